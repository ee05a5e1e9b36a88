//! The shipped filter: started by the nonlinear observer when that has found the attitude, fed with the same measurements, and watched
//! by the observer from then on.

use nalgebra::{Matrix2, Matrix3, SVector, Vector2, Vector3};

use crate::geo::so3;
use crate::observer::eskf::{Correction, Eskf, EskfState};
use crate::time::ApTime;

use super::Navigator;
use super::event::What;
use super::settings::Estimator;
use super::solution::Mode;

/// Standard deviations at the start: roll and pitch, yaw (rad), velocity (m/s), gyro bias (rad/s), accelerometer bias (m/s²).
const START_TILT: f64 = 0.05;
const START_YAW: f64 = 0.17;
const START_VELOCITY: f64 = 0.7;
const START_GYRO_BIAS: f64 = 0.005;
const START_ACCEL_BIAS: f64 = 0.15;
/// The magnetometer is fused this often, s: its errors are not white.
const MAGNETIC_PERIOD_S: f64 = 0.1;
/// The height is fused this often, s.
const HEIGHT_PERIOD_S: f64 = 0.1;
/// Standard deviation of the height filter's height as a measurement, m.
const HEIGHT_SIGMA_M: f64 = 0.5;
/// Trusted fixes that are gated out for this long mean that the filter is wrong, s.
const LOCKED_OUT_S: f64 = 2.0;
/// Observer and filter disagree when their attitudes differ by this much, rad …
const DISAGREEMENT: f64 = 0.35;
/// … for this long, s.
const DISAGREEMENT_S: f64 = 5.0;

/// The filter and when it was last fed.
#[derive(Clone, Debug)]
pub(super) struct Kalman {
    pub(super) filter: Eskf,
    magnetic_due: ApTime,
    height_due: ApTime,
    disagree_since: Option<ApTime>,
    /// Since when trusted fixes have been gated out.
    locked_out_since: Option<ApTime>,
}

impl Navigator {
    /// Starts the filter from the observer.
    pub(super) fn start_kalman(&mut self, now: ApTime) {
        if !matches!(self.settings.estimator, Estimator::Shipped | Estimator::Inertial) {
            return;
        }
        let (Some(state), Some(r)) = (self.state, self.state.and_then(|s| s.r_body_to_ned())) else { return };
        let position_ned = match self.height.height_m() {
            Some(h) => Vector3::new(state.position_ned.x, state.position_ned.y, -h),
            None => state.position_ned,
        };
        let start = EskfState {
            r_body_to_ned: r,
            position_ned,
            velocity_ned: state.velocity_ned,
            gyro_bias: state.gyro_bias,
            accel_bias: Vector3::zeros(),
            flow: SVector::zeros(),
            magnetic_bias: Vector3::zeros(),
        };
        let gnss = self.gnss_sigma_m;
        // Yaw stands on NED's z axis; body axes take their share of it.
        let attitude = r.tr_mul(&Vector3::new(START_TILT, START_TILT, START_YAW)).abs();
        let sigma = [
            attitude,
            Vector3::new(gnss, gnss, self.height.height_sigma_m().max(HEIGHT_SIGMA_M)),
            Vector3::repeat(START_VELOCITY),
            Vector3::repeat(START_GYRO_BIAS),
            Vector3::repeat(START_ACCEL_BIAS),
        ];
        let unknown = crate::camera::FlowCalibration::new(self.settings.flow.calibration);
        self.kalman = Some(Kalman {
            filter: Eskf::new(self.settings.kalman, start, sigma, unknown.covariance()),
            magnetic_due: now,
            height_due: now,
            disagree_since: None,
            locked_out_since: None,
        });
    }

    /// Position and velocity that are published (but for the glide): the filter's where it runs, else the observer's.
    pub(super) fn estimate(&self) -> Option<(Vector3<f64>, Vector3<f64>)> {
        match (&self.kalman, &self.state) {
            (Some(k), _) => Some((k.filter.state().position_ned, k.filter.state().velocity_ned)),
            (None, Some(s)) => Some((s.position_ned, s.velocity_ned)),
            (None, None) => None,
        }
    }

