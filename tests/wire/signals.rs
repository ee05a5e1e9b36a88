//! What the system does to the real daemon: signals, and a log that nobody reads.

use std::io::{Read, Write};
use std::net::SocketAddr;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::live::flight::{Flight, Heard};
use crate::live::process::Holdover;
use mavlink::dialects::ardupilotmega::{MavMessage, MavState};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::time::{Instant, sleep, timeout};

const COPTER: &str = "ardupilot-copter-gps-loss";
const SPEED: f64 = 15.0;
/// What a pipe holds.
const PIPE_BYTES: usize = 65_536;
/// Asked for are 200 ms; a machine that is busy with other tests may take longer.
const SOON: Duration = Duration::from_secs(2);

fn signal(holdover: &Holdover, name: &str) {
    let status = Command::new("kill").args([name, &holdover.id().to_string()]).status().unwrap();
    assert!(status.success());
}

/// The daemon connects to the autopilot, so that nobody has to read its log for an address.
async fn connected(stderr: Stdio) -> (Holdover, TcpStream) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let endpoint = format!("tcpout:{}", listener.local_addr().unwrap());
    let holdover = Holdover::start(&["--endpoint", &endpoint, "--deny-gnss", "30..200"], stderr);
    let drone =
        timeout(Duration::from_secs(10), listener.accept()).await.expect("nobody connects").unwrap().0;
    (holdover, drone)
}

/// Flies into an outage: positions come. Then tells it to end: it says good-bye, soon.
async fn flies_and_ends(mut holdover: Holdover, drone: TcpStream) {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    let (flight, heard) = (Flight::load(COPTER, 50.0), Heard::default());
    let (mut reader, mut writer) = drone.into_split();
    let ears = heard.clone();
    tokio::spawn(async move {
        let mut buffer = [0; 4000];
        while let Ok(n @ 1..) = reader.read(&mut buffer).await {
            ears.add(&buffer[..n]);
        }
    });
    writer.write_all(flight.heartbeat()).await.unwrap();
    let send = async |burst: &[u8]| {
        let sending = timeout(Duration::from_secs(5), writer.write_all(burst));
        sending.await.expect("the daemon does not read").unwrap();
    };
    flight.play(0.0, 50.0, SPEED, send).await;
    heard.until("ODOMETRY", |h| h.odometry().len() > 100).await;
    holdover.terminate();
    assert_eq!(holdover.exit(SOON).code(), Some(0));
    heard.until("the last heartbeat", |h| h.messages().iter().any(is_good_bye)).await;
}

fn is_good_bye(message: &MavMessage) -> bool {
    matches!(message, MavMessage::HEARTBEAT(b) if b.system_status == MavState::MAV_STATE_POWEROFF)
}

#[tokio::test]
async fn who_does_not_read_the_log_holds_up_nothing() {
    let (mut reader, mut writer) = std::io::pipe().unwrap();
    writer.write_all(&[b'\n'; PIPE_BYTES]).unwrap();
    let (holdover, drone) = connected(writer.into()).await;
    flies_and_ends(holdover, drone).await;
    let mut left = [0; PIPE_BYTES];
    reader.read_exact(&mut left).unwrap();
    assert!(left.iter().all(|&b| b == b'\n'), "the pipe was not full");
}

#[tokio::test]
async fn who_reads_the_log_may_die() {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let (holdover, drone) = connected(writer.into()).await;
    flies_and_ends(holdover, drone).await;
}

#[tokio::test]
async fn lines_that_are_lost_are_counted_when_somebody_reads_again() {
    let (mut reader, mut writer) = std::io::pipe().unwrap();
    writer.write_all(&[b'\n'; PIPE_BYTES]).unwrap();
    let (mut holdover, _drone) = connected(writer.into()).await;
    // Far more than may wait.
    for _ in 0..700 {
        signal(&holdover, "-USR2");
        sleep(Duration::from_millis(1)).await;
    }
    signal(&holdover, "-USR1");
    let log = std::thread::spawn(move || {
        let mut log = String::new();
        reader.read_to_string(&mut log).unwrap();
        log
    });
    sleep(Duration::from_millis(500)).await;
    holdover.terminate();
    assert_eq!(holdover.exit(SOON).code(), Some(0));
    drop(holdover);
    let log = log.join().unwrap();
    // The limit of lines of a kind holds back what the pipe would lose.
    let told = log.lines().filter(|l| l.contains("SIGUSR2 means nothing")).count();
    assert!((30..=61).contains(&told), "{told} lines");
    assert!(log.contains("in the end: Aligning"), "{log}");
}

