//! The messages, before they become MAVLink.

use nalgebra::{Matrix3, Vector3};

use crate::geo::{Body, BodyToNed, Ned};
use crate::time::AutopilotTime;

/// Frame of the pose in ODOMETRY.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseFrame {
    /// MAV_FRAME_LOCAL_FRD (20); north-aligned here, which is what ArduPilot takes it for.
    LocalFrd,
    /// MAV_FRAME_LOCAL_NED (1).
    LocalNed,
}

/// ODOMETRY: pose in the local frame, velocity and rates in body FRD.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Odometry {
    /// When it holds.
    pub time: AutopilotTime,
    /// Frame of the pose; the child frame is always MAV_FRAME_BODY_FRD.
    pub frame: PoseFrame,
    /// From the autopilot's origin, m.
    pub position: Ned<Vector3<f64>>,
    /// Attitude.
    pub attitude: BodyToNed,
    /// Velocity, m/s.
    pub velocity: Body<Vector3<f64>>,
    /// Angular rate, rad/s.
    pub angular_rate: Body<Vector3<f64>>,
    /// Upper triangle, row by row, of the covariance of (x, y, z, roll, pitch, yaw).
    pub pose_covariance: [f64; 21],
    /// The same of (vx, vy, vz, roll rate, pitch rate, yaw rate).
    pub velocity_covariance: [f64; 21],
    /// Changes when the pose jumped.
    pub reset_counter: u8,
    /// -1 failed, 1 (worst) to 100 (best).
    pub quality: i8,
}

/// VISION_POSITION_ESTIMATE.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisionPosition {
    /// When it holds.
    pub time: AutopilotTime,
    /// From the autopilot's origin, m.
    pub position: Ned<Vector3<f64>>,
    /// Attitude.
    pub attitude: BodyToNed,
    /// As in [`Odometry`].
    pub pose_covariance: [f64; 21],
    /// As in [`Odometry`].
    pub reset_counter: u8,
}

/// What is sent.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "a box would be an allocation for each message, on the path of every IMU sample"
)]
pub enum OutboundMessage {
    /// ODOMETRY.
    Odometry(Odometry),
    /// VISION_POSITION_ESTIMATE.
    VisionPosition(VisionPosition),
    /// VISION_SPEED_ESTIMATE.
    VisionSpeed {
        /// When it holds.
        time: AutopilotTime,
        /// Velocity, m/s.
        velocity: Ned<Vector3<f64>>,
        /// Its covariance, m²/s².
        covariance: Ned<Matrix3<f64>>,
        /// As in [`Odometry`].
        reset_counter: u8,
    },
}

impl OutboundMessage {
    /// When it holds.
    pub fn time(&self) -> AutopilotTime {
        match self {
            Self::Odometry(Odometry { time, .. })
            | Self::VisionPosition(VisionPosition { time, .. })
            | Self::VisionSpeed { time, .. } => *time,
        }
    }
}

/// MAVLink's 21 numbers of a 6×6 covariance: `first` in the upper left, `second` on the rest of the diagonal.
pub(super) fn upper_triangle(first: &Matrix3<f64>, second: &Vector3<f64>) -> [f64; 21] {
    let mut out = [0.0; 21];
    let mut i = 0;
    for row in 0..6 {
        for column in row..6 {
            out[i] = match (row, column) {
                (r, c) if c < 3 => first[(r, c)],
                (r, c) if r == c => second[r - 3],
                _ => 0.0,
            };
            i += 1;
        }
    }
    out
}
