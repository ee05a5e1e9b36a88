//! The navigator.
pub mod budget;
pub mod history;
pub mod trust;
