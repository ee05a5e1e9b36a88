//! What the tasks of a link and its handles share: counters, queues and state.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::mpsc;

use super::arrival::Attendance;
use super::backoff::Backoff;
use super::candidate::Evidence;
use super::deframer::{Found, deframe};
use super::event::{LinkEvent, LinkEventKind};
use super::pin::PinPolicy;
use super::queue::{OutboundQueue, SendOutcome};
use super::stats::{LinkState, LinkStats};
use super::throttle::Throttle;
use super::{LinkConfig, LinkId, ReceivedFrame};
use crate::time::{Companion, Span, Stamp};
use crate::wire::counters::{Cause, Counters};
use crate::wire::endpoint::Endpoint;
use crate::wire::frame::Frame;
use crate::wire::frame_bytes::FrameBytes;
use crate::wire::running_crc::RunningCrc;

/// One link.
#[derive(Debug)]
pub(super) struct Shared {
    id: LinkId,
    pub(super) config: LinkConfig,
    attendance: Arc<Attendance>,
    outbound: OutboundQueue,
    inbound: mpsc::Sender<ReceivedFrame>,
    events: mpsc::Sender<LinkEvent>,
    inner: Mutex<Inner>,
    held: AtomicBool,
}

#[derive(Debug)]
struct Inner {
    stats: LinkStats,
    throttle: Throttle,
    measured: Option<Stamp<Companion>>,
    was_up: bool,
    troubled: bool,
    stranger_told: bool,
}

/// What of some bytes is no frame.
#[derive(Debug, Default)]
pub(super) struct Rejects {
    counters: Counters,
    unsearched_bytes: u64,
}

impl Rejects {
    pub(super) fn note(&mut self, found: &Found<'_>) {
        match found {
            Found::Frame(_) | Found::Unknown(_) => {}
            Found::Reject { cause, n } => self.counters.add(*cause, *n),
            Found::Unsearched(n) => self.unsearched_bytes += n,
        }
    }
}

pub(super) fn span(duration: Duration) -> Span {
    Span::from_micros(i64::try_from(duration.as_micros()).unwrap_or(i64::MAX))
}

