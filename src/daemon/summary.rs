//! One line that says how it fares, for the log.

use std::fmt;

use crate::altimeter::{Channel, Health};
use crate::navigator::Navigator;
use crate::navigator::shadow::MeasuredDrift;
use crate::navigator::solution::Mode;
use crate::navigator::sources::status::{SourceHealth, SourceReport};
use crate::outbound::handover::{Sending, StandsOn};
use crate::record::RecordCounts;
use crate::sample::SampleKind;
use crate::time::Span;
use crate::wire::counters::Counters;
use crate::wire::decode::Repairs;
use crate::wire::link::Excess;
use crate::wire::session::fusion::Fusion;
use crate::wire::signing::SigningCounts;

/// The sources of heights that are declared faulty.
pub(super) fn faulty_heights(navigator: &Navigator) -> Vec<(Channel, Health)> {
    let mut health = Vec::from(navigator.height_health());
    health.retain(|(_, health)| health.is_faulty());
    health
}

/// What the daemon counted, at one moment.
#[derive(Clone, Debug)]
pub struct Summary {
    /// The navigator's mode.
    pub mode: Mode,
    /// Horizontal uncertainty, m, once there is a solution.
    pub sigma_m: Option<f64>,
    /// What an outage would come to, as it was measured on this flight.
    pub drift: Option<MeasuredDrift>,
    /// Sources of heights that are declared faulty.
    pub faulty_heights: Vec<(Channel, Health)>,
    /// Every source that was heard, as it fares at present.
    pub sources: Vec<SourceReport>,
    /// Samples a second since the summary before, by [`SampleKind`].
    pub rates_hz: [f64; SampleKind::ALL.len()],
    /// Position messages sent.
    pub sent: u64,
    /// Whether and why they are sent, and what the autopilot makes of them, once it is known.
    pub hand_over: Option<HandOverSummary>,
    /// Position messages withheld, because a number in them was not finite.
    pub not_finite: u64,
    /// Position messages withheld, because the sample they stand on waited too long in the daemon.
    pub late: u64,
    /// What was not used, by cause, on the links and in the decoder.
    pub rejects: Counters,
    /// What was put right in the autopilot's messages.
    pub repairs: Repairs,
    /// Frames of the autopilot that came on another link than the one that is listened to.
    pub duplicates: u64,
    /// Measurements that came on links for sensors, and frames there that are none.
    pub sensor_frames: [u64; 2],
    /// Frames dropped because the daemon did not keep up.
    pub inbound_dropped: u64,
    /// Datagrams and connections of others than the peers.
    pub strangers: u64,
    /// What links did not take because there was too much of it.
    pub excess: Excess,
    /// Frames not sent because the link did not keep up.
    pub unsent: u64,
    /// Autopilot clock less ours, and the shortest round trip.
    pub timesync: Option<(Span, Span)>,
    /// TIMESYNC questions of the autopilot that were answered.
    pub answered: u64,
    /// Words withheld from the pilot because there were too many.
    pub words_withheld: u64,
    /// Reboots of the autopilot.
    pub reboots: u32,
    /// What became of signatures.
    pub signing: SigningCounts,
    /// How the recording fares, where there is one.
    pub recording: Option<RecordCounts>,
    /// Lines of the log that could not be written.
    pub lines_lost: u64,
}

/// How it stands with the hand-over.
#[derive(Clone, Copy, Debug)]
pub struct HandOverSummary {
    /// Whether something is sent, and why.
    pub sending: Sending,
    /// What the autopilot's position stands on.
    pub standing: StandsOn,
    /// What it makes of what is sent.
    pub fusion: Fusion,
    /// Our frame to the autopilot's, m, and its heading less ours, rad, once they were compared.
    pub offset: Option<(f64, f64)>,
}

impl fmt::Display for HandOverSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "; {}; autopilot on {}", self.sending.label(), self.standing.label())?;
        if self.fusion != Fusion::NotSent {
            write!(f, "; {}", self.fusion)?;
        }
        if let Some((offset_m, heading_rad)) = self.offset {
            write!(f, "; its frame {offset_m:.1} m and {:.1} deg from ours", heading_rad.to_degrees())?;
        }
        Ok(())
    }
}

