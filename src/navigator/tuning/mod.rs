//! Every constant of the navigator that nobody configures: its value, its unit and why.
//!
//! What a user may need is configuration; what follows from a paper stands with its equation. These are left: they are design choices, and
//! each says what it separates or bounds.

mod decisions;
mod estimation;
mod sensing;
pub(super) mod shadow;

pub(super) use decisions::{
    budget, core, doppler_track, environment, event_log, flow_travel, frozen_fixes, gnss_by_air,
    gnss_by_flow, gnss_integrity, gyro_by_field, heading_witness, height, height_wander, inertia_jumps,
    inertia_witness, landmark_fix, memory, outage, plausibility, published, receiver_lie, relative, step,
    stream, travel_path, uncertainty, unexplained, vehicle, velocity_step, witness_blocks,
};
pub(super) use estimation::{
    error_state, estimator, estimator_step, exogenous, heading, hole, lookback, observer,
};
pub(super) use sensing::{
    airspeed, barometer, compass_step, drag, every_source, flow, flow_image, flow_measure, flow_unit,
    flow_witness, following, gnss, gnss_latency, held_course, inertial_noise, landmark_pose,
    landmark_relation, landmarks, latency, magnetic_latency, magnetic_noise, magnetometer, parting,
    rangefinder, rangefinders, standstill, status, takeoff,
};
