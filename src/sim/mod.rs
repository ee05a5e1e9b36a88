//! Simulation: closed-form truth and sensors made from it. The engine behind `simulate`, the tests of estimators and the
//! examples: a [`Scenario`] is flown with a [`SensorSuite`] by a [`Simulation`].

pub mod altimeter;
pub mod autopilot;
mod figures;
pub mod flight;
pub mod landmarks;
pub mod markers;
pub mod models;
mod noise;
mod profile;
pub mod scenario;
pub mod trajectory;
mod wander;
mod waypoints;
mod wing;
pub mod world;

pub use flight::{Reading, Samples, SensorSuite, Simulation};
pub use landmarks::{LandmarkFlight, MarkerCamera, MarkerField, MotionNoise, SeenLandmark};
pub use markers::MarkerWatch;
pub use noise::GaussMarkov;
pub use scenario::Scenario;
pub use trajectory::{Trajectory, Truth};
pub use wander::Wander;
pub use world::{Environment, ImuMean};
