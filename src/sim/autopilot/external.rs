//! What an external navigation source tells an autopilot, as it stands in its messages and before any rule of acceptance.

use nalgebra::{Matrix3, Vector3};

/// The frame that a message says its numbers are in (`MAV_FRAME`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReportedFrame {
    /// MAV_FRAME_LOCAL_NED (1).
    LocalNed,
    /// MAV_FRAME_LOCAL_FRD (20).
    LocalFrd,
    /// MAV_FRAME_BODY_FRD (12).
    BodyFrd,
    /// Any other.
    Other,
}

/// Which message it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExternalMessage {
    /// ODOMETRY (331), with the frames of its pose and of its velocity.
    Odometry {
        /// `frame_id`.
        pose: ReportedFrame,
        /// `child_frame_id`.
        velocity: ReportedFrame,
        /// `estimator_type`.
        estimator_type: u8,
        /// `quality`: −1 failed, 0 not known, else up to 100.
        quality: i8,
    },
    /// VISION_POSITION_ESTIMATE (102), which has neither velocity nor quality.
    VisionPosition,
    /// VISION_SPEED_ESTIMATE (103): a velocity in NED alone.
    VisionSpeed,
}

/// One message of an external navigation source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExternalPose {
    /// Which message.
    pub message: ExternalMessage,
    /// Its own stamp, s.
    pub stamp_s: f64,
    /// When it came, s of the simulation.
    pub arrived_s: f64,
    /// Position as told, m; `None` where it is NaN or not part of the message.
    pub position: Option<Vector3<f64>>,
    /// Attitude as told, if it can be read as one.
    pub attitude: Option<Matrix3<f64>>,
    /// How far the norm of the quaternion is from 1.
    pub quaternion_error: f64,
    /// Velocity as told, m/s, in the message's frame.
    pub velocity: Option<Vector3<f64>>,
    /// Variances of the position, m²; NaN where they are.
    pub position_variance: Vector3<f64>,
    /// Variances of the velocity, m²/s².
    pub velocity_variance: Vector3<f64>,
    /// Changes when the pose jumps.
    pub reset_counter: u8,
}

impl ExternalPose {
    /// Its quality, where the message has one.
    pub fn quality(&self) -> Option<i8> {
        match self.message {
            ExternalMessage::Odometry { quality, .. } => Some(quality),
            ExternalMessage::VisionPosition | ExternalMessage::VisionSpeed => None,
        }
    }
}

/// What became of a message: nobody but the double's own tests and its reports is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExternalFate {
    /// At least a part of it was fused.
    Fused,
    /// The estimate jumped to it.
    Jumped,
    /// Taken note of, but not used by what is selected now.
    NotSelected,
    /// A frame, a message or an estimator type that is not read.
    NotRead,
    /// Its quality is below what is asked for.
    LowQuality,
    /// Too soon after the one before.
    TooSoon,
    /// Too old.
    TooLate,
    /// The gate says no.
    Gated,
    /// Fusion has not begun, or was stopped.
    NotStarted,
}

/// How often each fate befell a message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ExternalCounts {
    counts: [u64; 9],
}

impl ExternalCounts {
    /// One more.
    pub fn count(&mut self, fate: ExternalFate) {
        self.counts[fate as usize] += 1;
    }

    /// How many.
    pub fn of(&self, fate: ExternalFate) -> u64 {
        self.counts[fate as usize]
    }

    /// All messages.
    pub fn total(&self) -> u64 {
        self.counts.iter().sum()
    }
}
