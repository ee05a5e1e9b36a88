//! The exogenous Kalman filter in the navigator: a second stage over whichever observer is in force (`xkf`).
//!
//! The observers run as for `nlo`. When the observer has converged, and only then, the second stage starts from it, linearised about its
//! trajectory; what the second stage estimates is published and never goes back into the observer. It starts anew when the two disagree
//! for long, or when trusted fixes do not fit it, and it is given up while there is no trajectory to be linearised about (the nose near
//! the vertical), the observer being published then. With GNSS its biases are estimated; in holdover they are frozen, and as the
//! covariance then says nothing of them, the error budget is added to it.
//!
//! The flow's systematic errors are taken out by the calibration before it sees the flow, as for the observers.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::geo::so3;
use crate::observer::xkf::XkfCorrection;
use crate::observer::{BiasMode, EulerState, SpecificForceForm, Xkf, XkfInput, XkfSettings};
use crate::sample::ImuSample;
use crate::time::{AutopilotTime, Span};

use super::event::What;
use super::gnss::{AIDED_SPEED_SIGMA, UNKNOWN_SPEED_SIGMA};
use super::kalman::{
    DISAGREEMENT, DISAGREEMENT_S, HEIGHT_PERIOD_S, HEIGHT_SIGMA_M, LOCKED_OUT_S, MAGNETIC_PERIOD_S,
    START_ACCEL_BIAS, START_GYRO_BIAS, START_TILT, START_VELOCITY, START_YAW,
};
use super::nis::Measured;
use super::settings::Estimator;
use super::solution::{Carrier, Mode};
use super::{Navigator, Place};

/// The second stage has no states for what comes with motion (gyro scale, vibration, the sampling of the stream): its white noise, as a
/// multiple of the shipped filter's, stands for all of it.
const NOISE_FACTOR: f64 = 3.0;

/// The second stage, and when it was last fed.
#[derive(Clone, Debug)]
pub(super) struct SecondStage {
    pub(super) filter: Xkf,
    /// The observer's newest state: what is linearised about.
    about: EulerState,
    magnetic_due: AutopilotTime,
    height_due: AutopilotTime,
    disagree_since: Option<AutopilotTime>,
    locked_out_since: Option<AutopilotTime>,
}

/// What of the second stage is published after an IMU sample.
pub(super) struct SecondOpinion {
    pub(super) r_body_to_ned: Matrix3<f64>,
    pub(super) gyro_bias: Vector3<f64>,
    pub(super) acceleration_ned: Vector3<f64>,
}

impl Navigator {
    /// The observer's state as a point to linearise about.
    fn observed(&self) -> Option<EulerState> {
        EulerState::of_observer(self.state.as_ref()?, Vector3::zeros())
    }

    /// What is linearised about. Without any velocity the observer does not converge, and its trajectory is worth nothing: then the filter
    /// is linearised about its own, as any extended Kalman filter is.
    fn about(&self) -> Option<EulerState> {
        match &self.xkf {
            Some(stage) if self.modes.dead_reckoning() && self.carrier != Carrier::Flow => {
                Some(stage.filter.state()).filter(EulerState::is_regular)
            }
            _ => self.observed(),
        }
    }

    /// Starts the second stage from the observer.
    pub(super) fn start_xkf(&mut self, now: AutopilotTime) {
        if self.settings.estimator != Estimator::Xkf {
            return;
        }
        let Some(about) = self.observed() else {
            self.xkf = None;
            return;
        };
        let k = &self.settings.kalman;
        let settings = XkfSettings {
            gyro_noise: NOISE_FACTOR * k.gyro_noise,
            accel_noise: NOISE_FACTOR * k.accel_noise,
            gyro_bias_walk: k.gyro_bias_walk,
            accel_bias_walk: k.accel_bias_walk,
            flow_bias_time_constant_s: self.fusini.flow_bias_time_constant_s,
            gate_sigma: k.gate_sigma,
            specific_force: SpecificForceForm::WithBias,
        };
        let down = self.height.height_m().map_or(about.position_ned.z, |h| -h);
        let start = EulerState {
            position_ned: Vector3::new(about.position_ned.x, about.position_ned.y, down),
            ..about
        };
        let gnss = self.gnss_sigma_m;
        let sigma = [
            Vector3::new(START_TILT, START_TILT, START_YAW),
            Vector3::new(gnss, gnss, self.height.height_sigma_m().max(HEIGHT_SIGMA_M)),
            Vector3::repeat(START_VELOCITY),
            Vector3::repeat(START_GYRO_BIAS),
            Vector3::repeat(START_ACCEL_BIAS),
        ];
        self.xkf = Some(SecondStage {
            filter: Xkf::new(settings, &start, &sigma, Vector3::zeros()),
            about,
            magnetic_due: now,
            height_due: now,
            disagree_since: None,
            locked_out_since: None,
        });
    }

