//! Height: a baro/inertial/GNSS filter that keeps the height continuous when one of its sources goes, and the published altimeters.
//!
//! [`published`], [`ibig`] and [`selector`] are the altimeters of Contreras and Hajiyev, "Robust Kalman filter-based fault-tolerant
//! integrated baro-inertial-GPS altimeter", over the error model in [`model`].

pub mod atmosphere;
pub mod height;
pub mod ibig;
pub mod model;
pub mod probability;
pub mod published;
pub mod selector;

pub use height::{HeightFilter, HeightSettings, HeightVerdict};
pub use ibig::{Estimate, Method, PublishedAltimeter, Scheme, StepReport, fuse};
pub use model::{ErrorModel, stationary_sigma};
pub use probability::normal_operation;
pub use published::{Ibi, Iig, Innovation, PublishedFilter, Variant};
