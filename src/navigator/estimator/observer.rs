//! The first stage: the nonlinear observers, Grip's with GNSS and a magnetometer, Fusini's with GNSS and flow or in dead reckoning, and the
//! predictor that makes a measurement signal of rare and late fixes.

use std::f64::consts::FRAC_1_SQRT_2;

use nalgebra::{Matrix3, Vector3};

use crate::geo::{polar_rotation, so3};
use crate::observer::fusini::FlowBiasForm;
use crate::observer::triad::normalised_triad;
use crate::observer::{
    Aiding, AttitudeReference, FixSample, FusiniBiases, FusiniInput, FusiniParams, GripInput, GripParams,
    Innovation, MagneticPair, ObserverState, Predictor, Scheme, Signal, StepReport, fusini, grip,
};
use crate::sample::ImuSample;
use crate::time::AutopilotTime;

use super::super::environment::LocalEnvironment;
use super::super::settings::{Estimator as Kind, FlowBiasSource, NavigatorSettings, ObserverSettings};
use super::super::solution::Mode;
use super::step::StepInput;
use crate::navigator::tuning::observer::{
    INJECTION_CORRELATION_S, INJECTION_MEAN_S, LONGEST_DELAY, PRINTED_RATE_HZ, PRINTED_STEP_S, SIGNAL_HOLD,
    TELL_EVERY_S, WAIT_FOR_MAGNETOMETER_S,
};

/// Which gains are in force when.
#[derive(Clone, Debug)]
struct ObserverParams {
    grip: GripParams,
    /// While aligning: fast gains.
    grip_start: GripParams,
    fusini: FusiniParams,
    fusini_start: FusiniParams,
    scheme: Scheme,
}

impl ObserverParams {
    fn new(settings: &NavigatorSettings) -> Self {
        let printed = settings.estimator == Kind::NloPrinted;
        let (grip, grip_start, fusini) = if printed {
            (GripParams::printed(), GripParams::printed(), FusiniParams::printed())
        } else {
            (tuned_grip(&settings.observer), GripParams::start_up(), tuned_fusini(&settings.observer))
        };
        let (grip, grip_start) = if settings.observer.gnss_velocity {
            (grip, grip_start)
        } else {
            (grip.position_only(), grip_start.position_only())
        };
        let fusini = FusiniParams {
            flow_bias: match settings.observer.flow_bias {
                FlowBiasSource::AsPrinted => FlowBiasForm::AsPrinted,
                FlowBiasSource::Body | FlowBiasSource::Calibration => FlowBiasForm::Body,
            },
            flow_bias_time_constant_s: settings.observer.flow_bias_time_s,
            ..fusini
        };
        let fusini_start = if printed { fusini } else { fusini.starting() };
        let scheme = if printed { Scheme::Hold } else { Scheme::InterSample };
        Self { grip, grip_start, fusini, fusini_start, scheme }
    }
}

fn tuned_grip(settings: &ObserverSettings) -> GripParams {
    GripParams { k_p: Vector3::repeat(settings.k_p), k_i: settings.k_i, ..GripParams::km() }
}

fn tuned_fusini(settings: &ObserverSettings) -> FusiniParams {
    let mut params = FusiniParams::tuned();
    params.k_p = Vector3::repeat(settings.k_p);
    params.k_i = settings.k_i;
    params.guard = settings.guard;
    params.dead_reckoning.vv = settings.holdover_k_vv;
    params.dead_reckoning.xv = settings.holdover_k_xv;
    // The calibration takes the flow's bias out before the observer sees it.
    params.predict_flow_z = false;
    params
}

/// How far the search for the attitude has come.
///
/// A single injection J = (R − R̂)·A_b A_bᵀ says how far R̂ is from the attitude that one magnetometer sample and one specific force show, with
/// all of their noise. What is decided on is its mean J̄ over some seconds, turned to NED by R̂ᵀ, and what the mean may be wrong by: the
/// attitude is found when ‖J̄‖ + 2 s/√n is small for long enough, with s² the mean square of J about J̄ and n the number of samples that are
/// independent.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct AttitudeSearch {
    /// When the first sample came, and when the search began that is going on.
    began: Option<AutopilotTime>,
    started: Option<AutopilotTime>,
    /// When the attitude got its first guess.
    attitude_started: Option<AutopilotTime>,
    /// Mean of the injections, the mean square of what is left of them, and over how long they were taken, s.
    mean: Matrix3<f64>,
    spread: f64,
    heard_s: f64,
    /// Since when the mean has been small.
    calm_since: Option<AutopilotTime>,
    /// When it was last told what is waited for.
    told: Option<AutopilotTime>,
}

