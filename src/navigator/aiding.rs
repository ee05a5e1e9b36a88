//! Magnetometer and rangefinder.

use crate::sample::{MagSample, RangeDirection, RangeSample};
use crate::time::{AutopilotTime, Span};
use nalgebra::Vector3;

use super::Navigator;
use super::verdict::{Reason, Verdict};

/// What is set against the present may be this old, s.
pub(super) const LATE_S: f64 = 0.5;
/// A magnetometer that tells the same for this long, s (a slow one is told several times), while the vehicle has turned by this much, rad,
/// beyond this rate, rad/s, within so long, s, is stuck.
const STUCK_S: f64 = 0.3;
const STUCK_TURN: f64 = 0.03;
const STUCK_RATE: f64 = 0.02;
const STUCK_LOOK_S: f64 = 2.0;
/// Steepest tilt at which a range beam still measures the height over ground: cos 60°.
const RANGE_MIN_COSINE: f64 = 0.5;
/// The ground may step by this much, m, or this part of the height over it, from one sample to the next …
const GROUND_STEP_M: f64 = 1.5;
const GROUND_STEP_FRACTION: f64 = 0.2;
/// … and by more when it stays there for this long, s.
const GROUND_BELIEVED_S: f64 = 5.0;

impl Navigator {
    pub(super) fn mag(&mut self, s: &MagSample) -> Verdict {
        if !self.settings.magnetometer {
            return Verdict::Rejected(Reason::SwitchedOff);
        }
        let norm = s.field.raw().norm();
        if !norm.is_finite() {
            return Verdict::Rejected(Reason::NotFinite);
        }
        if self.magnetic.is_some_and(|(t, _)| s.time < t) {
            return Verdict::Rejected(Reason::OutOfOrder);
        }
        let Some(field) = self.place.as_ref().and_then(|p| p.field_ned) else {
            return Verdict::Rejected(Reason::NoReferenceYet);
        };
        if (norm / field.norm() - 1.0).abs() > self.settings.magnetometer_norm_error {
            return Verdict::Rejected(Reason::FieldStrength);
        }
        if self.is_late(s.time, LATE_S) {
            return Verdict::Rejected(Reason::Late);
        }
        if self.magnetometer_is_stuck(s) {
            return Verdict::Rejected(Reason::Stuck);
        }
        self.magnetic = Some((s.time, s.field.raw()));
        if self.fuse_magnetic(s.time, &s.field.raw()) {
            Verdict::Used
        } else {
            Verdict::Rejected(Reason::Innovation)
        }
    }

    /// Whether a sample of this time comes too late for the present.
    pub(super) fn is_late(&self, time: AutopilotTime, most_s: f64) -> bool {
        self.last_imu.is_some_and(|now| now.seconds_since(time) > most_s)
    }

    /// Whether the field stands still in the body while the body turns. At rest a coarse magnetometer may tell the same for long.
    fn magnetometer_is_stuck(&mut self, s: &MagSample) -> bool {
        let Some((since, field, known)) = self.magnetic_same.filter(|(_, field, _)| *field == s.field.raw())
        else {
            self.magnetic_same = Some((s.time, s.field.raw(), false));
            return false;
        };
        let now = self.last_imu.map_or(s.time, |now| now.min(s.time));
        let from = since.max(now - Span::from_seconds(STUCK_LOOK_S));
        let elapsed = now.seconds_since(from);
        // What turns slower than this may be a gyro's bias.
        let turned = |w: Vector3<f64>| (w.norm() - STUCK_RATE) * elapsed > STUCK_TURN;
        let stuck = known || (elapsed > STUCK_S && self.history.mean_rate(from, now).is_some_and(turned));
        self.magnetic_same = Some((since, field, stuck));
        stuck
    }

    pub(super) fn range(&mut self, s: &RangeSample) -> Verdict {
        if s.direction != RangeDirection::Down {
            return Verdict::Rejected(Reason::NotUsed);
        }
        if !s.distance_m.is_finite() {
            return Verdict::Rejected(Reason::NotFinite);
        }
        if self.range.is_some_and(|(t, _)| s.time < t) {
            return Verdict::Rejected(Reason::OutOfOrder);
        }
        if self.is_late(s.time, LATE_S) {
            return Verdict::Rejected(Reason::Late);
        }
        // At their limits sensors report the limit.
        let outside = |[low, high]: [f64; 2]| s.distance_m <= 1.05 * low || s.distance_m >= 0.98 * high;
        if s.distance_m <= 0.0 || s.limits_m.is_some_and(outside) {
            return Verdict::Rejected(Reason::OutOfRange);
        }
        let cosine = self.r_body_to_ned[(2, 2)];
        let Some(height) = self.height.height_m().filter(|_| cosine > RANGE_MIN_COSINE) else {
            return Verdict::Rejected(Reason::NoReferenceYet);
        };
        let ground = height - s.distance_m * cosine;
        if let Some(known) = self.ground_m
            && !self.plausible_ground(s.time, ground - known, height - known)
        {
            return Verdict::Rejected(Reason::Innovation);
        }
        self.ground_disputed_since = None;
        self.range = Some((s.time, s.distance_m));
        self.ground_m = Some(ground);
        self.range_height(s, s.distance_m * cosine);
        Verdict::Used
    }

    /// Whether the ground may be this much higher than it was. A stuck rangefinder makes the ground climb with the vehicle; a
    /// roof or a cliff stays where it is, and is believed after a while.
    fn plausible_ground(&mut self, now: AutopilotTime, rise_m: f64, above_m: f64) -> bool {
        if rise_m.abs() < GROUND_STEP_M.max(GROUND_STEP_FRACTION * above_m) {
            return true;
        }
        match self.ground_disputed_since {
            Some((since, rise)) if (rise_m - rise).abs() < 0.5 * GROUND_STEP_M => {
                now.seconds_since(since) > GROUND_BELIEVED_S
            }
            _ => {
                self.ground_disputed_since = Some((now, rise_m));
                false
            }
        }
    }
}
