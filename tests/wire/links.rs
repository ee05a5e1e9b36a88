//! Links over loopback sockets and pseudo-terminals: who is heard, who is answered, and what is survived.

use std::net::SocketAddr;
use std::time::Duration;

use crate::live::terminal::plug_in;
use holdover::time::{Span, Stamp};
use holdover::wire::companion_clock::CompanionClock;
use holdover::wire::counters::Cause;
use holdover::wire::endpoint::Endpoint;
use holdover::wire::frame::{ComponentId, SystemId};
use holdover::wire::frame_bytes::FrameBytes;
use holdover::wire::link::{
    LinkConfig, LinkEventKind, LinkId, LinkState, LinkStats, Links, OpenError, ReceivedFrame, SendOutcome,
};
use holdover::wire::session::Address;
use holdover::wire::session::outgoing::FrameWriter;
use mavlink::dialects::ardupilotmega::{
    HEARTBEAT_DATA, MavAutopilot, MavMessage, MavModeFlag, MavState, MavType,
};
use rand::{Rng, SeedableRng};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::time::{sleep, timeout};
use tokio_util::sync::CancellationToken;

pub const LINK: LinkId = LinkId(0);
/// Heartbeats for so long are an autopilot's.
const CONFIRM: Duration = Duration::from_millis(20);

pub async fn within<F: Future>(future: F) -> F::Output {
    timeout(Duration::from_secs(5), future).await.expect("took too long")
}

pub fn quick() -> LinkConfig {
    LinkConfig {
        peer_confirm: CONFIRM,
        peer_silence: Duration::from_secs(3),
        tcp_silence: Duration::from_secs(3),
        backoff_first: Duration::from_millis(10),
        backoff_cap: Duration::from_millis(50),
        ..LinkConfig::default()
    }
}

/// Lets go of a silent peer soon.
pub fn impatient() -> LinkConfig {
    LinkConfig { peer_silence: Duration::from_millis(400), ..quick() }
}

fn endpoint(text: impl AsRef<str>) -> Endpoint {
    text.as_ref().parse().unwrap()
}

pub async fn open_with(endpoints: &[&str], config: LinkConfig, clock: CompanionClock) -> Links {
    let endpoints: Vec<Endpoint> = endpoints.iter().map(endpoint).collect();
    within(Links::open(&endpoints, config, clock, CancellationToken::new())).await.unwrap()
}

pub async fn open(endpoints: &[&str]) -> Links {
    open_with(endpoints, quick(), CompanionClock::new()).await
}

async fn open_error(text: &str) -> OpenError {
    let endpoints = [endpoint(text)];
    let opened = Links::open(&endpoints, quick(), CompanionClock::new(), CancellationToken::new());
    within(opened).await.expect_err("it was opened")
}

pub fn stats(links: &Links) -> LinkStats {
    links.handles.stats().swap_remove(0)
}

pub fn local(links: &Links) -> SocketAddr {
    stats(links).local.unwrap()
}

pub fn heartbeat(mavtype: MavType, autopilot: MavAutopilot) -> MavMessage {
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: 0,
        mavtype,
        autopilot,
        base_mode: MavModeFlag::empty(),
        system_status: MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
    })
}

fn frame(system: u8, message: &MavMessage) -> FrameBytes {
    let from = Address { system: SystemId(system), component: ComponentId(1) };
    FrameWriter::new(from).write(message).unwrap()
}

pub fn autopilot() -> FrameBytes {
    frame(1, &heartbeat(MavType::MAV_TYPE_QUADROTOR, MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA))
}

fn ground_station() -> FrameBytes {
    frame(255, &heartbeat(MavType::MAV_TYPE_GCS, MavAutopilot::MAV_AUTOPILOT_INVALID))
}

/// What Holdover sends.
pub fn ours(code: u8) -> FrameBytes {
    use holdover::wire::session::heartbeat::{SystemStatus, heartbeat};
    frame(1, &heartbeat(SystemStatus::Active, u32::from(code) + 1))
}

async fn receive(links: &mut Links) -> ReceivedFrame {
    within(links.inbound.recv()).await.unwrap()
}

