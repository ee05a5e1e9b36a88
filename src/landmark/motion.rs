//! How a body moves over a short time, in its own axes: what moves every filter of this room between sightings.

use nalgebra::{Matrix3, Vector3};

use crate::geo::so3::{exp, left_jacobian};

/// Velocity and angular rate of the body in body axes, held over an interval (zero-order hold).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyMotion {
    /// Velocity, m/s.
    pub velocity_body: Vector3<f64>,
    /// Angular rate, rad/s.
    pub angular_rate_body: Vector3<f64>,
}

impl BodyMotion {
    /// At rest.
    pub const REST: Self =
        Self { velocity_body: Vector3::new(0.0, 0.0, 0.0), angular_rate_body: Vector3::new(0.0, 0.0, 0.0) };

    /// Whether every number is one.
    pub fn is_finite(&self) -> bool {
        self.velocity_body.iter().chain(self.angular_rate_body.iter()).all(|v| v.is_finite())
    }

    /// Where the motion leads within `dt_s`, exactly: the turn Exp(ωh) and the way J(ωh)vh, both in the body axes at its beginning.
    pub fn over(&self, dt_s: f64) -> (Matrix3<f64>, Vector3<f64>) {
        let turn = self.angular_rate_body * dt_s;
        (exp(&turn), left_jacobian(&turn) * self.velocity_body * dt_s)
    }
}
