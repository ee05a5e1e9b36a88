//! Geodesy and rotations: WGS-84, the local NED frame, normal gravity, Earth rate, the geomagnetic field, SO(3), frames and mounts.
//!
//! Frames: **NED** is the local tangent frame at a fixed origin on the WGS-84 ellipsoid (x true north, y east, z down along
//! the ellipsoid's normal); **body** is x forward, y right, z down (FRD); **ECEF** is Earth-centred, Earth-fixed. Lengths are
//! metres, angles radians, magnetic flux densities tesla.

pub mod earth_rate;
pub mod frame;
pub mod gravity;
pub mod magnetic;
pub mod mount;
pub mod nearest;
pub mod so3;
pub mod wgs84;

pub use earth_rate::{EARTH_RATE_RADPS, earth_rate_ned};
pub use frame::{Body, BodyToNed, Camera, CameraToBody, Ned};
pub use gravity::normal_gravity;
pub use magnetic::{MagneticError, MagneticField, magnetic_field};
pub use mount::CameraMount;
pub use nearest::{kabsch_rotation, polar_rotation};
pub use so3::Euler;
pub use wgs84::{Geodetic, LocalNed};
