//! A rangefinder that looks along body +z.

use crate::sim::noise::{SensorRng, Stream};
use crate::sim::trajectory::Truth;
use crate::sim::world::Environment;

/// Errors of a rangefinder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeModel {
    /// Time between samples, s.
    pub period_s: f64,
    /// Least and greatest distance, m.
    pub limits_m: [f64; 2],
    /// White noise, m.
    pub noise_m: f64,
    /// White noise as a part of the distance.
    pub noise_fraction: f64,
}

impl RangeModel {
    /// A small lidar: 0.1 to 50 m, 3 cm and 0.3 %, 20 Hz.
    pub fn lidar() -> Self {
        Self { period_s: 0.05, limits_m: [0.1, 50.0], noise_m: 0.03, noise_fraction: 0.003 }
    }
}

/// What comes when nothing is in range: beyond the greatest distance by this much, m, as autopilots send it.
const BEYOND_M: f64 = 1.0;

/// A rangefinder in flight.
#[derive(Clone, Debug)]
pub(in crate::sim) struct Range {
    model: RangeModel,
    rng: SensorRng,
}

impl Range {
    pub(in crate::sim) fn new(model: RangeModel, seed: u64) -> Self {
        Self { model, rng: SensorRng::new(seed, Stream::Range) }
    }

    /// Distance along the beam, m; beyond the greatest when out of range or looking up.
    pub(in crate::sim) fn sample(&mut self, environment: &Environment, truth: &Truth) -> f64 {
        let m = self.model;
        let n = self.rng.normal();
        let cosine = truth.r_body_to_ned[(2, 2)];
        let slant = if cosine > 0.0 { environment.height(truth) / cosine } else { f64::INFINITY };
        let measured = slant + n * m.noise_m.hypot(m.noise_fraction * slant);
        if measured.is_finite() && measured < m.limits_m[1] {
            measured.max(0.0)
        } else {
            m.limits_m[1] + BEYOND_M
        }
    }
}
