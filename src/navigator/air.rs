//! Airspeed, and the nose of a fixed wing in the wind: what carries the velocity where there is no flow.
//!
//! With GNSS the filter learns the wind and the airspeed's scale in turns; without, airspeed and heading less the wind are a velocity
//! whose error grows as slowly as the wind changes.

use crate::geo::atmosphere::true_airspeed_factor;
use crate::sample::{Airframe, AirspeedSample};
use crate::time::AutopilotTime;

use super::Navigator;
use super::aiding::LATE_S;
use super::nis::Measured;
use super::settings::Estimator;
use super::verdict::{Reason, Verdict};

/// Noise is stated for samples this far apart, s: gusts last, and more samples tell no more.
const SAMPLE_INTERVAL_S: f64 = 0.2;
/// Beyond this bank or pitch, or this load, a wing does not fly nose first: cos 60°, and in g.
const MIN_UPRIGHT: f64 = 0.5;
const MAX_LOAD_G: f64 = 2.5;
const GRAVITY: f64 = 9.81;
/// An airspeed carries the velocity for this long, s.
pub(super) const AIRSPEED_AGE_S: f64 = 2.0;

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

impl Navigator {
    pub(super) fn airspeed(&mut self, s: &AirspeedSample) -> Verdict {
        let air = self.settings.air;
        if !s.airspeed_mps.is_finite() {
            return Verdict::Rejected(Reason::NotFinite);
        }
        let coasting = self.settings.estimator == Estimator::Inertial && self.modes.dead_reckoning();
        if !air.enabled || self.settings.estimator == Estimator::Ekf15 || coasting {
            return Verdict::Rejected(Reason::SwitchedOff);
        }
        if self.status.airframe != Some(Airframe::FixedWing) {
            return Verdict::Rejected(Reason::NotUsed);
        }
        if self.airspeed.is_some_and(|t| s.time <= t) {
            return Verdict::Rejected(Reason::OutOfOrder);
        }
        if self.is_late(s.time, LATE_S) {
            return Verdict::Rejected(Reason::Late);
        }
        let interval_s = self.airspeed.map_or(SAMPLE_INTERVAL_S, |t| s.time.seconds_since(t));
        self.airspeed = Some(s.time);
        let Some(place) = &self.place else { return Verdict::Rejected(Reason::NoReferenceYet) };
        let above_sea = place.frame.origin().height_m + self.height.height_m().unwrap_or_default();
        let airspeed = s.airspeed_mps * true_airspeed_factor(above_sea);
        if airspeed < air.min_mps {
            return Verdict::Rejected(Reason::TooSlow);
        }
        let Some(kalman) = &mut self.kalman else { return Verdict::Rejected(Reason::NoReferenceYet) };
        let often = (SAMPLE_INTERVAL_S / interval_s.max(1e-3)).max(1.0).sqrt();
        let fused = kalman.filter.fuse_airspeed(airspeed, air.sigma_mps * often);
        let upright = kalman.filter.state().r_body_to_ned[(2, 2)] > MIN_UPRIGHT;
        let load = self.last_sample.map_or(f64::INFINITY, |i| i.specific_force.raw().norm() / GRAVITY);
        let slipped = (fused.is_ok() && upright && load < MAX_LOAD_G && air.sideslip_sigma_rad > 0.0)
            .then(|| kalman.filter.fuse_sideslip(air.sideslip_sigma_rad * often));
        let taken = self.nis.note(Measured::Airspeed, fused, |c| c.nis);
        let side = slipped.and_then(|f| self.nis.note(Measured::Sideslip, f, |c| c.nis));
        let now = self.last_imu.unwrap_or(s.time);
        self.carry_back(now, taken.iter().chain(side.iter()));
        if taken.is_none() {
            return Verdict::Rejected(Reason::Innovation);
        }
        self.airspeed_used = Some(s.time);
        Verdict::Used
    }

    /// Whether airspeed carries the velocity at present.
    pub(super) fn carried_by_air(&self, now: AutopilotTime) -> bool {
        self.airspeed_used.is_some_and(|t| now.seconds_since(t) < AIRSPEED_AGE_S)
    }
}
