//! UDP, in both directions.

use std::convert::Infallible;
use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::net::{UdpSocket, lookup_host};

use super::OpenError;
use super::arrival::{Datagram, DatagramArrivals};
use super::deframer::{Found, deframe};
use super::event::LinkEventKind;
use super::pin::{Pin, PinVerdict};
use super::shared::{Shared, span};
use crate::time::{Companion, Stamp};
use crate::wire::endpoint::{Endpoint, HostPort};
use crate::wire::messages::from_any_component;
use crate::wire::running_crc::RunningCrc;
use crate::wire::session::heartbeat_fields::HeartbeatFields;

/// The longest datagram there is.
const DATAGRAM: usize = 65_536;

/// Consecutive failures of receiving after which the socket is opened anew.
const MAX_FAILURES: u32 = 20;

pub(super) fn cannot_resolve(endpoint: &Endpoint) -> impl Fn(io::Error) -> OpenError {
    let endpoint = endpoint.clone();
    move |source| OpenError::CannotResolve { endpoint: endpoint.clone(), source }
}

pub(super) fn bind_error(endpoint: &Endpoint) -> impl Fn(io::Error) -> OpenError {
    let endpoint = endpoint.clone();
    move |source| {
        let endpoint = endpoint.clone();
        match source.kind() {
            io::ErrorKind::AddrInUse => OpenError::AddressInUse { endpoint },
            io::ErrorKind::AddrNotAvailable => OpenError::NoSuchAddress { endpoint },
            io::ErrorKind::PermissionDenied => OpenError::PermissionDenied { endpoint },
            _ => OpenError::Other { endpoint, source },
        }
    }
}

/// Errors of a datagram socket that say something about a packet or a route, not about the socket.
fn is_passing(error: &io::Error) -> bool {
    use io::ErrorKind as K;
    matches!(
        error.kind(),
        K::ConnectionRefused
            | K::ConnectionReset
            | K::HostUnreachable
            | K::NetworkUnreachable
            | K::NetworkDown
            | K::Interrupted
            | K::WouldBlock
            | K::TimedOut
    )
}

/// Counts consecutive failures of receiving, and makes pauses so that they take no core.
async fn survive(shared: &Shared, error: io::Error, failures: &mut u32) -> Result<(), String> {
    *failures += 1;
    if !is_passing(&error) || *failures > MAX_FAILURES {
        return Err(format!("receiving failed: {error}"));
    }
    shared.trouble(&error);
    tokio::time::sleep(Duration::from_millis(u64::from(*failures))).await;
    Ok(())
}

/// Listens at an address, and answers the autopilot that is heard there.
#[derive(Debug)]
pub(super) struct UdpServer {
    socket: UdpSocket,
}

impl UdpServer {
    pub(super) async fn bind(endpoint: &Endpoint, address: &HostPort) -> Result<Self, OpenError> {
        let resolved = lookup_host((address.host(), address.port())).await;
        let addresses: Vec<SocketAddr> = resolved.map_err(cannot_resolve(endpoint))?.collect();
        let socket = UdpSocket::bind(&addresses[..]).await.map_err(bind_error(endpoint))?;
        Ok(Self { socket })
    }

    pub(super) fn local(&self) -> Option<SocketAddr> {
        self.socket.local_addr().ok()
    }

    pub(super) async fn run(self, shared: &Shared) {
        let local = self.local();
        let mut socket = self.socket;
        let mut backoff = shared.backoff();
        loop {
            let reason = listen(&socket, shared).await;
            drop(socket);
            shared.down(LinkEventKind::Down { reason });
            // The port must stay the same: it is where the autopilot sends to.
            socket = loop {
                tokio::time::sleep(backoff.pause()).await;
                match local {
                    None => shared.pause(&mut backoff, "its own address is unknown".to_owned()).await,
                    Some(address) => match UdpSocket::bind(address).await {
                        Ok(socket) => break socket,
                        Err(error) => shared.pause(&mut backoff, error.to_string()).await,
                    },
                }
            };
        }
    }
}

/// The pin of a listening socket, shared by the three loops of its one task.
#[derive(Default)]
struct SharedPin(Mutex<Pin>);

