//! What the navigator believes.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::geo::{Body, BodyToNed, Ned};
use crate::time::AutopilotTime;

/// What the navigator is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, strum::IntoStaticStr)]
pub enum Mode {
    /// Finding attitude, heading and place; nothing is known yet.
    #[strum(serialize = "Aligning")]
    Aligning,
    /// GNSS is trusted and used.
    #[strum(serialize = "Aided")]
    Aided,
    /// GNSS is not trusted: dead reckoning.
    #[strum(serialize = "Holdover")]
    Holdover,
    /// GNSS is good again; the position glides over to it.
    #[strum(serialize = "Rejoining")]
    Rejoining,
    /// The position is not known well enough to be used by anybody.
    #[strum(serialize = "Lost")]
    Lost,
}

impl Mode {
    /// Its name, as in the JSON.
    pub fn label(self) -> &'static str {
        self.into()
    }
}

/// What carries the horizontal velocity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, strum::IntoStaticStr)]
#[serde(rename_all = "lowercase")]
pub enum VelocitySource {
    /// GNSS position and velocity.
    #[strum(serialize = "GNSS")]
    Gnss,
    /// The position is that of known landmarks in view; what carries between them does not matter.
    #[strum(serialize = "landmarks")]
    Landmarks,
    /// Optical flow and height.
    #[strum(serialize = "optical flow")]
    Flow,
    /// Airspeed, heading and the wind as it was last known.
    #[strum(serialize = "airspeed")]
    Airspeed,
    /// The drag of a multirotor's rotors, and the wind as it was last known.
    #[strum(serialize = "rotor drag")]
    Drag,
    /// The vehicle stands on the ground.
    #[strum(serialize = "standing still")]
    Standstill,
    /// Nothing: inertial coasting.
    #[strum(serialize = "inertia alone")]
    Inertial,
}

impl VelocitySource {
    /// What it is, for people.
    pub fn label(self) -> &'static str {
        self.into()
    }
}

/// Position, velocity and attitude with their uncertainty, at the navigator's origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution {
    /// When it holds.
    pub time: AutopilotTime,
    /// The mode.
    pub mode: Mode,
    /// What carries the horizontal velocity.
    pub velocity_source: VelocitySource,
    /// Position, m.
    pub position: Ned<Vector3<f64>>,
    /// Velocity, m/s.
    pub velocity: Ned<Vector3<f64>>,
    /// What the published position moves by beyond that while it glides to where the estimate is, m/s.
    pub glide_velocity: Ned<Vector3<f64>>,
    /// Attitude.
    pub attitude: BodyToNed,
    /// Angular rate less the estimated gyro bias, rad/s.
    pub angular_rate: Body<Vector3<f64>>,
    /// Covariance of the position, m².
    pub position_covariance: Ned<Matrix3<f64>>,
    /// Covariance of the velocity, m²/s².
    pub velocity_covariance: Ned<Matrix3<f64>>,
    /// Variances of roll, pitch and yaw, rad².
    pub attitude_variance: Vector3<f64>,
    /// Changes when the position had to jump.
    pub reset_counter: u8,
}

impl Solution {
    /// The velocity that the published position moves with, m/s: who integrates it gets that position.
    pub fn published_velocity(&self) -> Ned<Vector3<f64>> {
        self.velocity + self.glide_velocity
    }

    /// Standard deviation of the horizontal position error, √(P_NN + P_EE), m: the expected root mean square of its length (DRMS).
    pub fn horizontal_sigma_m(&self) -> f64 {
        let p = self.position_covariance.raw();
        (p[(0, 0)] + p[(1, 1)]).max(0.0).sqrt()
    }
}
