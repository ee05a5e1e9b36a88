//! What the autopilot may be told, and when: the message, its frames, rate, covariance, quality and reset counter.
//!
//! The rules come from the autopilots: ArduPilot reads ODOMETRY only in (MAV_FRAME_LOCAL_FRD, MAV_FRAME_BODY_FRD) and takes x, y, z as
//! north, east, down from its EKF's origin; PX4 wants MAV_FRAME_LOCAL_NED and believes the diagonal of the covariance. Both fly
//! off by whatever the frame is off, so nothing is sent before the frame is aligned with the autopilot's own ([`alignment`]).
//! Messages are paced by the solution's time: when the stream of samples stops, so does the output, and no pose is sent twice.

pub mod alignment;
pub mod message;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use strum::{Display, EnumString};

use crate::navigator::solution::{Mode, Solution};
use crate::sample::Reference;
use crate::time::{AutopilotTime, Span};

use alignment::{Alignment, AlignmentMemory};
use message::{Odometry, OutboundMessage, PoseFrame, VisionPosition};

/// When to send.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Publish {
    /// While GNSS is not trusted, and until the position has glided back.
    Holdover,
    /// Whenever there is a solution.
    Always,
    /// Not at all: look, do not touch.
    Never,
}

/// Which message carries the solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Carriage {
    /// ODOMETRY (331).
    Odometry,
    /// VISION_POSITION_ESTIMATE (102), and for ArduPilot VISION_SPEED_ESTIMATE (103).
    VisionPositionEstimate,
}

/// How a kind of autopilot wants to be told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Display, EnumString)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case", parse_err_ty = String, parse_err_fn = unknown_profile)]
pub enum Profile {
    /// ArduPilot.
    Ardupilot,
    /// PX4.
    Px4,
}

fn unknown_profile(name: &str) -> String {
    format!("unknown profile \"{name}\": expected \"ardupilot\" or \"px4\"")
}

/// Settings of the output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutboundSettings {
    /// When to send.
    pub publish: Publish,
    /// Which message.
    pub carriage: Carriage,
    /// For whom.
    pub profile: Profile,
    /// Messages a second.
    pub rate_hz: f64,
    /// Horizontal uncertainty at which the quality reaches 1, m: where the navigator calls itself lost.
    pub worst_sigma_m: f64,
    /// For how long a lost navigator says so (quality -1) before it is silent, s.
    pub farewell_s: f64,
}

/// The output of one vehicle.
#[derive(Clone, Debug)]
pub struct Outbound {
    settings: OutboundSettings,
    alignment: Alignment,
    due: Option<AutopilotTime>,
    last_published: Option<AutopilotTime>,
    lost_since: Option<AutopilotTime>,
    sent: u64,
}

impl Outbound {
    /// An output that has sent nothing.
    pub fn new(settings: OutboundSettings) -> Self {
        Self {
            settings,
            alignment: Alignment::new(),
            due: None,
            last_published: None,
            lost_since: None,
            sent: 0,
        }
    }

    /// Settings in force.
    pub fn settings(&self) -> &OutboundSettings {
        &self.settings
    }

    /// The autopilot is of this kind.
    pub fn set_profile(&mut self, profile: Profile) {
        self.settings.profile = profile;
    }

    /// Position messages made so far.
    pub fn sent(&self) -> u64 {
        self.sent
    }

    /// How our frame lies in the autopilot's.
    pub fn alignment(&self) -> &Alignment {
        &self.alignment
    }

    /// The process was restarted: our frame lies in the autopilot's as it did.
    pub fn recall(&mut self, kept: &AlignmentMemory) {
        self.alignment.recall(kept);
    }

    /// The autopilot has told its origin, and the navigator's frame has been put there.
    pub fn origin_shared(&mut self) {
        self.alignment.origin_shared();
    }

    /// The autopilot has rebooted: its frame is a new one.
    pub fn restart(&mut self) {
        self.alignment = Alignment::new();
        self.due = None;
        self.last_published = None;
        self.lost_since = None;
    }

    /// The autopilot's own estimate, while it is not built on ours: aligns the frames.
    pub fn reference(&mut self, reference: &Reference, solution: &Solution) {
        // An autopilot that was sent something may be following it. What it says is taken once, to begin with, and then only after a
        // silence of ours. (With publish = "always" there is no such silence.)
        let independent =
            self.last_published.is_none_or(|t| solution.time.seconds_since(t) > INDEPENDENT_AFTER_S);
        let independent = independent || !self.alignment.learned();
        if let Reference::Local { time, position, .. } = reference
            && solution.mode == Mode::Aided
            && independent
        {
            self.alignment.observe(*time, *position, solution);
        }
    }

