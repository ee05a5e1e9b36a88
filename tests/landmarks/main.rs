//! Landmarks: their filters, and what the navigator makes of them.
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
#[path = "../support/marker_flight.rs"]
mod marker_flight;
#[path = "../support/paper_vision.rs"]
mod paper_vision;
#[path = "../support/sound.rs"]
mod sound;

mod filter;
mod hinf;
mod navigator;
mod vectors;
