//! Cameras: from the motion of the image to the velocity of the body (Fusini, Section III).
//!
//! ```
//! use holdover::camera::{FlowPatch, PatchLimits, PatchNoise, single_patch};
//! use holdover::geo::CameraMount;
//! use nalgebra::{Matrix3, Vector2, Vector3};
//!
//! // 20 m over the ground, level, the image moves by 0.5 rad/s about the camera's y axis: 10 m/s forward.
//! let patch = FlowPatch {
//!     integration_time_s: 0.05,
//!     flow_rad: Vector2::new(0.0, 0.025),
//!     rotation_rad: Vector2::zeros(),
//!     body_rate: Vector3::zeros(),
//!     distance_m: Some(20.0),
//!     height_m: None,
//!     quality: 0.9,
//! };
//! let (mount, level) = (CameraMount::downward(), Matrix3::identity());
//! let seen = single_patch::solve(&patch, &mount, &level, &PatchLimits::default(), &PatchNoise::default())?;
//! assert!((seen.velocity_body(0.0) - Vector3::new(10.0, 0.0, 0.0)).norm() < 1e-9);
//! # Ok::<(), holdover::camera::FlowRefusal>(())
//! ```

pub mod calibration;
pub mod features;
pub mod patch_table;
pub mod refusal;
mod robust;
pub mod single_patch;
pub mod stacked;

pub use calibration::{CalibrationMemory, CalibrationSettings, Distrust, FlowCalibration, ReferenceVelocity};
pub use features::{Feature, View, ground_point, interaction_matrix};
pub use patch_table::{MAX_PATCHES, PatchCentre, PatchTable};
pub use refusal::FlowRefusal;
pub use single_patch::{FlowPatch, FlowVelocity, PatchLimits, PatchNoise};
pub use stacked::{
    KnownComponent, Method, SixSolution, SolveLimits, SolveNoise, VelocitySolution, solve_six, solve_velocity,
};
