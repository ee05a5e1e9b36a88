//! The state both observers share, and what a step returns.

use super::predictor::Signal;
use crate::geo::polar_rotation;
use nalgebra::{Matrix3, Vector3};
use thiserror::Error;

/// The state of Grip's and Fusini's observer alike. `Copy`: keeping one as a snapshot costs 168 bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObserverState {
    /// R̂, body → NED. Deliberately **not** kept in SO(3): its nine free numbers are what makes global convergence possible. Use
    /// [`Self::r_body_to_ned`] for angles.
    pub r_hat: Matrix3<f64>,
    /// b̂, gyro bias in body axes, rad/s.
    pub gyro_bias: Vector3<f64>,
    /// p̂ in NED, m.
    pub position_ned: Vector3<f64>,
    /// v̂ in NED, m/s.
    pub velocity_ned: Vector3<f64>,
    /// ξ in NED, m/s²: the auxiliary state with specific force f̂ⁿ = R̂ f + ξ (Grip (6c)-(6d), Fusini (7c)-(7e)).
    pub xi_ned: Vector3<f64>,
}

impl ObserverState {
    /// At an attitude, position and velocity, with no bias and ξ = 0.
    pub fn new(r_body_to_ned: Matrix3<f64>, position_ned: Vector3<f64>, velocity_ned: Vector3<f64>) -> Self {
        Self {
            r_hat: r_body_to_ned,
            gyro_bias: Vector3::zeros(),
            position_ned,
            velocity_ned,
            xi_ned: Vector3::zeros(),
        }
    }

    /// The rotation nearest to R̂; `None` while R̂ is degenerate, as it may be for moments when converging from half a turn.
    pub fn r_body_to_ned(&self) -> Option<Matrix3<f64>> {
        polar_rotation(&self.r_hat)
    }

    /// Specific force in NED, m/s²: R̂ f + ξ (Grip (6d)).
    pub fn specific_force_ned(&self, specific_force_body: &Vector3<f64>) -> Vector3<f64> {
        self.r_hat * specific_force_body + self.xi_ned
    }

    /// Whether every component is finite.
    pub fn is_finite(&self) -> bool {
        self.r_hat.iter().all(|c| c.is_finite())
            && [self.gyro_bias, self.position_ned, self.velocity_ned, self.xi_ned]
                .iter()
                .all(|v| v.iter().all(|c| c.is_finite()))
    }
}

/// What a step did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepReport {
    /// f̂ⁿ + g in NED over the step, m/s², without Coriolis, from the state before the step. Feed it to
    /// [`super::Predictor::propagate`].
    pub acceleration_ned: Vector3<f64>,
    /// J of the (last) injection; `None` when there was none: no reference vector, a degenerate triad, or Assumption 3's guard.
    pub injection: Option<Matrix3<f64>>,
    /// The start-up gains were in force.
    pub gated: bool,
    /// The measurement signal that was in the input, moved to the end of the step with every sub-step; `None` where the input has none.
    /// For [`super::Predictor::follow`].
    pub signal: Option<Signal>,
}

impl StepReport {
    /// ‖J‖_F. Above 0.5 the attitude is still being found; 2√2 is half a turn.
    pub fn injection_norm(&self) -> Option<f64> {
        self.injection.map(|j| j.norm())
    }
}

/// Why a step was refused. The state is then unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum StepRefusal {
    /// An input is not finite.
    #[error("an input is not finite")]
    NotFinite,
    /// The interval is not in (0, 1] s.
    #[error("the interval is not in (0, 1] s")]
    Interval,
}

/// Checks an interval and input vectors before they may touch a state.
pub(super) fn check(dt_s: f64, vectors: &[&Vector3<f64>]) -> Result<(), StepRefusal> {
    if !(dt_s > 0.0 && dt_s <= 1.0) {
        return Err(StepRefusal::Interval);
    }
    // A sum is finite only if every term is, barring overflow, which is as bad.
    let sum: f64 = vectors.iter().map(|v| v.x.abs() + v.y.abs() + v.z.abs()).sum();
    if sum.is_finite() { Ok(()) } else { Err(StepRefusal::NotFinite) }
}
