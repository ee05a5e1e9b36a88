//! Several patches of one image through the navigator: stacked, outvoted when they lie, solved without those that do not come.

use crate::flight::{self, Step};
use holdover::camera::{View, ground_point, interaction_matrix};
use holdover::geo::CameraMount;
use holdover::navigator::Navigator;
use holdover::navigator::solution::{Mode, VelocitySource};
use holdover::navigator::verdict::{Reason, Verdict};
use holdover::sample::{FlowRotation, FlowSample, Sample, SampleKind, VehicleStatus};
use holdover::sim::models::{GnssModel, ImuModel, MagnetometerModel};
use holdover::sim::{Scenario, SensorSuite, Simulation, Trajectory, Truth};
use holdover::time::{AutopilotTime, Span};
use nalgebra::{Vector2, Vector6};
use proptest::prelude::*;

const PATCHES: &str = "flow.patches=[\
    {id=11,right_deg=-18,forward_deg=14}, {id=12,right_deg=18,forward_deg=14}, \
    {id=13,right_deg=-18,forward_deg=-14}, {id=14,right_deg=18,forward_deg=-14}]";

fn at(t: f64) -> AutopilotTime {
    Simulation::ap_time(t)
}

/// What a patch really sees: sensor id, centre, truth.
fn patch(sensor: u8, truth: &Truth, height_m: f64, time: AutopilotTime) -> FlowSample {
    let (right, forward) = [(-18.0, 14.0), (18.0, 14.0), (-18.0, -14.0), (18.0, -14.0)]
        .map(|(r, f): (f64, f64)| (r.to_radians().tan(), f.to_radians().tan()))[usize::from(sensor) - 11];
    let view = View::mounted(1.0, &CameraMount::downward(), &truth.r_body_to_ned, height_m);
    let point = ground_point(&view, &Vector2::new(right, -forward)).unwrap();
    let (v, w) = (truth.velocity_body(), truth.body_rate);
    let flow = -(interaction_matrix(1.0, &point) * Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z));
    FlowSample {
        time,
        sensor,
        interval: Span::ZERO,
        rate_xy: [flow.x, flow.y],
        rotation: FlowRotation::Contained,
        quality: 1.0,
        distance_m: Some(height_m / truth.r_body_to_ned[(2, 2)]),
    }
}

/// No flow of its own, and fixes without errors.
fn suite() -> SensorSuite {
    let gnss = Some(GnssModel { claims: [1.0, 1.5, 0.1], ..GnssModel::ideal() });
    let magnetometer = Some(MagnetometerModel { noise_t: 0.3e-6, ..MagnetometerModel::ideal() });
    SensorSuite { gnss, magnetometer, flow: None, ..flight::white(ImuModel::tactical()) }
}

struct Flown {
    navigator: Navigator,
    /// Horizontal error at the end, m.
    error_m: f64,
}

/// Flies the square with GNSS until `lost_s` and then without until the end. `camera` brings what the camera sends at a time.
fn fly(
    duration_s: f64,
    lost_s: f64,
    overrides: &[&str],
    camera: &dyn Fn(&mut Navigator, &Truth, f64, f64),
) -> Flown {
    let mut navigator = flight::navigator(overrides);
    let simulation = Simulation::new(Scenario::corners().lasting(duration_s), suite(), 1);
    let (frame, environment) = (simulation.frame().clone(), simulation.scenario().environment);
    let mut truth = simulation.truth(0.0);
    let steps = flight::steps(simulation).map(|step| Step { status: VehicleStatus::default(), ..step });
    let give = |navigator: &mut Navigator, step: &Step, sample: &Sample| {
        if step.t_s < lost_s || sample.kind() != SampleKind::Gnss {
            navigator.ingest(sample);
        }
    };
    let mut pictures = 0.0;
    flight::fly(&mut navigator, steps, give, |navigator, step| {
        truth = step.truth;
        if step.t_s > 0.1 * (pictures + 1.0) - 1e-6 {
            pictures += 1.0;
            camera(navigator, &truth, environment.height(&truth), step.t_s);
        }
    });
    let shift = frame.to_ned(&navigator.frame().unwrap().origin());
    let error_m = (navigator.solution().unwrap().position.raw() + shift - truth.position_ned).xy().norm();
    Flown { navigator, error_m }
}

fn all(navigator: &mut Navigator, truth: &Truth, height_m: f64, t: f64) {
    for (i, sensor) in (11..=14).enumerate() {
        let verdict = navigator.ingest(&Sample::Flow(patch(sensor, truth, height_m, at(t))));
        assert_eq!(verdict == Verdict::Waiting, i < 3, "{verdict:?}");
    }
}

const FIXED: [&str; 2] = [PATCHES, "gnss.delay_ms=0"];

#[test]
fn stacked_patches_are_one_sensor_that_carries() {
    let flown = fly(160.0, 100.0, &FIXED, &all);
    let solution = flown.navigator.solution().unwrap();
    assert_eq!((solution.mode, solution.velocity_source), (Mode::Holdover, VelocitySource::Flow));
    assert!(flown.error_m < 2.5, "{}", flown.error_m);
    let ids: Vec<u8> = flown.navigator.flow_sensors().map(|(id, ..)| id).collect();
    assert_eq!(ids, [11]);
    let tally = flown.navigator.statuses();
    let rejected: u64 = tally.rejected(SampleKind::Flow).map(|(_, n)| n).sum();
    assert_eq!(tally.used(SampleKind::Flow) + rejected, 4 * 1600, "every message is counted once");
}