/// Skips events until one of the wanted kind.
pub async fn event(links: &mut Links, wanted: impl Fn(&LinkEventKind) -> bool) -> LinkEventKind {
    let find = async {
        loop {
            let kind = links.events.recv().await.unwrap().kind;
            if wanted(&kind) {
                return kind;
            }
        }
    };
    timeout(Duration::from_secs(5), find).await.expect("no such event")
}

pub fn is_up(kind: &LinkEventKind) -> bool {
    matches!(kind, LinkEventKind::Up { .. } | LinkEventKind::PeerPinned { .. })
}

fn is_down(kind: &LinkEventKind) -> bool {
    matches!(kind, LinkEventKind::Down { .. } | LinkEventKind::PeerReleased { .. })
}

/// Waits until the link's statistics satisfy `wanted`.
pub async fn until(links: &Links, wanted: impl Fn(&LinkStats) -> bool) {
    let wait = async {
        while !wanted(&stats(links)) {
            sleep(Duration::from_millis(2)).await;
        }
    };
    if timeout(Duration::from_secs(5), wait).await.is_err() {
        panic!("never came: {:#?}", stats(links));
    }
}

pub async fn socket() -> UdpSocket {
    UdpSocket::bind("127.0.0.1:0").await.unwrap()
}

/// Heartbeats for long enough to be answered. The last one is passed on.
async fn introduce(drone: &UdpSocket, to: SocketAddr, beat: &FrameBytes) {
    for _ in 0..3 {
        drone.send_to(beat, to).await.unwrap();
        sleep(CONFIRM / 2).await;
    }
}

pub async fn datagram(socket: &UdpSocket) -> Vec<u8> {
    let mut buffer = vec![0; 1000];
    let n = within(socket.recv(&mut buffer)).await.unwrap();
    buffer.truncate(n);
    buffer
}

#[tokio::test]
async fn udpin_answers_the_autopilot_and_a_stranger_cannot_steal_the_link() {
    let mut links = open(&["udpin:127.0.0.1:0"]).await;
    let (drone, stranger) = (socket().await, socket().await);
    let to = local(&links);
    assert_eq!(links.handles.send(LINK, ours(0)), SendOutcome::LinkDown);

    stranger.send_to(&ground_station(), to).await.unwrap();
    stranger.send_to(b"hello there", to).await.unwrap();
    until(&links, |s| s.unpinned == 2).await;
    assert_eq!(stats(&links).rejects.of(Cause::Garbage), 11);
    assert_eq!(stats(&links).state, LinkState::Waiting);

    introduce(&drone, to, &autopilot()).await;
    let received = receive(&mut links).await;
    assert_eq!((received.link, received.bytes, received.known), (LINK, autopilot(), true));
    let pinned = event(&mut links, is_up).await;
    let LinkEventKind::PeerPinned { peer, shown: Some(shown) } = pinned else { panic!("{pinned:?}") };
    assert_eq!(peer, drone.local_addr().unwrap().to_string());
    assert_eq!((shown.address.system.0, shown.address.component.0), (1, 1));

    // The stranger now says that it is an autopilot.
    for _ in 0..3 {
        stranger.send_to(&autopilot(), to).await.unwrap();
    }
    until(&links, |s| s.wrong_peer == 3).await;
    assert!(links.inbound.try_recv().is_err());
    let ignored = event(&mut links, |_| true).await;
    assert_eq!(ignored, LinkEventKind::StrangerIgnored { peer: stranger.local_addr().unwrap().to_string() });
    assert!(links.events.try_recv().is_err(), "told more than once");

    assert_eq!(links.handles.send(LINK, ours(1)), SendOutcome::Queued);
    assert_eq!(datagram(&drone).await, ours(1).to_vec());
    assert!(stranger.try_recv(&mut [0; 100]).is_err());
    let stats = stats(&links);
    assert_eq!((stats.frames_in, stats.frames_out, stats.unsent_down), (1, 1, 1));
}

