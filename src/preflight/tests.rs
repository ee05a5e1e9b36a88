//! The rules, one perturbation of a vehicle that is ready at a time.

use proptest::prelude::*;

use super::finding::{Finding, FindingGrade};
use super::outlook::outlook;
use super::readings::Readings;
use super::{Needs, judge, untold, wanted_parameters};
use crate::config::{Settings, Sources};
use crate::sample::{Airframe, SampleKind};
use crate::time::Span;
use crate::wire::frame::{ComponentId, SystemId};
use crate::wire::session::identity::{AutopilotKind, Vehicle};

fn needs(overrides: &[&str]) -> Needs {
    let overrides = overrides.iter().map(|s| (*s).to_owned()).collect();
    Needs::of(&Settings::load(&Sources { overrides, ..Sources::default() }).unwrap(), None)
}

/// A vehicle with flow that is ready.
fn ready(autopilot: AutopilotKind, parameters: &[(&str, f64)]) -> Readings {
    let mut rates_hz = [10.0; SampleKind::ALL.len()];
    rates_hz[SampleKind::Imu as usize] = 200.0;
    Readings {
        vehicle: Vehicle {
            system: SystemId(1),
            component: ComponentId(1),
            autopilot,
            vehicle_type: 2,
            armed: false,
            version: None,
        },
        airframe: Some(Airframe::Multirotor),
        mavlink1: false,
        rates_hz,
        gnss_fix: true,
        round_trip: Some(Span::from_millis(4)),
        parameters: parameters.iter().map(|(n, v)| ((*n).to_owned(), *v)).collect(),
        untold: Vec::new(),
    }
}

fn ardupilot() -> Readings {
    let sets = [[3.0, 3.0, 1.0, 3.0, 1.0], [6.0, 6.0, 1.0, 6.0, 1.0], [0.0, 0.0, 1.0, 0.0, 0.0]];
    let mut readings = ready(
        AutopilotKind::ArduPilot,
        &[
            ("VISO_TYPE", 1.0),
            ("VISO_DELAY_MS", 10.0),
            ("VISO_QUAL_MIN", 0.0),
            ("EK3_ENABLE", 1.0),
            ("AHRS_EKF_TYPE", 3.0),
            ("EK3_SRC_OPTIONS", 0.0),
            ("ARMING_CHECK", 1.0),
            ("RNGFND1_TYPE", 100.0),
            ("RNGFND1_MAX", 50.0),
        ],
    );
    for (n, set) in sets.iter().enumerate() {
        for (source, value) in ["POSXY", "VELXY", "POSZ", "VELZ", "YAW"].iter().zip(set) {
            readings.parameters.insert(format!("EK3_SRC{}_{source}", n + 1), *value);
        }
    }
    readings
}

fn px4() -> Readings {
    ready(
        AutopilotKind::Px4,
        &[
            ("EKF2_EV_CTRL", 7.0),
            ("EKF2_HGT_REF", 0.0),
            ("EKF2_EV_DELAY", 0.0),
            ("EKF2_DELAY_MAX", 200.0),
            ("EKF2_EV_QMIN", 0.0),
            ("EKF2_EV_NOISE_MD", 0.0),
            ("EKF2_NOAID_TOUT", 5e6),
            ("EKF2_OF_CTRL", 0.0),
            ("SYS_HAS_MAG", 1.0),
        ],
    )
}

fn faults(readings: &Readings, needs: &Needs) -> Vec<Finding> {
    judge(readings, needs).into_iter().filter(|f| f.grade == FindingGrade::Fault).collect()
}

/// Subject and mending value of every fault, of the vehicle with these parameters set.
fn mends(mut readings: Readings, set: &[(&str, f64)], overrides: &[&str]) -> Vec<(String, Option<f64>)> {
    for (name, value) in set {
        readings.parameters.insert((*name).to_owned(), *value);
    }
    faults(&readings, &needs(overrides)).into_iter().map(|f| (f.subject, f.mend)).collect()
}

const ALWAYS: &str = "outbound.publish=\"always\"";
const VISION: &str = "outbound.message=\"vision_position_estimate\"";

fn one(name: &str, mend: f64) -> Vec<(String, Option<f64>)> {
    vec![(name.to_owned(), Some(mend))]
}

#[test]
fn a_vehicle_that_is_set_up_has_no_fault() {
    assert_eq!(faults(&ardupilot(), &needs(&[ALWAYS])), []);
    assert_eq!(judge(&px4(), &needs(&[])), []);
}

