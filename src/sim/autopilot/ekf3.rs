//! ArduPilot's rules of aiding (EKF3 and AP_VisualOdom of 4.7, and what was measured on them): source sets, which messages are read, the
//! gate that gives way after ten seconds, the jump of a reset counter, and when aiding ends.

use nalgebra::Vector3;

use super::axis::AxisQuantity;
use super::external::{ExternalFate, ExternalMessage, ExternalPose, ReportedFrame};
use super::own_filter::{AxisMeasurement, OwnFilter};

/// A source of `EK3_SRCn_*`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AidingSource {
    /// 0
    Nothing,
    /// 1: barometer (height) or compass (yaw).
    Own,
    /// 3
    Gps,
    /// 6
    ExternalNav,
}

impl AidingSource {
    /// The source with this number in a parameter.
    pub fn of_parameter(value: f64) -> Self {
        match value.round() as i64 {
            1 => Self::Own,
            3 => Self::Gps,
            6 => Self::ExternalNav,
            _ => Self::Nothing,
        }
    }
}

/// One of the three source sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AidingSet {
    /// `EK3_SRCn_POSXY`.
    pub position: AidingSource,
    /// `EK3_SRCn_VELXY`.
    pub velocity: AidingSource,
    /// `EK3_SRCn_VELZ`.
    pub climb: AidingSource,
    /// `EK3_SRCn_POSZ`.
    pub height: AidingSource,
    /// `EK3_SRCn_YAW`.
    pub heading: AidingSource,
}

/// Parameters of aiding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ekf3Settings {
    /// `VISO_TYPE`: 0 reads nothing.
    pub viso_type: u8,
    /// `VISO_DELAY_MS`, s.
    pub delay_s: f64,
    /// `VISO_QUAL_MIN`.
    pub least_quality: i8,
    /// `VISO_POS_M_NSE`, m.
    pub position_noise_m: f64,
    /// `VISO_VEL_M_NSE`, m/s.
    pub velocity_noise_mps: f64,
    /// The source sets, 1 to 3.
    pub sets: [AidingSet; 3],
}

impl Ekf3Settings {
    /// Whether any set takes external navigation: buffers are made at boot, and only then.
    fn wants_external(&self) -> bool {
        let uses = |s: &AidingSet| {
            [s.position, s.velocity, s.climb, s.height, s.heading].contains(&AidingSource::ExternalNav)
        };
        self.viso_type != 0 && self.sets.iter().any(uses)
    }
}

/// A message within this time is a healthy source, s.
const HEALTHY_S: f64 = 0.3;
/// Samples that are closer are dropped: 50 Hz is the ceiling, s.
const LEAST_SPACING_S: f64 = 0.02;
/// Stamps and spacings are good to this, s.
const SPACING_SLACK_S: f64 = 1e-3;
/// A position that the gate has refused for so long is jumped to, s.
const GATE_GIVES_WAY_S: f64 = 10.0;
/// Without any aiding for so long, dead reckoning ends, s.
const AIDING_ENDS_S: f64 = 15.0;
/// … and the EKF failsafe acts this much later, s; on external navigation it acts when that was silent for …, s.
const FAILSAFE_AFTER_S: f64 = 1.0;
const SILENCE_FAILSAFE_S: f64 = 8.0;
/// Gates, sigmas (`EK3_POS_I_GATE`, `EK3_VEL_I_GATE`).
const GATE_SIGMA: f64 = 5.0;
/// Noise of GPS as the EKF assumes it (`EK3_POSNE_M_NSE`, `EK3_VELNE_M_NSE`), m and m/s.
const GPS_NOISE: [f64; 2] = [0.5, 0.3];
/// Largest position noise, m.
const MOST_POSITION_NOISE_M: f64 = 100.0;
/// The link's shortest delay is forgotten at this rate, so that a clock may run slow (`JitterCorrection`), s/s.
const LAG_LEAK: f64 = 0.005;
/// Part of a difference of heading that a sample takes out.
const HEADING_PART: f64 = 0.05;
/// GPS is older than this when it is used, s.
const GPS_DELAY_S: f64 = 0.2;

