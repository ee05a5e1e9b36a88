//! Who is answered on a UDP port to which others send, too, and what their floods cost.

use std::net::SocketAddr;
use std::time::Duration;

use holdover::time::{Span, Stamp};
use holdover::wire::companion_clock::CompanionClock;
use holdover::wire::counters::Cause;
use holdover::wire::frame::{ComponentId, SystemId};
use holdover::wire::frame_bytes::FrameBytes;
use holdover::wire::link::{LinkConfig, LinkEventKind, LinkLimits, LinkState};
use holdover::wire::session::Address;
use holdover::wire::session::outgoing::FrameWriter;
use mavlink::dialects::ardupilotmega::{MavAutopilot, MavMessage, MavType, RAW_IMU_DATA};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpStream, UdpSocket};
use tokio::time::{sleep, timeout};

use crate::links::{
    LINK, autopilot, datagram, event, heartbeat, impatient, is_up, local, open, open_with, ours, quick,
    socket, stats, until, within,
};

/// IMU messages of an autopilot that started `boot` before `clock` did.
struct Flying {
    writer: FrameWriter,
    clock: CompanionClock,
    boot: Duration,
}

impl Flying {
    fn new(boot: Duration) -> Self {
        let from = Address { system: SystemId(1), component: ComponentId(1) };
        Self { writer: FrameWriter::new(from), clock: CompanionClock::new(), boot }
    }

    fn imu(&mut self) -> FrameBytes {
        let time_usec = self.boot.as_micros() as u64 + self.clock.now().micros().unsigned_abs();
        self.writer.write(&MavMessage::RAW_IMU(RAW_IMU_DATA { time_usec, ..Default::default() })).unwrap()
    }

    fn beat(&mut self) -> FrameBytes {
        let beat = heartbeat(MavType::MAV_TYPE_QUADROTOR, MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA);
        self.writer.write(&beat).unwrap()
    }

    /// A heartbeat every 100 ms and IMU messages every 10 ms until `enough`.
    async fn fly(&mut self, drone: &UdpSocket, to: SocketAddr, enough: impl Fn() -> bool) {
        let flying = async {
            for i in 0.. {
                if enough() {
                    break;
                }
                if i % 10 == 0 {
                    drone.send_to(&self.beat(), to).await.unwrap();
                }
                drone.send_to(&self.imu(), to).await.unwrap();
                sleep(Duration::from_millis(10)).await;
            }
        };
        within(flying).await;
    }
}

#[tokio::test]
async fn a_router_that_restarts_on_another_port_is_followed_at_once() {
    let mut links = open(&["udpin:127.0.0.1:0"]).await;
    let to = local(&links);
    let mut vehicle = Flying::new(Duration::from_secs(100));
    let (before, after) = (socket().await, socket().await);
    vehicle.fly(&before, to, || stats(&links).frames_in > 20).await;
    event(&mut links, is_up).await;
    let there = after.local_addr().unwrap().to_string();
    vehicle.fly(&after, to, || stats(&links).peer.as_ref() == Some(&there)).await;
    let moved = event(&mut links, |kind| matches!(kind, LinkEventKind::PeerFollowed { .. })).await;
    assert_eq!(
        moved,
        LinkEventKind::PeerFollowed { from: before.local_addr().unwrap().to_string(), to: there }
    );
    links.handles.send(LINK, ours(0));
    assert_eq!(datagram(&after).await, ours(0).to_vec());
}

#[tokio::test]
async fn a_forged_heartbeat_before_the_autopilot_speaks_wins_nothing() {
    let mut links = open(&["udpin:127.0.0.1:0"]).await;
    let to = local(&links);
    let (forger, drone) = (socket().await, socket().await);
    forger.send_to(&autopilot(), to).await.unwrap();
    until(&links, |s| s.unpinned == 1).await;
    Flying::new(Duration::from_secs(3)).fly(&drone, to, || stats(&links).state == LinkState::Up).await;
    let drone = drone.local_addr().unwrap().to_string();
    assert_eq!(stats(&links).peer.as_ref(), Some(&drone));
    let told = event(&mut links, |kind| matches!(kind, LinkEventKind::RivalsHeard { .. })).await;
    assert_eq!(told, LinkEventKind::RivalsHeard { peer: drone, rivals: 1 });
}

#[tokio::test]
async fn while_it_is_held_a_silent_peer_is_not_given_up_for_another() {
    let mut links = open_with(&["udpin:127.0.0.1:0"], impatient(), CompanionClock::new()).await;
    let to = local(&links);
    let (drone, forger) = (socket().await, socket().await);
    Flying::new(Duration::from_secs(100)).fly(&drone, to, || stats(&links).frames_in > 20).await;
    event(&mut links, is_up).await;
    links.handles.hold(true);
    let mut another = Flying::new(Duration::from_secs(7));
    let (from, patience) = (CompanionClock::new(), Span::from_millis(1500));
    another.fly(&forger, to, || from.now() - Stamp::from_micros(0) > patience).await;
    assert_eq!(stats(&links).peer, Some(drone.local_addr().unwrap().to_string()));
    links.handles.hold(false);
    let forger_at = forger.local_addr().unwrap().to_string();
    another.fly(&forger, to, || stats(&links).peer.as_ref() == Some(&forger_at)).await;
    event(&mut links, |kind| matches!(kind, LinkEventKind::PeerReplaced { silent: true, .. })).await;
}

