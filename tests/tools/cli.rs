//! The `holdover` command as a stranger uses it: every mistake has its exit code and a message that says what to do, and no
//! log makes it panic.

use std::collections::BTreeSet;
use std::fs;
use std::process::{Command, Stdio};

use crate::command::{COPTER, PX4, Ran, bytes_of, holdover, holdover_with, records, sitl_log, write_log};
use serde_json::Value;
use tempfile::{TempDir, tempdir};

fn folder() -> TempDir {
    tempdir().unwrap()
}

fn replay_json(path: &std::path::Path, more: &[&str]) -> Value {
    replay(path, &[&["--json"], more].concat()).json()
}

fn replay(path: &std::path::Path, more: &[&str]) -> Ran {
    let mut arguments = vec!["replay", path.to_str().unwrap()];
    arguments.extend(more);
    holdover(&arguments)
}

fn modes(report: &Value) -> Vec<&str> {
    report["modes"].as_array().unwrap().iter().map(|m| m["mode"].as_str().unwrap()).collect()
}

#[test]
fn a_path_that_is_no_log_is_named_with_what_it_is() {
    let d = folder();
    let file = |name: &str, bytes: &[u8]| write_log(d.path(), name, bytes);
    let empty = d.path().join("folder");
    std::fs::create_dir(&empty).unwrap();
    let cases: &[(std::path::PathBuf, &str)] = &[
        (d.path().join("nothing.tlog"), "nothing.tlog"),
        (empty, "directory without a log"),
        (file("empty.tlog", b""), "empty"),
        (file("notes.tlog", b"dear diary, today the drone flew well\n"), "text file"),
        (file("flight.ulg", b"ULog\x01\x12\x35\x01and more that is binary \x00\x01\x02"), "ULog"),
        (file("flight.bin", b"\xA3\x95\x80\x80\x59FMT\x00BBnNZ and more\x00"), "DataFlash"),
        (file("noise.tlog", &[0x55; 4096]), "noise.tlog"),
    ];
    for command in ["replay", "inspect", "evaluate"] {
        for (path, word) in cases {
            let name = path.file_name().unwrap().to_str().unwrap();
            holdover(&[command, path.to_str().unwrap()]).fails(3, &[name, word]);
        }
    }
}

#[test]
fn a_log_cut_anywhere_is_read_to_its_end() {
    let d = folder();
    let bytes = bytes_of(&records(COPTER, 0.0, 40.0));
    let whole = replay_json(&write_log(d.path(), "whole.tlog", &bytes), &[]);
    assert_eq!(whole["skipped_bytes"], 0);
    for cut in [1, 7, 9, 23, 31] {
        let report = replay_json(&write_log(d.path(), "cut.tlog", &bytes[..bytes.len() - cut]), &[]);
        assert!(report["frames"].as_u64() < whole["frames"].as_u64());
        assert!(report["frames"].as_u64().unwrap() + 3 >= whole["frames"].as_u64().unwrap());
    }
    let text = replay(&d.path().join("cut.tlog"), &[]);
    assert!(text.out.contains("ends in the middle of a record"), "{}", text.out);
}

#[test]
fn flipped_bytes_cost_frames_and_are_counted() {
    let d = folder();
    let good = bytes_of(&records(COPTER, 0.0, 60.0));
    let whole = replay_json(&write_log(d.path(), "good.tlog", &good), &[]);
    let mut bytes = good;
    let (mut at, mut flips) = (1000, 0);
    while at < bytes.len() {
        bytes[at] ^= 1 << (flips % 8);
        flips += 1;
        at += 4001;
    }
    let report = replay_json(&write_log(d.path(), "bad.tlog", &bytes), &[]);
    let (before, after) = (whole["frames"].as_u64().unwrap(), report["frames"].as_u64().unwrap());
    assert!(after < before && before - after <= 3 * flips, "{before} {after} {flips}");
    assert!(report["bad_crc"].as_u64().unwrap() > flips / 2, "{report}");
    assert!(modes(&report).contains(&"Aided"));
}

