//! The thread that serves: every connection is bounded in size and time, and there are only so many.

use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::time::Duration;
use std::{io, thread};

use nix::sys::socket::{setsockopt, sockopt};
use tokio::sync::Semaphore;
use tokio::sync::mpsc::{Receiver, channel};

use super::feed::{FeedItem, StatusFeed};
use super::front::StatusFront;
use crate::config::StatusSettings;
use crate::time::{Companion, Stamp};

/// Connections at a time.
const MOST_CONNECTIONS: usize = 64;
/// A viewer that takes nothing for so long is gone, ms.
const STALLED_MS: u32 = 15_000;
/// What the navigation has told and was not taken yet.
const WAITING: usize = 64;
/// After an error of accepting.
const AFTER_ERROR: Duration = Duration::from_millis(100);

/// Why nothing is served.
#[derive(Debug, thiserror::Error)]
pub enum StatusError {
    /// Another program listens there.
    #[error("status.listen: another program listens at {0} already")]
    Taken(SocketAddr),
    /// Anything else.
    #[error("status.listen: {at}: {source}")]
    Other {
        /// Where.
        at: SocketAddr,
        /// What the system says.
        source: io::Error,
    },
}

/// A server that listens, and is to be started.
#[derive(Debug)]
pub struct StatusServer {
    listener: TcpListener,
    local: SocketAddr,
    told: Receiver<FeedItem>,
    names: Arc<[String]>,
}

impl StatusServer {
    /// Listens where the settings say, if they do.
    ///
    /// # Errors
    /// [`StatusError`].
    pub fn open(
        settings: &StatusSettings,
        now: Stamp<Companion>,
    ) -> Result<Option<(Self, StatusFeed)>, StatusError> {
        let Some(at) = settings.listen else { return Ok(None) };
        let other = |source: io::Error| match source.kind() {
            io::ErrorKind::AddrInUse => StatusError::Taken(at),
            _ => StatusError::Other { at, source },
        };
        let listener = TcpListener::bind(at).map_err(other)?;
        listener.set_nonblocking(true).map_err(other)?;
        let local = listener.local_addr().map_err(other)?;
        let (sender, told) = channel(WAITING);
        let names = settings.hosts.clone().into();
        Ok(Some((Self { listener, local, told, names }, StatusFeed::new(sender, now))))
    }

    /// Where it listens.
    pub fn local(&self) -> SocketAddr {
        self.local
    }

    /// Starts the thread. It is not waited for in the end: what it holds is lost without harm.
    ///
    /// # Errors
    /// Those of the system.
    pub fn start(self) -> io::Result<()> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        thread::Builder::new().name("status".to_owned()).spawn(move || runtime.block_on(self.serve()))?;
        Ok(())
    }

    async fn serve(self) {
        let front = Arc::new(StatusFront::new(self.names));
        let Ok(listener) = tokio::net::TcpListener::from_std(self.listener) else { return };
        let accepting = tokio::spawn(accept(listener, Arc::clone(&front)));
        let mut told = self.told;
        while let Some(told) = told.recv().await {
            front.take(told);
        }
        // The navigation has ended.
        accepting.abort();
    }
}

async fn accept(listener: tokio::net::TcpListener, front: Arc<StatusFront>) {
    let places = Arc::new(Semaphore::new(MOST_CONNECTIONS));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            tokio::time::sleep(AFTER_ERROR).await;
            continue;
        };
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
            front.dropped();
            continue;
        };
        // A kernel without it leaves a stalled viewer its place for longer.
        let _ = setsockopt(&stream, sockopt::TcpUserTimeout, &STALLED_MS);
        let front = Arc::clone(&front);
        tokio::spawn(async move {
            front.answer(stream).await;
            drop(place);
        });
    }
}
