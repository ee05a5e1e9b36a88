//! Faults of sensors put into recorded flights: charged while they matter, no confident lie from them, and taken back when they are over.

use std::path::Path;

use holdover::config::{Settings, Sources};
use holdover::fault::InjectedFault;
use holdover::log::Log;
use holdover::navigator::event::EventKind;
use holdover::navigator::sources::status::SourceKind;
use holdover::replay::runner::Runner;

/// What came of a flight with a fault.
struct Judged {
    /// When the sensor was charged and when it was acquitted, s.
    accused: Vec<f64>,
    acquitted: Vec<f64>,
    /// Horizontal error at the end of the outage and the greatest, and sigma at its end, m; altitude error, RMS, m.
    error_m: f64,
    worst_m: f64,
    sigma_m: f64,
    altitude_m: f64,
}

fn fly(name: &str, outage: (f64, f64), faults: &[&str], kind: SourceKind) -> Judged {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("sitl-logs").join(format!("{name}.tlog"));
    let settings = Settings::load(&Sources::default()).unwrap().pipeline;
    let log = Log::open(&path, None).unwrap();
    let mut runner = Runner::new(&settings, &[outage]);
    let faults: Vec<InjectedFault> = faults.iter().map(|f| f.parse().unwrap()).collect();
    runner.set_faults(faults, 1);
    runner.pipeline.follow(log.vehicle());
    log.play(
        |_, _| {},
        |clock, item| {
            runner.take(clock, item);
        },
    )
    .unwrap();
    let told = |charged: bool| {
        let of = |kind_of: &EventKind| match kind_of {
            EventKind::Accused(source, _) => charged && source.kind == kind,
            EventKind::Acquitted(source) => !charged && source.kind == kind,
            _ => false,
        };
        runner.events().iter().filter(|(_, e)| of(&e.kind)).map(|(t, _)| *t).collect()
    };
    let outcome = runner.outcome();
    let report = outcome.outages[0];
    Judged {
        accused: told(true),
        acquitted: told(false),
        error_m: report.horizontal_error_end_m.unwrap(),
        worst_m: report.horizontal_error_max_m.unwrap(),
        sigma_m: report.sigma_end_m.unwrap(),
        altitude_m: report.altitude_rmse_m.unwrap(),
    }
}

/// A square is flown with 6 to 9 m/s in this outage of it; the fault begins and ends in motion.
const SQUARES: &str = "ardupilot-copter-baro-faults";
const SQUARE_S: (f64, f64) = (80.0, 130.0);

#[test]
fn a_flow_that_goes_wrong_in_an_outage_is_told_does_no_more_harm_than_none_and_comes_back() {
    let whole = fly(SQUARES, SQUARE_S, &[], SourceKind::Flow);
    assert!(whole.accused.is_empty() && whole.error_m < 4.0, "{:?} {}", whole.accused, whole.error_m);
    // As long without it as a fault and the way back take.
    let without = fly(SQUARES, SQUARE_S, &["flow:drop@90..120"], SourceKind::Flow);
    for kind in ["zero", "freeze", "scale=2", "scale=0.5", "flip", "bias=0.2"] {
        let judged = fly(SQUARES, SQUARE_S, &[&format!("flow:{kind}@90..110")], SourceKind::Flow);
        assert!(
            judged.accused.first().is_some_and(|t| (90.0..93.1).contains(t)),
            "{kind}: {:?}",
            judged.accused
        );
        assert!(
            judged.acquitted.first().is_some_and(|t| (110.0..122.0).contains(t)),
            "{kind}: {:?}",
            judged.acquitted
        );
        assert!(judged.error_m < 2.0 * without.error_m, "{kind}: {} {}", judged.error_m, without.error_m);
        // Three seconds at 8 m/s may pass before it is told.
        assert!(
            judged.worst_m < 24.0 && without.worst_m < 6.0,
            "{kind}: {} {}",
            judged.worst_m,
            without.worst_m
        );
        assert!(judged.error_m < 3.0 * judged.sigma_m, "{kind}: {} {}", judged.error_m, judged.sigma_m);
    }
}