    /// One IMU sample, after the observer has taken it.
    pub(super) fn predict_xkf(&mut self, s: &ImuSample, dt: f64, place: &Place) -> Option<SecondOpinion> {
        let now = s.time;
        if self.xkf.is_none() && self.modes.mode() == Mode::Aided && self.modes.calm() {
            self.start_xkf(now);
        }
        let biases = if self.modes.dead_reckoning() { BiasMode::Frozen } else { BiasMode::Estimated };
        let input = XkfInput {
            dt_s: dt,
            angular_rate_body: s.angular_rate.raw(),
            specific_force_body: s.specific_force.raw(),
            gravity_ned: place.gravity_ned,
            earth_rate_ned: place.earth_rate_ned,
        };
        let stage = self.xkf.as_mut()?;
        let predicted = stage.filter.predict(&stage.about, &input, biases);
        let sound = predicted.is_ok() && stage.filter.is_finite();
        let Some(about) = self.about().filter(|_| sound) else {
            self.xkf = None;
            return None;
        };
        self.xkf.as_mut()?.about = about;
        self.fuse_slow(now, place);
        self.watch_xkf(now);
        let state = self.xkf.as_ref()?.filter.state();
        let r = state.r_body_to_ned();
        Some(SecondOpinion {
            r_body_to_ned: r,
            gyro_bias: state.gyro_bias,
            acceleration_ned: r * (s.specific_force.raw() - state.accel_bias) + place.gravity_ned,
        })
    }

    /// Height, and the magnetic field, which is Grip's measurement.
    fn fuse_slow(&mut self, now: AutopilotTime, place: &Place) {
        let height = self.height.height_m();
        let magnetic =
            self.magnetic.filter(|(t, _)| now.seconds_since(*t) < MAGNETIC_PERIOD_S).zip(place.field_ned);
        let Some(stage) = &mut self.xkf else { return };
        if let Some(height) = height
            && now >= stage.height_due
        {
            stage.height_due = now + Span::from_seconds(HEIGHT_PERIOD_S);
            let innovation = -height - stage.filter.state().position_ned.z;
            let fused = stage.filter.fuse_position(2, innovation, HEIGHT_SIGMA_M.powi(2));
            self.nis.note(Measured::Height, fused, |c| c.nis);
        }
        let Some(stage) = &mut self.xkf else { return };
        if let Some(((_, body), field)) = magnetic
            && now >= stage.magnetic_due
        {
            stage.magnetic_due = now + Span::from_seconds(MAGNETIC_PERIOD_S);
            let variance = self.settings.magnetometer_sigma_t.powi(2);
            for axis in 0..3 {
                let Some(stage) = &mut self.xkf else { return };
                let fused = stage.filter.fuse_direction(&stage.about, axis, body[axis], &field, variance);
                self.nis.note(Measured::Magnetometer, fused, |c| c.nis);
            }
        }
    }

    /// The observer watches its second stage.
    fn watch_xkf(&mut self, now: AutopilotTime) {
        let aided = self.modes.mode() == Mode::Aided;
        let Some(stage) = &mut self.xkf else { return };
        let apart = so3::angle_between(&stage.filter.state().r_body_to_ned(), &stage.about.r_body_to_ned());
        if apart < DISAGREEMENT || !aided {
            stage.disagree_since = None;
            return;
        }
        let since = *stage.disagree_since.get_or_insert(now);
        if now.seconds_since(since) > DISAGREEMENT_S && self.modes.calm() {
            self.start_xkf(now);
            self.tell(now, What::FilterRestarted(apart));
        }
    }

