//! Nonlinear observers with global convergence: attitude, position and velocity from any start.
//!
//! [`grip`] is Grip's observer (IMU, GNSS, magnetometer), [`fusini`] Fusini's (IMU, GNSS or altitude, optical-flow velocity). Both
//! act on one [`ObserverState`], so a navigator runs the first while GNSS is good and goes on with the second, from the same
//! numbers, when it is lost. Fixes at 1-10 Hz reach an observer at the IMU's rate by way of [`predictor::Predictor`].
//!
//! Parameters are one type, state another; every step is a pure function `step(&params, &mut state, &input)` that allocates
//! nothing. What an observer is *for* here: to find the attitude when an error-state filter could not, and to watch it later.
//!
//! Sources: Grip, Fossen, Johansen, Saberi, "A nonlinear observer for integration of GNSS and IMU measurements with gyro bias
//! estimation" ("Grip"); Fusini, Fossen, Johansen, "Nonlinear observers and eXogenous Kalman filters for dead reckoning"
//! ("Fusini").
//!
//! ```
//! use holdover::geo::so3;
//! use holdover::observer::{GripInput, GripParams, MagneticPair, ObserverState, grip};
//! use nalgebra::{Matrix3, Vector3};
//!
//! // Level and at rest, but the observer starts half a turn off.
//! let field = Vector3::new(13.0, 1.0, 50.0);
//! let wrong = so3::exp(&Vector3::new(0.0, 0.0, 3.0));
//! let mut state = ObserverState::new(wrong, Vector3::zeros(), Vector3::zeros());
//! for _ in 0..3000 {
//!     let input = GripInput {
//!         dt_s: 0.01,
//!         angular_rate_body: Vector3::zeros(),
//!         specific_force_body: Vector3::new(0.0, 0.0, -9.81),
//!         gravity_ned: Vector3::new(0.0, 0.0, 9.81),
//!         earth_rate_ned: Vector3::zeros(),
//!         magnetic: Some(MagneticPair { field_body: field, field_ned: field }),
//!         position_error_ned: -state.position_ned,
//!         velocity_error_ned: -state.velocity_ned,
//!     };
//!     grip::step(&GripParams::start_up(), &mut state, &input)?;
//! }
//! let r = state.r_body_to_ned().unwrap_or_default();
//! assert!((r - Matrix3::identity()).norm() < 0.05);
//! # Ok::<(), holdover::observer::StepRefusal>(())
//! ```

pub mod attitude;
pub mod bias;
mod euler_model;
pub mod fusini;
pub mod gains;
pub mod grip;
mod history;
pub mod predictor;
pub mod state;
pub mod triad;
mod tuning;
pub mod xkf;

pub use attitude::{Discretisation, Gate, MagneticPair};
pub use fusini::{Aiding, AttitudeReference, FusiniBiases, FusiniInput, FusiniParams};
pub use gains::{DeadReckoningGains, TranslationGains};
pub use grip::{GripInput, GripParams};
pub use history::PastMotion;
pub use predictor::{FixSample, Innovation, Predictor, Scheme, Signal};
pub use state::{ObserverState, StepRefusal, StepReport};
pub use xkf::{BiasMode, EulerState, SpecificForceForm, Xkf, XkfInput, XkfSettings};
