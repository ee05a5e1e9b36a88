//! The navigator on simulated flights: what it reaches, and what bad input does to it.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests may fail like tests"
)]

#[path = "../support/command.rs"]
mod command;
#[path = "../support/data_sheet.rs"]
mod data_sheet;
#[path = "../support/flight.rs"]
mod flight;
#[path = "../support/sound.rs"]
mod sound;

mod aiding;
mod allocation;
mod bad_input;
mod believed;
mod contradicted;
mod dead_reckoning;
mod forged;
mod heights;
mod holes;
mod hostile;
mod judged;

mod lacking;
mod modes;
mod patches;
mod pixels;
mod random_samples;
mod resumed;
mod shadow;
