//! The shipped filter: started by the nonlinear observer when that has found the attitude, fed with the same measurements, and watched
//! by the observer from then on.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use crate::camera::FlowCalibration;
use crate::filter::error_state::{AirModel, Correction, Eskf, EskfSettings, EskfState, Lag, StartSigma};
use crate::geo::so3;
use crate::time::{AutopilotTime, Span};

use super::Navigator;
use super::event::{What, Why};
use super::nis::Measured;
use super::settings::Estimator;
use super::solution::Mode;

/// Standard deviations at the start: roll and pitch, yaw (rad), velocity (m/s), gyro bias (rad/s), accelerometer bias (m/s²).
pub(super) const START_TILT: f64 = 0.05;
pub(super) const START_YAW: f64 = 0.17;
pub(super) const START_VELOCITY: f64 = 0.7;
pub(super) const START_GYRO_BIAS: f64 = 0.005;
pub(super) const START_ACCEL_BIAS: f64 = 0.15;
/// The magnetometer is fused this often, s: its errors are not white.
pub(super) const MAGNETIC_PERIOD_S: f64 = 0.1;
/// The height is fused this often, s.
pub(super) const HEIGHT_PERIOD_S: f64 = 0.1;
/// Standard deviation of the height filter's height as a measurement, m.
pub(super) const HEIGHT_SIGMA_M: f64 = 0.5;
/// Trusted fixes that are gated out for this long mean that the filter is wrong, s.
pub(super) const LOCKED_OUT_S: f64 = 2.0;
/// Observer and filter disagree when their attitudes differ by this much, rad …
pub(super) const DISAGREEMENT: f64 = 0.35;
/// … for this long, s.
pub(super) const DISAGREEMENT_S: f64 = 5.0;
/// tr(RᵀR̂) above this is an angle far below that, however little orthonormal R̂ is.
const NEARLY_THE_SAME: f64 = 2.95;

/// Standard deviations of what the filter starts from: roll and pitch, yaw (rad), velocity (m/s), gyro bias (rad/s).
pub(super) struct StartSigmas {
    pub(super) tilt: f64,
    pub(super) yaw: f64,
    pub(super) velocity: f64,
    pub(super) gyro_bias: f64,
    /// Noise densities that the gyros (rad/s/√Hz) and accelerometers (m/s²/√Hz) are known to have at least.
    pub(super) gyro_noise: f64,
    pub(super) accel_noise: f64,
}

impl StartSigmas {
    /// Of an observer that has found the attitude.
    const OBSERVED: Self = Self {
        tilt: START_TILT,
        yaw: START_YAW,
        velocity: START_VELOCITY,
        gyro_bias: START_GYRO_BIAS,
        gyro_noise: 0.0,
        accel_noise: 0.0,
    };
}

/// The filter and when it was last fed.
#[derive(Clone, Debug)]
pub(super) struct Kalman {
    pub(super) filter: Eskf,
    magnetic_due: AutopilotTime,
    height_due: AutopilotTime,
    disagree_since: Option<AutopilotTime>,
    /// Since when trusted fixes have been gated out.
    locked_out_since: Option<AutopilotTime>,
}

impl Navigator {
    /// What the filter of this estimator is: the baseline knows of attitude, position, velocity, IMU biases and a flow bias only.
    fn kalman_settings(&self) -> (EskfSettings, nalgebra::Matrix4<f64>) {
        let mut settings = self.settings.kalman;
        let mut flow = *FlowCalibration::new(self.settings.flow.calibration).covariance();
        if self.settings.estimator == Estimator::Ekf15 {
            settings = EskfSettings {
                gyro_scale_sigma: 0.0,
                magnetic_bias_sigma: 0.0,
                magnetic_bias_walk: 0.0,
                flow_scale_walk: 0.0,
                air: AirModel::default(),
                ..settings
            };
            for i in 2..4 {
                flow.row_mut(i).fill(0.0);
                flow.column_mut(i).fill(0.0);
            }
        }
        (settings, flow)
    }

    /// Starts the filter from the observer.
    pub(super) fn start_kalman(&mut self, now: AutopilotTime) {
        self.start_kalman_as(now, &StartSigmas::OBSERVED);
    }