    /// The newest solution: appends what is to be sent now.
    pub fn step(&mut self, solution: &Solution, out: &mut Vec<OutboundMessage>) {
        let wanted = match (self.settings.publish, solution.mode) {
            (Publish::Never, _) | (_, Mode::Aligning) => false,
            (Publish::Always, Mode::Aided) | (_, Mode::Holdover | Mode::Rejoining) => true,
            (Publish::Holdover, Mode::Aided) => false,
            (_, Mode::Lost) => self.farewell(solution.time),
        };
        if solution.mode != Mode::Lost {
            self.lost_since = None;
        }
        if !wanted || !self.alignment.aligned() {
            self.due = None;
            return;
        }
        let due = *self.due.get_or_insert(solution.time);
        if solution.time < due {
            return;
        }
        let period = Span::from_seconds(1.0 / self.settings.rate_hz);
        // After a hole the missed messages are not made up for.
        self.due = Some(if solution.time - due > period { solution.time + period } else { due + period });
        self.last_published = Some(solution.time);
        self.sent += 1;
        match self.settings.carriage {
            Carriage::Odometry => out.push(OutboundMessage::Odometry(self.odometry(solution))),
            Carriage::VisionPositionEstimate if solution.mode == Mode::Lost => {} // It cannot say that it is lost.
            Carriage::VisionPositionEstimate => {
                let odometry = self.odometry(solution);
                out.push(OutboundMessage::VisionPosition(VisionPosition {
                    time: odometry.time,
                    position: odometry.position,
                    attitude: odometry.attitude,
                    pose_covariance: odometry.pose_covariance,
                    reset_counter: odometry.reset_counter,
                }));
                if self.settings.profile == Profile::Ardupilot {
                    out.push(OutboundMessage::VisionSpeed {
                        time: solution.time,
                        velocity: solution.velocity,
                        covariance: solution.velocity_covariance,
                        reset_counter: solution.reset_counter,
                    });
                }
            }
        }
    }

    fn farewell(&mut self, now: AutopilotTime) -> bool {
        // Only somebody who was listened to says good-bye.
        let listened = self.last_published.is_some_and(|t| now.seconds_since(t) < 1.0);
        if self.lost_since.is_none() && !listened {
            return false;
        }
        let since = *self.lost_since.get_or_insert(now);
        now.seconds_since(since) <= self.settings.farewell_s
    }

    fn odometry(&self, s: &Solution) -> Odometry {
        let velocity_covariance = s.attitude.covariance_to_body(s.velocity_covariance).raw();
        Odometry {
            time: s.time,
            frame: match self.settings.profile {
                Profile::Ardupilot => PoseFrame::LocalFrd,
                Profile::Px4 => PoseFrame::LocalNed,
            },
            position: s.position + self.alignment.offset(),
            attitude: s.attitude,
            velocity: s.attitude.to_body(s.velocity),
            angular_rate: s.angular_rate,
            pose_covariance: message::upper_triangle(&s.position_covariance.raw(), &s.attitude_variance),
            velocity_covariance: message::upper_triangle(
                &velocity_covariance,
                &Vector3::from_element(RATE_VARIANCE),
            ),
            reset_counter: s.reset_counter,
            quality: self.quality(s),
        }
    }

    /// -1 when lost, else 100 for perfect down to 1 at the largest uncertainty allowed. Never 0: that means "not known".
    fn quality(&self, s: &Solution) -> i8 {
        if s.mode == Mode::Lost {
            return -1;
        }
        let used = (s.horizontal_sigma_m() / self.settings.worst_sigma_m).clamp(0.0, 1.0);
        (100.0 * (1.0 - used)).round().clamp(1.0, 100.0) as i8
    }
}

