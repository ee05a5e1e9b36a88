//! What was learned of a flow sensor, as numbers that can be kept, and back.

use nalgebra::{Vector2, Vector4};
use serde::{Deserialize, Serialize};

use super::{CalibrationSettings, FlowCalibration};
use crate::geo::symmetric;

/// Estimate and covariance, and what the residuals have shown.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationMemory {
    /// Two biases, scale error s and misalignment μ, rad; see [`FlowCalibration`].
    pub estimate: [f64; 4],
    /// Its covariance's upper triangle, row by row.
    pub covariance: Vec<f64>,
    /// Mean square residual over the noise stated, and mean squares of velocity and residual, m²/s².
    pub statistics: [f64; 3],
    /// Mean velocity, body x and y, m/s.
    pub mean: [f64; 2],
    /// Mean distance, m.
    pub mean_distance: f64,
    /// For how long it was compared, s.
    pub compared_s: f64,
}

/// Nothing here is larger: squares of it stay finite.
const LARGEST: f64 = 1e6;
/// No flow sensor's error is larger: a bias, and as a part.
const LARGEST_BIAS: f64 = 20.0;
const LARGEST_SCALE: f64 = 1.0;

impl CalibrationMemory {
    /// What a calibration has learned.
    pub fn of(calibration: &FlowCalibration) -> Self {
        Self {
            estimate: calibration.x.into(),
            covariance: symmetric::upper(&calibration.p),
            statistics: [calibration.excess, calibration.signal, calibration.residual],
            mean: calibration.mean.into(),
            mean_distance: calibration.mean_distance,
            compared_s: calibration.compared_s,
        }
    }

    /// A calibration that has learned this. `None` where no sensor is like that.
    pub fn calibration(&self, settings: CalibrationSettings) -> Option<FlowCalibration> {
        let [b_x, b_y, s, mu] = self.estimate.map(f64::abs);
        let [excess, signal, residual] = self.statistics;
        let sound = b_x.max(b_y) <= LARGEST_BIAS
            && s.max(mu) <= LARGEST_SCALE
            && [b_x, b_y, s, mu].iter().all(|v| v.is_finite())
            && (0.0..=LARGEST).contains(&excess)
            && (0.0..=LARGEST).contains(&signal)
            && residual.abs() <= LARGEST
            && self.mean.iter().all(|v| v.abs() <= LARGEST)
            && (0.0..=LARGEST).contains(&self.mean_distance)
            && (0.0..=1e9).contains(&self.compared_s);
        let p = symmetric::covariance::<4>(&self.covariance).filter(|_| sound)?;
        let x = Vector4::from(self.estimate);
        let mean = Vector2::from(self.mean);
        let (mean_distance, compared_s) = (self.mean_distance, self.compared_s);
        Some(FlowCalibration { settings, x, p, excess, signal, residual, mean, mean_distance, compared_s })
    }

    /// The same for another flight: the sensor is what it was, and has to be compared again before it is believed.
    pub fn to_be_confirmed(&self) -> Self {
        Self {
            statistics: [1.0, 0.0, 0.0],
            mean: [0.0; 2],
            mean_distance: 0.0,
            compared_s: 0.0,
            ..self.clone()
        }
    }
}
