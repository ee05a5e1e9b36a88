//! Dead reckoning: what carries the velocity, for how long nothing has, and the error budget of the observers.

use nalgebra::{Matrix2, Matrix2x4, Matrix3, Matrix4, Vector2};

use crate::time::AutopilotTime;

use super::super::settings::HoldoverSettings;
use super::super::solution::{Mode, VelocitySource};
use super::budget::ErrorBudget;
use crate::navigator::tuning::outage::TOLD_AFTER_S;

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(in super::super) struct Outage {
    source: VelocitySource,
    budget: Option<ErrorBudget>,
    coasting_since: Option<AutopilotTime>,
    /// What carries, and since when.
    carried: Option<(VelocitySource, AutopilotTime)>,
    /// Which of them was told last.
    told: Option<VelocitySource>,
}

/// A flow sample that carried, for the budget.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct CarriedBy {
    /// Since the last, s.
    pub(in super::super) interval_s: f64,
    pub(in super::super) r_body_to_ned: Matrix3<f64>,
    /// ∂v_xy/∂[b_x, b_y, s, μ] in body axes.
    pub(in super::super) jacobian: Matrix2x4<f64>,
    /// m/s.
    pub(in super::super) v_ne: Vector2<f64>,
    /// Of the white noise, m²/s²·s.
    pub(in super::super) noise_density: f64,
    /// The distance came from a rangefinder.
    pub(in super::super) ranged: bool,
}

impl Outage {
    pub(in super::super) fn new() -> Self {
        Self { source: VelocitySource::Gnss, budget: None, coasting_since: None, carried: None, told: None }
    }

    /// What carries the velocity, but for landmarks.
    pub(in super::super) fn source(&self) -> VelocitySource {
        self.source
    }

    pub(in super::super) fn budget(&self) -> Option<&ErrorBudget> {
        self.budget.as_ref()
    }

    /// A budget begins with this covariance of the position, NE, m², and of the flow's calibration.
    pub(in super::super) fn begin_budget(
        &mut self,
        settings: &HoldoverSettings,
        start: Matrix2<f64>,
        calibration: &Matrix4<f64>,
    ) {
        self.budget = Some(ErrorBudget::new(settings.budget, start, *calibration));
    }

    /// The position is known by something else.
    pub(in super::super) fn end_budget(&mut self) {
        self.budget = None;
    }

    /// An outage begins: nothing carries yet.
    pub(in super::super) fn begin(&mut self) {
        self.source = VelocitySource::Inertial;
    }

    /// The mode has changed.
    pub(in super::super) fn mode_changed(&mut self, to: Mode) {
        self.coasting_since = None;
        if !matches!(to, Mode::Holdover | Mode::Lost) {
            self.carried = None;
            self.told = None;
            self.source = VelocitySource::Gnss;
        }
    }

    /// Goes on for `dt` s; `shown` is what carries with landmarks counted. Returns what carries now if that is to be told.
    pub(in super::super) fn go_on(
        &mut self,
        now: AutopilotTime,
        dt: f64,
        source: VelocitySource,
        shown: VelocitySource,
    ) -> Option<VelocitySource> {
        self.source = source;
        let tell = self.news(now, shown);
        if shown != VelocitySource::Inertial {
            self.coasting_since = None;
        } else if let Some(budget) = &mut self.budget {
            budget.coasted(dt);
            self.coasting_since.get_or_insert(now);
        }
        tell
    }

    /// What carries is told once it has done so for a while: flow comes and goes with the ground.
    fn news(&mut self, now: AutopilotTime, shown: VelocitySource) -> Option<VelocitySource> {
        let (_, since) =
            *self.carried.insert(self.carried.filter(|(of, _)| *of == shown).unwrap_or((shown, now)));
        if now.seconds_since(since) > TOLD_AFTER_S && self.told != Some(shown) {
            self.told = Some(shown);
            return Some(shown);
        }
        None
    }

    /// For how long nothing has carried, s.
    pub(in super::super) fn coasted_s(&self, now: AutopilotTime) -> f64 {
        self.coasting_since.map_or(0.0, |t| now.seconds_since(t))
    }

    /// A flow sample carried.
    pub(in super::super) fn carried_by_flow(&mut self, c: &CarriedBy) {
        if let Some(budget) = &mut self.budget {
            budget.carried(c.interval_s, &c.r_body_to_ned, &c.jacobian, &c.v_ne, c.noise_density, c.ranged);
        }
    }
}
