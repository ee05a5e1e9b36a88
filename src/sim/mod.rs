//! Simulation: closed-form truth and sensors made from it. The engine behind the tests of estimators, and of `simulate`.

pub mod altimeter;
pub mod flight;
mod hops;
pub mod landmarks;
pub mod markers;
pub mod models;
mod noise;
mod profile;
pub mod scenario;
pub mod sensors;
pub mod trajectory;
mod wander;
mod wing;

pub use flight::{Reading, Samples, SensorSuite, Simulation};
pub use landmarks::{LandmarkFlight, MarkerCamera, MarkerField, MotionNoise, SeenLandmark};
pub use markers::MarkerWatch;
pub use noise::GaussMarkov;
pub use scenario::Scenario;
pub use sensors::{Environment, ImuMean, NoiseLevels, Noisy};
pub use trajectory::{FixedWing, Multirotor, Trajectory, Truth};
pub use wander::Wander;
