//! The real daemon against a recorded flight, over every kind of link: what the autopilot gets to read, and what is survived.

use std::net::SocketAddr;
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

use crate::live::flight::{Flight, Heard, path};
use crate::live::process::Holdover;
use crate::live::pymavlink;
use crate::live::terminal::plug_in;
use holdover::sample::VehicleStatus;
use holdover::wire::encode_vehicle;
use holdover::wire::frame::{ComponentId, SystemId};
use holdover::wire::session::Address;
use holdover::wire::session::identity::AutopilotKind;
use holdover::wire::session::outgoing::FrameWriter;
use mavlink::dialects::ardupilotmega::{MavMessage, MavState, TIMESYNC_DATA};
use serde_json::Value;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, WriteHalf};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::time::{sleep, timeout};

const COPTER: &str = "ardupilot-copter-gps-loss";
const QUAD: &str = "px4-quad-gps-loss";
/// How much faster than real time a flight is played.
const SPEED: f64 = 15.0;
/// Number of the TIMESYNC question that is asked in flight.
const QUESTION: i64 = 4_242_424_242;

/// The autopilot's end of a link.
enum Drone {
    Udp(Arc<UdpSocket>, SocketAddr),
    Stream(Box<dyn AsyncWrite + Unpin + Send>),
}

impl Drone {
    /// A UDP socket that sends to `to`, and keeps what it hears.
    async fn udp(to: SocketAddr, heard: &Heard) -> Self {
        Self::on(UdpSocket::bind("127.0.0.1:0").await.unwrap(), to, heard)
    }

    fn on(socket: UdpSocket, to: SocketAddr, heard: &Heard) -> Self {
        let (socket, heard) = (Arc::new(socket), heard.clone());
        let listener = Arc::clone(&socket);
        tokio::spawn(async move {
            let mut buffer = vec![0; 2000];
            while let Ok(n) = listener.recv(&mut buffer).await {
                heard.add(&buffer[..n]);
            }
        });
        Self::Udp(socket, to)
    }

    fn stream<S: AsyncRead + AsyncWrite + Send + 'static>(stream: S, heard: &Heard) -> Self {
        let (mut reader, writer): (_, WriteHalf<S>) = tokio::io::split(stream);
        let heard = heard.clone();
        tokio::spawn(async move {
            let mut buffer = vec![0; 4000];
            while let Ok(n) = reader.read(&mut buffer).await {
                if n == 0 {
                    break;
                }
                heard.add(&buffer[..n]);
            }
        });
        Self::Stream(Box::new(writer))
    }

    async fn send(&mut self, bytes: &[u8]) {
        let sending = async {
            match self {
                Self::Udp(socket, to) => drop(socket.send_to(bytes, *to).await.unwrap()),
                Self::Stream(writer) => writer.write_all(bytes).await.unwrap(),
            }
        };
        timeout(Duration::from_secs(5), sending).await.expect("the daemon does not read");
    }

    async fn play(&mut self, flight: &Flight, from_s: f64, to_s: f64) {
        flight.play(from_s, to_s, SPEED, async |burst: &[u8]| self.send(burst).await).await;
    }
}

fn timesync(ts1: i64) -> Vec<u8> {
    let from = Address { system: SystemId(1), component: ComponentId(1) };
    let question = TIMESYNC_DATA { tc1: 0, ts1, target_system: 0, target_component: 0 };
    FrameWriter::new(from).write(&MavMessage::TIMESYNC(question)).unwrap().to_vec()
}

/// Plays the flight with a TIMESYNC question half way, and stops the daemon.
async fn fly(mut drone: Drone, holdover: &mut Holdover, flight: &Flight, to_s: f64, heard: &Heard) {
    flight.introduce(async |beat: &[u8]| drone.send(beat).await).await;
    let half = to_s / 2.0;
    drone.play(flight, 0.0, half).await;
    drone.send(&timesync(QUESTION)).await;
    drone.play(flight, half, to_s).await;
    sleep(Duration::from_millis(200)).await;
    holdover.stop();
    heard.until("the last heartbeat", |h| {
        let off = |m: &MavMessage| {
            matches!(m, MavMessage::HEARTBEAT(b) if b.system_status == MavState::MAV_STATE_POWEROFF)
        };
        h.messages().iter().any(off)
    })
    .await;
    assert_eq!(holdover.told("dropped on the way in"), 0, "{}", holdover.log());
    answered(heard, half);
}

