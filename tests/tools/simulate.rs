//! `holdover simulate`: what it writes is what was simulated, the same every time, and the other commands read it.

use std::fs;
use std::path::Path;

use crate::command::{Ran, holdover};
use holdover::geo::LocalNed;
use holdover::log::Log;
use holdover::sample::{FlowRotation, Input, Reference, Sample, TruthState, VehicleStatus};
use holdover::sim::models::{AirspeedModel, ImuModel};
use holdover::sim::{Scenario, SensorSuite, Simulation};
use holdover::time::{AutopilotTime, Span};
use tempfile::{TempDir, tempdir};

fn simulate(out: &Path, more: &[&str]) -> Ran {
    holdover(&[&["simulate"], more, &["--out", out.to_str().unwrap()]].concat())
}

/// Simulates into a new folder.
fn log(more: &[&str]) -> (TempDir, std::path::PathBuf) {
    let folder = tempdir().unwrap();
    let path = folder.path().join("flight.tlog");
    let ran = simulate(&path, more);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    (folder, path)
}

struct Decoded {
    samples: Vec<Sample>,
    truth: Vec<TruthState>,
    statuses: Vec<VehicleStatus>,
    origins: usize,
    rejected: usize,
}

fn decode(path: &Path) -> Decoded {
    let mut d =
        Decoded { samples: Vec::new(), truth: Vec::new(), statuses: Vec::new(), origins: 0, rejected: 0 };
    let summary = Log::open(path, None)
        .unwrap()
        .play(
            |_, _| {},
            |_, item| match item {
                Input::Sample(s) => d.samples.push(*s),
                Input::Reference(Reference::Truth(t)) => d.truth.push(*t),
                Input::Origin(_) => d.origins += 1,
                Input::Status(s) => d.statuses.push(*s),
                other => panic!("{other:?}"),
            },
        )
        .unwrap();
    d.rejected = summary.counters.seen().count();
    d
}

fn close(a: f64, b: f64, tolerance: f64, what: &str, time: AutopilotTime) {
    assert!((a - b).abs() <= tolerance, "{what} at {time:?}: {a} and {b}");
}

/// Within the resolution of the wire: 32-bit floats, 1e-7 degrees, millimetres, cm/s, centidegrees, centimetres.
fn assert_same(sent: &Sample, heard: &Sample, frame: &LocalNed) {
    let t = sent.time();
    // SCALED_PRESSURE and DISTANCE_SENSOR tell milliseconds; all stamps are multiples of it.
    assert_eq!(t, heard.time());
    let float = |a: f64, b: f64, what: &str| close(a, b, 1e-6 * a.abs().max(1e-4), what, t);
    match (sent, heard) {
        (Sample::Imu(a), Sample::Imu(b)) => (0..3).for_each(|i| {
            float(a.angular_rate.raw()[i], b.angular_rate.raw()[i], "gyro");
            float(a.specific_force.raw()[i], b.specific_force.raw()[i], "accelerometer");
        }),
        (Sample::Mag(a), Sample::Mag(b)) => {
            (0..3).for_each(|i| close(a.field.raw()[i], b.field.raw()[i], 1e-11, "field", t));
        }
        (Sample::Pressure(a), Sample::Pressure(b)) => {
            close(a.pressure_pa, b.pressure_pa, 0.01, "pressure", t)
        }
        (Sample::Range(a), Sample::Range(b)) => {
            assert_eq!((a.direction, a.sensor), (b.direction, b.sensor));
            close(a.distance_m, b.distance_m, 0.005001, "range", t);
            close(a.limits_m.unwrap()[1], b.limits_m.unwrap()[1], 1e-9, "limit", t);
        }
        (Sample::Airspeed(a), Sample::Airspeed(b)) => float(a.airspeed_mps, b.airspeed_mps, "airspeed"),
        (Sample::Flow(a), Sample::Flow(b)) => {
            assert_eq!((a.interval, a.sensor, a.quality), (b.interval, b.sensor, b.quality));
            let (FlowRotation::SensorGyro(p), FlowRotation::SensorGyro(q)) = (a.rotation, b.rotation) else {
                panic!("{a:?} {b:?}")
            };
            for i in 0..2 {
                close(a.rate_xy[i], b.rate_xy[i], 1e-6, "flow", t);
                close(p[i], q[i], 1e-6, "flow gyro", t);
            }
            assert_eq!(a.distance_m.is_some(), b.distance_m.is_some());
            if let (Some(p), Some(q)) = (a.distance_m, b.distance_m) {
                float(p, q, "flow distance");
            }
        }
        (Sample::Gnss(a), Sample::Gnss(b)) => {
            assert_eq!((a.fix, a.satellites, a.receiver), (b.fix, b.satellites, b.receiver));
            let accuracies = |g: &holdover::sample::GnssSample| {
                (g.horizontal_accuracy_m, g.vertical_accuracy_m, g.speed_accuracy_mps)
            };
            assert_eq!(accuracies(a), accuracies(b));
            let (Some(p), Some(q)) = (a.position, b.position) else {
                assert_eq!((a.position, b.position), (None, None));
                return;
            };
            assert!((frame.to_ned(&p) - frame.to_ned(&q)).norm() < 0.01);
            let ((n, e), (m, f)) =
                (a.ground_velocity.unwrap().north_east(), b.ground_velocity.unwrap().north_east());
            assert!((n - m).hypot(e - f) < 0.01, "{a:?} {b:?}");
        }
        (a, b) => panic!("{a:?} became {b:?}"),
    }
}

