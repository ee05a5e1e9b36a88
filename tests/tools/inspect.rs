//! What `inspect` says of a log's sensors.

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::command::{COPTER, bytes_of, holdover, records, sitl_log, write_log};

fn inspect(path: &Path) -> Value {
    holdover(&["inspect", path.to_str().unwrap(), "--json"]).json()
}

fn sensor<'a>(report: &'a Value, name: &str) -> &'a Value {
    report["sensors"].as_array().unwrap().iter().find(|s| s["sensor"] == name).unwrap()
}

/// GPS_RAW_INT.
const GNSS: u32 = 24;

#[test]
fn how_late_gnss_is_is_found_and_also_how_early() {
    let folder = tempfile::tempdir().unwrap();
    let flight = records(COPTER, 0.0, 144.0);
    let mut late_s = Vec::new();
    for shift_us in [0i64, -300_000] {
        let mut shifted = flight.clone();
        for r in shifted.iter_mut().filter(|r| r.id() == GNSS) {
            // Its stamp, in microseconds since boot, stands first.
            let at = r.payload().start;
            let us = i64::from_le_bytes(r.frame[at..at + 8].try_into().unwrap());
            r.frame[at..at + 8].copy_from_slice(&(us + shift_us).max(0).to_le_bytes());
            r.seal();
        }
        let path = write_log(folder.path(), "shifted.tlog", &bytes_of(&shifted));
        let report = inspect(&path);
        late_s.push(sensor(&report, "GNSS")["lag"]["late_s"].as_f64().unwrap());
        let text = holdover(&["inspect", path.to_str().unwrap()]).out;
        let how = if shift_us < 0 { "ahead of the IMU" } else { "behind the IMU" };
        assert!(text.contains(how), "{text}");
    }
    // A stamp that is 0.3 s older makes the fix 0.3 s earlier.
    assert!((late_s[0] - late_s[1] - 0.3).abs() < 0.05, "{late_s:?}");
    assert!((0.0..0.2).contains(&late_s[0]), "{late_s:?}");
}

#[test]
fn a_receiver_without_a_fix_is_not_gnss_that_can_be_used() {
    let folder = tempfile::tempdir().unwrap();
    let mut never = records(COPTER, 0.0, 60.0);
    for r in never.iter_mut().filter(|r| r.id() == GNSS) {
        // Zeros at a frame's end are not sent: then it tells of no fix already.
        let at = r.payload().start + 28;
        if r.payload().contains(&at) {
            r.frame[at] = 1;
            r.seal();
        }
    }
    never.retain(|r| !matches!(r.id(), 100 | 106));
    let path = write_log(folder.path(), "never.tlog", &bytes_of(&never));
    let report = inspect(&path);
    let lacks = report["lacks"].as_str().unwrap();
    assert!(
        lacks.contains("no GNSS fix") && !lacks.split("it holds").nth(1).unwrap().contains("GNSS"),
        "{lacks}"
    );
    assert!(sensor(&report, "GNSS")["remarks"][0].as_str().unwrap().contains("never a fix"), "{report}");
    assert_eq!(report["outlook"], Value::Null);
}

#[test]
fn what_is_expected_without_gnss_was_measured_and_what_never_aligns_says_so() {
    let report = inspect(&sitl_log(COPTER));
    assert!(report["outlook"]["aligned_at_s"].as_f64().unwrap() < 30.0, "{}", report["outlook"]);
    let expected = report["outlook"]["expected"].as_array().unwrap();
    let minute = expected.iter().find(|e| e["carried_by"] == "optical flow" && e["after_s"] == 60.0).unwrap();
    assert!((0.5..10.0).contains(&minute["error_m"].as_f64().unwrap()), "{minute}");
    // The simulator's rangefinder tells what lies beyond its range.
    assert!(sensor(&report, "rangefinder")["beyond_limits"].as_f64().unwrap() > 100.0);
    // On the ground, and over before it can align.
    let folder = tempfile::tempdir().unwrap();
    let path = write_log(folder.path(), "short.tlog", &bytes_of(&records(COPTER, 0.0, 12.0)));
    let short = inspect(&path);
    assert_eq!(short["outlook"]["aligned_at_s"], Value::Null);
    assert!(short["outlook"]["waiting_for"].as_str().is_some());
    let text = holdover(&["inspect", path.to_str().unwrap()]).out;
    assert!(text.contains("it never aligns"), "{text}");
    fs::remove_file(path).unwrap();
}

/// ESC_TELEMETRY_1_TO_4 and EXTENDED_SYS_STATE.
const ESC: u32 = 11_030;
const LANDED: u32 = 245;

#[test]
fn flights_and_rotors_are_told_where_the_log_tells_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let mut flight = records(COPTER, 0.0, 120.0);
    assert!(flight.iter().any(|r| r.id() == LANDED));
    let path = write_log(folder.path(), "flight.tlog", &bytes_of(&flight));
    let report = inspect(&path);
    let period = |report: &Value, what: &str| {
        let all = report[what].as_array().unwrap();
        assert_eq!(all.len(), 1, "{report}");
        (all[0]["from_s"].as_f64().unwrap(), all[0]["to_s"].as_f64().unwrap())
    };
    let (armed, in_air) = (period(&report, "armed"), period(&report, "in_air"));
    // It takes off some seconds after it is armed, and the log ends in the air.
    assert!(armed.0 + 1.0 < in_air.0 && in_air.0 < armed.0 + 10.0, "{armed:?} {in_air:?}");
    assert!(in_air.1 > 118.0 && report["vibration"]["rotors"].is_null());
    let text = holdover(&["inspect", path.to_str().unwrap()]).out;
    assert!(text.contains("in the air, as it says itself, from") && !text.contains("Vibration"), "{text}");
    // Without that message nothing is said of it.
    flight.retain(|r| r.id() != LANDED && r.id() != ESC);
    let silent = inspect(&write_log(folder.path(), "silent.tlog", &bytes_of(&flight)));
    assert_eq!(silent["in_air"].as_array().unwrap().len(), 0);
    assert_eq!(period(&silent, "armed"), armed);
}
