//! What the observers promise, on closed-form trajectories: convergence from any attitude, and going on without GNSS.

use crate::flight::white;
use crate::observing::{FAST_S, Observer, Run, cessna, measure, rms, run, settled, wrong_by, wrong_yaw};
use holdover::observer::*;
use holdover::sim::models::{FlowModel, GnssModel, ImuModel};
use holdover::sim::{Scenario, SensorSuite, Trajectory};
use nalgebra::Vector3;

fn circle() -> Scenario {
    Scenario::circle(300.0, 25.0, 40.0)
}

fn tactical() -> SensorSuite {
    white(ImuModel::tactical())
}

fn mems() -> SensorSuite {
    white(ImuModel::mems())
}

/// With these velocity biases of the flow, m/s.
fn with_flow_bias(suite: SensorSuite, ahead_mps: f64, right_mps: f64) -> SensorSuite {
    let bias_mps = Vector3::new(ahead_mps, right_mps, 0.0);
    SensorSuite { flow: suite.flow.map(|f| FlowModel { bias_mps, ..f }), ..suite }
}

const SEEDS: u64 = 24;

/// Starts from 40° to 180°, every other one at 180°; the worst times to the first crossing of 5° and to staying below 10°.
fn worst_convergence(observer: &Observer, suite: SensorSuite) -> (f64, f64) {
    let mut worst = (0.0f64, 0.0f64);
    for scenario in [circle(), Scenario::figure_eight()] {
        let truth = scenario.at(0.0).r_body_to_ned;
        for seed in 0..SEEDS {
            let angle = if seed % 2 == 0 { 180.0 } else { 40.0 + 6.0 * seed as f64 };
            let what = Run::new(&scenario, suite, seed, 60.0);
            let points = run(&what, observer, observer, wrong_by(&truth, angle, seed));
            let first = points.iter().find(|p| p.angle < 5f64.to_radians()).map_or(f64::INFINITY, |p| p.t);
            worst = (worst.0.max(first), worst.1.max(settled(&points, 10.0)));
        }
    }
    worst
}

#[test]
fn fusini_finds_any_attitude_in_seconds_with_flow() {
    for suite in [tactical(), mems()] {
        let observer = Observer::Fusini(FusiniParams::start_up(), false, 1.0);
        let (first, stays) = worst_convergence(&observer, suite);
        println!("Fusini, flow: below 5 deg at {first:.1} s, stays below 10 deg from {stays:.1} s");
        assert!(first < 10.0 && stays < 10.0, "{first} {stays}");
    }
}

#[test]
fn without_the_gate_the_bias_winds_up() {
    let ungated = FusiniParams { gate: None, ..FusiniParams::tuned() };
    let (first, _) = worst_convergence(&Observer::Fusini(ungated, false, 1.0), tactical());
    println!("Fusini, flow, ungated: {first:.1} s");
    assert!(first > 20.0);
}

#[test]
fn both_observers_find_any_attitude_with_the_magnetometer() {
    for suite in [tactical(), mems()] {
        for (name, observer) in [
            ("Grip", Observer::Grip(GripParams::start_up())),
            ("Fusini", Observer::Fusini(FusiniParams::start_up(), true, 1.0)),
        ] {
            let (first, stays) = worst_convergence(&observer, suite);
            println!(
                "{name}, magnetometer: below 5 deg at {first:.1} s, stays below 10 deg from {stays:.1} s"
            );
            // The field dips by 75° here, and every turn takes the specific force past it: some seconds a turn say nothing.
            assert!(first < 42.0 && stays < 42.0, "{name}: {first} {stays}");
        }
    }
}

/// Grip from 165° off: the start-up parameters for 30 s, then KM. RMS errors after 120 s: attitude, °; position, m; velocity, m/s.
fn grip_staged(change: impl Fn(&mut Run)) -> [f64; 3] {
    let scenario = Scenario::figure_eight();
    let mut what = Run { staged_s: 30.0, ..Run::new(&scenario, tactical(), 3, 300.0) };
    change(&mut what);
    let start = wrong_by(&scenario.at(0.0).r_body_to_ned, 165.0, 3);
    let (first, then) = (Observer::Grip(GripParams::start_up()), Observer::Grip(GripParams::km()));
    let points = run(&what, &first, &then, start);
    let angle = rms(&points, 120.0, |p| p.angle).to_degrees();
    let position = rms(&points, 120.0, |p| p.position.norm());
    let velocity = rms(&points, 120.0, |p| p.velocity.norm());
    let yaw = rms(&points, 120.0, |p| p.euler.z).to_degrees();
    let bias = rms(&points, 120.0, |p| p.bias).to_degrees();
    println!("Grip: {angle:.3} deg (yaw {yaw:.3}), {position:.2} m, {velocity:.3} m/s, bias {bias:.4} deg/s");
    [angle, position, velocity]
}

