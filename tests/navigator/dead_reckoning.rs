//! Ten minutes without GNSS in simulation: what the shipped filter promises, and that it is better than coasting and than the observers.
//! Seeds that `--example paper_dead_reckoning` shows by default; all of them stand in the README.

use crate::data_sheet::data_sheet;
use crate::flight::{self, Step, masked_from};
use holdover::metrics::nees::NeesCount;
use holdover::navigator::Navigator;
use holdover::sample::SampleKind;
use holdover::sim::{Scenario, SensorSuite, Simulation};

struct Flown {
    drift_percent: f64,
    holdover: NeesCount,
}

fn fly(scenario: Scenario, mems: bool, seed: u64, set: &[&str]) -> Flown {
    let mut overrides = data_sheet(mems);
    overrides.extend(set.iter().map(|s| (*s).to_owned()));
    let set: Vec<&str> = overrides.iter().map(String::as_str).collect();
    let mut navigator = flight::navigator(&set);
    let (from_s, _) = scenario.outage_s.unwrap();
    let suite = if mems { SensorSuite::mems() } else { SensorSuite::tactical() };
    let simulation = Simulation::new(scenario, suite, seed);
    navigator.set_origin(Simulation::ap_time(0.0), simulation.frame().origin());
    let mut holdover = NeesCount::default();
    let (mut distance_m, mut last) = (0.0, None::<nalgebra::Vector2<f64>>);
    let look = |navigator: &mut Navigator, step: &Step| {
        if step.t_s < from_s {
            return;
        }
        let at = step.truth.position_ned.xy();
        distance_m += last.map_or(0.0, |l| (at - l).norm());
        last = Some(at);
        if step.samples.iter().any(|s| s.kind() == SampleKind::Gnss) {
            let s = navigator.solution().unwrap();
            let p = s.position_covariance.raw().fixed_view::<2, 2>(0, 0).into_owned();
            holdover.add(&(s.position.raw().xy() - at), &p);
        }
    };
    flight::fly(&mut navigator, flight::steps(simulation), masked_from(from_s), look);
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
    let baseline = straight(&["navigator.estimator=ekf15", "magnetometer.use=false"]);
    let inertial = straight(&["navigator.estimator=inertial"]);
    assert!(2.0 * shipped < baseline && 2.0 * baseline < inertial, "{shipped} {baseline} {inertial} %");
}