#[tokio::test]
async fn an_autopilot_that_restarts_on_another_port_is_found_again() {
    let mut links = open_with(&["udpin:127.0.0.1:0"], impatient(), CompanionClock::new()).await;
    let to = local(&links);
    let before = socket().await;
    introduce(&before, to, &autopilot()).await;
    event(&mut links, is_up).await;
    let released = event(&mut links, is_down).await;
    assert!(matches!(released, LinkEventKind::PeerReleased { .. }), "{released:?}");
    let after = socket().await;
    introduce(&after, to, &autopilot()).await;
    event(&mut links, is_up).await;
    links.handles.send(LINK, ours(0));
    assert_eq!(datagram(&after).await, ours(0).to_vec());
    assert_eq!(stats(&links).reconnects, 1);
}

#[tokio::test]
async fn only_the_configured_system_pins() {
    let config = LinkConfig { system: Some(SystemId(7)), ..quick() };
    let mut links = open_with(&["udpin:127.0.0.1:0"], config, CompanionClock::new()).await;
    let drone = socket().await;
    introduce(&drone, local(&links), &autopilot()).await;
    until(&links, |s| s.unpinned == 3).await;
    let beat = heartbeat(MavType::MAV_TYPE_QUADROTOR, MavAutopilot::MAV_AUTOPILOT_PX4);
    introduce(&drone, local(&links), &frame(7, &beat)).await;
    event(&mut links, is_up).await;
}

#[tokio::test]
async fn a_datagram_of_both_versions_and_garbage_gives_its_frames_and_counts() {
    let mut links = open(&["udpin:127.0.0.1:0"]).await;
    let drone = socket().await;
    let mut v1 = mavlink::MAVLinkV1MessageRaw::new();
    let beat = heartbeat(MavType::MAV_TYPE_QUADROTOR, MavAutopilot::MAV_AUTOPILOT_PX4);
    v1.serialize_message(mavlink::MavHeader { system_id: 1, component_id: 1, sequence: 3 }, &beat);
    let mut damaged = autopilot().to_vec();
    damaged[12] ^= 0x10;
    let bytes = [v1.raw_bytes(), b"xyz", &damaged, &autopilot()].concat();
    introduce(&drone, local(&links), &autopilot()).await;
    assert_eq!(receive(&mut links).await.bytes, autopilot());
    drone.send_to(&bytes, local(&links)).await.unwrap();
    assert_eq!(&*receive(&mut links).await.bytes, v1.raw_bytes());
    assert_eq!(receive(&mut links).await.bytes, autopilot());
    let stats = stats(&links);
    assert_eq!(stats.rejects.of(Cause::BadChecksum), 1);
    // The damaged frame's other bytes belong to no frame either.
    assert_eq!(stats.rejects.of(Cause::Garbage), 3 + damaged.len() as u64 - 1);
    assert_eq!((stats.frames_in, stats.bytes_in), (3, (bytes.len() + 3 * autopilot().len()) as u64));
    assert_eq!(stats.sources.len(), 1);
}

#[tokio::test]
async fn udpout_speaks_first_and_survives_that_nobody_listens_yet() {
    let reserved = socket().await;
    let address = reserved.local_addr().unwrap();
    drop(reserved);
    let mut links = open(&[&format!("udpout:{address}")]).await;
    event(&mut links, is_up).await;
    links.handles.send(LINK, ours(0));
    event(&mut links, |kind| matches!(kind, LinkEventKind::Trouble { .. })).await;

    let drone = UdpSocket::bind(address).await.unwrap();
    // An error that was pending may take the first frame with it.
    let mut buffer = [0; 300];
    let (n, peer) = loop {
        links.handles.send(LINK, ours(1));
        if let Ok(result) = timeout(Duration::from_millis(50), drone.recv_from(&mut buffer)).await {
            break result.unwrap();
        }
    };
    assert_eq!(&buffer[..n], &*ours(1));
    drone.send_to(&autopilot(), peer).await.unwrap();
    assert_eq!(receive(&mut links).await.bytes, autopilot());
    assert_eq!(stats(&links).state, LinkState::Up);
}

