//! Links to autopilots: sockets and serial ports, from bytes to frames with receive stamps, and back.
//!
//! One task owns each link. It reads, finds frames, stamps them with the companion's clock as they leave the socket, and puts
//! them into a bounded queue; it never waits for a slow reader but drops and counts. It writes what a bounded queue of its own
//! holds, the newest frames at the expense of the oldest, and nothing that has waited too long. After start-up no error ends a
//! link: it is opened again, with growing pauses, until the [`CancellationToken`] says to stop.
//!
//! Frames are checked for damage here, and at the gate of [`crate::wire::signing`] for their signatures, which is also where what goes out
//! is signed.

mod arrival;
mod backoff;
mod boot_clock;
mod bucket;
mod candidate;
mod deframer;
mod event;
mod pin;
mod queue;
mod route;
mod serial;
mod session;
mod shared;
mod stats;
mod tcp;
mod throttle;
mod udp;
mod udp_line;
mod udp_server;

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

pub use deframer::{Deframer, Found};
pub use event::{LinkEvent, LinkEventKind};
pub use queue::SendOutcome;
pub use route::ReplyRoute;
pub use stats::{Excess, LinkState, LinkStats, SourceStats};

use super::companion_clock::CompanionClock;
use super::endpoint::Endpoint;
use super::frame::{ComponentId, Frame, SystemId};
use super::frame_bytes::FrameBytes;
use super::signing::{SigningCounts, SigningGate};
use crate::time::{Companion, Stamp};
use arrival::Attendance;
use shared::Shared;

/// Number of a link: its place in the list of endpoints.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct LinkId(pub usize);

impl fmt::Display for LinkId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "link {}", self.0)
    }
}

/// A frame that came in.
#[derive(Clone, Copy, Debug)]
pub struct ReceivedFrame {
    /// On which link.
    pub link: LinkId,
    /// When it arrived: by the kernel's stamp where there is one, else when its last byte was read; the beginning of the pause when the
    /// process was stopped in between.
    pub received: Stamp<Companion>,
    /// Its bytes.
    pub bytes: FrameBytes,
    /// Whether the message is in the dialect, and its checksum was therefore tested.
    pub known: bool,
}

impl ReceivedFrame {
    /// The frame; its checksum was tested if [`ReceivedFrame::known`]. Always `Some` for a frame that a link delivers.
    pub fn frame(&self) -> Option<Frame<'_>> {
        self.bytes.frame()
    }
}

/// Settings of all links.
#[derive(Clone, Debug)]
pub struct LinkConfig {
    /// Frames that may wait to be taken from [`Links::inbound`]; more are dropped.
    pub inbound_capacity: usize,
    /// Frames that may wait to be written, per link; the oldest make room.
    pub outbound_capacity: usize,
    /// Events that may wait to be taken from [`Links::events`]; more are dropped.
    pub event_capacity: usize,
    /// A frame that waited longer is not sent any more: a stale pose misleads the autopilot.
    pub max_queue_age: Duration,
    /// How much a peer, or a stranger, may ask of a link.
    pub limits: LinkLimits,
    /// How long an autopilot's heartbeats must come from a UDP address before it is answered; with IMU messages, a quarter of it.
    pub peer_confirm: Duration,
    /// A UDP peer, or a TCP client, that is silent for longer, or has no IMU messages, may be replaced by another.
    pub peer_silence: Duration,
    /// A TCP connection that is silent for longer is closed and opened anew: a host that lost its power says no goodbye.
    pub tcp_silence: Duration,
    /// A connection that takes no bytes for so long is closed and opened anew.
    pub write_stall: Duration,
    /// How long a TCP connection may take to be made.
    pub connect_timeout: Duration,
    /// First pause before a link is opened again.
    pub backoff_first: Duration,
    /// Longest pause before a link is opened again.
    pub backoff_cap: Duration,
    /// Only an autopilot of this system can pin a UDP peer; `None` allows any.
    pub system: Option<SystemId>,
    /// Only an autopilot of this component can; `None` allows any.
    pub component: Option<ComponentId>,
    /// The links from this number on are for sensors: whoever sends a measurement there pins its UDP peer.
    pub sensors_from: usize,
    /// What every frame passes, in and out.
    pub signing: Arc<SigningGate>,
}

