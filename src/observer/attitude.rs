//! The attitude equation, common to both observers, and its start-up gate.

use super::bias::{BiasBounds, bias_drive};
use crate::geo::so3;
use nalgebra::{Matrix3, Vector3};

/// How the attitude equation is discretised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Discretisation {
    /// R̂⁺ = (R̂ + ΔR) Exp((ω − b̂) dt). The one to use.
    Exponential,
    /// R̂⁺ = R̂ + dt R̂ S(ω − b̂) + ΔR, as in Fusini's experiments.
    Euler,
}

/// A magnetometer vector and its reference. Only the directions matter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MagneticPair {
    /// Measured field in body axes, calibrated, any unit.
    pub field_body: Vector3<f64>,
    /// Reference field in NED, any unit (see [`crate::geo::magnetic`]).
    pub field_ned: Vector3<f64>,
}

/// The start-up gate: while ‖J‖_F is at or above a threshold the gyro bias is held and K_P is the identity.
///
/// Our addition. Far from the truth the injection says nothing about the bias, which would wind up to its bound and take
/// minutes to come back. The attitude is below 5° in seconds from any start only if K_P = I stays in force below the threshold, too:
/// use the observers' `start_up` parameters for the first half minute.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gate {
    /// Threshold on ‖J‖_F, dimensionless.
    pub threshold: f64,
    /// K_P in force above it, 1/s.
    pub k_p: f64,
}

impl Gate {
    /// Threshold 0.5 (about 20° of attitude error) and K_P = I.
    pub const fn standard() -> Self {
        Self { threshold: 0.5, k_p: 1.0 }
    }
}

/// Attitude gains of one step, after gating.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct AttitudeGains {
    /// Diagonal of K_P, 1/s.
    pub k_p: Vector3<f64>,
    /// k_I, 1/s.
    pub k_i: f64,
    /// Whether the start-up gains are in force.
    pub gated: bool,
}

impl AttitudeGains {
    /// The gains for an injection of this norm.
    pub(super) fn choose(gate: Option<Gate>, k_p: Vector3<f64>, k_i: f64, j_norm: Option<f64>) -> Self {
        match (gate, j_norm) {
            (Some(g), Some(n)) if n >= g.threshold => {
                Self { k_p: Vector3::repeat(g.k_p), k_i: 0.0, gated: true }
            }
            _ => Self { k_p, k_i, gated: false },
        }
    }

    /// b̂ after `dt`: Proj and the resetting rule (Grip (7b), (12); Fusini (6b)).
    pub(super) fn advance_bias(
        &self,
        bounds: &BiasBounds,
        bias: &Vector3<f64>,
        r_hat: &Matrix3<f64>,
        j: &Matrix3<f64>,
        dt: f64,
    ) -> Vector3<f64> {
        let tau = self.k_i * bias_drive(r_hat, &self.k_p, j);
        bounds.reset(&(bias + dt * bounds.project(bias, &tau)))
    }
}

/// R̂ after `dt` at a body rate, given the injected change ΔR (Grip (7a), Fusini (6a)).
pub(super) fn advance(
    discretisation: Discretisation,
    r_hat: &Matrix3<f64>,
    delta_r: &Matrix3<f64>,
    body_rate: &Vector3<f64>,
    dt: f64,
) -> Matrix3<f64> {
    match discretisation {
        Discretisation::Exponential => (r_hat + delta_r) * so3::exp(&(body_rate * dt)),
        Discretisation::Euler => r_hat + r_hat * so3::hat(body_rate) * dt + delta_r,
    }
}

/// Rows of `j` scaled by the components of `scale`: diag(scale) J.
pub(super) fn scale_rows(scale: &Vector3<f64>, j: &Matrix3<f64>) -> Matrix3<f64> {
    Matrix3::from_fn(|row, col| scale[row] * j[(row, col)])
}
