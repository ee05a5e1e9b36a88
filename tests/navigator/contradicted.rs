//! Compasses and IMUs that go wrong in recorded flights: told, not followed, GNSS not blamed for it, and taken back when it is over.

use std::path::Path;

use holdover::config::{Settings, Sources};
use holdover::fault::InjectedFault;
use holdover::log::Log;
use holdover::navigator::event::EventKind;
use holdover::navigator::solution::Mode;
use holdover::navigator::sources::status::SourceKind;
use holdover::replay::runner::Runner;

/// What came of a flight with a fault.
struct Seen {
    accused: Vec<f64>,
    acquitted: Vec<f64>,
    modes: Vec<(f64, Mode)>,
    /// Of the outage, where there is one: the greatest error, m.
    worst_m: Option<f64>,
    /// The greatest error over its own sigma, and the greatest error, m, among solutions that may be relied on, from the fault on.
    ratio: f64,
    relied_m: f64,
}

fn fly(name: &str, outages: &[(f64, f64)], fault: &str, kind: SourceKind) -> Seen {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("sitl-logs").join(format!("{name}.tlog"));
    let settings = Settings::load(&Sources::default()).unwrap().pipeline;
    let log = Log::open(&path, None).unwrap();
    let mut runner = Runner::new(&settings, outages);
    let fault: InjectedFault = fault.parse().unwrap();
    let from_s = fault.from_s;
    runner.set_faults(vec![fault], 1);
    runner.pipeline.follow(log.vehicle());
    let (mut ratio, mut relied_m) = (0.0_f64, 0.0_f64);
    log.play(
        |_, _| {},
        |clock, item| {
            runner.take(clock, item);
            let holdover::sample::Input::Reference(holdover::sample::Reference::Truth(truth)) = item else {
                return;
            };
            let (Some(solution), Some(frame)) = (runner.solution(), runner.pipeline.navigator.frame()) else {
                return;
            };
            let there = holdover::metrics::ReferenceState::from_truth(truth, frame);
            let relied = solution.mode != Mode::Aligning && runner.pipeline.outbound.quality(solution) >= 1;
            if let Some(there) = there.filter(|_| relied && runner.seconds(solution.time) > from_s) {
                let error = (there.position_ned - solution.position.raw()).xy().norm();
                ratio = ratio.max(error / solution.horizontal_sigma_m());
                relied_m = relied_m.max(error);
            }
        },
    )
    .unwrap();
    let told = |charged: bool| {
        let of = |event: &EventKind| match event {
            EventKind::Accused(source, _) => charged && source.kind == kind,
            EventKind::Acquitted(source) => !charged && source.kind == kind,
            _ => false,
        };
        runner.events().iter().filter(|(_, e)| of(&e.kind)).map(|(t, _)| *t).collect()
    };
    let outcome = runner.outcome();
    Seen {
        accused: told(true),
        acquitted: told(false),
        modes: outcome.modes.iter().map(|m| (m.t_s, m.mode)).collect(),
        worst_m: outcome.outages.first().and_then(|o| o.horizontal_error_max_m),
        ratio,
        relied_m,
    }
}

const SQUARES: &str = "ardupilot-copter-baro-faults";

#[test]
fn an_axis_of_the_imu_that_stands_still_is_told_and_gnss_is_followed_without_it() {
    for axis in ["gyro.x", "gyro.z", "accel.x", "accel.z"] {
        let seen = fly(SQUARES, &[], &format!("{axis}:freeze@90..120"), SourceKind::Imu);
        assert!(seen.accused.first().is_some_and(|t| (90.0..91.5).contains(t)), "{axis}: {:?}", seen.accused);
        assert!(
            seen.acquitted.first().is_some_and(|t| (120.0..121.0).contains(t)),
            "{axis}: {:?}",
            seen.acquitted
        );
        assert!(seen.modes.iter().all(|(t, m)| *t < 90.0 || *m == Mode::Aided), "{axis}: {:?}", seen.modes);
        assert!(seen.relied_m < 5.0, "{axis}: {}", seen.relied_m);
    }
}

#[test]
fn without_gnss_it_ends_in_lost_before_the_error_is_beyond_what_was_claimed() {
    let seen = fly(SQUARES, &[(80.0, 140.0)], "gyro.x:freeze@90..140", SourceKind::Imu);
    assert!(
        seen.modes.iter().any(|(t, m)| (90.0..125.0).contains(t) && *m == Mode::Lost),
        "{:?}",
        seen.modes
    );
    assert!(seen.ratio < 4.0, "{}", seen.ratio);
}

#[test]
fn an_imu_that_lies_is_convicted_and_not_the_gnss_that_shows_it() {
    for fault in ["accel.z:flip", "gyro.z:flip", "accel.x:flip"] {
        let seen = fly(SQUARES, &[], &format!("{fault}@90..110"), SourceKind::Imu);
        assert!(
            seen.accused.first().is_some_and(|t| (90.0..105.0).contains(t)),
            "{fault}: {:?}",
            seen.accused
        );
        assert!(!seen.acquitted.is_empty(), "{fault}: tried again and believed");
        assert!(seen.relied_m < 100.0, "{fault}: {}", seen.relied_m);
        let end = seen.modes.last().unwrap().1;
        assert_eq!(end, Mode::Aided, "{fault}: {:?}", seen.modes);
    }
}

#[test]
fn a_compass_that_is_turned_in_flight_is_dropped_and_taken_back_when_it_agrees() {
    let seen = fly(SQUARES, &[], "mag:turn=90@90..130", SourceKind::Magnetometer);
    assert!(seen.accused.first().is_some_and(|t| (90.0..100.0).contains(t)), "{:?}", seen.accused);
    assert!(seen.acquitted.first().is_some_and(|t| (155.0..230.0).contains(t)), "{:?}", seen.acquitted);
    assert!(seen.modes.iter().all(|(t, m)| *t < 90.0 || *m == Mode::Aided), "{:?}", seen.modes);
    assert!(seen.relied_m < 5.0, "{}", seen.relied_m);
    let without = fly(SQUARES, &[(100.0, 160.0)], "mag:drop@60..160", SourceKind::Magnetometer);
    let turned = fly(SQUARES, &[(100.0, 160.0)], "mag:turn=90@60..160", SourceKind::Magnetometer);
    assert!(turned.worst_m.unwrap() < 2.0 * without.worst_m.unwrap() + 1.0, "{:?}", turned.worst_m);
}
