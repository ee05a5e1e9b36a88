//! Which UDP peer is answered: the one an autopilot's heartbeat came from, and nobody else while it speaks.

use std::net::SocketAddr;

use crate::time::{Companion, Span, Stamp};

/// The pinned peer.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pin {
    peer: Option<(SocketAddr, Stamp<Companion>)>,
}

/// What to do with a datagram.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum PinVerdict {
    /// It comes from the pinned peer.
    Serve,
    /// It holds an autopilot's heartbeat, and its sender is the pinned peer from now on.
    Pinned,
    /// Another peer is pinned.
    Stranger,
    /// Nobody is pinned, and this is no autopilot.
    Unpinned,
}

impl Pin {
    /// Judges a datagram from `peer`; `valid` if it holds a frame with a valid checksum.
    pub(super) fn judge(
        &mut self,
        peer: SocketAddr,
        now: Stamp<Companion>,
        valid: bool,
        autopilot: bool,
    ) -> PinVerdict {
        match &mut self.peer {
            Some((pinned, heard)) if *pinned == peer => {
                // Garbage does not keep a pin alive.
                if valid {
                    *heard = now;
                }
                PinVerdict::Serve
            }
            Some(_) => PinVerdict::Stranger,
            None if autopilot => {
                self.peer = Some((peer, now));
                PinVerdict::Pinned
            }
            None => PinVerdict::Unpinned,
        }
    }

    pub(super) fn peer(&self) -> Option<SocketAddr> {
        self.peer.map(|(peer, _)| peer)
    }

    /// Lets go of a peer that was silent for longer than `limit`.
    pub(super) fn expire(&mut self, now: Stamp<Companion>, limit: Span) -> Option<(SocketAddr, Span)> {
        let (peer, heard) = self.peer?;
        let silent = now - heard;
        if silent <= limit {
            return None;
        }
        self.peer = None;
        Some((peer, silent))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn addr(port: u16) -> SocketAddr {
        ([127, 0, 0, 1], port).into()
    }

    fn at(ms: i64) -> Stamp<Companion> {
        Stamp::from_micros(ms * 1000)
    }

    #[test]
    fn only_an_autopilot_pins_and_only_silence_unpins() {
        let limit = Span::from_millis(5000);
        let mut pin = Pin::default();
        assert_eq!(pin.judge(addr(1), at(0), true, false), PinVerdict::Unpinned);
        assert_eq!(pin.judge(addr(2), at(1), true, true), PinVerdict::Pinned);
        assert_eq!(pin.judge(addr(1), at(2), true, true), PinVerdict::Stranger);
        assert_eq!(pin.judge(addr(2), at(3000), true, false), PinVerdict::Serve);
        assert_eq!(pin.expire(at(8000), limit), None);
        assert_eq!(pin.expire(at(8001), limit), Some((addr(2), Span::from_millis(5001))));
        assert_eq!(pin.judge(addr(1), at(8002), true, true), PinVerdict::Pinned);
    }

    #[test]
    fn garbage_does_not_keep_a_pin() {
        let mut pin = Pin::default();
        pin.judge(addr(2), at(0), true, true);
        assert_eq!(pin.judge(addr(2), at(4999), false, false), PinVerdict::Serve);
        assert!(pin.expire(at(5001), Span::from_millis(5000)).is_some());
    }
}
