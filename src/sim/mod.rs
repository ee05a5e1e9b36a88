//! Simulation: closed-form truth and sensors made from it. The engine behind the tests of estimators, and of `simulate`.

pub mod sensors;
pub mod trajectory;

pub use sensors::{Environment, ImuMean, NoiseLevels, Noisy};
pub use trajectory::{FixedWing, Multirotor, Trajectory, Truth};
