//! Airspeed, and the nose of a fixed wing in the wind: what carries the velocity where there is no flow.
//!
//! With GNSS the filter learns the wind and the airspeed's scale in turns; without, airspeed and heading less the wind are a velocity
//! whose error grows as slowly as the wind changes.

use crate::geo::atmosphere::true_airspeed_factor;
use crate::sample::{Airframe, AirspeedSample};
use crate::time::AutopilotTime;

use super::super::context::{Context, SourceFacts};
use super::super::observation::{Fused, Observation};
use super::super::reset::Reset;
use super::super::settings::Estimator;
use super::super::verdict::{Reason, Verdict};
use super::status::Measured;
use crate::geo::NOMINAL_GRAVITY_MPS2;
use crate::navigator::tuning::airspeed::{CARRIES_S, MAX_LOAD_G, SAMPLE_INTERVAL_S, STUCK_S};
use crate::navigator::tuning::every_source::LATE_S;

/// Settings of the airspeed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AirSettings {
    /// Use it.
    pub enabled: bool,
    /// Below this it is not used, m/s.
    pub min_mps: f64,
    /// Standard deviation with gusts, m/s.
    pub sigma_mps: f64,
    /// Standard deviation of the sideslip, rad; 0 does not use it.
    pub sideslip_sigma_rad: f64,
}

/// The newest airspeed, and the newest that was used.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct AirspeedSource {
    heard: Option<AutopilotTime>,
    /// Since when it has told the same, and what, m/s.
    same: Option<(AutopilotTime, f64)>,
    used: Option<AutopilotTime>,
}

impl AirspeedSource {
    /// When it last corrected the velocity.
    pub(super) fn used(&self) -> Option<AutopilotTime> {
        self.used
    }

    pub(in super::super) fn observe(
        &mut self,
        s: &AirspeedSample,
        context: &Context<'_>,
    ) -> Result<Observation, Reason> {
        let core = context.core;
        let air = &core.settings.air;
        if !s.airspeed_mps.is_finite() {
            return Err(Reason::NotFinite);
        }
        if !air.enabled || core.settings.estimator == Estimator::Ekf15 || core.coasts() {
            return Err(Reason::SwitchedOff);
        }
        if !core.vehicle.is(Airframe::FixedWing) {
            return Err(Reason::NotUsed);
        }
        if self.heard.is_some_and(|t| s.time <= t) {
            return Err(Reason::OutOfOrder);
        }
        if context.is_late(s.time, LATE_S) {
            return Err(Reason::Late);
        }
        let interval_s = self.heard.map_or(SAMPLE_INTERVAL_S, |t| s.time.seconds_since(t));
        self.heard = Some(s.time);
        if self.repeats(s) {
            return Err(Reason::Stuck);
        }
        let environment = core.surroundings.environment().ok_or(Reason::NoReferenceYet)?;
        let above_sea = environment.frame.origin().height_m + core.height.height_m().unwrap_or_default();
        let speed_mps = s.airspeed_mps * true_airspeed_factor(above_sea);
        if speed_mps < air.min_mps {
            return Err(Reason::TooSlow);
        }
        if core.estimator.filter_state().is_none() {
            return Err(Reason::NoReferenceYet);
        }
        let often = (SAMPLE_INTERVAL_S / interval_s.max(1e-3)).max(1.0).sqrt();
        let load = core
            .stream
            .last()
            .map_or(f64::INFINITY, |i| i.specific_force.raw().norm() / NOMINAL_GRAVITY_MPS2);
        let nose_first = load < MAX_LOAD_G && air.sideslip_sigma_rad > 0.0;
        Ok(Observation::Airspeed {
            speed_mps,
            sigma_mps: air.sigma_mps * often,
            sideslip_sigma_rad: nose_first.then_some(air.sideslip_sigma_rad * often),
        })
    }

    /// Whether it has told the same for longer than air lets it; until it tells another.
    fn repeats(&mut self, s: &AirspeedSample) -> bool {
        let same = self.same.filter(|(_, mps)| *mps == s.airspeed_mps).unwrap_or((s.time, s.airspeed_mps));
        self.same = Some(same);
        s.airspeed_mps > 0.0 && s.time.seconds_since(same.0) > STUCK_S
    }

    /// What became of an airspeed of this time.
    pub(in super::super) fn fused(&mut self, time: AutopilotTime, fused: &Fused) -> Verdict {
        if !fused.took(Measured::Airspeed) {
            return Verdict::Rejected(Reason::Innovation);
        }
        self.used = Some(time);
        Verdict::Used
    }

    pub(super) fn reset(&mut self, reset: &Reset) {
        if reset.sets_clock_back() {
            *self = Self::default();
        }
    }
}

/// Whether airspeed carries the velocity at present.
pub(in super::super) fn carries(facts: &SourceFacts, now: AutopilotTime) -> bool {
    facts.airspeed_used.is_some_and(|t| now.seconds_since(t) < CARRIES_S)
}
