//! One simulated flight, written in every format: the same samples and the same navigation, to the resolution of the format.

use std::path::Path;

use holdover::config::{Settings, Sources};
use holdover::log::{Log, LogFormat};
use holdover::replay::runner::{self, Runner};
use holdover::sample::{FlowRotation, Input, Sample, SampleKind, VehicleStatus};
use holdover::wire::clock::AutopilotClock;
use nalgebra::Vector3;

use crate::command::{bytes_of, holdover, records, write_log};
use crate::dataflash_file::DataFlashFile;
use crate::flight::{Flight, Step};
use crate::inputs;
use crate::ulog_file::UlogFile;

/// GNSS is withheld in this interval, s.
const OUTAGE: (f64, f64) = (50.0, 70.0);

fn samples(inputs: &[Input]) -> Vec<Sample> {
    inputs.iter().filter_map(|i| if let Input::Sample(s) = i { Some(*s) } else { None }).collect()
}

/// How far two samples of a kind are apart: in time, s, and in their numbers, in units of `resolution`.
fn apart(a: &Sample, b: &Sample) -> (f64, f64) {
    let vector = |a: Vector3<f64>, b: Vector3<f64>| (a - b).amax();
    let numbers = match (a, b) {
        (Sample::Imu(a), Sample::Imu(b)) => vector(a.angular_rate.raw(), b.angular_rate.raw())
            .max(vector(a.specific_force.raw(), b.specific_force.raw()) / 40.0),
        (Sample::Mag(a), Sample::Mag(b)) => vector(a.field.raw(), b.field.raw()) * 1e7,
        (Sample::Pressure(a), Sample::Pressure(b)) => (a.pressure_pa - b.pressure_pa).abs() * 0.1,
        (Sample::Range(a), Sample::Range(b)) => (a.distance_m - b.distance_m).abs(),
        (Sample::Airspeed(a), Sample::Airspeed(b)) => (a.airspeed_mps - b.airspeed_mps).abs(),
        (Sample::Flow(a), Sample::Flow(b)) => {
            let (FlowRotation::SensorGyro(ga), FlowRotation::SensorGyro(gb)) = (a.rotation, b.rotation)
            else {
                panic!("{a:?} {b:?}");
            };
            let pairs = a.rate_xy.iter().zip(b.rate_xy).chain(ga.iter().zip(gb));
            pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
        }
        (Sample::Gnss(a), Sample::Gnss(b)) => {
            let (p, q) = (a.position.unwrap(), b.position.unwrap());
            let (va, vb) = (a.ground_velocity.unwrap().north_east(), b.ground_velocity.unwrap().north_east());
            assert_eq!((a.fix, a.satellites), (b.fix, b.satellites));
            let claimed = |a: Option<f64>, b: Option<f64>| (a.unwrap() - b.unwrap()).abs() * 0.1;
            [
                (p.latitude_rad - q.latitude_rad).abs() * 6.4e6,
                (p.longitude_rad - q.longitude_rad).abs() * 6.4e6,
                (p.height_m - q.height_m).abs(),
                (va.0 - vb.0).abs(),
                (va.1 - vb.1).abs(),
                claimed(a.horizontal_accuracy_m, b.horizontal_accuracy_m),
                claimed(a.speed_accuracy_mps, b.speed_accuracy_mps),
            ]
            .into_iter()
            .fold(0.0, f64::max)
        }
        _ => panic!("{a:?} {b:?}"),
    };
    (a.time().seconds_since(b.time()).abs(), numbers)
}

/// What of a kind a log gives back is what was written: as many, at the same time, within what the format resolves.
fn compare(written: &[Step], read: &[Input], resolution: f64, stamp_s: f64) {
    let written: Vec<Sample> = written.iter().flat_map(|s| s.samples.iter().copied()).collect();
    let read = samples(read);
    for kind in SampleKind::ALL {
        let of =
            |all: &[Sample]| -> Vec<Sample> { all.iter().filter(|s| s.kind() == *kind).copied().collect() };
        let (a, b) = (of(&written), of(&read));
        assert_eq!(a.len(), b.len(), "{}", kind.label());
        for (a, b) in a.iter().zip(&b) {
            let (time, numbers) = apart(a, b);
            assert!(time <= stamp_s && numbers <= resolution, "{a:?} {b:?}: {time} {numbers}");
        }
    }
}

fn flight() -> Flight {
    Flight::rotor(0.01, 90.0, 3)
}

#[test]
fn a_ulog_gives_back_what_was_measured() {
    let folder = tempfile::tempdir().unwrap();
    let flight = flight();
    let path = write_log(folder.path(), "flight", &UlogFile::of(&flight.steps).bytes);
    assert_eq!(Log::open(&path, None).unwrap().format(), LogFormat::Ulog);
    let (inputs, summary) = inputs(&path);
    // Floats: a pressure to 0.004 Pa.
    compare(&flight.steps, &inputs, 5e-4, 0.0);
    assert_eq!(summary.counters.seen().count(), 0, "{:?}", summary.remarks());
    assert_eq!(summary.parameters.all().map(|p| (p.0, p.1)).collect::<Vec<_>>(), [("EKF2_GPS_DELAY", 110.0)]);
    assert!(inputs.contains(&Input::Status(flight.steps[0].status)));
}