impl Summary {
    /// Sources that cannot be believed at present, with what speaks against them most often.
    fn write_doubted(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for s in self.sources.iter().filter(|s| s.health != SourceHealth::Healthy) {
            write!(f, "; {} {} {}", s.kind.label(), s.id, s.health.label())?;
            if let Some(charge) = s.charge {
                write!(f, ": {}", charge.label())?;
            }
            if let Some((reason, n)) = s.rejected.iter().max_by_key(|(_, n)| **n) {
                write!(f, " ({n} {reason})")?;
            }
        }
        Ok(())
    }

    /// Samples a second by kind.
    fn write_heard(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "; heard")?;
        let mut heard = false;
        for &kind in SampleKind::ALL {
            let rate = self.rates_hz[kind as usize];
            if rate > 0.0 {
                write!(f, "{} {} {rate:.1} Hz", if heard { "," } else { "" }, kind.label())?;
                heard = true;
            }
        }
        if !heard {
            write!(f, " nothing")?;
        }
        Ok(())
    }

    /// What was sent, and what was withheld or lost.
    fn write_sent(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.sensor_frames {
            [0, 0] => {}
            [taken, 0] => write!(f, "; {taken} measurements of sensors on their own links")?,
            [taken, other] => {
                write!(f, "; {taken} measurements of sensors on their own links, {other} other frames there")?
            }
        }
        write!(f, "; sent {}", self.sent)?;
        for (n, what) in [
            (self.not_finite, "not finite"),
            (self.late, "late"),
            (self.duplicates, "duplicates"),
            (self.inbound_dropped, "dropped on the way in"),
            (self.strangers, "datagrams or connections of strangers"),
            (self.excess.frames, "frames too many"),
            (self.excess.unsearched_bytes, "garbage bytes too many"),
            (self.excess.unverified, "signatures too many"),
            (self.excess.unread, "datagrams not read in time"),
            (self.excess.strangers_unread, "of strangers not read"),
            (self.unsent, "dropped on the way out"),
            (self.words_withheld, "words withheld"),
            (u64::from(self.reboots), "reboots"),
            (self.lines_lost, "lines of the log lost"),
            (self.recording.map_or(0, |r| r.lost), "frames not recorded, the disk does not keep up"),
        ] {
            if n > 0 {
                write!(f, ", {n} {what}")?;
            }
        }
        Ok(())
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write_uncertainty(f)?;
        for (channel, health) in &self.faulty_heights {
            write!(f, "; {} {health}", channel.label())?;
        }
        self.write_doubted(f)?;
        self.write_heard(f)?;
        self.write_sent(f)?;
        if let Some(hand_over) = &self.hand_over {
            write!(f, "{hand_over}")?;
        }
        for (i, (cause, n)) in self.rejects.seen().enumerate() {
            write!(f, "{} {n} {}", if i == 0 { "; rejected" } else { "," }, cause.label())?;
        }
        write!(f, "{}", self.signing)?;
        for (repair, n) in self.repairs.seen() {
            write!(f, "; {n} {}", repair.label())?;
        }
        self.write_clock(f)
    }
}

impl Summary {
    /// The mode, how wrong the position may be, and beside GNSS what it would be without.
    fn write_uncertainty(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.mode.label())?;
        if let Some(sigma) = self.sigma_m.filter(|_| self.mode != Mode::Aligning) {
            write!(f, " +-{sigma:.1} m")?;
        }
        match self.drift.filter(|_| self.mode == Mode::Aided) {
            Some(drift) => write!(f, "; {drift}"),
            None => Ok(()),
        }
    }

    /// How the autopilot's clock is known.
    fn write_clock(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.timesync {
            Some((offset, round_trip)) => write!(
                f,
                "; timesync {:.3} s, round trip {:.1} ms, {} answered",
                offset.seconds(),
                1e3 * round_trip.seconds(),
                self.answered
            ),
            None => write!(f, "; no timesync, {} answered", self.answered),
        }
    }
}
