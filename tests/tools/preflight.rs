//! `holdover preflight` against stand-ins: what it says, what it sets, and how it ends.

use holdover::wire::session::identity::AutopilotKind;
use serde_json::Value;
use std::time::Duration;

use crate::command::{Ran, holdover};
use crate::stand_in::{INT8, INT32, REAL32, Running, StandIn};

const SOURCES: [(&str, [f64; 3]); 5] = [
    ("POSXY", [3.0, 0.0, 0.0]),
    ("VELXY", [3.0, 0.0, 0.0]),
    ("POSZ", [1.0, 1.0, 1.0]),
    ("VELZ", [3.0, 0.0, 0.0]),
    ("YAW", [1.0, 0.0, 0.0]),
];

/// ArduPilot as it comes.
fn ardupilot() -> StandIn {
    let mut stand_in = StandIn::new(
        AutopilotKind::ArduPilot,
        &[
            ("VISO_TYPE", 0.0, INT8),
            ("VISO_DELAY_MS", 10.0, REAL32),
            ("VISO_QUAL_MIN", 0.0, INT8),
            ("EK3_ENABLE", 1.0, INT8),
            ("AHRS_EKF_TYPE", 3.0, INT8),
            ("EK3_SRC_OPTIONS", 0.0, INT8),
            ("ARMING_CHECK", 1.0, INT32),
            ("FLOW_TYPE", 10.0, INT8),
            ("RNGFND1_TYPE", 100.0, INT8),
            ("RNGFND1_MAX", 50.0, REAL32),
            ("RC7_OPTION", 90.0, INT8),
        ],
    );
    for (source, values) in SOURCES {
        for (n, value) in values.iter().enumerate() {
            stand_in.parameters.insert(format!("EK3_SRC{}_{source}", n + 1), (*value, INT8));
        }
    }
    stand_in
}

/// PX4 as it comes, with its barometer as the reference of the height.
fn px4(ev_ctrl: f64) -> StandIn {
    StandIn::new(
        AutopilotKind::Px4,
        &[
            ("EKF2_EV_CTRL", ev_ctrl, INT32),
            ("EKF2_HGT_REF", 0.0, INT32),
            ("EKF2_EV_DELAY", 0.0, REAL32),
            ("EKF2_DELAY_MAX", 200.0, REAL32),
            ("EKF2_EV_QMIN", 0.0, INT32),
            ("EKF2_EV_NOISE_MD", 0.0, INT32),
            ("EKF2_NOAID_TOUT", 5_000_000.0, INT32),
            ("EKF2_OF_CTRL", 1.0, INT32),
            ("SYS_HAS_MAG", 1.0, INT32),
        ],
    )
}

fn preflight(of: &Running, more: &[&str]) -> Ran {
    holdover(&[&["preflight", "--endpoint", &of.endpoint], more].concat())
}

/// The object that a run with `--json` printed, and its exit code.
fn json(of: &Running, more: &[&str]) -> (Value, Option<i32>) {
    let ran = preflight(of, &[&["--json"], more].concat());
    (serde_json::from_str(&ran.out).unwrap_or_else(|e| panic!("{e}: {ran:?}")), ran.code)
}

fn faults(report: &Value) -> Vec<&str> {
    let findings = report["findings"].as_array().unwrap().iter();
    findings.filter(|f| f["grade"] == "fault").map(|f| f["subject"].as_str().unwrap()).collect()
}

#[test]
fn an_ardupilot_as_it_comes_is_told_what_it_lacks_and_nothing_is_changed() {
    let running = StandIn { loses_one_of: Some(3), ..ardupilot() }.start();
    let ran = preflight(&running, &["--set", "outbound.publish=holdover"]);
    assert_eq!(ran.code, Some(6), "{ran:?}");
    for text in [
        "ArduPilot 4.7.0, system 1, disarmed, round trip",
        "optical flow",
        "VISO_TYPE is 0, should be 1 (MAVLink) or 3, from the next boot on",
        "param set VISO_TYPE 1",
        "EK3_SRC2_POSXY is 0, should be 6",
        "EK3_SRC2_YAW is 0, should be 1 or 6",
        "outbound.publish is holdover, should be auto",
        "holdover run --set outbound.publish=auto",
        "RC7_OPTION is 90",
        "After a loss of GNSS\n  carried by optical flow, its height from the rangefinder, up to 50 m",
    ] {
        assert!(ran.out.contains(text), "no \"{text}\" in {}", ran.out);
    }
    // Names of other versions, and channels that it does not have, are no news.
    assert!(!ran.out.contains("Unknown"), "{}", ran.out);
    assert!(ran.err.contains("not ready: 5 faults"), "{}", ran.err);
    assert_eq!(running.told().sets, 0);
}

#[test]
fn what_mends_the_faults_is_set_and_read_back() {
    let running = StandIn { loses_one_of: Some(4), ..ardupilot() }.start();
    let always = ["--set", "outbound.publish=always"];
    let ran = preflight(&running, &[&["--write"], &always[..]].concat());
    assert_eq!(ran.code, Some(6), "it has to boot first: {ran:?}");
    for text in
        ["VISO_TYPE 0 -> 1, read back; in effect from the next boot on", "EK3_SRC2_POSXY 0 -> 6, read back"]
    {
        assert!(ran.out.contains(text), "no \"{text}\" in {}", ran.out);
    }
    assert!(ran.err.contains("reboot the autopilot"), "{}", ran.err);
    assert_eq!((running.value("VISO_TYPE"), running.value("EK3_SRC2_VELXY")), (1.0, 6.0));
    assert_eq!(running.value("EK3_SRC1_POSXY"), 3.0, "the set with GNSS is left as it is");
    let sets = running.told().sets;
    let (report, code) = json(&running, &always);
    assert_eq!((code, &report["ready"], faults(&report)), (Some(0), &Value::Bool(true), vec![]));
    assert_eq!(running.told().sets, sets);
}