    /// Starts the filter from the observer's state, known this well.
    pub(super) fn start_kalman_as(&mut self, now: AutopilotTime, known: &StartSigmas) {
        if !self.settings.estimator.has_filter() {
            return;
        }
        let (Some(state), Some(r)) = (self.state, self.state.and_then(|s| s.r_body_to_ned())) else { return };
        let position_ned = match self.height.height_m() {
            Some(h) => Vector3::new(state.position_ned.x, state.position_ned.y, -h),
            None => state.position_ned,
        };
        let start = EskfState {
            drag: self.settings.drag.coefficient,
            ..EskfState::moving(r, position_ned, state.velocity_ned, state.gyro_bias)
        };
        let gnss = self.gnss_sigma_m;
        let (mut settings, flow) = self.kalman_settings();
        settings.gyro_noise = settings.gyro_noise.max(known.gyro_noise);
        settings.accel_noise = settings.accel_noise.max(known.accel_noise);
        let sigma = StartSigma {
            // Yaw stands on NED's z axis; body axes take their share of it.
            attitude_body: r.tr_mul(&Vector3::new(known.tilt, known.tilt, known.yaw)).abs(),
            position_ned: Vector3::new(gnss, gnss, self.height.height_sigma_m().max(HEIGHT_SIGMA_M)),
            velocity_ned: Vector3::repeat(known.velocity),
            gyro_bias: Vector3::repeat(known.gyro_bias),
            accel_bias: Vector3::repeat(START_ACCEL_BIAS),
            flow,
        };
        self.kalman = Some(Kalman {
            filter: Eskf::new(settings, start, &sigma),
            magnetic_due: now,
            height_due: now,
            disagree_since: None,
            locked_out_since: None,
        });
    }

    /// Position and velocity that are published (but for the glide): the filter's where it runs, else the observer's.
    pub(super) fn estimate(&self) -> Option<(Vector3<f64>, Vector3<f64>)> {
        match (&self.kalman, &self.xkf, &self.state) {
            (Some(k), ..) => Some((k.filter.state().position_ned, k.filter.state().velocity_ned)),
            (None, Some(x), _) => Some((x.filter.state().position_ned, x.filter.state().velocity_ned)),
            (None, None, Some(s)) => Some((s.position_ned, s.velocity_ned)),
            (None, None, None) => None,
        }
    }

    /// One IMU sample. Returns the acceleration, if the filter runs.
    pub(super) fn predict_kalman(
        &mut self,
        now: AutopilotTime,
        dt: f64,
        angular_rate: &Vector3<f64>,
        specific_force: &Vector3<f64>,
    ) -> Option<Vector3<f64>> {
        let place = self.place.as_ref()?;
        let (gravity, earth) = (place.gravity_ned, place.earth_rate_ned);
        let height = self.height.height_m();
        let kalman = self.kalman.as_mut()?;
        let acceleration = kalman.filter.predict(dt, angular_rate, specific_force, &gravity, &earth);
        if let Some(height) = height
            && now >= kalman.height_due
        {
            kalman.height_due = now + Span::from_seconds(HEIGHT_PERIOD_S);
            let innovation = -height - kalman.filter.state().position_ned.z;
            let fused = kalman.filter.fuse_position(2, innovation, HEIGHT_SIGMA_M.powi(2), &Lag::NONE);
            self.nis.note(Measured::Height, fused, |c| c.nis);
        }
        if !self.kalman.as_ref()?.filter.is_finite() {
            self.kalman = None;
            return None;
        }
        self.watch(now);
        Some(acceleration)
    }

    /// A magnetometer vector, body, T: fused every so often. False when it did not fit.
    pub(super) fn fuse_magnetic(&mut self, time: AutopilotTime, body: &Vector3<f64>) -> bool {
        let Some(field) = self.place.as_ref().and_then(|p| p.field_ned) else { return true };
        let Some(kalman) = self.kalman.as_mut().filter(|k| time >= k.magnetic_due) else { return true };
        kalman.magnetic_due = time + Span::from_seconds(MAGNETIC_PERIOD_S);
        match kalman.filter.fuse_magnetic(body, &field, self.settings.magnetometer_sigma_t) {
            Ok(nis) => {
                self.nis.fused(Measured::Magnetometer, nis);
                true
            }
            Err(_) => {
                self.nis.gated(Measured::Magnetometer);
                false
            }
        }
    }

    /// The observer watches: attitudes that stay apart while GNSS is good mean that the filter has gone astray.
    fn watch(&mut self, now: AutopilotTime) {
        // An observer that follows the filter has nothing to say about it.
        let watching = self.modes.mode() == Mode::Aided && !self.led(now);
        let (Some(kalman), Some(state)) = (&mut self.kalman, &self.state) else { return };
        if !watching {
            kalman.disagree_since = None;
            return;
        }
        // tr(RᵀR̂) = 1 + 2 cos φ: near 3 they agree, and R̂ need not be made orthonormal to see it.
        let filter = kalman.filter.state().r_body_to_ned;
        let near = filter.component_mul(&state.r_hat).sum() > NEARLY_THE_SAME;
        let apart =
            if near { Some(0.0) } else { state.r_body_to_ned().map(|r| so3::angle_between(&filter, &r)) };
        let Some(apart) = apart.filter(|a| *a >= DISAGREEMENT) else {
            kalman.disagree_since = None;
            return;
        };
        let since = *kalman.disagree_since.get_or_insert(now);
        if now.seconds_since(since) > DISAGREEMENT_S && self.modes.calm() {
            self.start_kalman(now);
            self.tell(now, What::FilterRestarted(apart));
        }
    }