#[test]
fn each_parameter_of_ardupilot_has_its_rule() {
    let cases = [
        ("VISO_TYPE", 0.0, 1.0),
        ("EK3_ENABLE", 0.0, 1.0),
        ("AHRS_EKF_TYPE", 10.0, 3.0),
        ("EK3_SRC_OPTIONS", 3.0, 2.0),
        ("VISO_QUAL_MIN", 30.0, 0.0),
        ("VISO_DELAY_MS", 80.0, 2.0),
        ("EK3_SRC2_VELXY", 5.0, 6.0),
        ("EK3_SRC2_VELZ", 3.0, 6.0),
        ("EK3_SRC2_POSZ", 3.0, 1.0),
        ("EK3_SRC2_YAW", 2.0, 1.0),
    ];
    for (name, value, mend) in cases {
        assert_eq!(mends(ardupilot(), &[(name, value)], &[ALWAYS]), one(name, mend));
    }
    assert_eq!(mends(ardupilot(), &[("VISO_QUAL_MIN", 10.0)], &[ALWAYS]), []);
    assert_eq!(mends(ardupilot(), &[("VISO_QUAL_MIN", 10.0)], &[ALWAYS, VISION]), one("VISO_QUAL_MIN", 0.0));
}

#[test]
fn each_parameter_of_px4_has_its_rule() {
    let cases = [
        ("EKF2_EV_CTRL", 0.0, 7.0),
        ("EKF2_EV_CTRL", 15.0, 7.0),
        ("EKF2_HGT_REF", 3.0, 0.0),
        ("EKF2_EV_DELAY", 60.0, 0.0),
        ("EKF2_DELAY_MAX", 40.0, 150.0),
        ("EKF2_EV_QMIN", 30.0, 0.0),
        ("EKF2_EV_NOISE_MD", 1.0, 0.0),
        ("EKF2_NOAID_TOUT", 1e6, 5e6),
    ];
    for (name, value, mend) in cases {
        assert_eq!(mends(px4(), &[(name, value)], &[]), one(name, mend));
    }
    assert_eq!(mends(px4(), &[("EKF2_EV_CTRL", 3.0)], &[VISION]), []);
    assert_eq!(mends(px4(), &[("EKF2_EV_CTRL", 15.0), ("SYS_HAS_MAG", 0.0)], &[]), [], "no other heading");
    assert_eq!(mends(px4(), &[], &["outbound.rate_hz=5"]), [("outbound.rate_hz".to_owned(), None)]);
}

#[test]
fn a_slow_link_changes_what_the_delays_should_be() {
    let mut readings = px4();
    readings.round_trip = Some(Span::from_millis(300));
    assert_eq!(
        mends(readings, &[("EKF2_DELAY_MAX", 180.0)], &[]),
        [("EKF2_EV_DELAY".to_owned(), Some(150.0)), ("EKF2_DELAY_MAX".to_owned(), Some(250.0))]
    );
}

#[test]
fn a_free_source_set_is_used_and_one_in_use_is_left_alone() {
    let none = [("EK3_SRC2_POSXY", 0.0), ("EK3_SRC2_VELXY", 0.0), ("EK3_SRC2_YAW", 0.0)];
    let names: Vec<_> = mends(ardupilot(), &none, &[ALWAYS]);
    let wanted = [("EK3_SRC2_POSXY", 6.0), ("EK3_SRC2_VELXY", 6.0), ("EK3_SRC2_YAW", 1.0)]
        .map(|(n, v)| (n.to_owned(), Some(v)));
    assert_eq!(names, wanted);
    let used = [("EK3_SRC2_POSXY", 3.0), ("EK3_SRC3_VELXY", 5.0)];
    assert_eq!(mends(ardupilot(), &used, &[ALWAYS]), [("EK3_SRC2_POSXY".to_owned(), None)]);
    let third = "tuning.handover.external_set=3";
    let names: Vec<_> = mends(ardupilot(), &[], &[ALWAYS, third]).into_iter().map(|f| f.0).collect();
    assert_eq!(names, ["EK3_SRC3_POSXY", "EK3_SRC3_VELXY", "EK3_SRC3_YAW"]);
    let other = [used[0], ("EK3_SRC3_POSXY", 6.0), ("EK3_SRC3_VELXY", 6.0), ("EK3_SRC3_YAW", 1.0)];
    assert_eq!(mends(ardupilot(), &other, &[ALWAYS]), [("tuning.handover.external_set".to_owned(), None)]);
}

#[test]
fn the_configuration_is_judged_by_the_autopilots_ways() {
    let publish = [("outbound.publish".to_owned(), None)];
    assert_eq!(mends(ardupilot(), &[], &["outbound.publish=\"holdover\""]), publish, "it cannot arm");
    let unchecked = [("ARMING_CHECK", 0.0)];
    assert_eq!(mends(ardupilot(), &unchecked, &["outbound.publish=\"holdover\""]), []);
    assert_eq!(mends(ardupilot(), &[], &["outbound.publish=\"auto\""]), [], "it sends from the alignment on");
    let wrong = mends(px4(), &[], &["vehicle.profile=\"ardupilot\""]);
    assert_eq!(wrong, [("vehicle.profile".to_owned(), None)]);
    // Who sends nothing needs no external navigation.
    assert_eq!(mends(ardupilot(), &[("VISO_TYPE", 0.0)], &["outbound.publish=\"never\""]), []);
}

