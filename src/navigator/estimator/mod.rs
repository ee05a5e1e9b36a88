//! What estimates: an observer, and over it the stage that the configuration asks for. Decided once, here.
//!
//! The observer (Grip's or Fusini's, [`observer`]) always runs. `nlo` and `nlo_printed` publish it as it is; `shipped`, `ekf15` and
//! `inertial` publish the error-state filter ([`error_state`]), which the observer starts and watches; `xkf` publishes the exogenous Kalman
//! filter over it ([`exogenous`]). Where nothing tells a heading, [`heading`] finds it from motion.
//! SourceSet give [`Observation`]s; nobody else changes the estimate.

mod air;
mod error_state;
mod exogenous;
mod heading;
mod hole;
mod lookback;
mod observer;
mod proven;
mod step;
mod suspected;
mod without_inertia;

use nalgebra::{Matrix3, Matrix4, Vector2, Vector3, Vector4};

use crate::filter::error_state::{EskfMemory, EskfState};
use crate::filter::{HeadingEstimate, Jitter};
use crate::observer::{Innovation, ObserverState};
use crate::sample::ImuSample;
use crate::time::AutopilotTime;

use super::context::SourceFacts;
use super::environment::LocalEnvironment;
use super::observation::{Fused, Observation};
use super::reset::Reset;
use super::settings::{Estimator as Kind, NavigatorSettings};
use super::shadow::{Growth, Shadows};
use super::solution::Mode;
use super::timeline::Timeline;

use crate::navigator::tuning::estimator::{AIDED_SPEED_SIGMA, UNKNOWN_SPEED_SIGMA};
use crate::navigator::tuning::observer::WAIT_FOR_MAGNETOMETER_S;
pub(super) use air::{change_wind, expected_airspeed};
use error_state::StartSigmas;
pub(super) use error_state::{ErrorStateStage, FilterPast, StartPoint};
use exogenous::ExogenousStage;
use heading::HeadingSearch;
use hole::Settling;
pub(super) use hole::climb_beyond;
use observer::ObserverStage;
pub(super) use step::{CarryInput, SeekInput, StepInput, StepOutcome, Stepped, has_flow, has_magnetometer};
use step::{Progress, is_blind};
use suspected::Suspicion;

/// The stage over the observer.
#[derive(Clone, Debug)]
enum Stage {
    /// None: the observer is published.
    Observer,
    /// The error-state filter, once it runs.
    ErrorState(Option<Box<ErrorStateStage>>),
    /// The exogenous Kalman filter, while it runs.
    Exogenous(Option<Box<ExogenousStage>>),
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(super) struct EstimatorStack {
    observer: ObserverStage,
    stage: Stage,
    heading: HeadingSearch,
    /// How much the IMU shakes, and how noisy the accelerometers are beside GNSS, m/s²/√Hz.
    jitter: Jitter,
    accel_density: f64,
    /// After a long hole, until the attitude is found again.
    settling: Option<Settling>,
    /// Without inertia, for this long, s.
    coasted_s: Option<f64>,
    /// Dead reckonings that prove what is claimed.
    shadows: Shadows,
    /// What the covariance has grown by in this outage.
    growth: Growth,
    /// What jumps that are suspected may have done.
    suspicion: Suspicion,
}

impl EstimatorStack {
    pub(super) fn new(settings: &NavigatorSettings) -> Self {
        let stage = match settings.estimator {
            Kind::Shipped | Kind::Ekf15 | Kind::Inertial => Stage::ErrorState(None),
            Kind::Xkf => Stage::Exogenous(None),
            Kind::Nlo | Kind::NloPrinted => Stage::Observer,
        };
        Self {
            observer: ObserverStage::new(settings),
            stage,
            heading: HeadingSearch::default(),
            jitter: Jitter::default(),
            accel_density: 0.0,
            settling: None,
            coasted_s: None,
            shadows: Shadows::new(),
            growth: Growth::default(),
            suspicion: Suspicion::default(),
        }
    }

    pub(super) fn observer(&self) -> &ObserverStage {
        &self.observer
    }

    pub(super) fn observer_mut(&mut self) -> &mut ObserverStage {
        &mut self.observer
    }