#[test]
fn a_patch_that_lies_is_outvoted() {
    let flown = fly(160.0, 100.0, &FIXED, &|navigator, truth, height, t| {
        for sensor in 11..=14 {
            let mut sample = patch(sensor, truth, height, at(t));
            if t > 100.0 && sensor == 13 {
                // Something hangs before the lens and moves.
                sample.rate_xy = [1.5, -1.0];
            }
            navigator.ingest(&Sample::Flow(sample));
        }
    });
    assert!(flown.error_m < 2.5, "{}", flown.error_m);
}

#[test]
fn what_comes_alone_is_solved_alone_and_what_comes_late_is_told_so() {
    let late = std::cell::Cell::new(0);
    let flown = fly(160.0, 100.0, &FIXED, &|navigator, truth, height, t| {
        // One of four in turn, and one of the image before.
        let sensor = 11 + ((t * 10.0).round() as i64 % 4) as u8;
        navigator.ingest(&Sample::Flow(patch(sensor, truth, height, at(t))));
        let other = 11 + (sensor - 10) % 4;
        let verdict = navigator.ingest(&Sample::Flow(patch(other, truth, height, at(t - 0.1))));
        late.set(late.get() + u32::from(verdict == Verdict::Rejected(Reason::OutOfOrder)));
    });
    assert!(flown.error_m < 3.0, "{}", flown.error_m);
    assert!(late.get() > 1590, "{}", late.get());
    assert!(flown.navigator.statuses().used(SampleKind::Flow) > 1000);
}

#[test]
fn other_sensors_stay_sensors_of_their_own() {
    let flown = fly(60.0, 60.0, &FIXED, &|navigator, truth, height, t| {
        all(navigator, truth, height, t);
        let lone = FlowSample { sensor: 3, ..patch(11, truth, height, at(t)) };
        assert_ne!(navigator.ingest(&Sample::Flow(lone)), Verdict::Waiting);
    });
    let ids: Vec<u8> = flown.navigator.flow_sensors().map(|(id, ..)| id).collect();
    assert_eq!(ids, [11, 3]);
}

#[test]
fn a_patch_twice_and_a_patch_of_nonsense_are_refused() {
    let flown = fly(30.0, 30.0, &FIXED, &|navigator, truth, height, t| {
        let good = patch(11, truth, height, at(t));
        let mut send = |sample| navigator.ingest(&Sample::Flow(sample));
        send(good);
        assert_eq!(send(good), Verdict::Rejected(Reason::Redundant));
        let nan = FlowSample { sensor: 12, rate_xy: [f64::NAN, 0.0], ..good };
        assert_eq!(send(nan), Verdict::Rejected(Reason::NotFinite));
        let blurred = FlowSample { sensor: 12, quality: 0.0, ..good };
        assert_eq!(send(blurred), Verdict::Rejected(Reason::LowQuality));
    });
    assert!(flown.navigator.solution().is_some());
}

#[test]
fn a_camera_that_is_late_is_found_to_be() {
    let square = Scenario::corners();
    let late = |latency_s: f64, overrides: &[&str]| {
        let overrides: Vec<&str> = FIXED.iter().chain(overrides).copied().collect();
        let flown = fly(220.0, 160.0, &overrides, &|navigator, _, _, t| {
            let past = square.at(t - latency_s);
            all(navigator, &past, -past.position_ned.z, t);
        });
        let (_, latency, sigma) = flown.navigator.flow_latencies_s().next().unwrap();
        (latency, sigma, flown.error_m)
    };
    for latency_s in [0.0, 0.12] {
        let (found, sigma, error_m) = late(latency_s, &[]);
        assert!((found - latency_s).abs() < 0.025, "{found} ± {sigma}");
        assert!((found - latency_s).abs() < 4.0 * sigma && sigma < 0.03, "{found} ± {sigma}");
        assert!(error_m < 2.5, "{error_m}");
    }
    let (kept, sigma, _) = late(0.12, &["flow.delay_sigma_ms=0"]);
    assert_eq!((kept, sigma), (0.0, 0.0));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn whatever_patches_send_the_solution_is_finite_and_each_is_counted_once(
        sent in proptest::collection::vec(
            (8u8..17, -0.3..0.3f64, proptest::array::uniform4(proptest::num::f64::ANY), -5.0..5.0f64, any::<bool>()), 200)) {
        let next = std::cell::Cell::new(0);
        let flown = fly(30.0, 25.0, &FIXED, &|navigator, truth, height, t| {
            for _ in 0..3 {
                let (sensor, ahead, wild, rate, tame) = sent[next.get() % sent.len()];
                next.set(next.get() + 1);
                let good = patch(11, truth, height, at(if tame { t } else { t + ahead }));
                let sample = if tame {
                    FlowSample { sensor, rate_xy: [rate, -rate], ..good }
                } else {
                    let distance_m = Some(wild[3]);
                    FlowSample { sensor, rate_xy: [wild[0], wild[1]], quality: wild[2], distance_m, ..good }
                };
                navigator.ingest(&Sample::Flow(sample));
            }
        });
        let solution = flown.navigator.solution().unwrap();
        prop_assert!((solution.position.raw().sum() + solution.velocity.raw().sum()).is_finite());
        let tally = flown.navigator.statuses();
        let counted = tally.used(SampleKind::Flow) + tally.rejected(SampleKind::Flow).map(|(_, n)| n).sum::<u64>();
        // What came last may still wait.
        prop_assert!((next.get() as u64).abs_diff(counted) <= 4, "{counted} of {}", next.get());
    }
}
