//! What a step of an altimeter costs: `cargo bench --bench altimeter`. A step is half a second of prediction and a height of each
//! channel; it is measured where it falls in the paper's runs, and "item/s" is steps a second.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a benchmark that cannot go on has failed")]

use divan::Bencher;
use divan::counter::ItemsCount;
use holdover::altimeter::{
    Altimeter, AltimeterMethod, AltimeterSettings, Channel, ErrorModel, PublishedAltimeter,
};
use holdover::sim::altimeter::{AltimeterRun, FaultCase, FaultSize, STEP_S};

fn main() {
    divan::main();
}

const CASES: [FaultCase; 2] = [FaultCase::FaultFree, FaultCase::BaroNoisyGpsBiased];
const METHODS: [AltimeterMethod; 4] =
    [AltimeterMethod::Okf, AltimeterMethod::Rkf, AltimeterMethod::RkfJoseph, AltimeterMethod::Selector];

fn run(case: FaultCase) -> AltimeterRun {
    let size = FaultSize { bias_m: 20.0, variance_factor: 100.0 };
    AltimeterRun::draw(&ErrorModel::table_1(), case, size, 1, 0)
}

/// A whole run of the default altimeter.
#[divan::bench(args = CASES, sample_count = 200, sample_size = 1)]
fn tolerant_step(bencher: Bencher<'_, '_>, case: FaultCase) {
    let run = run(case);
    let begin = Altimeter::new(AltimeterSettings::table_1());
    bencher.counter(ItemsCount::new(run.steps.len())).with_inputs(|| begin.clone()).bench_local_values(
        |mut altimeter| {
            for step in &run.steps {
                altimeter.predict(STEP_S, 0.0, 0.0);
                for (channel, z) in [(Channel::Baro, step.z_ibi), (Channel::Gnss, step.z_iig)] {
                    if let Some(z) = z {
                        divan::black_box(altimeter.measure(channel, -z, None, 0.0));
                    }
                }
            }
            altimeter
        },
    );
}

/// The same of a published one.
#[divan::bench(args = METHODS, sample_count = 200, sample_size = 1)]
fn published_step(bencher: Bencher<'_, '_>, method: AltimeterMethod) {
    let run = run(FaultCase::BaroNoisyGpsBiased);
    let begin = PublishedAltimeter::new(ErrorModel::table_1(), method);
    bencher.counter(ItemsCount::new(run.steps.len())).with_inputs(|| begin.clone()).bench_local_values(
        |mut altimeter| {
            for step in &run.steps {
                divan::black_box(altimeter.step(STEP_S, step.z_ibi, step.z_iig));
            }
            altimeter
        },
    );
}

/// One IMU sample at 200 Hz, between two heights.
#[divan::bench(sample_count = 1000, sample_size = 50)]
fn predict(bencher: Bencher<'_, '_>) {
    let mut altimeter = Altimeter::new(AltimeterSettings::table_1());
    for step in &run(FaultCase::FaultFree).steps {
        altimeter.predict(STEP_S, 0.0, 0.0);
        altimeter.measure(Channel::Baro, -step.z_ibi.unwrap(), None, 0.0);
        altimeter.measure(Channel::Gnss, -step.z_iig.unwrap(), None, 0.0);
    }
    bencher.bench_local(|| altimeter.predict(0.005, divan::black_box(0.1), 0.0));
}