impl AttitudeSearch {
    /// The search begins, or begins anew: what came before there was a place could not be used.
    pub(in super::super) fn start(&mut self, time: AutopilotTime) {
        self.began.get_or_insert(time);
        self.started = Some(time);
    }

    /// It was found before.
    pub(super) fn found(&mut self, time: AutopilotTime) {
        (self.started, self.attitude_started) = (Some(time), Some(time));
    }

    /// What was found does not hold any more.
    pub(in super::super) fn forget(&mut self) {
        self.calm_since = None;
        self.heard_s = 0.0;
    }

    /// Seconds since the first sample.
    pub(in super::super) fn seconds_since_first(&self, now: AutopilotTime) -> f64 {
        self.began.map_or(0.0, |t| now.seconds_since(t))
    }

    /// How far the attitude may be off, as far as the injections tell: about √2 times the angle, rad.
    fn off(&self) -> f64 {
        let independent = (self.heard_s / INJECTION_CORRELATION_S).max(1.0);
        self.mean.norm() + 2.0 * (self.spread / independent).sqrt()
    }

    /// How far the attitude is off, rad, while injections tell.
    pub(in super::super) fn off_rad(&self) -> Option<f64> {
        (self.heard_s > 0.0).then(|| self.off() * FRAC_1_SQRT_2)
    }

    /// Whether it is time to tell again what is waited for.
    pub(in super::super) fn tells(&mut self, now: AutopilotTime) -> bool {
        let since = *self.told.get_or_insert(now);
        let due = now.seconds_since(since) >= TELL_EVERY_S;
        if due {
            self.told = Some(now);
        }
        due
    }

    pub(in super::super) fn seconds_since_start(&self, now: AutopilotTime) -> f64 {
        self.started.map_or(0.0, |t| now.seconds_since(t))
    }

    /// Seconds since the attitude got its first guess.
    pub(in super::super) fn seconds_since_attitude(&self, now: AutopilotTime) -> f64 {
        self.attitude_started.map_or(0.0, |t| now.seconds_since(t))
    }

    /// Takes the attitude injection of a step over `dt` s, in NED. Without reference vectors nothing is learned; what was found still holds.
    fn injection(&mut self, now: AutopilotTime, dt: f64, ned: &Matrix3<f64>, settings: &ObserverSettings) {
        if self.heard_s == 0.0 {
            (self.mean, self.spread) = (Matrix3::zeros(), 0.0);
        }
        // The plain mean at first, a low pass later.
        self.heard_s = (self.heard_s + dt).min(INJECTION_MEAN_S);
        let gain = dt / self.heard_s.max(dt);
        let rest = ned - self.mean;
        self.mean += rest * gain;
        self.spread += (rest.norm_squared() * (1.0 - gain) - self.spread) * gain;
        if self.off() < settings.aligned_injection {
            self.calm_since.get_or_insert(now);
        } else {
            self.calm_since = None;
        }
    }

    /// Whether the injection is small at present.
    pub(super) fn calm(&self) -> bool {
        self.calm_since.is_some()
    }

    /// Whether it has been for long enough.
    pub(in super::super) fn attitude_found(&self, now: AutopilotTime, settings: &ObserverSettings) -> bool {
        self.calm_since.is_some_and(|t| now.seconds_since(t) >= settings.aligned_s)
    }
}

/// The observer in force, its signal, and how far it has come.
#[derive(Clone, Debug)]
pub(in super::super) struct ObserverStage {
    params: ObserverParams,
    /// `None` until the attitude has a first guess.
    pub(super) state: Option<ObserverState>,
    pub(in super::super) predictor: Predictor,
    pub(in super::super) alignment: AttitudeSearch,
}

impl ObserverStage {
    pub(super) fn new(settings: &NavigatorSettings) -> Self {
        let params = ObserverParams::new(settings);
        let predictor = Predictor::new(params.scheme, LONGEST_DELAY, SIGNAL_HOLD, Vector3::zeros());
        Self { params, state: None, predictor, alignment: AttitudeSearch::default() }
    }

