//! The IMU sample: what moves everything.

use nalgebra::{Matrix3, Vector3};

use crate::geo::polar_rotation;
use crate::observer::triad::normalised_triad;
use crate::observer::{
    Aiding, AttitudeReference, FusiniBiases, FusiniInput, FusiniParams, GripInput, MagneticPair,
    ObserverState, Signal, StepReport, fusini, grip,
};
use crate::sample::ImuSample;
use crate::time::AutopilotTime;

use super::drag::DragMean;
use super::event::Why;
use super::history::Moment;
use super::rest::Rest;
use super::settings::Estimator;
use super::solution::{Carrier, Mode};
use super::verdict::{Reason, Verdict};
use super::{Navigator, Place};

/// The interval that Grip's printed gains are for, s. Jitter makes no second step of it.
const PRINTED_STEP_S: f64 = 0.012;
/// The rate that Fusini's are for, Hz.
const PRINTED_RATE_HZ: f64 = 300.0;
/// A vehicle that hears no magnetometer for this long starts without, s.
pub(super) const WAIT_FOR_MAGNETOMETER_S: f64 = 2.0;
/// A step longer than this leaves room for what was not seen, s.
const LONG_STEP_S: f64 = 0.1;
/// Autopilots' IMUs measure up to 2000 °/s and 16 g; at their limits, less 1 %, they tell the limit and not the motion, rad/s and m/s².
/// What is missed so is bridged by the samples around it, and where that takes too long, it is a hole in the stream.
const FULL_RATE: f64 = 34.55;
const FULL_FORCE: f64 = 155.3;
/// An IMU in the air that tells the same six numbers for this long is stuck, s.
const STUCK_S: f64 = 0.5;
/// A stream that goes on in the past for this long has another clock than it had, s.
const BEHIND_S: f64 = 0.2;

/// What a vertical acceleration may be that nobody has measured, m/s².
pub(super) const UNKNOWN_VERTICAL: f64 = 2.0;

impl Navigator {
    pub(super) fn imu(&mut self, s: &ImuSample) -> Verdict {
        if !finite(&s.angular_rate.raw()) || !finite(&s.specific_force.raw()) {
            return Verdict::Rejected(Reason::NotFinite);
        }
        if saturated(&s.angular_rate.raw(), FULL_RATE) || saturated(&s.specific_force.raw(), FULL_FORCE) {
            return Verdict::Rejected(Reason::OutOfRange);
        }
        let Some(last) = self.last_imu else {
            self.last_imu = Some(s.time);
            self.modes.started(s.time);
            return Verdict::Used;
        };
        let dt = s.time.seconds_since(last);
        if dt <= 0.0 {
            return self.behind(s.time);
        }
        self.behind = None;
        if self.is_stuck(s) {
            return Verdict::Rejected(Reason::Stuck);
        }
        self.last_imu = Some(s.time);
        self.trust.check(s.time);
        if dt > self.settings.imu_max_gap_s {
            if !self.bridge(s, dt) {
                self.height.blind(dt, UNKNOWN_VERTICAL);
                self.broken_off(s.time, Why::ImuGap(dt));
            }
            return Verdict::Used;
        }
        if dt > LONG_STEP_S
            && let Some(kalman) = &mut self.kalman
        {
            kalman.doubt(dt);
        }
        let Some(place) = self.place.clone() else {
            return Verdict::Rejected(Reason::NoReferenceYet);
        };
        if self.state.is_none() {
            self.first_attitude(s, &place);
        }
        let Some(mut state) = self.state else {
            return Verdict::Rejected(Reason::NoReferenceYet);
        };
        // Over the interval the mean of its two ends is nearer to the truth than either instant.
        let last = self.last_sample.replace(*s).filter(|_| self.settings.imu_instantaneous);
        let mean = last.map_or(*s, |last| ImuSample {
            time: s.time,
            angular_rate: (last.angular_rate + s.angular_rate) * 0.5,
            specific_force: (last.specific_force + s.specific_force) * 0.5,
        });
        let report = self.observe(&mut state, &mean, dt, &place);
        match (report, state.is_finite()) {
            (Some(report), true) => {
                self.state = Some(state);
                self.after_step(&mean, dt, &report, &place);
            }
            _ => {
                self.state = None;
                self.broken_off(s.time, Why::Broken);
            }
        }
        Verdict::Used
    }