#[test]
fn a_dataflash_log_gives_back_what_was_measured() {
    let folder = tempfile::tempdir().unwrap();
    let flight = flight();
    let path = write_log(folder.path(), "flight", &DataFlashFile::of(&flight.steps).bytes);
    let log = Log::open(&path, None).unwrap();
    assert_eq!((log.format(), log.vehicle().version.unwrap().minor), (LogFormat::DataFlash, 5));
    let (inputs, summary) = inputs(&path);
    // A field in milligauss, a height in centimetres, times of fixes in milliseconds.
    compare(&flight.steps, &inputs, 0.501, 0.001);
    assert_eq!(summary.counters.seen().count(), 0, "{:?}", summary.remarks());
    assert!(inputs.contains(&Input::Status(flight.steps[0].status)));
}

/// Where the flight ends by the navigation, and how far off it was in the outage, m.
fn outcome(runner: &Runner) -> (Vector3<f64>, f64, f64) {
    let solution = runner.solution().unwrap();
    let outage = runner.outcome().outages[0];
    (solution.position.raw(), outage.horizontal_error_end_m.unwrap(), outage.sigma_end_m.unwrap())
}

#[test]
fn the_navigation_is_the_same_from_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let flight = flight();
    let settings = Settings::load(&Sources::default()).unwrap().pipeline;
    let from = |name: &str, bytes: &[u8]| {
        let log = Log::open(&write_log(folder.path(), name, bytes), None).unwrap();
        outcome(&runner::run(&log, &settings, &[OUTAGE], &[], |_| {}, |_, _, _, _| {}).unwrap().0)
    };
    let mut direct = Runner::new(&settings, &[OUTAGE]);
    let clock = AutopilotClock::new();
    let mut status: Option<VehicleStatus> = None;
    for step in &flight.steps {
        if status.replace(step.status) != Some(step.status) {
            direct.take(&clock, &Input::Status(step.status));
        }
        for sample in &step.samples {
            direct.take(&clock, &Input::Sample(*sample));
        }
    }
    let direct = outcome(&direct);
    let ulog = from("a", &UlogFile::of(&flight.steps).bytes);
    let dataflash = from("b", &DataFlashFile::of(&flight.steps).bytes);
    for (name, off_m, (position, error_m, sigma_m)) in [("ulog", 0.02, ulog), ("dataflash", 0.3, dataflash)] {
        let apart = (position - direct.0).norm();
        assert!(apart < off_m, "{name}: ends {apart} m apart");
        assert!((error_m - direct.1).abs() < 10.0 * off_m, "{name}: {error_m} m, directly {} m", direct.1);
        assert!((sigma_m / direct.2 - 1.0).abs() < 0.1, "{name}: {sigma_m} m, directly {} m", direct.2);
    }
}

#[test]
fn folders_and_packed_logs_are_read_by_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let flight = flight();
    let below = folder.path().join("below");
    std::fs::create_dir(&below).unwrap();
    write_log(folder.path(), "a.bin", &DataFlashFile::of(&flight.steps).bytes);
    write_log(folder.path(), "notes.txt", b"a fine day");
    let ulog = UlogFile::of(&flight.steps).bytes;
    let packed =
        ruzstd::encoding::compress_to_vec(ulog.as_slice(), ruzstd::encoding::CompressionLevel::Fastest);
    write_log(&below, "b.ulg.zst", &packed);
    let logs = |arguments: &[&str]| -> Vec<String> {
        let out =
            holdover(&[&["inspect", folder.path().to_str().unwrap(), "--json"], arguments].concat()).out;
        out.lines()
            .map(|l| serde_json::from_str::<serde_json::Value>(l).unwrap()["format"].to_string())
            .collect()
    };
    assert_eq!(logs(&[]), ["\"DataFlash\""]);
    assert_eq!(logs(&["--recursive"]), ["\"DataFlash\"", "\"ULog\""]);
    let evaluated = holdover(&[
        "evaluate",
        folder.path().to_str().unwrap(),
        "--recursive",
        "--lengths",
        "10",
        "--starts",
        "1",
        "--estimator",
        "shipped",
        "--json",
    ]);
    assert_eq!(evaluated.json()["rows"].as_array().unwrap().len(), 2);
    let out = folder.path().join("out");
    let replayed = ["replay", folder.path().to_str().unwrap(), "--recursive", "--out", out.to_str().unwrap()];
    assert_eq!(holdover(&replayed).code, Some(0));
    let written = |name: &str| Path::new(&out).join(name).join("solution.csv").is_file();
    assert!(written("a.bin") && written("b.ulg.zst"));
}

#[test]
fn frames_without_stamps_are_the_same_log() {
    let folder = tempfile::tempdir().unwrap();
    let recorded = records("px4-quad-gps-loss", 0.0, 20.0);
    let stamped = write_log(folder.path(), "a", &bytes_of(&recorded));
    let frames: Vec<u8> = recorded.iter().flat_map(|r| r.frame.iter().copied()).collect();
    let raw = write_log(folder.path(), "b", &frames);
    let format = |path: &Path| Log::open(path, None).unwrap().format();
    assert_eq!((format(&stamped), format(&raw)), (LogFormat::Tlog, LogFormat::RawMavlink));
    assert_eq!(inputs(&stamped).0, inputs(&raw).0);
}
