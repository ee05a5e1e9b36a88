//! Holdover keeps a drone navigating when GNSS drops. See the README for the daemon, and the modules for the mathematics.

pub mod altimeter;
pub mod camera;
pub mod cli;
pub mod config;
pub mod daemon;
pub mod filter;
pub mod geo;
pub mod landmark;
pub mod metrics;
pub mod navigator;
pub mod observer;
pub mod outbound;
pub mod pipeline;
pub mod replay;
pub mod sample;
pub mod sim;
pub mod time;
pub mod wire;
