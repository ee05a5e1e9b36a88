//! Faults put into recorded flights: what the commands do with them, and that no list of them makes a confident lie.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests may fail like tests"
)]

#[path = "../support/command.rs"]
mod command;

mod any_list;
mod by_command;
mod gnss;
mod height;
mod holes;
mod imu;
mod turns;
