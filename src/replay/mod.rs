//! Logs: opening them, playing them through the pipeline, and scoring what came out.

pub mod airborne;
mod as_flown;
pub mod forks;
pub mod losses;
pub mod matrix;
pub mod runner;
pub mod stress;
pub mod sweep;