#[test]
fn what_is_decoded_is_what_was_simulated() {
    for (name, imu, dialect) in [("circles", "mems", "ardupilot"), ("square", "tactical", "px4")] {
        let more =
            [name, "--imu", imu, "--dialect", dialect, "--duration", "70", "--seed", "9", "--airspeed"];
        let (_folder, path) = log(&[&more[..], &["--lose-gnss", "50..60"]].concat());
        let heard = decode(&path);
        assert_eq!(heard.rejected, 0);
        let scenario = Scenario::by_name(name).unwrap().lasting(70.0);
        let imu = if imu == "mems" { ImuModel::mems() } else { ImuModel::tactical() };
        let mut suite = SensorSuite::of(&scenario, imu);
        suite.airspeed = Some(AirspeedModel::pitot());
        if let Some(gnss) = &mut suite.gnss {
            let kind = holdover::sim::models::OutageKind::NoFix;
            gnss.outage = Some(holdover::sim::models::GnssOutage { from_s: 50.0, to_s: 60.0, kind });
        }
        let simulation = Simulation::new(scenario, suite, 9);
        let frame = simulation.frame().clone();
        let sent: Vec<Sample> =
            simulation.clone().flat_map(|r| r.samples.iter().copied().collect::<Vec<_>>()).collect();
        assert_eq!(sent.len(), heard.samples.len());
        assert!(sent.len() > 11_000);
        for (a, b) in sent.iter().zip(&heard.samples) {
            assert_same(a, b, &frame);
        }
        assert_eq!((heard.truth.len(), heard.origins), (701, 3));
        let scenario = simulation.scenario();
        let told = if name == "square" { vec![0.0, 30.0] } else { vec![0.0] };
        assert_eq!(heard.statuses, told.into_iter().map(|t| scenario.status(t)).collect::<Vec<_>>());
        for t in &heard.truth {
            let x = simulation.truth(Simulation::seconds(t.time));
            assert!((frame.to_ned(&t.position.unwrap()) - x.position_ned).norm() < 0.01);
            assert!((t.velocity.unwrap().raw() - x.velocity_ned).norm() < 0.01);
            assert!((t.attitude.unwrap().matrix() - x.r_body_to_ned).norm() < 1e-6);
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_another_does_not() {
    let bytes = |seed| {
        let (_folder, path) = log(&["legs", "--duration", "20", "--seed", seed]);
        fs::read(path).unwrap()
    };
    assert!(bytes("3") == bytes("3"));
    assert!(bytes("3") != bytes("4"));
}

#[test]
fn a_log_is_not_overwritten_unless_told() {
    let (folder, path) = log(&["square", "--duration", "5"]);
    let before = fs::read(&path).unwrap();
    simulate(&path, &["square", "--duration", "6"]).fails(2, &["flight.tlog", "--force"]);
    assert!(fs::read(&path).unwrap() == before);
    assert_eq!(simulate(&path, &["square", "--duration", "2", "--force"]).code, Some(0));
    assert!(fs::read(&path).unwrap().len() < before.len());
    simulate(folder.path(), &["square", "--duration", "2", "--force"]).fails(2, &["directory"]);
    simulate(&folder.path().join("no/flight.tlog"), &["square"]).fails(1, &["no/flight.tlog"]);
}

#[test]
fn mistakes_are_named() {
    let folder = tempdir().unwrap();
    let path = folder.path().join("flight.tlog");
    let cases: &[(&[&str], &str)] = &[
        (&["pirouette"], "cessna, circles, legs, straight, square"),
        (&["circles", "--duration", "0"], "--duration"),
        (&["circles", "--duration", "nan"], "--duration"),
        (&["circles", "--duration", "1e9"], "--duration"),
        (&["circles", "--imu", "quantum"], "tactical"),
        (&["circles", "--dialect", "klingon"], "ardupilot"),
        (&["circles", "--wind", "storm"], "N,E"),
        (&["circles", "--wind", "40,0"], "20"),
        (&["circles", "--range", "9000"], "--range"),
        (&["circles", "--seed", "many"], "seed"),
        (&["circles", "--lose-gnss", "9..3"], "A..B"),
    ];
    for (arguments, word) in cases {
        simulate(&path, arguments).fails(2, &[word]);
        assert!(!path.exists(), "{arguments:?}");
    }
    holdover(&["simulate", "circles"]).fails(2, &["--out"]);
    let double = |more: &[&str]| holdover(&[&["simulate", "--autopilot", "px4"], more].concat());
    let to = "udpout:127.0.0.1:9";
    double(&[]).fails(2, &["--endpoint"]);
    double(&["--endpoint", "udpin:127.0.0.1:0"]).fails(2, &["udpout"]);
    double(&["--endpoint", to, "--param", "VISO_TYPE=1"]).fails(2, &["VISO_TYPE"]);
    double(&["--endpoint", to, "--with", "politeness"]).fails(2, &["repeated-flow"]);
    double(&["--endpoint", to, "--speed", "0"]).fails(2, &["--speed"]);
    double(&["--endpoint", to, "--out", "x.tlog"]).fails(2, &["--out"]);
    holdover(&["simulate", "square", "--out", "x.tlog", "--hold", "5"]).fails(2, &["--autopilot"]);
}

#[test]
fn an_autopilot_that_is_none_flies_as_fast_as_it_is_told() {
    let arguments =
        ["--autopilot", "ardupilot", "--endpoint", "udpout:127.0.0.1:9", "--camera", "--speed", "50"];
    let report = holdover(&[&["simulate", "--duration", "40", "--json"], &arguments[..]].concat()).json();
    assert!(report["lost_s"].is_null() && report["failsafe_s"].is_null(), "{report}");
    assert_eq!(report["external"], 0);
    let told = holdover(&[&["simulate", "--duration", "20"], &arguments[..]].concat());
    assert!(told.out.contains("origin set") && told.out.contains("0 messages"), "{told:?}");
}

#[test]
fn a_simulated_flight_is_replayed_and_held_through_an_outage() {
    let (_folder, path) = log(&["square", "--imu", "mems", "--seed", "2"]);
    let path = path.to_str().unwrap();
    let inspect = holdover(&["inspect", path, "--json"]).json();
    assert_eq!((&inspect["truth"], &inspect["bad_crc"]), (&true.into(), &0.into()));
    assert!(inspect["lacks"].is_null(), "{inspect}");
    let imu = inspect["samples"].as_array().unwrap().iter().find(|s| s["kind"] == "IMU").unwrap();
    assert!((imu["rate_hz"].as_f64().unwrap() - 100.0).abs() < 0.1);

    let report = holdover(&["replay", path, "--outage", "150..270", "--json"]).json();
    assert_eq!(report["reference"], "truth");
    assert!(report["modes"].as_array().unwrap().iter().any(|m| m["mode"] == "Aided"), "{report}");
    let outage = &report["outages"][0];
    let distance = outage["distance_m"].as_f64().unwrap();
    assert!((200.0..400.0).contains(&distance), "{outage}");
    let (drift, sigma) = (outage["drift_percent"].as_f64().unwrap(), outage["sigma_end_m"].as_f64().unwrap());
    let error = outage["horizontal_error_end_m"].as_f64().unwrap();
    assert!(drift.is_finite() && drift < 3.0 && error < 3.5 * sigma, "{outage}");
    assert!(report["aided"]["position_rmse_m"].as_f64().unwrap() < 3.0, "{report}");
}

#[test]
fn a_wind_and_no_flow_are_what_they_say() {
    let (_folder, windy) =
        log(&["straight", "--duration", "60", "--wind", "-6,0", "--airspeed", "--no-flow"]);
    let d = decode(&windy);
    assert!(!d.samples.iter().any(|s| matches!(s, Sample::Flow(_))));
    let airspeed: Vec<f64> = d
        .samples
        .iter()
        .filter_map(|s| if let Sample::Airspeed(a) = s { Some(a.airspeed_mps) } else { None })
        .collect();
    let mean = airspeed.iter().sum::<f64>() / airspeed.len() as f64;
    assert!((mean - 27.0).abs() < 1.5, "{mean}");
    let start = d.truth[0].time;
    let slow = d.truth.iter().filter(|t| t.time - start < Span::from_millis(20_000));
    // Northwards against the wind at first.
    assert!(slow.map(|t| t.velocity.unwrap().raw().norm()).all(|v| v < 25.0));
}