    fn error_state(&self) -> Option<&ErrorStateStage> {
        if let Stage::ErrorState(stage) = &self.stage { stage.as_deref() } else { None }
    }

    fn error_state_mut(&mut self) -> Option<&mut ErrorStateStage> {
        if let Stage::ErrorState(stage) = &mut self.stage { stage.as_deref_mut() } else { None }
    }

    fn exogenous(&self) -> Option<&ExogenousStage> {
        if let Stage::Exogenous(stage) = &self.stage { stage.as_deref() } else { None }
    }

    /// The state of the error-state filter, if it runs.
    pub(super) fn filter_state(&self) -> Option<&EskfState> {
        self.error_state().map(|s| s.filter().state())
    }

    /// What the error-state filter holds the flow's [b_x, b_y, s, μ] to be, and its covariance.
    pub(super) fn flow_errors(&self) -> Option<(Vector4<f64>, Matrix4<f64>)> {
        self.error_state().map(|s| (s.filter().state().flow, s.filter().flow_covariance()))
    }

    /// The distance that flow is scaled by is measured otherwise from now on: its scale error, and the standard deviation of that.
    pub(super) fn set_flow_scale(&mut self, scale: f64, sigma: f64) {
        if let Some(stage) = self.error_state_mut() {
            stage.filter_mut().set_flow_scale(scale, sigma);
        }
    }

    /// How far a specific force is from what the drag should make it, body x and y, m/s², and the variance of that by what the filter does not know.
    pub(super) fn drag_innovation(
        &self,
        force_xy: &Vector2<f64>,
        air_body: &Vector3<f64>,
    ) -> Option<(Vector2<f64>, f64)> {
        let filter = self.error_state()?.filter();
        Some((filter.drag_innovation(force_xy, air_body), filter.drag_variance(air_body)))
    }

    /// Whether a filter is published, of whichever kind.
    pub(super) fn is_filtered(&self) -> bool {
        match &self.stage {
            Stage::Observer => false,
            Stage::ErrorState(stage) => stage.is_some(),
            Stage::Exogenous(stage) => stage.is_some(),
        }
    }

    /// Position and velocity, NED, m and m/s.
    pub(super) fn estimate(&self) -> Option<(Vector3<f64>, Vector3<f64>)> {
        if let Some(stage) = self.error_state() {
            let state = stage.filter().state();
            return Some((state.position_ned, state.velocity_ned));
        }
        if let Some(stage) = self.exogenous() {
            let state = stage.filter().state();
            return Some((state.position_ned, state.velocity_ned));
        }
        self.observer.state.as_ref().map(|s| (s.position_ned, s.velocity_ned))
    }

    /// Whether the heading came from motion and the observer has still nothing to find it by: then it only follows.
    pub(super) fn is_led(&self, facts: &SourceFacts, now: AutopilotTime) -> bool {
        self.heading.by_motion() && is_blind(facts, now)
    }

    /// The observer's state is not finite any more: there is none.
    pub(super) fn lose_attitude(&mut self) {
        self.observer.state = None;
    }

    /// A hole of `gap_s` between two samples that is too short to interrupt anything leaves doubt.
    pub(super) fn doubt(&mut self, gap_s: f64) {
        if let Some(stage) = self.error_state_mut() {
            stage.doubt(gap_s);
        }
    }

    /// The autopilot calibrates its gyros when it boots. False where no filter knows an attitude that goes on.
    pub(super) fn doubt_gyros(&mut self) -> bool {
        let Some(stage) = self.error_state_mut() else { return false };
        stage.doubt_gyros();
        true
    }

