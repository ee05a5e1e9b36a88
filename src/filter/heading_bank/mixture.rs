//! The hypotheses together: weights, mean and covariance of a sum of Gaussians.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::hypothesis::Hypothesis;
use super::tuning::LEAST_WEIGHT;
use crate::geo::so3;

/// Mean and covariance.
pub(super) struct Moments {
    pub(super) r_body_to_ned: Matrix3<f64>,
    pub(super) velocity_ne: Vector2<f64>,
    pub(super) gyro_bias: Vector3<f64>,
    /// Covariances of the attitude (about NED's axes), the velocity and the bias.
    pub(super) attitude: Matrix3<f64>,
    pub(super) velocity: Matrix2<f64>,
    pub(super) bias: Matrix3<f64>,
}

impl Moments {
    /// About the likeliest hypothesis (Alspach, Sorenson (18)-(19)); `None` of none.
    pub(super) fn of(bank: &[Hypothesis]) -> Option<Self> {
        let best = bank.iter().reduce(|a, b| if b.log_weight > a.log_weight { b } else { a })?;
        let about = best.r_body_to_ned;
        let away = |h: &Hypothesis| so3::log(&(h.r_body_to_ned * about.transpose()));
        let (mut turn, mut gyro_bias) = (Vector3::zeros(), Vector3::zeros());
        for (w, h) in weighted(bank) {
            turn += w * away(h);
            gyro_bias += w * h.gyro_bias;
        }
        let mut m = Self {
            r_body_to_ned: so3::exp(&turn) * about,
            velocity_ne: mean_velocity(bank),
            gyro_bias,
            attitude: Matrix3::zeros(),
            velocity: Matrix2::zeros(),
            bias: Matrix3::zeros(),
        };
        for (w, h) in weighted(bank) {
            let (t, v, b) = (away(h) - turn, h.velocity_ne - m.velocity_ne, h.gyro_bias - gyro_bias);
            m.attitude += w * (h.attitude_covariance() + t * t.transpose());
            m.velocity += w * (h.velocity_covariance() + v * v.transpose());
            m.bias += w * (h.bias_covariance() + b * b.transpose());
        }
        Some(m)
    }
}

/// The hypotheses with their weights, which add up to 1.
fn weighted(bank: &[Hypothesis]) -> impl Iterator<Item = (f64, &Hypothesis)> {
    let sum: f64 = bank.iter().map(|h| h.log_weight.exp()).sum();
    bank.iter().map(move |h| (h.log_weight.exp() / sum, h))
}

/// The mean velocity, m/s.
pub(super) fn mean_velocity(bank: &[Hypothesis]) -> Vector2<f64> {
    weighted(bank).fold(Vector2::zeros(), |sum, (w, h)| sum + w * h.velocity_ne)
}

/// The greatest logarithm of a weight becomes 0: the sum then cannot overflow, nor vanish.
pub(super) fn normalise(bank: &mut [Hypothesis]) {
    let best = bank.iter().map(|h| h.log_weight).fold(f64::NEG_INFINITY, f64::max);
    let least = LEAST_WEIGHT.ln();
    for h in bank {
        h.log_weight = (h.log_weight - best).max(least);
    }
}
