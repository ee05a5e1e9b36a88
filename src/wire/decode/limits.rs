//! What can be measured at all: beyond these bounds a value is an error, whoever tells it and however.

use std::ops::RangeInclusive;

/// Beyond any accelerometer that a small vehicle carries (±16 g to ±32 g), m/s².
pub const SPECIFIC_FORCE_MPS2: f64 = 400.0;
/// Beyond any gyroscope that a small vehicle carries (±2000 °/s to ±4000 °/s), rad/s.
pub const ANGULAR_RATE_RADPS: f64 = 80.0;
/// What a magnetometer near Earth can tell, T: its field, and what iron and currents of the vehicle make of it.
pub const FIELD_T: RangeInclusive<f64> = 5e-6..=3e-4;
/// From 20 km of height to the deepest valley, Pa.
pub const PRESSURE_PA: RangeInclusive<f64> = 5e3..=1.2e5;
/// Flow faster than this is no flow, rad/s (good sensors end at 7).
pub const FLOW_RADPS: f64 = 50.0;
/// Farther than any rangefinder sees, m.
pub const RANGE_M: f64 = 1e4;
/// Of a vehicle in the air; a pitot tube's zero wanders below none, m/s.
pub const AIRSPEED_MPS: RangeInclusive<f64> = -5.0..=200.0;
/// Further from its origin, or faster, no vehicle of this kind gets, m and m/s.
pub const LOCAL_M: f64 = 1e6;
/// See [`LOCAL_M`].
pub const LOCAL_MPS: f64 = 1e3;
