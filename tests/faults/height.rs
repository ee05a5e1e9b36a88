//! Barometers that freeze while the vehicle climbs or sinks in an outage.

use crate::command::{COPTER, holdover, sitl_log};
use serde_json::Value;

/// An outage of 45 s, and both barometers frozen from its fifth second on.
fn frozen(flight: &str, from_s: f64) -> Value {
    let log = sitl_log(flight);
    let outage = format!("{}..{}", from_s - 5.0, from_s + 40.0);
    let fault = format!("baro:freeze@{from_s}..{}", from_s + 40.0);
    holdover(&["replay", log.to_str().unwrap(), "--json", "--outage", &outage, "--fault", &fault]).json()
}

/// A height that is kept takes the climb away, and leaves inertia with a rate that nobody flies: what repeats itself is let go before it does.
#[test]
fn barometers_that_freeze_in_a_climb_leave_the_height_to_the_rangefinder() {
    let flights = [
        (COPTER, 54.7),
        (COPTER, 355.6),
        (COPTER, 400.2),
        ("ardupilot-copter-gps-glitches", 338.5),
        ("px4-quad-gps-loss", 408.5),
        // Beside noise that has grown fivefold: what was kept was far off.
        ("ardupilot-copter-baro-faults", 253.7),
    ];
    for (flight, from_s) in flights {
        let report = frozen(flight, from_s);
        let outage = &report["outages"][0];
        assert!(outage["altitude_rmse_m"].as_f64().unwrap() < 5.0, "{flight} at {from_s} s: {outage}");
        assert!(outage["worst_sigmas"].as_f64().unwrap() < 4.0, "{flight} at {from_s} s: {outage}");
        let events = report["events"].as_array().unwrap().iter();
        let stuck = |e: &&Value| e["text"].as_str().is_some_and(|text| text == "barometer 0 stuck");
        let told_s = events.filter(stuck).find_map(|e| e["t_s"].as_f64()).unwrap();
        assert!((from_s..from_s + 10.0).contains(&told_s), "{flight} at {from_s} s: told at {told_s} s");
    }
}

/// A fault that is found within the minute of the one before is held back, and told all the same: when it has stayed, or when the log ends.
#[test]
fn a_fault_that_is_in_force_is_what_was_told_last() {
    let log = sitl_log("ardupilot-copter-baro-faults");
    for (again_s, told_s) in [(418.0, 423.5), (430.0, 432.8)] {
        let second = format!("baro0:bias=8@{again_s}..");
        let faults = ["--fault", "baro0:bias=8@390..395", "--fault", &second];
        let report = holdover(&[&["replay", log.to_str().unwrap(), "--json"], &faults[..]].concat()).json();
        let events = report["events"].as_array().unwrap().iter();
        let barometer = |e: &&Value| e["text"].as_str().is_some_and(|text| text.starts_with("barometer "));
        let last: Vec<&Value> = events.filter(barometer).collect();
        let [.., first, healed, last] = last.as_slice() else { panic!("{last:?}") };
        let codes = [first, healed, last].map(|e| e["code"].as_str().unwrap());
        assert_eq!(codes, ["height-fault", "height-healed", "height-fault"], "{report}");
        assert!((last["t_s"].as_f64().unwrap() - told_s).abs() < 0.5, "{last}");
        assert_eq!(last["times"], 2, "{last}");
    }
}