impl Shared {
    pub(super) fn new(
        id: LinkId,
        endpoint: Endpoint,
        config: &LinkConfig,
        attendance: Arc<Attendance>,
        inbound: mpsc::Sender<ReceivedFrame>,
        events: mpsc::Sender<LinkEvent>,
    ) -> Self {
        let stats = LinkStats::new(id, endpoint);
        Self {
            id,
            config: config.clone(),
            attendance,
            outbound: OutboundQueue::new(config.outbound_capacity, span(config.max_queue_age)),
            inbound,
            events,
            inner: Mutex::new(Inner {
                stats,
                throttle: Throttle::new(&config.limits),
                measured: None,
                was_up: false,
                troubled: false,
                stranger_told: false,
            }),
            held: AtomicBool::new(false),
        }
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn id(&self) -> LinkId {
        self.id
    }

    /// Whether this link is for sensors.
    pub(super) fn is_for_sensors(&self) -> bool {
        self.id.0 >= self.config.sensors_from
    }

    pub(super) fn now(&self) -> Stamp<Companion> {
        self.attendance.now()
    }

    /// When the process has read its links, and when it could not.
    pub(super) fn attendance(&self) -> &Attendance {
        &self.attendance
    }

    pub(super) fn stats(&self) -> LinkStats {
        self.inner().stats.clone()
    }

    pub(super) fn set_local(&self, local: Option<SocketAddr>) {
        self.inner().stats.local = local;
    }

    pub(super) fn backoff(&self) -> Backoff {
        Backoff::new(self.config.backoff_first, self.config.backoff_cap)
    }

    pub(super) fn emit(&self, kind: LinkEventKind) {
        let event = LinkEvent { link: self.id, at: self.now(), kind };
        if self.events.try_send(event).is_err() {
            self.inner().stats.events_dropped += 1;
        }
    }

    /// The link can carry frames to `peer` from now on.
    pub(super) fn up(&self, peer: String, event: impl FnOnce(String) -> LinkEventKind) {
        {
            let mut inner = self.inner();
            if std::mem::replace(&mut inner.was_up, true) {
                inner.stats.reconnects += 1;
            }
            inner.stats.state = LinkState::Up;
            inner.stats.peer = Some(peer.clone());
            inner.stranger_told = false;
            inner.troubled = false;
        }
        self.outbound.open();
        self.emit(event(peer));
    }

    /// The link cannot carry frames from now on.
    pub(super) fn down(&self, event: LinkEventKind) {
        self.stop(LinkState::Waiting);
        self.emit(event);
    }

    /// The link's task has ended.
    pub(super) fn closed(&self) {
        self.stop(LinkState::Closed);
    }

    fn stop(&self, state: LinkState) {
        let unsent = self.outbound.close();
        let mut inner = self.inner();
        inner.stats.unsent_down += unsent;
        inner.stats.state = state;
        inner.stats.peer = None;
    }

    /// Waits before the next attempt to open the link, and says so.
    pub(super) async fn pause(&self, backoff: &mut Backoff, reason: String) {
        let after = backoff.pause();
        self.inner().stats.io_errors += 1;
        self.emit(LinkEventKind::Retry { reason, after });
        tokio::time::sleep(after).await;
    }

    /// An error that may pass.
    pub(super) fn trouble(&self, error: &std::io::Error) {
        let first = {
            let mut inner = self.inner();
            inner.stats.io_errors += 1;
            !std::mem::replace(&mut inner.troubled, true)
        };
        if first {
            self.emit(LinkEventKind::Trouble { reason: error.to_string() });
        }
    }

    /// A sender that is not the peer, of a datagram of so many bytes.
    pub(super) fn stranger(&self, peer: SocketAddr, bytes: usize) {
        let first = {
            let mut inner = self.inner();
            inner.stats.wrong_peer += 1;
            inner.stats.excess.stranger_bytes += bytes as u64;
            !std::mem::replace(&mut inner.stranger_told, true)
        };
        if first {
            self.emit(LinkEventKind::StrangerIgnored { peer: peer.to_string() });
        }
    }

    /// A datagram from before anybody was pinned.
    pub(super) fn unpinned(&self, rejects: &Rejects) {
        self.inner().stats.unpinned += 1;
        self.rejected(rejects);
    }

    pub(super) fn read(&self, bytes: usize) {
        self.inner().stats.bytes_in += bytes as u64;
    }

    /// The kernel dropped so many datagrams on a socket that was not read in time; on the peer's own, or on everybody's beside one.
    pub(super) fn unread(&self, datagrams: u32, of_peer: bool) {
        if datagrams > 0 {
            let excess = &mut self.inner().stats.excess;
            let count = if of_peer { &mut excess.unread } else { &mut excess.strangers_unread };
            *count += u64::from(datagrams);
        }
    }

    /// Whether the autopilot on the link must not be mistaken for another now.
    pub(super) fn is_held(&self) -> bool {
        self.held.load(Ordering::Relaxed)
    }

    pub(super) fn hold(&self, held: bool) {
        self.held.store(held, Ordering::Relaxed);
    }

    /// Passes on the frames in a datagram of the peer, tells `heard` of those that are genuine, and counts what is none. Never waits.
    pub(super) fn datagram(
        &self,
        datagram: &[u8],
        crc: &mut RunningCrc,
        received: Stamp<Companion>,
        mut heard: impl FnMut(&Frame<'_>),
    ) {
        let mut rejects = Rejects::default();
        let may_search = |n| self.inner().throttle.may_search(n, received);
        deframe(datagram, crc, may_search, |found| {
            let admitted = self.found(&found, received, &mut rejects);
            if let (Found::Frame(frame), true) = (&found, admitted) {
                heard(frame);
            }
        });
        self.rejected(&rejects);
    }

    /// Passes a frame on, or counts what is none in `rejects`; whether it is a frame that may come in. Never waits.
    pub(super) fn found(&self, found: &Found<'_>, received: Stamp<Companion>, rejects: &mut Rejects) -> bool {
        let (frame, known) = match found {
            Found::Frame(frame) => (frame, true),
            Found::Unknown(frame) => (frame, false),
            found => {
                rejects.note(found);
                return false;
            }
        };
        let admitted = self.admits(frame);
        if admitted {
            self.frame(frame, received, known);
        }
        admitted
    }

    /// Whether a frame may decide who the peer is.
    pub(super) fn is_genuine(&self, frame: &Frame<'_>) -> bool {
        self.may_verify(frame) && self.config.signing.is_genuine(frame, self.is_for_sensors())
    }

    /// Whether one more signature may be looked at: each costs a hash, whoever has sent it.
    fn may_verify(&self, frame: &Frame<'_>) -> bool {
        if !frame.is_signed() || self.config.signing.key().is_none() {
            return true;
        }
        let mut inner = self.inner();
        let may = inner.throttle.may_verify(self.attendance.now());
        inner.stats.excess.unverified += u64::from(!may);
        may
    }

    /// Whether a frame's signature lets it in; one that is refused is counted.
    pub(super) fn admits(&self, frame: &Frame<'_>) -> bool {
        if !self.may_verify(frame) {
            return false;
        }
        let verdict = self.config.signing.admit(frame, self.is_for_sensors(), self.attendance.unix_us());
        if let Err(cause) = verdict {
            self.inner().stats.rejects.count(cause);
        }
        verdict.is_ok()
    }

    pub(super) fn rejected(&self, rejects: &Rejects) {
        let stats = &mut self.inner().stats;
        stats.rejects.merge(&rejects.counters);
        stats.excess.unsearched_bytes += rejects.unsearched_bytes;
    }

    fn frame(&self, frame: &Frame<'_>, received: Stamp<Companion>, known: bool) {
        let mut inner = self.inner();
        let inner = &mut *inner;
        let stats = &mut inner.stats;
        stats.follow(frame, known);
        if !inner.throttle.admits(frame, known, received) {
            stats.excess.frames += 1;
            return;
        }
        let delivered = FrameBytes::new(frame.bytes()).is_some_and(|bytes| {
            self.inbound.try_send(ReceivedFrame { link: self.id, received, bytes, known }).is_ok()
        });
        stats.frames_in += 1;
        stats.inbound_dropped += u64::from(!delivered);
        if known {
            stats.rejects.frames += 1;
            stats.last_heard = Some(received);
            inner.troubled = false;
            if Evidence::of(frame, &self.pin_policy()) == Some(Evidence::Measurement) {
                inner.measured = Some(received);
            }
        } else {
            stats.rejects.count(Cause::UnknownId);
        }
    }

    /// How a peer of this link is chosen.
    pub(super) fn pin_policy(&self) -> PinPolicy {
        PinPolicy {
            system: self.config.system,
            component: self.config.component,
            for_sensors: self.is_for_sensors(),
            confirm: span(self.config.peer_confirm),
            silence: span(self.config.peer_silence),
        }
    }

    /// When the last measurement came.
    pub(super) fn last_measured(&self) -> Option<Stamp<Companion>> {
        self.inner().measured
    }

    /// Frames received so far.
    pub(super) fn frames_in(&self) -> u64 {
        self.inner().stats.frames_in
    }

    /// When the last valid frame came.
    pub(super) fn last_heard(&self) -> Option<Stamp<Companion>> {
        self.inner().stats.last_heard
    }

    pub(super) fn send(&self, frame: FrameBytes) -> SendOutcome {
        self.send_since(frame, self.now())
    }

    pub(super) fn send_since(&self, frame: FrameBytes, since: Stamp<Companion>) -> SendOutcome {
        let Some(frame) = self.config.signing.sign(frame, self.id.0, self.attendance.unix_us()) else {
            self.inner().stats.unsent_unsigned += 1;
            return SendOutcome::NotSigned;
        };
        let outcome = self.outbound.push(frame, since);
        match outcome {
            SendOutcome::Queued | SendOutcome::NoSuchLink | SendOutcome::NotSigned => {}
            SendOutcome::QueuedOldestDropped => self.inner().stats.unsent_full += 1,
            SendOutcome::LinkDown => self.inner().stats.unsent_down += 1,
        }
        outcome
    }

    /// The next frame to write. Cancelling this loses no frame.
    pub(super) async fn next_outbound(&self) -> FrameBytes {
        loop {
            let popped = self.outbound.pop(self.now());
            if popped.stale > 0 {
                self.inner().stats.unsent_stale += popped.stale;
            }
            match popped.frame {
                Some(frame) => return frame,
                None => self.outbound.arrived().await,
            }
        }
    }

    pub(super) fn written(&self, bytes: usize) {
        let mut inner = self.inner();
        inner.stats.bytes_out += bytes as u64;
        inner.stats.frames_out += 1;
    }
}
