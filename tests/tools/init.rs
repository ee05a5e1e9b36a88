//! `holdover init` against stand-ins over UDP: what it says, what it writes, and how it ends.

use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::net::UdpSocket;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use holdover::wire::session::identity::AutopilotKind;
use nix::fcntl::OFlag;
use nix::pty::{grantpt, posix_openpt, ptsname_r, unlockpt};
use serde_json::{Value, json};

use crate::command::{Ran, holdover};
use crate::stand_in::{INT8, INT32, REAL32, StandIn};

fn ardupilot() -> StandIn {
    StandIn::new(AutopilotKind::ArduPilot, &[("VISO_TYPE", 0.0, INT8), ("EK3_ENABLE", 1.0, INT8)])
}

fn px4() -> StandIn {
    StandIn::new(
        AutopilotKind::Px4,
        &[("EKF2_EV_CTRL", 7.0, INT32), ("EKF2_EV_DELAY", 0.0, REAL32), ("SYS_HAS_MAG", 1.0, INT32)],
    )
}

/// A folder, and the configuration that is to be in it.
fn place() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("holdover.toml");
    (folder, path)
}

fn init(out: &Path, more: &[&str]) -> Ran {
    holdover(&[&["init", "--out", out.to_str().unwrap(), "--listen-s", "6"], more].concat())
}

/// What a configuration differs by from the defaults.
fn differs(config: &Path) -> Value {
    let report = holdover(&["check", "--json", "--config", config.to_str().unwrap()]).json();
    let keys = report["keys"].as_array().unwrap().iter().filter(|k| k["source"] == "file");
    keys.map(|k| (k["key"].as_str().unwrap().to_owned(), k["value"].clone())).collect()
}

