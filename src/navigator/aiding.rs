//! Magnetometer, barometer and rangefinder.

use crate::altimeter::{HeightVerdict, atmosphere::pressure_altitude_m};
use crate::sample::{MagSample, PressureSample, RangeDirection, RangeSample};

use super::Navigator;
use super::event::What;
use super::verdict::{Reason, Verdict};

/// A second barometer takes over when the first is silent for this long, s.
const BARO_SILENCE_S: f64 = 1.0;
/// Steepest tilt at which a range beam still measures the height over ground: cos 60°.
const RANGE_MIN_COSINE: f64 = 0.5;

impl Navigator {
    pub(super) fn mag(&mut self, s: &MagSample) -> Verdict {
        if !self.settings.magnetometer {
            return Verdict::Rejected(Reason::SwitchedOff);
        }
        let norm = s.field_body.norm();
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
        self.magnetic = Some((s.time, s.field_body));
        Verdict::Used
    }

    pub(super) fn pressure(&mut self, s: &PressureSample) -> Verdict {
        let Some(altitude) = pressure_altitude_m(s.pressure_pa) else {
            return Verdict::Rejected(Reason::NotFinite);
        };
        let Some(now) = self.last_imu else { return Verdict::Rejected(Reason::NoReferenceYet) };
        let interval = match self.pressure {
            Some((last, sensor)) if sensor != s.sensor && s.time.seconds_since(last) < BARO_SILENCE_S => {
                return Verdict::Rejected(Reason::Redundant);
            }
            Some((last, _)) if s.time <= last => return Verdict::Rejected(Reason::OutOfOrder),
            Some((last, sensor)) => {
                if sensor != s.sensor {
                    // Another barometer has another offset.
                    self.height.another_barometer();
                }
                s.time.seconds_since(last)
            }
            None => 0.0,
        };
        self.pressure = Some((s.time, s.sensor));
        // Before there is a place, a height has no zero.
        if self.place.is_none() {
            return Verdict::Rejected(Reason::NoReferenceYet);
        }
        match self.height.baro(altitude, interval, now.seconds_since(s.time)) {
            HeightVerdict::Used(_) => Verdict::Used,
            HeightVerdict::Rejected(_) => Verdict::Rejected(Reason::Innovation),
            HeightVerdict::OffsetReset(step) => {
                self.tell(s.time, What::BaroStep(step));
                Verdict::Used
            }
        }
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
        // At their limits sensors report the limit.
        let outside = |[low, high]: [f64; 2]| s.distance_m <= low || s.distance_m >= 0.98 * high;
        if s.distance_m <= 0.0 || s.limits_m.is_some_and(outside) {
            return Verdict::Rejected(Reason::OutOfRange);
        }
        self.range = Some((s.time, s.distance_m));
        let cosine = self.r_body_to_ned[(2, 2)];
        if let (Some(height), true) = (self.height.height_m(), cosine > RANGE_MIN_COSINE) {
            self.ground_m = Some(height - s.distance_m * cosine);
        }
        Verdict::Used
    }
}
