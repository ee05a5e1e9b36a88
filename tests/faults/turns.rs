//! A sound copter that flips: what is late in its sensors is no fault of another.

use crate::command::holdover;
use std::path::Path;

/// Flips and stick work of 45 degrees: how late the compass is found to be, ms, and by how much that is known, with `fault` in the flight.
fn flips(fault: Option<&str>) -> (f64, f64) {
    let log = Path::new(env!("CARGO_MANIFEST_DIR")).join("sitl-logs/ardupilot-copter-flips.tlog.zst");
    let log = log.to_str().unwrap();
    let fault: Vec<&str> = fault.into_iter().flat_map(|fault| ["--fault", fault]).collect();
    let report = holdover(&[&["replay", log, "--json"], fault.as_slice()].concat()).json();
    let events = report["events"].as_array().unwrap();
    assert!(events.iter().all(|e| e["code"] != "source-accused"), "{fault:?}: {events:?}");
    let compass = report["sources"].as_array().unwrap().iter().find(|s| s["kind"] == "magnetometer").unwrap();
    assert_eq!(compass["gated"], 0, "{fault:?}: {compass}");
    assert!(compass["nis_mean"].as_f64().unwrap() < 0.1, "{fault:?}: {compass}");
    // The truth of this log has no stamps of its own: while the vehicle flips it is some degrees apart from any estimate.
    let yaw_deg = report["aided"]["yaw_rmse_deg"].as_f64().unwrap();
    assert!(yaw_deg < 2.5, "{fault:?}: {yaw_deg}");
    let text = holdover(&[&["replay", log], fault.as_slice()].concat()).out;
    let line = text.lines().find_map(|line| line.trim().strip_prefix("magnetometer latency ")).unwrap();
    let (late, sigma) = line.trim_end_matches(" ms").split_once(" +- ").unwrap();
    (late.parse().unwrap(), sigma.parse().unwrap())
}

#[test]
fn a_late_compass_is_measured_and_neither_it_nor_the_gyros_are_charged_in_a_flip() {
    let (own, _) = flips(None);
    for delay_s in [0.1, 0.2] {
        let (late, sigma) = flips(Some(&format!("mag:delay={delay_s}@0..60")));
        let found = late - own;
        assert!((found - 1e3 * delay_s).abs() < 15.0, "{delay_s} s: {found} ms more");
        assert!(sigma < 15.0, "{delay_s} s: {sigma} ms");
    }
}