    /// One IMU sample, over the interval before it: observer, then stage. `None` when the observer's state is not finite any more.
    pub(super) fn step(
        &mut self,
        s: &ImuSample,
        dt: f64,
        input: &StepInput<'_>,
        facts: &SourceFacts,
        r_body_to_ned: &Matrix3<f64>,
    ) -> Option<StepOutcome> {
        let (rate, force) = (s.angular_rate.raw(), s.specific_force.raw());
        self.jitter.add(dt, &rate, &force, input.settings.imu.instantaneous);
        if let Stage::ErrorState(Some(stage)) = &mut self.stage {
            stage.feel_vibration(self.jitter.gyro_density(), self.accel_density);
        }
        let report = self.observer.step(s, dt, input)?;
        let observed = *self.observer.state()?;
        let mut fused = Fused::nothing();
        let progress = Progress {
            observed: &observed,
            calm: self.observer.alignment.calm(),
            led: self.is_led(facts, s.time),
            injected_ned: report.acceleration_ned,
            flow_bias_time_constant_s: self.observer.fusini().flow_bias_time_constant_s,
        };
        let (stepped, restarted) = match &mut self.stage {
            Stage::Observer => (None, None),
            Stage::ErrorState(stage) => error_state::step(stage, s, dt, input, &progress, &mut fused),
            Stage::Exogenous(stage) => exogenous::step(stage, s, dt, input, &progress, &mut fused),
        };
        if let Stage::ErrorState(Some(stage)) = &self.stage {
            let speed_mps = stage.filter().state().velocity_ned.norm();
            self.shadows.step(s, dt, input, facts, speed_mps);
        }
        let settled = self.settle(s, dt, input);
        let stepped = settled.or(stepped).unwrap_or_else(|| {
            let r = observed.r_body_to_ned().unwrap_or(*r_body_to_ned);
            Stepped {
                r_body_to_ned: r,
                angular_rate_body: s.angular_rate.raw() - observed.gyro_bias,
                acceleration_ned: r * s.specific_force.raw() + input.environment.gravity_ned,
                injected_ned: report.acceleration_ned,
            }
        });
        Some(StepOutcome { stepped, report, fused, restarted, settled: settled.is_some() })
    }

    /// Takes an observation.
    pub(super) fn fuse(
        &mut self,
        now: AutopilotTime,
        observation: &Observation,
        timeline: &Timeline,
        environment: &LocalEnvironment,
    ) -> Fused {
        let mut fused = Fused::nothing();
        let turned = !matches!(observation, Observation::Fix { .. });
        if self.is_settling() || self.coasted_s.is_some() && turned {
            // A velocity would be turned by an attitude that is not known.
            return fused;
        }
        match &mut self.stage {
            Stage::ErrorState(Some(stage)) => {
                self.shadows.observe(now, observation, stage, timeline, environment);
                stage.fuse(now, observation, &FilterPast::of(timeline), environment, &mut fused);
                if matches!(observation, Observation::Fix { .. }) {
                    self.shadows.restart(now, stage);
                }
            }
            Stage::Exogenous(Some(stage)) => stage.fuse(observation, timeline, &mut fused),
            Stage::Observer | Stage::ErrorState(None) | Stage::Exogenous(None) => {}
        }
        fused
    }

    /// Whether fixes that GNSS is trusted for have been gated out for so long that the stage must be wrong; `fused` is what became of one.
    pub(super) fn is_locked_out(&mut self, now: AutopilotTime, fused: &Fused) -> bool {
        match &mut self.stage {
            Stage::ErrorState(Some(stage)) => stage.watch.locked_out(now, fused),
            Stage::Exogenous(Some(stage)) => stage.watch.locked_out(now, fused),
            Stage::Observer | Stage::ErrorState(None) | Stage::Exogenous(None) => false,
        }
    }

    /// Starts the stage from the observer, if it is one that starts with an attitude that was found.
    pub(super) fn start_filter(&mut self, now: AutopilotTime, from: &StartPoint<'_>) {
        self.start_filter_as(now, from, &StartSigmas::OBSERVED);
    }

    fn start_filter_as(&mut self, now: AutopilotTime, from: &StartPoint<'_>, known: &StartSigmas) {
        self.shadows.abort();
        if let (Stage::ErrorState(stage), Some(observed)) = (&mut self.stage, &self.observer.state)
            && let Some(started) = ErrorStateStage::start(now, observed, from, known)
        {
            *stage = Some(Box::new(started));
        }
    }