#[test]
fn no_signal_kills_it_but_those_that_end_it() {
    let mut holdover = Holdover::run(&["--endpoint", "udpin:127.0.0.1:0"]);
    holdover.address();
    signal(&holdover, "-USR1");
    holdover.wait_for("Aligning; heard nothing; sent 0", 1);
    signal(&holdover, "-USR2");
    holdover.wait_for("SIGUSR2 means nothing", 1);
    signal(&holdover, "-PIPE");
    signal(&holdover, "-HUP");
    holdover.wait_for("the configuration was read again: nothing has changed", 1);
    holdover.stop();
    let mut holdover = Holdover::run(&["--endpoint", "udpin:127.0.0.1:0"]);
    holdover.address();
    signal(&holdover, "-INT");
    assert_eq!(holdover.exit(SOON).code(), Some(0));
}

#[test]
fn a_hang_up_reloads_what_can_change_and_names_what_cannot() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.toml");
    let write = |text: &str| std::fs::write(&path, text).unwrap();
    write("[log]\nlevel = \"info\"\n");
    let file = path.to_str().unwrap();
    let mut holdover = Holdover::run(&["--config", file, "--endpoint", "udpin:127.0.0.1:0"]);
    holdover.address();
    write("[log]\nlevel = \"error\"\nlines_per_event_per_min = 7\n[outbound]\nrate_hz = 10\n");
    signal(&holdover, "-HUP");
    holdover.wait_for("outbound.rate_hz = 10", 1);
    assert_eq!(holdover.told("takes a restart"), 1, "{}", holdover.log());
    sleep_briefly();
    signal(&holdover, "-USR2");
    write("[log]\nlevel = \"warn\"\n[outbound]\nrate_hz = 10\n");
    signal(&holdover, "-HUP");
    holdover.wait_for("log.level is \"warn\" now", 1);
    assert_eq!(holdover.told("SIGUSR2"), 0, "only errors were to be told");
    write("[outbound]\nrate_hz = 1000\n");
    signal(&holdover, "-HUP");
    holdover.wait_for("the configuration is not read again, and stays as it was", 1);
    std::fs::remove_file(&path).unwrap();
    signal(&holdover, "-HUP");
    holdover.wait_for("the configuration is not read again, and stays as it was", 2);
    holdover.stop();
}

/// For a signal to be taken that leaves no line.
fn sleep_briefly() {
    std::thread::sleep(Duration::from_millis(300));
}

#[tokio::test]
async fn it_ends_at_once_under_a_flood() {
    let holdover = Holdover::run(&["--endpoint", "udpin:127.0.0.1:0"]);
    let to: SocketAddr = holdover.address();
    let flight = Flight::load(COPTER, 5.0);
    let frames: Vec<u8> = flight.frames.iter().flat_map(|(_, f)| f.clone()).take(1400).collect();
    let over = Arc::new(AtomicBool::new(false));
    let floods = Arc::clone(&over);
    let flood = std::thread::spawn(move || {
        let socket = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.send_to(flight.heartbeat(), to).unwrap();
        while !floods.load(Ordering::Relaxed) {
            // Refused when the daemon has ended.
            let _ = socket.send_to(&frames, to);
        }
    });
    let drone = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    drone.send_to(b"hello", to).await.unwrap();
    sleep(Duration::from_millis(500)).await;
    let (mut holdover, begun) = (holdover, Instant::now());
    holdover.terminate();
    let status = holdover.exit(2 * SOON);
    over.store(true, Ordering::Relaxed);
    flood.join().unwrap();
    assert_eq!(status.code(), Some(0), "{}", holdover.log());
    println!("ended after {:?}", begun.elapsed());
}
