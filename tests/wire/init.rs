//! `holdover init` on a serial cable and on UDP with recorded flights, and the daemon with what it has written.

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use rustix::termios::tcgetattr;
use tokio::io::AsyncWriteExt;
use tokio::net::UdpSocket;
use tokio::task::spawn_blocking;
use tokio::time::{sleep, timeout};

use crate::live::flight::Flight;
use crate::live::process::Holdover;
use crate::live::terminal::plug_in;

const PX4: &str = "px4-quad-gps-loss";
/// What nobody takes for so long is lost.
const TAKEN: Duration = Duration::from_millis(50);

/// Runs it while other tasks go on.
async fn init(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_holdover"));
    command.arg("init").args(arguments).args(["--listen-s", "6"]).stdin(Stdio::null());
    spawn_blocking(move || command.output().unwrap()).await.unwrap()
}

fn told(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

/// The daemon hears the vehicle when it is started with this configuration, and ends well.
async fn daemon_runs_with(config: &Path) {
    let config = config.to_str().unwrap().to_owned();
    let run = move || {
        let mut daemon = Holdover::run(&["--config", &config]);
        daemon.wait_for("PX4", 1);
        daemon.stop();
    };
    spawn_blocking(run).await.unwrap();
}

/// What `testing` came to, while `endless` went on.
async fn beside<T>(endless: impl Future<Output = ()>, testing: impl Future<Output = T>) -> T {
    tokio::select! {
        () = endless => panic!("the other end of the link has gone"),
        came_to = testing => came_to,
    }
}

#[tokio::test]
async fn the_baud_rate_of_a_cable_is_found_and_the_daemon_runs_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let (port, out) = (folder.path().join("autopilot"), folder.path().join("holdover.toml"));
    let (mut cable, device) = plug_in(&port);
    let flight = Flight::load(PX4, 60.0);
    let flying = async {
        loop {
            let send = async |bytes: &[u8]| {
                // At any other rate than the drone's a UART reads noise.
                let sound = tcgetattr(&device).is_ok_and(|settings| settings.output_speed() == 921_600);
                let noise = |b: &u8| if sound { *b } else { b.rotate_left(3) ^ 0x55 };
                let _ = timeout(TAKEN, cable.write_all(&bytes.iter().map(noise).collect::<Vec<u8>>())).await;
            };
            flight.play(20.0, 60.0, 1.0, send).await;
        }
    };
    let testing = async {
        let endpoint = format!("serial:{}:auto", port.display());
        let output = init(&["--endpoint", &endpoint, "--out", out.to_str().unwrap()]).await;
        assert_eq!(output.status.code(), Some(0), "{}", told(&output));
        daemon_runs_with(&out).await;
        told(&output)
    };
    let all = beside(flying, testing).await;
    let found = format!("serial:{}:921600", port.display());
    let silent = "answers no question for a parameter";
    for text in [&found, "PX4 of unknown version, quadrotor, system 1", silent, "HIGHRES_IMU"] {
        assert!(all.contains(text), "no \"{text}\" in {all}");
    }
    let text = fs::read_to_string(&out).unwrap();
    assert!(text.contains(&format!("endpoints = [\"{found}\"]")), "{text}");
    assert!(!text.contains("imu_hz"), "the line has room for everything: {text}");
}

#[tokio::test]
async fn the_daemon_runs_with_what_was_written_for_udp() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("holdover.toml");
    let drone = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let endpoint = format!("udpout:{}", drone.local_addr().unwrap());
    let flight = Flight::load(PX4, 60.0);
    let flying = async {
        let mut peer = None;
        loop {
            let send = async |bytes: &[u8]| {
                // Whoever spoke last is answered.
                while let Ok((_, from)) = drone.try_recv_from(&mut [0; 2000]) {
                    peer = Some(from);
                }
                if let Some(peer) = peer {
                    let _ = drone.send_to(bytes, peer).await;
                }
            };
            flight.play(20.0, 60.0, 1.0, send).await;
        }
    };
    let testing = async {
        let output = init(&["--endpoint", &endpoint, "--out", out.to_str().unwrap()]).await;
        assert_eq!(output.status.code(), Some(0), "{}", told(&output));
        daemon_runs_with(&out).await;
    };
    beside(flying, testing).await;
    assert!(fs::read_to_string(&out).unwrap().contains(&endpoint));
}

#[tokio::test]
async fn a_cable_without_mavlink_is_told_of_with_what_to_look_at() {
    let folder = tempfile::tempdir().unwrap();
    let (port, out) = (folder.path().join("autopilot"), folder.path().join("holdover.toml"));
    let (mut cable, device) = plug_in(&port);
    let name = port.display().to_string();
    let arguments = ["--device", &name, "--out", out.to_str().unwrap()];
    let output = init(&arguments).await;
    let all = told(&output);
    assert_eq!(output.status.code(), Some(5), "{all}");
    for text in [&name, "not a byte at 57600, 115200, 921600", "SERIALn_PROTOCOL = 2", "has it open, too"] {
        assert!(all.contains(text), "no \"{text}\" in {all}");
    }
    let console = async {
        loop {
            let _ = timeout(TAKEN, cable.write_all(b"login: ")).await;
            sleep(TAKEN).await;
        }
    };
    let output = beside(console, init(&arguments)).await;
    let all = told(&output);
    assert_eq!(output.status.code(), Some(5), "{all}");
    assert!(all.contains("bytes, and no frame of MAVLink at 57600") && !out.exists(), "{all}");
    drop(device);
}
