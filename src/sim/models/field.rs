//! A magnetometer.

use crate::sim::noise::{SensorRng, Stream};
use crate::sim::trajectory::Truth;
use crate::sim::world::Environment;
use nalgebra::Vector3;

/// Errors of a magnetometer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MagnetometerModel {
    /// Time between samples, s.
    pub period_s: f64,
    /// White noise an axis, T.
    pub noise_t: f64,
    /// Hard iron: length of the constant bias as a part of the field's strength, the same on all axes.
    pub hard_iron: f64,
}

impl MagnetometerModel {
    /// No errors, 50 Hz.
    pub fn ideal() -> Self {
        Self { period_s: 0.02, noise_t: 0.0, hard_iron: 0.0 }
    }

    /// 0.3 µT of noise and hard iron of 3.5 % of the field.
    pub fn small() -> Self {
        Self { noise_t: 0.3e-6, hard_iron: 0.035, ..Self::ideal() }
    }
}

/// A magnetometer in flight.
#[derive(Clone, Debug)]
pub(in crate::sim) struct Magnetometer {
    model: MagnetometerModel,
    rng: SensorRng,
    bias_body: Vector3<f64>,
}

impl Magnetometer {
    pub(in crate::sim) fn new(model: MagnetometerModel, seed: u64, environment: &Environment) -> Self {
        let mut rng = SensorRng::new(seed, Stream::Magnetometer);
        let axis = model.hard_iron * environment.magnetic_ned.norm() / 3f64.sqrt();
        let bias_body = rng.signed3(&Vector3::repeat(axis));
        Self { model, rng, bias_body }
    }

    /// The field in body axes, T.
    pub(in crate::sim) fn sample(&mut self, environment: &Environment, truth: &Truth) -> Vector3<f64> {
        environment.magnetometer(truth) + self.bias_body + self.rng.normals() * self.model.noise_t
    }
}