#[test]
fn a_log_without_an_imu_says_what_it_holds_and_what_is_needed() {
    let d = folder();
    let mut kept = records(COPTER, 0.0, 60.0);
    kept.retain(|r| !matches!(r.id(), 26 | 27 | 105 | 116 | 129));
    let path = write_log(d.path(), "no-imu.tlog", &bytes_of(&kept));
    replay(&path, &["--json"]).fails(4, &["no-imu.tlog", "no IMU", "GNSS", "optical flow", "HIGHRES_IMU"]);
    let report = holdover(&["inspect", path.to_str().unwrap(), "--json"]).json();
    assert!(report["lacks"].as_str().unwrap().contains("no IMU"));
    let text = holdover(&["inspect", path.to_str().unwrap()]);
    assert!(text.code == Some(0) && text.out.contains("nothing: no IMU"), "{}", text.out);
}

#[test]
fn the_first_of_two_vehicles_is_followed_and_the_other_counted() {
    let d = folder();
    let one = records(COPTER, 0.0, 70.0);
    let alone = replay_json(&write_log(d.path(), "one.tlog", &bytes_of(&one)), &[]);
    let mut two = Vec::new();
    for r in &one {
        let mut other = r.clone();
        other.set_system(2);
        two.extend([r.clone(), other]);
    }
    let path = write_log(d.path(), "two.tlog", &bytes_of(&two));
    let both = replay_json(&path, &[]);
    assert_eq!(both["frames"].as_u64(), alone["frames"].as_u64().map(|n| 2 * n));
    assert_eq!(both["aided"], alone["aided"]);
    assert_eq!(both["modes"], alone["modes"]);
    let text = replay(&path, &[]).out;
    assert!(text.contains(&format!("{} wrong system", one.len())) && text.contains("(system 1)"), "{text}");
    let text = replay(&path, &["--set", "vehicle.system_id=2"]).out;
    assert!(text.contains("(system 2)"), "{text}");
    replay(&path, &["--set", "vehicle.system_id=9"]).fails(3, &["system id 9", "heard"]);
}

#[test]
fn a_reboot_in_the_middle_is_survived() {
    let d = folder();
    let mut pieces = records(COPTER, 60.0, 100.0);
    pieces.extend(records(COPTER, 5.0, 60.0));
    let path = write_log(d.path(), "reboot.tlog", &bytes_of(&pieces));
    let report = replay_json(&path, &[]);
    let aided = modes(&report).iter().filter(|m| **m == "Aided").count();
    assert_eq!(aided, 2, "{report}");
    let duration = report["duration_s"].as_f64().unwrap();
    assert!((90.0..100.0).contains(&duration), "{duration}");
    let mut last = 0.0;
    for m in report["modes"].as_array().unwrap() {
        let t = m["t_s"].as_f64().unwrap();
        assert!(t >= last, "{report}");
        last = t;
    }
    let text = replay(&path, &[]).out;
    assert!(text.contains("rebooted 1 times"), "{text}");
}

#[test]
fn values_that_cannot_be_are_counted_and_never_reach_the_solution() {
    let d = folder();
    let values = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 3e38, -3e38, 1e9, f32::MIN_POSITIVE, -0.0];
    for (name, ids) in [(COPTER, [105, 24, 29, 100, 132, 108]), (PX4, [105, 24, 29, 115, 132, 32])] {
        let mut log = records(name, 0.0, 120.0);
        let (mut n, mut hit) = (0usize, 0);
        for r in log.iter_mut().filter(|r| ids.contains(&r.id())) {
            n += 1;
            // Let it find its feet; then one frame in ten has one wild word, which goes through all fields and all values.
            if n < 3000 || !n.is_multiple_of(10) {
                continue;
            }
            let payload = r.payload();
            let words = payload.len() / 4;
            let at = payload.start + 4 * ((n / 10) % words);
            r.frame[at..at + 4].copy_from_slice(&values[(n / 10 / words) % values.len()].to_le_bytes());
            r.seal();
            hit += 1;
        }
        assert!(hit > 500);
        let path = write_log(d.path(), "wild.tlog", &bytes_of(&log));
        let out = d.path().join("out");
        let report = replay_json(&path, &["--outage", "90..110", "--force", "--out", out.to_str().unwrap()]);
        assert!(modes(&report).contains(&"Aided"), "{report}");
        let text = replay(&path, &[]).out;
        assert!(text.contains("not finite") && text.contains("absurd"), "{text}");
        let csv = fs::read_to_string(out.join("solution.csv")).unwrap();
        assert!(csv.lines().count() > 1000);
        for line in csv.lines() {
            assert!(!line.contains("NaN") && !line.contains("inf"), "{line}");
        }
    }
}