/// How much a peer, or a stranger, may ask of a link: far more than any real one does. What is beyond is dropped and counted.
#[derive(Clone, Copy, Debug)]
pub struct LinkLimits {
    /// Frames of one sender that are passed on, 1/s.
    pub frames_per_s: f64,
    /// Bytes that are searched for frames where no frame stands at once, bytes/s; a stream of bytes is read no faster.
    pub search_bytes_per_s: f64,
    /// Datagrams of strangers that are taken note of while the pinned peer is heard, 1/s. The kernel drops the others.
    pub strangers_per_s: f64,
}

impl Default for LinkLimits {
    fn default() -> Self {
        Self { frames_per_s: 10_000.0, search_bytes_per_s: 4e6, strangers_per_s: 200.0 }
    }
}

impl Default for LinkConfig {
    fn default() -> Self {
        Self {
            inbound_capacity: 1024,
            outbound_capacity: 64,
            event_capacity: 64,
            max_queue_age: Duration::from_millis(200),
            limits: LinkLimits::default(),
            peer_confirm: Duration::from_secs(2),
            peer_silence: Duration::from_secs(5),
            tcp_silence: Duration::from_secs(15),
            write_stall: Duration::from_secs(5),
            connect_timeout: Duration::from_secs(3),
            backoff_first: Duration::from_millis(100),
            backoff_cap: Duration::from_secs(5),
            system: None,
            component: None,
            sensors_from: usize::MAX,
            signing: Arc::default(),
        }
    }
}

/// Why links could not be opened. Later troubles are [`LinkEvent`]s instead.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// There is nothing to open.
    #[error("no endpoint was given")]
    NoEndpoint,
    /// Two endpoints are the same.
    #[error("{endpoint} is given twice")]
    Twice {
        /// The endpoint.
        endpoint: Endpoint,
    },
    /// The address to listen at is taken.
    #[error("{endpoint}: another program listens at this address already")]
    AddressInUse {
        /// The endpoint.
        endpoint: Endpoint,
    },
    /// The address to listen at cannot be resolved.
    #[error("{endpoint}: the host cannot be resolved: {source}")]
    CannotResolve {
        /// The endpoint.
        endpoint: Endpoint,
        /// What the resolver says.
        source: std::io::Error,
    },
    /// The operating system does not allow it.
    #[error("{endpoint}: permission denied (may this user open it?)")]
    PermissionDenied {
        /// The endpoint.
        endpoint: Endpoint,
    },
    /// The serial device is held by another program.
    #[error("{endpoint}: {device} is in use by another program")]
    DeviceInUse {
        /// The endpoint.
        endpoint: Endpoint,
        /// The device's name.
        device: String,
    },
    /// Anything else.
    #[error("{endpoint}: {source}")]
    Other {
        /// The endpoint.
        endpoint: Endpoint,
        /// What the operating system says.
        source: std::io::Error,
    },
}

/// All links of a daemon, running.
#[derive(Debug)]
pub struct Links {
    /// Frames of all links, in the order they came.
    pub inbound: mpsc::Receiver<ReceivedFrame>,
    /// What befalls the links.
    pub events: mpsc::Receiver<LinkEvent>,
    /// For sending and for statistics.
    pub handles: LinkHandles,
}

/// Sends frames and tells statistics. Clones are handles of the same links.
#[derive(Clone, Debug)]
pub struct LinkHandles {
    links: Arc<[Arc<Shared>]>,
    tracker: TaskTracker,
}

enum Transport {
    UdpIn(udp_server::UdpServer),
    UdpOut(udp::UdpClient),
    TcpIn(tcp::TcpServer),
    TcpOut(tcp::TcpClient),
    Serial(serial::Port),
}

