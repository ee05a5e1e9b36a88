//! The real daemon killed in an outage, and started again: what was known goes on, and what is no state is told and not used.

use std::net::{SocketAddr, UdpSocket as StdSocket};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use crate::live::flight::{Flight, Heard};
use crate::live::process::Holdover;
use mavlink::dialects::ardupilotmega::{MavMessage, ODOMETRY_DATA};
use tokio::net::UdpSocket;
use tokio::time::{Instant, sleep_until};

const COPTER: &str = "ardupilot-copter-gps-loss";
/// Aligned and with a flow that is trusted, and in real time from here on, s.
const REAL_TIME_S: f64 = 97.0;
const KILLED_S: f64 = 101.5;
const SPEED: f64 = 15.0;

/// An autopilot that goes on whoever listens.
struct Autopilot {
    socket: Arc<UdpSocket>,
    to: SocketAddr,
    heard: Heard,
}

impl Autopilot {
    async fn new(to: SocketAddr) -> Self {
        let socket = Arc::new(UdpSocket::bind("127.0.0.1:0").await.unwrap());
        let heard = Heard::on(&socket);
        Self { socket, to, heard }
    }

    async fn play(&self, flight: &Flight, from_s: f64, to_s: f64, speed: f64) {
        let send = async |burst: &[u8]| drop(self.socket.send_to(burst, self.to).await);
        flight.play(from_s, to_s, speed, send).await;
    }

    fn odometry(&self) -> Vec<ODOMETRY_DATA> {
        let of = |m| match m {
            MavMessage::ODOMETRY(o) => Some(o),
            _ => None,
        };
        self.heard.messages().into_iter().filter_map(of).collect()
    }
}

fn free_port() -> SocketAddr {
    StdSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap()
}

fn start(address: SocketAddr, folder: &Path, deny: &str) -> Holdover {
    let endpoint = format!("udpin:{address}");
    let dir = format!("state.dir={}", folder.display());
    let arguments = ["--endpoint", &endpoint, "--deny-gnss", deny, "--set", &dir];
    let holdover = Holdover::run(&[&arguments[..], &["--set", "outbound.covariance=absolute"]].concat());
    holdover.wait_for("listens at", 1);
    holdover
}

/// Flies into an outage, kills the daemon, and what is at hand then: the autopilot, its flight and when the daemon was killed.
async fn killed_in_an_outage(address: SocketAddr, folder: &Path) -> (Autopilot, Flight, Instant) {
    let flight = Flight::load(COPTER, 120.0);
    let mut holdover = start(address, folder, "80..400");
    let autopilot = Autopilot::new(address).await;
    flight
        .introduce(async |beat: &[u8]| {
            autopilot.socket.send_to(beat, address).await.unwrap();
        })
        .await;
    autopilot.play(&flight, 0.0, REAL_TIME_S, SPEED).await;
    autopilot.play(&flight, REAL_TIME_S, KILLED_S, 1.0).await;
    assert!(autopilot.odometry().len() > 100, "{}", holdover.log());
    holdover.kill();
    let killed = Instant::now();
    // What is on its way yet arrives.
    sleep_until(killed + Duration::from_millis(300)).await;
    (autopilot, flight, killed)
}

#[tokio::test]
async fn a_daemon_that_is_killed_in_an_outage_goes_on_when_it_is_started_again() {
    let (address, folder) = (free_port(), tempfile::tempdir().unwrap());
    let (autopilot, flight, killed) = killed_in_an_outage(address, folder.path()).await;
    let before = autopilot.odometry();
    let last = &before[before.len() - 1];

    let mut holdover = start(address, folder.path(), "0..400");
    // Three seconds were lost by every clock.
    sleep_until(killed + Duration::from_secs(3)).await;
    // It knows whom to look for.
    autopilot.socket.send_to(flight.heartbeat(), address).await.unwrap();
    autopilot.play(&flight, KILLED_S + 3.0, KILLED_S + 8.0, 1.0).await;
    holdover.wait_for("restarted: goes on from", 1);
    assert_eq!(holdover.told("Aligning -> Holdover: restarted"), 1, "{}", holdover.log());
    let after = autopilot.odometry().split_off(before.len());
    let first = &after[0];
    let silent_s = (first.time_usec - last.time_usec) as f64 * 1e-6;
    assert!((3.0..3.5).contains(&silent_s), "{silent_s} s between two poses");
    // It is where it was, but for what is flown in three seconds; and goes on with the same counter.
    let moved = f64::from((first.x - last.x).hypot(first.y - last.y));
    assert!(moved < 30.0, "{moved} m");
    assert_eq!(first.reset_counter, last.reset_counter);
    assert!(after.len() > 100 && after.iter().all(|o| o.quality > 0), "{}", after.len());
    // The doubt of the gap is in what is sent.
    assert!(first.pose_covariance[0] > 4.0 * last.pose_covariance[0]);
    assert!(first.velocity_covariance[0] > 4.0 * last.velocity_covariance[0]);
    holdover.stop();
}

#[tokio::test]
async fn a_state_of_another_boot_and_one_that_is_none_are_told_and_not_used() {
    let (address, folder) = (free_port(), tempfile::tempdir().unwrap());
    let (autopilot, flight, _) = killed_in_an_outage(address, folder.path()).await;
    let path = folder.path().join("system-1.json");
    let whole = std::fs::read(&path).unwrap();
    assert!(!whole.is_empty() && whole.len() < 64 * 1024, "{} bytes", whole.len());

    // An autopilot that has just booted.
    let again = async |reason: &str| {
        let mut holdover = start(address, folder.path(), "0..400");
        flight
            .introduce(async |beat: &[u8]| {
                autopilot.socket.send_to(beat, address).await.unwrap();
            })
            .await;
        autopilot.play(&flight, 0.0, 3.0, SPEED).await;
        holdover.wait_for(&format!("state not used: {reason}"), 1);
        assert_eq!(holdover.told("Holdover: restarted"), 0, "{}", holdover.log());
        holdover.stop();
    };
    again("the autopilot has rebooted since").await;
    std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    again("it is damaged").await;
    std::fs::remove_file(&path).unwrap();
    let elsewhere = folder.path().join("elsewhere");
    std::fs::write(&elsewhere, &whole).unwrap();
    std::os::unix::fs::symlink(&elsewhere, &path).unwrap();
    again("it is no file").await;
    assert_eq!(std::fs::read(&elsewhere).unwrap(), whole, "a link was followed");
}

#[test]
fn a_folder_that_cannot_be_written_is_told_once_and_harms_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    let mut holdover = start(free_port(), &file, "0..400");
    holdover.wait_for("no state is kept, a restart begins anew", 1);
    holdover.stop();
}
