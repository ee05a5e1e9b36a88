//! What the navigator costs: `cargo bench`. Every sample is measured where it falls in a flight with everything running, so the caches hold
//! what they hold in service; the samples were simulated beforehand.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a benchmark that cannot go on has failed")]

#[path = "../tests/support/flight.rs"]
mod flight;

use std::cell::RefCell;
use std::sync::OnceLock;

use divan::Bencher;
use divan::counter::ItemsCount;
use flight::Step;
use holdover::navigator::Navigator;
use holdover::navigator::solution::Mode;
use holdover::sample::{Sample, SampleKind};

/// IMU period, s: 200 Hz.
const PERIOD_S: f64 = 0.005;
/// By then the navigator is aided, and GNSS ends where it is to end, s.
const LEARNED_S: f64 = 120.0;
/// From then on is measured, s.
const FROM_S: f64 = 130.0;
/// The end of the flights, s.
const TO_S: f64 = 190.0;

fn main() {
    divan::main();
}

/// Which flight, and whether GNSS ends after [`LEARNED_S`].
#[derive(Clone, Copy, Debug, PartialEq)]
enum Flight {
    WingAided,
    WingHoldover,
    RotorAided,
    RotorHoldover,
}

const ALL: [Flight; 4] = [Flight::WingAided, Flight::WingHoldover, Flight::RotorAided, Flight::RotorHoldover];
const AIDED: [Flight; 2] = [Flight::WingAided, Flight::RotorAided];
const WINGS: [Flight; 2] = [Flight::WingAided, Flight::WingHoldover];

impl Flight {
    fn flown(self) -> &'static flight::Flight {
        static WING: OnceLock<flight::Flight> = OnceLock::new();
        static ROTOR: OnceLock<flight::Flight> = OnceLock::new();
        match self {
            Flight::WingAided | Flight::WingHoldover => {
                WING.get_or_init(|| flight::Flight::wing(PERIOD_S, TO_S, 1))
            }
            Flight::RotorAided | Flight::RotorHoldover => {
                ROTOR.get_or_init(|| flight::Flight::rotor(PERIOD_S, TO_S, 1))
            }
        }
    }

    fn is_heard(self, t_s: f64, sample: &Sample) -> bool {
        let ended = matches!(self, Flight::WingHoldover | Flight::RotorHoldover) && t_s > LEARNED_S;
        !(ended && sample.kind() == SampleKind::Gnss)
    }

    /// Flies to where the measuring begins; the rest of the flight comes along.
    fn ready(self) -> (Navigator, &'static [Step]) {
        let steps = &self.flown().steps;
        let at = steps.partition_point(|s| s.t_s < FROM_S);
        let mut navigator = flight::navigator(&[]);
        for step in &steps[..at] {
            self.step(&mut navigator, step);
        }
        let mode = match self {
            Flight::WingAided | Flight::RotorAided => Mode::Aided,
            Flight::WingHoldover | Flight::RotorHoldover => Mode::Holdover,
        };
        assert_eq!(navigator.mode(), mode);
        (navigator, &steps[at..])
    }

    fn step(self, navigator: &mut Navigator, step: &Step) {
        navigator.set_status(step.status);
        for sample in step.samples.iter().filter(|s| self.is_heard(step.t_s, s)) {
            navigator.ingest(sample);
        }
        navigator.drain_events().for_each(drop);
    }
}

/// Samples of one kind, each after all that came before it in the flight, which is not timed.
fn one(bencher: Bencher<'_, '_>, flight: Flight, kind: SampleKind) {
    let (begin, steps) = flight.ready();
    let samples: Vec<Sample> =
        steps.iter().flat_map(|s| s.samples.iter().filter(|x| flight.is_heard(s.t_s, x))).copied().collect();
    let state = RefCell::new((begin.clone(), 0));
    bencher
        .with_inputs(|| {
            let (navigator, next) = &mut *state.borrow_mut();
            loop {
                let Some(sample) = samples.get(*next) else {
                    (*navigator, *next) = (begin.clone(), 0);
                    continue;
                };
                *next += 1;
                if sample.kind() == kind {
                    return *sample;
                }
                navigator.ingest(sample);
            }
        })
        .bench_local_values(|sample| state.borrow_mut().0.ingest(&sample));
}

#[divan::bench(args = ALL, sample_size = 1, sample_count = 5000)]
fn imu(bencher: Bencher<'_, '_>, flight: Flight) {
    one(bencher, flight, SampleKind::Imu);
}

#[divan::bench(args = AIDED, sample_size = 1, sample_count = 1000)]
fn gnss(bencher: Bencher<'_, '_>, flight: Flight) {
    one(bencher, flight, SampleKind::Gnss);
}

#[divan::bench(args = ALL, sample_size = 1, sample_count = 3000)]
fn flow(bencher: Bencher<'_, '_>, flight: Flight) {
    one(bencher, flight, SampleKind::Flow);
}

#[divan::bench(args = ALL, sample_size = 1, sample_count = 3000)]
fn magnetometer(bencher: Bencher<'_, '_>, flight: Flight) {
    one(bencher, flight, SampleKind::Mag);
}

#[divan::bench(args = WINGS, sample_size = 1, sample_count = 3000)]
fn airspeed(bencher: Bencher<'_, '_>, flight: Flight) {
    one(bencher, flight, SampleKind::Airspeed);
}

#[divan::bench(args = ALL, sample_size = 1, sample_count = 3000)]
fn pressure(bencher: Bencher<'_, '_>, flight: Flight) {
    one(bencher, flight, SampleKind::Pressure);
}

/// All of it, over the IMU samples that are in it: "item/s" is IMU samples a second.
#[divan::bench(args = ALL, sample_count = 20, sample_size = 1)]
fn flight_per_imu_sample(bencher: Bencher<'_, '_>, flight: Flight) {
    let (begin, steps) = flight.ready();
    bencher.counter(ItemsCount::new(steps.len())).with_inputs(|| begin.clone()).bench_local_values(
        |mut navigator| {
            for step in steps {
                flight.step(&mut navigator, step);
            }
            navigator
        },
    );
}

/// The same, with the solution asked for after every IMU sample.
#[divan::bench(args = ALL, sample_count = 20, sample_size = 1)]
fn flight_with_solutions(bencher: Bencher<'_, '_>, flight: Flight) {
    let (begin, steps) = flight.ready();
    bencher.counter(ItemsCount::new(steps.len())).with_inputs(|| begin.clone()).bench_local_values(
        |mut navigator| {
            for step in steps {
                flight.step(&mut navigator, step);
                divan::black_box(navigator.solution());
            }
            navigator
        },
    );
}
