//! The page's server beside a live flight: what it tells, to whom, and that nobody who asks is felt by the navigation.

use std::collections::BTreeSet;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use serde_json::Value;
use tokio::net::UdpSocket;

use crate::live::flight::{Flight, Heard};
use crate::live::process::Holdover;

const FLIGHT: &str = "ardupilot-copter-gps-loss";
/// How much faster than it was flown the flight is played.
const SPEED: f64 = 10.0;

/// Where the page is.
pub fn page(holdover: &Holdover) -> SocketAddr {
    let line = holdover.wait_for("the page is at http://", 1);
    line.rsplit("http://").next().unwrap().trim_end_matches('/').parse().unwrap()
}

/// Sends `request` and reads what comes, until the other end closes.
fn exchange(to: SocketAddr, request: &[u8]) -> String {
    let mut stream = TcpStream::connect(to).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    // It may have closed already.
    let _ = stream.write_all(request);
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8_lossy(&answer).into_owned()
}

/// Status and body of a GET.
pub fn get(to: SocketAddr, path: &str) -> (u16, String) {
    let answer = exchange(to, format!("GET {path} HTTP/1.1\r\nHost: {to}\r\n\r\n").as_bytes());
    let (head, body) = answer.split_once("\r\n\r\n").unwrap_or_else(|| panic!("{path}: {answer}"));
    (code(head), body.to_owned())
}

fn code(head: &str) -> u16 {
    head.split(' ').nth(1).and_then(|c| c.parse().ok()).unwrap_or(0)
}

fn json(to: SocketAddr, path: &str) -> Value {
    let (code, body) = get(to, path);
    assert_eq!(code, 200, "{path}: {body}");
    serde_json::from_str(&body).unwrap()
}

pub struct Flown {
    pub holdover: Holdover,
    pub heard: Heard,
    flight: Flight,
    socket: Arc<UdpSocket>,
}

impl Flown {
    pub async fn begin(to_s: f64, arguments: &[&str]) -> Self {
        let common = ["--endpoint", "udpin:127.0.0.1:0", "--set", "status.listen=127.0.0.1:0"];
        let holdover = Holdover::run(&[&common[..], arguments].concat());
        let socket = Arc::new(UdpSocket::bind("127.0.0.1:0").await.unwrap());
        socket.connect(holdover.address()).await.unwrap();
        let heard = Heard::on(&socket);
        let flight = Flight::load(FLIGHT, to_s);
        let flown = Self { holdover, heard, flight, socket };
        flown.flight.introduce(async |bytes| drop(flown.socket.send(bytes).await)).await;
        flown
    }

    pub async fn fly(&self, from_s: f64, to_s: f64) {
        self.flight.play(from_s, to_s, SPEED, async |bytes| drop(self.socket.send(bytes).await)).await;
        // The next view is made 200 ms later at most, on a machine that is not busy.
        tokio::time::sleep(Duration::from_millis(500)).await;
    }
}

#[tokio::test]
async fn a_flight_is_told_as_it_is_flown() {
    let mut flown = Flown::begin(140.0, &["--deny-gnss", "70..105"]).await;
    let to = page(&flown.holdover);
    flown.fly(0.0, 65.0).await;
    let aided = json(to, "/api/v1/status");
    assert_eq!(aided["mode"]["name"], "Aided", "{aided}");
    assert_eq!(
        (&aided["vehicle"]["autopilot"], &aided["vehicle"]["heard"]),
        (&"ArduPilot".into(), &true.into())
    );
    let sigma_m = aided["uncertainty"]["horizontal_m"].as_f64().unwrap();
    assert!((0.1..10.0).contains(&sigma_m), "{sigma_m}");
    let imu = &aided["sources"][0];
    assert_eq!((&imu["kind"], &imu["health"]), (&"IMU".into(), &"healthy".into()));
    // A hundred a second, ten times as fast, while it was played.
    assert!(imu["used"].as_u64().unwrap() > 5000, "{imu}");
    assert!(aided["plan"]["gnss_m"].is_array() && aided["plan"]["autopilot_m"].is_array(), "{aided}");

    flown.fly(65.0, 100.0).await;
    let outage = json(to, "/api/v1/status");
    assert_eq!(outage["mode"]["name"], "Holdover", "{outage}");
    assert!(outage["mode"]["reason"].as_str().unwrap().contains("GNSS"), "{outage}");
    assert!(outage["output"]["sent"].as_u64() > aided["output"]["sent"].as_u64());

    flown.fly(100.0, 140.0).await;
    let back = json(to, "/api/v1/status");
    assert_eq!(back["mode"]["name"], "Aided", "{back}");
    let events = json(to, "/api/v1/events");
    let events = events.as_array().unwrap();
    let numbers: Vec<u64> = events.iter().map(|e| e["number"].as_u64().unwrap()).collect();
    assert!(numbers.is_sorted() && numbers[0] == 1);
    let modes = events.iter().filter(|e| e["code"] == "mode").count();
    assert!(modes >= 3, "{events:?}");
    let later = json(to, &format!("/api/v1/events?after={}", numbers[2]));
    assert_eq!(later.as_array().unwrap()[0]["number"].as_u64(), Some(numbers[3]));
    let track = json(to, "/api/v1/track");
    assert!(track.as_array().unwrap().len() >= 5, "{track}");
    metrics_hold(to, &back);
    flown.holdover.stop();
}

