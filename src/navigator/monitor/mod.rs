//! What is believed of GNSS, which mode follows from it, and how dead reckoning goes on.

pub mod budget;
mod difference_noise;
mod doppler_track;
pub(super) mod felt_velocity;
pub(super) mod flow_travel;
mod frozen_fixes;
pub(super) mod gnss_by_air;
pub(super) mod gnss_by_flow;
pub mod gnss_integrity;
pub(super) mod gyro_by_field;
pub(super) mod heading_witness;
pub(super) mod inertia_jumps;
pub(super) mod inertia_trust;
pub(super) mod inertia_witness;
pub(super) mod mode;
pub(super) mod outage;
pub(super) mod plausibility;
pub(super) mod receiver_lie;
mod step_fit;
mod step_look;
pub(super) mod travel_path;
pub(super) mod unexplained;
pub(super) mod usual;
mod velocity_doubt;
pub(super) mod velocity_step;
pub(super) mod vertical_witness;
mod walk_fit;
mod witness_blocks;
pub(super) mod witnesses;

pub use gnss_integrity::{GnssFault, GnssState};