#[test]
fn a_sensor_that_does_not_come_is_told_and_so_is_an_old_protocol() {
    for (kind, subject) in [(SampleKind::Imu, "IMU"), (SampleKind::Gnss, "GNSS")] {
        let mut readings = px4();
        readings.rates_hz[kind as usize] = 0.0;
        readings.rates_hz[SampleKind::Flow as usize] = 0.0;
        assert_eq!(mends(readings, &[], &[]), [(subject.to_owned(), None)]);
    }
    let mut readings = px4();
    readings.rates_hz[SampleKind::Gnss as usize] = 0.0;
    assert_eq!(faults(&readings, &needs(&[])), [], "flow starts without");
    assert_eq!(faults(&readings, &needs(&["start.without_gnss_s=0"])).len(), 1);
    let mut readings = ardupilot();
    readings.mavlink1 = true;
    let found = mends(readings, &[("SERIAL2_PROTOCOL", 1.0)], &[ALWAYS]);
    assert_eq!(found, [("MAVLink".to_owned(), None), ("SERIAL2_PROTOCOL".to_owned(), Some(2.0))]);
}

#[test]
fn a_flight_above_the_rangefinders_reach_is_told() {
    let mut needs = needs(&[ALWAYS]);
    needs.altitude_m = Some(60.0);
    assert_eq!(faults(&ardupilot(), &needs)[0].subject, "RNGFND1_MAX");
    needs.altitude_m = Some(40.0);
    assert_eq!(faults(&ardupilot(), &needs), []);
}

#[test]
fn what_a_loss_is_carried_by_is_told_honestly() {
    let mut readings = px4();
    assert_eq!(outlook(&readings, &needs(&[])).carried_by, "flow");
    readings.rates_hz[SampleKind::Flow as usize] = 0.0;
    let drag = outlook(&readings, &needs(&[]));
    assert_eq!(drag.carried_by, "drag");
    assert_eq!(faults(&readings, &needs(&[])), []);
    readings.airframe = Some(Airframe::FixedWing);
    assert_eq!(outlook(&readings, &needs(&[])).carried_by, "airspeed");
    readings.rates_hz[SampleKind::Airspeed as usize] = 0.0;
    let inertia = outlook(&readings, &needs(&[]));
    assert_eq!(inertia.carried_by, "inertia");
    // 0.15 m/s, 0.8 degrees and 4 degrees a minute for 15 s, in quadrature.
    let expected =
        [0.15f64 * 15.0, 9.81 * 0.8f64.to_radians() * 112.5, 9.81 * (4.0f64.to_radians() / 60.0) * 562.5];
    let expected = expected.iter().map(|v| v * v).sum::<f64>().sqrt();
    assert!((inertia.inertial_drift_m.unwrap() - expected).abs() < 0.02 * expected, "{inertia:?} {expected}");
    assert_eq!(faults(&readings, &needs(&[])).len(), 1, "inertia alone is no reason to send anything");
}

#[test]
fn names_of_other_versions_are_no_news() {
    let mut readings = ardupilot();
    readings.untold =
        ["RNGFND1_MAX_CM", "ARMING_SKIPCHK", "RC13_OPTION", "VISO_FUTURE"].map(str::to_owned).into();
    assert_eq!(untold(&readings), ["VISO_FUTURE"]);
}

proptest! {
    #[test]
    fn no_values_make_the_rules_fail(
        px4 in any::<bool>(),
        values in prop::collection::vec(prop::option::of(any::<f32>()), 120),
        round_trip in 0u32..500_000,
    ) {
        let kind = if px4 { AutopilotKind::Px4 } else { AutopilotKind::ArduPilot };
        let mut readings = ready(kind, &[]);
        readings.round_trip = Some(Span::from_micros(i64::from(round_trip)));
        for (name, value) in wanted_parameters(kind).into_iter().zip(values) {
            match value {
                Some(value) => drop(readings.parameters.insert(name, f64::from(value))),
                None => readings.untold.push(name),
            }
        }
        let parameters = readings.parameters.clone();
        for finding in judge(&readings, &needs(&[])) {
            // A parameter that was not told is no fault, and a mended one is none either.
            if let Some(mend) = finding.mend {
                prop_assert!(parameters.contains_key(&finding.subject));
                readings.parameters.insert(finding.subject, mend);
            }
        }
        let again = faults(&readings, &needs(&[]));
        prop_assert!(again.iter().all(|f| f.mend.is_none() || !parameters.contains_key(&f.subject)
            || f.subject.starts_with("EK3_SRC")), "{again:?}");
    }
}
