//! A receiver that lies, told and left, and taken back: each kind put into a recorded flight with flow.

use crate::command::{COPTER, holdover, sitl_log};
use serde_json::Value;
use std::path::Path;
use tempfile::tempdir;

/// When the lie begins and ends, s.
const FROM_S: f64 = 270.0;
const TO_S: f64 = 310.0;

struct Told {
    report: Value,
}

impl Told {
    fn of(fault: &str) -> Self {
        let log = sitl_log(COPTER);
        let fault = format!("{fault}@{FROM_S}..{TO_S}");
        Self { report: holdover(&["replay", log.to_str().unwrap(), "--json", "--fault", &fault]).json() }
    }

    /// Events of a code from the lie's beginning on: time and text.
    fn events(&self, code: &str) -> Vec<(f64, String)> {
        let told = |e: &Value| Some((e["t_s"].as_f64()?, e["text"].as_str()?.to_owned()));
        let all = self.report["events"].as_array().unwrap().iter();
        all.filter(|e| e["code"] == code).filter_map(told).filter(|(t, _)| *t >= FROM_S).collect()
    }

    /// When GNSS was left, and when it was joined again.
    fn holdover(&self) -> (f64, f64) {
        let modes = self.events("mode");
        let time = |words: &str| modes.iter().find(|(_, text)| text.contains(words)).map(|(t, _)| *t);
        (time("-> Holdover").unwrap(), time("-> Rejoining").unwrap())
    }
}

#[test]
fn every_lie_is_left_before_it_does_harm_and_its_end_is_taken_in_seconds() {
    // What is put in, within which time it is left, what it is charged with, and how long after its end GNSS is back.
    let lies = [
        ("gnss:jump=5", 2.0, "contradicts inertia", 5.0),
        ("gnss:jump=12", 2.0, "contradicts inertia", 5.0),
        ("gnss:walk=0.5", 15.0, "", 15.0),
        ("gnss:walkboth=0.5", 30.0, "contradicts", 15.0),
        ("gnss:walkboth=1.2", 8.0, "contradicts", 15.0),
        ("gnss:freeze", 3.0, "", 5.0),
        ("gnss:spoofed", 1.0, "says so itself", 5.0),
        ("gnss:jammed", 1.0, "says so itself", 5.0),
        ("gnss:nofix", 2.0, "", 5.0),
    ];
    for (lie, within_s, charge, back_s) in lies {
        let told = Told::of(lie);
        let (left, joined) = told.holdover();
        assert!(left < FROM_S + within_s, "{lie}: left after {} s", left - FROM_S);
        assert!(joined > TO_S && joined < TO_S + back_s, "{lie}: back {} s after its end", joined - TO_S);
        let accused = told.events("source-accused");
        if lie != "gnss:nofix" {
            assert!(accused[0].0 < FROM_S + within_s && accused[0].1.contains(charge), "{lie}: {accused:?}");
            let acquitted = told.events("source-acquitted");
            assert!(acquitted.iter().any(|(t, _)| *t <= joined), "{lie}: {acquitted:?}");
        }
        let gnss = told.report["sources"].as_array().unwrap().iter().find(|s| s["kind"] == "gnss").unwrap();
        assert_eq!(gnss["health"], "healthy", "{lie}: nothing is held against it in the end");
        assert_eq!(gnss["charge"], Value::Null, "{lie}");
    }
}

#[test]
fn a_walk_of_position_and_velocity_is_found_where_it_begins_by_inertia_alone() {
    // A multirotor without flow, and a wing.
    for (name, from_s, back_s) in
        [("px4-quad-gps-loss", 90.0, 5.0), ("ardupilot-plane-survey-light", 700.0, 5.0)]
    {
        let log = sitl_log(name);
        let fault = format!("gnss:walkboth=2@{from_s}..{}", from_s + 30.0);
        let report = holdover(&["replay", log.to_str().unwrap(), "--json", "--fault", &fault]).json();
        let told = |code: &str, words: &str| {
            let after = |e: &&Value| e["t_s"].as_f64().is_some_and(|t| t > from_s);
            let says =
                |e: &&Value| e["code"] == code && e["text"].as_str().is_some_and(|t| t.contains(words));
            let mut events = report["events"].as_array().unwrap().iter().filter(after).filter(says);
            events.find_map(|e| e["t_s"].as_f64())
        };
        let left = told("mode", "-> Holdover").unwrap();
        assert!(left < from_s + 5.0, "{name}: left after {} s", left - from_s);
        let back = told("source-acquitted", "GNSS 0").unwrap();
        assert!(
            back > from_s + 30.0 && back < from_s + 33.0 + back_s,
            "{name}: back after {} s",
            back - from_s
        );
    }
}

