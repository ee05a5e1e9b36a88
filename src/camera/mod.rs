//! Cameras: from the motion of the image to the velocity of the body (Fusini, Section III).

pub mod calibration;
pub mod single_patch;

pub use calibration::{CalibrationSettings, Distrust, FlowCalibration};
pub use single_patch::{CameraMount, FlowPatch, FlowRefusal, FlowVelocity, PatchLimits, PatchNoise};
