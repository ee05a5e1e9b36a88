//! What the navigator tells besides the solution: every change that somebody who runs it has to know of.

use std::fmt;

use crate::altimeter::{Channel, Fault};
use crate::camera::calibration::Distrust;
use crate::time::AutopilotTime;

use super::solution::{Carrier, Mode};
use super::trust::GnssFault;

/// Something happened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    /// When.
    pub time: AutopilotTime,
    /// What.
    pub what: What,
}

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum What {
    /// The mode changed.
    Mode {
        /// From.
        from: Mode,
        /// To.
        to: Mode,
        /// Why.
        why: Why,
    },
    /// The frame's origin was set or moved; the distance it moved, m.
    Origin(f64),
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
    Carried(Carrier),
    /// The filter was carried over a hole in the IMU stream, s.
    Bridged(f64),
    /// There is no magnetometer: the heading is sought in the vehicle's accelerations.
    HeadingSought,
    /// Motion has shown the heading; its standard deviation, rad.
    HeadingFound(f64),
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

/// Why a mode was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Why {
    /// Attitude, heading and place are known.
    Aligned,
    /// GNSS is lost.
    GnssLost(GnssFault),
    /// GNSS is trusted again.
    GnssBack,
    /// The position has glided back to GNSS.
    Joined,
    /// The uncertainty passed what is allowed; its standard deviation, m.
    Uncertain(f64),
    /// Coasted without any velocity for too long, s.
    Coasted(f64),
    /// Landmarks tell the position again.
    Landmarks,
    /// The IMU was silent, s.
    ImuGap(f64),
    /// A heading that was found from motion does not fit what GNSS shows.
    HeadingWrong,
    /// The autopilot rebooted.
    Reboot,
    /// The observer's state was no longer finite.
    Broken,
}

impl fmt::Display for Why {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Why::Aligned => write!(f, "aligned"),
            Why::GnssLost(fault) => write!(f, "GNSS {}", fault.reason()),
            Why::GnssBack => write!(f, "GNSS is back"),
            Why::Joined => write!(f, "joined GNSS"),
            Why::Uncertain(sigma) => write!(f, "uncertainty {sigma:.0} m"),
            Why::Coasted(s) => write!(f, "{s:.0} s without velocity"),
            Why::Landmarks => write!(f, "landmarks in view"),
            Why::ImuGap(s) => write!(f, "IMU silent for {s:.1} s"),
            Why::HeadingWrong => write!(f, "heading from motion does not fit"),
            Why::Reboot => write!(f, "autopilot rebooted"),
            Why::Broken => write!(f, "estimate not finite"),
        }
    }
}

impl fmt::Display for What {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            What::Mode { from, to, why } => write!(f, "{} -> {}: {why}", from.label(), to.label()),
            What::Origin(m) if *m == 0.0 => write!(f, "origin set"),
            What::Origin(m) => write!(f, "origin moved by {m:.2} m"),
            What::Reset(m) => write!(f, "position reset by {m:.1} m"),
            What::WalkedBack(m) => write!(f, "took back {m:.1} m of GNSS drift"),
            What::Receiver(n) => write!(f, "using GNSS receiver {n}"),
            What::FlowTrusted(n) => write!(f, "flow {n} trusted"),
            What::FlowDistrusted(n, why) => write!(f, "flow {n} not trusted: {}", why.reason()),
            What::HeightFault { channel, fault: fault @ Fault::Drift { .. }, .. } => {
                write!(f, "{} {fault}", channel.label())
            }
            What::HeightFault { channel, fault, for_s } => {
                write!(f, "{} {fault} for {for_s:.1} s", channel.label())
            }
            What::HeightHealed(channel) => write!(f, "{} healthy again", channel.label()),
            What::InertialHeight(m) => write!(f, "inertial height was off, moved by {m:+.1} m"),
            What::HeightReset(m) => write!(f, "height reset by {m:+.1} m"),
            What::FilterRestarted(apart) => {
                write!(f, "filter restarted: {:.0} deg from the observer", apart.to_degrees())
            }
            What::Carried(carrier) => write!(f, "carried by {}", carrier.label()),
            What::Bridged(s) => write!(f, "IMU silent for {s:.1} s: carried over"),
            What::HeadingSought => write!(f, "no magnetometer: heading from GNSS acceleration, needs motion"),
            What::HeadingFound(sigma) => {
                write!(f, "heading found from motion, +- {:.0} deg", sigma.to_degrees())
            }
            What::LandmarksFound => write!(f, "landmarks found"),
            What::LandmarksLost => write!(f, "landmarks lost"),
            What::LandmarkContradicts(id) => write!(f, "landmark {id} contradicts the others"),
            What::LandmarksContradict { suspect, trusted } => {
                write!(f, "{suspect} landmarks contradict {trusted}: not used")
            }
            What::LandmarksApart(m) => write!(f, "landmarks contradict GNSS by {m:.1} m: not used"),
            What::LandmarksAgree => write!(f, "landmarks and GNSS agree"),
            What::LandmarkFrame(heading, sigma) => write!(
                f,
                "landmarks' frame aligned: turned by {:.1} +- {:.1} deg",
                heading.to_degrees(),
                sigma.to_degrees()
            ),
        }
    }
}
