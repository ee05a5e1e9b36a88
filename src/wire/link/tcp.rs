//! TCP, in both directions.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use tokio::net::{TcpListener, TcpStream, lookup_host};
use tokio::time::timeout;

use super::event::LinkEventKind;
use super::session::{Connect, keep_connected, serve};
use super::shared::{Shared, span};
use super::{OpenError, udp};
use crate::time::{Companion, Stamp};
use crate::wire::endpoint::{Endpoint, HostPort};

/// Pause after a client was turned away: connections that come by the thousand take no core.
const TURNED_AWAY: Duration = Duration::from_millis(20);

/// Connects to a server.
#[derive(Debug)]
pub(super) struct TcpClient {
    address: HostPort,
}

impl TcpClient {
    pub(super) fn new(address: &HostPort) -> Self {
        Self { address: address.clone() }
    }

    pub(super) async fn run(self, shared: &Shared) {
        keep_connected(&self, None, shared).await;
    }
}

impl Connect for TcpClient {
    type Stream = TcpStream;

    async fn connect(&self, shared: &Shared) -> io::Result<(TcpStream, String)> {
        let connecting = TcpStream::connect((self.address.host(), self.address.port()));
        let stream = match timeout(shared.config.connect_timeout, connecting).await {
            Ok(result) => result?,
            Err(_elapsed) => return Err(io::ErrorKind::TimedOut.into()),
        };
        // A pose that waits for a full segment is a late pose.
        stream.set_nodelay(true)?;
        let peer = stream.peer_addr()?.to_string();
        Ok((stream, peer))
    }

    fn silence(&self, shared: &Shared) -> Option<Duration> {
        Some(shared.config.tcp_silence)
    }
}

/// Listens, and serves one client at a time. Another is turned away, unless the one that is served has fallen silent
/// or has no IMU messages.
#[derive(Debug)]
pub(super) struct TcpServer {
    addresses: Vec<SocketAddr>,
    listener: Option<TcpListener>,
}

impl TcpServer {
    pub(super) async fn bind(endpoint: &Endpoint, address: &HostPort) -> Result<Self, OpenError> {
        let resolved = lookup_host((address.host(), address.port())).await;
        let addresses: Vec<SocketAddr> = resolved.map_err(udp::cannot_resolve(endpoint))?.collect();
        let listener = udp::unless_too_early(TcpListener::bind(&addresses[..]).await, endpoint)?;
        Ok(Self { addresses, listener })
    }

    pub(super) fn local(&self) -> Option<SocketAddr> {
        self.listener.as_ref()?.local_addr().ok()
    }

    pub(super) async fn run(self, shared: &Shared) {
        let mut backoff = shared.backoff();
        let mut bound = self.listener;
        let listener = loop {
            match bound.take() {
                Some(listener) => break listener,
                None => match TcpListener::bind(&self.addresses[..]).await {
                    Ok(listener) => bound = Some(listener),
                    Err(error) => shared.pause(&mut backoff, error.to_string()).await,
                },
            }
        };
        shared.set_local(listener.local_addr().ok());
        Listening { listener }.serve(shared).await;
    }
}

/// A server whose address is there.
struct Listening {
    listener: TcpListener,
}

impl Listening {
    async fn serve(&self, shared: &Shared) {
        let mut next = None;
        loop {
            let (stream, peer) = match next.take() {
                Some(client) => client,
                None => self.accept(shared).await,
            };
            if let Err(error) = stream.set_nodelay(true) {
                shared.trouble(&error);
            }
            shared.up(peer.to_string(), |peer| LinkEventKind::Up { peer });
            let reason = tokio::select! {
                reason = serve(stream, shared, Some(shared.config.tcp_silence)) => reason,
                client = self.successor(peer, shared) => {
                    let reason = format!("silent or without IMU messages, and {} takes its place", client.1);
                    next = Some(client);
                    reason
                }
            };
            shared.down(LinkEventKind::Down { reason });
        }
    }

    async fn accept(&self, shared: &Shared) -> (TcpStream, SocketAddr) {
        let mut backoff = shared.backoff();
        loop {
            match self.listener.accept().await {
                Ok(client) => return client,
                // A connection that died while it waited, or too many open files: the listener itself is well.
                Err(error) => {
                    shared.trouble(&error);
                    tokio::time::sleep(backoff.pause()).await;
                }
            }
        }
    }

    /// Turns clients away while the one that is served is live: heard, and with measurements. Returns the one that came when it was not.
    async fn successor(&self, served: SocketAddr, shared: &Shared) -> (TcpStream, SocketAddr) {
        let connected = shared.now();
        let patience = span(shared.config.peer_silence);
        loop {
            let client = self.accept(shared).await;
            let since = |heard: Option<Stamp<Companion>>| {
                shared.now() - heard.map_or(connected, |heard| heard.max(connected))
            };
            let silent = since(shared.last_heard()) > patience;
            let idle = !shared.is_for_sensors() && since(shared.last_measured()) > patience;
            // In an outage nobody from elsewhere takes the autopilot's place.
            let may = !shared.is_held() || client.1.ip() == served.ip();
            if (silent || idle) && may {
                return client;
            }
            shared.stranger(client.1, 0);
            drop(client);
            tokio::time::sleep(TURNED_AWAY).await;
        }
    }
}
