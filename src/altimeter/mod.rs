//! Height from inertia, barometers, GNSS and a rangefinder: the fault-tolerant altimeter ([`tolerant`]), and the published ones.
//!
//! [`published`], [`ibig`] and [`selector`] are the altimeters of Contreras and Hajiyev, "Robust Kalman filter-based fault-tolerant
//! integrated baro-inertial-GPS altimeter", over the error model in [`model`].

pub mod atmosphere;
mod declared;
mod drift;
mod fault;
pub mod flown;
pub mod height;
pub mod ibig;
mod isolation;
mod joint;
pub mod model;
mod noise;
mod onsets;
pub mod probability;
pub mod published;
pub mod selector;
mod settings;
pub mod tolerant;

pub use fault::{Change, Fault, Health};
pub use flown::FlownAltimeter;
pub use height::{AltimeterKind, HeightFilter};
pub use ibig::{Estimate, Method, PublishedAltimeter, Scheme, StepReport, fuse};
pub use joint::{Channel, InertialModel, OffsetModel};
pub use model::{ErrorModel, stationary_sigma};
pub use probability::normal_operation;
pub use published::{Ibi, Iig, Innovation, PublishedFilter, Variant};
pub use settings::{AltimeterSettings, ChannelSettings, DetectionSettings};
pub use tolerant::{Altimeter, HeightVerdict};
