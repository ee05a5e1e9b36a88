//! The stage that flies: the error-state filter, started by the nonlinear observer when that has found the attitude, fed with the same
//! measurements, and watched by the observer from then on.

use nalgebra::{Matrix3, Matrix4, Vector2, Vector3};

use crate::camera::FlowCalibration;
use crate::filter::error_state::{
    AirModel, Correction, Eskf, EskfMemory, EskfSettings, EskfState, Fade, JumpOdds, JumpWindow, Lag,
    SeenFlow, StartSigma,
};
use crate::geo::so3;
use crate::observer::ObserverState;
use crate::sample::ImuSample;
use crate::time::{AutopilotTime, Span};

use super::super::environment::LocalEnvironment;
use super::super::observation::{Fused, Observation};
use super::super::settings::{Estimator as Kind, NavigatorSettings};
use super::super::solution::Mode;
use super::super::sources::status::Measured;
use super::super::timeline::Timeline;
use super::hole::{self, Levelled};
use super::lookback::Lookback;
use super::step::{Progress, StepInput, Stepped, Watch};
use crate::navigator::tuning::error_state::{
    BRIDGE_STEP_S, HEIGHT_PERIOD_S, HEIGHT_SIGMA_M, MAGNETIC_PERIOD_S, MIN_UPRIGHT, MOVING_GYRO_BIAS,
    MOVING_TILT, MOVING_VELOCITY, MOVING_YAW, START_ACCEL_BIAS, START_GYRO_BIAS, START_TILT, START_VELOCITY,
    START_YAW, WIDE_YAW,
};

/// Standard deviations of what the filter starts from: roll and pitch, yaw (rad), velocity (m/s), gyro bias (rad/s).
pub(super) struct StartSigmas {
    pub(super) tilt: f64,
    pub(super) yaw: f64,
    pub(super) velocity: f64,
    pub(super) gyro_bias: f64,
}

impl StartSigmas {
    /// Of an observer that has found the attitude in motion, by accelerometers alone: what they felt was not only gravity.
    pub(super) const IN_MOTION: Self =
        Self { tilt: MOVING_TILT, yaw: MOVING_YAW, velocity: MOVING_VELOCITY, gyro_bias: MOVING_GYRO_BIAS };

    /// Of an observer that has found the attitude.
    pub(super) const OBSERVED: Self =
        Self { tilt: START_TILT, yaw: START_YAW, velocity: START_VELOCITY, gyro_bias: START_GYRO_BIAS };
}

/// What a filter starts from besides the observer's state.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct StartPoint<'a> {
    pub(in super::super) settings: &'a NavigatorSettings,
    /// The altimeter's height above the origin, m, and its standard deviation.
    pub(in super::super) height_m: Option<f64>,
    pub(in super::super) height_sigma_m: f64,
    /// Standard deviation of the horizontal position, m.
    pub(in super::super) position_sigma_m: f64,
}

impl StartPoint<'_> {
    /// The observer's position at the altimeter's height.
    pub(super) fn position(&self, observed_ned: &Vector3<f64>) -> Vector3<f64> {
        let down = self.height_m.map_or(observed_ned.z, |h| -h);
        Vector3::new(observed_ned.x, observed_ned.y, down)
    }

    /// Standard deviation of that, NED, m.
    pub(super) fn position_sigma(&self) -> Vector3<f64> {
        let horizontal = self.position_sigma_m;
        Vector3::new(horizontal, horizontal, self.height_sigma_m.max(HEIGHT_SIGMA_M))
    }
}

/// The filter and when it was last fed.
#[derive(Clone, Debug)]
pub(in super::super) struct ErrorStateStage {
    filter: Eskf,
    /// As configured: of an IMU that does not shake.
    configured: EskfSettings,
    magnetic_due: AutopilotTime,
    height_due: AutopilotTime,
    /// How often magnetometer and height are fused, s.
    periods_s: [f64; 2],
    pub(super) watch: Watch,
    /// Of the filter that is published.
    lookback: Option<Lookback>,
}

