//! PX4's rules of aiding (EKF2 of 1.17, and what was measured on it): the bits of `EKF2_EV_CTRL`, when fusion of external vision starts
//! and stops, the bias that is tracked while GNSS is used, and the reset to the raw position seven seconds after GNSS was lost.

use nalgebra::{Matrix3, Vector3};

use super::axis::AxisQuantity;
use super::external::{ExternalFate, ExternalMessage, ExternalPose, ReportedFrame};
use super::own_filter::{AxisMeasurement, OwnFilter};

/// Parameters of aiding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ekf2Settings {
    /// `EKF2_EV_CTRL`: 1 horizontal position, 2 height, 4 velocity, 8 yaw.
    pub control: u8,
    /// `EKF2_EV_DELAY`, s.
    pub delay_s: f64,
    /// `EKF2_DELAY_MAX`, s: what is older is dropped without a word.
    pub most_delay_s: f64,
    /// `EKF2_EV_QMIN`; 0 asks for nothing.
    pub least_quality: i8,
    /// `EKF2_EVP_NOISE`, a floor, m.
    pub position_noise_m: f64,
    /// `EKF2_EVV_NOISE`, a floor, m/s.
    pub velocity_noise_mps: f64,
    /// `EKF2_NOAID_TOUT`, s.
    pub no_aid_s: f64,
}

impl Ekf2Settings {
    fn horizontal(&self) -> bool {
        self.control & 1 != 0
    }

    fn velocity(&self) -> bool {
        self.control & 4 != 0
    }

    fn heading(&self) -> bool {
        self.control & 8 != 0
    }
}

/// Samples have to be closer than this for fusion to start …, s.
const START_SPACING_S: f64 = 0.2;
/// … for so long, s.
const START_S: f64 = 1.5;
/// Fusion stops when samples are further apart, s.
const STOP_SPACING_S: f64 = 0.4;
/// The failsafe acts this much after the position is lost, s.
const FAILSAFE_AFTER_S: f64 = 0.7;
/// GNSS counts as used for so long after the last fix; then the position is reset to external vision, s.
const GNSS_USED_S: f64 = 7.0;
/// GNSS that comes back has to be good for so long before it is used, s.
const GNSS_GOOD_S: f64 = 8.0;
/// A fix that is further from the next breaks that, s.
const GNSS_GAP_S: f64 = 1.5;
/// Position resets in the air after which external vision is stopped.
const MOST_RESETS: u32 = 5;
/// Estimator types that are read: up to MAV_ESTIMATOR_TYPE_VIO and GPS; the others are refused.
const KNOWN_TYPES: u8 = 5;
/// MAV_ESTIMATOR_TYPE_NAIVE: its covariance is dropped.
const NAIVE: u8 = 1;
/// Quaternions that are further from a norm of 1 lose the heading without a word.
const QUATERNION_TOLERANCE: f64 = 1e-5;
/// Gates, sigmas (`EKF2_EVP_GATE`, `EKF2_EVV_GATE`, `EKF2_GPS_P_GATE`).
const POSITION_GATE: f64 = 5.0;
const VELOCITY_GATE: f64 = 3.0;
/// Noise of GNSS as the EKF assumes it, m and m/s, and its age, s.
const GNSS_NOISE: [f64; 2] = [0.5, 0.3];
const GNSS_DELAY_S: f64 = 0.11;
/// The bias of external vision follows by this part a sample.
const BIAS_PART: f64 = 0.02;
/// Part of a difference of heading that a sample takes out.
const HEADING_PART: f64 = 0.05;
/// Everything that the gates refused for so long is jumped to, s.
const GATE_GIVES_WAY_S: f64 = 7.0;

const HORIZONTAL: &[usize] = &[0, 1];
const ALL: &[usize] = &[0, 1, 2];

/// The state of aiding. Times are seconds of the simulation.
#[derive(Clone, Debug)]
pub struct Ekf2 {
    settings: Ekf2Settings,
    sampled_s: Option<f64>,
    /// Since when samples have come close enough together.
    steady_since_s: Option<f64>,
    reset_counter: Option<u8>,
    resets: u32,
    /// What external vision's position is off by while GNSS is used, m.
    bias: Option<Vector3<f64>>,
    gnss_good_since_s: Option<f64>,
    gnss_heard_s: Option<f64>,
    gnss_fused_s: Option<f64>,
    gnss_in_use: bool,
    position_fused_s: Option<f64>,
    aided_s: Option<f64>,
    ratios: [f64; 2],
}

impl Ekf2 {
    /// An EKF that has just booted.
    pub fn new(settings: Ekf2Settings) -> Self {
        Self {
            settings,
            sampled_s: None,
            steady_since_s: None,
            reset_counter: None,
            resets: 0,
            bias: None,
            gnss_good_since_s: None,
            gnss_heard_s: None,
            gnss_fused_s: None,
            gnss_in_use: false,
            position_fused_s: None,
            aided_s: None,
            ratios: [0.0; 2],
        }
    }

    /// Parameters that were set in flight.
    pub fn set(&mut self, settings: Ekf2Settings) {
        self.settings = settings;
    }

