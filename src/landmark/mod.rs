//! Pose from known landmarks: the H∞ filter for systems with implicit outputs, in general and for a drone.
//!
//! [`implicit`] says what such a system is, [`riccati`] steps its Riccati equation exactly, and [`hinf`] is the filter: measurements may be
//! delayed, incomplete and in any number; whether its cost still has a minimum is checked at every step. [`vision_inertial`] is the example
//! of the paper in both of its forms.
//!
//! Source: Aguiar and Hespanha, "State estimation for systems with implicit outputs for the integration of vision and inertial sensors"
//! ("Aguiar"). Equation numbers are the paper's.

pub mod dead_reckoning;
pub mod hinf;
pub mod implicit;
pub mod information;
pub mod motion;
pub mod pose;
pub mod riccati;
pub mod vision_inertial;

pub use hinf::{Definiteness, HinfFilter, HinfSettings, UpdateRefusal};
pub use implicit::{Dynamics, ImplicitOutput, ImplicitSystem, Transition};
pub use motion::BodyMotion;
pub use vision_inertial::{CameraModel, VisionInertial, VisionSample};
