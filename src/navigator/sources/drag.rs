//! Rotor drag: a multirotor's accelerometers show its velocity through the air.
//!
//! The thrust of rotors lies along body z; what the accelerometers show along x and y is drag, nearly proportional to the velocity through
//! the air (Leishman et al. 2014, "Quadrotors and accelerometers"). With GNSS the filter learns the proportion and the wind; without GNSS and
//! flow, that bounds the velocity which inertial coasting alone would lose within a minute.
//!
//! What is wrong with that lasts: gusts, vibration that the accelerometers rectify, drag that is not proportional. An error of standard
//! deviation σ_c that lasts for τ is, for a filter that takes it for white, worth σ_c √(2τ/Δt) a sample; σ_c differs by a factor of
//! ten between vehicles, so it is measured while GNSS is there, from the mean of the innovations over some seconds.

use nalgebra::{Vector2, Vector3};

use crate::sample::{Airframe, ImuSample};
use crate::time::AutopilotTime;

use super::super::context::{Context, SourceFacts};
use super::super::estimator::EstimatorStack;
use super::super::observation::{Fused, Observation};
use super::super::reset::Reset;
use super::super::settings::Estimator;
use super::super::solution::{Mode, VelocitySource};
use crate::navigator::tuning::drag::{
    AGE_S, ASSUMED_S, KNOWN, LASTING_S, LATELY_S, LEAST_DRAG, LEAST_GUST_MPS, LEAST_LASTING_MPS2, MEAN_S,
    PERIOD_S, RECALLED_S, SPREAD_S, WIND_KEPT_S,
};

/// Settings of the rotor drag.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DragSettings {
    /// Use it.
    pub enabled: bool,
    /// Deceleration over velocity before it was seen, 1/s.
    pub coefficient: f64,
    /// White noise of the mean force of 0.1 s, m/s².
    pub sigma_mps2: f64,
    /// Standard deviation of what is wrong with the force for some time, before it was measured, m/s².
    pub lasting_mps2: f64,
}

/// What is wrong with the force for some time.
#[derive(Clone, Copy, Debug)]
struct DragError {
    /// Mean innovation of late, m/s².
    mean: Vector2<f64>,
    /// Its mean square an axis less what the filter expects of it, m²/s⁴.
    spread: f64,
    /// For how long that was measured, s.
    seconds: f64,
}

impl DragError {
    fn new(settings: &DragSettings) -> Self {
        Self { mean: Vector2::zeros(), spread: settings.lasting_mps2.powi(2), seconds: 0.0 }
    }

    /// Takes an innovation, m/s², `dt` s after the last; `expected`: its variance an axis by what the filter does not know, m²/s⁴. That is no
    /// error of the drag: a velocity, a wind or a proportion that is not found yet.
    fn learn(&mut self, innovation: &Vector2<f64>, expected: f64, dt: f64) {
        if !(innovation.sum() + expected).is_finite() {
            return;
        }
        self.mean += (innovation - self.mean) * (dt / MEAN_S).min(1.0);
        // What was assumed is worth some seconds of measurement.
        self.seconds += dt;
        let memory_s = (ASSUMED_S + self.seconds).min(SPREAD_S);
        self.spread += (0.5 * self.mean.norm_squared() - expected - self.spread) * (dt / memory_s).min(1.0);
    }

    /// What lasts, of a drag of so much, 1/s: m²/s⁴.
    fn lasting(&self, drag: f64) -> f64 {
        self.spread.max(LEAST_LASTING_MPS2.powi(2) + (LEAST_GUST_MPS * drag).powi(2))
    }

    /// What a sample of `dt` s is worth with a drag of so much, m/s²: white noise, and what lasts.
    fn sigma(&self, white: f64, dt: f64, drag: f64) -> f64 {
        (white * white + self.lasting(drag) * 2.0 * LASTING_S / dt).sqrt()
    }
}