#[tokio::test]
async fn what_a_person_must_put_right_is_an_error_at_the_start() {
    let udp = socket().await.into_std().unwrap();
    let error = open_error(&format!("udpin:{}", udp.local_addr().unwrap())).await;
    assert!(matches!(error, OpenError::AddressInUse { .. }), "{error:?}");
    assert!(error.to_string().contains(&udp.local_addr().unwrap().to_string()), "{error}");
    let tcp = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let error = open_error(&format!("tcpin:{}", tcp.local_addr().unwrap())).await;
    assert!(matches!(error, OpenError::AddressInUse { .. }), "{error:?}");
    let error = open_error("serial:/dev/null:57600").await;
    assert!(matches!(error, OpenError::Other { .. }), "{error:?}");

    let twice = [endpoint("tcpout:127.0.0.1:9"), endpoint("tcpout:127.0.0.1:9")];
    let token = CancellationToken::new();
    let error = Links::open(&twice, quick(), CompanionClock::new(), token.clone()).await.err().unwrap();
    assert!(matches!(error, OpenError::Twice { .. }), "{error:?}");
    let error = Links::open(&[], quick(), CompanionClock::new(), token).await.err().unwrap();
    assert!(matches!(error, OpenError::NoEndpoint), "{error:?}");
}

#[tokio::test]
async fn tcpout_waits_for_its_server_and_comes_back_after_its_restart() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    drop(listener);
    let mut links = open(&[&format!("tcpout:{address}")]).await;
    event(&mut links, |kind| matches!(kind, LinkEventKind::Retry { .. })).await;

    for round in 0..2 {
        let listener = TcpListener::bind(address).await.unwrap();
        let (mut drone, _) = within(listener.accept()).await.unwrap();
        event(&mut links, is_up).await;
        drone.write_all(&autopilot()).await.unwrap();
        assert_eq!(receive(&mut links).await.bytes, autopilot());
        links.handles.send(LINK, ours(round));
        let mut heard = vec![0; ours(round).len()];
        within(drone.read_exact(&mut heard)).await.unwrap();
        assert_eq!(heard, ours(round).to_vec());
        drop((drone, listener));
        event(&mut links, is_down).await;
        assert_eq!(links.handles.send(LINK, ours(9)), SendOutcome::LinkDown);
    }
    assert_eq!(stats(&links).reconnects, 1);
}

#[tokio::test]
async fn a_tcp_server_that_falls_silent_is_connected_to_anew() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let config = LinkConfig { tcp_silence: Duration::from_millis(100), ..quick() };
    let to = format!("tcpout:{}", listener.local_addr().unwrap());
    let mut links = open_with(&[&to], config, CompanionClock::new()).await;
    let (_silent, _) = within(listener.accept()).await.unwrap();
    let (mut drone, _) = within(listener.accept()).await.unwrap();
    drone.write_all(&autopilot()).await.unwrap();
    assert_eq!(receive(&mut links).await.bytes, autopilot());
}

#[tokio::test]
async fn tcpin_serves_one_client_until_it_is_gone_or_silent() {
    let mut links = open_with(&["tcpin:127.0.0.1:0"], impatient(), CompanionClock::new()).await;
    let to = local(&links);
    let mut first = TcpStream::connect(to).await.unwrap();
    event(&mut links, is_up).await;
    first.write_all(&autopilot()).await.unwrap();
    assert_eq!(receive(&mut links).await.bytes, autopilot());

    let mut second = TcpStream::connect(to).await.unwrap();
    let turned_away = within(second.read(&mut [0; 10])).await;
    assert!(matches!(turned_away, Ok(0) | Err(_)), "{turned_away:?}");
    assert_eq!(stats(&links).wrong_peer, 1);

    // The first is silent now, as if its host had lost its power.
    sleep(Duration::from_millis(450)).await;
    let mut third = TcpStream::connect(to).await.unwrap();
    event(&mut links, is_down).await;
    event(&mut links, is_up).await;
    third.write_all(&autopilot()).await.unwrap();
    assert_eq!(receive(&mut links).await.bytes, autopilot());

    drop(third);
    event(&mut links, is_down).await;
    let mut fourth = TcpStream::connect(to).await.unwrap();
    event(&mut links, is_up).await;
    links.handles.send(LINK, ours(4));
    let mut heard = vec![0; ours(4).len()];
    within(fourth.read_exact(&mut heard)).await.unwrap();
    assert_eq!(heard, ours(4).to_vec());
}