const HORIZONTAL: &[usize] = &[0, 1];
const VERTICAL: &[usize] = &[2];

/// The state of aiding. Times are seconds of the simulation.
#[derive(Clone, Debug)]
pub struct Ekf3 {
    settings: Ekf3Settings,
    /// Whether external navigation had its buffers made at boot.
    buffers: bool,
    active: usize,
    reset_wanted: bool,
    heard_s: Option<f64>,
    taken_s: Option<f64>,
    lag_s: Option<(f64, f64)>,
    reset_counter: u8,
    position_fused_s: Option<f64>,
    aided_s: Option<f64>,
    ratios: [f64; 2],
}

impl Ekf3 {
    /// An EKF that has just booted.
    pub fn new(settings: Ekf3Settings) -> Self {
        Self {
            buffers: settings.wants_external(),
            settings,
            active: 0,
            reset_wanted: false,
            heard_s: None,
            taken_s: None,
            lag_s: None,
            reset_counter: 0,
            position_fused_s: None,
            aided_s: None,
            ratios: [0.0; 2],
        }
    }

    /// Parameters that were set in flight; buffers need a reboot.
    pub fn set(&mut self, settings: Ekf3Settings) {
        self.settings = settings;
    }

    /// The source set in use, 1 to 3.
    pub fn active_set(&self) -> u8 {
        self.active as u8 + 1
    }

    /// Selects a source set, 1 to 3; false for another number. The next sample of a new source is jumped to.
    pub fn select(&mut self, number: u8) -> bool {
        let Some(index) = usize::from(number).checked_sub(1).filter(|&i| i < 3) else { return false };
        let (before, after) = (self.settings.sets[self.active], self.settings.sets[index]);
        self.reset_wanted |= before.position != after.position && after.position != AidingSource::Nothing;
        self.active = index;
        true
    }

    /// Whether external navigation is set up.
    pub fn external_is_set_up(&self) -> bool {
        self.settings.viso_type != 0
    }

    /// Whether external navigation is heard, or not wanted: the arming check "VisOdom: not healthy".
    pub fn external_is_healthy(&self, now_s: f64) -> bool {
        self.settings.viso_type == 0 || self.heard_s.is_some_and(|t| now_s - t <= HEALTHY_S)
    }

    /// Whether the horizontal position is aided, or reckoned from aiding that is not long ago.
    pub fn has_position(&self, now_s: f64) -> bool {
        self.aided_s.is_some_and(|t| now_s - t <= AIDING_ENDS_S)
    }

    /// Whether aiding came within the last second.
    pub fn is_aided(&self, now_s: f64) -> bool {
        self.aided_s.is_some_and(|t| now_s - t <= 1.0)
    }

    /// Test ratios of the last velocity and position: above 1 they were refused.
    pub fn ratios(&self) -> [f64; 2] {
        self.ratios
    }

    /// Whether the EKF failsafe acts in a flight that needs a position.
    pub fn failsafe(&self, now_s: f64) -> bool {
        let external = self.settings.sets[self.active].position == AidingSource::ExternalNav;
        let patience_s = if external { SILENCE_FAILSAFE_S } else { AIDING_ENDS_S + FAILSAFE_AFTER_S };
        self.aided_s.is_none_or(|t| now_s - t > patience_s)
    }

