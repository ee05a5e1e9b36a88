//! Who is believed: a source that is wrong does not take others with it, and what stands on a source asks for its health first.

use crate::bad_input::{FAULT_S, faulty, same_time};
use crate::flight::{ready_rotor, ready_wing};
use holdover::geo::Body;
use holdover::navigator::event::EventKind;
use holdover::navigator::solution::Mode;
use holdover::navigator::sources::status::{SourceHealth, SourceKind};
use holdover::sample::Sample;
use nalgebra::{Rotation3, Vector3};

/// A compass that is turned in flight misleads the observer, which is calm all the same; the filter, which every fix fits, stays.
#[test]
fn a_compass_that_is_turned_does_not_restart_a_filter_that_gnss_fits() {
    for (vehicle, ready) in [("wing", ready_wing()), ("rotor", ready_rotor())] {
        for turned_deg in [90.0f64, 180.0] {
            let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), turned_deg.to_radians());
            let turned = |_: f64, s: &Sample, out: &mut Vec<Sample>| {
                out.push(match s {
                    Sample::Mag(m) => {
                        let mut m = *m;
                        m.field = Body::new(turn * m.field.raw());
                        Sample::Mag(m)
                    }
                    other => *other,
                });
            };
            let mut seen =
                faulty(&format!("{vehicle}: compass turned by {turned_deg}"), ready, true, turned, same_time);
            seen.honest();
            let restarts = seen
                .navigator
                .drain_events()
                .filter(|e| matches!(e.kind, EventKind::FilterRestarted(_) | EventKind::Reset(_)))
                .count();
            assert_eq!(restarts, 0, "{vehicle}, {turned_deg}");
            assert!(seen.modes.iter().all(|(_, m)| *m == Mode::Aided), "{vehicle}: {:?}", seen.modes);
            assert!(seen.error_m < 8.0, "{vehicle}, {turned_deg}: {} m", seen.error_m);
        }
    }
}

/// A rangefinder that sees something else in an outage, with a good flow that is scaled by it.
fn ranged(name: &str, distance: impl Fn(f64, f64) -> f64) -> (f64, f64, SourceHealth) {
    let seen = faulty(
        name,
        ready_rotor(),
        false,
        |t, s, out| {
            out.push(match s {
                Sample::Range(r) => {
                    let mut r = *r;
                    r.distance_m = distance(t, r.distance_m);
                    Sample::Range(r)
                }
                other => *other,
            });
        },
        same_time,
    );
    let reports = seen.navigator.source_reports();
    let range = reports.iter().find(|r| r.kind == SourceKind::Rangefinder).unwrap();
    (seen.error_m, seen.horizontal.0, range.health)
}

#[test]
fn a_rangefinder_that_is_wrong_does_not_scale_the_flow() {
    let (right_m, ..) = ranged("range right", |_, d| d);
    type Distance = fn(f64, f64) -> f64;
    let wrong: [(&str, Distance); 4] = [
        ("range stuck at 2 m", |_, _| 2.0),
        ("range stuck at 0.7 m", |_, _| 0.7),
        ("range twice as far", |_, d| 2.0 * d),
        ("a roof of 4 m for 20 s", |t, d| if t < FAULT_S + 20.0 { d - 4.0 } else { d }),
    ];
    for (name, distance) in wrong {
        let (error_m, sigmas, health) = ranged(name, distance);
        assert!(error_m < 3.0 * right_m && sigmas < 3.0, "{name}: {error_m} m for {right_m}, {sigmas} sigma");
        if name.contains("stuck") {
            assert_eq!(health, SourceHealth::Faulty, "{name}");
        }
    }
}

/// A second rangefinder, sound, beside a first that is stuck: it takes over, and the first again when it is well.
#[test]
fn a_second_rangefinder_is_the_spare_of_the_first() {
    let seen = faulty(
        "range stuck at 2 m for 60 s, with a spare",
        ready_rotor(),
        false,
        |t, s, out| {
            out.push(*s);
            if let Sample::Range(r) = s {
                let mut first = *r;
                first.distance_m = if t < FAULT_S + 60.0 { 2.0 } else { r.distance_m };
                out.pop();
                out.push(Sample::Range(first));
                let mut spare = *r;
                spare.sensor = r.sensor + 1;
                out.push(Sample::Range(spare));
            }
        },
        same_time,
    );
    seen.honest();
    let reports = seen.navigator.source_reports();
    let ranges: Vec<_> = reports.iter().filter(|r| r.kind == SourceKind::Rangefinder).collect();
    assert_eq!(ranges.len(), 2);
    assert!(ranges[1].used > 1000 && ranges[1].health == SourceHealth::Healthy, "{:?}", ranges[1]);
    assert!(seen.error_m < 5.0, "{} m", seen.error_m);
}
