//! A flow that is told in pixels only, of a lens and a mounting that nobody knows.

use std::path::Path;

use holdover::config::{Settings, Sources};
use holdover::log::Log;
use holdover::navigator::event::EventKind;
use holdover::replay::runner::Runner;
use holdover::sample::{FlowRotation, Input, Sample};
use holdover::time::Span;
use nalgebra::Complex;

/// A recorded flight whose flow, rotation and all, is told in pixels: z/c, mirrored or not. What a unit was found to be worth, whether the flow was trusted
/// then, and the error at the end of an outage, m.
fn fly(unit: Complex<f64>, mirrored: bool, noise: bool) -> (Option<f64>, bool, Option<f64>) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("sitl-logs/ardupilot-copter-gps-loss.tlog");
    let settings = Settings::load(&Sources::default()).unwrap().pipeline;
    let log = Log::open(&path, None).unwrap();
    let mut runner = Runner::new(&settings, &[(265.0, 325.0)]);
    runner.pipeline.follow(log.vehicle());
    let (mut turning, mut k) = ([0.0; 2], 0);
    log.play(
        |_, _| {},
        |clock, item| {
            let mut item = *item;
            match &mut item {
                Input::Sample(Sample::Imu(s)) => turning = [s.angular_rate.raw().x, s.angular_rate.raw().y],
                Input::Sample(Sample::Flow(s)) => {
                    assert_eq!(s.rotation, FlowRotation::Removed);
                    let seen = Complex::new(s.rate_xy[0] + turning[0], s.rate_xy[1] + turning[1]);
                    k += 1;
                    let seen = if noise {
                        Complex::new((7.0 * f64::from(k)).sin(), (5.0 * f64::from(k)).cos())
                    } else {
                        seen
                    };
                    let told = if mirrored { seen.conj() / unit } else { seen / unit };
                    (s.rate_xy, s.rotation) = ([told.re, told.im], FlowRotation::InOwnUnit);
                    s.interval = Span::from_millis(100);
                }
                _ => {}
            }
            runner.take(clock, &item);
        },
    )
    .unwrap();
    let found = runner.events().iter().find_map(|(_, e)| match e.kind {
        EventKind::FlowUnit(0, rad) => Some(rad),
        _ => None,
    });
    let trusted = runner.events().iter().any(|(_, e)| matches!(e.kind, EventKind::FlowTrusted(0)));
    (found, trusted, runner.outcome().outages[0].horizontal_error_end_m)
}

#[test]
fn what_a_pixel_is_worth_is_found_whatever_the_lens_and_however_it_is_mounted() {
    for (mrad, turned_deg, mirrored) in [(1.5, 0.0f64, false), (4.0, 90.0, false), (0.5, -125.0, true)] {
        let unit = Complex::from_polar(mrad * 1e-3, turned_deg.to_radians());
        let (found, trusted, error_m) = fly(unit, mirrored, false);
        let found = found.unwrap_or_else(|| panic!("{mrad} mrad: not found"));
        assert!((found / (mrad * 1e-3) - 1.0).abs() < 0.15, "{mrad}: {found}");
        assert!(trusted, "{mrad}");
        assert!(error_m.is_some_and(|e| e < 5.0), "{mrad}: {error_m:?}");
    }
}

#[test]
fn pixels_that_have_nothing_to_do_with_the_motion_are_never_used() {
    let (found, trusted, _) = fly(Complex::new(1.5e-3, 0.0), false, true);
    assert_eq!((found, trusted), (None, false));
}
