//! The navigator.
pub mod budget;
pub mod history;
pub mod latency;
pub mod solution;
pub mod trust;
pub mod verdict;
