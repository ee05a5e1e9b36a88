//! The mode machine: Aligning → Aided → Holdover → Rejoining → Aided, and Lost; and the uncertainty that goes with each mode.

use nalgebra::{Matrix2, Matrix2x4, Matrix3, Vector2, Vector3};

use crate::altimeter::HeightFilter;
use crate::time::AutopilotTime;

use super::Navigator;
use super::budget::ErrorBudget;
use super::event::{What, Why};
use super::gnss::VERTICAL_RATIO;
use super::height::HeightState;
use super::inertial::FLOW_AGE_S;
use super::settings::ObserverSettings;
use super::solution::{Carrier, Mode};
use super::trust::{GnssFault, GnssState, GnssTrust};

/// The position has joined GNSS when it is this near, m.
const JOINED_M: f64 = 0.05;
/// Attitude uncertainty while aligning, rad.
const UNKNOWN_ATTITUDE: f64 = 0.5;
/// What carries is told when it has carried for this long, s.
const CARRIER_TOLD_S: f64 = 3.0;
/// Velocity uncertainty with GNSS, m/s.
const AIDED_VELOCITY_SIGMA: f64 = 0.15;
/// What "not known" is in metres and m/s: for a solution that is still aligning.
const UNKNOWN_M: f64 = 1e4;
const UNKNOWN_MPS: f64 = 100.0;

/// Mode and what decides about it.
#[derive(Clone, Debug)]
pub(super) struct ModeState {
    mode: Mode,
    started: Option<AutopilotTime>,
    /// When the attitude got its first guess.
    attitude_started: Option<AutopilotTime>,
    /// Since when the injection has been small.
    calm_since: Option<AutopilotTime>,
    coasting_since: Option<AutopilotTime>,
    /// What carries in this outage, and since when.
    carried: Option<(Carrier, AutopilotTime)>,
    /// Which of them was told last.
    carrier_told: Option<Carrier>,
}

impl ModeState {
    pub(super) fn new() -> Self {
        Self {
            mode: Mode::Aligning,
            started: None,
            attitude_started: None,
            calm_since: None,
            coasting_since: None,
            carried: None,
            carrier_told: None,
        }
    }

    pub(super) fn mode(&self) -> Mode {
        self.mode
    }

    /// Whether Fusini's dead-reckoning equations are in force.
    pub(super) fn dead_reckoning(&self) -> bool {
        matches!(self.mode, Mode::Holdover | Mode::Lost)
    }

    pub(super) fn started(&mut self, time: AutopilotTime) {
        self.started = Some(time);
    }

    pub(super) fn seconds_since_start(&self, now: AutopilotTime) -> f64 {
        self.started.map_or(0.0, |t| now.seconds_since(t))
    }

    pub(super) fn attitude_started(&mut self, time: AutopilotTime) {
        self.attitude_started = Some(time);
    }

    pub(super) fn seconds_since_attitude(&self, now: AutopilotTime) -> f64 {
        self.attitude_started.map_or(0.0, |t| now.seconds_since(t))
    }

    /// Takes the norm of the attitude injection: small for long enough is an attitude found.
    pub(super) fn injection(&mut self, now: AutopilotTime, norm: Option<f64>, settings: &ObserverSettings) {
        match norm {
            Some(n) if n < settings.aligned_injection => {
                self.calm_since.get_or_insert(now);
            }
            Some(_) => self.calm_since = None,
            // Without reference vectors nothing is learned; what was found still holds.
            None => {}
        }
    }

    /// Whether the injection is small at present.
    pub(super) fn calm(&self) -> bool {
        self.calm_since.is_some()
    }

    fn attitude_found(&self, now: AutopilotTime, settings: &ObserverSettings) -> bool {
        self.calm_since.is_some_and(|t| now.seconds_since(t) >= settings.aligned_s)
    }
}