impl SharedPin {
    fn lock(&self) -> MutexGuard<'_, Pin> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

async fn listen(socket: &UdpSocket, shared: &Shared) -> String {
    let pin = SharedPin::default();
    tokio::select! {
        reason = receive_pinned(socket, shared, &pin) => reason,
        never = answer_pinned(socket, shared, &pin) => match never {},
        never = release_silent(shared, &pin) => match never {},
    }
}

async fn receive_pinned(socket: &UdpSocket, shared: &Shared, pin: &SharedPin) -> String {
    let mut buffer = vec![0; DATAGRAM];
    let mut failures = 0;
    let mut arrivals = DatagramArrivals::new(shared.attendance(), socket);
    loop {
        match arrivals.receive(&mut buffer).await {
            Ok(Datagram { len, from, arrived }) => {
                failures = 0;
                shared.read(len);
                let datagram = buffer.get(..len).unwrap_or_default();
                if let Some(peer) = from {
                    datagram_from(peer, datagram, arrived, shared, pin);
                }
            }
            Err(error) => {
                if let Err(reason) = survive(shared, error, &mut failures).await {
                    return reason;
                }
            }
        }
    }
}

fn datagram_from(
    peer: SocketAddr,
    datagram: &[u8],
    received: Stamp<Companion>,
    shared: &Shared,
    pin: &SharedPin,
) {
    let (valid, pins) = look_through(datagram, shared);
    let verdict = pin.lock().judge(peer, received, valid, pins);
    match verdict {
        PinVerdict::Stranger => return shared.stranger(peer),
        PinVerdict::Pinned => shared.up(peer.to_string(), |peer| LinkEventKind::PeerPinned { peer }),
        PinVerdict::Serve => {}
        PinVerdict::Unpinned => shared.unpinned(),
    }
    deframe(datagram, &mut RunningCrc::new(), |found| match found {
        // Before an autopilot was heard, frames are not to be trusted, but garbage is worth counting.
        Found::Frame(frame) | Found::Unknown(frame) if verdict == PinVerdict::Unpinned => {
            shared.admits(&frame);
        }
        found => shared.found(found, received),
    });
}

/// Whether a datagram holds a valid frame, and whether it holds what may pin: the heartbeat of an autopilot, or on a link for sensors a
/// measurement.
fn look_through(datagram: &[u8], shared: &Shared) -> (bool, bool) {
    let (mut valid, mut pins) = (false, false);
    deframe(datagram, &mut RunningCrc::new(), |found| {
        if let Found::Frame(frame) = found {
            valid = true;
            if !shared.is_genuine(&frame) {
                return;
            }
            if shared.is_for_sensors() {
                pins |= from_any_component(frame.message_id());
                return;
            }
            pins |= shared.config.system.is_none_or(|system| system == frame.system())
                && HeartbeatFields::read(&frame).is_some_and(|fields| fields.is_autopilot());
        }
    });
    (valid, pins)
}

async fn answer_pinned(socket: &UdpSocket, shared: &Shared, pin: &SharedPin) -> Infallible {
    loop {
        let frame = shared.next_outbound().await;
        let peer = pin.lock().peer();
        // Without a peer the queue is closed, so this is a frame that was taken out just before.
        let Some(peer) = peer else { continue };
        match socket.send_to(&frame, peer).await {
            Ok(n) => shared.written(n),
            Err(error) => shared.trouble(&error),
        }
    }
}

async fn release_silent(shared: &Shared, pin: &SharedPin) -> Infallible {
    let limit = shared.config.peer_silence;
    let period = (limit / 8).clamp(Duration::from_millis(10), Duration::from_millis(500));
    loop {
        tokio::time::sleep(period).await;
        let expired = pin.lock().expire(shared.now(), span(limit));
        if let Some((peer, silent)) = expired {
            shared.down(LinkEventKind::PeerReleased { peer: peer.to_string(), silent });
        }
    }
}

/// Sends to an address, and hears what comes back from it.
#[derive(Debug)]
pub(super) struct UdpClient {
    address: HostPort,
}

impl UdpClient {
    pub(super) fn new(address: &HostPort) -> Self {
        Self { address: address.clone() }
    }

    pub(super) async fn run(self, shared: &Shared) {
        let mut backoff = shared.backoff();
        loop {
            match self.connect().await {
                Ok((socket, peer)) => {
                    let heard_before = shared.frames_in();
                    shared.up(peer.to_string(), |peer| LinkEventKind::Up { peer });
                    let reason = tokio::select! {
                        reason = receive_connected(&socket, shared) => reason,
                        never = send_connected(&socket, shared) => match never {},
                    };
                    shared.down(LinkEventKind::Down { reason });
                    if shared.frames_in() > heard_before {
                        backoff.reset();
                    }
                    tokio::time::sleep(backoff.pause()).await;
                }
                Err(error) => shared.pause(&mut backoff, error.to_string()).await,
            }
        }
    }

    /// A connected socket hears its peer only, and is told when nobody listens there.
    async fn connect(&self) -> io::Result<(UdpSocket, SocketAddr)> {
        let mut last = io::Error::from(io::ErrorKind::NotFound);
        for peer in lookup_host((self.address.host(), self.address.port())).await? {
            let local: SocketAddr = if peer.is_ipv4() {
                (Ipv4Addr::UNSPECIFIED, 0).into()
            } else {
                (Ipv6Addr::UNSPECIFIED, 0).into()
            };
            let attempt = async {
                let socket = UdpSocket::bind(local).await?;
                socket.connect(peer).await?;
                io::Result::Ok(socket)
            };
            match attempt.await {
                Ok(socket) => return Ok((socket, peer)),
                Err(error) => last = error,
            }
        }
        Err(last)
    }
}

async fn receive_connected(socket: &UdpSocket, shared: &Shared) -> String {
    let mut buffer = vec![0; DATAGRAM];
    let mut failures = 0;
    let mut arrivals = DatagramArrivals::new(shared.attendance(), socket);
    loop {
        match arrivals.receive(&mut buffer).await {
            Ok(Datagram { len, arrived, .. }) => {
                failures = 0;
                shared.read(len);
                deframe(buffer.get(..len).unwrap_or_default(), &mut RunningCrc::new(), |found| {
                    shared.found(found, arrived)
                });
            }
            Err(error) => {
                if let Err(reason) = survive(shared, error, &mut failures).await {
                    return reason;
                }
            }
        }
    }
}

async fn send_connected(socket: &UdpSocket, shared: &Shared) -> Infallible {
    loop {
        let frame = shared.next_outbound().await;
        match socket.send(&frame).await {
            Ok(n) => shared.written(n),
            // Nobody listens there yet, or the route is gone for now: the next frame is a new attempt.
            Err(error) => shared.trouble(&error),
        }
    }
}
