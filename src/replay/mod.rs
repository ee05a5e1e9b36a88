//! Logs: opening them, playing them through the pipeline, and scoring what came out.

pub mod log;
pub mod runner;
pub mod sweep;
