//! A magnetometer whose field comes in the wrong unit: off by a power of ten from any field that Earth has.
//!
//! ArduPilot of 2025-10 sends HIGHRES_IMU's field in milligauss times 1000 instead of gauss. Earth's field is 22 to 67 µT at its surface
//! (World Magnetic Model 2025), less than a factor of ten apart, so that the power is certain where the direction of the slip is.

use std::ops::RangeInclusive;

use nalgebra::Vector3;

use super::limits;

/// Earth's field, T, with room for a sensor that is not calibrated.
const EARTH_T: RangeInclusive<f64> = 20e-6..=70e-6;
/// The middle of [`EARTH_T`] by ratio, T.
const TYPICAL_T: f64 = 37e-6;
/// Fields in a row that have to be off by the same power.
const CONFIRM: u32 = 20;

/// The unit of one stream of fields.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FieldUnit {
    /// The fields that come are 10^`power` times as strong as they are.
    power: i32,
    suspected: i32,
    agreed: u32,
}

impl FieldUnit {
    /// The field in tesla, with the power of ten that it was off by; `None` if it is no field, or not known yet to be one in another
    /// unit.
    pub(super) fn put_right(&mut self, field: Vector3<f64>) -> Option<(Vector3<f64>, i32)> {
        let norm = field.norm();
        let corrected = field * 10f64.powi(-self.power);
        if limits::FIELD_T.contains(&corrected.norm()) {
            self.agreed = 0;
            return Some((corrected, self.power));
        }
        let power = (norm / TYPICAL_T).log10().round();
        if !power.is_finite() || !EARTH_T.contains(&(norm * 10f64.powf(-power))) {
            self.agreed = 0;
            return None;
        }
        let power = power as i32;
        self.agreed = if power == self.suspected { self.agreed + 1 } else { 1 };
        self.suspected = power;
        if self.agreed < CONFIRM {
            return None;
        }
        *self = Self { power, ..Self::default() };
        Some((field * 10f64.powi(-power), power))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FIELD: Vector3<f64> = Vector3::new(20e-6, -3e-6, 42e-6);

    #[test]
    fn a_slip_is_found_and_undone() {
        for (factor, power) in [(1e6, 6), (1e3, 3), (1e-4, -4), (1e4, 4)] {
            let mut unit = FieldUnit::default();
            let first = (0..100).find(|_| unit.put_right(FIELD * factor).is_some());
            assert_eq!(first, Some(i32::try_from(CONFIRM).unwrap() - 1));
            let (field, off) = unit.put_right(FIELD * factor).unwrap();
            assert!((field - FIELD).norm() < 1e-12 && off == power, "{field:?} {off}");
            // A firmware that does better after a reboot.
            assert!((0..100).any(|_| unit.put_right(FIELD) == Some((FIELD, 0))));
        }
    }

    #[test]
    fn a_disturbed_field_is_no_slip_and_neither_is_nonsense() {
        let mut unit = FieldUnit::default();
        assert!((0..100).all(|_| unit.put_right(FIELD * 5.0) == Some((FIELD * 5.0, 0))));
        // Neither itself nor a tenth of it is a field that Earth has.
        assert!((0..100).all(|_| unit.put_right(Vector3::new(0.0, 0.0, 900e-6)).is_none()));
        assert!((0..100).all(|k| unit.put_right(FIELD * 10f64.powi(3 + k % 2)).is_none()));
        assert!((0..100).all(|_| unit.put_right(Vector3::zeros()).is_none()));
        assert_eq!(unit.put_right(FIELD), Some((FIELD, 0)));
    }
}