    /// Starts whatever stage there is anew from the observer, at the measurement signal: fixes say that it is wrong.
    pub(super) fn restart(&mut self, now: AutopilotTime, from: &StartPoint<'_>) {
        self.shadows.abort();
        self.observer.take_signal_over();
        self.start_filter(now, from);
        let time_constant = self.observer.fusini().flow_bias_time_constant_s;
        if let Stage::Exogenous(stage) = &mut self.stage {
            let observed = self.observer.state.as_ref();
            *stage = observed.and_then(|o| ExogenousStage::start(now, o, from, time_constant)).map(Box::new);
        }
    }

    /// The position is somewhere else by `by`, NED, m: no measurement, a decision.
    pub(super) fn relocate(&mut self, by: &Vector3<f64>) {
        self.shadows.abort();
        match &mut self.stage {
            Stage::ErrorState(Some(stage)) => stage.filter_mut().shift_origin(&-by),
            Stage::Exogenous(Some(stage)) => stage.filter_mut().shift_position(by),
            Stage::Observer | Stage::ErrorState(None) | Stage::Exogenous(None) => {}
        }
        if let Some(state) = &mut self.observer.state {
            state.position_ned += by;
        }
    }

    /// North was elsewhere: everything is turned about the vertical, rad.
    pub(super) fn turn(&mut self, now: AutopilotTime, angle: f64) {
        self.shadows.abort();
        if let Some(stage) = self.error_state_mut() {
            stage.filter_mut().turn(angle);
        }
        self.observer.turn(angle);
        if let Some((position_ned, velocity_ned)) = self.estimate() {
            self.observer.predictor.reset(now, &position_ned, &velocity_ned);
        }
    }

    /// The vehicle is at `position_ned` with `velocity_ned`, m and m/s, at the start where no fix says so.
    pub(super) fn stand_at(
        &mut self,
        now: AutopilotTime,
        position_ned: &Vector3<f64>,
        velocity_ned: &Vector3<f64>,
    ) {
        self.observer.predictor.reset(now, position_ned, velocity_ned);
    }

    /// What was measured since `then` is taken back; how far that moves the position, NED, m. See [`ErrorStateStage::go_back`].
    pub(super) fn go_back(
        &mut self,
        now: AutopilotTime,
        then: AutopilotTime,
        environment: &LocalEnvironment,
    ) -> Option<Vector3<f64>> {
        self.shadows.abort();
        let (moved, _) = self.error_state_mut()?.go_back(then, environment)?;
        let (position_ned, velocity_ned) = self.estimate()?;
        self.observer.predictor.reset(now, &position_ned, &velocity_ned);
        Some(moved)
    }

    /// The horizontal position is known anew, with this standard deviation, by what the error-state filter has no model for. False when
    /// that does not run.
    pub(super) fn reset_position(&mut self, by_ne: &Vector2<f64>, sigma_m: f64) -> bool {
        let Some(stage) = self.error_state_mut() else { return false };
        let position = stage.filter().state().position_ned.xy() + by_ne;
        stage.filter_mut().reset_position(&position, sigma_m);
        true
    }

    /// Whether the error-state filter runs.
    pub(super) fn has_error_state(&self) -> bool {
        self.error_state().is_some()
    }

    /// GNSS is back: the estimate moves by `shift_ne` to `position_ne` and by `velocity_error` to the fix at once. `sigma`: position, m, and
    /// velocity, m/s, of the fix.
    pub(super) fn rejoin(
        &mut self,
        innovation: &Innovation,
        position_ne: &Vector2<f64>,
        velocity_error: Option<&Vector2<f64>>,
        sigma: [f64; 2],
    ) {
        let e_v = velocity_error.copied().unwrap_or_default();
        let speed_sigma =
            if velocity_error.is_some() { sigma[1].max(AIDED_SPEED_SIGMA) } else { UNKNOWN_SPEED_SIGMA };
        self.observer.predictor.apply(innovation);
        match &mut self.stage {
            Stage::ErrorState(Some(stage)) => {
                let velocity = stage.filter().state().velocity_ned.xy() + e_v;
                stage.filter_mut().reset_motion(position_ne, &velocity, sigma[0], speed_sigma);
            }
            Stage::Exogenous(Some(stage)) => {
                let velocity = stage.filter().state().velocity_ned.xy() + e_v;
                stage.filter_mut().reset_motion(position_ne, &velocity, sigma[0], speed_sigma);
            }
            Stage::Observer | Stage::ErrorState(None) | Stage::Exogenous(None) => {}
        }
        if let (Some(state), Some(w)) = (&mut self.observer.state, self.observer.predictor.latest()) {
            state.position_ned = Vector3::new(w.position_ned.x, w.position_ned.y, state.position_ned.z);
            state.velocity_ned += Vector3::new(e_v.x, e_v.y, 0.0);
        }
    }