    /// The frame's origin is at a place.
    pub(in super::super) fn settle(&mut self, environment: &LocalEnvironment) {
        let earth_rate = environment.earth_rate_ned;
        self.predictor = Predictor::new(self.params.scheme, LONGEST_DELAY, SIGNAL_HOLD, earth_rate);
    }

    /// Its newest state; `None` until the attitude has a first guess.
    pub(in super::super) fn state(&self) -> Option<&ObserverState> {
        self.state.as_ref()
    }

    pub(in super::super) fn predictor(&self) -> &Predictor {
        &self.predictor
    }

    /// Gains of Fusini's observer, for the low pass of the flow's bias.
    pub(in super::super) fn fusini(&self) -> &FusiniParams {
        &self.params.fusini
    }

    /// Whether the observers are still looking for the attitude, with gains to match.
    pub(in super::super) fn starting(
        &self,
        now: AutopilotTime,
        mode: Mode,
        settings: &ObserverSettings,
    ) -> bool {
        mode == Mode::Aligning || self.alignment.seconds_since_attitude(now) < settings.start_s
    }

    /// The measurement signal at a past time: position and velocity, NED.
    pub(in super::super) fn predicted(&self, time: AutopilotTime) -> Option<(Vector3<f64>, Vector3<f64>)> {
        // An innovation of a zero sample is the negative of the prediction.
        let zero = FixSample { stamp: time, position_ned: [Some(0.0); 3], velocity_ned: [Some(0.0); 3] };
        let i = self.predictor.innovation(&zero)?;
        let v = |o: &[Option<f64>; 3]| Vector3::from_fn(|row, _| -o[row].unwrap_or_default());
        Some((v(&i.position_ned), v(&i.velocity_ned)))
    }

    /// The state is set to the measurement signal: the transient is over for the attitude only.
    pub(super) fn take_signal_over(&mut self) {
        if let (Some(w), Some(state)) = (self.predictor.latest(), &mut self.state) {
            state.position_ned = w.position_ned;
            state.velocity_ned = w.velocity_ned;
        }
    }

    /// North was elsewhere: what is estimated is turned about the vertical, rad.
    pub(super) fn turn(&mut self, angle: f64) {
        let turn = so3::exp(&Vector3::new(0.0, 0.0, angle));
        if let Some(state) = &mut self.state {
            state.r_hat = turn * state.r_hat;
            state.velocity_ned = turn * state.velocity_ned;
            state.xi_ned = turn * state.xi_ned;
        }
    }

    /// The observer takes an attitude and a gyro bias from somebody who knows them better.
    pub(super) fn led_by(&mut self, r_body_to_ned: &Matrix3<f64>, gyro_bias: &Vector3<f64>) {
        if let Some(state) = &mut self.state {
            state.r_hat = *r_body_to_ned;
            state.gyro_bias = *gyro_bias;
            state.xi_ned = Vector3::zeros();
        }
    }

    /// A first guess: TRIAD of specific force (as if at rest) and magnetic field; without a magnetometer north is anywhere. The
    /// observer converges from any guess; a vehicle at rest needs not wait for that. Returns the attitude when it was guessed.
    pub(in super::super) fn first_attitude(
        &mut self,
        s: &ImuSample,
        input: &StepInput<'_>,
    ) -> Option<Matrix3<f64>> {
        if self.state.is_some() {
            return None;
        }
        let up = -input.environment.gravity_ned;
        let r = match input.magnetic_pair(s.time) {
            Some(pair) => rotation(&s.specific_force.raw(), &pair.field_body, &up, &pair.field_ned)?,
            None if self.alignment.seconds_since_start(s.time) < WAIT_FOR_MAGNETOMETER_S => return None,
            None => {
                let forward = Vector3::x()
                    - s.specific_force.raw() * s.specific_force.raw().x
                        / s.specific_force.raw().norm_squared();
                rotation(&s.specific_force.raw(), &forward, &up, &Vector3::x())?
            }
        };
        self.alignment.attitude_started = Some(s.time);
        self.state = Some(ObserverState::new(r, Vector3::zeros(), Vector3::zeros()));
        Some(r)
    }

