//! What the navigator tells besides the solution: every change that somebody who runs it has to know of.

use std::fmt;

use crate::altimeter::{Channel, Fault};
use crate::camera::calibration::Distrust;
use crate::time::AutopilotTime;

use super::judge::Charge;
use super::monitor::GnssFault;
use super::solution::{Mode, VelocitySource};
use super::sources::status::SourceId;

/// Something happened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    /// When.
    pub time: AutopilotTime,
    /// What.
    pub kind: EventKind,
    /// How often, since it was told before: what alternates is told once a minute. Where it is told again within that, both times are in it.
    pub times: u32,
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.kind)?;
        if self.times > 1 { write!(f, ", {} times", self.times) } else { Ok(()) }
    }
}

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EventKind {
    /// The mode changed.
    Mode {
        /// From.
        from: Mode,
        /// To.
        to: Mode,
        /// Why.
        reason: TransitionReason,
    },
    /// The frame that began where the vehicle was has a place on Earth; north was off by so much, rad.
    Placed(f64),
    /// The frame's origin was set or moved; the distance it moved, m.
    Origin(f64),
    /// The autopilot told an origin this far off, m, that its own positions contradict; it is not used.
    OriginContradicted(f64),
    /// The published position had to jump by this much, m; the reset counter changed.
    Reset(f64),
    /// A slow lie of GNSS is taken back by this much, m.
    WalkedBack(f64),
    /// Another receiver is used now.
    Receiver(u8),
    /// A flow sensor is trusted from now on.
    FlowTrusted(u8),
    /// A flow sensor is not trusted any more.
    FlowDistrusted(u8, Distrust),
    /// What one unit of a flow sensor is worth was found, rad.
    FlowUnit(u8, f64),
    /// A source is wrong.
    Accused(SourceId, Charge),
    /// Nothing is held against a source any more.
    Acquitted(SourceId),
    /// A source of heights is faulty; what is wrong, and for how long it has been, s.
    HeightFault {
        /// Which.
        channel: Channel,
        /// What.
        fault: Fault,
        /// For how long, s.
        for_s: f64,
    },
    /// A source of heights is healthy again.
    HeightHealed(Channel),
    /// The inertial height had gone astray; it was corrected by this much, m.
    InertialHeight(f64),
    /// The published height had to jump by this much, m; the reset counter changed.
    HeightReset(f64),
    /// The filter was started anew from the observer; their attitudes were this far apart, rad.
    FilterRestarted(f64),
    /// In holdover this carries the velocity now.
    Carried(VelocitySource),
    /// The filter was carried over a hole in the IMU stream, s.
    Bridged(f64),
    /// It was started anew, and goes on from what was kept so long ago, s.
    Resumed(f64),
    /// Still aligning: what is waited for.
    Waits(Waits),
    /// There is no magnetometer: the heading is sought in the vehicle's accelerations.
    HeadingSought,
    /// Motion has shown the heading; its standard deviation, rad.
    HeadingFound(f64),
    /// Motion contradicts the heading: it was turned by so much, rad, and the magnetometer is not believed.
    HeadingTurned(f64),
    /// The landmarks in view give a pose.
    LandmarksFound,
    /// They do so no more.
    LandmarksLost,
    /// A landmark is not where it should be, going by the others: it is misplaced, or taken for another.
    LandmarkContradicts(u8),
    /// Landmarks contradict each other, and none of them has a majority.
    LandmarksContradict {
        /// How many are contradicted.
        suspect: u32,
        /// How many are not.
        trusted: u32,
    },
    /// Landmarks and a GNSS that is trusted are this far apart, m: in an outage they will not be used.
    LandmarksApart(f64),
    /// Landmarks and GNSS agree again.
    LandmarksAgree,
    /// GNSS has shown how the landmarks' own frame lies; its heading, rad, and the heading's standard deviation.
    LandmarkFrame(f64, f64),
}

/// What keeps the navigator from navigating.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Waits {
    /// A fix of GNSS that can be trusted; what is wrong with those that come.
    Fix(GnssFault),
    /// GNSS is good, and has to be for longer.
    Trust,
    /// A height: a barometer, or the height of fixes.
    Height,
    /// Without a magnetometer only motion shows the heading.
    Motion,
    /// The attitude is still off by so much, rad, going by magnetometer and accelerometers.
    Attitude(f64),
}