/// The mean force and velocity through the air since the last use.
#[derive(Clone, Copy, Debug, Default)]
struct DragMean {
    seconds: f64,
    force: Vector2<f64>,
    air: Vector3<f64>,
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct DragSource {
    mean: DragMean,
    /// The force of late, m/s².
    lately: Option<Vector2<f64>>,
    error: DragError,
    used: Option<AutopilotTime>,
    wind: KeptWind,
}

/// The filter's wind of some seconds ago, NE, m/s: a flow that is wrong bends the wind as well, and a witness is not to be bent by whom it is asked about.
#[derive(Clone, Copy, Debug, Default)]
struct KeptWind {
    since: Option<AutopilotTime>,
    /// The older is at least [`WIND_KEPT_S`] old.
    older: Option<Vector2<f64>>,
    newer: Option<Vector2<f64>>,
}

impl KeptWind {
    fn note(&mut self, now: AutopilotTime, wind_ne: &Vector2<f64>) {
        if self.since.is_none_or(|t| now.seconds_since(t) > WIND_KEPT_S) {
            self.since = Some(now);
            self.older = self.newer.replace(*wind_ne);
        }
    }
}

impl DragSource {
    pub(super) fn new(settings: &DragSettings) -> Self {
        Self {
            mean: DragMean::default(),
            lately: None,
            error: DragError::new(settings),
            used: None,
            wind: KeptWind::default(),
        }
    }

    /// When it last corrected the velocity.
    pub(in super::super) fn used(&self) -> Option<AutopilotTime> {
        self.used
    }

    /// Takes an IMU sample over `dt` s; an observation every so often.
    pub(in super::super) fn observe(
        &mut self,
        s: &ImuSample,
        dt: f64,
        context: &Context<'_>,
    ) -> Option<Observation> {
        let core = context.core;
        if !core.settings.drag.enabled
            || core.coasts()
            || core.settings.estimator == Estimator::Ekf15
            || !core.vehicle.is(Airframe::Multirotor)
            || context.facts.resting
            || core.vehicle.disarmed()
        {
            self.forget();
            return None;
        }
        let state = core.estimator.filter_state()?;
        let mean = &mut self.mean;
        mean.seconds += dt;
        mean.force += s.specific_force.raw().xy() * dt;
        mean.air += state.air_velocity_body() * dt;
        if mean.seconds < PERIOD_S {
            return None;
        }
        let (force_xy, air_body, seconds) =
            (mean.force / mean.seconds, mean.air / mean.seconds, mean.seconds);
        *mean = DragMean::default();
        self.wind.note(s.time, &state.wind_ne);
        let lately = self.lately.get_or_insert(force_xy);
        *lately += (force_xy - *lately) * (seconds / LATELY_S).min(1.0);
        // A flow that carries knows the velocity better than gusts let the drag know it.
        if core.dead_reckoning() && core.outage.source() == VelocitySource::Flow {
            return None;
        }
        if core.mode == Mode::Aided
            && let Some((innovation, expected)) = core.estimator.drag_innovation(&force_xy, &air_body)
        {
            self.error.learn(&innovation, expected, seconds);
        }
        let sigma_mps2 = self.error.sigma(core.settings.drag.sigma_mps2, seconds, state.drag);
        Some(Observation::Drag { force_xy, air_body, sigma_mps2 })
    }

    /// The velocity through the air, NE, m/s, and the wind, by a mean force along body x and y, m/s²: nothing of it is by way of GNSS. `None` where the drag is not known.
    pub(in super::super) fn through_air(
        force_xy: &Vector2<f64>,
        estimator: &EstimatorStack,
    ) -> Option<(Vector2<f64>, Vector2<f64>)> {
        let (state, sigma) = estimator.filter_state().zip(estimator.drag_sigma())?;
        is_known(state.drag, sigma).then(|| {
            let air_xy = (state.accel_bias.xy() - force_xy) / state.drag;
            let air_ned = state.r_body_to_ned * Vector3::new(air_xy.x, air_xy.y, 0.0);
            (air_ned.xy(), state.wind_ne)
        })
    }

    /// What became of an observation.
    pub(in super::super) fn fused(&mut self, now: AutopilotTime, fused: &Fused, estimator: &EstimatorStack) {
        if !fused.taken() {
            return;
        }
        let drag = estimator.filter_state().map(|s| s.drag).zip(estimator.drag_sigma());
        let known = drag.is_some_and(|(drag, sigma)| is_known(drag, sigma));
        self.used = known.then_some(now);
    }

    /// Which of two velocities of late, NED, m/s, the force speaks for: by how much the square of its deviation over the variance is
    /// less with the first. `None` where the drag is not known.
    pub(in super::super) fn speaks_for(
        &self,
        context: &Context<'_>,
        first_ned: &Vector3<f64>,
        second_ned: &Vector3<f64>,
    ) -> Option<f64> {
        let estimator = &context.core.estimator;
        let (state, sigma) = estimator.filter_state().zip(estimator.drag_sigma())?;
        let force_xy = self.lately.filter(|_| is_known(state.drag, sigma))?;
        let wind_ne = self.wind.older?;
        let wind = Vector3::new(wind_ne.x, wind_ne.y, 0.0);
        let square = |v_ned: &Vector3<f64>| {
            let air_body = state.r_body_to_ned.tr_mul(&(v_ned - wind));
            let (off, _) = estimator.drag_innovation(&force_xy, &air_body)?;
            Some(
                off.norm_squared()
                    / self.error.lasting(state.drag).max(context.core.settings.drag.sigma_mps2.powi(2)),
            )
        };
        Some(square(second_ned)? - square(first_ned)?)
    }

