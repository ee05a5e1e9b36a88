//! Listens at a UDP address, and answers the autopilot that is heard there.
//!
//! Everybody's datagrams come to the *door*, the socket that was bound at first. Who is pinned gets a *line* ([`open_line`]), a socket of
//! its own at the same address. While the pinned peer is well the door is looked through only so many times a second, and what
//! is found there is counted by its source and not looked into; the kernel drops what does not fit.

use std::convert::Infallible;
use std::future::ready;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::net::{UdpSocket, lookup_host};
use tokio::sync::watch;

use super::OpenError;
use super::arrival::{Datagram, DatagramArrivals};
use super::bucket::Bucket;
use super::deframer::{Found, deframe};
use super::event::LinkEventKind;
use super::pin::{Pin, PinChange, Regard};
use super::shared::{Rejects, Shared, span};
use super::udp::{DATAGRAM, cannot_resolve, is_passing, survive, unless_too_early};
use super::udp_line::open_line;
use crate::time::{Companion, Stamp};
use crate::wire::endpoint::{Endpoint, HostPort};
use crate::wire::running_crc::RunningCrc;

/// Datagrams that are taken from the door before a line is read: what came before the line was there.
const BEFORE_THE_LINE: usize = 1024;

/// A look at the pin that is later than this comes after a pause of the process.
const LATE: Duration = Duration::from_secs(1);
/// Bytes that are received before anybody else has his turn.
const IN_A_ROW: usize = 1 << 18;

/// See the module's documentation.
#[derive(Debug)]
pub(super) struct UdpServer {
    /// Where the door is, or will be.
    addresses: Vec<SocketAddr>,
    door: Option<UdpSocket>,
}

impl UdpServer {
    pub(super) async fn bind(endpoint: &Endpoint, address: &HostPort) -> Result<Self, OpenError> {
        let resolved = lookup_host((address.host(), address.port())).await;
        let addresses: Vec<SocketAddr> = resolved.map_err(cannot_resolve(endpoint))?.collect();
        let door = unless_too_early(UdpSocket::bind(&addresses[..]).await, endpoint)?;
        Ok(Self { addresses, door })
    }

    pub(super) fn local(&self) -> Option<SocketAddr> {
        self.door.as_ref()?.local_addr().ok()
    }

    pub(super) async fn run(mut self, shared: &Shared) {
        let mut backoff = shared.backoff();
        loop {
            let door = match self.door.take() {
                Some(door) => door,
                None => match UdpSocket::bind(&self.addresses[..]).await {
                    Ok(door) => door,
                    Err(error) => {
                        shared.pause(&mut backoff, error.to_string()).await;
                        continue;
                    }
                },
            };
            if let Ok(local) = door.local_addr() {
                shared.set_local(Some(local));
                // It must stay the same: it is where the autopilot sends to.
                self.addresses = vec![local];
            }
            let reason = UdpListener::new(&door, shared).listen().await;
            drop(door);
            shared.down(LinkEventKind::Down { reason });
            tokio::time::sleep(backoff.pause()).await;
        }
    }
}

/// A listening socket with its pin, shared by the loops of its one task.
struct UdpListener<'a> {
    door: &'a UdpSocket,
    shared: &'a Shared,
    pin: Mutex<Pin>,
    line: watch::Sender<Option<Arc<UdpSocket>>>,
}

/// What a loop that receives needs for each datagram.
struct Desk {
    crc: RunningCrc,
    /// Bytes that may be searched for somebody to pin.
    search: Bucket,
    /// Bytes that were received in a row.
    in_a_row: usize,
}

impl Desk {
    fn new(shared: &Shared) -> Self {
        let per_s = shared.config.limits.search_bytes_per_s;
        Self { crc: RunningCrc::new(), search: Bucket::new(per_s, per_s / 10.0), in_a_row: 0 }
    }

    /// After so many bytes more everybody else gets his turn.
    async fn rest(&mut self, bytes: usize) {
        self.in_a_row += bytes;
        if self.in_a_row > IN_A_ROW {
            self.in_a_row = 0;
            tokio::task::yield_now().await;
        }
    }
}