    /// A sample older than the newest. One may be late; a stream of them is a clock that was set back, and then everything that is
    /// remembered has times that will not come for long, or mean another moment.
    fn behind(&mut self, time: AutopilotTime) -> Verdict {
        let gap = self.settings.imu_max_gap_s;
        let goes_on = |last: AutopilotTime| time > last && time.seconds_since(last) <= gap;
        let since = self.behind.filter(|(_, last)| goes_on(*last)).map_or(time, |(since, _)| since);
        self.behind = Some((since, time));
        if time.seconds_since(since) >= BEHIND_S {
            self.behind = None;
            self.reboot(time);
            self.forget_times();
        }
        Verdict::Rejected(Reason::OutOfOrder)
    }

    /// Whether the IMU repeats itself for longer than one does that is in the air; on the ground a coarse one may.
    fn is_stuck(&mut self, s: &ImuSample) -> bool {
        let Some(last) = self.last_sample.filter(|last| {
            last.angular_rate.raw() == s.angular_rate.raw()
                && last.specific_force.raw() == s.specific_force.raw()
        }) else {
            self.imu_same_since = None;
            return false;
        };
        let since = *self.imu_same_since.get_or_insert(last.time);
        !self.disarmed() && s.time.seconds_since(since) > STUCK_S
    }

    /// One observer step. Which observer depends on what there is: Grip's with GNSS and a magnetometer, Fusini's with GNSS and
    /// flow, or in dead reckoning.
    fn observe(
        &self,
        state: &mut ObserverState,
        s: &ImuSample,
        dt: f64,
        place: &Place,
    ) -> Option<StepReport> {
        let magnetic = self.magnetic_pair(s.time, place);
        let printed = self.settings.estimator == Estimator::NloPrinted;
        let flow_body = self.flow_body.filter(|(t, _)| s.time.seconds_since(*t) < FLOW_AGE_S).map(|(_, v)| v);
        if self.modes.dead_reckoning() {
            let velocity = if printed { flow_body } else { self.carried_velocity_body(state, s.time) };
            // The velocity triad needs a measured direction: the carried velocity would only agree with itself.
            let reference = match magnetic {
                // As printed; its gains would turn the attitude over by the magnetic triad.
                _ if printed && flow_body.is_some() => AttitudeReference::FlowVelocity,
                Some(pair) => AttitudeReference::Magnetic(pair),
                None if flow_body.is_some() => AttitudeReference::FlowVelocity,
                None => AttitudeReference::None,
            };
            let flow_velocity_body = if magnetic.is_some() { velocity } else { flow_body };
            let k_p = self.fusini.k_p * self.settings.observer.holdover_k_p_factor;
            let input = FusiniInput {
                dt_s: dt,
                angular_rate_body: s.angular_rate.raw(),
                specific_force_body: s.specific_force.raw(),
                gravity_ned: place.gravity_ned,
                earth_rate_ned: place.earth_rate_ned,
                flow_velocity_body: flow_velocity_body.filter(|_| self.carrier == Carrier::Flow),
                aiding: Aiding::DeadReckoning { altitude_down_m: self.height.height_m().map(|h| -h) },
                reference,
                k_p_override: (!printed).then_some(k_p),
            };
            return fusini_step(&self.at_rate(&self.fusini, dt), state, &input);
        }
        let signal = self.signal();
        let starting = self.starting(s.time);
        if let Some(pair) = magnetic {
            let params = if starting { &self.grip_start } else { &self.grip };
            // The printed gains are for 100 Hz: a slower stream is held for several steps, at which they do not diverge.
            let n = if printed { (dt / PRINTED_STEP_S).ceil().clamp(1.0, 100.0) } else { 1.0 };
            let mut report = None;
            for _ in 0..n as u32 {
                let (position_error_ned, velocity_error_ned) = signal
                    .map_or_else(Default::default, |w| w.errors(&state.position_ned, &state.velocity_ned));
                let input = GripInput {
                    dt_s: dt / n,
                    angular_rate_body: s.angular_rate.raw(),
                    specific_force_body: s.specific_force.raw(),
                    gravity_ned: place.gravity_ned,
                    earth_rate_ned: place.earth_rate_ned,
                    magnetic: Some(pair),
                    position_error_ned,
                    velocity_error_ned,
                };
                report = Some(grip::step(params, state, &input).ok()?);
            }
            return report;
        }
        let input = FusiniInput {
            dt_s: dt,
            angular_rate_body: s.angular_rate.raw(),
            specific_force_body: s.specific_force.raw(),
            gravity_ned: place.gravity_ned,
            earth_rate_ned: place.earth_rate_ned,
            flow_velocity_body: flow_body,
            aiding: Aiding::Gnss(signal),
            reference: AttitudeReference::FlowVelocity,
            k_p_override: None,
        };
        let params = if starting { &self.fusini_start } else { &self.fusini };
        fusini_step(&self.at_rate(params, dt), state, &input)
    }

