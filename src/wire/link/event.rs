//! What befalls a link, for the log.

use std::fmt;
use std::time::Duration;

use super::LinkId;
use crate::time::{Companion, Span, Stamp};
use crate::wire::session::identity::AutopilotShown;

/// Something happened to a link.
#[derive(Clone, PartialEq, Debug)]
pub struct LinkEvent {
    /// Which link.
    pub link: LinkId,
    /// When.
    pub at: Stamp<Companion>,
    /// What.
    pub kind: LinkEventKind,
}

/// What happened to a link.
#[derive(Clone, PartialEq, Debug)]
pub enum LinkEventKind {
    /// The link can carry frames, to and from `peer`.
    Up {
        /// Address or device at the other end.
        peer: String,
    },
    /// The link was up and is not any more.
    Down {
        /// Why.
        reason: String,
    },
    /// An attempt to open it again failed.
    Retry {
        /// Why.
        reason: String,
        /// Pause before the next attempt.
        after: Duration,
    },
    /// An autopilot was heard from this UDP peer for long enough: the link is up and answers nobody else.
    PeerPinned {
        /// Its address.
        peer: String,
        /// What was heard of its autopilot meanwhile.
        shown: Option<Box<AutopilotShown>>,
    },
    /// When a peer was pinned, others looked like autopilots, too.
    RivalsHeard {
        /// The one that is answered.
        peer: String,
        /// How many others there were.
        rivals: usize,
    },
    /// The autopilot of the pinned peer is heard from another address, by its clock since boot, and answered there.
    PeerFollowed {
        /// The address before.
        from: String,
        /// The address now.
        to: String,
    },
    /// Another peer took the place of one that was silent or had no IMU messages.
    PeerReplaced {
        /// The address before.
        from: String,
        /// The address now.
        to: String,
        /// Whether it was silent; else it had no IMU messages.
        silent: bool,
        /// For how long.
        lasted: Span,
    },
    /// The pinned UDP peer was silent for too long: the link is down until an autopilot is heard, from anywhere.
    PeerReleased {
        /// Its address.
        peer: String,
        /// How long it was silent.
        silent: Span,
    },
    /// Somebody else sends to this link, and is ignored. Told once per pinned peer or connection; all are counted.
    StrangerIgnored {
        /// The stranger's address.
        peer: String,
    },
    /// Sending or receiving fails for the time being. Told once until it works again; all failures are counted.
    Trouble {
        /// What the operating system says.
        reason: String,
    },
}

impl fmt::Display for LinkEventKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Up { peer } => write!(f, "up, to {peer}"),
            Self::Down { reason } => write!(f, "down: {reason}"),
            Self::Retry { reason, after } => write!(f, "cannot be opened ({reason}), again in {after:?}"),
            Self::PeerPinned { peer, .. } => {
                write!(f, "an autopilot was heard at {peer}, and nobody else is answered")
            }
            Self::RivalsHeard { peer, rivals } => write!(
                f,
                "{rivals} other {} seemed to be an autopilot, too, before {peer} was chosen",
                if *rivals == 1 { "address" } else { "addresses" }
            ),
            Self::PeerFollowed { from, to } => {
                write!(f, "the autopilot at {from} is heard at {to} now, and answered there")
            }
            Self::PeerReplaced { from, to, silent, lasted } => write!(
                f,
                "{from} {} for {:.1} s, and {to} takes its place",
                if *silent { "was silent" } else { "had no IMU messages" },
                lasted.seconds()
            ),
            Self::PeerReleased { peer, silent } => {
                write!(
                    f,
                    "{peer} was silent for {:.1} s, waiting for an autopilot from anywhere",
                    silent.seconds()
                )
            }
            Self::StrangerIgnored { peer } => write!(f, "{peer} is ignored: another peer is served"),
            Self::Trouble { reason } => write!(f, "trouble for the time being: {reason}"),
        }
    }
}