    /// What lies between the time of a measurement and now, for the filter.
    pub(super) fn lag(
        &self,
        now: AutopilotTime,
        measured: AutopilotTime,
        then_velocity: &Vector3<f64>,
    ) -> Lag {
        let seconds = now.seconds_since(measured);
        match (&self.kalman, &self.place) {
            (Some(k), Some(place)) if seconds > 0.0 => Lag {
                seconds,
                impulse_ned: k.filter.state().velocity_ned - then_velocity - place.gravity_ned * seconds,
            },
            _ => Lag::NONE,
        }
    }

    /// A fix that was accepted, measured at `measured`: horizontal errors against the past it belongs to.
    pub(super) fn fuse_fix(
        &mut self,
        now: AutopilotTime,
        measured: AutopilotTime,
        e_p: &Vector2<f64>,
        e_v: Option<&Vector2<f64>>,
        accuracy: [f64; 2],
    ) {
        let lag = match self.history.motion(measured) {
            Some((_, then)) => self.lag(now, measured, &then),
            None => Lag::NONE,
        };
        let Some(kalman) = &mut self.kalman else { return self.fuse_fix_xkf(now, e_p, e_v, accuracy) };
        let fused = kalman.filter.fuse_fix(e_p, e_v, accuracy.map(|a| a * a), &lag);
        let kinds =
            [Measured::GnssPosition, Measured::GnssPosition, Measured::GnssVelocity, Measured::GnssVelocity];
        let mut corrections = [None; 4];
        for i in 0..4 {
            corrections[i] = fused[i].and_then(|f| self.nis.note(kinds[i], f, |c| c.nis));
        }
        let Some(kalman) = &mut self.kalman else { return };
        let taken = corrections.iter().take(2).all(Option::is_some);
        kalman.locked_out_since = if taken { None } else { Some(kalman.locked_out_since.unwrap_or(now)) };
        let locked_out = kalman.locked_out_since.is_some_and(|t| now.seconds_since(t) > LOCKED_OUT_S);
        self.carry_back(now, corrections.iter().flatten());
        if locked_out && self.modes.mode() == Mode::Aided {
            // GNSS is trusted and the filter will not have it: then the filter is wrong.
            if self.led(now) {
                // The observer knows no better: it only follows.
                return self.broken_off(now, Why::HeadingWrong);
            }
            let apart = e_p.norm();
            self.take_fix_over();
            self.start_kalman(now);
            self.history.clear();
            self.reset_counter = self.reset_counter.wrapping_add(1);
            self.tell(now, What::Reset(apart));
        }
    }

    /// A flow velocity, with the state of its time. False when it was gated out.
    pub(super) fn fuse_flow(
        &mut self,
        now: AutopilotTime,
        time: AutopilotTime,
        flow_xy: &Vector2<f64>,
        r_body_to_ned: &Matrix3<f64>,
        covariance: &Matrix2<f64>,
    ) -> bool {
        if self.kalman.is_none() {
            return self.fuse_flow_xkf(now, time, flow_xy, r_body_to_ned, &covariance.diagonal());
        }
        let past = self.history.motion(time).or_else(|| self.estimate());
        let Some((_, velocity)) = past else { return true };
        let lag = self.lag(now, time, &velocity);
        let Some(kalman) = &mut self.kalman else { return true };
        match kalman.filter.fuse_flow(flow_xy, &velocity, r_body_to_ned, covariance, &lag) {
            Ok(corrections) => {
                for c in &corrections {
                    self.nis.fused(Measured::Flow, c.nis);
                }
                self.carry_back(now, corrections.iter());
                true
            }
            Err(_) => {
                self.nis.gated(Measured::Flow);
                false
            }
        }
    }

    /// The position is somewhere else by `by`: no measurement, a decision.
    pub(super) fn move_estimate(&mut self, by: &Vector3<f64>) {
        if let Some(kalman) = &mut self.kalman {
            kalman.filter.shift_origin(&-by);
        }
        if let Some(stage) = &mut self.xkf {
            stage.filter.shift_position(by);
        }
        if let Some(state) = &mut self.state {
            state.position_ned += by;
        }
    }

    /// Carries corrections into the remembered past. On the way back to GNSS the published position glides, and what the filter still
    /// corrects is part of the way.
    pub(super) fn carry_back<'a>(
        &mut self,
        now: AutopilotTime,
        corrections: impl Iterator<Item = &'a Correction>,
    ) {
        let (mut p, mut v) = (Vector3::zeros(), Vector3::zeros());
        for c in corrections {
            p += c.position_ned;
            v += c.velocity_ned;
        }
        self.history.correct(now, &p, &v);
        if self.modes.mode() == Mode::Rejoining {
            self.offset_ned -= Vector3::new(p.x, p.y, 0.0);
        }
    }
}
