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
use crate::wire::endpoint::{Endpoint, HostPort};

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

/// Listens, and serves one client at a time. Another is turned away, unless the one that is served has fallen silent.
#[derive(Debug)]
pub(super) struct TcpServer {
    listener: TcpListener,
}

impl TcpServer {
    pub(super) async fn bind(endpoint: &Endpoint, address: &HostPort) -> Result<Self, OpenError> {
        let resolved = lookup_host((address.host(), address.port())).await;
        let addresses: Vec<SocketAddr> = resolved.map_err(udp::cannot_resolve(endpoint))?.collect();
        let listener = TcpListener::bind(&addresses[..]).await.map_err(udp::bind_error(endpoint))?;
        Ok(Self { listener })
    }

    pub(super) fn local(&self) -> Option<SocketAddr> {
        self.listener.local_addr().ok()
    }

    pub(super) async fn run(self, shared: &Shared) {
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
                client = self.successor(shared) => {
                    let reason = format!("silent, and {} takes its place", client.1);
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

    /// Turns clients away until the one that is served has been silent for long enough; returns the one that came then.
    async fn successor(&self, shared: &Shared) -> (TcpStream, SocketAddr) {
        let connected = shared.now();
        loop {
            let client = self.accept(shared).await;
            let heard = shared.last_heard().map_or(connected, |heard| heard.max(connected));
            if shared.now() - heard > span(shared.config.peer_silence) {
                return client;
            }
            shared.stranger(client.1);
        }
    }
}
