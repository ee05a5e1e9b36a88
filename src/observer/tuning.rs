//! The observers' tuning constants, with their reasons. Their gains, printed and tuned, are presets of their parameters
//! ([`super::gains`], [`super::GripParams`], [`super::FusiniParams`]).

use crate::time::Span;

/// Euler angles say nothing where the cosine of the pitch is below this (1.1° from the vertical): T(Θ) has 1/cos θ in it, which
/// multiplies the gyros' noise by 50 there.
pub(super) const LEAST_COS_PITCH: f64 = 0.02;
/// How far a fix may lie ahead of the last IMU sample: clocks of receiver and IMU jitter by some samples.
pub(super) const MAX_AHEAD: Span = Span::from_millis(50);
/// Longer gaps in the IMU's stream end the prediction: at 10 m/s² unseen it is off by 5 m then.
pub(super) const MAX_STEP: Span = Span::from_millis(1000);