/// A leg that begins as the lie does: what the receiver's velocity stepped by is not charged to an axis of the IMU.
#[test]
fn a_lie_that_begins_with_a_manoeuvre_is_the_receivers() {
    let faults = "ardupilot-copter-baro-faults";
    for (flight, from_s, speed, within_s) in
        [(COPTER, 314, 2.0, 3.0), (COPTER, 366, 2.0, 3.0), (faults, 249, 2.0, 3.0), (faults, 392, 0.5, 8.0)]
    {
        let log = sitl_log(flight);
        let fault = format!("gnss:walkboth={speed}@{from_s}..{}", from_s + 30);
        let report = holdover(&["replay", log.to_str().unwrap(), "--json", "--fault", &fault]).json();
        let told = |e: &Value| Some((e["t_s"].as_f64()?, e["text"].as_str()?.to_owned()));
        let events = report["events"].as_array().unwrap().iter();
        let accused = events.filter(|e| e["code"] == "source-accused").filter_map(told);
        let from_s = f64::from(from_s);
        let lied: Vec<_> = accused.filter(|(t, _)| (from_s..from_s + 30.0).contains(t)).collect();
        let [(at_s, text)] = &lied[..] else { panic!("{flight} at {from_s} s: {lied:?}") };
        assert!(text.starts_with("GNSS 0 contradicts") && *at_s < from_s + within_s, "{flight}: {lied:?}");
    }
}

/// The rows of `stress` with GNSS, over eight starts of a flight.
fn stress(flight: &str, lies: &[&str]) -> Vec<Value> {
    let log = sitl_log(flight);
    let mut arguments = vec!["stress", log.to_str().unwrap(), "--starts", "8", "--with-gnss", "--json"];
    arguments.extend(lies.iter().flat_map(|lie| ["--fault", lie]));
    let report = holdover(&arguments).json();
    report["logs"][0]["rows"].as_array().unwrap().clone()
}

/// Slow lies: what inertia alone only suspects is charged with the flow's word, and is claimed until the flow has refuted it.
#[test]
fn flow_and_inertia_testify_together_about_a_walk_of_half_a_metre_a_second() {
    for flight in [COPTER, "ardupilot-copter-baro-faults"] {
        let rows = stress(flight, &["gnss:walkboth=0.5@0..60", "gnss:walkboth=0.5@20..60"]);
        assert!(rows.len() > 8, "{flight}: {}", rows.len());
        for row in rows {
            let (error, sigmas) = (row["error_m"].as_f64().unwrap(), row["worst_sigmas"].as_f64().unwrap());
            let told = row["told_after_s"].as_f64().unwrap_or(f64::INFINITY);
            assert!(told < 15.0 && sigmas < 2.2 && error < 6.0, "{flight}: {row}");
        }
    }
}

/// In a hover as well, if it is a receiver that never holds its position; and what was followed of it is undone.
#[test]
fn a_receiver_that_freezes_is_told_whatever_the_vehicle_does() {
    for row in stress(COPTER, &["gnss:freeze@0..60"]) {
        let (error, sigmas) = (row["error_m"].as_f64().unwrap(), row["worst_sigmas"].as_f64().unwrap());
        let told = row["told_after_s"].as_f64().unwrap_or(f64::INFINITY);
        assert!(told < 3.0 && sigmas < 2.0 && error < 5.0, "{row}");
    }
}

#[test]
fn a_fix_that_comes_and_goes_is_used_while_it_is_there_and_waited_for_longer_each_time() {
    let told = Told::of("gnss:flap=10");
    let modes = told.events("mode");
    let times =
        |words: &str| modes.iter().filter(|(_, m)| m.contains(words)).map(|(t, _)| *t).collect::<Vec<_>>();
    let (lost, back) = (times("-> Holdover"), times("-> Rejoining"));
    assert!(lost.len() >= 3 && back.len() >= 3, "{modes:?}");
    let waited: Vec<f64> = lost.iter().zip(&back).map(|(l, b)| b - l).collect();
    assert!(waited[2] > waited[0] + 1.0 && waited.iter().all(|w| *w < 15.0), "{waited:?}");
}

#[test]
fn an_honest_receiver_is_never_accused() {
    for log in ["ardupilot-copter-baro-faults", COPTER, "px4-quad-gps-loss", "ardupilot-plane-survey-light"] {
        assert_eq!(accused(&sitl_log(log)), None);
    }
}

#[test]
fn an_honest_receiver_is_not_accused_while_its_latency_is_learned_or_a_flow_of_the_first_minute_testifies() {
    // The first fast turn shows the latency of a receiver that flew straight until then.
    let d = tempdir().unwrap();
    for (scenario, seed, duration) in [("cessna", "203", "150"), ("legs", "208", "90"), ("legs", "209", "90")]
    {
        let log = d.path().join(format!("{scenario}-{seed}.tlog"));
        let out = log.to_str().unwrap();
        let flight = ["--imu", "mems", "--wind", "3,-2", "--airspeed", "--duration", duration];
        let ran = holdover(&[&["simulate", scenario, "--seed", seed, "--out", out], &flight[..]].concat());
        assert_eq!(ran.code, Some(0), "{ran:?}");
        assert_eq!(accused(&log), None, "{scenario} {seed}");
    }
}