#[test]
fn px4s_integers_are_read_and_set_by_their_bytes() {
    let running = px4(15.0).start();
    let (report, code) = json(&running, &[]);
    assert_eq!((code, faults(&report)), (Some(6), vec!["EKF2_EV_CTRL"]));
    let fault = &report["findings"][0];
    assert_eq!(
        (&fault["value"], &fault["mend"], &fault["reboot"]),
        (&15.0.into(), &7.0.into(), &false.into())
    );
    assert_eq!(fault["example"], "param set EKF2_EV_CTRL 7");
    assert_eq!(report["parameters"]["EKF2_NOAID_TOUT"], 5e6);
    assert!((90.0..=105.0).contains(&report["streams_hz"]["IMU"].as_f64().unwrap()), "{report}");
    assert_eq!(report["streams_hz"]["airspeed"], Value::Null);
    assert_eq!(report["after_a_loss"]["carried_by"], "flow");

    let (report, code) = json(&running, &["--write"]);
    assert_eq!((code, &report["ready"]), (Some(0), &Value::Bool(true)), "{report}");
    let written = &report["written"][0];
    let values = [&written["before"], &written["wanted"], &written["after"]].map(|v| v.as_f64().unwrap());
    assert_eq!((values, &written["took"]), ([15.0, 7.0, 7.0], &Value::Bool(true)));
    assert_eq!(running.value("EKF2_EV_CTRL"), 7.0);
}

#[test]
fn a_value_that_is_not_kept_is_told() {
    let running = StandIn { stubborn: vec!["EKF2_EV_CTRL"], ..px4(0.0) }.start();
    let ran = preflight(&running, &["--write"]);
    assert_eq!(ran.code, Some(6), "{ran:?}");
    assert!(ran.out.contains("EKF2_EV_CTRL 0 -> 7: not kept, it is 0"), "{}", ran.out);
    assert!(ran.err.contains("not ready: 1 fault"), "{}", ran.err);
}

#[test]
fn a_slow_link_is_measured_and_an_unknown_parameter_is_no_fault() {
    let mut stand_in = StandIn { delay: Duration::from_millis(120), flow: false, ..px4(7.0) };
    stand_in.parameters.remove("EKF2_EV_QMIN");
    let running = stand_in.start();
    let (report, code) = json(&running, &["--set", "drag.use=false"]);
    assert_eq!(code, Some(6));
    let round_trip = report["round_trip_ms"].as_f64().unwrap();
    assert!((120.0..180.0).contains(&round_trip), "{round_trip} ms");
    assert_eq!(report["unknown"], serde_json::json!(["EKF2_EV_QMIN"]));
    assert_eq!(faults(&report), ["EKF2_EV_DELAY", "optical flow or airspeed"]);
    assert_eq!(report["after_a_loss"]["carried_by"], "inertia");
    let text = report["after_a_loss"]["text"].as_str().unwrap();
    assert!(text.contains("about 17 m after 15 s") && text.contains("Land"), "{text}");
}

#[test]
fn an_armed_vehicle_is_left_alone() {
    let running = StandIn { armed: true, ..px4(0.0) }.start();
    let (report, code) = json(&running, &["--write"]);
    assert_eq!((code, &report["not_written"]), (Some(6), &"the vehicle is armed".into()));
    assert_eq!((running.told().sets, running.value("EKF2_EV_CTRL")), (0, 0.0));
}

#[test]
fn an_autopilot_that_tells_no_parameter_is_no_ready_one() {
    let running = StandIn { answers_parameters: false, ..px4(7.0) }.start();
    let (report, code) = json(&running, &[]);
    assert_eq!((code, &report["ready"]), (Some(4), &Value::Bool(false)));
    assert!(report["streams_hz"]["IMU"].as_f64().unwrap() > 80.0, "{report}");
    let other = StandIn::new(AutopilotKind::Other(4), &[]).start();
    let ran = preflight(&other, &[]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert!(ran.out.contains("only the streams were checked"), "{}", ran.out);
}

#[test]
fn nobody_and_too_many_are_told_apart() {
    let quiet = ["preflight", "--wait", "1", "--endpoint"];
    holdover(&[&quiet[..], &["udpin:127.0.0.1:0"]].concat()).fails(5, &["nothing was heard", "in 1 s"]);
    let running = StandIn { company: true, ..px4(7.0) }.start();
    preflight(&running, &[]).fails(2, &["system 1, system 2 are heard", "vehicle.system_id=1"]);
    let (report, _) = json(&running, &["--set", "vehicle.system_id=1"]);
    assert_eq!(report["system"], 1);
    let wanted = ["--wait", "2", "--set", "vehicle.system_id=9"];
    preflight(&running, &wanted).fails(5, &["no autopilot of system 9", "heard: system 1, system 2"]);
    holdover(&["preflight", "--endpoint", "serial:/dev/nothing:57600"]).fails(5, &["/dev/nothing"]);
    holdover(&["preflight", "--set", "link.endpoints=[]"]).fails(2, &["link.endpoints"]);
}
