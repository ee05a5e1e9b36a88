//! Pose from known landmarks.
//!
//! What flies is [`LandmarkFilter`]: sightings take effect in the order in which they were made ([`ordered`]) in a dead-reckoned frame
//! ([`dead_reckoning`]), on an H∞ filter of the drone in information form ([`information`]), which needs no start, and on a filter that
//! refines what that one has acquired ([`refined`]). [`hinf`] holds the published H∞ filter for implicit outputs, in general and in its
//! 24-state example: what the flying one is derived from and compared with.

pub mod dead_reckoning;
mod drone;
mod geometry;
pub mod hinf;
pub mod information;
pub mod motion;
pub mod ordered;
pub mod refined;
mod settings;
mod sighting;
mod tracker;
mod tuning;

pub use dead_reckoning::MotionVerdict;
pub use drone::{LandmarkFilter, LandmarkHealth, LandmarkPose, PoseGuess, PoseSource};
pub use geometry::Observability;
pub use hinf::{
    AffineDynamics, AffineTransition, CameraModel, Definiteness, Discount, HinfFilter, HinfSettings,
    ImplicitOutput, ImplicitSystem, UpdateRefusal, VisionInertial, VisionSample,
};
pub use motion::BodyMotion;
pub use settings::{BeliefSettings, LandmarkCamera, LandmarkMap, LandmarkSettings, MapError};
pub use sighting::{LandmarkSighting, Seen, SightingVerdict};