#[test]
fn a_flow_that_goes_wrong_with_gnss_does_not_bend_its_calibration() {
    let outage = (300.0, 360.0);
    let whole = fly(SQUARES, outage, &[], SourceKind::Flow);
    for kind in ["scale=0.5", "zero"] {
        let judged = fly(SQUARES, outage, &[&format!("flow:{kind}@245..275")], SourceKind::Flow);
        assert!(
            judged.accused.first().is_some_and(|t| (245.0..260.0).contains(t)),
            "{kind}: {:?}",
            judged.accused
        );
        assert_eq!(judged.accused.len(), judged.acquitted.len(), "{kind}");
        assert!(judged.error_m < whole.error_m + 2.0, "{kind}: {} {}", judged.error_m, whole.error_m);
    }
}

/// The vehicle hovers and flies on at constant height: nothing but its own noise shows that a barometer is stuck.
#[test]
fn barometers_that_are_stuck_in_an_outage_convict_nobody_and_come_back() {
    let faults = ["baro:freeze@90..130", "baro1:freeze@90..130"];
    let judged = fly(SQUARES, SQUARE_S, &faults, SourceKind::Barometer);
    assert!(judged.accused.len() >= 2, "{:?}", judged.accused);
    assert!(judged.accused.iter().all(|t| (90.0..100.0).contains(t)), "{:?}", judged.accused);
    assert!(judged.acquitted.iter().all(|t| (130.0..131.0).contains(t)), "{:?}", judged.acquitted);
    assert_eq!(judged.accused.len(), judged.acquitted.len());
    // The rangefinder is the only height meanwhile, from as far as it is: a height that is kept is not used, though this vehicle keeps its own.
    assert!(judged.altitude_m < 1.0, "{} m", judged.altitude_m);
}

#[test]
fn a_rangefinder_that_is_stuck_does_not_scale_the_flow() {
    let whole = fly(SQUARES, SQUARE_S, &[], SourceKind::Rangefinder);
    assert!(whole.accused.is_empty(), "{:?}", whole.accused);
    for fault in ["stuck=2", "stuck=0.7", "scale=2", "drop"] {
        let judged = fly(SQUARES, SQUARE_S, &[&format!("range:{fault}@90..130")], SourceKind::Flow);
        assert!(judged.accused.is_empty(), "{fault}: flow charged at {:?}", judged.accused);
        assert!(judged.error_m < whole.error_m + 8.0, "{fault}: {} {}", judged.error_m, whole.error_m);
        assert!(judged.error_m < 3.0 * judged.sigma_m, "{fault}: {} {}", judged.error_m, judged.sigma_m);
    }
}

/// A wing in wind; without flow, airspeed carries it.
const SURVEY: &str = "ardupilot-plane-survey-light";
const NO_FLOW: &str = "flow:drop@300..900";

#[test]
fn a_pitot_tube_that_goes_wrong_in_an_outage_is_told_and_comes_back_at_the_latest_with_gnss() {
    let outage = (400.0, 460.0);
    let whole = fly(SURVEY, outage, &[NO_FLOW], SourceKind::Airspeed);
    assert!(whole.accused.is_empty(), "{:?}", whole.accused);
    for kind in ["scale=0.7", "zero"] {
        let judged =
            fly(SURVEY, outage, &[NO_FLOW, &format!("airspeed:{kind}@410..420")], SourceKind::Airspeed);
        assert_eq!((judged.accused.len(), judged.acquitted.len()), (1, 1), "{kind}");
        assert!((410.0..414.0).contains(&judged.accused[0]), "{kind}: {:?}", judged.accused);
        assert!((424.0..475.0).contains(&judged.acquitted[0]), "{kind}: {:?}", judged.acquitted);
        assert!(judged.error_m < 3.0 * judged.sigma_m, "{kind}: {} {}", judged.error_m, judged.sigma_m);
    }
}

#[test]
fn a_pitot_tube_that_goes_wrong_with_gnss_teaches_no_wind_and_comes_back() {
    let outage = (500.0, 560.0);
    for kind in ["scale=0.7", "zero"] {
        let judged =
            fly(SURVEY, outage, &[NO_FLOW, &format!("airspeed:{kind}@410..470")], SourceKind::Airspeed);
        assert_eq!((judged.accused.len(), judged.acquitted.len()), (1, 1), "{kind}");
        assert!((410.0..414.0).contains(&judged.accused[0]), "{kind}: {:?}", judged.accused);
        assert!((474.0..485.0).contains(&judged.acquitted[0]), "{kind}: {:?}", judged.acquitted);
        assert!(judged.error_m < 3.0 * judged.sigma_m, "{kind}: {} {}", judged.error_m, judged.sigma_m);
    }
}
