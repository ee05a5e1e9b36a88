//! The real daemon with a recorder: what it wrote is read by others, flies again to the same bytes, and is whole after a kill.

use std::net::{SocketAddr, UdpSocket as StdSocket};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

use crate::live::flight::{Flight, Heard};
use crate::live::process::Holdover;
use crate::live::pymavlink;
use mavlink::dialects::ardupilotmega::MavMessage;
use serde_json::Value;
use tokio::net::UdpSocket;
use tokio::time::{Instant, sleep};

const COPTER: &str = "ardupilot-copter-gps-loss";
const SPEED: f64 = 15.0;

/// The autopilot on a link, with a second one on which everything comes, too.
struct Vehicle {
    socket: Arc<UdpSocket>,
    beside: UdpSocket,
    to: [SocketAddr; 2],
    heard: Heard,
}

impl Vehicle {
    async fn new(to: [SocketAddr; 2]) -> Self {
        let socket = Arc::new(UdpSocket::bind("127.0.0.1:0").await.unwrap());
        let heard = Heard::on(&socket);
        Self { socket, beside: UdpSocket::bind("127.0.0.1:0").await.unwrap(), to, heard }
    }

    async fn send(&self, burst: &[u8]) {
        drop(self.socket.send_to(burst, self.to[0]).await);
        drop(self.beside.send_to(burst, self.to[1]).await);
    }

    async fn play(&self, flight: &Flight, from_s: f64, to_s: f64) {
        flight.play(from_s, to_s, SPEED, async |burst: &[u8]| self.send(burst).await).await;
    }

    /// Positions and velocities that came.
    fn positions(&self) -> u64 {
        let ours = |m: &MavMessage| {
            matches!(
                m,
                MavMessage::ODOMETRY(_)
                    | MavMessage::VISION_POSITION_ESTIMATE(_)
                    | MavMessage::VISION_SPEED_ESTIMATE(_)
            )
        };
        self.heard.messages().iter().filter(|m| ours(m)).count() as u64
    }
}

fn free_port() -> SocketAddr {
    StdSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap()
}

/// Starts it with its recordings and states below `folder`, and small files.
fn start(to: [SocketAddr; 2], folder: &Path, deny: &str) -> Holdover {
    let endpoints = to.map(|to| format!("udpin:{to}"));
    let set = |key: &str, to: String| ["--set".to_owned(), format!("{key}={to}")];
    let below = |name: &str| folder.join(name).display().to_string();
    let mut arguments =
        vec!["--endpoint".to_owned(), endpoints[0].clone(), "--deny-gnss".into(), deny.into()];
    arguments.extend(["--endpoint".to_owned(), endpoints[1].clone()]);
    arguments.extend(set("state.dir", below("state")));
    arguments.extend(set("record.dir", below("flights")));
    arguments.extend(set("record.min_free_bytes", "0".into()));
    arguments.extend(set("tuning.record.max_file_bytes", "700000".into()));
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let holdover = Holdover::run(&arguments);
    holdover.wait_for("listens at", 2);
    holdover
}

/// The files of one recording in their order.
fn files(folder: &Path, run: u32) -> Vec<PathBuf> {
    let start = format!("holdover-{run:05}-");
    let entries = std::fs::read_dir(folder.join("flights")).unwrap().map(|e| e.unwrap().path());
    let mut files: Vec<_> =
        entries.filter(|p| p.file_name().unwrap().to_str().unwrap().starts_with(&start)).collect();
    files.sort();
    files
}

