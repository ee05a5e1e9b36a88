//! Standing still: a disarmed vehicle whose IMU is quiet does not move. That ends the drift before take-off and after landing, and shows
//! the gyro bias.

use nalgebra::Vector3;

use crate::sample::ImuSample;
use crate::time::AutopilotTime;

use super::super::context::Context;
use super::super::observation::{Fused, Observation};
use super::super::reset::Reset;
use crate::geo::NOMINAL_GRAVITY_MPS2;
use crate::navigator::tuning::standstill::{
    PERIOD_S, QUIET_FORCE, QUIET_RATE, QUIET_S, SIGMA_MPS, SIGMA_RADPS,
};

/// Since when the IMU has been quiet, and when standing still is to be told the filter next.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct StandstillSource {
    since: Option<AutopilotTime>,
    told: Option<AutopilotTime>,
    resting: bool,
}

impl StandstillSource {
    /// Whether the vehicle stands.
    pub(in super::super) fn resting(&self) -> bool {
        self.resting
    }

    /// Whether the vehicle is disarmed and quiet, whether or not a filter believes it.
    pub(in super::super) fn quiet(&self, now: AutopilotTime) -> bool {
        self.since.is_some_and(|since| now.seconds_since(since) >= QUIET_S)
    }

    /// Looks at an IMU sample; an observation every so often while the vehicle stands.
    pub(in super::super) fn observe(&mut self, s: &ImuSample, context: &Context<'_>) -> Option<Observation> {
        let core = context.core;
        let environment = core.surroundings.environment();
        let gravity = environment.map_or(NOMINAL_GRAVITY_MPS2, |e| e.gravity_ned.z);
        let quiet = s.angular_rate.raw().norm() < QUIET_RATE
            && (s.specific_force.raw().norm() - gravity).abs() < QUIET_FORCE;
        if !core.vehicle.disarmed() || !quiet {
            *self = Self::default();
            return None;
        }
        let since = *self.since.get_or_insert(s.time);
        if s.time.seconds_since(since) < QUIET_S {
            return None;
        }
        if self.told.is_some_and(|t| s.time.seconds_since(t) < PERIOD_S) {
            return None;
        }
        self.told = Some(s.time);
        core.estimator.filter_state()?;
        Some(Observation::Standstill {
            angular_rate_body: s.angular_rate.raw(),
            earth_rate_ned: environment.map_or(Vector3::zeros(), |e| e.earth_rate_ned),
            sigma_mps: SIGMA_MPS,
            sigma_radps: SIGMA_RADPS,
        })
    }

    /// What became of it. A filter that moves does not believe it, and is right: a float on a river is disarmed, too.
    pub(in super::super) fn fused(&mut self, fused: &Fused) {
        self.resting = fused.taken();
    }

    pub(super) fn reset(&mut self, reset: &Reset) {
        if reset.breaks_motion() {
            *self = Self::default();
        }
    }
}