/// The answer to [`QUESTION`] is the autopilot's own clock, which said `t_s`.
fn answered(heard: &Heard, t_s: f64) {
    let answer = |m| match m {
        MavMessage::TIMESYNC(t) if t.ts1 == QUESTION => Some(t.tc1),
        _ => None,
    };
    let answers: Vec<i64> = heard.messages().into_iter().filter_map(answer).collect();
    assert_eq!(answers.len(), 1, "{answers:?}");
    assert!((answers[0] as f64 * 1e-9 - t_s).abs() < 3.0, "{} ns at {t_s} s", answers[0]);
}

/// A row of `replay`'s solution.csv.
struct Row {
    t_s: f64,
    mode: String,
    ned: [f64; 3],
    resets: f64,
}

/// What `replay` makes of the same log and the same outage.
fn replayed(name: &str, outage: &str) -> Vec<Row> {
    let folder = tempfile::tempdir().unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_holdover"))
        .args(["replay", "--json", "--outage", outage, "--out"])
        .arg(folder.path())
        .arg(path(name))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = std::fs::read_to_string(folder.path().join("solution.csv")).unwrap();
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |i: usize| cells[i].parse().unwrap();
        Row {
            t_s: number(0),
            mode: cells[1].to_owned(),
            ned: [number(3), number(4), number(5)],
            resets: number(14),
        }
    };
    text.lines().skip(1).map(row).collect()
}

fn number(message: &Value, field: &str) -> f64 {
    message[field].as_f64().unwrap_or_else(|| panic!("{field} in {message}"))
}

fn numbers(message: &Value, field: &str) -> Vec<f64> {
    message[field].as_array().unwrap().iter().map(|v| v.as_f64().unwrap_or(f64::NAN)).collect()
}

fn of_type<'a>(messages: &'a [Value], name: &str) -> Vec<&'a Value> {
    messages.iter().filter(|m| m["mavpackettype"] == name).collect()
}

/// Checks everything that was sent, as pymavlink reads it.
fn check(heard: &Heard, name: &str, outage: &str, publish: &str, frames: (f64, f64)) {
    let messages = pymavlink::decode(&heard.bytes());
    let first = messages[0]["sequence"].as_u64().unwrap();
    for (i, m) in messages.iter().enumerate() {
        assert_eq!((number(m, "system"), number(m, "component")), (1.0, 197.0), "{m}");
        assert_eq!(m["sequence"].as_u64(), Some((first + i as u64) % 256), "{m}");
    }
    let beats = of_type(&messages, "HEARTBEAT");
    assert!(beats.len() > 4, "{}", beats.len());
    assert!(beats.iter().all(|b| number(b, "type") == 18.0 && number(b, "autopilot") == 8.0));
    let words = of_type(&messages, "STATUSTEXT");
    assert!(words.iter().any(|w| w["text"] == "Holdover: Aided -> Holdover: GNSS masked"), "{words:?}");

    let odometry = of_type(&messages, "ODOMETRY");
    for m in &odometry {
        assert_eq!((number(m, "frame_id"), number(m, "child_frame_id")), frames);
        assert_eq!(number(m, "estimator_type"), 3.0);
        assert!((1.0..=100.0).contains(&number(m, "quality")), "{m}");
        let norm = numbers(m, "q").iter().map(|c| c * c).sum::<f64>().sqrt();
        assert!((norm - 1.0).abs() < 1e-5, "{m}");
        for field in ["pose_covariance", "velocity_covariance"] {
            let covariance = numbers(m, field);
            assert!(covariance.iter().all(|c| c.is_finite()), "{m}");
            assert!([0, 6, 11, 15, 18, 20].iter().all(|&i| covariance[i] > 0.0), "{m}");
        }
        assert!(["x", "y", "z", "vx", "vy", "vz"].iter().all(|f| number(m, f).is_finite()), "{m}");
    }
    let times: Vec<f64> = odometry.iter().map(|m| number(m, "time_usec")).collect();
    assert!(times.windows(2).all(|w| w[1] > w[0]), "time does not increase");
    let span_s = (times[times.len() - 1] - times[0]) * 1e-6;
    let rate_hz = (times.len() - 1) as f64 / span_s;
    assert!((28.5..=30.5).contains(&rate_hz), "{rate_hz} Hz over {span_s} s");
    // What the two heard before the outage differs by the first second. Flow takes such a difference out; without it, coasting
    // carries it on as a velocity.
    let tolerance_m = if name == QUAD { 1.5 } else { 0.3 };
    let (rows, start_s) = (replayed(name, outage), Flight::start_us(name) as f64 * 1e-6);
    compare(&odometry, &rows, start_s, tolerance_m);
    let decided = rows.iter().find(|r| r.mode == "Holdover").unwrap().t_s;
    let after_s = times[0] * 1e-6 - start_s - decided;
    if publish == "auto" {
        assert!(after_s < -20.0, "sent from the alignment on: {after_s} s after the decision");
        let longest_s = times.windows(2).map(|w| w[1] - w[0]).fold(0.0, f64::max) * 1e-6;
        assert!(longest_s < 0.3, "a hole of {longest_s} s");
    } else {
        // The rows of the solution are 0.1 s apart at most.
        assert!((-0.1..0.3).contains(&after_s), "{after_s} s after the decision");
    }
}

