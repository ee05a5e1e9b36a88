//! What an outage claims is what this vehicle's own drift was while GNSS was there.

use holdover::navigator::Navigator;
use holdover::navigator::shadow::MeasuredDrift;
use holdover::navigator::solution::{Mode, VelocitySource};
use holdover::sample::{Sample, SampleKind};

use crate::flight::{Flight, navigator};

const PERIOD_S: f64 = 0.01;
/// Outages begin between these, s …
const FROM_S: f64 = 110.0;
const TO_S: f64 = 270.0;
/// … every so often, and last as long, s.
const EVERY_S: f64 = 16.0;
const OUTAGE_S: f64 = 30.0;
const END_S: f64 = 301.0;

/// Outages of a vehicle that has no flow and whose accelerometers are off by `force` (body x, m/s²): errors, and what was claimed, m; and
/// what had been measured by the end.
fn outages(force: impl Fn(f64) -> f64) -> (Vec<(f64, f64)>, Vec<MeasuredDrift>) {
    let flight = Flight::rotor(PERIOD_S, END_S, 3);
    let mut aided = navigator(&["drag.use=false"]);
    let mut forks: Vec<(f64, Navigator)> = Vec::new();
    let (mut found, mut next) = (Vec::new(), FROM_S);
    for step in &flight.steps {
        if step.t_s >= next && next <= TO_S {
            forks.push((step.t_s, aided.clone()));
            next += EVERY_S;
        }
        aided.set_status(step.status);
        forks.iter_mut().for_each(|(_, fork)| fork.set_status(step.status));
        for sample in &step.samples {
            let mut sample = *sample;
            if let Sample::Imu(s) = &mut sample {
                let mut felt = s.specific_force.raw();
                felt.x += force(step.t_s);
                s.specific_force = holdover::geo::Body::new(felt);
            }
            if sample.kind() == SampleKind::Flow {
                continue;
            }
            aided.ingest(&sample);
            for (_, fork) in forks.iter_mut().filter(|_| sample.kind() != SampleKind::Gnss) {
                fork.ingest(&sample);
            }
        }
        aided.drain_events().for_each(drop);
        forks.retain_mut(|(start, fork)| {
            fork.drain_events().for_each(drop);
            let over = step.t_s > *start + OUTAGE_S;
            if let Some(solution) = fork.solution().filter(|_| over) {
                let error = (solution.position.raw() - step.truth.position_ned).xy().norm();
                found.push((error, solution.horizontal_sigma_m()));
            }
            !over
        });
    }
    assert!(matches!(aided.mode(), Mode::Aided | Mode::Rejoining), "{:?}", aided.mode());
    (found, aided.measured_drift())
}

fn within_two_sigmas(found: &[(f64, f64)]) -> f64 {
    found.iter().filter(|(error, sigma)| *error <= 2.0 * sigma).count() as f64 / found.len() as f64
}

fn factor(measured: &[MeasuredDrift], after_s: f64) -> f64 {
    let of = |m: &&MeasuredDrift| m.source == VelocitySource::Inertial && m.after_s == after_s;
    measured.iter().find(of).map(|m| m.factor).unwrap()
}

#[test]
fn a_vehicle_worse_than_its_data_sheet_claims_what_it_is_and_a_sound_one_no_less_than_it_may() {
    // A force that the filter has no model for, and that no bias follows.
    let (rough, measured) = outages(|t_s| 0.4 * (0.35 * t_s).sin());
    assert!(rough.len() >= 8, "{}", rough.len());
    assert!(factor(&measured, 10.0) > 1.5, "{measured:?}");
    assert!(within_two_sigmas(&rough) >= 0.95, "{rough:?}");
    assert!(measured.iter().any(|m| m.after_s == 30.0 && m.times >= 1), "{measured:?}");

    let (sound, measured) = outages(|_| 0.0);
    assert!((0.5..1.5).contains(&factor(&measured, 10.0)), "{measured:?}");
    assert!(within_two_sigmas(&sound) >= 0.95, "{sound:?}");
    let mean_square =
        |found: &[(f64, f64)]| found.iter().map(|(e, s)| (e / s).powi(2)).sum::<f64>() / found.len() as f64;
    assert!(mean_square(&sound) > 1.0 / 9.0, "no more than three times as wide as it is: {sound:?}");
}

#[test]
fn a_copy_measures_the_same() {
    let flight = Flight::rotor(PERIOD_S, 90.0, 3);
    let mut one = navigator(&[]);
    let at = flight.steps.len() / 2 + 7;
    let give = |navigator: &mut Navigator, steps: &[crate::flight::Step]| {
        for step in steps {
            navigator.set_status(step.status);
            step.samples.iter().for_each(|s| {
                navigator.ingest(s);
            });
            navigator.drain_events().for_each(drop);
        }
    };
    give(&mut one, &flight.steps[..at]);
    let mut other = one.clone();
    give(&mut one, &flight.steps[at..]);
    give(&mut other, &flight.steps[at..]);
    assert!(one.measured_drift().iter().any(|m| m.times > 2), "{:?}", one.measured_drift());
    assert_eq!(one.measured_drift(), other.measured_drift());
    assert_eq!(one.solution(), other.solution());
}