    /// One IMU sample. Returns the acceleration, if the filter runs.
    pub(super) fn predict_kalman(
        &mut self,
        now: ApTime,
        dt: f64,
        angular_rate: &Vector3<f64>,
        specific_force: &Vector3<f64>,
    ) -> Option<Vector3<f64>> {
        let place = self.place.as_ref()?;
        let (gravity, earth) = (place.gravity_ned, place.earth_rate_ned);
        let field = place.field_ned;
        let magnetic = self.magnetic.filter(|(t, _)| now.seconds_since(*t) < MAGNETIC_PERIOD_S);
        let height = self.height.height_m();
        let kalman = self.kalman.as_mut()?;
        let acceleration = kalman.filter.predict(dt, angular_rate, specific_force, &gravity, &earth);
        if let (Some((_, body)), Some(field)) = (magnetic, field)
            && now >= kalman.magnetic_due
        {
            kalman.magnetic_due = now + crate::time::Span::from_seconds(MAGNETIC_PERIOD_S);
            // A field that does not fit is left out: the observer watches.
            let _gated = kalman.filter.fuse_magnetic(&body, &field, self.settings.magnetometer_sigma_t);
        }
        if let Some(height) = height
            && now >= kalman.height_due
        {
            kalman.height_due = now + crate::time::Span::from_seconds(HEIGHT_PERIOD_S);
            let innovation = -height - kalman.filter.state().position_ned.z;
            let _gated = kalman.filter.fuse_position(2, innovation, HEIGHT_SIGMA_M * HEIGHT_SIGMA_M);
        }
        if !kalman.filter.is_finite() {
            self.kalman = None;
            return None;
        }
        self.watch(now);
        Some(acceleration)
    }

    /// The observer watches: attitudes that stay apart while GNSS is good mean that the filter has gone astray.
    fn watch(&mut self, now: ApTime) {
        let (Some(kalman), Some(r)) = (&mut self.kalman, self.state.and_then(|s| s.r_body_to_ned())) else {
            return;
        };
        let apart = so3::angle_between(&kalman.filter.state().r_body_to_ned, &r);
        if apart < DISAGREEMENT || self.modes.mode() != Mode::Aided {
            kalman.disagree_since = None;
            return;
        }
        let since = *kalman.disagree_since.get_or_insert(now);
        if now.seconds_since(since) > DISAGREEMENT_S && self.modes.calm() {
            self.start_kalman(now);
            self.tell(now, What::FilterRestarted(apart));
        }
    }

    /// A fix that was accepted: horizontal errors against the past it belongs to.
    pub(super) fn fuse_fix(
        &mut self,
        now: ApTime,
        e_p: &Vector2<f64>,
        e_v: Option<&Vector2<f64>>,
        accuracy: [f64; 2],
    ) {
        let Some(kalman) = &mut self.kalman else { return };
        let mut corrections = [None; 4];
        for axis in 0..2 {
            corrections[axis] = kalman.filter.fuse_position(axis, e_p[axis], accuracy[0].powi(2)).ok();
        }
        if let Some(e_v) = e_v {
            for axis in 0..2 {
                // What the position has changed already of the velocity's innovation.
                let moved: f64 = corrections.iter().flatten().map(|c| c.velocity_ned[axis]).sum();
                corrections[2 + axis] =
                    kalman.filter.fuse_velocity(axis, e_v[axis] - moved, accuracy[1].powi(2)).ok();
            }
        }
        let taken = corrections.iter().take(2).all(Option::is_some);
        kalman.locked_out_since = if taken { None } else { Some(kalman.locked_out_since.unwrap_or(now)) };
        let locked_out = kalman.locked_out_since.is_some_and(|t| now.seconds_since(t) > LOCKED_OUT_S);
        let moved = self.carry_back(now, corrections.iter().flatten());
        if self.modes.mode() == Mode::Rejoining {
            // On the way back the published position glides; what the filter still corrects is part of the way.
            self.offset_ned -= Vector3::new(moved.x, moved.y, 0.0);
        }
        if locked_out && self.modes.mode() == Mode::Aided {
            // GNSS is trusted and the filter will not have it: then the filter is wrong.
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
        now: ApTime,
        time: ApTime,
        flow_xy: &Vector2<f64>,
        r_body_to_ned: &Matrix3<f64>,
        covariance: &Matrix2<f64>,
    ) -> bool {
        let past = self.history.motion(time).or_else(|| self.estimate());
        let (Some((_, velocity)), Some(kalman)) = (past, &mut self.kalman) else { return true };
        match kalman.filter.fuse_flow(flow_xy, &velocity, r_body_to_ned, covariance) {
            Ok(corrections) => {
                self.carry_back(now, corrections.iter());
                true
            }
            Err(_) => false,
        }
    }

    /// The position is somewhere else by `by`: no measurement, a decision.
    pub(super) fn move_estimate(&mut self, by: &Vector3<f64>) {
        if let Some(kalman) = &mut self.kalman {
            kalman.filter.shift_origin(&-by);
        }
        if let Some(state) = &mut self.state {
            state.position_ned += by;
        }
    }

    /// Carries corrections into the remembered past; returns what they moved the position by.
    fn carry_back<'a>(
        &mut self,
        now: ApTime,
        corrections: impl Iterator<Item = &'a Correction>,
    ) -> Vector3<f64> {
        let (mut p, mut v) = (Vector3::zeros(), Vector3::zeros());
        for c in corrections {
            p += c.position_ned;
            v += c.velocity_ned;
        }
        self.history.correct(now, &p, &v);
        p
    }
}