/// What is remembered of the past, as it was for a filter.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct FilterPast<'a> {
    timeline: &'a Timeline,
    /// Of a filter beside the one that the timeline is of, less that: attitude about NED, velocity, NED, m/s, air velocity, body, m/s.
    apart: Option<(Matrix3<f64>, Vector3<f64>, Vector3<f64>)>,
}

impl<'a> FilterPast<'a> {
    /// Of the filter that is published.
    pub(super) fn of(timeline: &'a Timeline) -> Self {
        Self { timeline, apart: None }
    }

    /// Of another filter at `own`, while the published one is at `published`: their difference is that of the present, for a measurement is not
    /// so late that it changes.
    pub(in super::super) fn beside(timeline: &'a Timeline, own: &EskfState, published: &EskfState) -> Self {
        let turn = own.r_body_to_ned * published.r_body_to_ned.transpose();
        let faster = own.velocity_ned - published.velocity_ned;
        let through_air = own.air_velocity_body() - published.air_velocity_body();
        Self { timeline, apart: Some((turn, faster, through_air)) }
    }

    fn velocity(&self, at: AutopilotTime) -> Option<Vector3<f64>> {
        let (_, velocity) = self.timeline.motion(at)?;
        Some(self.apart.map_or(velocity, |(_, faster, _)| velocity + faster))
    }

    fn attitude(&self, r_body_to_ned: &Matrix3<f64>) -> Matrix3<f64> {
        self.apart.map_or(*r_body_to_ned, |(turn, ..)| turn * r_body_to_ned)
    }

    fn air_body(&self, air_body: &Vector3<f64>) -> Vector3<f64> {
        self.apart.map_or(*air_body, |(.., through_air)| air_body + through_air)
    }
}

impl ErrorStateStage {
    /// Starts from the observer's state, known this well. `None` when the observer has no attitude.
    pub(super) fn start(
        now: AutopilotTime,
        observed: &ObserverState,
        from: &StartPoint<'_>,
        known: &StartSigmas,
    ) -> Option<Self> {
        let r = observed.r_body_to_ned()?;
        let position_ned = from.position(&observed.position_ned);
        let start = EskfState {
            drag: from.settings.drag.coefficient,
            ..EskfState::moving(r, position_ned, observed.velocity_ned, observed.gyro_bias)
        };
        let (settings, flow) = filter_settings(from.settings);
        let sigma = StartSigma {
            // Yaw stands on NED's z axis; body axes take their share of it.
            attitude_body: r.tr_mul(&Vector3::new(known.tilt, known.tilt, known.yaw)).abs(),
            position_ned: from.position_sigma(),
            velocity_ned: Vector3::repeat(known.velocity),
            gyro_bias: Vector3::repeat(known.gyro_bias),
            accel_bias: Vector3::repeat(START_ACCEL_BIAS),
            flow,
        };
        let mut filter = Eskf::new(settings, start, &sigma);
        filter.watch_for_jumps(true);
        Some(Self {
            filter,
            configured: settings,
            magnetic_due: now,
            height_due: now,
            periods_s: [MAGNETIC_PERIOD_S, HEIGHT_PERIOD_S],
            watch: Watch::default(),
            lookback: Some(Lookback::new()),
        })
    }

    /// Goes on from what a filter knew. `None` where that is nothing that a filter knows.
    pub(super) fn remembering(
        now: AutopilotTime,
        memory: &EskfMemory,
        settings: &NavigatorSettings,
    ) -> Option<Self> {
        let (settings, _) = filter_settings(settings);
        let mut filter = memory.filter(settings)?;
        filter.watch_for_jumps(true);
        Some(Self {
            filter,
            configured: settings,
            magnetic_due: now,
            height_due: now,
            periods_s: [MAGNETIC_PERIOD_S, HEIGHT_PERIOD_S],
            watch: Watch::default(),
            lookback: Some(Lookback::new()),
        })
    }

    /// The same filter in a coarser form that costs less: the covariance in steps of so many seconds, magnetometer and height so often, s; and whether it
    /// watches for jumps.
    pub(in super::super) fn shadow(
        &self,
        covariance_step_s: f64,
        periods_s: [f64; 2],
        watches: bool,
    ) -> Self {
        let mut filter = self.filter.clone();
        filter.set_covariance_step(covariance_step_s);
        filter.watch_for_jumps(watches);
        Self { filter, periods_s, lookback: None, watch: Watch::default(), ..*self }
    }

