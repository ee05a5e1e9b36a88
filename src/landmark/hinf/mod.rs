//! The published H∞ filter for systems with implicit outputs: Aguiar and Hespanha, "State estimation for systems with implicit outputs for
//! the integration of vision and inertial sensors" ("Aguiar"). Equation numbers are the paper's.
//!
//! [`implicit`] says what such a system is, [`riccati`] steps its Riccati equation exactly, and [`filter`] is the filter: measurements may
//! be delayed, incomplete and in any number; whether its cost still has a minimum is checked at every step. [`vision_inertial`] is the
//! paper's example, in both of its forms. None of it flies: [`super::LandmarkFilter`] does.

pub mod filter;
pub mod implicit;
pub mod riccati;
pub mod vision_inertial;

pub use filter::{Definiteness, HinfFilter, HinfSettings, UpdateRefusal, impulse, projection};
pub use implicit::{AffineDynamics, AffineTransition, ImplicitOutput, ImplicitSystem};
pub use riccati::Discount;
pub use vision_inertial::{CameraModel, VisionInertial, VisionSample};
