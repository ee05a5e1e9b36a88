//! Pose from known landmarks: the H∞ filter for systems with implicit outputs, in general and for a drone.
//!
//! [`implicit`] says what such a system is, [`riccati`] steps its Riccati equation exactly, and [`hinf`] is the filter: measurements may be
//! delayed, incomplete and in any number; whether its cost still has a minimum is checked at every step. [`vision_inertial`] is the example
//! of the paper in both of its forms. [`LandmarkFilter`] is what flies.
//!
//! Source: Aguiar and Hespanha, "State estimation for systems with implicit outputs for the integration of vision and inertial sensors"
//! ("Aguiar"). Equation numbers are the paper's.

pub mod dead_reckoning;
mod drone;
mod geometry;
pub mod hinf;
pub mod implicit;
pub mod information;
pub mod motion;
pub mod ordered;
pub mod pose;
pub mod refined;
pub mod riccati;
mod settings;
mod sighting;
mod tracker;
pub mod vision_inertial;

pub use dead_reckoning::MotionVerdict;
pub use drone::{LandmarkFilter, LandmarkHealth, LandmarkPose, PoseGuess, PoseSource};
pub use geometry::Observability;
pub use hinf::{Definiteness, HinfFilter, HinfSettings, UpdateRefusal};
pub use implicit::{Dynamics, ImplicitOutput, ImplicitSystem, Transition};
pub use motion::BodyMotion;
pub use settings::{CameraMount, LandmarkMap, LandmarkSettings, MapError};
pub use sighting::{LandmarkSighting, Seen, SightingVerdict};
pub use vision_inertial::{CameraModel, VisionInertial, VisionSample};
