//! Ten minutes without GNSS in simulation: what the shipped filter promises, and that it is better than coasting and than the observers.
//! Seeds that `--example paper_dead_reckoning` shows by default; all of them stand in the README.

use holdover::config::{Settings, Sources};
use holdover::metrics::nees::NeesCount;
use holdover::navigator::Navigator;
use holdover::sample::Sample;
use holdover::sim::{Scenario, SensorSuite, Simulation};

struct Flown {
    drift_percent: f64,
    holdover: NeesCount,
}

fn fly(scenario: Scenario, mems: bool, seed: u64, set: &[&str]) -> Flown {
    let mut overrides = crate::data_sheet::data_sheet(mems);
    overrides.extend(set.iter().map(|s| (*s).to_owned()));
    let settings = Settings::load(&Sources { overrides, ..Sources::default() }).unwrap();
    let mut navigator = Navigator::new(settings.pipeline.navigator);
    let (from_s, _) = scenario.outage_s.unwrap();
    let suite = if mems { SensorSuite::mems() } else { SensorSuite::tactical() };
    let simulation = Simulation::new(scenario.clone(), suite, seed);
    let origin = simulation.frame().origin();
    let mut holdover = NeesCount::default();
    let (mut distance_m, mut last) = (0.0, None::<nalgebra::Vector2<f64>>);
    for (k, reading) in simulation.enumerate() {
        if k == 0 {
            navigator.set_origin(reading.time, origin);
        }
        navigator.set_status(scenario.status(reading.t_s));
        let out = reading.t_s >= from_s;
        for sample in reading.samples.iter() {
            match sample {
                Sample::Gnss(fix) if out => navigator.mask_gnss(fix.time),
                other => {
                    navigator.ingest(other);
                }
            }
        }
        navigator.drain_events().for_each(drop);
        if out {
            let at = reading.truth.position_ned.xy();
            distance_m += last.map_or(0.0, |l| (at - l).norm());
            last = Some(at);
            if k % 100 == 0 {
                let s = navigator.solution().unwrap();
                let p = s.position_covariance.raw().fixed_view::<2, 2>(0, 0).into_owned();
                holdover.add(&(s.position.raw().xy() - at), &p);
            }
        }
    }
    let error_m = (navigator.solution().unwrap().position.raw().xy() - last.unwrap()).norm();
    assert!(distance_m > 14_000.0);
    Flown { drift_percent: 100.0 * error_m / distance_m, holdover }
}

#[test]
fn the_shipped_filter_keeps_to_a_fraction_of_a_percent_and_knows_it() {
    let mut all = NeesCount::default();
    for (scenario, limit) in
        [(Scenario::circles(), 0.3), (Scenario::legs(), 0.3), (Scenario::straight(), 0.6)]
    {
        for mems in [false, true] {
            let flown = fly(scenario.clone(), mems, 3, &[]);
            assert!(flown.drift_percent < limit, "{} {mems}: {} %", scenario.name, flown.drift_percent);
            all = all.merged(flown.holdover);
        }
    }
    let (mean, inside) = (all.mean().unwrap(), all.in_bounds().unwrap());
    assert!(mean < 4.0 && inside > 0.85, "NEES {mean}, {inside} of it within its 95 % bounds");
}

#[test]
fn the_baseline_and_coasting_are_worse_on_a_mems_imu() {
    let straight = |set: &[&str]| fly(Scenario::straight(), true, 1, set).drift_percent;
    let shipped = straight(&[]);
    let baseline = straight(&["observer.estimator=ekf15", "magnetometer.use=false"]);
    let inertial = straight(&["observer.estimator=inertial"]);
    assert!(2.0 * shipped < baseline && 2.0 * baseline < inertial, "{shipped} {baseline} {inertial} %");
}
