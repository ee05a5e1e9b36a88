//! One IMU sample through the estimator: what it needs, what it gives, and when a stage has to begin anew.

use nalgebra::{Matrix3, Vector3};

use crate::observer::{MagneticPair, ObserverState, StepReport};
use crate::time::AutopilotTime;

use super::super::context::SourceFacts;
use super::super::environment::LocalEnvironment;
use super::super::observation::Fused;
use super::super::settings::NavigatorSettings;
use super::super::solution::Mode;
use super::super::sources::status::Measured;
use super::error_state::StartPoint;
use crate::navigator::tuning::estimator_step::{
    DISAGREEMENT, DISAGREEMENT_S, FLOW_AGE_S, LOCKED_OUT_S, MAGNETIC_AGE_S, MISFIT_GAIN, MOST_MISFITS,
};

/// Since when a stage has disagreed with what it stands on.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Watch {
    disagree_since: Option<AutopilotTime>,
    /// Since when trusted fixes have been gated out.
    locked_out_since: Option<AutopilotTime>,
    /// The part of the trusted fixes of late of which a component did not fit, and when the last of those came.
    misfits: f64,
    misfit: Option<AutopilotTime>,
}

impl Watch {
    /// Whether a disagreement of `apart` rad has lasted for too long.
    pub(super) fn disagrees(&mut self, now: AutopilotTime, apart: Option<f64>) -> bool {
        if apart.is_none_or(|a| a < DISAGREEMENT) {
            self.disagree_since = None;
            return false;
        }
        now.seconds_since(*self.disagree_since.get_or_insert(now)) > DISAGREEMENT_S
    }

    /// Whether most of the trusted fixes of late have spoken against the stage. Who disagrees with it may be wrong himself, with a magnetometer that
    /// is; as long as fixes fit, the stage is not.
    pub(super) fn is_doubted(&self, now: AutopilotTime) -> bool {
        self.misfits > MOST_MISFITS && self.misfit.is_some_and(|t| now.seconds_since(t) < DISAGREEMENT_S)
    }

    /// Takes note of a fix: whether position and velocity fitted, and whether fixes have been gated out for too long.
    pub(super) fn locked_out(&mut self, now: AutopilotTime, fused: &Fused) -> bool {
        let taken = !fused.gated(Measured::GnssPosition);
        let misfit = !taken || fused.gated(Measured::GnssVelocity);
        self.misfits += MISFIT_GAIN * (f64::from(u8::from(misfit)) - self.misfits);
        if misfit {
            self.misfit = Some(now);
        }
        self.locked_out_since = if taken { None } else { Some(self.locked_out_since.unwrap_or(now)) };
        self.locked_out_since.is_some_and(|t| now.seconds_since(t) > LOCKED_OUT_S)
    }
}

/// What an IMU step needs besides the sample.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct StepInput<'a> {
    pub(in super::super) settings: &'a NavigatorSettings,
    pub(in super::super) environment: &'a LocalEnvironment,
    pub(in super::super) mode: Mode,
    /// GNSS is not navigated on.
    pub(in super::super) dead_reckoning: bool,
    /// What carries the velocity without it is the flow.
    pub(in super::super) carried_by_flow: bool,
    pub(in super::super) height_m: Option<f64>,
    pub(in super::super) height_sigma_m: f64,
    pub(in super::super) climb_mps: f64,
    /// The newest magnetic field, body, T.
    pub(in super::super) magnetic: Option<(AutopilotTime, Vector3<f64>)>,
    /// The newest corrected flow velocity, body, m/s.
    pub(in super::super) flow_velocity: Option<(AutopilotTime, Vector3<f64>)>,
    pub(in super::super) gnss_sigma_m: f64,
    /// It is a fixed wing.
    pub(in super::super) wing: bool,
}

impl StepInput<'_> {
    pub(super) fn magnetic_pair(&self, now: AutopilotTime) -> Option<MagneticPair> {
        let (time, field_body) = self.magnetic?;
        let field_ned = self.environment.field_ned?;
        (now.seconds_since(time) < MAGNETIC_AGE_S).then_some(MagneticPair { field_body, field_ned })
    }

    pub(super) fn flow_body(&self, now: AutopilotTime) -> Option<Vector3<f64>> {
        self.flow_velocity.filter(|(t, _)| now.seconds_since(*t) < FLOW_AGE_S).map(|(_, v)| v)
    }

    pub(super) fn start_point(&self) -> StartPoint<'_> {
        StartPoint {
            settings: self.settings,
            height_m: self.height_m,
            height_sigma_m: self.height_sigma_m,
            position_sigma_m: self.gnss_sigma_m,
        }
    }
}

/// Whether a magnetometer is heard.
pub(in super::super) fn has_magnetometer(facts: &SourceFacts, now: AutopilotTime) -> bool {
    facts.magnetic.is_some_and(|(t, _)| now.seconds_since(t) < MAGNETIC_AGE_S)
}

/// Whether there is a fresh flow velocity.
pub(in super::super) fn has_flow(facts: &SourceFacts, now: AutopilotTime) -> bool {
    facts.flow_velocity.is_some_and(|(t, _)| now.seconds_since(t) < FLOW_AGE_S)
}

/// Whether an observer has no direction but gravity.
pub(super) fn is_blind(facts: &SourceFacts, now: AutopilotTime) -> bool {
    !has_flow(facts, now) && !has_magnetometer(facts, now)
}

/// What a step gives.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Stepped {
    pub(in super::super) r_body_to_ned: Matrix3<f64>,
    /// Gyro bias taken out, rad/s.
    pub(in super::super) angular_rate_body: Vector3<f64>,
    /// m/s².
    pub(in super::super) acceleration_ned: Vector3<f64>,
    /// What the observer's signal goes on with, m/s².
    pub(in super::super) injected_ned: Vector3<f64>,
}

/// What came of an IMU step.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct StepOutcome {
    pub(in super::super) stepped: Stepped,
    pub(in super::super) report: StepReport,
    /// What was fused on the way.
    pub(in super::super) fused: Fused,
    /// The stage was started anew; it had been this far from the observer, rad.
    pub(in super::super) restarted: Option<f64>,
    /// The attitude was found again after a hole.
    pub(in super::super) settled: bool,
}

/// What a hole is carried over with besides the samples at its ends.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct CarryInput<'a> {
    pub(in super::super) settings: &'a NavigatorSettings,
    pub(in super::super) environment: &'a LocalEnvironment,
    /// It is a fixed wing.
    pub(in super::super) wing: bool,
}

/// What the search for a heading needs besides the sample.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct SeekInput<'a> {
    pub(in super::super) settings: &'a NavigatorSettings,
    pub(in super::super) environment: &'a LocalEnvironment,
    pub(in super::super) facts: &'a SourceFacts,
}

/// How far the observer has come, for the stage over it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Progress<'a> {
    /// After this step.
    pub(super) observed: &'a ObserverState,
    /// Its injection is small.
    pub(super) calm: bool,
    /// It only follows the stage: it has nothing to say about it.
    pub(super) led: bool,
    /// What its signal goes on with, m/s².
    pub(super) injected_ned: Vector3<f64>,
    pub(super) flow_bias_time_constant_s: f64,
}
