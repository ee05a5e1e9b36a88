//! An axis of the IMU that changes in an outage: found, told, corrected and no false alarm.

use crate::command::{COPTER, holdover, sitl_log};
use serde_json::Value;

/// The rows of `stress` over two starts of a flight, with outages of a minute and faults from the tenth second on.
fn stress(faults: &[&str]) -> Vec<Value> {
    let log = sitl_log(COPTER);
    let mut arguments = vec!["stress", log.to_str().unwrap(), "--starts", "2", "--json"];
    let timed: Vec<String> = faults.iter().map(|fault| format!("{fault}@10..60")).collect();
    for fault in &timed {
        arguments.extend(["--fault", fault]);
    }
    let report = holdover(&arguments).json();
    assert_eq!(report["logs"][0]["false_alarms"].as_array().unwrap().len(), 0, "{report}");
    report["logs"][0]["rows"].as_array().unwrap().clone()
}

#[test]
fn a_bias_that_begins_in_an_outage_is_found_in_seconds_and_taken_out() {
    let rows =
        stress(&["gyro.z:bias=3", "gyro.y:bias=1", "gyro.x:bias=-2", "accel.z:bias=1", "accel.z:bias=-1.5"]);
    assert_eq!(rows.len(), 10);
    for row in rows {
        let number = |key: &str| row[key].as_f64().unwrap_or(f64::NAN);
        assert!(number("told_after_s") < 8.0, "{row}");
        assert!(number("worst_sigmas") < 2.5, "{row}");
        assert!(number("error_m") < 2.0 * number("error_without_fault_m") + 2.0, "{row}");
        assert_eq!(row["blamed"].as_array().unwrap().len(), 0, "{row}");
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