#[tokio::test]
async fn a_stream_of_noise_does_no_harm() {
    let mut links = open(&["tcpin:127.0.0.1:0"]).await;
    let mut drone = TcpStream::connect(local(&links)).await.unwrap();
    let mut noise = vec![0; 300_000];
    rand_chacha::ChaCha8Rng::seed_from_u64(1).fill_bytes(&mut noise);
    drone.write_all(&noise).await.unwrap();
    // Noise may end in what looks like the head of a long frame.
    for _ in 0..20 {
        drone.write_all(&autopilot()).await.unwrap();
    }
    let mut seen = 0;
    while seen < 5 {
        seen += usize::from(receive(&mut links).await.bytes == autopilot());
    }
    assert!(stats(&links).rejects.of(Cause::Garbage) > 200_000);
}

#[tokio::test]
async fn a_serial_cable_may_be_pulled_and_put_back() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("autopilot");
    let (mut drone, device) = plug_in(&path);
    let mut links = open(&[&format!("serial:{}:921600", path.display())]).await;
    drop(device);
    for round in 0..2 {
        event(&mut links, is_up).await;
        drone.write_all(&autopilot()).await.unwrap();
        assert_eq!(receive(&mut links).await.bytes, autopilot());
        links.handles.send(LINK, ours(round));
        let mut heard = vec![0; ours(round).len()];
        within(drone.read_exact(&mut heard)).await.unwrap();
        assert_eq!(heard, ours(round).to_vec());

        std::fs::remove_file(&path).unwrap();
        drop(drone);
        event(&mut links, is_down).await;
        event(&mut links, |kind| matches!(kind, LinkEventKind::Retry { .. })).await;
        let plugged = plug_in(&path);
        drone = plugged.0;
        sleep(Duration::from_millis(1)).await;
    }
    until(&links, |s| s.state == LinkState::Up).await;
    assert_eq!(stats(&links).reconnects, 2);
}

#[tokio::test]
async fn what_is_not_there_at_the_start_is_waited_for() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("autopilot");
    // An address reserved for documentation is never this machine's.
    let serial = format!("serial:{}:921600", path.display());
    let mut links = open(&[&serial, "udpin:192.0.2.1:14550", "tcpin:192.0.2.1:14550"]).await;
    let mut waited_for = [false; 3];
    while waited_for.contains(&false) {
        let event = within(links.events.recv()).await.unwrap();
        let LinkEventKind::Retry { reason, .. } = event.kind else { panic!("{event:?}") };
        assert!(event.link != LINK || reason.contains(&path.display().to_string()), "{reason}");
        waited_for[event.link.0] = true;
    }
    let (mut drone, device) = plug_in(&path);
    event(&mut links, is_up).await;
    drop(device);
    drone.write_all(&autopilot()).await.unwrap();
    assert_eq!(receive(&mut links).await.bytes, autopilot());
}

#[tokio::test]
async fn a_serial_device_in_use_is_an_error() {
    let directory = tempfile::tempdir().unwrap();
    let (path, alias) = (directory.path().join("a"), directory.path().join("b"));
    let (_drone, device) = plug_in(&path);
    std::os::unix::fs::symlink(&path, &alias).unwrap();
    let _links = open(&[&format!("serial:{}:57600", path.display())]).await;
    drop(device);
    let error = open_error(&format!("serial:{}:57600", alias.display())).await;
    assert!(matches!(error, OpenError::DeviceInUse { .. }), "{error:?}");
}

#[tokio::test]
async fn frames_that_nobody_takes_are_dropped_and_counted() {
    let config = LinkConfig { inbound_capacity: 4, ..quick() };
    let mut links = open_with(&["tcpin:127.0.0.1:0"], config, CompanionClock::new()).await;
    let mut drone = TcpStream::connect(local(&links)).await.unwrap();
    let from = Address { system: SystemId(1), component: ComponentId(1) };
    let mut writer = FrameWriter::new(from);
    for _ in 0..20 {
        let beat = heartbeat(MavType::MAV_TYPE_QUADROTOR, MavAutopilot::MAV_AUTOPILOT_PX4);
        drone.write_all(&writer.write(&beat).unwrap()).await.unwrap();
    }
    until(&links, |s| s.frames_in == 20).await;
    assert_eq!(stats(&links).inbound_dropped, 16);
    assert_eq!(stats(&links).lost_frames(), 0, "what we drop was not lost on the way");
    for sequence in 0..4 {
        assert_eq!(receive(&mut links).await.frame().unwrap().sequence(), sequence);
    }
}

