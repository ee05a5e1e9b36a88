//! Holes of seconds, of a minute and of ten in recorded flights: the height stays one, and every position is as sure as it claims to be.

use std::path::Path;

use crate::command::{COPTER, PX4, holdover, sitl_log};
use holdover::config::{Settings, Sources};
use holdover::log::Log;
use holdover::metrics::ReferenceState;
use holdover::navigator::event::EventKind;
use holdover::navigator::solution::Mode;
use holdover::replay::runner;
use holdover::sample::{Input, Reference};

/// Worst errors after a hole, in sigmas: horizontal position, and height.
#[derive(Debug, Default)]
struct Worst {
    horizontal: f64,
    height: f64,
    height_m: f64,
    sigma_m: f64,
    compared: u32,
}

/// Flies over a hole of everything, from when to when, and without GNSS for some seconds after it.
fn over_a_hole(flight: &str, from_s: f64, seconds: f64, denied_s: f64) -> Worst {
    let what = format!("{flight}: {seconds} s from {from_s} s on, and {denied_s} s without GNSS");
    let settings = Settings::load(&Sources::default()).unwrap();
    let log = Log::open(&sitl_log(flight), None).unwrap();
    let to_s = from_s + seconds;
    let fault = format!("all:drop@{from_s}..{to_s}").parse().unwrap();
    let mut worst = Worst::default();
    let watch = |r: &runner::Runner, _: &_, item: &Input, _: &[_]| {
        let Input::Reference(Reference::Truth(truth)) = item else { return };
        let (Some(frame), Some(s)) = (r.pipeline.navigator.frame(), r.solution()) else { return };
        let Some(state) = ReferenceState::from_truth(truth, frame) else { return };
        let after_s = r.seconds(s.time) - to_s;
        if !(0.0..60.0).contains(&after_s)
            || s.mode == Mode::Aligning
            || truth.time.seconds_since(s.time).abs() > 0.2
        {
            return;
        }
        let off = s.position.raw() - state.position_ned;
        // How far the vehicle goes between a solution and the truth.
        let [p, h] =
            [s.horizontal_sigma_m(), s.position_covariance.raw()[(2, 2)].sqrt()].map(|m| m.hypot(1.0));
        worst.horizontal = worst.horizontal.max(off.xy().norm() / p);
        worst.height = worst.height.max(off.z.abs() / h);
        worst.height_m = worst.height_m.max(off.z.abs());
        worst.sigma_m = worst.sigma_m.max(s.horizontal_sigma_m());
        worst.compared += 1;
    };
    let outage = [(from_s, to_s + denied_s)];
    let (runner, _) = runner::run(&log, &settings.pipeline, &outage, &[fault], |_| {}, watch).unwrap();
    let after = || runner.events().iter().filter(|(t_s, _)| (from_s..to_s + 60.0).contains(t_s));
    assert!(worst.compared > 50, "{what}: {worst:?}");
    assert!(
        after().any(|(_, e)| matches!(e.kind, EventKind::Bridged(gap_s) if gap_s > seconds - 1.0)),
        "{what}"
    );
    assert!(worst.height < 4.0 && worst.height_m < 60.0, "{what}: {worst:?}");
    assert!(worst.horizontal < 4.0, "{what}: {worst:?}");
    let jumped = after().find(|(_, e)| matches!(e.kind, EventKind::HeightReset(m) if m.abs() > 60.0));
    assert!(jumped.is_none(), "{what}: {jumped:?}");
    let faults = after().filter(|(_, e)| matches!(e.kind, EventKind::HeightFault { .. })).count();
    assert_eq!(faults, 0, "{what}: a height that was not seen for a while is no fault");
    worst
}

#[test]
fn over_a_hole_of_any_length_position_and_height_are_what_they_claim() {
    for (flight, starts_s) in [(COPTER, [40.0, 260.0]), (PX4, [60.0, 255.0])] {
        for from_s in starts_s {
            for seconds in [5.0, 60.0] {
                for denied_s in [2.0, 30.0] {
                    over_a_hole(flight, from_s, seconds, denied_s);
                }
            }
        }
    }
    for (from_s, seconds) in [(200.0, 5.0), (300.0, 60.0), (700.0, 60.0), (200.0, 600.0), (800.0, 600.0)] {
        let worst = over_a_hole("ardupilot-plane-survey-light", from_s, seconds, 20.0);
        // Who flies at 20 m/s is somewhere within what that leads to, and nowhere else.
        let reach_m = 20.0 * seconds;
        assert!((0.2..2.5).contains(&(worst.sigma_m / reach_m)) || seconds < 10.0, "{from_s} s: {worst:?}");
    }
}

/// A wing in gusts is far from where it was when GNSS comes back; what a height then says of the horizontal position moves what is remembered as well.
#[test]
fn a_wing_in_gusts_goes_to_a_receiver_that_comes_back_and_not_beyond_it() {
    let log = Path::new(env!("CARGO_MANIFEST_DIR")).join("sitl-logs/ardupilot-plane-gusts.tlog.zst");
    let mut arguments = vec!["stress", log.to_str().unwrap(), "--starts", "4", "--with-gnss", "--json"];
    for hole in ["imu:freeze@15..40", "all:drop@15..35", "imu:freeze@5..30", "all:drop@20..40"] {
        arguments.extend(["--fault", hole]);
    }
    let report = holdover(&arguments).json();
    let rows = report["logs"][0]["rows"].as_array().unwrap();
    assert!(rows.len() == 16, "{}", rows.len());
    for row in rows {
        assert!(row["worst_sigmas"].as_f64().unwrap() < 4.5, "{row}");
    }
}