    /// A fix that was accepted: horizontal errors against the past it belongs to.
    pub(super) fn fuse_fix_xkf(
        &mut self,
        now: AutopilotTime,
        e_p: &Vector2<f64>,
        e_v: Option<&Vector2<f64>>,
        accuracy: [f64; 2],
    ) {
        if self.xkf.is_none() {
            return;
        }
        let mut moved =
            XkfCorrection { position_ned: Vector3::zeros(), velocity_ned: Vector3::zeros(), nis: 0.0 };
        let mut taken = true;
        for axis in 0..2 {
            // What the components before it have changed already.
            let Some(stage) = &mut self.xkf else { return };
            let innovation = e_p[axis] - moved.position_ned[axis];
            let fused = stage.filter.fuse_position(axis, innovation, accuracy[0].powi(2));
            match self.nis.note(Measured::GnssPosition, fused, |c| c.nis) {
                Some(c) => moved.add(&c),
                None => taken = false,
            }
        }
        if let Some(e_v) = e_v {
            for axis in 0..2 {
                let Some(stage) = &mut self.xkf else { return };
                let innovation = e_v[axis] - moved.velocity_ned[axis];
                let fused = stage.filter.fuse_velocity(axis, innovation, accuracy[1].powi(2));
                if let Some(c) = self.nis.note(Measured::GnssVelocity, fused, |c| c.nis) {
                    moved.add(&c);
                }
            }
        }
        self.history.correct(now, &moved.position_ned, &moved.velocity_ned);
        if self.modes.mode() == Mode::Rejoining {
            // On the way back the published position glides; what the filter still corrects is part of the way.
            self.offset_ned -= Vector3::new(moved.position_ned.x, moved.position_ned.y, 0.0);
        }
        let aided = self.modes.mode() == Mode::Aided;
        let Some(stage) = &mut self.xkf else { return };
        stage.locked_out_since = if taken { None } else { Some(stage.locked_out_since.unwrap_or(now)) };
        if aided && stage.locked_out_since.is_some_and(|t| now.seconds_since(t) > LOCKED_OUT_S) {
            // GNSS is trusted and the filter will not have it: then the filter is wrong.
            self.take_fix_over();
            self.start_xkf(now);
            self.history.clear();
            self.reset_counter = self.reset_counter.wrapping_add(1);
            self.tell(now, What::Reset(e_p.norm()));
        }
    }

    /// GNSS is back: position and velocity are known anew.
    pub(super) fn rejoin_xkf(
        &mut self,
        position: &Vector2<f64>,
        e_v: Option<&Vector2<f64>>,
        accuracy: [f64; 2],
    ) {
        let Some(stage) = &mut self.xkf else { return };
        let velocity = stage.filter.state().velocity_ned.xy() + e_v.copied().unwrap_or_default();
        let sigma = if e_v.is_some() { accuracy[1].max(AIDED_SPEED_SIGMA) } else { UNKNOWN_SPEED_SIGMA };
        stage.filter.reset_motion(position, &velocity, accuracy[0], sigma);
        self.history.clear();
    }

    /// A flow velocity of `time`, taken at the attitude `r_body_to_ned`. False when it was gated out.
    pub(super) fn fuse_flow_xkf(
        &mut self,
        now: AutopilotTime,
        time: AutopilotTime,
        flow_xy: &Vector2<f64>,
        r_body_to_ned: &Matrix3<f64>,
        variance_xy: &Vector2<f64>,
    ) -> bool {
        let past = self.history.motion(time).or_else(|| self.estimate());
        let corrected = self.carrier_index().map(|sensor| self.corrected(sensor, flow_xy));
        let (Some((_, velocity)), Some(corrected), Some(stage)) = (past, corrected, &mut self.xkf) else {
            return true;
        };
        let innovation = corrected - r_body_to_ned.tr_mul(&velocity).xy();
        match stage.filter.fuse_late_flow(&stage.about, &innovation, variance_xy) {
            Ok(corrections) => {
                for c in corrections {
                    self.nis.fused(Measured::Flow, c.nis);
                    self.history.correct(now, &c.position_ned, &c.velocity_ned);
                }
                true
            }
            Err(_) => {
                self.nis.gated(Measured::Flow);
                false
            }
        }
    }

    /// Covariances of position and velocity of the filter that is published, if one is.
    pub(super) fn filter_covariance(&self) -> Option<(Matrix3<f64>, Matrix3<f64>)> {
        match (&self.kalman, &self.xkf) {
            (Some(k), _) => Some((k.filter.position_covariance(), k.filter.velocity_covariance())),
            (None, Some(stage)) => {
                let (mut p, mut v) = (stage.filter.position_covariance(), stage.filter.velocity_covariance());
                if let (Some(budget), Some(now)) = (&self.budget, self.last_imu) {
                    let mut p_ne = p.fixed_view_mut::<2, 2>(0, 0);
                    p_ne += budget.position(self.has_magnetometer(now));
                    let mut v_ne = v.fixed_view_mut::<2, 2>(0, 0);
                    v_ne += budget.velocity();
                }
                Some((p, v))
            }
            (None, None) => None,
        }
    }

    /// Covariance of the attitude of the filter that is published, about the NED axes.
    pub(super) fn filter_attitude_covariance(&self) -> Option<Matrix3<f64>> {
        match (&self.kalman, &self.xkf) {
            (Some(k), _) => Some(k.filter.attitude_covariance_ned()),
            (None, Some(stage)) => Some(stage.filter.attitude_covariance_ned()),
            (None, None) => None,
        }
    }

    /// Whether a filter is published, of whichever kind.
    pub(super) fn filtered(&self) -> bool {
        self.kalman.is_some() || self.xkf.is_some()
    }
}

impl XkfCorrection {
    /// The sum of both, in place.
    fn add(&mut self, other: &XkfCorrection) {
        self.position_ned += other.position_ned;
        self.velocity_ned += other.velocity_ned;
    }
}