/// The metrics agree with the status, and hold whatever the dashboard shows.
fn metrics_hold(to: SocketAddr, status: &Value) {
    let (code, text) = get(to, "/metrics");
    assert_eq!(code, 200);
    assert!(text.ends_with("# EOF\n"), "{text}");
    assert!(text.contains("holdover_mode{mode=\"aided\"} 1.0\n"), "{text}");
    let value = |name: &str| {
        let line =
            text.lines().find(|l| l.starts_with(&format!("{name} "))).unwrap_or_else(|| panic!("{name}"));
        line.rsplit(' ').next().unwrap().parse::<f64>().unwrap()
    };
    assert!(value("holdover_positions_sent_total") >= status["output"]["sent"].as_f64().unwrap());
    assert!(value("holdover_frames_total") > 1000.0);
    let names: BTreeSet<&str> =
        text.lines().filter(|l| !l.starts_with('#')).filter_map(|l| l.split(['{', ' ']).next()).collect();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/grafana/holdover.json");
    let dashboard: Value = serde_json::from_str(&std::fs::read_to_string(file).unwrap()).unwrap();
    // Those that are not there while nothing is to be told of.
    let unless_told =
        ["holdover_outlook_error_meters", "holdover_position_latency_seconds", "holdover_round_trip_seconds"];
    let described: BTreeSet<&str> =
        text.lines().filter_map(|l| l.strip_prefix("# TYPE ")?.split(' ').next()).collect();
    let panels = dashboard["panels"].as_array().unwrap();
    assert!(panels.len() > 10);
    let mut shown = BTreeSet::new();
    for panel in panels {
        for target in panel["targets"].as_array().unwrap() {
            let expr = target["expr"].as_str().unwrap();
            let words = expr.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
            let used: Vec<&str> = words.filter(|w| w.starts_with("holdover_")).collect();
            assert!(!used.is_empty(), "{}: {expr}", panel["title"]);
            for name in used {
                let there = names.contains(name) || (unless_told.contains(&name) && described.contains(name));
                assert!(there || name == "holdover_frames_rejected_total", "{}: {name}", panel["title"]);
                shown.insert(name);
            }
        }
    }
    let unused: Vec<_> = names.iter().filter(|n| !shown.contains(**n)).collect();
    assert!(unused.is_empty(), "the dashboard does not show {unused:?}");
}