impl<'a> UdpListener<'a> {
    fn new(door: &'a UdpSocket, shared: &'a Shared) -> Self {
        let pin = Mutex::new(Pin::new(shared.pin_policy()));
        Self { door, shared, pin, line: watch::Sender::new(None) }
    }

    fn pin(&self) -> MutexGuard<'_, Pin> {
        self.pin.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Serves until the door breaks; returns why.
    async fn listen(&self) -> String {
        // In no order: a flood on one socket must not keep the others from their turn.
        tokio::select! {
            never = self.serve_line() => match never {},
            reason = self.receive_at_door() => reason,
            never = self.answer() => match never {},
            never = self.look_after_pin() => match never {},
        }
    }

    /// Receives on the pinned peer's line, while there is one.
    async fn serve_line(&self) -> Infallible {
        let mut changes = self.line.subscribe();
        let mut buffer = vec![0; DATAGRAM];
        let mut desk = Desk::new(self.shared);
        loop {
            let line = changes.borrow_and_update().clone();
            let Some(line) = line else {
                let _ = changes.changed().await;
                continue;
            };
            self.empty_door(&mut buffer, &mut desk).await;
            let mut arrivals = DatagramArrivals::new(self.shared.attendance(), &line);
            loop {
                let received = tokio::select! {
                    _ = changes.changed() => break,
                    received = arrivals.receive(&mut buffer) => received,
                };
                match received {
                    Ok(datagram) => {
                        self.shared.unread(datagram.dropped, true);
                        self.take(&buffer, datagram, &mut desk);
                        desk.rest(datagram.len).await;
                    }
                    Err(error) if is_passing(&error) => {
                        // Nobody listens there any more, for now.
                        self.shared.trouble(&error);
                        tokio::time::sleep(Duration::from_millis(1)).await;
                    }
                    Err(error) => {
                        self.shared.trouble(&error);
                        self.line.send_replace(None);
                    }
                }
            }
        }
    }

    /// Takes what came to the door before the line was there, so that the peer's frames stay in their order.
    async fn empty_door(&self, buffer: &mut [u8], desk: &mut Desk) {
        let mut arrivals = DatagramArrivals::new(self.shared.attendance(), self.door);
        for _ in 0..BEFORE_THE_LINE {
            let received = tokio::select! {
                biased;
                received = arrivals.receive(buffer) => received,
                () = ready(()) => return,
            };
            let Ok(datagram) = received else { return };
            self.take(buffer, datagram, desk);
        }
    }

    async fn receive_at_door(&self) -> String {
        let mut buffer = vec![0; DATAGRAM];
        let mut desk = Desk::new(self.shared);
        let mut failures = 0;
        let per_s = self.shared.config.limits.strangers_per_s;
        let mut strangers = Bucket::new(per_s, per_s / 10.0);
        let mut arrivals = DatagramArrivals::new(self.shared.attendance(), self.door);
        loop {
            let now = self.shared.now();
            let served = self.line.borrow().is_some() && self.pin().is_well(now);
            if served && !strangers.take(1, now) {
                tokio::time::sleep(strangers.wait(1)).await;
                continue;
            }
            match arrivals.receive(&mut buffer).await {
                Ok(datagram) => {
                    failures = 0;
                    // Without a line the door is the peer's, too.
                    self.shared.unread(datagram.dropped, self.line.borrow().is_none());
                    self.take(&buffer, datagram, &mut desk);
                    desk.rest(datagram.len).await;
                }
                Err(error) => {
                    if let Err(reason) = survive(self.shared, error, &mut failures).await {
                        return reason;
                    }
                }
            }
        }
    }

    /// A datagram: judged by its source, then by its content.
    fn take(&self, buffer: &[u8], datagram: Datagram, desk: &mut Desk) {
        let Datagram { len, from, arrived, .. } = datagram;
        self.shared.read(len);
        let Some(peer) = from else { return };
        let bytes = buffer.get(..len).unwrap_or_default();
        let regard = self.pin().regard(peer, self.shared.now());
        match regard {
            Regard::Serve => self.serve(peer, bytes, arrived, desk),
            Regard::Ignore => self.shared.stranger(peer, len),
            Regard::Judge => self.judge(peer, bytes, arrived, desk),
        }
    }

