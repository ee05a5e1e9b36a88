//! UDP: what both directions have in common, and the one that speaks first.

use std::convert::Infallible;
use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::time::Duration;

use tokio::net::{UdpSocket, lookup_host};

use super::OpenError;
use super::arrival::{Datagram, DatagramArrivals};
use super::event::LinkEventKind;
use super::shared::Shared;
use super::udp_line::make_roomy;
use crate::wire::endpoint::{Endpoint, HostPort};
use crate::wire::running_crc::RunningCrc;

/// The longest datagram there is.
pub(super) const DATAGRAM: usize = 65_536;

/// Consecutive failures of receiving after which the socket is opened anew.
const MAX_FAILURES: u32 = 20;

pub(super) fn cannot_resolve(endpoint: &Endpoint) -> impl Fn(io::Error) -> OpenError {
    let endpoint = endpoint.clone();
    move |source| OpenError::CannotResolve { endpoint: endpoint.clone(), source }
}

fn bind_error(endpoint: &Endpoint) -> impl Fn(io::Error) -> OpenError {
    let endpoint = endpoint.clone();
    move |source| {
        let endpoint = endpoint.clone();
        match source.kind() {
            io::ErrorKind::AddrInUse => OpenError::AddressInUse { endpoint },
            io::ErrorKind::PermissionDenied => OpenError::PermissionDenied { endpoint },
            _ => OpenError::Other { endpoint, source },
        }
    }
}

/// What was bound, or `None` where the address is not one of this machine yet: its network may come up later.
pub(super) fn unless_too_early<S>(bound: io::Result<S>, endpoint: &Endpoint) -> Result<Option<S>, OpenError> {
    match bound {
        Ok(socket) => Ok(Some(socket)),
        Err(error) if error.kind() == io::ErrorKind::AddrNotAvailable => Ok(None),
        Err(error) => Err(bind_error(endpoint)(error)),
    }
}

/// Errors of a datagram socket that say something about a packet or a route, not about the socket.
pub(super) fn is_passing(error: &io::Error) -> bool {
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
pub(super) async fn survive(shared: &Shared, error: io::Error, failures: &mut u32) -> Result<(), String> {
    *failures += 1;
    if !is_passing(&error) || *failures > MAX_FAILURES {
        return Err(format!("receiving failed: {error}"));
    }
    shared.trouble(&error);
    tokio::time::sleep(Duration::from_millis(u64::from(*failures))).await;
    Ok(())
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
                make_roomy(&socket);
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
    let mut crc = RunningCrc::new();
    let mut arrivals = DatagramArrivals::new(shared.attendance(), socket);
    loop {
        match arrivals.receive(&mut buffer).await {
            Ok(Datagram { len, arrived, dropped, .. }) => {
                failures = 0;
                shared.read(len);
                shared.unread(dropped, true);
                shared.datagram(buffer.get(..len).unwrap_or_default(), &mut crc, arrived, |_| {});
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
