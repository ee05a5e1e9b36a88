//! Height: a baro/inertial/GNSS filter that keeps the height continuous when one of its sources goes.

pub mod atmosphere;
pub mod height;

pub use height::{HeightFilter, HeightSettings, HeightVerdict};