/// The positions are `replay`'s, in the autopilot's frame: the same but for a constant difference of the origins. And each was
/// sent in a mode in which it may be sent.
fn compare(odometry: &[&Value], rows: &[Row], start_s: f64, tolerance_m: f64) {
    let mut differences: [Vec<f64>; 3] = Default::default();
    for m in odometry {
        let t = number(m, "time_usec") * 1e-6 - start_s;
        let after = rows.partition_point(|r| r.t_s < t).clamp(1, rows.len() - 1);
        let (a, b) = (&rows[after - 1], &rows[after]);
        let may = |r: &Row| ["Aided", "Holdover", "Rejoining"].contains(&&*r.mode);
        assert!(may(a) || may(b), "sent at {t} s, when replay was {}", a.mode);
        assert!(number(m, "reset_counter") == a.resets || number(m, "reset_counter") == b.resets, "{m}");
        // While GNSS aids, what the two heard at first differs yet, and so does the offset that is being learned.
        if a.resets != b.resets || a.mode == "Aided" {
            continue;
        }
        let part = ((t - a.t_s) / (b.t_s - a.t_s)).clamp(0.0, 1.0);
        for (axis, field) in ["x", "y", "z"].iter().enumerate() {
            let expected = a.ned[axis] + part * (b.ned[axis] - a.ned[axis]);
            differences[axis].push(number(m, field) - expected);
        }
    }
    for (axis, mut d) in differences.into_iter().enumerate() {
        d.sort_by(f64::total_cmp);
        let (least, median, most) = (d[0], d[d.len() / 2], d[d.len() - 1]);
        println!("axis {axis}: {} compared, offset {median:.3} m, from {least:.3} to {most:.3} m", d.len());
        assert!(median.abs() < 2.0, "the frames differ by {median} m on axis {axis}");
        let spread_m = (median - least).max(most - median);
        assert!(spread_m < tolerance_m, "{least} {median} {most} m on axis {axis}");
    }
}

const OUTAGE: &str = "80..140";
const UNTIL_S: f64 = 143.0;
const ARDUPILOT_FRAMES: (f64, f64) = (20.0, 12.0);

#[tokio::test]
async fn a_flight_over_udp() {
    let (flight, heard) = (Flight::load(COPTER, UNTIL_S), Heard::default());
    let mut holdover = Holdover::run(&["--endpoint", "udpin:127.0.0.1:0", "--deny-gnss", OUTAGE]);
    let drone = Drone::udp(holdover.address(), &heard).await;
    fly(drone, &mut holdover, &flight, UNTIL_S, &heard).await;
    check(&heard, COPTER, OUTAGE, "auto", ARDUPILOT_FRAMES);
}

#[tokio::test]
async fn a_flight_over_tcp_to_the_daemon() {
    let (flight, heard) = (Flight::load(COPTER, UNTIL_S), Heard::default());
    let only = ["--set", "outbound.publish=holdover"];
    let arguments = ["--endpoint", "tcpin:127.0.0.1:0", "--deny-gnss", OUTAGE];
    let mut holdover = Holdover::run(&[&arguments[..], &only].concat());
    let drone = Drone::stream(TcpStream::connect(holdover.address()).await.unwrap(), &heard);
    fly(drone, &mut holdover, &flight, UNTIL_S, &heard).await;
    check(&heard, COPTER, OUTAGE, "holdover", ARDUPILOT_FRAMES);
}

async fn accept(listener: &TcpListener) -> TcpStream {
    timeout(Duration::from_secs(10), listener.accept()).await.expect("nobody connects").unwrap().0
}

