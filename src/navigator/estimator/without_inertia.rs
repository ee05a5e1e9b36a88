//! The estimator while the IMU is not believed, and what is doubted when it was wrong.

use crate::filter::error_state::Doubt;
use crate::sample::ImuSample;

use super::EstimatorStack;
use super::hole::Settling;
use super::step::Stepped;

impl EstimatorStack {
    /// `dt` s without inertia: the velocity is what it was, with the doubt that vehicles leave. `None` when there is no filter; `lag_s`: for how long
    /// the inertia had been wrong before that was known, s.
    pub(in super::super) fn coast_on(&mut self, s: &ImuSample, dt: f64, lag_s: f64) -> Option<Stepped> {
        let begins = self.coasted_s.is_none();
        let from_s = self.coasted_s.unwrap_or(0.0);
        let stage = self.error_state_mut()?;
        let to_s = if begins { lag_s + dt } else { from_s + dt };
        let stepped = stage.coast_on(s, dt, [from_s, to_s])?;
        self.coasted_s = Some(to_s);
        self.settling = None;
        self.doubted();
        self.follow_filter();
        Some(stepped)
    }

    /// The inertia has been wrong for a while: what it has done to position and velocity, m and m/s, may be that much.
    pub(in super::super) fn doubt_motion(&mut self, position: f64, velocity: f64) {
        if let Some(stage) = self.error_state_mut() {
            let correlation = 0.75f64.sqrt();
            stage.filter_mut().doubt(&Doubt { position, velocity, correlation, ..Doubt::NONE });
        }
        self.doubted();
    }

    /// There is inertia again: the attitude is found anew.
    pub(in super::super) fn feel_again(&mut self) {
        if self.coasted_s.take().is_some() && self.has_error_state() {
            self.settling = Some(Settling::default());
        }
    }
}