    /// A blind observer follows the filter: left alone it would drift, and start the filter from there one day.
    pub(super) fn lead_observer(&mut self, facts: &SourceFacts, now: AutopilotTime) {
        if self.is_led(facts, now)
            && let Some((r, bias)) = self.filter_state().map(|s| (s.r_body_to_ned, s.gyro_bias))
        {
            self.observer.led_by(&r, &bias);
        }
    }

    /// An IMU sample for the search for a heading, which goes on while the vehicle aligns without a magnetometer. True when it begins.
    pub(super) fn seek_heading(&mut self, s: &ImuSample, dt: f64, mode: Mode, input: &SeekInput<'_>) -> bool {
        let magnetic =
            input.facts.magnetic.is_some_and(|(t, _)| s.time.seconds_since(t) < WAIT_FOR_MAGNETOMETER_S);
        let waited = self.observer.alignment.seconds_since_start(s.time) >= WAIT_FOR_MAGNETOMETER_S;
        // Without a filter nobody carries the heading on: the observers have no direction to hold it by.
        let carried = matches!(self.stage, Stage::ErrorState(_));
        if mode != Mode::Aligning || !carried || !waited || magnetic {
            self.heading.stop();
            return false;
        }
        self.heading.seek(s, dt, input.environment.gravity_ned.z, input.settings.imu.instantaneous)
    }

    /// A velocity of GNSS for the search; a blind observer is levelled by it.
    pub(super) fn weigh_headings(
        &mut self,
        now: AutopilotTime,
        measured: AutopilotTime,
        v: &Vector2<f64>,
        sigma: f64,
        facts: &SourceFacts,
    ) {
        let Some(e) = self.heading.weigh(measured, v, sigma, facts.gnss_latency_sigma_s) else { return };
        if is_blind(facts, now)
            && let Some(r) = self
                .observer
                .state
                .as_ref()
                .and_then(ObserverState::r_body_to_ned)
                .and_then(|r| heading::tilted_as(&r, &e.r_body_to_ned))
        {
            self.observer.led_by(&r, &e.gyro_bias);
        }
    }

    /// The heading, once motion has shown it.
    pub(super) fn heading_found(&self) -> Option<HeadingEstimate> {
        self.heading.found()
    }

    /// The attitude was found by the observer: the stage starts.
    pub(super) fn align(&mut self, now: AutopilotTime, from: &StartPoint<'_>) {
        self.observer.take_signal_over();
        self.start_filter(now, from);
    }

    /// The attitude was found without GNSS, at rest or in motion: the stage starts.
    pub(super) fn align_without_gnss(&mut self, now: AutopilotTime, from: &StartPoint<'_>, at_rest: bool) {
        self.observer.take_signal_over();
        let known = if at_rest { StartSigmas::OBSERVED } else { StartSigmas::IN_MOTION };
        self.start_filter_as(now, from, &known);
    }

    /// The heading was found from motion: observer and stage start there.
    pub(super) fn align_by_motion(&mut self, now: AutopilotTime, e: &HeadingEstimate, from: &StartPoint<'_>) {
        self.observer.take_signal_over();
        self.observer.led_by(&e.r_body_to_ned, &e.gyro_bias);
        if let Some(state) = &mut self.observer.state {
            state.velocity_ned.x = e.velocity_ne.x;
            state.velocity_ned.y = e.velocity_ne.y;
        }
        self.start_filter_as(now, from, &heading::start_sigmas(e));
        self.heading.fly_on();
    }