    /// Whether the horizontal position is aided, or was a short while ago.
    pub fn has_position(&self, now_s: f64) -> bool {
        self.aided_s.is_some_and(|t| now_s - t <= self.settings.no_aid_s)
    }

    /// Whether GNSS is used, or was until a short while ago.
    pub fn uses_gnss(&self) -> bool {
        self.gnss_in_use
    }

    /// Whether external vision is fused.
    pub fn uses_external(&self, now_s: f64) -> bool {
        self.sampled_s.is_some_and(|t| now_s - t <= STOP_SPACING_S) && self.started(now_s)
    }

    /// Test ratios of the last velocity and position: above 1 they were refused.
    pub fn ratios(&self) -> [f64; 2] {
        self.ratios
    }

    /// Whether the position has been lost for a moment, and a flight that needs it ends.
    pub fn failsafe(&self, now_s: f64) -> bool {
        !self.has_position(now_s - FAILSAFE_AFTER_S)
    }

    fn started(&self, now_s: f64) -> bool {
        self.resets <= MOST_RESETS && self.steady_since_s.is_some_and(|t| now_s - t >= START_S)
    }

    /// A good fix of GNSS, in the double's frame.
    pub fn gnss(
        &mut self,
        now_s: f64,
        position: &Vector3<f64>,
        velocity: &Vector3<f64>,
        filter: &mut OwnFilter,
    ) {
        let gap = self.gnss_heard_s.replace(now_s).is_none_or(|t| now_s - t > GNSS_GAP_S);
        let since = *self.gnss_good_since_s.filter(|_| !gap).get_or_insert(now_s);
        self.gnss_good_since_s = Some(since);
        if !self.gnss_in_use && now_s - since < GNSS_GOOD_S {
            return;
        }
        let time_s = now_s - GNSS_DELAY_S;
        let p =
            measurement(AxisQuantity::Position, position, &Vector3::repeat(GNSS_NOISE[0].powi(2)), time_s);
        let v =
            measurement(AxisQuantity::Velocity, velocity, &Vector3::repeat(GNSS_NOISE[1].powi(2)), time_s);
        let refused = filter.test_ratio(&p, HORIZONTAL, POSITION_GATE) > 1.0;
        // A position that external vision holds elsewhere is not given up for GNSS.
        let held = self.uses_external(now_s) && self.settings.horizontal();
        let given_way = self.position_fused_s.is_none_or(|t| now_s - t > GATE_GIVES_WAY_S);
        if refused && (held || !given_way) && self.gnss_fused_s.is_some() {
            return;
        }
        if refused || self.gnss_fused_s.is_none() {
            filter.reset(&p, HORIZONTAL);
            filter.reset(&v, HORIZONTAL);
        }
        filter.fuse(&v, ALL);
        filter.fuse(&p, HORIZONTAL);
        self.gnss_in_use = true;
        self.gnss_fused_s = Some(now_s);
        self.position_fused_s = Some(now_s);
        self.aided_s = Some(now_s);
    }

    /// A message of external vision; `stamps_believed` once TIMESYNC has converged, else the time of arrival counts.
    pub fn external(
        &mut self,
        pose: &ExternalPose,
        stamps_believed: bool,
        filter: &mut OwnFilter,
    ) -> ExternalFate {
        let now_s = pose.arrived_s;
        if !self.reads(pose) {
            return ExternalFate::NotRead;
        }
        let stamp_s = if stamps_believed { pose.stamp_s.min(now_s) } else { now_s };
        let time_s = stamp_s - self.settings.delay_s;
        if now_s - time_s > self.settings.most_delay_s {
            return ExternalFate::TooLate;
        }
        let least = self.settings.least_quality;
        if least > 0 && pose.quality().is_some_and(|q| q < least) {
            return ExternalFate::LowQuality;
        }
        let spacing_s = self.sampled_s.replace(stamp_s).map_or(f64::INFINITY, |t| stamp_s - t);
        if spacing_s > if self.started(now_s) { STOP_SPACING_S } else { START_SPACING_S } {
            self.steady_since_s = Some(now_s);
        }
        let jumps = self.reset_counter.replace(pose.reset_counter).is_some_and(|c| c != pose.reset_counter);
        if self.settings.control & 0b1101 == 0 {
            return ExternalFate::NotSelected;
        }
        if !self.started(now_s) {
            return ExternalFate::NotStarted;
        }
        if let (true, Some(r)) = (self.settings.heading(), &pose.attitude)
            && pose.quaternion_error <= QUATERNION_TOLERANCE
        {
            filter.heading_by(r, HEADING_PART);
        }
        let velocity = self.velocity(pose, time_s, filter);
        let position = self.position(pose, time_s, jumps, filter);
        position.or(velocity).unwrap_or(ExternalFate::NotSelected)
    }

    /// Frames, messages and estimator types that PX4 reads.
    fn reads(&self, pose: &ExternalPose) -> bool {
        match pose.message {
            ExternalMessage::Odometry { pose, velocity, estimator_type, .. } => {
                let local = |f| matches!(f, ReportedFrame::LocalNed | ReportedFrame::LocalFrd);
                local(pose)
                    && (local(velocity) || velocity == ReportedFrame::BodyFrd)
                    && estimator_type < KNOWN_TYPES
            }
            ExternalMessage::VisionPosition => true,
            ExternalMessage::VisionSpeed => false,
        }
    }