#[tokio::test]
async fn the_newest_frames_are_sent_and_old_ones_never() {
    let clock = CompanionClock::manual(Stamp::from_micros(0));
    let config = LinkConfig { outbound_capacity: 2, ..quick() };
    let mut links = open_with(&["udpin:127.0.0.1:0"], config, clock.clone()).await;
    let drone = socket().await;
    for i in 1..=3 {
        drone.send_to(&autopilot(), local(&links)).await.unwrap();
        until(&links, |s| s.bytes_in == i * autopilot().len() as u64).await;
        clock.advance(Span::from_millis(100));
    }
    event(&mut links, is_up).await;

    // Nothing is awaited between these, so the writer cannot run meanwhile.
    let outcomes: Vec<SendOutcome> = (0..5).map(|i| links.handles.send(LINK, ours(i))).collect();
    assert_eq!(outcomes[1..3], [SendOutcome::Queued, SendOutcome::QueuedOldestDropped]);
    assert_eq!(datagram(&drone).await, ours(3).to_vec());
    assert_eq!(datagram(&drone).await, ours(4).to_vec());

    links.handles.send(LINK, ours(5));
    clock.advance(Span::from_millis(150));
    links.handles.send(LINK, ours(6));
    clock.advance(Span::from_millis(51));
    assert_eq!(datagram(&drone).await, ours(6).to_vec());
    let stats = stats(&links);
    assert_eq!((stats.unsent_full, stats.unsent_stale, stats.frames_out), (3, 1, 3));
}

#[tokio::test]
async fn several_links_carry_their_number_and_the_time() {
    let clock = CompanionClock::new();
    let mut links = open_with(&["udpin:127.0.0.1:0", "udpin:127.0.0.1:0"], quick(), clock.clone()).await;
    let drone = socket().await;
    for stats in links.handles.stats() {
        let before = clock.now();
        introduce(&drone, stats.local.unwrap(), &autopilot()).await;
        let received = receive(&mut links).await;
        assert_eq!(received.link, stats.link);
        assert!(before <= received.received && received.received <= clock.now());
    }
    links.handles.send_all(ours(0));
    assert_eq!((datagram(&drone).await, datagram(&drone).await), (ours(0).to_vec(), ours(0).to_vec()));
    assert_eq!(links.handles.send(LinkId(2), ours(0)), SendOutcome::NoSuchLink);
}

#[tokio::test]
async fn cancelling_ends_every_task_and_frees_the_ports() {
    let cancel = CancellationToken::new();
    let endpoints = ["udpin:127.0.0.1:0", "tcpin:127.0.0.1:0", "tcpout:127.0.0.1:9", "udpout:127.0.0.1:9"];
    let endpoints: Vec<Endpoint> = endpoints.iter().map(endpoint).collect();
    let links = Links::open(&endpoints, quick(), CompanionClock::new(), cancel.clone()).await.unwrap();
    let address = local(&links);
    sleep(Duration::from_millis(20)).await;
    cancel.cancel();
    within(links.handles.closed()).await;
    assert!(links.handles.stats().iter().all(|s| s.state == LinkState::Closed));
    UdpSocket::bind(address).await.unwrap();
}

#[tokio::test]
async fn a_connection_that_takes_no_bytes_is_made_anew() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let config = LinkConfig { write_stall: Duration::from_millis(50), ..quick() };
    let to = format!("tcpout:{}", listener.local_addr().unwrap());
    let mut links = open_with(&[&to], config, CompanionClock::new()).await;
    let (_deaf, _) = within(listener.accept()).await.unwrap();
    event(&mut links, is_up).await;
    let longest = FrameBytes::new(&[0xFD; 280]).unwrap();
    let stalled = async {
        while stats(&links).reconnects == 0 {
            for _ in 0..60 {
                links.handles.send(LINK, longest);
            }
            sleep(Duration::from_micros(100)).await;
        }
    };
    within(stalled).await;
    let down = event(&mut links, is_down).await;
    assert!(down.to_string().contains("took no bytes"), "{down}");
}
