//! The Kalman filters that fly: the error-state filter that is published, and the bank that finds a heading from motion where nothing
//! else tells it.
//!
//! They are locally convergent and know how wrong they are; the observers in [`crate::observer`] are globally convergent and do not. So the
//! observers start the error-state filter and watch it.
//!
//! ```
//! use holdover::filter::error_state::{Lag, StartSigma};
//! use holdover::filter::{AirModel, Eskf, EskfSettings, EskfState};
//! use nalgebra::{Matrix3, Matrix4, Vector3};
//!
//! let settings = EskfSettings {
//!     gyro_noise: 1e-3,
//!     accel_noise: 0.02,
//!     gyro_rate_noise: 0.0,
//!     accel_load_noise: 0.0,
//!     gyro_bias_walk: 1e-5,
//!     accel_bias_walk: 1e-4,
//!     gyro_scale_sigma: 0.0,
//!     magnetic_bias_walk: 0.0,
//!     magnetic_bias_sigma: 0.0,
//!     flow_bias_walk: 0.0,
//!     flow_scale_walk: 0.0,
//!     air: AirModel::default(),
//!     gate_sigma: 5.0,
//! };
//! let zero = Vector3::zeros();
//! let sigma = StartSigma {
//!     attitude_body: Vector3::repeat(0.01),
//!     position_ned: Vector3::repeat(5.0),
//!     velocity_ned: Vector3::repeat(0.5),
//!     gyro_bias: Vector3::repeat(1e-3),
//!     accel_bias: Vector3::repeat(0.05),
//!     flow: Matrix4::zeros(),
//! };
//! let mut filter = Eskf::new(settings, EskfState::moving(Matrix3::identity(), zero, zero, zero), &sigma);
//! // At rest, level, 3 m north of where it thinks it is; GNSS says so with 1 m of noise.
//! for k in 0..500 {
//!     filter.predict(0.01, &zero, &Vector3::new(0.0, 0.0, -9.81), &Vector3::new(0.0, 0.0, 9.81), &zero);
//!     if k % 20 == 0 {
//!         let innovation = 3.0 - filter.state().position_ned.x;
//!         assert!(filter.fuse_position(0, innovation, 1.0, &Lag::NONE).is_ok());
//!     }
//! }
//! assert!((filter.state().position_ned.x - 3.0).abs() < 0.5);
//! assert!(filter.position_covariance()[(0, 0)] < 1.0);
//! ```

pub mod error_state;
pub mod heading_bank;
mod increments;
mod jitter;

pub use error_state::{AirModel, Eskf, EskfSettings, EskfState};
pub use heading_bank::{BankVerdict, HeadingBank, HeadingBankSettings, HeadingEstimate};
pub use increments::{LAGS, Lags, NoiseAndWalk};
pub use jitter::Jitter;
