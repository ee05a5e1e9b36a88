//! Logs of the autopilots' own formats: one flight in each of them, and what damage does to it.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests may fail like tests"
)]

#[path = "../support/command.rs"]
mod command;
#[path = "../support/dataflash_file.rs"]
mod dataflash_file;
#[path = "../support/flight.rs"]
mod flight;
#[path = "../support/ulog_file.rs"]
mod ulog_file;

mod damage;
mod formats;
mod golden;
mod pauses;
mod topics;

use std::path::Path;

use holdover::log::{Log, LogSummary};
use holdover::sample::Input;

/// Everything that a log becomes.
fn inputs(path: &Path) -> (Vec<Input>, LogSummary) {
    let mut inputs = Vec::new();
    let summary = Log::open(path, None).unwrap().play(|_, _| {}, |_, i| inputs.push(*i)).unwrap();
    (inputs, summary)
}
