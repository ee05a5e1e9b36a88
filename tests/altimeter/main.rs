//! The altimeters: alone in Monte Carlo runs, and on recorded flights.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests may fail like tests"
)]

#[path = "../support/altimeter/mod.rs"]
mod altimeter;
#[path = "../support/heights.rs"]
mod heights;

mod flights;
mod published;
mod tolerant;
