//! The real daemon stopped for two seconds in an outage, or told late: what is old is not sent as if it were new, on any transport.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::live::flight::Flight;
use crate::live::process::Holdover;
use crate::live::terminal::plug_in;
use holdover::wire::frame::{Scan, scan};
use mavlink::dialects::ardupilotmega::MavMessage;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpStream, UdpSocket};
use tokio::time::{Instant, sleep};

const COPTER: &str = "ardupilot-copter-gps-loss";
const SPEED: f64 = 15.0;
/// Aligned and with a flow that is trusted, and in real time from here on, s.
const REAL_TIME_S: f64 = 97.0;
const PAUSED_S: f64 = 2.0;
/// What a position may be old for when it is read here. Less is configured; this process may be slow, too.
const OLD: Duration = Duration::from_millis(1000);
const STALE: &str = "tuning.link.stale_output_ms=200";

/// When each IMU sample was sent, by its stamp, and how old the positions that stand on them were when they were read.
#[derive(Default)]
struct Ages {
    sent: HashMap<u64, Instant>,
    odometry: Vec<(Instant, Duration)>,
    rest: Vec<u8>,
}

impl Ages {
    fn sends(&mut self, burst: &[u8]) {
        let mut rest = burst;
        while let Scan::Frame(frame) | Scan::Unknown(frame) = scan(rest, true) {
            if let Ok(MavMessage::HIGHRES_IMU(imu)) = frame.parse() {
                self.sent.insert(imu.time_usec, Instant::now());
            }
            rest = &rest[frame.len()..];
        }
    }

    fn hears(&mut self, bytes: &[u8]) {
        self.rest.extend_from_slice(bytes);
        let whole = std::mem::take(&mut self.rest);
        let mut rest = &whole[..];
        while let Scan::Frame(frame) = scan(rest, false) {
            if let Ok(MavMessage::ODOMETRY(odometry)) = frame.parse() {
                let now = Instant::now();
                self.odometry.push((now, now - self.sent[&odometry.time_usec]));
            }
            rest = &rest[frame.len()..];
        }
        self.rest = rest.to_vec();
    }
}

/// Warms up, stops the daemon for a while as the flight goes on, and looks at what was sent.
async fn paused(
    holdover: &mut Holdover,
    flight: &Flight,
    ages: &Mutex<Ages>,
    mut send: impl AsyncFnMut(&[u8]),
) {
    let mut send = async |burst: &[u8]| {
        ages.lock().unwrap().sends(burst);
        send(burst).await;
    };
    flight.introduce(&mut send).await;
    flight.play(0.0, REAL_TIME_S, SPEED, &mut send).await;
    flight.play(REAL_TIME_S, REAL_TIME_S + 1.0, 1.0, &mut send).await;
    assert!(!ages.lock().unwrap().odometry.is_empty(), "{}", holdover.log());
    signal(holdover, "-STOP");
    let (stopped, from_s) = (Instant::now(), REAL_TIME_S + 1.0);
    flight.play(from_s, from_s + PAUSED_S, 1.0, &mut send).await;
    signal(holdover, "-CONT");
    flight.play(from_s + PAUSED_S, from_s + PAUSED_S + 3.0, 1.0, &mut send).await;
    sleep(Duration::from_millis(300)).await;
    holdover.stop();
    let ages = ages.lock().unwrap();
    let after: Vec<Duration> =
        ages.odometry.iter().filter(|(at, _)| *at > stopped + OLD).map(|(_, age)| *age).collect();
    assert!(after.len() > 20, "{} sent after the pause\n{}", after.len(), holdover.log());
    let old = after.iter().filter(|age| **age > OLD).count();
    assert_eq!(old, 0, "of {}, the oldest {:?}\n{}", after.len(), after.iter().max(), holdover.log());
}

fn signal(holdover: &Holdover, name: &str) {
    let status = Command::new("kill").args([name, &holdover.id().to_string()]).status().unwrap();
    assert!(status.success());
}

/// A socket, and what comes to it is heard.
async fn hearing(ages: &Arc<Mutex<Ages>>) -> Arc<UdpSocket> {
    let socket = Arc::new(UdpSocket::bind("127.0.0.1:0").await.unwrap());
    let (ears, heard) = (Arc::clone(&socket), Arc::clone(ages));
    tokio::spawn(async move {
        let mut buffer = [0; 2000];
        while let Ok(n) = ears.recv(&mut buffer).await {
            heard.lock().unwrap().hears(&buffer[..n]);
        }
    });
    socket
}