#[tokio::test]
async fn a_px4_flight_over_tcp_from_the_daemon() {
    let (flight, heard) = (Flight::load(QUAD, 90.0), Heard::default());
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let endpoint = format!("tcpout:{}", listener.local_addr().unwrap());
    let mut holdover = Holdover::run(&["--endpoint", &endpoint, "--deny-gnss", "70..84"]);
    let drone = Drone::stream(accept(&listener).await, &heard);
    fly(drone, &mut holdover, &flight, 90.0, &heard).await;
    check(&heard, QUAD, "70..84", "auto", (1.0, 12.0));
}

#[tokio::test]
async fn a_flight_over_a_serial_port() {
    let (flight, heard) = (Flight::load(COPTER, UNTIL_S), Heard::default());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("autopilot");
    let (drone, device) = plug_in(&path);
    let endpoint = format!("serial:{}:921600", path.display());
    let mut holdover = Holdover::run(&["--endpoint", &endpoint, "--deny-gnss", OUTAGE]);
    holdover.wait_for("link 0: up", 1);
    drop(device);
    fly(Drone::stream(drone, &heard), &mut holdover, &flight, UNTIL_S, &heard).await;
    check(&heard, COPTER, OUTAGE, "auto", ARDUPILOT_FRAMES);
}

#[tokio::test]
async fn a_cable_that_is_pulled_and_put_back_goes_on() {
    let flight = Flight::load(COPTER, 140.0);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("autopilot");
    let (drone, device) = plug_in(&path);
    let endpoint = format!("serial:{}:921600", path.display());
    let mut holdover = Holdover::run(&["--endpoint", &endpoint, "--deny-gnss", "30..200"]);
    holdover.wait_for("link 0: up", 1);
    drop(device);
    let heard = Heard::default();
    // Not split: the port is closed when it is dropped.
    let mut drone = drone;
    flight.introduce(async |beat: &[u8]| drone.write_all(beat).await.unwrap()).await;
    let mut buffer = vec![0; 4000];
    flight
        .play(0.0, 45.0, SPEED, async |burst: &[u8]| {
            drone.write_all(burst).await.unwrap();
            while let Ok(n) = drone.reader().try_read(&mut buffer) {
                heard.add(&buffer[..n]);
            }
        })
        .await;
    assert!(!heard.odometry().is_empty(), "{}", holdover.log());
    std::fs::remove_file(&path).unwrap();
    drop(drone);
    holdover.wait_for("link 0: down", 1);
    holdover.wait_for("IMU silent", 1);

    let heard = Heard::default();
    let (drone, device) = plug_in(&path);
    holdover.wait_for("link 0: up", 2);
    drop(device);
    // It is said to be back when it has come for 5 s.
    Drone::stream(drone, &heard).play(&flight, 45.0, 140.0).await;
    holdover.wait_for("IMU is back", 1);
    heard.until("ODOMETRY", |h| h.odometry().len() > 200).await;
    holdover.stop();
}

#[tokio::test]
async fn a_log_that_cannot_be_written_ends_nothing() {
    let flight = Flight::load(COPTER, 50.0);
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let endpoint = format!("tcpout:{}", listener.local_addr().unwrap());
    let mut holdover = Holdover::run_without_log(&["--endpoint", &endpoint, "--deny-gnss", "30..200"]);
    let heard = Heard::default();
    let mut autopilot = accept(&listener).await;
    flight.introduce(async |beat: &[u8]| autopilot.write_all(beat).await.unwrap()).await;
    Drone::stream(autopilot, &heard).play(&flight, 0.0, 50.0).await;
    heard.until("ODOMETRY", |h| h.odometry().len() > 100).await;
    holdover.stop();
}

#[tokio::test]
async fn a_tcp_server_that_is_restarted_goes_on() {
    let flight = Flight::load(COPTER, 60.0);
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let endpoint = format!("tcpout:{address}");
    let mut holdover = Holdover::run(&["--endpoint", &endpoint, "--deny-gnss", "30..200"]);
    let mut first = accept(&listener).await;
    flight.introduce(async |beat: &[u8]| first.write_all(beat).await.unwrap()).await;
    flight.play(0.0, 40.0, SPEED, async |burst: &[u8]| first.write_all(burst).await.unwrap()).await;
    drop((first, listener));
    holdover.wait_for("link 0: down", 1);

    let listener = TcpListener::bind(address).await.unwrap();
    let heard = Heard::default();
    Drone::stream(accept(&listener).await, &heard).play(&flight, 40.0, 60.0).await;
    // It stands until 52 s; then it takes off, and with a flow that is not trusted yet nothing but inertia carries it.
    heard.until("ODOMETRY", |h| h.odometry().len() > 250).await;
    let wished = |h: &Heard| h.messages().iter().any(|m| matches!(m, MavMessage::COMMAND_LONG(_)));
    assert!(wished(&heard), "the streams are not asked for again");
    holdover.stop();
}