#[test]
fn an_ardupilot_is_described_and_its_configuration_written() {
    let running = ardupilot().start();
    let (folder, out) = place();
    let ran = init(&out, &["--endpoint", &running.endpoint]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    for text in [
        "ArduPilot 4.7.0, quadrotor, system 1, component 1, disarmed",
        "frames are not signed",
        "HIGHRES_IMU",
        "GPS_RAW_INT: 3D fix",
        "OPTICAL_FLOW_RAD: quality up to",
        "DISTANCE_SENSOR",
        "VISO_TYPE is 0, should be 1 (MAVLink) or 3, from the next boot on",
        "param set VISO_TYPE 1",
        "carried by optical flow",
        "holdover preflight --config",
        "--write",
    ] {
        assert!(ran.out.contains(text), "no \"{text}\" in {}", ran.out);
    }
    let told = running.told();
    assert!(told.reads > 0 && told.sets == 0, "{} reads, {} sets", told.reads, told.sets);
    // The file is what was shown, holds what differs and nothing else, and no trial of it is left.
    let text = fs::read_to_string(&out).unwrap();
    for line in text.lines() {
        assert!(ran.out.contains(line), "{line}");
    }
    let low = json!({"holdover.max_sigma_m": 30.0, "holdover.max_coast_s": 15.0, "link.endpoints": [running.endpoint]});
    assert_eq!(differs(&out), low, "{text}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    let config = out.to_str().unwrap();
    assert_eq!(holdover(&["run", "--dry-run", "--config", config]).code, Some(0));
    // What is there stays, and that is told before anybody waits.
    init(&out, &["--endpoint", &running.endpoint]).fails(2, &[config, "--force"]);
    assert_eq!(fs::read_to_string(&out).unwrap(), text);
}

#[test]
fn a_px4_is_told_as_json_and_a_file_is_overwritten_with_force() {
    let running = px4().start();
    let (_folder, out) = place();
    fs::write(&out, "old").unwrap();
    let set = ["--set", "outbound.publish=never", "--set", "vehicle.system_id=1"];
    let report =
        init(&out, &[&["--endpoint", &running.endpoint, "--json", "--force"], &set[..]].concat()).json();
    assert_eq!(report["preflight"]["autopilot"], "PX4");
    assert_eq!(report["written"], out.to_str().unwrap());
    let text = fs::read_to_string(&out).unwrap();
    assert_eq!(report["configuration"], text);
    assert_eq!(report["differs"], differs(&out), "{text}");
    assert_eq!(report["differs"]["outbound.publish"], "never");
    let sensors = report["sensors"].as_array().unwrap();
    let sensor =
        |name: &str| sensors.iter().find(|s| s["sensor"] == name).unwrap_or_else(|| panic!("{name}"));
    assert_eq!(sensor("IMU")["grade"], "good");
    assert_eq!(sensor("optical flow")["message"], "OPTICAL_FLOW_RAD");
    assert!(sensor("GNSS")["rate_hz"].as_f64().unwrap() > 1.0);
    assert!(report["links"][0]["frames"].as_u64().unwrap() > 100);
    assert_eq!(report["links"][0]["damaged"], 0);
}

#[test]
fn of_two_vehicles_it_has_to_be_said_which_is_meant() {
    let running = StandIn { company: true, flow: false, ..ardupilot() }.start();
    let (folder, out) = place();
    let endpoint = ["--endpoint", &running.endpoint];
    init(&out, &endpoint).fails(2, &["system 1, system 2", "--set vehicle.system_id=1"]);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is written");
    let ran = init(&out, &[&endpoint[..], &["--set", "vehicle.system_id=1"]].concat());
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert!(ran.out.contains("beside it: ArduPilot quadrotor (system 2)"), "{}", ran.out);
    assert!(ran.out.contains("optical flow  none"), "{}", ran.out);
    assert_eq!(differs(&out)["vehicle.system_id"], 1);
}

#[test]
fn whoever_sits_at_a_terminal_is_asked() {
    let running = StandIn { company: true, ..ardupilot() }.start();
    let (_folder, out) = place();
    let terminal = posix_openpt(OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_CLOEXEC).unwrap();
    grantpt(&terminal).unwrap();
    unlockpt(&terminal).unwrap();
    let name = ptsname_r(&terminal).unwrap();
    let open = || -> Stdio {
        let opened =
            OpenOptions::new().read(true).write(true).custom_flags(OFlag::O_NOCTTY.bits()).open(&name);
        opened.unwrap().into()
    };
    let mut child = Command::new(env!("CARGO_BIN_EXE_holdover"))
        .args(["init", "--listen-s", "6", "--endpoint", &running.endpoint, "--out"])
        .arg(&out)
        .stdin(open())
        .stderr(open())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    // Typed ahead: the first is no answer, the second is the first vehicle.
    let mut keys = File::from(std::os::fd::OwnedFd::from(terminal));
    keys.write_all(b"9\n1\n").unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert_eq!(differs(&out)["vehicle.system_id"], 1);
    let text = fs::read_to_string(&out).unwrap();
    assert!(text.contains("Vehicles of the systems 2 are heard here, too."), "{text}");
}

#[test]
fn what_was_tried_in_vain_is_told() {
    let silent = UdpSocket::bind("127.0.0.1:0").unwrap();
    let at = format!("udpout:{}", silent.local_addr().unwrap());
    let (folder, out) = place();
    init(&out, &["--endpoint", &at])
        .fails(5, &[&at, "in 6 s", "nothing came: does the autopilot, or the router, send"]);
    // A port that somebody else has: this test.
    let taken = UdpSocket::bind("0.0.0.0:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let pid = format!("(process {})", std::process::id());
    let missing = folder.path().join("ttyUSB7").display().to_string();
    let ran = init(&out, &["--port", &port, "--device", &missing]);
    ran.fails(5, &["no autopilot is heard", &format!("UDP port {port}: "), &pid, &missing, "--endpoint"]);
    let endpoint = format!("udpin:0.0.0.0:{port}");
    init(&out, &["--endpoint", &endpoint]).fails(5, &[&endpoint, &pid]);
    init(&out, &["--endpoint", "serial:"]).fails(2, &["serial:DEVICE:auto"]);
    init(&out, &["--endpoint", &at, "--set", "vehicle.system_id=1000"]).fails(2, &["vehicle.system_id"]);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is written");
}

/// A heartbeat of an ArduPilot copter, and DISTANCE_SENSOR of a sensor without one.
fn frames() -> [Vec<u8>; 2] {
    use holdover::wire::frame::{ComponentId, SystemId};
    use holdover::wire::session::Address;
    use holdover::wire::session::outgoing::FrameWriter;
    use mavlink::dialects::ardupilotmega as apm;
    use mavlink::dialects::ardupilotmega::MavMessage;
    let from = |system, component| Address { system: SystemId(system), component: ComponentId(component) };
    let status = holdover::sample::VehicleStatus::default();
    let beat = holdover::wire::encode_vehicle::heartbeat(AutopilotKind::ArduPilot, &status);
    let range = MavMessage::DISTANCE_SENSOR(apm::DISTANCE_SENSOR_DATA::DEFAULT);
    [
        FrameWriter::new(from(3, 1)).write(&beat).unwrap().to_vec(),
        FrameWriter::new(from(9, 140)).write(&range).unwrap().to_vec(),
    ]
}

#[test]
fn of_several_places_none_is_guessed() {
    let ports: Vec<u16> = {
        let free: Vec<UdpSocket> = (0..3).map(|_| UdpSocket::bind("0.0.0.0:0").unwrap()).collect();
        free.iter().map(|s| s.local_addr().unwrap().port()).collect()
    };
    let [beat, range] = frames();
    let stop = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(false));
    let (end, to) = (std::sync::Arc::clone(&stop), ports.clone());
    let speaking = std::thread::spawn(move || {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        while !end.load(std::sync::atomic::Ordering::Relaxed) {
            for (frame, port) in [(&beat, to[0]), (&beat, to[1]), (&range, to[2])] {
                let _ = socket.send_to(frame, ("127.0.0.1", port));
            }
            std::thread::sleep(std::time::Duration::from_millis(100));
        }
    });
    let (folder, out) = place();
    let list = ports.iter().map(u16::to_string).collect::<Vec<_>>().join(",");
    let ran = init(&out, &["--port", &list]);
    stop.store(true, std::sync::atomic::Ordering::Relaxed);
    speaking.join().unwrap();
    let named = |i: usize| format!("udpin:127.0.0.1:{}: ArduPilot", ports[i]);
    ran.fails(2, &["an autopilot is heard at several places", "--endpoint", &named(0), &named(1)]);
    assert!(!ran.err.contains(&format!(":{}: ", ports[2])), "a sensor is no autopilot: {}", ran.err);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}