fn start(endpoint: &str) -> Holdover {
    Holdover::run(&["--endpoint", endpoint, "--deny-gnss", "80..400", "--set", STALE])
}

#[tokio::test]
async fn no_old_position_is_sent_after_a_pause_over_udp() {
    let (flight, ages) = (Flight::load(COPTER, 110.0), Arc::new(Mutex::new(Ages::default())));
    let mut holdover = start("udpin:127.0.0.1:0");
    let to: SocketAddr = holdover.address();
    let socket = hearing(&ages).await;
    let send = async |burst: &[u8]| {
        socket.send_to(burst, to).await.unwrap();
    };
    paused(&mut holdover, &flight, &ages, send).await;
}

#[tokio::test]
async fn no_old_position_is_sent_after_a_pause_over_tcp() {
    let (flight, ages) = (Flight::load(COPTER, 110.0), Arc::new(Mutex::new(Ages::default())));
    let mut holdover = start("tcpin:127.0.0.1:0");
    let (mut reader, mut writer) = TcpStream::connect(holdover.address()).await.unwrap().into_split();
    let heard = Arc::clone(&ages);
    tokio::spawn(async move {
        let mut buffer = [0; 4000];
        while let Ok(n @ 1..) = reader.read(&mut buffer).await {
            heard.lock().unwrap().hears(&buffer[..n]);
        }
    });
    let send = async |burst: &[u8]| writer.write_all(burst).await.unwrap();
    paused(&mut holdover, &flight, &ages, send).await;
}

#[tokio::test]
async fn no_old_position_is_sent_after_a_pause_over_a_serial_port() {
    let (flight, ages) = (Flight::load(COPTER, 110.0), Arc::new(Mutex::new(Ages::default())));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("autopilot");
    let (drone, device) = plug_in(&path);
    let mut holdover = start(&format!("serial:{}:921600", path.display()));
    holdover.wait_for("link 0: up", 1);
    drop(device);
    let (mut reader, mut writer) = tokio::io::split(drone);
    let heard = Arc::clone(&ages);
    tokio::spawn(async move {
        let mut buffer = [0; 4000];
        while let Ok(n @ 1..) = reader.read(&mut buffer).await {
            heard.lock().unwrap().hears(&buffer[..n]);
        }
    });
    let send = async |burst: &[u8]| {
        // A device holds little, and the daemon is stopped: what does not fit is lost, as on a wire.
        drop(tokio::time::timeout(Duration::from_millis(20), writer.write_all(burst)).await);
    };
    paused(&mut holdover, &flight, &ages, send).await;
}

#[tokio::test]
async fn positions_that_stand_on_late_samples_are_not_sent_as_present() {
    let (flight, ages) = (Flight::load(COPTER, 110.0), Arc::new(Mutex::new(Ages::default())));
    let mut holdover = start("udpin:127.0.0.1:0");
    let to: SocketAddr = holdover.address();
    let socket = hearing(&ages).await;
    let send = async |burst: &[u8]| {
        ages.lock().unwrap().sends(burst);
        socket.send_to(burst, to).await.unwrap();
    };
    send(flight.heartbeat()).await;
    flight.play(0.0, REAL_TIME_S, SPEED, send).await;
    flight.play(REAL_TIME_S, REAL_TIME_S + 1.5, 1.0, send).await;
    let sent = ages.lock().unwrap().odometry.len();
    assert!(sent > 0, "{}", holdover.log());
    // Something on the way keeps everything back for 1.5 s from now on.
    sleep(Duration::from_millis(1500)).await;
    let before = ages.lock().unwrap().odometry.len();
    flight.play(REAL_TIME_S + 1.5, REAL_TIME_S + 4.5, 1.0, send).await;
    sleep(Duration::from_millis(300)).await;
    holdover.stop();
    assert_eq!(holdover.told("s late: no position is sent"), 1, "{}", holdover.log());
    let after = ages.lock().unwrap().odometry.len() - before;
    assert_eq!(after, 0, "positions of 1.5 s ago were sent\n{}", holdover.log());
}
