//! Height from inertia, barometers, GNSS and a rangefinder.
//!
//! What flies is the fault-tolerant altimeter, [`Altimeter`]: one joint filter (`joint`) whose samples `fault_tolerant` guards, a bank of
//! generalised likelihood ratios (`glr_bank`) that `isolation` reads, `accommodation` of what it finds, and two watches over what has
//! no onset: `noise_monitor` and `drift`. [`published`] holds the altimeters of Contreras and Hajiyev, for comparison: they fly only
//! where a configuration asks for them ([`AltimeterKind`]).
//!
//! ```
//! use holdover::altimeter::{Altimeter, AltimeterSettings, Channel, Health};
//!
//! // An aircraft at 120 m whose barometer is 15 m off from the fiftieth second on.
//! let mut altimeter = Altimeter::new(AltimeterSettings::table_1());
//! for k in 0..200 {
//!     altimeter.predict(0.5, 0.0, 0.0);
//!     let bias = if k < 100 { 0.0 } else { 15.0 };
//!     altimeter.measure(Channel::Baro, 120.0 + bias, None, 0.0);
//!     altimeter.measure(Channel::Gnss, 120.0, None, 0.0);
//! }
//! assert!(matches!(altimeter.health(Channel::Baro), Health::Faulty { .. }));
//! assert!(altimeter.height_m().is_some_and(|h| (h - 120.0).abs() < 1.0));
//! ```

mod accommodation;
mod channel_state;
mod drift;
mod fault;
mod fault_tolerant;
mod glr_bank;
mod height;
mod isolation;
mod joint;
mod memory;
mod noise_monitor;
mod probability;
pub mod published;
mod settings;
mod tuning;

pub use fault::{Change, Fault, Health};
pub use fault_tolerant::{Altimeter, HeightVerdict};
pub use height::{AltimeterKind, HeightFilter};
pub use joint::{Channel, InertialModel, OffsetModel, UnseenClimb};
pub use memory::{AltimeterMemory, ChannelMemory};
pub use probability::normal_operation;
pub use published::{
    AltimeterMethod, AltimeterScheme, BaselineAltimeter, ChannelReport, ErrorModel, Estimate, Ibi, Iig,
    PublishedAltimeter, PublishedFilter, Variant, WeightedInnovation, fuse, stationary_sigma,
};
pub use settings::{AltimeterSettings, ChannelSettings, DetectionSettings};
