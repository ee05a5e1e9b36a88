//! Geodesy and rotations: WGS-84, the local NED frame, normal gravity, Earth rate, the geomagnetic field, SO(3), frames and mounts.
//!
//! Frames: **NED** is the local tangent frame at a fixed origin on the WGS-84 ellipsoid (x true north, y east, z down along
//! the ellipsoid's normal); **body** is x forward, y right, z down (FRD); **ECEF** is Earth-centred, Earth-fixed. Lengths are
//! metres, angles radians, magnetic flux densities tesla.
//!
//! ```
//! use holdover::geo::{Body, CameraMount, Euler, Geodetic, LocalNed, magnetic_field, normal_gravity};
//! use nalgebra::Vector3;
//!
//! let origin = Geodetic::from_degrees(63.4, 10.4, 150.0);
//! let mast = LocalNed::new(origin).to_ned(&Geodetic::from_degrees(63.401, 10.4, 180.0));
//! assert!((mast.x - 111.5).abs() < 0.2 && (mast.z + 30.0).abs() < 0.01);
//!
//! assert!((normal_gravity(origin.latitude_rad, origin.height_m) - 9.821).abs() < 1e-3);
//! let field = magnetic_field(&origin, 2026.5)?.raw();
//! assert!(field.y > 0.0, "declination is to the east in Trondheim");
//!
//! let nose = CameraMount::turned(Euler::new(0.0, 90f64.to_radians(), 0.0), Body::new(Vector3::new(0.2, 0.0, 0.0)));
//! assert!((nose.axis().raw() - Vector3::x()).norm() < 1e-12, "pitched up by a quarter, it looks forward");
//! # Ok::<(), holdover::geo::MagneticError>(())
//! ```

pub mod atmosphere;
pub mod earth_rate;
pub mod frame;
pub mod gravity;
pub mod magnetic;
pub mod mount;
pub mod nearest;
pub mod so3;
pub mod symmetric;
pub mod wgs84;

pub use earth_rate::{EARTH_RATE_RADPS, earth_rate_ned};
pub use frame::{Body, BodyToNed, Camera, CameraToBody, Ned};
pub use gravity::{NOMINAL_GRAVITY_MPS2, STANDARD_GRAVITY_MPS2, normal_gravity};
pub use magnetic::{MagneticError, magnetic_field};
pub use mount::CameraMount;
pub use nearest::{kabsch_rotation, polar_rotation};
pub use so3::Euler;
pub use wgs84::{Geodetic, LocalNed};
