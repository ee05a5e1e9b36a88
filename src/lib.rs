//! Holdover keeps a drone navigating when GNSS drops. See the README for the daemon, and the modules for the mathematics.

pub mod geo;
pub mod observer;
pub mod time;
pub mod wire;
