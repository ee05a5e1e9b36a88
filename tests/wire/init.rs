//! `holdover init` on a serial cable and on UDP with recorded flights, and the daemon with what it has written.

use std::fs;
use std::os::fd::AsFd;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::Arc;
use std::time::Duration;

use nix::sys::termios::{BaudRate, cfgetospeed, tcgetattr};
use tokio::io::AsyncWriteExt;
use tokio::net::UdpSocket;
use tokio::task::spawn_blocking;
use tokio::time::sleep;

use crate::live::flight::Flight;
use crate::live::process::Holdover;
use crate::live::terminal::plug_in;

/// Runs it while other tasks go on.
async fn init(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_holdover"));
    command.arg("init").args(arguments).args(["--listen-s", "6"]).stdin(Stdio::null());
    spawn_blocking(move || command.output().unwrap()).await.unwrap()
}

fn told(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

/// The daemon, as it is started with that configuration, hears the vehicle.
async fn daemon_with(config: &Path) -> Holdover {
    let config = config.to_str().unwrap().to_owned();
    spawn_blocking(move || {
        let daemon = Holdover::run(&["--config", &config]);
        daemon.wait_for("PX4", 1);
        daemon
    })
    .await
    .unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_baud_rate_of_a_cable_is_found_and_the_daemon_runs_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let (port, out) = (folder.path().join("autopilot"), folder.path().join("holdover.toml"));
    let (mut cable, device) = plug_in(&port);
    let flight = Flight::load("px4-quad-gps-loss", 60.0);
    let playing = tokio::spawn(async move {
        // At any other rate than the drone's a UART reads noise.
        loop {
            flight
                .play(20.0, 60.0, 1.0, async |bytes| {
                    let speed = tcgetattr(device.as_fd()).map(|settings| cfgetospeed(&settings));
                    let sound = speed == Ok(BaudRate::B921600);
                    let noise: Vec<u8> =
                        bytes.iter().map(|b| if sound { *b } else { b.rotate_left(3) ^ 0x55 }).collect();
                    // What nobody reads is lost.
                    let _ = tokio::time::timeout(Duration::from_millis(50), cable.write_all(&noise)).await;
                })
                .await;
        }
    });
    let endpoint = format!("serial:{}:auto", port.display());
    let output = init(&["--endpoint", &endpoint, "--out", out.to_str().unwrap()]).await;
    let all = told(&output);
    assert_eq!(output.status.code(), Some(0), "{all}");
    let found = format!("serial:{}:921600", port.display());
    for text in [
        &found[..],
        "PX4 of unknown version, quadrotor, system 1",
        "answers no question for a parameter",
        "HIGHRES_IMU",
    ] {
        assert!(all.contains(text), "no \"{text}\" in {all}");
    }
    let text = fs::read_to_string(&out).unwrap();
    assert!(text.contains(&format!("endpoints = [\"{found}\"]")), "{text}");
    assert!(!text.contains("imu_hz"), "the line has room for everything: {text}");
    let mut daemon = daemon_with(&out).await;
    daemon.stop();
    playing.abort();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_daemon_runs_with_what_was_written_for_udp() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("holdover.toml");
    let drone = Arc::new(UdpSocket::bind("127.0.0.1:0").await.unwrap());
    let endpoint = format!("udpout:{}", drone.local_addr().unwrap());
    let flight = Flight::load("px4-quad-gps-loss", 60.0);
    let sending = tokio::spawn(async move {
        let mut buffer = [0; 2000];
        loop {
            // Whoever spoke last is answered.
            let Ok((_, mut peer)) = drone.recv_from(&mut buffer).await else { continue };
            flight
                .play(20.0, 60.0, 1.0, async |bytes| {
                    while let Ok((_, from)) = drone.try_recv_from(&mut buffer) {
                        peer = from;
                    }
                    let _ = drone.send_to(bytes, peer).await;
                })
                .await;
        }
    });
    let output = init(&["--endpoint", &endpoint, "--out", out.to_str().unwrap()]).await;
    assert_eq!(output.status.code(), Some(0), "{}", told(&output));
    let mut daemon = daemon_with(&out).await;
    daemon.stop();
    sending.abort();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_silent_cable_is_told_of_with_what_to_look_at() {
    let folder = tempfile::tempdir().unwrap();
    let port = folder.path().join("autopilot");
    let out = folder.path().join("holdover.toml");
    let (mut cable, device) = plug_in(&port);
    let name = port.display().to_string();
    let arguments = ["--device", &name, "--out", out.to_str().unwrap()];
    let output = init(&arguments).await;
    let all = told(&output);
    assert_eq!(output.status.code(), Some(5), "{all}");
    for text in [&name[..], "not a byte at 57600, 115200, 921600", "SERIALn_PROTOCOL = 2", "has it open, too"]
    {
        assert!(all.contains(text), "no \"{text}\" in {all}");
    }
    // A console.
    let talking = tokio::spawn(async move {
        loop {
            let _ = tokio::time::timeout(Duration::from_millis(50), cable.write_all(b"login: ")).await;
            sleep(Duration::from_millis(50)).await;
        }
    });
    let output = init(&arguments).await;
    let all = told(&output);
    assert_eq!(output.status.code(), Some(5), "{all}");
    assert!(all.contains("bytes, and no frame of MAVLink at 57600") && !out.exists(), "{all}");
    talking.abort();
    drop(device);
}
