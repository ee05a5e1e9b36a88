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

pub mod attitude;
pub mod bias;
pub mod euler_model;
pub mod fusini;
pub mod gains;
pub mod grip;
pub mod history;
pub mod predictor;
pub mod state;
pub mod triad;
mod tuning;
pub mod xkf;

pub use attitude::{Discretisation, Gate, MagneticPair};
pub use fusini::{Aiding, AttitudeReference, FusiniBiases, FusiniInput, FusiniParams};
pub use gains::{DeadReckoningGains, TranslationGains};
pub use grip::{GripInput, GripParams};
pub use predictor::{FixSample, Innovation, Predictor, Scheme, Signal};
pub use state::{ObserverState, StepRefusal, StepReport};
pub use xkf::{BiasMode, EulerState, SpecificForceForm, Xkf, XkfInput, XkfSettings};