#[tokio::test]
async fn a_stall_in_holdover_sends_no_stale_pose() {
    let (flight, heard) = (Flight::load(COPTER, 50.0), Heard::default());
    let mut holdover = Holdover::run(&["--endpoint", "udpin:127.0.0.1:0", "--deny-gnss", "30..200"]);
    let mut drone = Drone::udp(holdover.address(), &heard).await;
    flight.introduce(async |beat: &[u8]| drone.send(beat).await).await;
    drone.play(&flight, 0.0, 50.0).await;
    sleep(Duration::from_millis(200)).await;
    let before = heard.odometry();
    assert!(before.len() > 300, "{}", before.len());
    heard
        .until("a critical heartbeat", |h| {
            let silent = |m: &MavMessage| {
                matches!(m, MavMessage::HEARTBEAT(b)
                    if b.system_status == MavState::MAV_STATE_CRITICAL && b.custom_mode == 6)
            };
            h.messages().iter().any(silent)
        })
        .await;
    sleep(Duration::from_millis(500)).await;
    assert_eq!(heard.odometry().len(), before.len(), "a pose was sent after the stall");
    let said = heard.messages().iter().any(
        |m| matches!(m, MavMessage::STATUSTEXT(w) if w.text.to_str().is_ok_and(|t| t.contains("IMU silent"))),
    );
    assert!(said, "{}", holdover.log());
    holdover.stop();
}

#[tokio::test]
async fn what_is_lost_is_silent_within_300_ms() {
    let (flight, heard) = (Flight::load(QUAD, 100.0), Heard::default());
    let coast = ["--set", "holdover.max_sigma_m=4"];
    let arguments = ["--endpoint", "udpin:127.0.0.1:0", "--deny-gnss", "70..200"];
    let mut holdover = Holdover::run(&[&arguments[..], &coast].concat());
    let mut drone = Drone::udp(holdover.address(), &heard).await;
    flight.introduce(async |beat: &[u8]| drone.send(beat).await).await;
    drone.play(&flight, 0.0, 100.0).await;
    sleep(Duration::from_millis(200)).await;
    holdover.stop();
    let messages = heard.messages();
    let lost = messages.iter().position(
        |m| matches!(m, MavMessage::STATUSTEXT(w) if w.text.to_str().is_ok_and(|t| t.contains("-> Lost"))),
    );
    let quality = |m: &MavMessage| match m {
        MavMessage::ODOMETRY(o) => Some(o.quality),
        _ => None,
    };
    let (before, after) = messages.split_at(lost.unwrap_or_else(|| panic!("{}", holdover.log())));
    assert!(before.iter().filter_map(quality).filter(|&q| q > 0).count() > 300);
    // The position at the decision leaves before the word: 30 a second.
    let farewell: Vec<i8> = after.iter().filter_map(quality).collect();
    assert!((3..=9).contains(&farewell.len()) && farewell.iter().all(|&q| q == -1), "{farewell:?}");
}

#[tokio::test]
async fn of_two_vehicles_the_second_is_ignored() {
    let flight = Flight::load(COPTER, 20.0);
    let (heard, stray) = (Heard::default(), Heard::default());
    let mut holdover = Holdover::run(&["--endpoint", "udpin:127.0.0.1:0"]);
    let mut first = Drone::udp(holdover.address(), &heard).await;
    let mut second = Drone::udp(holdover.address(), &stray).await;
    flight.introduce(async |beat: &[u8]| first.send(beat).await).await;
    holdover.wait_for("following ArduPilot, system 1", 1);
    second.send(flight.heartbeat()).await;
    holdover.wait_for("is ignored", 1);
    flight
        .play(0.0, 18.0, SPEED, async |burst: &[u8]| {
            first.send(burst).await;
            second.send(burst).await;
        })
        .await;
    assert!(stray.bytes().is_empty(), "the second vehicle was answered");
    assert!(!heard.bytes().is_empty());

    // Other systems behind the same address: a ground station, which is as it should be, and a vehicle.
    let station = Address { system: SystemId(255), component: ComponentId(190) };
    let beat = holdover::wire::session::heartbeat::heartbeat;
    let beat = beat(holdover::wire::session::heartbeat::SystemStatus::Active, 0);
    first.send(&FrameWriter::new(station).write(&beat).unwrap()).await;
    let other = Address { system: SystemId(2), component: ComponentId(1) };
    let beat = encode_vehicle::heartbeat(AutopilotKind::Px4, &VehicleStatus::default());
    first.send(&FrameWriter::new(other).write(&beat).unwrap()).await;
    holdover.wait_for("system 2 is heard, too, and ignored", 1);
    assert_eq!(holdover.told("system 255"), 0, "{}", holdover.log());
    holdover.stop();
    assert!(holdover.log().contains("2 wrong system"), "{}", holdover.log());
}

