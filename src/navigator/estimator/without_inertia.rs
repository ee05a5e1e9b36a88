//! The estimator while the IMU is silent or not believed, and what is doubted when it was wrong.

use nalgebra::Matrix2;

use crate::filter::error_state::{Correction, Doubt, JumpOdds, JumpWindow};
use crate::geo::NOMINAL_GRAVITY_MPS2;
use crate::navigator::tuning::error_state::{MOVING_GYRO_BIAS, START_ACCEL_BIAS};
use crate::navigator::tuning::parting::DOUBTED_S;
use crate::navigator::tuning::plausibility::MOST_MPS;
use crate::sample::ImuSample;
use crate::time::AutopilotTime;

use super::super::monitor::inertia_jumps::SuspectedJumps;
use super::super::sources::parting::LedAway;
use super::EstimatorStack;
use super::error_state::ErrorStateStage;
use super::hole::Settling;
use super::step::{CarryInput, Stepped};

impl EstimatorStack {
    /// Carries the error-state filter over a hole of `gap_s` that ends with `s`: a short one with what was felt before and after, a longer
    /// one with its velocity as that goes over, and then the attitude has to be found again. `None` when there is no filter.
    pub(in super::super) fn carry_over(
        &mut self,
        last: &ImuSample,
        s: &ImuSample,
        gap_s: f64,
        input: &CarryInput<'_>,
    ) -> Option<Stepped> {
        let stage = self.error_state_mut()?;
        let short = gap_s <= input.settings.imu.bridge_s;
        let stepped = if short {
            stage.bridge(last, s, gap_s, input.environment)?
        } else {
            let settling = Settling::after(stage.filter().state());
            let stepped = stage.coast(s, gap_s, input.wing)?;
            self.settling = Some(settling);
            stepped
        };
        self.doubted();
        self.follow_filter();
        Some(stepped)
    }

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

    /// Inertia has led away: by a tilt, or by an accelerometer's bias, that may still be there. Velocity and position may be off by what the filter has followed of it.
    pub(in super::super) fn doubt_inertia(&mut self, led: &LedAway) {
        // What no vehicle does is no measure of a doubt.
        let most = |velocity: f64| velocity.min(MOST_MPS);
        if let Some(stage) = self.error_state_mut() {
            let acceleration = most(led.velocity_mps) / led.for_s.max(DOUBTED_S);
            stage.filter_mut().doubt(&Doubt {
                tilt: acceleration / NOMINAL_GRAVITY_MPS2,
                position: led.off_m.min(MOST_MPS * led.for_s),
                velocity: most(led.off_mps),
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
        if self.coasted_s.take().is_some() {
            self.settling = self.filter_state().map(Settling::after).or(self.settling);
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

    /// A jump has happened, with these odds which: what the filter makes of it, as it moves it.
    pub(in super::super) fn believe_jumps(&mut self, odds: &JumpOdds) -> Option<Correction> {
        let correction = self.error_state_mut()?.believe_jumps(odds);
        self.suspicion.explain();
        self.doubted();
        Some(correction)
    }

    /// The receiver has lied as a window shows: what the filter makes of it, as it moves it.
    pub(in super::super) fn believe_receiver_lies(&mut self, window: usize) -> Option<Correction> {
        let correction = self.error_state_mut()?.believe_receiver_lies(window)?;
        self.doubted();
        Some(correction)
    }

    /// Jumps that the windows show, and that are only suspected.
    pub(in super::super) fn suspect_jumps(&mut self, now: AutopilotTime, jumps: &SuspectedJumps) {
        let windows = self.jump_windows();
        let shown = jumps.iter().flatten().filter_map(|jump| {
            let [by, _] = windows.get(jump.window)?.moves(jump.jump)?;
            Some(by * by.transpose() * jump.odds)
        });
        self.suspicion.show(now, shown.sum());
    }

    /// What the window that was the oldest had shown stays suspected.
    pub(in super::super) fn keep_suspicion(&mut self, shown_by: impl Fn(&JumpWindow) -> SuspectedJumps) {
        let Some(gone) = self.error_state_mut().and_then(ErrorStateStage::take_gone_jumps) else { return };
        for jump in shown_by(&gone).iter().flatten() {
            self.suspicion.keep(&gone, jump.jump, jump.odds);
        }
    }

    /// GNSS has corrected whatever it was.
    pub(in super::super) fn forget_suspicion(&mut self) {
        self.suspicion.forget();
    }

    /// What jumps that are suspected may have done to the horizontal position, NE, m².
    pub(in super::super) fn suspected(&self) -> Matrix2<f64> {
        self.suspicion.position()
    }
}