    fn forget_past(&mut self) {
        self.filter.forget_jumps();
        if let Some(lookback) = &mut self.lookback {
            lookback.forget();
        }
    }

    pub(in super::super) fn filter(&self) -> &Eskf {
        &self.filter
    }

    /// To be set anew: what it was before is no past of it then.
    pub(in super::super) fn filter_mut(&mut self) -> &mut Eskf {
        self.forget_past();
        &mut self.filter
    }

    /// See [`Eskf::believe_jumps`]; what was before stays its past.
    pub(super) fn believe_jumps(&mut self, odds: &JumpOdds) -> Correction {
        self.filter.believe_jumps(odds)
    }

    /// See [`Eskf::believe_receiver_lies`].
    pub(super) fn believe_receiver_lies(&mut self, window: usize) -> Option<Correction> {
        self.filter.believe_receiver_lies(window)
    }

    /// See [`Eskf::take_gone_jumps`].
    pub(super) fn take_gone_jumps(&mut self) -> Option<JumpWindow> {
        self.filter.take_gone_jumps()
    }

    /// Takes back what was measured since `then`: the filter goes on from there by inertia alone, but for the height. How far that moves it,
    /// position and velocity, NED, m and m/s; `None` where nothing is remembered.
    pub(super) fn go_back(
        &mut self,
        then: AutopilotTime,
        environment: &LocalEnvironment,
    ) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let mut filter = self.lookback.as_mut()?.since(then, environment)?;
        let (before, after) = (*self.filter.state(), *filter.state());
        let climbed = before.position_ned.z - after.position_ned.z;
        filter.shift_origin(&Vector3::new(0.0, 0.0, -climbed));
        filter.forget_jumps();
        self.filter = filter;
        let moved = after.position_ned - before.position_ned;
        Some((Vector3::new(moved.x, moved.y, 0.0), after.velocity_ned - before.velocity_ned))
    }

    /// The gyros shake so much, rad/s/√Hz: what is white in their samples is noise, and never less than configured. Not so for the accelerometers: air
    /// is rough, and what it does to the specific force is motion, measured as such; theirs is what GNSS has shown, m/s²/√Hz.
    pub(super) fn feel_vibration(&mut self, gyro_density: f64, accel_density: f64) {
        let EskfSettings { gyro_noise, accel_noise, .. } = self.configured;
        self.filter.set_imu_noise(gyro_noise.max(gyro_density), accel_noise.max(accel_density));
    }

    /// One IMU sample, and the height when it is due. `None` when the estimate is not finite any more.
    pub(in super::super) fn step(
        &mut self,
        s: &ImuSample,
        dt: f64,
        environment: &LocalEnvironment,
        height_m: Option<f64>,
        fused: &mut Fused,
    ) -> Option<Vector3<f64>> {
        let LocalEnvironment { gravity_ned, earth_rate_ned, .. } = environment;
        let acceleration = self.filter.predict(
            dt,
            &s.angular_rate.raw(),
            &s.specific_force.raw(),
            gravity_ned,
            earth_rate_ned,
        );
        if let Some(lookback) = &mut self.lookback {
            lookback.note(s, dt, &self.filter);
        }
        if let Some(height) = height_m
            && s.time >= self.height_due
        {
            self.height_due = s.time + Span::from_seconds(self.periods_s[1]);
            let innovation = -height - self.filter.state().position_ned.z;
            fused.note(
                Measured::Height,
                self.filter.fuse_position(2, innovation, HEIGHT_SIGMA_M.powi(2), &Lag::NONE),
            );
        }
        self.filter.is_finite().then_some(acceleration)
    }

    /// Attitude, rate, and accelerations as they are published after a step.
    pub(super) fn stepped(&self, s: &ImuSample, acceleration: Vector3<f64>) -> Stepped {
        let state = self.filter.state();
        Stepped {
            r_body_to_ned: state.r_body_to_ned,
            angular_rate_body: s.angular_rate.raw() - state.gyro_bias,
            acceleration_ned: acceleration,
            injected_ned: acceleration,
        }
    }

    /// The angle between the filter's attitude and the observer's, rad, as far as it matters: nearly the same is zero.
    pub(super) fn apart(&self, observed: &ObserverState) -> Option<f64> {
        /// tr(RᵀR̂) above this is an angle far below any disagreement, however little orthonormal R̂ is.
        const NEARLY_THE_SAME: f64 = 2.95;
        // tr(RᵀR̂) = 1 + 2 cos φ: near 3 they agree, and R̂ need not be made orthonormal to see it.
        let filter = self.filter.state().r_body_to_ned;
        if filter.component_mul(&observed.r_hat).sum() > NEARLY_THE_SAME {
            return Some(0.0);
        }
        observed.r_body_to_ned().map(|r| so3::angle_between(&filter, &r))
    }

    /// What lies between the time of a measurement and now.
    fn lag(
        &self,
        now: AutopilotTime,
        measured: AutopilotTime,
        then_velocity: &Vector3<f64>,
        e: &LocalEnvironment,
    ) -> Lag {
        let seconds = now.seconds_since(measured);
        if seconds <= 0.0 {
            return Lag::NONE;
        }
        let velocity = self.filter.state().velocity_ned;
        Lag { seconds, impulse_ned: velocity - then_velocity - e.gravity_ned * seconds }
    }

    /// Takes an observation.
    pub(in super::super) fn fuse(
        &mut self,
        now: AutopilotTime,
        observation: &Observation,
        past: &FilterPast<'_>,
        environment: &LocalEnvironment,
        fused: &mut Fused,
    ) {
        match observation {
            Observation::Magnetic { field_body, field_ned, sigma_t, late_t, walk_t } => {
                if self.configured.magnetic_bias_sigma > 0.0 {
                    self.filter.set_magnetic_walk(*walk_t);
                }
                self.fuse_field(now, (field_body, field_ned), (*sigma_t, late_t), fused);
            }
            Observation::Fix { measured, position_error, velocity_error, sigma } => {
                let lag = match past.velocity(*measured) {
                    Some(then) => self.lag(now, *measured, &then, environment),
                    None => Lag::NONE,
                };
                let variances = sigma.map(|s| s * s);
                let results = self.filter.fuse_fix(position_error, velocity_error.as_ref(), variances, &lag);
                for (i, result) in results.into_iter().enumerate() {
                    let kind = if i < 2 { Measured::GnssPosition } else { Measured::GnssVelocity };
                    result.map(|r| fused.note(kind, r));
                }
            }
            Observation::Flow { measured, v_xy, distance_m, r_body_to_ned, covariance, .. } => {
                let velocity = past.velocity(*measured).unwrap_or(self.filter.state().velocity_ned);
                let r_body_to_ned = past.attitude(r_body_to_ned);
                let lag = self.lag(now, *measured, &velocity, environment);
                let seen = SeenFlow { v_xy: *v_xy, distance_m: *distance_m, covariance: *covariance };
                let result = self.filter.fuse_flow(&seen, &velocity, &r_body_to_ned, &lag);
                fused.note_all(Measured::Flow, result);
            }
            Observation::Airspeed { speed_mps, sigma_mps, sideslip_sigma_rad } => {
                let taken = fused.note(Measured::Airspeed, self.filter.fuse_airspeed(*speed_mps, *sigma_mps));
                let upright = self.filter.state().r_body_to_ned[(2, 2)] > MIN_UPRIGHT;
                if let Some(sigma) = sideslip_sigma_rad.filter(|_| taken && upright) {
                    fused.note(Measured::Sideslip, self.filter.fuse_sideslip(sigma));
                }
            }
            Observation::Drag { force_xy, air_body, sigma_mps2 } => {
                let air_body = past.air_body(air_body);
                fused.note_all(Measured::Drag, self.filter.fuse_drag(force_xy, &air_body, *sigma_mps2));
            }
            Observation::Standstill { angular_rate_body, earth_rate_ned, sigma_mps, sigma_radps } => {
                let result =
                    self.filter.fuse_standstill(angular_rate_body, earth_rate_ned, *sigma_mps, *sigma_radps);
                fused.note_all(Measured::Standstill, result);
            }
            Observation::Pose { error_ne, variance, r_body_to_ned, heading_variance } => {
                let turn = so3::log(&(r_body_to_ned * self.filter.state().r_body_to_ned.transpose())).z;
                if self.fuse_place(error_ne, variance, fused) {
                    let result = self.filter.fuse_heading(turn, *heading_variance);
                    fused.note(Measured::LandmarkHeading, result);
                }
            }
        }
    }

    /// The magnetic field, every so often: its errors are not white.
    fn fuse_field(
        &mut self,
        now: AutopilotTime,
        (field_body, field_ned): (&Vector3<f64>, &Vector3<f64>),
        (sigma_t, late_t): (f64, &Vector3<f64>),
        fused: &mut Fused,
    ) {
        if now < self.magnetic_due {
            return;
        }
        self.magnetic_due = now + Span::from_seconds(self.periods_s[0]);
        let sigma = late_t.map(|late| late.hypot(sigma_t));
        if self.yaw_sigma() > WIDE_YAW
            && self.head(
                field_body,
                field_ned,
                sigma_t.hypot(late_t.norm()).hypot(self.filter.magnetic_bias_sigma()),
            )
        {
            return;
        }
        let result = self.filter.fuse_magnetic(field_body, field_ned, &sigma);
        fused.note(Measured::Magnetometer, result);
    }

    /// A horizontal position of the present; whether both components were taken.
    fn fuse_place(&mut self, error_ne: &Vector2<f64>, variance: &[f64; 2], fused: &mut Fused) -> bool {
        let before = self.filter.state().position_ned;
        let mut taken = true;
        for axis in 0..2 {
            // Of the second the first has taken its part.
            let moved = self.filter.state().position_ned[axis] - before[axis];
            let result = self.filter.fuse_position(axis, error_ne[axis] - moved, variance[axis], &Lag::NONE);
            taken &= fused.note(Measured::LandmarkPosition, result);
        }
        taken
    }

    /// `gap_s` between two samples: what may have happened in it.
    pub(super) fn doubt(&mut self, gap_s: f64) {
        self.filter.doubt(&hole::doubt_between(gap_s));
    }

    /// The gyros may have been calibrated anew, in motion.
    pub(super) fn doubt_gyros(&mut self) {
        self.filter.doubt_gyros(MOVING_GYRO_BIAS);
    }

    /// Over a hole of `gap_s` with what was felt before and after, and the doubt that it leaves. `None` when that is not finite.
    pub(super) fn bridge(
        &mut self,
        last: &ImuSample,
        s: &ImuSample,
        gap_s: f64,
        environment: &LocalEnvironment,
    ) -> Option<Stepped> {
        self.forget_past();
        let rate = 0.5 * (last.angular_rate.raw() + s.angular_rate.raw());
        let force = 0.5 * (last.specific_force.raw() + s.specific_force.raw());
        let steps = (gap_s / BRIDGE_STEP_S).ceil().max(1.0);
        for _ in 0..steps as usize {
            let LocalEnvironment { gravity_ned, earth_rate_ned, .. } = environment;
            self.filter.predict(gap_s / steps, &rate, &force, gravity_ned, earth_rate_ned);
        }
        self.doubt(gap_s);
        let acceleration = self.filter.state().r_body_to_ned * force + environment.gravity_ned;
        self.filter.is_finite().then(|| self.stepped(s, acceleration))
    }

    /// Over a hole that is too long for that: with the velocity that it had, as it goes over. `None` when that is not finite.
    pub(super) fn coast(&mut self, s: &ImuSample, gap_s: f64, wing: bool) -> Option<Stepped> {
        self.forget_past();
        let speed = self.filter.state().velocity_ned.norm();
        self.filter.coast(gap_s, hole::fade_over(gap_s, wing));
        self.filter.doubt(&hole::doubt_beyond(gap_s, speed));
        self.filter.is_finite().then(|| self.stepped(s, Vector3::zeros()))
    }

    /// `dt` s without inertia, as part of a time without it that goes from one of `span_s` to the other. `None` when that is not finite.
    pub(super) fn coast_on(&mut self, s: &ImuSample, dt: f64, span_s: [f64; 2]) -> Option<Stepped> {
        self.filter.coast(dt, Fade::none(dt));
        let state = self.filter.state();
        let v = self.filter.velocity_covariance();
        let doubt = hole::doubt_more(span_s, state.velocity_ned.norm(), v[(0, 0)].max(v[(1, 1)]));
        self.filter.doubt(&doubt);
        self.filter.is_finite().then(|| self.stepped(s, Vector3::zeros()))
    }

    /// Which way is up was found again; `field`: what the magnetometer has told since, and what the place has, with its noise, T.
    pub(super) fn level(
        &mut self,
        found: &Levelled,
        field: Option<(&Vector3<f64>, &Vector3<f64>)>,
        sigma_t: f64,
    ) {
        self.forget_past();
        let yaw = self.yaw_sigma();
        self.filter.set_attitude(&found.turn_ned, found.tilt_sigma, yaw);
        if let Some((body, ned)) = field.filter(|_| yaw > found.tilt_sigma) {
            self.head(body, ned, sigma_t);
        }
    }

    /// Standard deviation of the heading, rad.
    pub(super) fn yaw_sigma(&self) -> f64 {
        self.filter.attitude_covariance_ned()[(2, 2)].max(0.0).sqrt()
    }

    /// The magnetic field sets the heading. False where it says nothing about it.
    fn head(&mut self, field_body: &Vector3<f64>, field_ned: &Vector3<f64>, sigma_t: f64) -> bool {
        let attitude = self.filter.attitude_covariance_ned();
        let tilt = (0.5 * (attitude[(0, 0)] + attitude[(1, 1)])).max(0.0).sqrt();
        let state = self.filter.state();
        let Some((turn, sigma)) = hole::heading_error(state, field_body, field_ned, sigma_t, tilt) else {
            return false;
        };
        self.filter.set_attitude(&(Vector3::z() * turn), tilt, sigma.min(self.yaw_sigma()));
        true
    }
}

