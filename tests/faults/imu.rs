//! An axis of the IMU that changes in an outage: found, told, corrected and no false alarm.

use crate::command::{COPTER, holdover, sitl_log};
use serde_json::Value;

/// The rows of `stress` over so many starts of a flight, with outages of a minute and faults from a second of it on.
fn stress(flight: &str, starts: &str, faults: &[&str], from_s: u32) -> Vec<Value> {
    let log = sitl_log(flight);
    let mut arguments = vec!["stress", log.to_str().unwrap(), "--starts", starts, "--json"];
    let timed: Vec<String> = faults.iter().map(|fault| format!("{fault}@{from_s}..60")).collect();
    for fault in &timed {
        arguments.extend(["--fault", fault]);
    }
    let report = holdover(&arguments).json();
    assert_eq!(report["logs"][0]["false_alarms"].as_array().unwrap().len(), 0, "{report}");
    report["logs"][0]["rows"].as_array().unwrap().clone()
}

#[test]
fn a_bias_that_begins_in_an_outage_is_found_in_seconds_and_taken_out() {
    let faults = ["gyro.z:bias=3", "gyro.y:bias=1", "gyro.x:bias=-2", "accel.z:bias=1", "accel.z:bias=-1.5"];
    let rows = stress(COPTER, "2", &faults, 10);
    assert_eq!(rows.len(), 10);
    for row in rows {
        let number = |key: &str| row[key].as_f64().unwrap_or(f64::NAN);
        assert!(number("told_after_s") < 8.0, "{row}");
        assert!(number("worst_sigmas") < 2.5, "{row}");
        assert!(number("error_m") < 2.0 * number("error_without_fault_m") + 2.0, "{row}");
        assert_eq!(row["blamed"].as_array().unwrap().len(), 0, "{row}");
    }
}

/// Two that part little by little were parted by inertia: the other is not to be blamed.
#[test]
fn accelerometers_that_lead_away_convict_neither_flow_nor_airspeed() {
    let number = |row: &Value, key: &str| row[key].as_f64().unwrap_or(f64::NAN);
    let rows = stress(COPTER, "3", &["accel.x:bias=1", "accel.y:bias=-1"], 0);
    assert_eq!(rows.len(), 6);
    for row in rows {
        assert!(number(&row, "told_after_s") < 4.0 && number(&row, "worst_sigmas") < 2.0, "{row}");
        assert!(number(&row, "error_m") < 1.5 * number(&row, "error_without_fault_m"), "{row}");
        assert_eq!(row["blamed"].as_array().unwrap().len(), 0, "{row}");
    }
    for row in stress("ardupilot-plane-survey-light", "3", &["accel.x:bias=1", "accel.y:flip"], 0) {
        let start_s = number(&row, "start_s");
        assert_eq!(row["blamed"].as_array().unwrap().len(), 0, "{row}");
        assert!(number(&row, "worst_sigmas") < 4.0, "{start_s}: {row}");
    }
}

/// A gyro that turns round is no jump of its bias: what is believed of it is contradicted by all others, and then inertia is given up.
#[test]
fn a_gyro_that_turns_round_is_given_up_before_it_leads_away() {
    let number = |row: &Value, key: &str| row[key].as_f64().unwrap_or(f64::NAN);
    let rows = stress(COPTER, "4", &["gyro.y:flip"], 0);
    assert_eq!(rows.len(), 4);
    for row in rows {
        assert!(number(&row, "worst_sigmas") < 2.0 && number(&row, "error_m") < 200.0, "{row}");
    }
}

#[test]
fn an_axis_that_has_jumped_is_believed_again_when_the_correction_has_proven_right() {
    let log = sitl_log(COPTER);
    let fault = ["--outage", "265..325", "--fault", "gyro.z:bias=3@275.."];
    let report = holdover(&[&["replay", log.to_str().unwrap(), "--json"], &fault[..]].concat()).json();
    let told = |code: &str| {
        let events = report["events"].as_array().unwrap().iter();
        let of_imu =
            |e: &&Value| e["code"] == code && e["text"].as_str().is_some_and(|t| t.starts_with("IMU"));
        events.filter(of_imu).filter_map(|e| e["t_s"].as_f64()).collect::<Vec<_>>()
    };
    let (accused, acquitted) = (told("source-accused"), told("source-acquitted"));
    assert!(accused.len() == 1 && (275.0..283.0).contains(&accused[0]), "{accused:?}");
    assert!(acquitted.len() == 1 && acquitted[0] < accused[0] + 30.0, "{acquitted:?}");
}
