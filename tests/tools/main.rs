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
mod drawing;
mod export;
mod files;
mod fleet;
mod flights;
mod init;
mod inspect;
mod marker_log;
mod preflight;
mod report;
mod simulate;
mod stand_in;
#[cfg(feature = "object-store")]
mod stores;