/// What is held against the receiver of a flight, first of all.
fn accused(log: &Path) -> Option<Value> {
    let report = holdover(&["replay", log.to_str().unwrap(), "--json"]).json();
    let of_gnss = |e: &&Value| {
        e["code"] == "source-accused" && e["text"].as_str().is_some_and(|t| t.starts_with("GNSS"))
    };
    report["events"].as_array().unwrap().iter().find(of_gnss).cloned()
}

/// What a fault makes of the published horizontal position, m, and its sigma, m, from `from_s` on, by time, s.
fn led_astray(name: &str, fault: &str, from_s: f64) -> Vec<(f64, f64, f64)> {
    let log = sitl_log(name);
    let solution = |more: &[&str]| {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().to_str().unwrap();
        holdover(&[&["replay", log.to_str().unwrap(), "--json", "--out", out], more].concat()).json();
        let mut csv = csv::Reader::from_path(folder.path().join("solution.csv")).unwrap();
        let rows = csv.deserialize::<std::collections::HashMap<String, String>>().map(Result::unwrap);
        let number =
            |row: &std::collections::HashMap<String, String>, key: &str| row[key].parse::<f64>().unwrap();
        let columns = ["north_m", "east_m", "sigma_horizontal_m"];
        rows.map(|row| ((number(&row, "t_s") * 1e6) as i64, columns.map(|key| number(&row, key))))
            .collect::<std::collections::BTreeMap<_, _>>()
    };
    let (sound, faulty) = (solution(&[]), solution(&["--fault", fault]));
    // One that goes on without inertia is told at other moments.
    let both = faulty.iter().filter_map(|(t, f)| Some((*t, sound.range(t - 50_000..=*t).next_back()?.1, f)));
    let after = both.map(|(t, s, f)| (t as f64 * 1e-6, s, f)).filter(|(t_s, ..)| *t_s >= from_s);
    after.map(|(t_s, s, f)| (t_s, f64::hypot(f[0] - s[0], f[1] - s[1]), f[2])).collect()
}

#[test]
fn while_an_imu_that_lies_and_a_receiver_part_the_claim_covers_both() {
    // The roll gyro turns its sign; whichever of the two is believed at first, the error has no more than its sigmas.
    for (name, from_s) in [("ardupilot-copter-gps-loss", 362.3), ("px4-quad-gps-loss", 366.7)] {
        let rows = led_astray(name, &format!("gyro.x:flip@{from_s}..{}", from_s + 60.0), from_s);
        assert!(
            rows.len() > 300 && rows.iter().any(|(_, apart_m, _)| *apart_m > 1.0),
            "{name}: it does harm"
        );
        for (t_s, apart_m, sigma_m) in rows {
            assert!(apart_m < 3.0 * sigma_m + 1.0, "{name} at {t_s} s: {apart_m} m off, {sigma_m} m claimed");
        }
    }
}

/// Flow carries on when the lie is found; the receiver falls silent, comes back where flow says that it is, and has led nowhere.
#[test]
fn a_receiver_that_did_not_lead_leaves_no_claim_behind() {
    let rows = led_astray("ardupilot-copter-gps-loss", "gnss:walkboth=2@120..180", 120.0);
    assert!(rows.len() > 3000);
    let most = rows.iter().map(|(.., sigma_m)| *sigma_m).fold(0.0, f64::max);
    assert!(most < 20.0, "{most} m claimed");
    for (t_s, apart_m, sigma_m) in rows {
        assert!(apart_m < 3.0 * sigma_m, "{t_s} s: {apart_m} m off, {sigma_m} m claimed");
    }
}

#[test]
fn what_a_walk_has_led_to_is_taken_back_and_no_more() {
    for from_s in [114.5, 238.4, 362.3] {
        let fault = format!("gnss:walk=0.5@{from_s}..{}", from_s + 60.0);
        let rows = led_astray("ardupilot-copter-gps-loss", &fault, from_s);
        let within = rows.iter().filter(|(t_s, ..)| *t_s < from_s + 60.0);
        for (t_s, apart_m, sigma_m) in within {
            assert!(*apart_m < 1.5 * sigma_m + 0.5, "at {t_s} s: {apart_m} m off, {sigma_m} m claimed");
        }
        let (_, apart_m, _) = rows.iter().find(|(t_s, ..)| *t_s > from_s + 40.0).unwrap();
        assert!(*apart_m < 3.5, "{apart_m} m after it was taken back");
    }
}
