//! The published observers, the filters that fly, and the camera's flow.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests may fail like tests"
)]

#[path = "../support/flight.rs"]
mod flight;
#[path = "../support/golden/mod.rs"]
mod golden;
#[path = "../support/observing.rs"]
mod observing;

mod camera_flow;
mod convergence;
mod heading_bank;
mod vectors;
mod xkf;
