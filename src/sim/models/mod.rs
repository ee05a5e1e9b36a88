//! Models of sensors with seeded errors.
//!
//! Each model is a plain record of its error levels, with presets; the state of a flight (biases, last values, random numbers) is a
//! type of its own beside it. **Constant errors have their stated size on every axis in every flight; only their signs are drawn from the
//! seed.** So all seeds are equally hard, and medians over seeds compare with the literature's, which states sizes. What changes with
//! time (noise, Gauss-Markov wander, outliers) is drawn.

mod air;
mod field;
mod flow;
mod gnss;
mod imu;
mod range;

pub use air::{AirspeedModel, BarometerModel, BarometerReading};
pub use field::MagnetometerModel;
pub use flow::{FlowModel, FlowReading, Outliers, RotationContent};
pub use gnss::{GnssModel, GnssOutage, GnssReading, OutageKind};
pub use imu::{ImuModel, ImuReading};
pub use range::RangeModel;

pub(super) use air::{Airspeed, Barometer};
pub(super) use field::Magnetometer;
pub(super) use flow::Flow;
pub(super) use gnss::Gnss;
pub(super) use imu::Imu;
pub(super) use range::Range;
