//! The estimator while the IMU is not believed, and what is doubted when it was wrong.

use nalgebra::Matrix2;

use crate::filter::error_state::{Correction, Doubt, JumpWindow};
use crate::geo::NOMINAL_GRAVITY_MPS2;
use crate::navigator::tuning::error_state::{MOVING_GYRO_BIAS, START_ACCEL_BIAS};
use crate::navigator::tuning::parting::DOUBTED_S;
use crate::navigator::tuning::plausibility::MOST_MPS;
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

    /// Inertia has led away for `seconds`, by `velocity` m/s: by a tilt, or by an accelerometer's bias, that may still be there.
    pub(in super::super) fn doubt_inertia(&mut self, seconds: f64, velocity: f64) {
        // What no vehicle does is no measure of a doubt.
        let velocity = velocity.min(MOST_MPS);
        if let Some(stage) = self.error_state_mut() {
            let acceleration = velocity / seconds.max(DOUBTED_S);
            stage.filter_mut().doubt(&Doubt {
                tilt: acceleration / NOMINAL_GRAVITY_MPS2,
                position: 0.5 * velocity * seconds,
                velocity,
                correlation: 0.75f64.sqrt(),
                accel_bias: acceleration,
                ..Doubt::NONE
            });
        }
        self.doubted();
    }

    /// The position may be off by `sigma_m` more than the error-state filter thinks.
    pub(in super::super) fn doubt_position(&mut self, sigma_m: f64) {
        self.shadows.abort();
        if let Some(stage) = self.error_state_mut() {
            stage.filter_mut().doubt(&Doubt { position: sigma_m, ..Doubt::NONE });
        }
    }

    /// There is inertia again: the attitude is found anew.
    pub(in super::super) fn feel_again(&mut self) {
        if self.coasted_s.take().is_some() && self.has_error_state() {
            self.settling = Some(Settling::default());
        }
    }

    /// It is tried again: what the filter took its axes to be off by while it was wrong is no measure of them.
    pub(in super::super) fn try_inertia(&mut self) {
        if let Some(stage) = self.error_state_mut() {
            stage.filter_mut().forget_imu(MOVING_GYRO_BIAS, START_ACCEL_BIAS);
        }
        self.feel_again();
    }

    /// What the filter's innovations show of jumps of the IMU's axes; none while its word is not asked for.
    pub(in super::super) fn jump_windows(&self) -> &[JumpWindow] {
        let asked = self.coasted_s.is_none() && !self.is_settling();
        self.error_state().filter(|_| asked).map_or(&[], |stage| stage.filter().jump_windows())
    }

    /// The same of a dead reckoning beside GNSS, while one goes on.
    pub(in super::super) fn jump_windows_alone(&self) -> &[JumpWindow] {
        self.shadows.jump_windows()
    }

    /// An axis has jumped: what the filter makes of it, as it moves it.
    pub(in super::super) fn believe_jump(&mut self, window: usize, jump: usize) -> Option<Correction> {
        let correction = self.error_state_mut()?.believe_jump(window, jump);
        self.doubted();
        correction
    }

    /// What a jump that is only suspected would move the horizontal position by, as a covariance, m².
    pub(in super::super) fn suspect_jump(&mut self, window: usize, jump: usize, odds: f64) {
        let windows = self.jump_windows();
        self.suspected = windows
            .get(window)
            .and_then(|w| w.moves(jump))
            .map_or(Matrix2::zeros(), |moved| moved * moved.transpose() * odds);
    }

    /// That, m².
    pub(in super::super) fn suspected(&self) -> &Matrix2<f64> {
        &self.suspected
    }
}