#[test]
fn mistakes_on_the_command_line_are_explained() {
    let log = sitl_log(COPTER);
    for wrong in ["5", "5..", "..5", "9..3", "3..3", "-1..4", "a..b", "1..inf", "nan..2"] {
        let ran = replay(&log, &[&format!("--outage={wrong}")]);
        ran.fails(2, &["--outage", "A..B"]);
    }
    replay(&log, &["--estimator", "magic"]).fails(2, &["magic", "shipped", "inertial"]);
    let log = log.to_str().unwrap();
    holdover(&["evaluate", log, "--lengths", "0"]).fails(2, &["--lengths"]);
    holdover(&["evaluate", log, "--lengths", "nan"]).fails(2, &["--lengths"]);
    holdover(&["evaluate", log, "--starts", "0"]).fails(2, &["--starts"]);
    holdover(&["evaluate", log, "--estimator", "shipped,magic"]).fails(2, &["magic"]);
    holdover(&["fly"]).fails(2, &["fly"]);
    holdover(&["replay"]).fails(2, &["LOG"]);
    assert_eq!(holdover(&["--help"]).code, Some(0));
    assert!(holdover(&["--version"]).out.starts_with("holdover "));
}

#[test]
fn mistakes_in_the_configuration_name_the_file_and_the_key() {
    let d = folder();
    let check = |name: &str, text: &str| {
        let path = write_log(d.path(), name, text.as_bytes());
        holdover(&["check", "--config", path.to_str().unwrap()])
    };
    check("key.toml", "[outbound]\nrate = 5.0\n")
        .fails(2, &["key.toml", "outbound.rate", "outbound.rate_hz"]);
    check("section.toml", "[outbond]\nrate_hz = 5.0\n").fails(2, &["section.toml", "outbond"]);
    check("type.toml", "[outbound]\nrate_hz = \"fast\"\n")
        .fails(2, &["type.toml", "outbound.rate_hz", "number"]);
    check("value.toml", "[tuning.gnss]\nloss_s = -3.0\n")
        .fails(2, &["value.toml:2: tuning.gnss.loss_s is -3.0, out of range: 0.2 to 60"]);
    check("old.toml", "[gnss]\nloss_s = 3.0\n")
        .fails(2, &["old.toml:2: gnss.loss_s is now tuning.gnss.loss_s"]);
    check("word.toml", "[outbound]\npublish = \"maybe\"\n").fails(2, &["word.toml", "maybe", "never"]);
    check("broken.toml", "[outbound\n").fails(2, &["broken.toml"]);
    check("two.toml", "[gnss]\ndelay_ms = -3.0\n[flow]\nuse = 3\n").fails(2, &["gnss.delay_ms", "flow.use"]);
    check("end.toml", "[link]\nendpoints = [\"udp:somewhere\"]\n").fails(2, &["link.endpoints", "udpin:"]);
    check("none.toml", "[link]\nendpoints = []\n").fails(2, &["link.endpoints"]);
    holdover(&["check", "--config", "/dev/zero"]).fails(2, &["/dev/zero", "device"]);
    holdover(&["check", "--config", "no-such.toml"]).fails(2, &["no-such.toml"]);
    holdover(&["check", "--config", d.path().to_str().unwrap()]).fails(2, &[d.path().to_str().unwrap()]);
    holdover(&["check", "--set", "outbound.rate_hz=fast"]).fails(2, &["--set", "outbound.rate_hz"]);
    holdover(&["check", "--set", "nonsense"]).fails(2, &["key=value"]);
    holdover_with(&["check"], &[("HOLDOVER_OUTBOUND__RAT", "1")]).fails(2, &["environment", "outbound.rat"]);
}