impl Navigator {
    /// Looks at what has changed since the last IMU sample.
    pub(super) fn advance_mode(&mut self, now: AutopilotTime, dt: f64) {
        let trusted = self.trust.trusted();
        match self.modes.mode {
            Mode::Aligning => {
                let found = self.modes.attitude_found(now, &self.settings.observer);
                if !trusted || self.height.height_m().is_none() {
                    return;
                }
                if found {
                    self.take_fix_over();
                    self.start_kalman(now);
                    self.change_mode(now, Mode::Aided, Why::Aligned);
                } else if let Some(estimate) = self.heading_found() {
                    self.align_by_motion(now, &estimate);
                    self.change_mode(now, Mode::Aided, Why::Aligned);
                }
            }
            Mode::Aided => {
                if !trusted {
                    self.enter_holdover(now);
                }
            }
            Mode::Holdover => {
                self.grow(now, dt);
                self.give_up_if_uncertain(now);
            }
            Mode::Rejoining => {
                if trusted {
                    self.glide(now, dt);
                } else {
                    self.enter_holdover(now);
                }
            }
            // The way out of Lost is a GNSS that is trusted again: see `came_back`.
            Mode::Lost => self.grow(now, dt),
        }
    }

    pub(super) fn change_mode(&mut self, time: AutopilotTime, to: Mode, why: Why) {
        let from = self.modes.mode;
        if from == to {
            return;
        }
        self.modes.mode = to;
        self.modes.coasting_since = None;
        if !matches!(to, Mode::Holdover | Mode::Lost) {
            self.modes.carried = None;
            self.modes.carrier_told = None;
        }
        if to == Mode::Aligning {
            self.modes.calm_since = None;
        }
        self.carrier = match to {
            Mode::Holdover | Mode::Lost => self.carrier,
            _ => Carrier::Gnss,
        };
        self.tell(time, What::Mode { from, to, why });
    }

    /// The autopilot rebooted: the vehicle stands, nothing else is certain.
    pub fn reboot(&mut self, time: AutopilotTime) {
        self.broken_off(time, Why::Reboot);
        self.change_mode(time, Mode::Aligning, Why::Reboot);
        self.state = None;
        self.last_imu = None;
        self.magnetic = None;
        // Nobody knows how high it stands.
        self.height = HeightFilter::new(self.settings.height.kind, self.settings.height.altimeter);
        self.heights = HeightState::default();
        self.trust.height_fault(false);
        (self.ground_m, self.ground_disputed_since) = (None, None);
        self.forget_flow_times();
        self.offset_ned = Vector3::zeros();
        self.reset_counter = self.reset_counter.wrapping_add(1);
    }

    /// The clock was set back: no time that is remembered can be compared with those that come.
    pub(super) fn forget_times(&mut self) {
        self.trust = GnssTrust::new(self.settings.gnss.trust);
        self.receiver_heard = None;
        self.magnetic_same = None;
        self.imu_same_since = None;
        self.ground_disputed_since = None;
        (self.airspeed, self.airspeed_used) = (None, None);
    }

    /// On the first entry the estimate is set to the measurement signal: the observer's transient is over for the attitude only.
    pub(super) fn take_fix_over(&mut self) {
        if let (Some(w), Some(state)) = (self.predictor.latest(), &mut self.state) {
            state.position_ned = w.position_ned;
            state.velocity_ned = w.velocity_ned;
        }
        self.offset_ned = Vector3::zeros();
        self.budget = None;
    }

