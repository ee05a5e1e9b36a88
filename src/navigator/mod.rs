//! The navigator.
pub mod budget;
pub mod history;
pub mod solution;
pub mod trust;