    /// The printed forms with as many sub-steps as their rate asks for.
    fn at_rate(&self, params: &FusiniParams, dt: f64) -> FusiniParams {
        match self.settings.estimator {
            Estimator::NloPrinted => {
                FusiniParams { sub_steps: (dt * PRINTED_RATE_HZ).round().clamp(1.0, 100.0) as u32, ..*params }
            }
            _ => *params,
        }
    }

    /// Whether the observers are still looking for the attitude, with gains to match.
    pub(super) fn starting(&self, now: AutopilotTime) -> bool {
        self.modes.mode() == Mode::Aligning
            || self.modes.seconds_since_attitude(now) < self.settings.observer.start_s
    }

    /// The measurement signal, its vertical part from the height filter.
    fn signal(&self) -> Option<Signal> {
        let mut signal = self.predictor.signal()?;
        if let Some(height) = self.height.height_m() {
            signal.position_ned.z = -height;
            signal.velocity_ned.z = -self.height.climb_mps();
            signal.position_axes[2] = true;
            signal.velocity_axes[2] = true;
        }
        Some(signal)
    }

    /// The flow velocity between flow samples, in the axes of R̂ itself: R̂ is not in SO(3), and R̂·(R̂⁻¹w_v) is w_v without its scale.
    fn carried_velocity_body(&self, state: &ObserverState, now: AutopilotTime) -> Option<Vector3<f64>> {
        let fresh = self.flow_body.is_some_and(|(t, _)| now.seconds_since(t) < FLOW_AGE_S);
        let w = self.predictor.latest().filter(|_| fresh)?;
        Some(state.r_hat.try_inverse()? * w.velocity_ned)
    }

    fn after_step(&mut self, s: &ImuSample, dt: f64, report: &StepReport, place: &Place) {
        let Some(state) = self.state else { return };
        let filtered = self.predict_kalman(s.time, dt, &s.angular_rate.raw(), &s.specific_force.raw());
        let (acceleration, integrated) = match (&self.kalman, filtered) {
            (Some(kalman), Some(acceleration)) => {
                let filter = kalman.filter.state();
                self.r_body_to_ned = filter.r_body_to_ned;
                self.angular_rate_body = s.angular_rate.raw() - filter.gyro_bias;
                (acceleration, acceleration)
            }
            _ => match self.predict_xkf(s, dt, place) {
                Some(second) => {
                    self.r_body_to_ned = second.r_body_to_ned;
                    self.angular_rate_body = s.angular_rate.raw() - second.gyro_bias;
                    // The signal that is injected into the observer stays the observer's own.
                    (second.acceleration_ned, report.acceleration_ned)
                }
                None => {
                    if let Some(r) = state.r_body_to_ned() {
                        self.r_body_to_ned = r;
                    }
                    self.angular_rate_body = s.angular_rate.raw() - state.gyro_bias;
                    (self.r_body_to_ned * s.specific_force.raw() + place.gravity_ned, report.acceleration_ned)
                }
            },
        };
        let (position_ned, velocity_ned) =
            self.estimate().unwrap_or((state.position_ned, state.velocity_ned));
        let instant = Moment {
            r_body_to_ned: self.r_body_to_ned,
            turned: self.angular_rate_body * dt,
            acceleration_ned: acceleration,
            position_ned,
            velocity_ned,
        };
        self.history.push(s.time, &instant);
        self.predictor.propagate(s.time, &integrated, &velocity_ned);
        let load = self.settings.height.accel_load_noise * acceleration.norm();
        self.height.predict(dt, -acceleration.z, load);
        self.feel_ground(dt);
        self.glide_height(dt);
        self.look_for_rest(s);
        self.feel_drag(s, dt);
        self.lead_observer(s.time);
        self.seek_heading(s, dt);
        self.feel_landmarks(s.time, dt);
        self.modes.injection(s.time, report.injection_norm, &self.settings.observer);
        self.advance_mode(s.time, dt);
    }

