//! No sample allocates once the navigator has settled: what it remembers was allocated with it.

use std::collections::BTreeMap;

use crate::flight::Flight;
use allocation_counter::measure;
use holdover::navigator::Navigator;
use holdover::navigator::solution::Mode;
use holdover::sample::SampleKind;

/// By then every kind of sample has been judged in every way that the flight has for it, s.
const SETTLED_S: f64 = 100.0;
const LOST_S: f64 = 150.0;
/// Entering holdover is no steady state, s.
const ENTERED_S: f64 = 5.0;
const END_S: f64 = 200.0;

/// Samples by kind, and allocations among them, of the steady part of a flight; `outage` loses GNSS.
fn allocations(flight: &Flight, navigator: &mut Navigator, outage: bool) -> BTreeMap<SampleKind, (u64, u64)> {
    let mut counts = BTreeMap::new();
    let steady = if outage { LOST_S + ENTERED_S } else { SETTLED_S };
    let lost = if outage { LOST_S } else { f64::INFINITY };
    for step in &flight.steps {
        navigator.set_status(step.status);
        for sample in &step.samples {
            if sample.kind() == SampleKind::Gnss && step.t_s > lost {
                continue;
            }
            let allocated = measure(|| {
                navigator.ingest(sample);
            });
            let solved = measure(|| {
                navigator.solution();
            });
            if step.t_s > steady {
                let (samples, allocations) = counts.entry(sample.kind()).or_default();
                *samples += 1;
                *allocations += allocated.count_total + solved.count_total;
            }
        }
        navigator.drain_events().for_each(drop);
    }
    counts
}

fn nothing_allocates(flight: &Flight, outage: bool, kinds: &[SampleKind]) {
    let mut navigator = crate::flight::navigator(&[]);
    let counts = allocations(flight, &mut navigator, outage);
    assert_eq!(navigator.mode(), if outage { Mode::Holdover } else { Mode::Aided });
    for kind in kinds {
        let (samples, allocations) = counts[kind];
        assert!(samples > 100, "{kind:?}: {samples} samples");
        assert_eq!(allocations, 0, "{kind:?}: {allocations} allocations in {samples} samples");
    }
    assert_eq!(counts.contains_key(&SampleKind::Gnss), !outage);
}

const WING: [SampleKind; 6] = [
    SampleKind::Imu,
    SampleKind::Gnss,
    SampleKind::Flow,
    SampleKind::Mag,
    SampleKind::Airspeed,
    SampleKind::Pressure,
];
const ROTOR: [SampleKind; 6] = [
    SampleKind::Imu,
    SampleKind::Gnss,
    SampleKind::Flow,
    SampleKind::Mag,
    SampleKind::Range,
    SampleKind::Pressure,
];

#[test]
fn the_counter_counts() {
    assert_eq!(measure(|| drop(std::hint::black_box(vec![0u8; 100]))).count_total, 1);
}

#[test]
fn a_fixed_wing_allocates_nothing_with_gnss_and_without() {
    let flight = Flight::wing(0.01, END_S, 3);
    nothing_allocates(&flight, false, &WING);
    let without: Vec<_> = WING.into_iter().filter(|k| *k != SampleKind::Gnss).collect();
    nothing_allocates(&flight, true, &without);
}

#[test]
fn a_multirotor_allocates_nothing_with_gnss_and_without() {
    let flight = Flight::rotor(0.01, END_S, 3);
    nothing_allocates(&flight, false, &ROTOR);
    let without: Vec<_> = ROTOR.into_iter().filter(|k| *k != SampleKind::Gnss).collect();
    nothing_allocates(&flight, true, &without);
}