    fn enter_holdover(&mut self, now: AutopilotTime) {
        let GnssState::Untrusted(fault) = self.trust.state() else { return };
        if fault == GnssFault::Inconsistent {
            // What the slow lie added is taken back; the published position glides after it.
            let walked = self.trust.run_away();
            let walked = Vector3::new(walked.x, walked.y, 0.0);
            self.move_estimate(&-walked);
            self.history.clear();
            self.offset_ned += walked;
            self.tell(now, What::WalkedBack(walked.norm()));
        }
        // Gliding on without GNSS would be a wrong velocity: where it was published to be is where it is, plus what is missing.
        let start = Matrix2::identity() * self.gnss_sigma_m.powi(2) + offset_covariance(&self.offset_ned);
        let calibration = self.carrying_calibration();
        self.budget = Some(ErrorBudget::new(self.settings.holdover.budget, start, *calibration.covariance()));
        self.carrier = Carrier::Inertial;
        self.change_mode(now, Mode::Holdover, Why::GnssLost(fault));
    }

    /// The uncertainty of dead reckoning grows.
    fn grow(&mut self, now: AutopilotTime, dt: f64) {
        let flowing =
            self.flow_body.is_some_and(|(t, _)| now.seconds_since(t) < FLOW_AGE_S) && self.flows_carry();
        self.carrier = if flowing {
            Carrier::Flow
        } else if self.resting() {
            Carrier::Standstill
        } else if self.carried_by_air(now) {
            Carrier::Airspeed
        } else if self.carried_by_drag(now) {
            Carrier::Drag
        } else {
            Carrier::Inertial
        };
        self.tell_carrier(now);
        if self.shown_carrier(now) != Carrier::Inertial {
            self.modes.coasting_since = None;
        } else if let Some(budget) = &mut self.budget {
            budget.coasted(dt);
            self.modes.coasting_since.get_or_insert(now);
        }
        self.glide_step(dt);
    }

    /// Tells what carries, once it has done so for a while: flow comes and goes with the ground.
    fn tell_carrier(&mut self, now: AutopilotTime) {
        let carrier = self.shown_carrier(now);
        let (_, since) = *self
            .modes
            .carried
            .insert(self.modes.carried.filter(|(of, _)| *of == carrier).unwrap_or((carrier, now)));
        if now.seconds_since(since) > CARRIER_TOLD_S && self.modes.carrier_told != Some(carrier) {
            self.modes.carrier_told = Some(carrier);
            self.tell(now, What::Carried(carrier));
        }
    }

    fn give_up_if_uncertain(&mut self, now: AutopilotTime) {
        let limits = &self.settings.holdover;
        let sigma = self.solution().map_or(f64::INFINITY, |s| s.horizontal_sigma_m());
        let coasted = self.modes.coasting_since.map_or(0.0, |t| now.seconds_since(t));
        if sigma > limits.max_sigma_m || sigma.is_nan() {
            self.change_mode(now, Mode::Lost, Why::Uncertain(sigma));
        } else if coasted > limits.max_coast_s {
            self.change_mode(now, Mode::Lost, Why::Coasted(coasted));
        }
    }

    fn flows_carry(&self) -> bool {
        self.settings.estimator != super::Estimator::Inertial
            && self.flow_sensors().any(|(_, _, trust)| trust.is_ok())
    }

    /// The budget's part of a flow sample that was used.
    pub(super) fn carried_by_flow(
        &mut self,
        dt: f64,
        r_body_to_ned: &Matrix3<f64>,
        jacobian: &Matrix2x4<f64>,
        v_ne: &Vector2<f64>,
        density: f64,
        ranged: bool,
    ) {
        if let Some(budget) = &mut self.budget {
            budget.carried(dt, r_body_to_ned, jacobian, v_ne, density, ranged);
        }
    }

    /// GNSS is trusted again and the estimate has moved to it; the published position still stands where it was.
    pub(super) fn came_back(&mut self, now: AutopilotTime) {
        let away = self.offset_ned.norm();
        self.budget = None;
        if self.modes.mode == Mode::Lost || away > self.settings.rejoin.jump_m {
            self.offset_ned = Vector3::zeros();
            self.reset_counter = self.reset_counter.wrapping_add(1);
            self.tell(now, What::Reset(away));
            self.change_mode(now, Mode::Aided, Why::GnssBack);
        } else {
            self.change_mode(now, Mode::Rejoining, Why::GnssBack);
        }
    }

