//! The `holdover` command and what it writes.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests may fail like tests"
)]

#[path = "../support/command.rs"]
mod command;

mod cli;
mod docs;
mod files;
mod flights;
mod marker_log;
mod preflight;
mod simulate;
mod stand_in;
