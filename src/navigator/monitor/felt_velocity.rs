//! A fix beside what inertia feels, and what is held against its receiver.

use nalgebra::Vector2;

use crate::time::AutopilotTime;

/// What is compared at a fix, NE, m/s.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct FeltVelocity {
    pub(in super::super) time: AutopilotTime,
    pub(in super::super) velocity: Vector2<f64>,
    pub(in super::super) impulse: Vector2<f64>,
    /// Changes when the impulse begins anew.
    pub(in super::super) epoch: u32,
    /// GNSS is navigated on, and inertia is sound.
    pub(in super::super) judged: bool,
    /// On the ground all is calm: that shows nothing of what is usual in the air.
    pub(in super::super) flies: bool,
    /// Against the estimate, which other sources carry, and how well that is known, m/s.
    pub(in super::super) error: Option<Vector2<f64>>,
    pub(in super::super) sigma: f64,
    /// How well the position is known, m, and how far the fix is from it, NE, m, where the estimate does not follow the receiver.
    pub(in super::super) position_sigma: f64,
    pub(in super::super) apart: Option<Vector2<f64>>,
}

/// A velocity that is a lie.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct VelocityLie {
    /// When it began.
    pub(in super::super) since: AutopilotTime,
    /// NE, m/s.
    pub(super) step: Vector2<f64>,
    /// What it did to the estimate is undone.
    pub(in super::super) undone: bool,
}

impl VelocityLie {
    pub(in super::super) fn new(since: AutopilotTime, step: Vector2<f64>) -> Self {
        Self { since, step, undone: false }
    }

    /// How far it has led by now, NE, m.
    pub(super) fn led(&self, now: AutopilotTime) -> Vector2<f64> {
        self.step * now.seconds_since(self.since).max(0.0)
    }
}