    /// One step of the observer in force. `None` when there is no state, or it is not finite any more: then there is none.
    pub(super) fn step(&mut self, s: &ImuSample, dt: f64, input: &StepInput<'_>) -> Option<StepReport> {
        let mut state = self.state?;
        let report = self.observe(&mut state, s, dt, input);
        self.state = Some(state).filter(|state| report.is_some() && state.is_finite());
        self.state.and(report)
    }

    fn observe(
        &self,
        state: &mut ObserverState,
        s: &ImuSample,
        dt: f64,
        input: &StepInput<'_>,
    ) -> Option<StepReport> {
        if input.dead_reckoning {
            return self.dead_reckon(state, s, dt, input);
        }
        let signal = self.signal(input);
        let starting = self.starting(s.time, input.mode, &input.settings.observer);
        match input.magnetic_pair(s.time) {
            Some(pair) => {
                let params = if starting { &self.params.grip_start } else { &self.params.grip };
                step_grip(params, state, s, dt, input, &pair, signal.as_ref())
            }
            None => {
                let params = if starting { &self.params.fusini_start } else { &self.params.fusini };
                let fusini_input = FusiniInput {
                    flow_velocity_body: input.flow_body(s.time),
                    aiding: Aiding::Gnss(signal),
                    reference: AttitudeReference::FlowVelocity,
                    k_p_override: None,
                    ..fusini_input(s, dt, input.environment)
                };
                step_fusini(&at_rate(params, dt, input.settings.estimator), state, &fusini_input)
            }
        }
    }

    fn dead_reckon(
        &self,
        state: &mut ObserverState,
        s: &ImuSample,
        dt: f64,
        input: &StepInput<'_>,
    ) -> Option<StepReport> {
        let printed = input.settings.estimator == Kind::NloPrinted;
        let magnetic = input.magnetic_pair(s.time);
        let flow_body = input.flow_body(s.time);
        let velocity =
            if printed { flow_body } else { self.carried_velocity_body(state, flow_body.is_some()) };
        // The velocity triad needs a measured direction: the carried velocity would only agree with itself.
        let reference = match magnetic {
            // As printed; its gains would turn the attitude over by the magnetic triad.
            _ if printed && flow_body.is_some() => AttitudeReference::FlowVelocity,
            Some(pair) => AttitudeReference::Magnetic(pair),
            None if flow_body.is_some() => AttitudeReference::FlowVelocity,
            None => AttitudeReference::None,
        };
        let flow_velocity_body = if magnetic.is_some() { velocity } else { flow_body };
        let k_p = self.params.fusini.k_p * input.settings.observer.holdover_k_p_factor;
        let fusini_input = FusiniInput {
            flow_velocity_body: flow_velocity_body.filter(|_| input.carried_by_flow),
            aiding: Aiding::DeadReckoning { altitude_down_m: input.height_m.map(|h| -h) },
            reference,
            k_p_override: (!printed).then_some(k_p),
            ..fusini_input(s, dt, input.environment)
        };
        step_fusini(&at_rate(&self.params.fusini, dt, input.settings.estimator), state, &fusini_input)
    }

    /// The measurement signal, its vertical part from the height filter.
    fn signal(&self, input: &StepInput<'_>) -> Option<Signal> {
        let mut signal = self.predictor.signal()?;
        if let Some(height) = input.height_m {
            signal.position_ned.z = -height;
            signal.velocity_ned.z = -input.climb_mps;
            signal.position_axes[2] = true;
            signal.velocity_axes[2] = true;
        }
        Some(signal)
    }

    /// The flow velocity between flow samples, in the axes of R̂ itself: R̂ is not in SO(3), and R̂·(R̂⁻¹w_v) is w_v without its scale.
    fn carried_velocity_body(&self, state: &ObserverState, fresh: bool) -> Option<Vector3<f64>> {
        let w = self.predictor.latest().filter(|_| fresh)?;
        Some(state.r_hat.try_inverse()? * w.velocity_ned)
    }

    /// After a step: the predictor goes on with the acceleration that is injected and the velocity that is estimated.
    pub(in super::super) fn propagate(
        &mut self,
        now: AutopilotTime,
        injected_ned: &Vector3<f64>,
        velocity_ned: &Vector3<f64>,
    ) {
        self.predictor.propagate(now, injected_ned, velocity_ned);
    }