/// What `replay` says of one recording: all its files in a row.
fn replayed(folder: &Path, run: u32) -> Value {
    let whole = folder.join(format!("{run}.tlog"));
    let bytes: Vec<u8> = files(folder, run).iter().flat_map(|f| std::fs::read(f).unwrap()).collect();
    std::fs::write(&whole, bytes).unwrap();
    let config = folder.join(format!("flights/holdover-{run:05}.toml"));
    let output = Command::new(env!("CARGO_BIN_EXE_holdover"))
        .args(["replay", "--json", "--config"])
        .args([&config, &whole])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[tokio::test]
async fn a_recorded_flight_flies_again_to_the_same_bytes_and_others_read_it() {
    let (to, folder) = ([free_port(), free_port()], tempfile::tempdir().unwrap());
    let flight = Flight::load(COPTER, 140.0);
    let mut holdover = start(to, folder.path(), "80..110");
    let vehicle = Vehicle::new(to).await;
    flight.introduce(async |beat: &[u8]| vehicle.send(beat).await).await;
    vehicle.play(&flight, 0.0, 110.0).await;
    let last = Instant::now();
    // Killed in the outage, with what is written brought to the disk every second.
    sleep(Duration::from_millis(1500)).await;
    holdover.kill();
    sleep(Duration::from_millis(200)).await;
    let sent = vehicle.positions();
    assert!(sent > 300, "{sent}: {}", holdover.log());

    // The next goes on from the state, and its recording does, too.
    let mut holdover = start(to, folder.path(), "0..5");
    vehicle.send(flight.heartbeat()).await;
    // By every clock so much was lost.
    vehicle.play(&flight, 110.0 + last.elapsed().as_secs_f64(), 140.0).await;
    holdover.wait_for("restarted: goes on from", 1);
    sleep(Duration::from_millis(300)).await;
    holdover.stop();
    sleep(Duration::from_millis(300)).await;
    let first = replayed(folder.path(), 1);
    let again = &first["sent_again"];
    assert_eq!(again["sent"].as_u64(), Some(sent), "{again}");
    assert_eq!((&again["same"], &again["different"]), (&again["sent"], &Value::from(0)), "{again}");
    let parts = files(folder.path(), 1);
    assert!(parts.len() > 1, "{parts:?}");
    for part in &parts {
        let read = pymavlink::tlog(part);
        assert!(read["counts"].get("BAD_DATA").is_none() && read["seconds"].as_f64() > Some(0.5), "{read}");
        assert!(
            read["rising"].as_bool().unwrap() && read["counts"]["HIGHRES_IMU"].as_u64() > Some(100),
            "{read}"
        );
    }

    let second = replayed(folder.path(), 2);
    let again = &second["sent_again"];
    assert_eq!(again["sent"].as_u64(), Some(vehicle.positions() - sent), "{again}");
    assert!(again["sent"].as_u64() > Some(100), "{again}");
    assert_eq!((&again["same"], &again["different"]), (&again["sent"], &Value::from(0)), "{again}");
    let events = second["events"].as_array().unwrap();
    assert!(events.iter().any(|e| e["text"].as_str().unwrap().contains("restarted")), "{events:?}");
}

#[tokio::test]
async fn a_full_disk_and_one_that_is_none_change_nothing_in_what_is_sent() {
    let (to, folder) = ([free_port(), free_port()], tempfile::tempdir().unwrap());
    let flight = Flight::load(COPTER, 60.0);
    // A disk without room.
    let mut holdover = {
        let endpoints = to.map(|to| format!("udpin:{to}"));
        let dir = format!("record.dir={}", folder.path().join("flights").display());
        let full = ["--set", "record.min_free_bytes=1000000000000000"];
        let arguments = ["--endpoint", &endpoints[0], "--endpoint", &endpoints[1], "--set", &dir];
        Holdover::run(&[&arguments[..], &full, &["--set", "outbound.publish=always"]].concat())
    };
    holdover.wait_for("listens at", 2);
    let vehicle = Vehicle::new(to).await;
    flight.introduce(async |beat: &[u8]| vehicle.send(beat).await).await;
    vehicle.play(&flight, 0.0, 60.0).await;
    sleep(Duration::from_millis(300)).await;
    assert_eq!(holdover.told("not recording: the disk has no room"), 1, "{}", holdover.log());
    assert!(vehicle.positions() > 300, "{}", holdover.log());
    holdover.stop();
    assert!(holdover.log().contains("frames not recorded"), "{}", holdover.log());
    assert!(files(folder.path(), 1).is_empty());

    // A folder that cannot be made.
    let endpoint = format!("udpin:{}", free_port());
    let mut holdover = Holdover::run(&["--endpoint", &endpoint, "--set", "record.dir=/dev/null/flights"]);
    holdover.wait_for("nothing is recorded: /dev/null/flights", 1);
    holdover.wait_for("listens at", 1);
    holdover.stop();
}
