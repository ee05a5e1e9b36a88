//! The published altimeters, for comparison: Contreras and Hajiyev, "Robust Kalman filter-based fault-tolerant integrated
//! baro-inertial-GPS altimeter".
//!
//! [`error_model`] is what they estimate, [`filter`] the optimal and the robust Kalman filter of one channel (IBI, IIG), [`ibig`] both
//! channels and their fusion, [`selector`] the test that the paper's recommendation leaves open. [`baseline`] puts them on a vehicle's own
//! sensors. What flies by default is [`super::Altimeter`].

pub mod baseline;
pub mod error_model;
pub mod filter;
pub mod ibig;
pub mod selector;
mod tuning;

pub use baseline::BaselineAltimeter;
pub use error_model::{ErrorModel, stationary_sigma};
pub use filter::{Ibi, Iig, PublishedFilter, Variant, WeightedInnovation};
pub use ibig::{AltimeterMethod, AltimeterScheme, ChannelReport, Estimate, PublishedAltimeter, fuse};