#[test]
fn check_shows_what_is_in_force() {
    let d = folder();
    let path = write_log(d.path(), "mine.toml", b"[outbound]\nrate_hz = 20.0\npublish = \"never\"\n");
    let path = path.to_str().unwrap();
    let ran = holdover(&["check", "--config", path]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert!(
        ran.out.contains("valid") && ran.out.contains("at 20 Hz") && ran.out.contains("Never"),
        "{}",
        ran.out
    );
    let variables = [("HOLDOVER_OUTBOUND__RATE_HZ", "40")];
    assert!(holdover_with(&["check", "--config", path], &variables).out.contains("at 40 Hz"));
    let ran = holdover_with(&["check", "--config", path, "--set", "outbound.rate_hz=50"], &variables);
    assert!(ran.out.contains("at 50 Hz"));
    assert!(holdover(&["check"]).out.contains("udpin:127.0.0.1:14550"));
}

#[test]
fn check_shows_where_each_value_came_from() {
    let d = folder();
    let path = write_log(d.path(), "mine.toml", b"[outbound]\nrate_hz = 20.0\n[tuning.gnss]\nloss_s = 2.0\n");
    let variables = [("HOLDOVER_GNSS__DELAY_MS", "40"), ("HOLDOVER_NOISE", "1")];
    let arguments = ["check", "--config", path.to_str().unwrap(), "--set", "flow.use=false"];
    let ran = holdover_with(&arguments, &variables);
    let line = |out: &str, key: &str| {
        out.lines().find(|l| l.starts_with(key)).map(str::to_owned).unwrap_or_default()
    };
    assert!(line(&ran.out, "rate_hz").ends_with("mine.toml:2"), "{}", ran.out);
    assert!(line(&ran.out, "loss_s").ends_with("mine.toml:4"), "differs from the default: {}", ran.out);
    assert!(line(&ran.out, "delay_ms").ends_with("# environment HOLDOVER_GNSS__DELAY_MS"), "{}", ran.out);
    assert!(
        ran.out.contains("use                       = false") && ran.out.contains("# --set flow.use=false"),
        "{}",
        ran.out
    );
    assert!(!ran.out.contains("recover_s"), "tuning that nobody touched: {}", ran.out);
    assert_eq!(ran.err.matches("HOLDOVER_NOISE").count(), 1, "{}", ran.err);
    let all = holdover_with(&[&arguments[..], &["--all"]].concat(), &variables).out;
    assert!(line(&all, "recover_s").ends_with("# default"), "{all}");
    let json = holdover_with(&[&arguments[..], &["--json"]].concat(), &variables).json();
    let keys = json["keys"].as_array().unwrap();
    let entry = |key: &str| keys.iter().find(|k| k["key"] == key).unwrap();
    assert_eq!(
        (&entry("tuning.gnss.loss_s")["line"], &entry("tuning.gnss.loss_s")["source"]),
        (&4.into(), &"file".into())
    );
    assert_eq!(entry("gnss.delay_ms")["variable"], "HOLDOVER_GNSS__DELAY_MS");
    assert_eq!(
        (&entry("flow.use")["value"], &entry("flow.use")["source"]),
        (&false.into(), &"argument".into())
    );
    assert_eq!(
        (&entry("tuning.gnss.recover_s")["source"], json["warnings"].as_array().unwrap().len()),
        (&"default".into(), 1)
    );
}

#[test]
fn check_prints_the_defaults_and_the_reference() {
    let defaults = holdover(&["check", "--defaults"]).out;
    assert_eq!(defaults, include_str!("../../config/default.toml"));
    let reference = holdover(&["check", "--reference"]).out;
    assert!(
        reference.contains("### `[[cameras]]`")
            && reference.contains("| `rate_hz` | Hz | [4, 50] | `30.0` |")
    );
}

const KEYS: [&str; 16] = [
    "log",
    "duration_s",
    "events",
    "faults",
    "frames",
    "skipped_bytes",
    "bad_crc",
    "reference",
    "estimator",
    "aided",
    "outages",
    "modes",
    "repairs",
    "sources",
    "drift",
    "realtime_factor",
];
const SOURCE: [&str; 9] =
    ["kind", "id", "used", "fused", "gated", "rejected", "nis_mean", "test_ratio", "health"];
const AIDED: [&str; 6] = [
    "position_rmse_m",
    "velocity_rmse_mps",
    "roll_rmse_deg",
    "pitch_rmse_deg",
    "yaw_rmse_deg",
    "altitude_rmse_m",
];
const OUTAGE: [&str; 11] = [
    "start_s",
    "end_s",
    "distance_m",
    "horizontal_error_end_m",
    "horizontal_error_max_m",
    "drift_percent",
    "altitude_rmse_m",
    "sigma_end_m",
    "worst_sigmas",
    "lost_at_s",
    "sent_messages",
];

fn has_keys(value: &Value, keys: &[&str]) {
    let found: BTreeSet<&str> = value.as_object().unwrap().keys().map(String::as_str).collect();
    assert_eq!(found, keys.iter().copied().collect::<BTreeSet<_>>());
}

#[test]
fn the_json_of_replay_has_every_key_and_numbers_that_can_be() {
    let d = folder();
    let path = write_log(d.path(), "a.tlog", &bytes_of(&records(COPTER, 0.0, 120.0)));
    let report = replay_json(&path, &["--outage", "80..110", "--outage", "500..600"]);
    has_keys(&report, &KEYS);
    has_keys(&report["aided"], &AIDED);
    let outages = report["outages"].as_array().unwrap();
    assert_eq!(outages.len(), 2);
    outages.iter().for_each(|o| has_keys(o, &OUTAGE));
    let sources = report["sources"].as_array().unwrap();
    sources.iter().for_each(|s| has_keys(s, &SOURCE));
    let of = |kind: &str| sources.iter().find(|s| s["kind"] == kind).unwrap();
    assert!(of("gnss")["fused"].as_u64().unwrap() > 500, "{}", of("gnss"));
    assert_eq!((&of("gnss")["health"], &of("drag")["health"]), (&"healthy".into(), &"healthy".into()));
    assert!(of("flow")["rejected"]["no height over ground"].as_u64().unwrap() > 0, "{}", of("flow"));
    assert!((0.0..3.0).contains(&of("flow")["nis_mean"].as_f64().unwrap()));
    assert_eq!(report["reference"], "truth");
    assert_eq!(report["estimator"], "shipped");
    let o = &outages[0];
    assert!((30.0..400.0).contains(&o["distance_m"].as_f64().unwrap()), "{o}");
    assert!(o["horizontal_error_end_m"].as_f64().unwrap() <= o["horizontal_error_max_m"].as_f64().unwrap());
    assert!(o["sent_messages"].as_u64().unwrap() > 500, "{o}");
    // The second lies beyond the log: nothing is known of it, which is not zero.
    for key in &OUTAGE[2..8] {
        assert_eq!(outages[1][key], Value::Null, "{key}");
    }
    assert_eq!(&modes(&report)[..2], ["Aided", "Holdover"]);
    let aided = report["aided"]["position_rmse_m"].as_f64().unwrap();
    assert!((0.01..3.0).contains(&aided), "{aided}");
    let inertial = replay_json(&path, &["--outage", "80..110", "--estimator", "inertial"]);
    assert_eq!(inertial["estimator"], "inertial");
    assert_ne!(inertial["outages"][0]["horizontal_error_end_m"], o["horizontal_error_end_m"]);
}

#[test]
fn the_same_log_twice_gives_the_same_bytes() {
    let d = folder();
    let path = write_log(d.path(), "a.tlog", &bytes_of(&records(PX4, 0.0, 100.0)));
    let run = |out: &str| {
        let out = d.path().join(out);
        let ran = replay(&path, &["--json", "--outage", "60..90", "--out", out.to_str().unwrap()]);
        let (head, tail) = ran.out.split_once("\"realtime_factor\":").unwrap();
        let rest = tail.trim_start_matches(|c: char| c.is_ascii_digit() || ".eE+-".contains(c)).to_owned();
        (head.to_owned(), rest, fs::read(out.join("solution.csv")).unwrap())
    };
    let (first, second) = (run("first"), run("second"));
    assert!(first == second);
    assert_eq!(first.1.trim_end(), "}");
    assert!(first.2.len() > 10_000);
}

#[test]
fn inspect_tells_what_is_in_a_log() {
    let log = sitl_log(PX4);
    let text = holdover(&["inspect", log.to_str().unwrap()]);
    assert_eq!(text.code, Some(0));
    for word in ["PX4 (system 1)", "IMU", "HIGHRES_IMU", "no optical flow", "simulator's truth"] {
        assert!(text.out.contains(word), "no \"{word}\" in {}", text.out);
    }
    let report = holdover(&["inspect", log.to_str().unwrap(), "--json"]).json();
    assert_eq!(report["autopilot"], "PX4");
    assert_eq!(report["lacks"], Value::Null);
    assert_eq!(report["truth"], true);
    let samples = report["samples"].as_array().unwrap();
    let imu = samples.iter().find(|s| s["kind"] == "IMU").unwrap();
    assert!((100.0..130.0).contains(&imu["rate_hz"].as_f64().unwrap()));
}

#[test]
fn evaluate_prints_one_row_an_outage() {
    let log = sitl_log(COPTER);
    let arguments = ["evaluate", log.to_str().unwrap(), "--lengths", "20", "--starts", "3", "--json"];
    let report = holdover(&arguments).json();
    let rows = report["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 6, "two estimators, three starts");
    let keys = [
        "log",
        "estimator",
        "length_s",
        "start_s",
        "distance_m",
        "start_error_m",
        "horizontal_error_end_m",
        "horizontal_error_max_m",
        "drift_percent",
        "altitude_rmse_m",
        "sigma_end_m",
    ];
    rows.iter().for_each(|r| has_keys(r, &keys));
    assert_eq!(holdover(&arguments).json(), report, "whatever the threads did");
    let text = holdover(&arguments[..6]).out;
    assert!(text.contains("shipped") && text.contains("inertial") && text.contains("drift %"), "{text}");
}

#[test]
fn who_wants_more_is_told_more_and_who_wants_quiet_has_quiet() {
    let log = sitl_log(COPTER);
    let log = log.to_str().unwrap();
    let inspect =
        |more: &[&str]| holdover(&[&["inspect", log, "--set", "holdover.max_sigma_m=31.0"], more].concat());
    let (plain, more, quiet) = (inspect(&[]), inspect(&["-v"]), inspect(&["-q"]));
    assert_eq!((plain.code, &plain.err[..], &quiet.err[..]), (Some(0), "", ""));
    assert!(more.out == plain.out && quiet.out == plain.out);
    assert!(more.err.contains("holdover.max_sigma_m = 31.0, by --set"), "{}", more.err);
    assert!(more.err.contains("MAVLink tlog") && more.err.contains("ArduPilot of system 1"), "{}", more.err);
    // What goes wrong is told whoever wants quiet; and nobody can have both.
    let wrong = holdover(&["-q", "inspect", "/no/such.tlog"]);
    assert!(wrong.code == Some(3) && wrong.err.contains("/no/such.tlog"), "{}", wrong.err);
    assert_eq!(inspect(&["-q", "-v"]).code, Some(2));
}

#[test]
fn a_reader_that_has_seen_enough_is_no_panic() {
    let log = sitl_log(COPTER);
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_holdover"))
        .args(["inspect", log.to_str().unwrap()])
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    let err = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{err}");
    assert!(err.is_empty(), "{err}");
}

/// The command with these as its standard output and error; its exit code, and what it told where that can be read.
fn written_to(arguments: &[&str], out: Stdio, err: Stdio) -> (Option<i32>, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_holdover"))
        .args(arguments)
        // Worth a word on standard error, whatever the command.
        .env("HOLDOVER_NO_SUCH", "1")
        .stdin(Stdio::null())
        .stdout(out)
        .stderr(err)
        .output()
        .unwrap();
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn every_command_survives_a_closed_and_a_full_output() {
    let full = || Stdio::from(fs::OpenOptions::new().write(true).open("/dev/full").unwrap());
    let closed = || {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        Stdio::from(writer)
    };
    let log = sitl_log(COPTER);
    let log = log.to_str().unwrap();
    let commands: &[&[&str]] = &[
        &["check", "--all"],
        &["check", "--json"],
        &["check", "--defaults"],
        &["inspect", log],
        &["replay", log, "--json"],
        &["evaluate", log, "--lengths", "20", "--starts", "1"],
        &["stress", log, "--starts", "1", "--length", "20", "--fault", "flow:zero@5..15"],
        &["run", "--dry-run"],
    ];
    for arguments in commands {
        let (code, told) = written_to(arguments, full(), Stdio::piped());
        assert_eq!(code, Some(1), "{arguments:?}: {told}");
        assert!(told.contains("standard output: No space left"), "{arguments:?}: {told}");
        assert_eq!(written_to(arguments, closed(), Stdio::piped()).0, Some(0), "{arguments:?}");
    }
    for stderr in [full, closed] {
        assert_eq!(written_to(&["check"], Stdio::null(), stderr()).0, Some(0));
        assert_eq!(written_to(&["inspect", log], Stdio::null(), stderr()).0, Some(0));
        assert_eq!(written_to(&["inspect", "nothing.tlog"], Stdio::null(), stderr()).0, Some(3));
        assert_eq!(written_to(&["check", "--set", "no.such=1"], Stdio::null(), stderr()).0, Some(2));
    }
}
