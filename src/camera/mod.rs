//! From what a camera sees to the vehicle's velocity.

pub mod calibration;
