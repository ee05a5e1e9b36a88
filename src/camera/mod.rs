//! Cameras: from the motion of the image to the velocity of the body (Fusini, Section III).

pub mod calibration;
pub mod features;
pub mod patch_table;
pub mod refusal;
mod robust;
pub mod single_patch;
pub mod stacked;

pub use calibration::{CalibrationSettings, Distrust, FlowCalibration};
pub use features::{Feature, View, ground_point, interaction_matrix};
pub use patch_table::{MAX_PATCHES, PatchCentre, PatchTable};
pub use refusal::FlowRefusal;
pub use single_patch::{FlowPatch, FlowVelocity, PatchLimits, PatchNoise};
pub use stacked::{
    KnownComponent, Method, SixSolution, SolveLimits, SolveNoise, VelocitySolution, solve_six, solve_velocity,
};