#[test]
fn grip_reaches_its_steady_state_from_the_wrong_way_round() {
    let [angle, position, velocity] = grip_staged(|_| {});
    assert!(angle < 1.5 && position < 1.6 && velocity < 0.35, "{angle} {position} {velocity}");
}

#[test]
fn a_latency_of_200_ms_costs_next_to_nothing() {
    let timely = grip_staged(|_| {});
    let late = grip_staged(|run| run.suite.gnss = run.suite.gnss.map(|g| GnssModel { latency_s: 0.2, ..g }));
    assert!(late[0] < timely[0] + 0.2 && late[1] < 1.15 * timely[1], "{timely:?} {late:?}");
}

#[test]
fn position_alone_is_enough_for_grip() {
    let [angle, position, velocity] = grip_staged(|run| run.with_gnss_velocity = false);
    assert!(angle < 3.0 && position < 2.5 && velocity < 1.0, "{angle} {position} {velocity}");
}

#[test]
fn grip_flies_its_papers_flight_as_well_as_can_be_asked() {
    let scenario = Scenario::cessna();
    let gains = TranslationGains::soft();
    let first = Observer::Grip(GripParams { gains, ..GripParams::start_up() });
    let then = Observer::Grip(GripParams { gains, ..GripParams::km() });
    for seed in 1..=4 {
        let what = Run { staged_s: FAST_S, ..cessna(&scenario, seed) };
        let got = measure(&run(&what, &first, &then, wrong_yaw(&scenario)));
        println!("roll, pitch, yaw deg, p m, v m/s, bias s: {got:.3?}");
        for (got, most) in got.iter().zip([0.1, 0.1, 0.3, 1.0, 0.2, 75.0]) {
            assert!(*got <= most, "{got} {most}");
        }
    }
}

/// Two minutes of dead reckoning after two with GNSS, 20° off at the start: drift in % of distance, and RMS yaw of the last minute in °.
fn drift(scenario: &Scenario, suite: SensorSuite, magnetic: bool, seed: u64) -> (f64, f64) {
    let flow_bias_from_s =
        if suite.flow.is_some_and(|f| f.bias_mps.norm() > 0.0) { 60.0 } else { f64::INFINITY };
    let what =
        Run { outage_s: 120.0, flow_bias_from_s, staged_s: 30.0, ..Run::new(scenario, suite, seed, 240.0) };
    let start = wrong_by(&scenario.at(0.0).r_body_to_ned, 20.0, seed);
    let first = Observer::Fusini(FusiniParams::start_up(), magnetic, 1.0);
    let then = Observer::Fusini(FusiniParams::tuned(), magnetic, if magnetic { 1.0 } else { 0.1 });
    let points = run(&what, &first, &then, start);
    let flown = points.iter().filter(|p| p.t >= 120.0);
    let distance: f64 = flown.map(|p| 0.01 * scenario.at(p.t).velocity_ned.xy().norm()).sum();
    let altitude = rms(&points, 130.0, |p| p.position.z);
    assert!(altitude < 1.0, "the altimeter holds the vertical: {altitude} m");
    let end = points[points.len() - 1].position.xy().norm();
    (100.0 * end / distance, rms(&points, 180.0, |p| p.euler.z).to_degrees())
}

fn cruise() -> SensorSuite {
    with_flow_bias(tactical(), 0.2, 0.1)
}

#[test]
fn dead_reckoning_drifts_by_a_few_percent() {
    let straight = Scenario::northwards(25.0, 20.0);
    for (name, scenario) in
        [("circle", circle()), ("straight", straight), ("eight", Scenario::figure_eight())]
    {
        for magnetic in [false, true] {
            let runs: Vec<(f64, f64)> = (0..6).map(|s| drift(&scenario, cruise(), magnetic, s)).collect();
            let worst = runs.iter().map(|r| r.0).fold(0.0, f64::max);
            println!("{name}, magnetometer {magnetic}: drift %, yaw deg {runs:.2?}");
            assert!(worst < if magnetic { 5.0 } else { 2.0 }, "{name} {magnetic}: {worst} %");
        }
    }
}

#[test]
fn a_hovering_vehicle_needs_the_magnetic_triad() {
    let square = Scenario::corners();
    let suite = with_flow_bias(mems(), 0.0, 0.0);
    for seed in 0..4 {
        let (_, yaw_flow) = drift(&square, suite, false, seed);
        let (percent, yaw) = drift(&square, suite, true, seed);
        println!(
            "square with hovers: {percent:.2} %, yaw {yaw:.2} deg; by the flow triad yaw {yaw_flow:.2} deg"
        );
        assert!(yaw < 2.5 && percent < 3.0 && yaw_flow > 2.0 * yaw);
    }
}