/// One IMU sample for the filter, if it runs, after the observer has taken it. Where they disagree for long the filter starts anew; how far
/// apart they were, rad, is returned too. A filter that is not finite any more is given up.
pub(super) fn step(
    stage: &mut Option<Box<ErrorStateStage>>,
    s: &ImuSample,
    dt: f64,
    input: &StepInput<'_>,
    progress: &Progress<'_>,
    fused: &mut Fused,
) -> (Option<Stepped>, Option<f64>) {
    let Some(filter) = stage else { return (None, None) };
    let Some(acceleration) = filter.step(s, dt, input.environment, input.height_m, fused) else {
        *stage = None;
        return (None, None);
    };
    // An observer that follows the filter has nothing to say about it.
    let watching = input.mode == Mode::Aided && !progress.led;
    let apart = if watching { filter.apart(progress.observed) } else { None };
    let restarted = apart.filter(|_| {
        filter.watch.disagrees(s.time, apart) && progress.calm && filter.watch.is_doubted(s.time)
    });
    if restarted.is_some()
        && let Some(anew) =
            ErrorStateStage::start(s.time, progress.observed, &input.start_point(), &StartSigmas::OBSERVED)
    {
        **filter = anew;
    }
    (Some(filter.stepped(s, acceleration)), restarted)
}

/// What the filter of this estimator is: the baseline knows of attitude, position, velocity, IMU biases and a flow bias only.
fn filter_settings(settings: &NavigatorSettings) -> (EskfSettings, Matrix4<f64>) {
    let mut filter = settings.kalman;
    let mut flow = *FlowCalibration::new(settings.flow.calibration).covariance();
    if settings.estimator == Kind::Ekf15 {
        filter = EskfSettings {
            gyro_scale_sigma: 0.0,
            magnetic_bias_sigma: 0.0,
            magnetic_bias_walk: 0.0,
            flow_scale_walk: 0.0,
            air: AirModel::default(),
            ..filter
        };
        for i in 2..4 {
            flow.row_mut(i).fill(0.0);
            flow.column_mut(i).fill(0.0);
        }
    }
    (filter, flow)
}