#[tokio::test]
async fn what_is_no_request_of_ours_is_refused() {
    let mut holdover =
        Holdover::run(&["--endpoint", "udpin:127.0.0.1:0", "--set", "status.listen=127.0.0.1:0"]);
    let to = page(&holdover);
    let ask = |request: String| code(&exchange(to, request.as_bytes()));
    let host = format!("Host: {to}\r\n");
    assert_eq!(get(to, "/").0, 200);
    assert_eq!(ask(format!("GET / HTTP/1.1\r\nHost: evil.example:{}\r\n\r\n", to.port())), 421);
    assert_eq!(ask("GET / HTTP/1.1\r\n\r\n".to_owned()), 421);
    assert_eq!(ask(format!("GET /api/v1/status HTTP/1.1\r\n{host}Origin: http://evil.example\r\n\r\n")), 421);
    for method in ["POST", "PUT", "DELETE", "PATCH", "OPTIONS"] {
        let request = format!("{method} /api/v1/status HTTP/1.1\r\n{host}Content-Length: 3\r\n\r\nabc");
        assert_eq!(ask(request), 405, "{method}");
    }
    for path in
        ["/../../etc/passwd", "/%2e%2e/etc/passwd", "//etc/passwd", "/page.js/..", "/api/v1/", "/nothing"]
    {
        assert_eq!(get(to, path).0, 404, "{path}");
    }
    assert_eq!(get(to, "/api/v1/events?after=-1").0, 400);
    assert_eq!(get(to, &format!("/{}", "a".repeat(5000))).0, 404);
    // Too long, too many lines, no HTTP.
    assert!([414, 431].contains(&ask(format!("GET /{} HTTP/1.1\r\n{host}\r\n", "a".repeat(100_000)))));
    assert_eq!(ask(format!("GET / HTTP/1.1\r\n{host}{}\r\n", "A: b\r\n".repeat(200))), 431);
    assert_eq!(ask("\u{1}\u{2}nonsense\r\n\r\n".to_owned()), 400);
    // What is told, and to whom: nothing is to be run, or shown elsewhere.
    let answer = exchange(to, format!("GET / HTTP/1.1\r\n{host}\r\n").as_bytes());
    for line in ["default-src 'none'", "x-frame-options: DENY", "x-content-type-options: nosniff"] {
        assert!(answer.contains(line), "{answer}");
    }
    assert!(!answer.contains("access-control-allow-origin"));
    assert!(!answer.contains("http://") && !answer.contains("https://"), "nothing from elsewhere");
    let api = json(to, "/api/v1/openapi.json");
    let paths: Vec<&String> = api["paths"].as_object().unwrap().keys().collect();
    assert_eq!(paths, ["/api/v1/events", "/api/v1/status", "/api/v1/track"]);
    assert!(api["components"]["schemas"]["StatusView"]["properties"]["mode"].is_object(), "{api}");
    let (_, text) = get(to, "/metrics");
    for outcome in ["foreign\"} 3.0", "served\"} "] {
        assert!(text.contains(&format!("holdover_requests_total{{outcome=\"{outcome}")), "{text}");
    }
    assert!(!text.contains("unknown\"} 0.0") && !text.contains("dropped\"} 0.0"), "{text}");

    // Somebody else's port: said, and nothing is begun.
    let listen = format!("status.listen={to}");
    let mut second = Holdover::run(&["--endpoint", "udpin:127.0.0.1:0", "--set", &listen]);
    assert_eq!(second.exit(Duration::from_secs(20)).code(), Some(5));
    second.wait_for("status.listen: another program listens at", 1);
    holdover.stop();
}

#[tokio::test]
async fn viewers_that_stall_and_thousands_of_requests_are_not_felt_by_the_navigation() {
    let mut flown = Flown::begin(100.0, &["--set", "outbound.publish=always"]).await;
    let to = page(&flown.holdover);
    // Viewers that ask and never read, connections that say nothing, and heads that never end.
    let stalled: Vec<TcpStream> = (0..100)
        .map(|n| {
            let mut stream = TcpStream::connect(to).unwrap();
            let text = match n % 3 {
                0 => format!("GET /api/v1/stream HTTP/1.1\r\nHost: {to}\r\n\r\n"),
                1 => String::new(),
                _ => "GET / HTTP/1.1\r\nA: ".to_owned(),
            };
            // The hundredth may have been closed already.
            let _ = stream.write_all(text.as_bytes());
            stream
        })
        .collect();
    let asking = tokio::task::spawn_blocking(move || {
        (0..1000)
            .filter(|_| {
                let mut stream = TcpStream::connect(to).unwrap();
                stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
                let _ =
                    stream.write_all(format!("GET /api/v1/status HTTP/1.1\r\nHost: {to}\r\n\r\n").as_bytes());
                let mut answer = Vec::new();
                let _ = stream.read_to_end(&mut answer);
                answer.starts_with(b"HTTP/1.1 200")
            })
            .count()
    });
    flown.fly(0.0, 100.0).await;
    asking.await.unwrap();
    let times = flown.heard.odometry();
    // Thirty a second of the flight, once it is aligned.
    let between: Vec<u64> = times.windows(2).map(|w| w[1] - w[0]).collect();
    assert!(times.len() > 2000, "{}", times.len());
    assert!(between.iter().all(|us| *us < 200_000), "{:?}", between.iter().max());
    drop(stalled);
    // And who asks then is answered.
    let mut answered = 0;
    for _ in 0..200 {
        answered = u16::from(
            exchange(to, format!("GET / HTTP/1.1\r\nHost: {to}\r\n\r\n").as_bytes()).contains(" 200 "),
        );
        if answered == 1 {
            break;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    assert_eq!(answered, 1);
    flown.holdover.stop();
}