    /// The signal begins with a fix, if it does not run; while aligning, the state too.
    pub(in super::super) fn begin_signal(
        &mut self,
        now: AutopilotTime,
        position_ned: &Vector3<f64>,
        velocity_ned: &Vector3<f64>,
        aligning: bool,
    ) {
        if self.predictor.is_running() {
            return;
        }
        self.predictor.reset(now, position_ned, velocity_ned);
        if let Some(state) = self.state.as_mut().filter(|_| aligning) {
            state.position_ned = *position_ned;
            state.velocity_ned = *velocity_ned;
        }
    }

    /// The signal begins anew with a velocity, in dead reckoning. False when there is no state.
    pub(in super::super) fn restart_signal(
        &mut self,
        now: AutopilotTime,
        velocity_ned: &Vector3<f64>,
    ) -> bool {
        let Some(state) = &self.state else { return false };
        self.predictor.reset(now, &state.position_ned, velocity_ned);
        true
    }

    /// The signal is corrected.
    pub(in super::super) fn apply(&mut self, innovation: &Innovation) {
        self.predictor.apply(innovation);
    }

    /// What was injected in a step over `dt` s.
    pub(in super::super) fn injected(
        &mut self,
        now: AutopilotTime,
        dt: f64,
        report: &StepReport,
        settings: &ObserverSettings,
    ) {
        if let (Some(j), Some(state)) = (&report.injection, &self.state) {
            self.alignment.injection(now, dt, &(j * state.r_hat.transpose()), settings);
        }
    }
}

fn fusini_input(s: &ImuSample, dt_s: f64, environment: &LocalEnvironment) -> FusiniInput {
    FusiniInput {
        dt_s,
        angular_rate_body: s.angular_rate.raw(),
        specific_force_body: s.specific_force.raw(),
        gravity_ned: environment.gravity_ned,
        earth_rate_ned: environment.earth_rate_ned,
        flow_velocity_body: None,
        aiding: Aiding::Gnss(None),
        reference: AttitudeReference::None,
        k_p_override: None,
    }
}

fn step_grip(
    params: &GripParams,
    state: &mut ObserverState,
    s: &ImuSample,
    dt: f64,
    input: &StepInput<'_>,
    pair: &MagneticPair,
    signal: Option<&Signal>,
) -> Option<StepReport> {
    // The printed gains are for 100 Hz: a slower stream is held for several steps, at which they do not diverge.
    let printed = input.settings.estimator == Kind::NloPrinted;
    let n = if printed { (dt / PRINTED_STEP_S).ceil().clamp(1.0, 100.0) } else { 1.0 };
    let mut report = None;
    for _ in 0..n as u32 {
        let (position_error_ned, velocity_error_ned) =
            signal.map_or_else(Default::default, |w| w.errors(&state.position_ned, &state.velocity_ned));
        let grip_input = GripInput {
            dt_s: dt / n,
            angular_rate_body: s.angular_rate.raw(),
            specific_force_body: s.specific_force.raw(),
            gravity_ned: input.environment.gravity_ned,
            earth_rate_ned: input.environment.earth_rate_ned,
            magnetic: Some(*pair),
            position_error_ned,
            velocity_error_ned,
        };
        report = Some(grip::step(params, state, &grip_input).ok()?);
    }
    report
}

/// Fusini's step without its b_v and b_f: the calibration has taken the flow's errors out, and with K_f = 0 b_f is constant.
fn step_fusini(params: &FusiniParams, state: &mut ObserverState, input: &FusiniInput) -> Option<StepReport> {
    fusini::step(params, state, &mut FusiniBiases::default(), input).ok()
}

/// The printed forms with as many sub-steps as their rate asks for.
fn at_rate(params: &FusiniParams, dt: f64, kind: Kind) -> FusiniParams {
    match kind {
        Kind::NloPrinted => {
            FusiniParams { sub_steps: (dt * PRINTED_RATE_HZ).round().clamp(1.0, 100.0) as u32, ..*params }
        }
        _ => *params,
    }
}

/// The rotation that maps two body vectors to two NED vectors; the first pair exactly.
fn rotation(
    b1: &Vector3<f64>,
    b2: &Vector3<f64>,
    n1: &Vector3<f64>,
    n2: &Vector3<f64>,
) -> Option<Matrix3<f64>> {
    let r = normalised_triad(n1, n2)? * normalised_triad(b1, b2)?.transpose();
    polar_rotation(&r)
}