impl Links {
    /// Binds and opens every endpoint, then starts a task for each. The tasks end when `cancel` is cancelled.
    ///
    /// What is not there yet is waited for: a serial device, a network, whoever is connected *to*.
    ///
    /// # Errors
    /// What only a person can put right, before any task is started: [`OpenError`].
    pub async fn open(
        endpoints: &[Endpoint],
        config: LinkConfig,
        clock: CompanionClock,
        cancel: CancellationToken,
    ) -> Result<Links, OpenError> {
        if endpoints.is_empty() {
            return Err(OpenError::NoEndpoint);
        }
        let mut transports = Vec::with_capacity(endpoints.len());
        for (i, endpoint) in endpoints.iter().enumerate() {
            if endpoints.iter().take(i).any(|other| other == endpoint && !chooses_its_port(endpoint)) {
                return Err(OpenError::Twice { endpoint: endpoint.clone() });
            }
            transports.push(Transport::open(endpoint).await?);
        }
        let (inbound_tx, inbound) = mpsc::channel(config.inbound_capacity.max(1));
        let (events_tx, events) = mpsc::channel(config.event_capacity.max(1));
        let tracker = TaskTracker::new();
        let attendance = Arc::new(Attendance::new(clock));
        let mut links = Vec::with_capacity(endpoints.len());
        for (i, (endpoint, transport)) in endpoints.iter().zip(transports).enumerate() {
            let (inbound, events) = (inbound_tx.clone(), events_tx.clone());
            let shared =
                Shared::new(LinkId(i), endpoint.clone(), &config, Arc::clone(&attendance), inbound, events);
            let shared = Arc::new(shared);
            shared.set_local(transport.local());
            links.push(Arc::clone(&shared));
            let cancel = cancel.clone();
            tracker.spawn(async move {
                tokio::select! {
                    biased;
                    () = cancel.cancelled() => {}
                    () = transport.run(&shared) => {}
                }
                shared.closed();
            });
        }
        tracker.spawn(async move { cancel.run_until_cancelled(attendance.beat()).await });
        tracker.close();
        Ok(Links { inbound, events, handles: LinkHandles { links: links.into(), tracker } })
    }
}

/// With port 0 each gets a port of its own.
fn chooses_its_port(endpoint: &Endpoint) -> bool {
    matches!(endpoint, Endpoint::UdpIn(address) | Endpoint::TcpIn(address) if address.port() == 0)
}

impl Transport {
    async fn open(endpoint: &Endpoint) -> Result<Transport, OpenError> {
        Ok(match endpoint {
            Endpoint::UdpIn(address) => {
                Transport::UdpIn(udp_server::UdpServer::bind(endpoint, address).await?)
            }
            Endpoint::UdpOut(address) => Transport::UdpOut(udp::UdpClient::new(address)),
            Endpoint::TcpIn(address) => Transport::TcpIn(tcp::TcpServer::bind(endpoint, address).await?),
            Endpoint::TcpOut(address) => Transport::TcpOut(tcp::TcpClient::new(address)),
            Endpoint::Serial(port) => Transport::Serial(serial::Port::open(endpoint, port)?),
        })
    }

    fn local(&self) -> Option<std::net::SocketAddr> {
        match self {
            Transport::UdpIn(udp) => udp.local(),
            Transport::TcpIn(tcp) => tcp.local(),
            Transport::UdpOut(_) | Transport::TcpOut(_) | Transport::Serial(_) => None,
        }
    }

    async fn run(self, shared: &Shared) {
        match self {
            Transport::UdpIn(udp) => udp.run(shared).await,
            Transport::UdpOut(udp) => udp.run(shared).await,
            Transport::TcpIn(tcp) => tcp.run(shared).await,
            Transport::TcpOut(tcp) => tcp.run(shared).await,
            Transport::Serial(serial) => serial.run(shared).await,
        }
    }
}

impl LinkHandles {
    /// The links there are.
    pub fn ids(&self) -> impl Iterator<Item = LinkId> + '_ {
        self.links.iter().map(|l| l.id())
    }

    /// Queues a frame on one link; never waits.
    pub fn send(&self, link: LinkId, frame: FrameBytes) -> SendOutcome {
        self.links.get(link.0).map_or(SendOutcome::NoSuchLink, |l| l.send(frame))
    }

    /// The same with a frame that tells what was so `since`: it is not sent when that is too long ago at its turn.
    pub fn send_since(&self, link: LinkId, frame: FrameBytes, since: Stamp<Companion>) -> SendOutcome {
        self.links.get(link.0).map_or(SendOutcome::NoSuchLink, |l| l.send_since(frame, since))
    }

    /// Queues a frame on every link that is up.
    pub fn send_all(&self, frame: FrameBytes) {
        for link in self.links.iter() {
            link.send(frame);
        }
    }

    /// While it is held, an autopilot that falls silent is not given up for another one, unless that goes on with the same clock since boot:
    /// to be told in an outage.
    pub fn hold(&self, held: bool) {
        for link in self.links.iter() {
            link.hold(held);
        }
    }

    /// The statistics of every link, as they are now.
    pub fn stats(&self) -> Vec<LinkStats> {
        self.links.iter().map(|l| l.stats()).collect()
    }

    /// What was counted of signatures, on all links.
    pub fn signing(&self) -> SigningCounts {
        self.links.first().map_or_else(SigningCounts::default, |l| l.config.signing.counts())
    }

    /// Waits until all tasks have ended, after a cancellation.
    pub async fn closed(&self) {
        self.tracker.wait().await;
    }
}
