//! Height: a baro/inertial/GNSS filter that keeps the height continuous when one of its sources goes.

pub mod atmosphere;
pub mod height;
pub mod probability;

pub use height::{HeightFilter, HeightSettings, HeightVerdict};
pub use probability::normal_operation;