#[tokio::test]
async fn a_flood_of_strangers_takes_no_frame_from_the_peer() {
    let links = open(&["udpin:127.0.0.1:0"]).await;
    let to = local(&links);
    let (drone, stranger) = (socket().await, socket().await);
    let mut vehicle = Flying::new(Duration::from_secs(3));
    vehicle.fly(&drone, to, || stats(&links).state == LinkState::Up).await;
    let before = stats(&links).frames_in;
    for _ in 0..200 {
        for _ in 0..20 {
            let _ = stranger.try_send_to(&[0xFE; 10_000], to);
        }
        drone.send_to(&vehicle.imu(), to).await.unwrap();
        sleep(Duration::from_micros(200)).await;
    }
    until(&links, |s| s.frames_in >= before + 200).await;
    let stats = stats(&links);
    assert_eq!((stats.lost_frames(), stats.rejects.of(Cause::BadChecksum)), (0, 0));
    assert!(stats.wrong_peer > 0 && stats.excess.stranger_bytes > 0, "{stats:#?}");
    assert!(stats.wrong_peer < 4000, "the kernel drops some: {stats:#?}");
}

#[tokio::test]
async fn hostile_bytes_from_the_peers_own_address_cost_so_much_and_no_more() {
    let limits = LinkLimits { search_bytes_per_s: 100_000.0, frames_per_s: 100.0, ..LinkLimits::default() };
    let config = LinkConfig { limits, ..quick() };
    let links = open_with(&["udpin:127.0.0.1:0"], config, CompanionClock::new()).await;
    let to = local(&links);
    let drone = socket().await;
    let mut vehicle = Flying::new(Duration::from_secs(3));
    vehicle.fly(&drone, to, || stats(&links).state == LinkState::Up).await;
    // Another system's frames, more than may pass.
    let from = Address { system: SystemId(77), component: ComponentId(1) };
    let mut other = FrameWriter::new(from);
    let beat = heartbeat(MavType::MAV_TYPE_QUADROTOR, MavAutopilot::MAV_AUTOPILOT_PX4);
    let before = stats(&links).frames_in;
    for _ in 0..50 {
        drone.send_to(&[0xFE; 20_000], to).await.unwrap();
        drone.send_to(&other.write(&beat).unwrap(), to).await.unwrap();
        sleep(Duration::from_micros(200)).await;
    }
    until(&links, |s| s.excess.frames > 0 && s.excess.unsearched_bytes > 500_000).await;
    drone.send_to(&vehicle.imu(), to).await.unwrap();
    until(&links, |s| {
        s.frames_in > before && s.sources.iter().any(|s| s.system == SystemId(1) && s.lost == 0)
    })
    .await;
}

/// Whether the link closes the connection within a while.
async fn is_turned_away(client: &mut TcpStream) -> bool {
    !matches!(timeout(Duration::from_secs(2), client.read(&mut [0; 10])).await, Err(_) | Ok(Ok(1..)))
}

#[tokio::test]
async fn a_tcp_client_with_an_imu_keeps_its_place_and_one_without_gives_way() {
    let mut links = open_with(&["tcpin:127.0.0.1:0"], impatient(), CompanionClock::new()).await;
    let to = local(&links);
    let mut idle = TcpStream::connect(to).await.unwrap();
    event(&mut links, is_up).await;
    // Heartbeats alone do not hold the place for ever.
    for _ in 0..12 {
        idle.write_all(&autopilot()).await.unwrap();
        sleep(Duration::from_millis(50)).await;
    }
    let mut drone = TcpStream::connect(to).await.unwrap();
    assert!(is_turned_away(&mut idle).await);
    event(&mut links, is_up).await;
    let mut vehicle = Flying::new(Duration::from_secs(3));
    for round in 0..12 {
        drone.write_all(&vehicle.imu()).await.unwrap();
        if round > 0 && round % 6 == 0 {
            assert!(is_turned_away(&mut TcpStream::connect(to).await.unwrap()).await);
        }
        sleep(Duration::from_millis(50)).await;
    }
    assert_eq!(stats(&links).peer, Some(drone.local_addr().unwrap().to_string()));
    assert_eq!(stats(&links).wrong_peer, 1);
}

#[tokio::test]
async fn in_an_outage_nobody_from_elsewhere_takes_a_silent_clients_place() {
    let mut links = open_with(&["tcpin:0.0.0.0:0"], impatient(), CompanionClock::new()).await;
    let port = local(&links).port();
    let from = |host: u8| async move {
        let socket = tokio::net::TcpSocket::new_v4().unwrap();
        socket.bind(SocketAddr::from(([127, 0, 0, host], 0))).unwrap();
        socket.connect(SocketAddr::from(([127, 0, 0, 1], port))).await.unwrap()
    };
    let _drone = from(1).await;
    event(&mut links, is_up).await;
    links.handles.hold(true);
    sleep(Duration::from_millis(500)).await;
    assert!(is_turned_away(&mut from(2).await).await);
    let back = from(1).await;
    let back_at = back.local_addr().unwrap().to_string();
    until(&links, |s| s.peer.as_ref() == Some(&back_at)).await;
}