    /// Mean square of what is wrong with the force for some time, m²/s⁴.
    pub(in super::super) fn spread(&self) -> f64 {
        self.error.spread.max(0.0)
    }

    /// The same, as it was learned before.
    pub(in super::super) fn recall(&mut self, spread: f64) {
        if (1e-9..=1e4).contains(&spread) {
            (self.error.spread, self.error.seconds) = (spread, RECALLED_S);
        }
    }

    fn forget(&mut self) {
        (self.mean, self.used, self.lately) = (DragMean::default(), None, None);
        self.wind = KeptWind::default();
    }

    pub(super) fn reset(&mut self, reset: &Reset) {
        if reset.breaks_motion() {
            self.forget();
        }
    }
}

/// Whether a drag that is known to this, 1/s, tells a velocity.
fn is_known(drag: f64, sigma: f64) -> bool {
    drag > LEAST_DRAG.max(KNOWN * sigma)
}

/// Whether the drag carries the velocity at present.
pub(in super::super) fn carries(facts: &SourceFacts, now: AutopilotTime) -> bool {
    facts.drag_used.is_some_and(|t| now.seconds_since(t) < AGE_S)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETTINGS: DragSettings =
        DragSettings { enabled: true, coefficient: 0.25, sigma_mps2: 0.3, lasting_mps2: 0.15 };

    fn learned(innovation: impl Fn(u32) -> f64, expected: f64, seconds: f64) -> DragError {
        let mut error = DragError::new(&SETTINGS);
        for k in 0..(seconds / PERIOD_S) as u32 {
            error.learn(&Vector2::repeat(innovation(k)), expected, PERIOD_S);
        }
        error
    }

    fn sigma(error: &DragError) -> f64 {
        error.sigma(SETTINGS.sigma_mps2, PERIOD_S, 0.25)
    }

    #[test]
    fn what_alternates_is_noise_and_what_lasts_makes_the_drag_worth_little() {
        let noisy = sigma(&learned(|k| if k % 2 == 0 { 0.3 } else { -0.3 }, 0.0, 300.0));
        assert!(noisy < 1.6, "{noisy}");
        let gusty = sigma(&learned(|k| if k / 200 % 2 == 0 { 0.5 } else { -0.5 }, 0.0, 300.0));
        assert!(gusty > 8.0, "{gusty}");
        assert!(sigma(&learned(|_| f64::NAN, 0.0, 300.0)).is_finite());
    }

    #[test]
    fn what_the_filter_does_not_know_yet_is_no_error_of_the_drag() {
        let searching = sigma(&learned(|_| 0.4, 0.16, 60.0));
        let known = sigma(&learned(|_| 0.4, 0.0, 60.0));
        assert!(searching < 2.0 && known > 6.0, "{searching} {known}");
    }

    #[test]
    fn a_minute_of_calm_or_of_gusts_counts_for_more_than_what_was_assumed() {
        let calm = sigma(&learned(|_| 0.03, 0.0, 60.0));
        assert!(calm < 0.6 * sigma(&DragError::new(&SETTINGS)), "{calm}");
        let mut recalled = DragSource::new(&SETTINGS);
        recalled.recall(1.0);
        assert!((recalled.spread() - 1.0).abs() < 1e-12);
        recalled.recall(f64::NAN);
        assert!((recalled.spread() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_wind_that_testifies_is_some_seconds_old() {
        let mut kept = KeptWind::default();
        for k in 0..300 {
            let t = 0.1 * f64::from(k);
            kept.note(AutopilotTime::from_micros((t * 1e6) as i64), &Vector2::new(t, 0.0));
            match kept.older {
                None => assert!(t < WIND_KEPT_S + 0.2),
                Some(wind) => assert!(
                    (WIND_KEPT_S..2.0 * WIND_KEPT_S + 0.3).contains(&(t - wind.x + 0.1)),
                    "{t} {wind}"
                ),
            }
        }
        assert!(kept.older.is_some());
    }
}
