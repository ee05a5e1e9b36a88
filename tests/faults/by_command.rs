//! `--fault` and `stress` as a stranger uses them.

use crate::command::{COPTER, holdover, sitl_log};
use serde_json::Value;
use tempfile::tempdir;

fn replay(faults: &[&str], outage: &str) -> Value {
    let log = sitl_log(COPTER);
    let mut arguments = vec!["replay", log.to_str().unwrap(), "--json", "--outage", outage];
    for fault in faults {
        arguments.extend(["--fault", fault]);
    }
    holdover(&arguments).json()
}

#[test]
fn a_fault_is_put_in_and_told_of() {
    let report = replay(&["flow:drop@275..320"], "265..325");
    assert_eq!(report["faults"][0], "flow:drop=1@275..320");
    let events = report["events"].as_array().unwrap();
    let carried = |e: &&Value| e["code"] == "carried-by" && e["t_s"].as_f64().is_some_and(|t| t > 275.0);
    assert!(events.iter().any(|e| carried(&e)), "{events:?}");
    // The same without it: the flow goes on carrying.
    let plain = replay(&[], "265..325");
    let heard = |r: &Value| {
        let flow = r["sources"].as_array().unwrap().iter().find(|s| s["kind"] == "flow").cloned();
        flow.unwrap()["used"].as_u64().unwrap()
    };
    assert!(heard(&report) + 400 < heard(&plain), "{} {}", heard(&report), heard(&plain));
    assert_eq!(plain["faults"].as_array().unwrap().len(), 0);
}

#[test]
fn the_same_faults_give_the_same_bytes() {
    let run = || {
        let mut report = replay(&["range:noise=1@200..300", "baro:drop=0.5@200..300"], "265..325");
        report.as_object_mut().unwrap().remove("realtime_factor");
        report
    };
    assert_eq!(run(), run());
}

#[test]
fn what_is_no_fault_is_refused_with_what_is() {
    let log = sitl_log(COPTER);
    let log = log.to_str().unwrap();
    for command in ["replay", "stress"] {
        holdover(&[command, log, "--fault", "sonar:zero@1..2"]).fails(2, &["sonar", "range"]);
        holdover(&[command, log, "--fault", "flow:melts@1..2"]).fails(2, &["melts", "zero"]);
    }
    holdover(&["stress", log, "--length", "0"]).fails(2, &["--length"]);
    holdover(&["stress", log, "--starts", "0"]).fails(2, &["--starts"]);
    holdover(&["stress", "no-such.tlog"]).fails(3, &["no-such.tlog"]);
}

#[test]
fn stress_sets_every_case_beside_the_flight_without_it() {
    let log = sitl_log(COPTER);
    let cases = ["--fault", "flow:drop@10..60", "--fault", "airspeed:zero@10..60"];
    let arguments = [&["stress", log.to_str().unwrap(), "--starts", "2", "--json"], &cases[..]].concat();
    let report = holdover(&arguments).json();
    let rows = report["logs"][0]["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 2);
    for row in rows {
        assert_eq!(row["outage"], true);
        // A flow that is silent is the flight without it, and that is told.
        assert_eq!(row["error_m"], row["error_without_sensor_m"]);
        assert!(row["error_without_fault_m"].as_f64().unwrap() < 10.0, "{row}");
        assert!(row["told_after_s"].as_f64().is_some_and(|t| t < 5.0), "{row}");
    }
    assert_eq!(report["logs"][0]["not_heard"][0], "airspeed:stuck=0@10..60");
    assert_eq!(report["table"].as_array().unwrap().len(), 1);
    let text = holdover(&["stress", log.to_str().unwrap(), "--starts", "1", "--fault", "flow:drop@10..60"]);
    assert!(text.out.contains("flow:drop=1@10..60"), "{}", text.out);
}

#[test]
fn a_simulated_flight_fails_by_the_same_command() {
    let d = tempdir().unwrap();
    let flown = |name: &str, fault: &[&str]| {
        let path = d.path().join(name);
        let out = path.to_str().unwrap().to_owned();
        let arguments = [&["simulate", "square", "--duration", "60", "--out", &out], fault].concat();
        assert_eq!(holdover(&arguments).code, Some(0));
        let report = holdover(&["replay", &out, "--json"]).json();
        let sources = report["sources"].as_array().unwrap().clone();
        let barometer = sources.iter().find(|s| s["kind"] == "barometer").unwrap();
        barometer["used"].as_u64().unwrap()
            + barometer["rejected"].as_object().unwrap().values().map(|n| n.as_u64().unwrap()).sum::<u64>()
    };
    let (plain, half) = (flown("plain.tlog", &[]), flown("half.tlog", &["--fault", "baro:drop@30.."]));
    assert!((half as f64 / plain as f64 - 0.5).abs() < 0.05, "{half} of {plain}");
}