    /// A first guess: TRIAD of specific force (as if at rest) and magnetic field; without a magnetometer north is anywhere. The
    /// observer converges from any guess; a vehicle at rest needs not wait for that.
    fn first_attitude(&mut self, s: &ImuSample, place: &Place) {
        let up = -place.gravity_ned;
        let guess = match self.magnetic_pair(s.time, place) {
            Some(pair) => rotation(&s.specific_force.raw(), &pair.field_body, &up, &pair.field_ned),
            None if self.modes.seconds_since_start(s.time) < WAIT_FOR_MAGNETOMETER_S => None,
            None => {
                let forward = Vector3::x()
                    - s.specific_force.raw() * s.specific_force.raw().x
                        / s.specific_force.raw().norm_squared();
                rotation(&s.specific_force.raw(), &forward, &up, &Vector3::x())
            }
        };
        if let Some(r) = guess {
            self.r_body_to_ned = r;
            self.modes.attitude_started(s.time);
            self.state = Some(ObserverState::new(r, Vector3::zeros(), Vector3::zeros()));
        }
    }

    fn magnetic_pair(&self, now: AutopilotTime, place: &Place) -> Option<MagneticPair> {
        let (time, field_body) = self.magnetic?;
        let field_ned = place.field_ned?;
        (now.seconds_since(time) < super::MAGNETIC_AGE_S).then_some(MagneticPair { field_body, field_ned })
    }

    /// The stream or the estimate broke: what was known does not hold any more.
    pub(super) fn broken_off(&mut self, time: AutopilotTime, why: Why) {
        self.history.clear();
        self.predictor.clear();
        self.kalman = None;
        self.xkf = None;
        self.heading = None;
        self.heading_by_motion = false;
        self.flow_body = None;
        self.range = None;
        self.last_sample = None;
        self.rest = Rest::default();
        if let Some(landmarks) = &mut self.landmarks {
            landmarks.interrupt();
        }
        self.drag = DragMean::default();
        self.latency.interrupt();
        let to = match self.modes.mode() {
            Mode::Aligning => return,
            Mode::Aided => Mode::Aligning,
            Mode::Holdover | Mode::Rejoining | Mode::Lost => Mode::Lost,
        };
        self.change_mode(time, to, why);
    }
}

/// Fusini's step without its b_v and b_f: the calibration has taken the flow's errors out, and with K_f = 0 b_f is constant.
fn fusini_step(params: &FusiniParams, state: &mut ObserverState, input: &FusiniInput) -> Option<StepReport> {
    fusini::step(params, state, &mut FusiniBiases::default(), input).ok()
}

/// A flow velocity is used for this long, s.
pub(super) const FLOW_AGE_S: f64 = 0.5;

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

fn saturated(v: &Vector3<f64>, full: f64) -> bool {
    v.iter().any(|c| c.abs() >= full)
}

fn finite(v: &Vector3<f64>) -> bool {
    // Far beyond any sensor (m/s² or rad/s), and far from where squares overflow. NaN fails too.
    v.iter().all(|c| c.abs() < 1e4)
}
