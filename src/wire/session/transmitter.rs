//! Writes to the links: every link has its own sequence numbers, and answers go where the autopilot is listened to.

use mavlink::dialects::ardupilotmega::MavMessage;

use super::Address;
use super::outgoing::FrameWriter;
use crate::time::{Companion, Span, Stamp};
use crate::wire::frame::{ComponentId, SystemId};
use crate::wire::frame_bytes::FrameBytes;
use crate::wire::link::{LinkHandles, LinkId, ReplyRoute, SendOutcome};

/// The autopilot may be heard on another link after so long without it on the one that is listened to.
const PATIENCE: Span = Span::from_millis(3000);

/// Sends messages as [`ComponentId::ODOMETRY_SOURCE`] of the vehicle.
#[derive(Debug)]
pub struct Transmitter {
    handles: LinkHandles,
    writers: Vec<FrameWriter>,
    route: ReplyRoute,
    /// What was sent, where somebody records it.
    sent: Option<Vec<FrameBytes>>,
}

impl Transmitter {
    /// Speaks as a part of `system` on every link, from sequence number 0.
    pub fn new(handles: LinkHandles, system: SystemId) -> Self {
        let from = Address { system, component: ComponentId::ODOMETRY_SOURCE };
        let writers = handles.ids().map(|_| FrameWriter::new(from)).collect();
        Self { handles, writers, route: ReplyRoute::new(PATIENCE), sent: None }
    }

    /// Remembers what is sent from now on, for [`Transmitter::take_sent`].
    pub fn remember(&mut self) {
        self.sent = Some(Vec::with_capacity(16));
    }

    /// What was sent since this was asked last, without signatures.
    pub fn take_sent(&mut self) -> impl Iterator<Item = FrameBytes> + '_ {
        self.sent.iter_mut().flat_map(|sent| sent.drain(..))
    }

    /// Speaks as a part of `system` from now on.
    pub fn belong_to(&mut self, system: SystemId) -> Address {
        let from = Address { system, component: ComponentId::ODOMETRY_SOURCE };
        for writer in self.writers.iter_mut().filter(|w| w.from() != from) {
            *writer = FrameWriter::new(from);
        }
        from
    }

    /// The links.
    pub fn handles(&self) -> &LinkHandles {
        &self.handles
    }

    /// Where the autopilot is listened to.
    pub fn route(&mut self) -> &mut ReplyRoute {
        &mut self.route
    }

    /// Sends on the link that the autopilot is listened to on; whether it could be queued there.
    pub fn answer(&mut self, message: &MavMessage) -> bool {
        self.route.link().is_some_and(|link| self.send(link, message, None))
    }

    /// The same with what stands on a sample that came at `since`, and is worth nothing when that is long ago.
    pub fn answer_since(&mut self, message: &MavMessage, since: Stamp<Companion>) -> bool {
        self.route.link().is_some_and(|link| self.send(link, message, Some(since)))
    }

    /// Sends on every link.
    pub fn broadcast(&mut self, message: &MavMessage) {
        for i in 0..self.writers.len() {
            self.send(LinkId(i), message, None);
        }
    }

    fn send(&mut self, link: LinkId, message: &MavMessage, since: Option<Stamp<Companion>>) -> bool {
        let Some(frame) = self.writers.get_mut(link.0).and_then(|w| w.write(message)) else { return false };
        let outcome = match since {
            Some(since) => self.handles.send_since(link, frame, since),
            None => self.handles.send(link, frame),
        };
        let queued = matches!(outcome, SendOutcome::Queued | SendOutcome::QueuedOldestDropped);
        if let Some(sent) = &mut self.sent
            && queued
        {
            sent.push(frame);
        }
        queued
    }

    /// Whether the autopilot is listened to on `link`, of which it was heard just now; and whether that is another link than
    /// before.
    pub fn listens(&mut self, link: LinkId, now: Stamp<Companion>) -> (bool, bool) {
        let before = self.route.link();
        let moved = self.route.heard(link, now) && before.is_some_and(|b| b != link);
        (self.route.link() == Some(link), moved)
    }
}