    /// Variances as told, with a floor, or the floor alone where they are NaN or of a naive estimator.
    fn variance(&self, pose: &ExternalPose, told: &Vector3<f64>, floor: f64) -> Vector3<f64> {
        let naive = matches!(pose.message, ExternalMessage::Odometry { estimator_type: NAIVE, .. });
        told.map(|v| if naive || v.is_nan() { floor.powi(2) } else { v.max(floor.powi(2)) })
    }

    fn velocity(&mut self, pose: &ExternalPose, time_s: f64, filter: &mut OwnFilter) -> Option<ExternalFate> {
        let told = pose.velocity.filter(|_| self.settings.velocity())?;
        // Body velocity is turned by the EKF's own attitude.
        let r = match pose.message {
            ExternalMessage::Odometry { velocity: ReportedFrame::BodyFrd, .. } => *filter.r_body_to_ned(),
            _ => Matrix3::identity(),
        };
        let variance = self.variance(pose, &pose.velocity_variance, self.settings.velocity_noise_mps);
        let m = measurement(AxisQuantity::Velocity, &(r * told), &variance, time_s);
        self.ratios[0] = filter.test_ratio(&m, ALL, VELOCITY_GATE);
        if self.ratios[0] > 1.0 && self.has_position(pose.arrived_s) {
            return Some(ExternalFate::Gated);
        }
        filter.fuse(&m, ALL);
        self.aided_s = Some(pose.arrived_s);
        Some(ExternalFate::Fused)
    }

    fn position(
        &mut self,
        pose: &ExternalPose,
        time_s: f64,
        jumps: bool,
        filter: &mut OwnFilter,
    ) -> Option<ExternalFate> {
        let told = pose.position.filter(|_| self.settings.horizontal())?;
        let now_s = pose.arrived_s;
        let variance = self.variance(pose, &pose.position_variance, self.settings.position_noise_m);
        let raw = measurement(AxisQuantity::Position, &told, &variance, time_s);
        if self.gnss_in_use {
            return Some(self.beside_gnss(&raw, now_s, jumps, filter));
        }
        // GNSS is gone: the first sample after that is jumped to, raw.
        let first = self.bias.take().is_some() || self.position_fused_s.is_none();
        self.ratios[1] = filter.test_ratio(&raw, HORIZONTAL, POSITION_GATE);
        let given_way = self.position_fused_s.is_none_or(|t| now_s - t > GATE_GIVES_WAY_S);
        if first || jumps || given_way {
            self.resets += u32::from(jumps);
            filter.reset(&raw, HORIZONTAL);
        } else if self.ratios[1] > 1.0 {
            return Some(ExternalFate::Gated);
        } else {
            filter.fuse(&raw, HORIZONTAL);
        }
        self.position_fused_s = Some(now_s);
        self.aided_s = Some(now_s);
        Some(if first || jumps || given_way { ExternalFate::Jumped } else { ExternalFate::Fused })
    }

    /// While GNSS is used only the bias of external vision is tracked; when fixes stop, vision less that bias carries the position.
    fn beside_gnss(
        &mut self,
        raw: &AxisMeasurement,
        now_s: f64,
        jumps: bool,
        filter: &mut OwnFilter,
    ) -> ExternalFate {
        let off = filter.innovation(raw);
        let fixes_come = self.gnss_fused_s.is_some_and(|t| now_s - t < 1.0);
        let bias = match self.bias.filter(|_| !jumps) {
            Some(bias) if fixes_come => bias + (off - bias) * BIAS_PART,
            Some(bias) => bias,
            None => off,
        };
        self.bias = Some(bias);
        if fixes_come {
            return ExternalFate::NotSelected;
        }
        let m = AxisMeasurement { value_ned: raw.value_ned - bias, ..*raw };
        self.ratios[1] = filter.test_ratio(&m, HORIZONTAL, POSITION_GATE);
        if self.ratios[1] > 1.0 {
            return ExternalFate::Gated;
        }
        filter.fuse(&m, HORIZONTAL);
        self.aided_s = Some(now_s);
        ExternalFate::Fused
    }

    /// Goes on by a step: GNSS that is gone for long enough is no longer in use, and the compass gives the heading.
    pub fn step(&mut self, now_s: f64, dt_s: f64, filter: &mut OwnFilter) {
        if self.gnss_in_use && self.gnss_fused_s.is_none_or(|t| now_s - t > GNSS_USED_S) {
            self.gnss_in_use = false;
        }
        if !(self.settings.heading() && self.uses_external(now_s)) {
            filter.heading_by_compass(dt_s);
        }
    }
}

fn measurement(
    what: AxisQuantity,
    value_ned: &Vector3<f64>,
    variance: &Vector3<f64>,
    time_s: f64,
) -> AxisMeasurement {
    AxisMeasurement { what, value_ned: *value_ned, variance: *variance, time_s }
}

#[cfg(test)]
mod tests;
