//! What the autopilot may be told, and when: the message, its frames, rate, covariance, quality and reset counter.
//!
//! The rules come from the autopilots: ArduPilot reads ODOMETRY only in (MAV_FRAME_LOCAL_FRD, MAV_FRAME_BODY_FRD) and takes x, y, z as
//! north, east, down from its EKF's origin; PX4 wants MAV_FRAME_LOCAL_NED and believes the diagonal of the covariance. Both fly
//! off by whatever the frame is off, so nothing is sent before the frame is aligned with the autopilot's own ([`alignment`]).
//! Messages are paced by the solution's time: when the stream of samples stops, so does the output, and no pose is sent twice.

pub mod alignment;
mod coasting;
mod covariance;
mod following;
pub mod handover;
pub mod message;
pub mod origin_watch;
pub mod settings;

use nalgebra::Vector3;

use crate::geo::Ned;
use crate::navigator::solution::{Mode, Solution};
use crate::sample::Reference;
use crate::time::{AutopilotTime, Span};

use alignment::{Alignment, AlignmentMemory};
use coasting::CoastWatch;
pub use following::Departure;
use following::FollowingWatch;
use handover::{SendInputs, Sending, StandsOn, decide};
use message::{Odometry, OutboundMessage, PoseFrame, VisionPosition};
pub use settings::{Carriage, Coasting, Covariance, OutboundSettings, Profile, Publish};

/// The output of one vehicle.
#[derive(Clone, Debug)]
pub struct Outbound {
    settings: OutboundSettings,
    alignment: Alignment,
    standing: StandsOn,
    sending: Sending,
    following: FollowingWatch,
    coast: CoastWatch,
    due: Option<AutopilotTime>,
    last_published: Option<AutopilotTime>,
    /// The autopilot was sent to in an outage, and was not seen on GNSS since.
    relied_on: bool,
    lost_since: Option<AutopilotTime>,
    sent: u64,
}

impl Outbound {
    /// An output that has sent nothing.
    pub fn new(settings: OutboundSettings) -> Self {
        Self {
            settings,
            alignment: Alignment::new(),
            standing: StandsOn::Unknown,
            sending: Sending::Aligning,
            following: FollowingWatch::new(),
            coast: CoastWatch::default(),
            due: None,
            last_published: None,
            relied_on: false,
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

    /// What the autopilot's own position stands on, as it is known now.
    pub fn set_standing(&mut self, standing: StandsOn) {
        self.standing = standing;
    }

    /// Position messages made so far.
    pub fn sent(&self) -> u64 {
        self.sent
    }

    /// Whether something is sent at present, and why.
    pub fn sending(&self) -> Sending {
        self.sending
    }

    /// How our frame lies in the autopilot's.
    pub fn alignment(&self) -> &Alignment {
        &self.alignment
    }

    /// The process was restarted: our frame lies in the autopilot's as it did.
    pub fn recall(&mut self, kept: &AlignmentMemory) {
        self.alignment.recall(kept);
    }

    /// How far the autopilot's position is from what it was sent; `None` while nothing is sent, or heard.
    pub fn departure(&self) -> Option<Departure> {
        let now = self.last_published?;
        self.following.departure().filter(|d| now.seconds_since(d.time).abs() < 1.0)
    }

    /// The autopilot has told its origin, and the navigator's frame has been put there; by how much it moved for that, m.
    pub fn origin_shared(&mut self, moved: Option<Ned<Vector3<f64>>>) {
        self.alignment.origin_shared(moved);
    }

    /// The autopilot has rebooted: its frame is a new one.
    pub fn restart(&mut self) {
        *self = Self { sent: self.sent, ..Self::new(self.settings) };
    }

    /// The autopilot's own estimate: aligns the frames while it is not built on ours, and shows whether it follows while it is.
    pub fn reference(&mut self, reference: &Reference, solution: &Solution) {
        if let Reference::Local { time, position, velocity } = reference {
            self.following.compare(*time, *position, *velocity);
        }
        let silent = self.last_published.is_none_or(|t| solution.time.seconds_since(t) > INDEPENDENT_AFTER_S);
        if solution.mode != Mode::Aided {
            return;
        }
        // It may follow what it was sent: what it says is taken to begin with, and then only after a silence of ours.
        let independent = |learned: bool| match self.standing {
            StandsOn::Gnss => true,
            StandsOn::Ours | StandsOn::Nothing => false,
            StandsOn::Unknown => silent || !learned,
        };
        match reference {
            Reference::Local { time, position, .. } if independent(self.alignment.learned()) => {
                self.alignment.observe(*time, *position, solution, silent);
            }
            Reference::Attitude { time, attitude } if independent(self.alignment.heading_learned()) => {
                self.alignment.observe_attitude(*time, attitude, solution);
            }
            _ => {}
        }
    }

    /// The newest solution: appends what is to be sent now.
    pub fn step(&mut self, solution: &Solution, out: &mut Vec<OutboundMessage>) {
        self.sending = self.decide(solution);
        if !self.sending.sends() {
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
        let odometry = self.odometry(solution);
        self.following.sent(solution.time, odometry.position);
        match self.settings.carriage {
            Carriage::Odometry => out.push(OutboundMessage::Odometry(odometry)),
            Carriage::VisionPositionEstimate if solution.mode == Mode::Lost => {} // It cannot say that it is lost.
            Carriage::VisionPositionEstimate => {
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
                        velocity: solution.published_velocity(),
                        covariance: covariance::sent(solution, &self.settings, self.standing).1,
                        reset_counter: solution.reset_counter,
                    });
                }
            }
        }
    }