    /// The observer has no such memory: it goes on from where the filter is.
    fn follow_filter(&mut self) {
        let Some(filter) = self.filter_state().copied() else { return };
        let state = self.observer.state.get_or_insert_with(|| {
            ObserverState::new(filter.r_body_to_ned, Vector3::zeros(), Vector3::zeros())
        });
        state.r_hat = filter.r_body_to_ned;
        state.position_ned = filter.position_ned;
        state.velocity_ned = filter.velocity_ned;
        state.gyro_bias = filter.gyro_bias;
        state.xi_ned = Vector3::zeros();
    }

    /// What the error-state filter knows, if it runs and has an attitude.
    pub(super) fn memory(&self) -> Option<EskfMemory> {
        self.error_state().filter(|_| !self.is_settling()).map(|s| EskfMemory::of(s.filter()))
    }

    /// The error-state filter knows what it knew, and the observer follows it. False, and nothing has changed, where there is none, or that
    /// is nothing that a filter knows.
    pub(super) fn remember(
        &mut self,
        now: AutopilotTime,
        memory: &EskfMemory,
        settings: &NavigatorSettings,
    ) -> bool {
        let Stage::ErrorState(stage) = &mut self.stage else { return false };
        let Some(remembering) = ErrorStateStage::remembering(now, memory, settings) else { return false };
        *stage = Some(Box::new(remembering));
        self.follow_filter();
        self.observer.alignment.found(now);
        true
    }

    /// Whether the heading that is flown on came from motion.
    pub(super) fn by_motion(&self) -> bool {
        self.heading.by_motion()
    }

    /// It did, before.
    pub(super) fn lead_by_motion(&mut self) {
        self.heading.fly_on();
    }

    /// Whether the attitude has to be found again.
    pub(super) fn is_settling(&self) -> bool {
        self.settling.is_some()
    }

    /// How well the filter knows the horizontal velocity, 1 sigma of its length, m/s.
    pub(super) fn speed_sigma(&self) -> Option<f64> {
        let v = self.error_state()?.filter().velocity_covariance();
        Some((v[(0, 0)] + v[(1, 1)]).max(0.0).sqrt())
    }

    /// How well the filter knows the heading, 1 sigma, rad.
    pub(super) fn yaw_sigma(&self) -> Option<f64> {
        self.error_state().map(ErrorStateStage::yaw_sigma)
    }

    /// One IMU sample more to find the attitude by; what is published when it was found with it.
    fn settle(&mut self, s: &ImuSample, dt: f64, input: &StepInput<'_>) -> Option<Stepped> {
        let (Some(settling), Stage::ErrorState(Some(stage))) = (&mut self.settling, &mut self.stage) else {
            self.settling = None;
            return None;
        };
        let due = input.magnetic.is_some() && input.magnetic_pair(s.time).is_none();
        let found = settling.feel(s, dt, stage.filter().state(), input.wing, due)?;
        let pair = input.magnetic_pair(s.time);
        let field = pair.as_ref().map(|pair| (&pair.field_body, &pair.field_ned));
        stage.level(&found, field, input.settings.magnetometer.sigma_t);
        let stepped = stage.stepped(s, Vector3::zeros());
        self.settling = None;
        self.follow_filter();
        Some(stepped)
    }

    pub(super) fn reset(&mut self, reset: &Reset, environment: Option<&LocalEnvironment>) {
        self.shadows.abort();
        match reset {
            Reset::OriginMoved(moved) => {
                self.relocate(&-moved);
                if let Some(environment) = environment {
                    self.observer.settle(environment);
                }
            }
            Reset::Bridged => self.observer.predictor.clear(),
            Reset::Relocated => {}
            Reset::StreamBroken | Reset::Reboot | Reset::ClockSetBack => {
                self.observer.predictor.clear();
                match &mut self.stage {
                    Stage::Observer => {}
                    Stage::ErrorState(stage) => *stage = None,
                    Stage::Exogenous(stage) => *stage = None,
                }
                self.heading = HeadingSearch::default();
                self.settling = None;
                self.coasted_s = None;
                if reset.reboots() {
                    self.observer.state = None;
                }
            }
        }
    }
}