    /// A position or a velocity of GPS, in the double's frame. It is used as the active set says.
    pub fn gps(
        &mut self,
        now_s: f64,
        position: &Vector3<f64>,
        velocity: &Vector3<f64>,
        filter: &mut OwnFilter,
    ) {
        let set = self.settings.sets[self.active];
        let time_s = now_s - GPS_DELAY_S;
        if set.velocity == AidingSource::Gps {
            let m = measurement(AxisQuantity::Velocity, velocity, GPS_NOISE[1], time_s);
            let axes = if set.climb == AidingSource::Gps { &[0, 1, 2] } else { HORIZONTAL };
            self.velocity(now_s, &m, axes, filter);
        }
        if set.position == AidingSource::Gps {
            let m = measurement(AxisQuantity::Position, position, GPS_NOISE[0], time_s);
            self.position(now_s, &m, filter);
        }
    }

    /// A message of external navigation.
    pub fn external(&mut self, pose: &ExternalPose, filter: &mut OwnFilter) -> ExternalFate {
        let now_s = pose.arrived_s;
        let ExternalMessage::Odometry { pose: frame, velocity: child, .. } = pose.message else {
            return self.vision(pose, filter);
        };
        // Of all pairs of frames only this one is read; what is not read does not count as heard either.
        if self.settings.viso_type == 0 || (frame, child) != (ReportedFrame::LocalFrd, ReportedFrame::BodyFrd)
        {
            return ExternalFate::NotRead;
        }
        self.heard_s = Some(now_s);
        if pose.quality().is_some_and(|q| q < self.settings.least_quality.max(0)) {
            return ExternalFate::LowQuality;
        }
        // Velocity is body, and the message's own attitude turns it.
        let velocity = pose.attitude.zip(pose.velocity).map(|(r, v)| r * v);
        self.sample(now_s, pose, velocity, filter)
    }

    /// VISION_POSITION_ESTIMATE and VISION_SPEED_ESTIMATE, which carry no quality: any floor blocks the first.
    fn vision(&mut self, pose: &ExternalPose, filter: &mut OwnFilter) -> ExternalFate {
        if self.settings.viso_type == 0 {
            return ExternalFate::NotRead;
        }
        self.heard_s = Some(pose.arrived_s);
        let is_position = pose.message == ExternalMessage::VisionPosition;
        if is_position && self.settings.least_quality > 0 {
            return ExternalFate::LowQuality;
        }
        if is_position {
            return self.sample(pose.arrived_s, pose, None, filter);
        }
        let (true, Some(velocity)) = (self.takes_velocity(), pose.velocity) else {
            return ExternalFate::NotSelected;
        };
        let time_s = self.corrected(pose);
        let m = measurement(AxisQuantity::Velocity, &velocity, self.settings.velocity_noise_mps, time_s);
        self.velocity(pose.arrived_s, &m, HORIZONTAL, filter)
    }

    fn takes_velocity(&self) -> bool {
        self.buffers && self.settings.sets[self.active].velocity == AidingSource::ExternalNav
    }

    fn sample(
        &mut self,
        now_s: f64,
        pose: &ExternalPose,
        velocity: Option<Vector3<f64>>,
        filter: &mut OwnFilter,
    ) -> ExternalFate {
        let time_s = self.corrected(pose);
        if self.taken_s.is_some_and(|t| time_s - t < LEAST_SPACING_S - SPACING_SLACK_S) {
            return ExternalFate::TooSoon;
        }
        self.taken_s = Some(time_s);
        // The first value that differs from the one stored counts, too.
        let jumps = std::mem::replace(&mut self.reset_counter, pose.reset_counter) != pose.reset_counter;
        let set = self.settings.sets[self.active];
        let external = |source| source == AidingSource::ExternalNav;
        if !self.buffers || ![set.position, set.velocity, set.climb, set.height].into_iter().any(external) {
            return ExternalFate::NotSelected;
        }
        let mut fate = ExternalFate::NotSelected;
        if let (true, Some(velocity)) = (self.takes_velocity(), velocity) {
            let m = measurement(AxisQuantity::Velocity, &velocity, self.settings.velocity_noise_mps, time_s);
            let axes = if external(set.climb) { &[0, 1, 2] } else { HORIZONTAL };
            fate = self.velocity(now_s, &m, axes, filter);
        }
        if let (true, Some(position)) = (external(set.position), pose.position) {
            // Three variances become one noise; only this much of the covariance is read.
            let sigma = pose.position_variance.sum().sqrt();
            let noise = sigma.clamp(self.settings.position_noise_m, MOST_POSITION_NOISE_M);
            let m = measurement(AxisQuantity::Position, &position, noise, time_s);
            self.reset_wanted |= jumps;
            fate = self.position(now_s, &m, filter);
            if external(set.height) {
                filter.fuse(&m, VERTICAL);
            }
        }
        if let (true, Some(r)) = (external(set.heading), &pose.attitude) {
            filter.heading_by(r, HEADING_PART);
        }
        fate
    }

