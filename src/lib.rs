//! Holdover keeps a drone navigating when GNSS drops. See the README for the daemon, and the modules for the mathematics.

pub mod camera;
pub mod geo;
pub mod observer;
pub mod sim;
pub mod time;
pub mod wire;