/// An autopilot has forgotten what it was sent after this long, s.
const INDEPENDENT_AFTER_S: f64 = 10.0;
/// Variance of the angular rate that is sent along, rad²/s²: a MEMS gyro's.
const RATE_VARIANCE: f64 = 1e-4;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::{Body, BodyToNed, Ned, so3};
    use crate::navigator::solution::VelocitySource;
    use nalgebra::Matrix3;

    fn settings(publish: Publish) -> OutboundSettings {
        OutboundSettings {
            publish,
            carriage: Carriage::Odometry,
            profile: Profile::Ardupilot,
            rate_hz: 30.0,
            worst_sigma_m: 50.0,
            farewell_s: 1.0,
        }
    }

    fn solution(ms: i64, mode: Mode) -> Solution {
        Solution {
            time: AutopilotTime::from_micros(ms * 1000),
            mode,
            velocity_source: VelocitySource::Flow,
            position: Ned::new(Vector3::new(10.0, 20.0, -5.0)),
            velocity: Ned::new(Vector3::new(1.0, 2.0, 0.5)),
            attitude: BodyToNed::from_matrix(&so3::exp(&Vector3::new(0.1, -0.2, 2.0))),
            angular_rate: Body::new(Vector3::zeros()),
            position_covariance: Ned::new(Matrix3::identity() * 4.0),
            velocity_covariance: Ned::new(Matrix3::identity() * 0.04),
            attitude_variance: Vector3::new(1e-4, 1e-4, 4e-4),
            reset_counter: 3,
        }
    }

    fn run(out: &mut Outbound, from_ms: i64, to_ms: i64, mode: Mode) -> Vec<Odometry> {
        let mut messages = Vec::new();
        for ms in (from_ms..to_ms).step_by(5) {
            out.step(&solution(ms, mode), &mut messages);
        }
        messages
            .into_iter()
            .map(|m| match m {
                OutboundMessage::Odometry(o) => o,
                other => panic!("{other:?}"),
            })
            .collect()
    }

    #[test]
    fn thirty_a_second_in_holdover_and_none_while_aided() {
        let mut out = Outbound::new(settings(Publish::Holdover));
        out.origin_shared();
        assert_eq!(run(&mut out, 0, 1000, Mode::Aided).len(), 0);
        let sent = run(&mut out, 1000, 11_000, Mode::Holdover);
        assert!((299..=301).contains(&sent.len()), "{}", sent.len());
        assert!(sent.windows(2).all(|w| w[1].time > w[0].time));
        assert_eq!(sent[0].frame, PoseFrame::LocalFrd);
        let v = solution(0, Mode::Holdover);
        assert_eq!(sent[0].attitude, v.attitude);
        assert!((v.attitude.to_ned(sent[0].velocity) - v.velocity).raw().norm() < 1e-12);
        assert_eq!(run(&mut out, 11_000, 12_000, Mode::Aided).len(), 0);
    }

    #[test]
    fn the_lost_say_so_and_are_silent_then() {
        let mut out = Outbound::new(settings(Publish::Holdover));
        out.origin_shared();
        assert_eq!(run(&mut out, 0, 500, Mode::Lost).len(), 0, "nobody was listening");
        assert!(run(&mut out, 500, 1500, Mode::Holdover).iter().all(|o| o.quality == 94));
        let farewell = run(&mut out, 1500, 9000, Mode::Lost);
        assert!((29..=32).contains(&farewell.len()), "{}", farewell.len());
        assert!(farewell.iter().all(|o| o.quality == -1));
    }

    #[test]
    fn an_unaligned_frame_is_not_sent() {
        let mut out = Outbound::new(settings(Publish::Always));
        assert_eq!(run(&mut out, 0, 1000, Mode::Holdover).len(), 0);
    }

    #[test]
    fn the_autopilots_frame_is_taken_while_gnss_is_good() {
        let mut out = Outbound::new(settings(Publish::Holdover));
        for ms in (0..30_000).step_by(200) {
            let s = solution(ms, Mode::Aided);
            let reference = Reference::Local {
                time: s.time,
                position: s.position + Ned::new(Vector3::new(0.5, -1.0, 2.0)),
                velocity: s.velocity,
            };
            out.reference(&reference, &s);
        }
        let sent = run(&mut out, 30_000, 30_100, Mode::Holdover);
        let position = sent[0].position.raw();
        assert!((position - Vector3::new(10.5, 19.0, -3.0)).norm() < 0.05, "{position}");
    }

    #[test]
    fn one_wild_position_of_the_autopilot_moves_nothing_and_many_do() {
        let mut out = Outbound::new(settings(Publish::Always));
        let tell = |out: &mut Outbound, from: i64, to: i64, north: f64| {
            for ms in (from..to).step_by(100) {
                let s = solution(ms, Mode::Aided);
                let position = s.position + Ned::new(Vector3::new(north, 0.0, 0.0));
                out.reference(&Reference::Local { time: s.time, position, velocity: s.velocity }, &s);
            }
        };
        tell(&mut out, 0, 5000, 1.0);
        tell(&mut out, 5000, 5100, 900.0);
        assert!((out.alignment().offset().raw().x - 1.0).abs() < 1e-9);
        tell(&mut out, 5100, 15_000, 30.0);
        assert!((out.alignment().offset().raw().x - 30.0).abs() < 0.1);
    }

    #[test]
    fn px4_gets_ned_and_the_diagonal_of_the_covariance() {
        let mut out = Outbound::new(settings(Publish::Always));
        out.set_profile(Profile::Px4);
        out.origin_shared();
        let o = &run(&mut out, 0, 100, Mode::Aided)[0];
        assert_eq!(o.frame, PoseFrame::LocalNed);
        for (i, v) in [(0, 4.0), (6, 4.0), (11, 4.0), (15, 1e-4), (18, 1e-4), (20, 4e-4)] {
            assert!((o.pose_covariance[i] - v).abs() < 1e-12);
        }
    }
}