    /// The time of a sample: its stamp on our clock by the shortest delay seen, so that a constant delay is invisible, less
    /// `VISO_DELAY_MS`.
    fn corrected(&mut self, pose: &ExternalPose) -> f64 {
        let lag = pose.arrived_s - pose.stamp_s;
        let leaked = self.lag_s.map_or(lag, |(least, since)| least + LAG_LEAK * (pose.arrived_s - since));
        let least = leaked.min(lag);
        self.lag_s = Some((least, pose.arrived_s));
        pose.stamp_s + least - self.settings.delay_s
    }

    fn velocity(
        &mut self,
        now_s: f64,
        m: &AxisMeasurement,
        axes: &[usize],
        filter: &mut OwnFilter,
    ) -> ExternalFate {
        if self.reset_wanted {
            filter.reset(m, axes);
            return ExternalFate::Jumped;
        }
        self.ratios[0] = filter.test_ratio(m, axes, GATE_SIGMA);
        if self.ratios[0] > 1.0 && self.has_position(now_s) {
            return ExternalFate::Gated;
        }
        filter.fuse(m, axes);
        self.aided_s = Some(now_s);
        ExternalFate::Fused
    }

    fn position(&mut self, now_s: f64, m: &AxisMeasurement, filter: &mut OwnFilter) -> ExternalFate {
        self.ratios[1] = filter.test_ratio(m, HORIZONTAL, GATE_SIGMA);
        let refused = self.ratios[1] > 1.0;
        let given_way = self.position_fused_s.is_none_or(|t| now_s - t > GATE_GIVES_WAY_S);
        if refused && !given_way && !self.reset_wanted {
            return ExternalFate::Gated;
        }
        self.position_fused_s = Some(now_s);
        self.aided_s = Some(now_s);
        if std::mem::take(&mut self.reset_wanted) || refused {
            filter.reset(m, HORIZONTAL);
            return ExternalFate::Jumped;
        }
        filter.fuse(m, HORIZONTAL);
        ExternalFate::Fused
    }

    /// MAV_CMD_EXTERNAL_POSITION_ESTIMATE: puts the position while dead reckoning; refused while GPS was used within the last second.
    pub fn place(
        &mut self,
        now_s: f64,
        position: &Vector3<f64>,
        noise_m: f64,
        filter: &mut OwnFilter,
    ) -> bool {
        if self.is_aided(now_s) && self.settings.sets[self.active].position == AidingSource::Gps {
            return false;
        }
        filter.reset(&measurement(AxisQuantity::Position, position, noise_m, now_s), HORIZONTAL);
        true
    }

    /// Goes on by a step: the compass gives the heading where the set says so.
    pub fn step(&self, dt_s: f64, filter: &mut OwnFilter) {
        if self.settings.sets[self.active].heading != AidingSource::ExternalNav {
            filter.heading_by_compass(dt_s);
        }
    }
}

fn measurement(what: AxisQuantity, value_ned: &Vector3<f64>, noise: f64, time_s: f64) -> AxisMeasurement {
    AxisMeasurement { what, value_ned: *value_ned, variance: Vector3::repeat(noise.powi(2)), time_s }
}

#[cfg(test)]
mod tests;