    fn serve(&self, peer: SocketAddr, bytes: &[u8], arrived: Stamp<Companion>, desk: &mut Desk) {
        self.shared.datagram(bytes, &mut desk.crc, arrived, |frame| self.pin().hear(peer, frame, arrived));
    }

    /// A datagram of somebody who may be pinned.
    fn judge(&self, peer: SocketAddr, bytes: &[u8], arrived: Stamp<Companion>, desk: &mut Desk) {
        let mut rejects = Rejects::default();
        let may_search = |n| desk.search.take(n, arrived);
        deframe(bytes, &mut desk.crc, may_search, |found| match found {
            Found::Frame(frame) if self.shared.is_genuine(&frame) => self.pin().hear(peer, &frame, arrived),
            // What is refused for its signature is counted.
            Found::Frame(frame) | Found::Unknown(frame) => {
                self.shared.admits(&frame);
            }
            found => rejects.note(&found),
        });
        self.decide();
        match self.pin().peer() {
            None => return self.shared.unpinned(&rejects),
            Some(pinned) if pinned != peer => return self.shared.stranger(peer, bytes.len()),
            Some(_) => {}
        }
        self.serve(peer, bytes, arrived, desk);
    }

    /// Looks whether the pin changes.
    fn decide(&self) {
        let now = self.shared.now();
        let Some(change) = self.pin().decide(now, self.shared.is_held()) else { return };
        let peer = match change {
            PinChange::Pinned { peer, rivals, shown } => {
                let shown = shown.map(Box::new);
                self.shared.up(peer.to_string(), |peer| LinkEventKind::PeerPinned { peer, shown });
                if rivals > 0 {
                    self.shared.emit(LinkEventKind::RivalsHeard { peer: peer.to_string(), rivals });
                }
                Some(peer)
            }
            PinChange::Followed { from, to } => {
                let from = from.to_string();
                self.shared.up(to.to_string(), |to| LinkEventKind::PeerFollowed { from, to });
                Some(to)
            }
            PinChange::Replaced { from, to, silent, lasted } => {
                let from = from.to_string();
                let event = |to| LinkEventKind::PeerReplaced { from, to, silent, lasted };
                self.shared.up(to.to_string(), event);
                Some(to)
            }
            PinChange::Released { peer, silent } => {
                self.shared.down(LinkEventKind::PeerReleased { peer: peer.to_string(), silent });
                None
            }
        };
        // One at a time: the line before would be in the way of the next.
        self.line.send_replace(None);
        if let Some(peer) = peer {
            match open_line(self.door, peer) {
                Ok(line) => drop(self.line.send_replace(Some(Arc::new(line)))),
                // The door serves everybody then.
                Err(error) => tracing::debug!("{peer} has no socket of its own: {error}"),
            }
        }
    }

    async fn answer(&self) -> Infallible {
        loop {
            let frame = self.shared.next_outbound().await;
            let (line, peer) = (self.line.borrow().clone(), self.pin().peer());
            let sent = match (line, peer) {
                (Some(line), _) => line.send(&frame).await,
                (None, Some(peer)) => self.door.send_to(&frame, peer).await,
                // Without a peer the queue is closed, so this is a frame that was taken out just before.
                (None, None) => continue,
            };
            match sent {
                Ok(n) => self.shared.written(n),
                Err(error) => self.shared.trouble(&error),
            }
        }
    }

    async fn look_after_pin(&self) -> Infallible {
        let config = &self.shared.config;
        let period = config.peer_silence.min(config.peer_confirm) / 8;
        let period = period.clamp(Duration::from_millis(10), Duration::from_millis(250));
        let mut looked = self.shared.now();
        loop {
            tokio::time::sleep(period).await;
            let now = self.shared.now();
            // After a pause of the process what the peer has sent meanwhile is read first.
            if now - looked < span(period + LATE) {
                self.decide();
            }
            looked = now;
        }
    }
}