    /// Whether to send, and what is remembered of the autopilot's reliance on it.
    fn decide(&mut self, solution: &Solution) -> Sending {
        let farewell = solution.mode == Mode::Lost && self.farewell(solution.time);
        if solution.mode != Mode::Lost {
            self.lost_since = None;
        }
        if solution.mode == Mode::Aided && self.standing == StandsOn::Gnss {
            self.relied_on = false;
        }
        let sending = decide(&SendInputs {
            publish: self.settings.publish,
            profile: self.settings.profile,
            mode: solution.mode,
            standing: self.standing,
            aligned: self.alignment.aligned(),
            relied_on: self.relied_on,
            coasts: self.coast.coasts(solution, self.settings.coasting),
            farewell,
        });
        self.relied_on |= matches!(sending, Sending::Outage | Sending::Rejoining);
        sending
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
        // With the autopilot's heading: it turns the body's velocity back by its own (PX4), or by this one (ArduPilot), and has ours in NED.
        let attitude = self.alignment.attitude(&s.attitude);
        let (position, velocity) = covariance::sent(s, &self.settings, self.standing);
        let velocity_covariance = attitude.covariance_to_body(velocity).raw();
        Odometry {
            time: s.time,
            frame: match self.settings.profile {
                Profile::Ardupilot => PoseFrame::LocalFrd,
                Profile::Px4 => PoseFrame::LocalNed,
            },
            position: s.position + self.alignment.offset(),
            attitude,
            velocity: attitude.to_body(s.published_velocity()),
            angular_rate: s.angular_rate,
            pose_covariance: message::upper_triangle(&position.raw(), &s.attitude_variance),
            velocity_covariance: message::upper_triangle(
                &velocity_covariance,
                &Vector3::from_element(RATE_VARIANCE),
            ),
            reset_counter: s.reset_counter,
            quality: self.quality(s),
        }
    }

    /// -1 when lost, or when the attitude is not known, which turns the body's velocity; else 100 for perfect down to 1 at the largest uncertainty allowed. Never 0: that means "not known".
    pub fn quality(&self, s: &Solution) -> i8 {
        let tilt = s.attitude_variance.xy().max();
        if s.mode == Mode::Lost || tilt > WORST_TILT_RAD.powi(2) || tilt.is_nan() {
            return -1;
        }
        let used = (s.horizontal_sigma_m() / self.settings.worst_sigma_m).clamp(0.0, 1.0);
        (100.0 * (1.0 - used)).round().clamp(1.0, 100.0) as i8
    }
}

/// An autopilot has forgotten what it was sent after this long, s.
const INDEPENDENT_AFTER_S: f64 = 10.0;
/// A vehicle whose tilt is not known better than this, rad, does not know where it goes.
const WORST_TILT_RAD: f64 = 0.4;
/// Variance of the angular rate that is sent along, rad²/s²: a MEMS gyro's.
const RATE_VARIANCE: f64 = 1e-4;

#[cfg(test)]
mod tests;