impl fmt::Display for Waits {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Waits::Fix(fault) => write!(f, "waits for GNSS: {}", fault.reason()),
            Waits::Trust => write!(f, "GNSS is good, not yet for long"),
            Waits::Height => write!(f, "waits for a height: no barometer"),
            Waits::Motion => write!(f, "no compass to trust: move, it shows heading"),
            Waits::Attitude(off) => write!(f, "attitude off by {:.0} deg, keep still", off.to_degrees()),
        }
    }
}

/// Why a mode was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TransitionReason {
    /// Attitude, heading and place are known.
    Aligned,
    /// GNSS is lost.
    GnssLost(GnssFault),
    /// There was never a fix: position is relative to where it began.
    NoGnss,
    /// GNSS is trusted again.
    GnssBack,
    /// The position has glided back to GNSS.
    Joined,
    /// The uncertainty passed what is allowed; its standard deviation, m.
    Uncertain(f64),
    /// Coasted without any velocity for too long, s.
    Coasted(f64),
    /// No vehicle of its class is so fast; its estimated speed, m/s.
    Implausible(f64),
    /// Landmarks tell the position again.
    Landmarks,
    /// The IMU was silent, s.
    ImuGap(f64),
    /// A heading that was found from motion does not fit what GNSS shows.
    HeadingWrong,
    /// A hole in the stream has left a heading that may be any, and GNSS is back to find it by.
    HeadingLost,
    /// Holdover was started anew, and goes on.
    Restarted,
    /// The autopilot rebooted.
    Reboot,
    /// The observer's state was no longer finite.
    Broken,
}

impl fmt::Display for TransitionReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            TransitionReason::Aligned => write!(f, "aligned"),
            TransitionReason::GnssLost(fault) => write!(f, "GNSS {}", fault.reason()),
            TransitionReason::NoGnss => write!(f, "no GNSS, relative to here"),
            TransitionReason::GnssBack => write!(f, "GNSS is back"),
            TransitionReason::Joined => write!(f, "joined GNSS"),
            TransitionReason::Uncertain(sigma) => write!(f, "uncertainty {sigma:.0} m"),
            TransitionReason::Coasted(s) => write!(f, "{s:.0} s without velocity"),
            TransitionReason::Implausible(v) => write!(f, "{v:.0} m/s is not plausible"),
            TransitionReason::Landmarks => write!(f, "landmarks in view"),
            TransitionReason::ImuGap(s) => write!(f, "IMU silent for {s:.1} s"),
            TransitionReason::HeadingWrong => write!(f, "heading from motion does not fit"),
            TransitionReason::HeadingLost => write!(f, "heading lost, sought anew"),
            TransitionReason::Restarted => write!(f, "restarted"),
            TransitionReason::Reboot => write!(f, "autopilot rebooted"),
            TransitionReason::Broken => write!(f, "estimate not finite"),
        }
    }
}