#[tokio::test]
async fn the_same_vehicle_on_two_links_is_used_once() {
    let flight = Flight::load(COPTER, 20.0);
    let endpoint = "tcpin:127.0.0.1:0";
    let mut holdover = Holdover::run(&["--endpoint", endpoint, "--endpoint", endpoint]);
    let (heard, twin) = (Heard::default(), Heard::default());
    let address = |n: usize| -> SocketAddr {
        holdover.wait_for("listens at", n).rsplit(' ').next().unwrap().parse().unwrap()
    };
    let mut first = Drone::stream(TcpStream::connect(address(1)).await.unwrap(), &heard);
    let mut second = Drone::stream(TcpStream::connect(address(2)).await.unwrap(), &twin);
    flight.introduce(async |beat: &[u8]| first.send(beat).await).await;
    holdover.wait_for("following", 1);
    let mut sent = 0;
    flight
        .play(0.0, 20.0, SPEED, async |burst: &[u8]| {
            first.send(burst).await;
            second.send(burst).await;
            sent += 1;
        })
        .await;
    sleep(Duration::from_millis(100)).await;
    holdover.stop();
    assert!(sent > 0 && holdover.log().contains("duplicates"), "{}", holdover.log());
    assert!(!holdover.log().contains("out of order"), "both were decoded:\n{}", holdover.log());
    let asked = |h: &Heard| h.messages().iter().any(|m| matches!(m, MavMessage::TIMESYNC(_)));
    assert!(asked(&heard) && !asked(&twin));
}

#[test]
fn a_port_in_use_is_named() {
    let taken = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("udpin:{}", taken.local_addr().unwrap());
    let mut holdover = Holdover::run(&["--endpoint", &endpoint]);
    assert_eq!(holdover.exit(Duration::from_secs(5)).code(), Some(5));
    let line = holdover.wait_for(&endpoint, 1);
    assert!(line.contains("listens at this address already"), "{line}");
}

#[tokio::test]
async fn a_serial_device_that_is_not_there_yet_is_named_and_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("autopilot");
    let endpoint = format!("serial:{}:921600", path.display());
    let mut holdover = Holdover::run(&["--endpoint", &endpoint]);
    let line = holdover.wait_for("there is no device", 1);
    assert!(line.contains("WARN") && line.contains(&path.display().to_string()), "{line}");

    let flight = Flight::load(COPTER, 10.0);
    let (stream, device) = plug_in(&path);
    let mut drone = Drone::stream(stream, &Heard::default());
    holdover.wait_for("up, to", 1);
    drop(device);
    flight.introduce(async |beat: &[u8]| drone.send(beat).await).await;
    drone.play(&flight, 0.0, 10.0).await;
    holdover.wait_for("following", 1);
    holdover.stop();
}

#[test]
fn wrong_settings_end_it_with_2_and_a_dry_run_opens_nothing() {
    let mut wrong = Holdover::run(&["--set", "outbound.rate_hz=fast"]);
    assert_eq!(wrong.exit(Duration::from_secs(5)).code(), Some(2));
    wrong.wait_for("outbound.rate_hz", 1);
    let mut wrong = Holdover::run(&["--deny-gnss", "9..3"]);
    assert_eq!(wrong.exit(Duration::from_secs(5)).code(), Some(2));
    let taken = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("udpin:{}", taken.local_addr().unwrap());
    let mut dry = Holdover::run(&["--dry-run", "--endpoint", &endpoint]);
    assert_eq!(dry.exit(Duration::from_secs(5)).code(), Some(0), "{}", dry.log());
}

#[test]
fn it_ends_at_once_when_nothing_was_ever_heard() {
    let mut holdover = Holdover::run(&["--endpoint", "udpin:127.0.0.1:0"]);
    holdover.address();
    holdover.stop();
    assert_eq!(holdover.told("in the end: Aligning; heard nothing; sent 0"), 1, "{}", holdover.log());
}
