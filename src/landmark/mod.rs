//! Pose from known landmarks.
//!
//! What flies is [`LandmarkFilter`]: sightings take effect in the order in which they were made (`ordered`) in a dead-reckoned frame
//! ([`dead_reckoning`]), on an H∞ filter of the drone in information form ([`information`]), which needs no start, and on a filter that
//! refines what that one has acquired ([`refined`]). [`hinf`] holds the published H∞ filter for implicit outputs, in general and in its
//! 24-state example: what the flying one is derived from and compared with.
//!
//! ```
//! use holdover::geo::Body;
//! use holdover::landmark::{
//!     BodyMotion, LandmarkCamera, LandmarkFilter, LandmarkMap, LandmarkSettings, LandmarkSighting, PoseGuess, Seen,
//! };
//! use holdover::time::AutopilotTime;
//! use nalgebra::{Matrix3, Vector3};
//!
//! // Six marks on the ground; a drone hovers 4 m above them, level, nose north, and takes itself for 2 m further north.
//! let marks: Vec<(u8, Vector3<f64>)> =
//!     (0..6).map(|i| (i, Vector3::new(f64::from(i % 3) - 1.0, f64::from(i / 3), 0.1 * f64::from(i)))).collect();
//! let map = LandmarkMap::new(marks.clone())?;
//! let truth = Vector3::new(0.0, 0.0, -4.0);
//! let guess = PoseGuess {
//!     position_ned: truth + Vector3::new(2.0, 0.0, 0.0),
//!     r_body_to_ned: Matrix3::identity(),
//!     position_sigma_m: 3.0,
//!     attitude_sigma_rad: 0.1,
//! };
//! let start = AutopilotTime::from_micros(0);
//! let cameras = vec![LandmarkCamera::downward([0.9, 0.9])];
//! let mut filter = LandmarkFilter::new(LandmarkSettings::seen_from(4.0), map, cameras, start, &guess);
//! for k in 1..100 {
//!     let time = AutopilotTime::from_micros(20_000 * k);
//!     filter.push(time, &BodyMotion::REST, Some(&Vector3::z()));
//!     for (id, mark) in &marks {
//!         let seen = Seen::InBody(Body::new(mark - truth));
//!         filter.sighting(&LandmarkSighting { time, camera: 0, id: *id, seen });
//!     }
//! }
//! assert!(filter.pose().is_some_and(|pose| (pose.position_ned - truth).norm() < 0.2));
//! # Ok::<(), holdover::landmark::MapError>(())
//! ```

pub mod dead_reckoning;
mod drone;
mod geometry;
pub mod hinf;
pub mod information;
pub mod motion;
mod ordered;
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
