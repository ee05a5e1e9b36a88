//! What a link counts.

use std::net::SocketAddr;

use super::LinkId;
use crate::time::{Companion, Stamp};
use crate::wire::counters::Counters;
use crate::wire::endpoint::Endpoint;
use crate::wire::frame::{ComponentId, Frame, SystemId};

/// How a link stands.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum LinkState {
    /// Being opened, or waiting for a peer.
    Waiting,
    /// Frames can be sent.
    Up,
    /// Cancelled.
    Closed,
}

/// Everything that a link counted, at one moment.
#[derive(Clone, PartialEq, Debug)]
pub struct LinkStats {
    /// Which link.
    pub link: LinkId,
    /// Its endpoint.
    pub endpoint: Endpoint,
    /// The address it listens at, with the port that the system chose.
    pub local: Option<SocketAddr>,
    /// How it stands.
    pub state: LinkState,
    /// The other end, while it is up.
    pub peer: Option<String>,
    /// When the last valid frame of the peer came.
    pub last_heard: Option<Stamp<Companion>>,
    /// Bytes read, of whatever sender.
    pub bytes_in: u64,
    /// Bytes written.
    pub bytes_out: u64,
    /// Frames received from the peer, known messages or not.
    pub frames_in: u64,
    /// Frames written.
    pub frames_out: u64,
    /// Bytes and frames of the peer that were no good, by cause; unknown messages count but are delivered.
    pub rejects: Counters,
    /// Frames dropped because nobody took them from the inbound queue.
    pub inbound_dropped: u64,
    /// Frames not sent because the link was down.
    pub unsent_down: u64,
    /// Frames not sent because newer ones needed their place in the queue.
    pub unsent_full: u64,
    /// Frames not sent because they had waited too long.
    pub unsent_stale: u64,
    /// Frames not sent because they could not be signed.
    pub unsent_unsigned: u64,
    /// Datagrams, or connections, from others than the peer.
    pub wrong_peer: u64,
    /// What was not taken because there was too much of it.
    pub excess: Excess,
    /// Datagrams from before an autopilot was heard.
    pub unpinned: u64,
    /// Times that the link came up again after it had been down.
    pub reconnects: u64,
    /// Errors of reading, writing and opening.
    pub io_errors: u64,
    /// Events dropped because nobody took them.
    pub events_dropped: u64,
    /// Frames by sender.
    pub sources: Vec<SourceStats>,
    /// Frames of senders beyond the first [`SourceStats::MAX`], whose losses are not followed.
    pub sources_overflow: u64,
}

/// What was not taken because there was too much of it.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Excess {
    /// Frames of the peer beyond [`super::LinkLimits::frames_per_s`].
    pub frames: u64,
    /// Bytes of the peer that are no frame, and were not searched for one: beyond [`super::LinkLimits::search_bytes_per_s`].
    pub unsearched_bytes: u64,
    /// Bytes in datagrams of others than the peer.
    pub stranger_bytes: u64,
    /// Datagrams of the peer that the kernel dropped, as they were not read in time.
    pub unread: u64,
    /// Datagrams of whoever sends to the port that the kernel dropped while the peer had a socket of its own.
    pub strangers_unread: u64,
    /// Frames of which there were so many that their signatures were not looked at.
    pub unverified: u64,
}

impl Excess {
    /// Adds another link's.
    pub fn add(&mut self, other: &Self) {
        self.frames += other.frames;
        self.unsearched_bytes += other.unsearched_bytes;
        self.stranger_bytes += other.stranger_bytes;
        self.unread += other.unread;
        self.strangers_unread += other.strangers_unread;
        self.unverified += other.unverified;
    }
}

/// Frames of one sender on a link.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SourceStats {
    /// The sender's system.
    pub system: SystemId,
    /// The sender's component.
    pub component: ComponentId,
    /// Frames that came.
    pub frames: u64,
    /// Frames missing from the sequence numbers: an estimate, as 256 lost in a row go unnoticed.
    pub lost: u64,
    /// Frames with a number just before the last one: doubled or overtaken on the way.
    pub reordered: u64,
    last_sequence: u8,
}

impl SourceStats {
    /// Senders that are followed on one link; an attacker can invent 65536.
    pub const MAX: usize = 64;
    /// A number up to this far back is an overtaken frame, not 250 lost ones.
    const REORDER_WINDOW: u8 = 8;

    fn note(&mut self, sequence: u8) {
        self.frames += 1;
        let gap = sequence.wrapping_sub(self.last_sequence).wrapping_sub(1);
        if gap >= u8::MAX - Self::REORDER_WINDOW {
            self.reordered += 1;
            // A frame that was overtaken had been counted as lost; a doubled one had not.
            if gap != u8::MAX {
                self.lost = self.lost.saturating_sub(1);
            }
            return;
        }
        self.lost += u64::from(gap);
        self.last_sequence = sequence;
    }
}

impl LinkStats {
    pub(super) fn new(link: LinkId, endpoint: Endpoint) -> Self {
        Self {
            link,
            endpoint,
            local: None,
            state: LinkState::Waiting,
            peer: None,
            last_heard: None,
            bytes_in: 0,
            bytes_out: 0,
            frames_in: 0,
            frames_out: 0,
            rejects: Counters::default(),
            inbound_dropped: 0,
            unsent_down: 0,
            unsent_full: 0,
            unsent_stale: 0,
            unsent_unsigned: 0,
            wrong_peer: 0,
            excess: Excess::default(),
            unpinned: 0,
            reconnects: 0,
            io_errors: 0,
            events_dropped: 0,
            sources: Vec::new(),
            sources_overflow: 0,
        }
    }

    /// Frames lost on the way, over all senders.
    pub fn lost_frames(&self) -> u64 {
        self.sources.iter().map(|s| s.lost).sum()
    }

    /// Follows the sequence numbers. Only a checked frame introduces a new sender: garbage must not.
    pub(super) fn follow(&mut self, frame: &Frame<'_>, checked: bool) {
        let (system, component, sequence) = (frame.system(), frame.component(), frame.sequence());
        if let Some(source) = self.sources.iter_mut().find(|s| s.system == system && s.component == component)
        {
            source.note(sequence);
        } else if checked && self.sources.len() < SourceStats::MAX {
            let first =
                SourceStats { system, component, frames: 1, lost: 0, reordered: 0, last_sequence: sequence };
            self.sources.push(first);
        } else {
            self.sources_overflow += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source() -> SourceStats {
        SourceStats {
            system: SystemId(1),
            component: ComponentId(1),
            frames: 1,
            lost: 0,
            reordered: 0,
            last_sequence: 250,
        }
    }

    #[test]
    fn gaps_are_lost_frames_across_the_wrap_too() {
        let mut s = source();
        for sequence in [251, 254, 255, 0, 1, 5] {
            s.note(sequence);
        }
        assert_eq!((s.frames, s.lost, s.reordered), (7, 5, 0));
    }

    #[test]
    fn doubled_and_overtaken_frames_are_not_hundreds_lost() {
        let mut s = source();
        for sequence in [251, 251, 253, 252, 254] {
            s.note(sequence);
        }
        assert_eq!((s.lost, s.reordered), (0, 2));
    }
}