impl EventKind {
    /// A word that stays the same, to search for: see [`super::event_codes::EVENTS`].
    pub const fn code(&self) -> &'static str {
        match self {
            EventKind::Mode { .. } => "mode",
            EventKind::Placed(_) => "placed",
            EventKind::Origin(_) => "origin",
            EventKind::OriginContradicted(_) => "origin-contradicted",
            EventKind::Reset(_) => "position-reset",
            EventKind::WalkedBack(_) => "gnss-walk-undone",
            EventKind::Receiver(_) => "gnss-receiver",
            EventKind::FlowTrusted(_) => "flow-trusted",
            EventKind::FlowDistrusted(..) => "flow-distrusted",
            EventKind::FlowUnit(..) => "flow-unit",
            EventKind::Accused(..) => "source-accused",
            EventKind::Acquitted(_) => "source-acquitted",
            EventKind::HeightFault { .. } => "height-fault",
            EventKind::HeightHealed(_) => "height-healed",
            EventKind::InertialHeight(_) => "height-inertial",
            EventKind::HeightReset(_) => "height-reset",
            EventKind::FilterRestarted(_) => "filter-restarted",
            EventKind::Carried(_) => "carried-by",
            EventKind::Bridged(_) => "imu-bridged",
            EventKind::Resumed(_) => "resumed",
            EventKind::Waits(_) => "aligning",
            EventKind::HeadingSought => "heading-sought",
            EventKind::HeadingFound(_) => "heading-found",
            EventKind::HeadingTurned(_) => "heading-turned",
            _ => self.landmark_code(),
        }
    }

    const fn landmark_code(&self) -> &'static str {
        match self {
            EventKind::LandmarksFound => "landmarks-found",
            EventKind::LandmarksLost => "landmarks-lost",
            EventKind::LandmarkContradicts(_) => "landmark-contradicts",
            EventKind::LandmarksContradict { .. } => "landmarks-contradict",
            EventKind::LandmarksApart(_) => "landmarks-apart",
            EventKind::LandmarksAgree => "landmarks-agree",
            _ => "landmark-frame",
        }
    }

    fn write_position(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            EventKind::Mode { from, to, reason } => {
                write!(f, "{} -> {}: {reason}", from.label(), to.label())
            }
            EventKind::Placed(by) => write!(f, "place known, heading turned {:+.0} deg", by.to_degrees()),
            EventKind::Origin(m) if *m == 0.0 => write!(f, "origin set"),
            EventKind::Origin(m) => write!(f, "origin moved by {m:.2} m"),
            EventKind::OriginContradicted(m) => write!(f, "origin {m:.0} m off: not believed"),
            EventKind::Reset(m) => write!(f, "position reset by {m:.1} m"),
            EventKind::WalkedBack(m) => write!(f, "took back {m:.1} m of GNSS drift"),
            EventKind::Receiver(n) => write!(f, "using GNSS receiver {n}"),
            EventKind::Carried(source) => write!(f, "carried by {}", source.label()),
            EventKind::Bridged(s) => write!(f, "IMU silent for {s:.1} s: carried over"),
            _ => Ok(()),
        }
    }

    fn write_heading(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            EventKind::Waits(waits) => write!(f, "aligning: {waits}"),
            EventKind::FilterRestarted(apart) => {
                write!(f, "filter restarted: {:.0} deg from the observer", apart.to_degrees())
            }
            EventKind::Resumed(s) => write!(f, "restarted: goes on from {s:.1} s ago"),
            EventKind::HeadingSought => {
                write!(f, "no magnetometer: heading from GNSS acceleration, needs motion")
            }
            EventKind::HeadingFound(sigma) => {
                write!(f, "heading found from motion, +- {:.0} deg", sigma.to_degrees())
            }
            EventKind::HeadingTurned(by) => {
                write!(f, "compass wrong: heading turned {:+.0} deg", by.to_degrees())
            }
            _ => Ok(()),
        }
    }

    fn write_sensors(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            EventKind::FlowTrusted(n) => write!(f, "flow {n} trusted"),
            EventKind::FlowDistrusted(n, why) => write!(f, "flow {n} not trusted: {}", why.reason()),
            EventKind::FlowUnit(n, rad) => write!(f, "flow {n} is told in units of {:.3} mrad", rad * 1e3),
            EventKind::Accused(source, charge) => write!(f, "{source} {}", charge.label()),
            EventKind::Acquitted(source) => write!(f, "{source} believed again"),
            EventKind::HeightFault { channel, fault: fault @ Fault::Drift { .. }, .. } => {
                write!(f, "{} {fault}", channel.label())
            }
            EventKind::HeightFault { channel, fault, for_s } => {
                write!(f, "{} {fault} for {for_s:.1} s", channel.label())
            }
            EventKind::HeightHealed(channel) => write!(f, "{} healthy again", channel.label()),
            EventKind::InertialHeight(m) => write!(f, "inertial height was off, moved by {m:+.1} m"),
            EventKind::HeightReset(m) => write!(f, "height reset by {m:+.1} m"),
            _ => Ok(()),
        }
    }

    fn write_landmarks(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            EventKind::LandmarksFound => write!(f, "landmarks found"),
            EventKind::LandmarksLost => write!(f, "landmarks lost"),
            EventKind::LandmarkContradicts(id) => write!(f, "landmark {id} contradicts the others"),
            EventKind::LandmarksContradict { suspect, trusted } => {
                write!(f, "{suspect} landmarks contradict {trusted}: not used")
            }
            EventKind::LandmarksApart(m) => write!(f, "landmarks contradict GNSS by {m:.1} m: not used"),
            EventKind::LandmarksAgree => write!(f, "landmarks and GNSS agree"),
            EventKind::LandmarkFrame(heading, sigma) => write!(
                f,
                "landmarks' frame aligned: turned by {:.1} +- {:.1} deg",
                heading.to_degrees(),
                sigma.to_degrees()
            ),
            _ => Ok(()),
        }
    }
}

impl fmt::Display for EventKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Each writes what is its own, and nothing else.
        self.write_position(f)?;
        self.write_heading(f)?;
        self.write_sensors(f)?;
        self.write_landmarks(f)
    }
}