    fn glide(&mut self, now: AutopilotTime, dt: f64) {
        self.glide_step(dt);
        if self.offset_ned.norm() < JOINED_M {
            self.offset_ned = Vector3::zeros();
            self.change_mode(now, Mode::Aided, Why::Joined);
        }
    }

    fn glide_step(&mut self, dt: f64) {
        let away = self.offset_ned.norm();
        if away > 0.0 {
            let step = (self.settings.rejoin.glide_mps * dt).min(away);
            self.offset_ned *= 1.0 - step / away;
        }
    }

    pub(super) fn covariances(&self) -> (Matrix3<f64>, Matrix3<f64>) {
        let mut p = Matrix3::identity();
        let mut v = Matrix3::identity();
        // A receiver's error changes over minutes: no averaging takes it out, and it stays when the receiver goes.
        let gnss = Matrix2::identity() * self.anchor_sigma_m().powi(2) + offset_covariance(&self.offset_ned);
        let (p_ne, v_ne) = match (self.modes.mode, self.filter_covariance(), &self.budget, self.last_imu) {
            (Mode::Aligning, ..) => unknown(),
            (_, Some((p, v)), ..) => {
                (p.fixed_view::<2, 2>(0, 0) + gnss, v.fixed_view::<2, 2>(0, 0).into_owned())
            }
            (Mode::Holdover | Mode::Lost, None, Some(budget), Some(now)) => {
                let p = budget.position(self.has_magnetometer(now)) + offset_covariance(&self.offset_ned);
                (p, budget.velocity())
            }
            (Mode::Aided | Mode::Rejoining, ..) => (gnss, Matrix2::identity() * AIDED_VELOCITY_SIGMA.powi(2)),
            _ => unknown(),
        };
        p.fixed_view_mut::<2, 2>(0, 0).copy_from(&p_ne);
        v.fixed_view_mut::<2, 2>(0, 0).copy_from(&v_ne);
        // The height filter averages what a receiver's height is wrong by over minutes, and takes it for the barometer's offset.
        p[(2, 2)] = self.height.height_sigma_m().powi(2)
            + (VERTICAL_RATIO * self.gnss_sigma_m).powi(2)
            + self.heights.offset_m().powi(2);
        v[(2, 2)] = self.height.climb_sigma_mps().powi(2);
        (p, v)
    }

    pub(super) fn attitude_variance(&self) -> Vector3<f64> {
        if self.modes.mode == Mode::Aligning {
            return Vector3::repeat(UNKNOWN_ATTITUDE.powi(2));
        }
        if let Some(c) = self.filter_attitude_covariance() {
            // Near level flight the rotations about north, east and down are roll, pitch and yaw turned by the heading.
            let tilt = 0.5 * (c[(0, 0)] + c[(1, 1)]);
            return Vector3::new(tilt, tilt, c[(2, 2)]);
        }
        let b = &self.settings.holdover.budget;
        let tilt = b.tilt_sigma_rad.powi(2);
        let heading =
            b.heading_sigma_rad.powi(2) + self.settings.flow.calibration.misalignment_sigma_rad.powi(2) * 0.1;
        let drifted = self.budget.as_ref().map_or(0.0, |budget| match self.last_imu {
            Some(now) if !self.has_magnetometer(now) => (b.heading_drift_radps * budget.elapsed_s()).powi(2),
            _ => 0.0,
        });
        Vector3::new(tilt, tilt, heading + drifted)
    }
}

fn unknown() -> (Matrix2<f64>, Matrix2<f64>) {
    (Matrix2::identity() * UNKNOWN_M.powi(2), Matrix2::identity() * UNKNOWN_MPS.powi(2))
}

/// A position that is still gliding is off by what is missing.
fn offset_covariance(offset_ned: &Vector3<f64>) -> Matrix2<f64> {
    let o = offset_ned.xy();
    o * o.transpose()
}
