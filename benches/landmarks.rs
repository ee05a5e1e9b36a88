//! What the landmark filter costs: `cargo bench --bench landmarks`. Steps and sightings are those of a simulated flight over 10 markers with
//! everything running, 300 ms late, in the order in which they come; simulated beforehand.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a benchmark that cannot go on has failed")]

#[path = "../tests/support/marker_flight.rs"]
mod marker_flight;

use std::cell::RefCell;
use std::sync::OnceLock;

use divan::Bencher;
use holdover::landmark::{LandmarkFilter, LandmarkSettings, LandmarkSighting};
use holdover::sim::landmarks::LandmarkStep;
use holdover::sim::{LandmarkFlight, MarkerCamera, MarkerField, MotionNoise, Wander};
use marker_flight::{Case, motion, sighting, stamp};

fn main() {
    divan::main();
}

/// In the order in which the filter is told.
#[derive(Clone, Copy)]
enum Told {
    Step(LandmarkStep),
    Sighting(LandmarkSighting),
}

/// From then on is measured, s.
const FROM_S: f64 = 15.0;

/// How sightings come.
#[derive(Clone, Copy, Debug)]
enum Arrival {
    InOrder,
    /// Each picture up to 0.2 s later than the least: pictures overtake each other.
    Overtaking,
}

const ARRIVALS: [Arrival; 2] = [Arrival::InOrder, Arrival::Overtaking];

struct Prepared {
    filter: LandmarkFilter,
    told: Vec<Told>,
}

fn prepared(arrival: Arrival) -> &'static Prepared {
    static READY: [OnceLock<Prepared>; 2] = [OnceLock::new(), OnceLock::new()];
    READY[arrival as usize].get_or_init(|| {
        let jitter_s = if matches!(arrival, Arrival::Overtaking) { 0.2 } else { 0.0 };
        let camera = MarkerCamera { delay_s: 0.3, jitter_s, wrong_ids: 0.03, ..MarkerCamera::downward() };
        let case = Case {
            trajectory: &Wander::over_field(0.3),
            field: &MarkerField::scattered(7, 10, 4.0, 1.3),
            camera,
            noise: MotionNoise::mems(),
            settings: LandmarkSettings::default(),
            attitude_rad: None,
            tells_attitude: false,
            duration_s: 60.0,
            seed: 7,
        };
        let flight: LandmarkFlight = case.flight();
        let (mut filter, mut told) = (case.filter(&flight), Vec::new());
        let mut next = flight.seen.iter().peekable();
        for step in &flight.steps {
            told.push((step.truth.t_s, Told::Step(*step)));
            while let Some(seen) = next.next_if(|s| s.heard_s <= step.truth.t_s + 1e-9) {
                told.push((step.truth.t_s, Told::Sighting(sighting(seen))));
            }
        }
        let at = told.partition_point(|(t, _)| *t < FROM_S);
        told[..at].iter().for_each(|(_, t)| tell(&mut filter, t));
        assert!(filter.pose().is_some_and(|p| p.converged));
        Prepared { filter, told: told[at..].iter().map(|(_, t)| *t).collect() }
    })
}

fn tell(filter: &mut LandmarkFilter, told: &Told) {
    match told {
        Told::Step(step) => {
            filter.push(stamp(step.truth.t_s), &motion(step), Some(&step.down_body));
        }
        Told::Sighting(s) => {
            filter.sighting(s);
        }
    }
}

/// Those that `measured` picks, each after all that came before it, which is not timed.
fn each(bencher: Bencher<'_, '_>, arrival: Arrival, measured: impl Fn(&Told) -> bool + Sync) {
    let ready = prepared(arrival);
    let state = RefCell::new((ready.filter.clone(), 0));
    bencher
        .with_inputs(|| {
            let (filter, next) = &mut *state.borrow_mut();
            loop {
                let Some(told) = ready.told.get(*next) else {
                    (*filter, *next) = (ready.filter.clone(), 0);
                    continue;
                };
                *next += 1;
                if measured(told) {
                    return *told;
                }
                tell(filter, told);
            }
        })
        .bench_local_values(|told| tell(&mut state.borrow_mut().0, &told));
}

/// A tenth of the steps takes a direction of gravity as well.
#[divan::bench(sample_size = 1, sample_count = 5000)]
fn imu_step(bencher: Bencher<'_, '_>) {
    each(bencher, Arrival::InOrder, |t| matches!(t, Told::Step(_)));
}

#[divan::bench(args = ARRIVALS, sample_size = 1, sample_count = 5000)]
fn one_sighting(bencher: Bencher<'_, '_>, arrival: Arrival) {
    each(bencher, arrival, |t| matches!(t, Told::Sighting(_)));
}

#[divan::bench]
fn pose(bencher: Bencher<'_, '_>) {
    let filter = &prepared(Arrival::InOrder).filter;
    bencher.bench_local(|| filter.pose());
}
