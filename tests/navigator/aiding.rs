//! What carries a vehicle that has no flow: airspeed, rotor drag, standing still. Each against the same flight without it.

use crate::flight::{self, masked_from};
use holdover::navigator::Navigator;
use holdover::navigator::solution::{Mode, Solution, VelocitySource};
use holdover::navigator::sources::status::Measured;
use holdover::sample::{Airframe, VehicleStatus};
use holdover::sim::models::AirspeedModel;
use holdover::sim::{Scenario, SensorSuite, Simulation};
use nalgebra::Vector3;

/// Not a setting: the vehicle never says that it is armed.
const DISARMED: &str = "disarmed";

struct Flown {
    /// Horizontal error at the end, m.
    error_m: f64,
    solution: Solution,
    navigator: Navigator,
}

/// Flies `scenario` with GNSS gone from `from_s` to `to_s`, where it ends.
fn fly(scenario: Scenario, suite: SensorSuite, seed: u64, (from_s, to_s): (f64, f64), set: &[&str]) -> Flown {
    let settings: Vec<&str> = set.iter().filter(|s| **s != DISARMED).copied().collect();
    let mut navigator = flight::navigator(&settings);
    let simulation = Simulation::new(scenario.lasting(to_s), suite, seed);
    navigator.set_origin(Simulation::ap_time(0.0), simulation.frame().origin());
    let mut truth = None;
    let steps = flight::steps(simulation).map(|mut step| {
        if set.contains(&DISARMED) {
            step.status.armed = Some(false);
        }
        step
    });
    flight::fly(&mut navigator, steps, masked_from(from_s), |_, step| truth = Some(step.truth));
    let solution = navigator.solution().unwrap();
    let error_m = (solution.position.raw() - truth.unwrap().position_ned).xy().norm();
    Flown { error_m, solution, navigator }
}

#[test]
fn airspeed_carries_a_wing_in_wind() {
    let wind = Vector3::new(4.0, -3.0, 0.0);
    let scenario = Scenario::legs().with_wind(wind);
    let suite = SensorSuite { flow: None, airspeed: Some(AirspeedModel::pitot()), ..SensorSuite::mems() };
    for seed in 1..=3 {
        let with = fly(scenario.clone(), suite, seed, (400.0, 520.0), &[]);
        assert_eq!(with.solution.mode, Mode::Holdover);
        assert_eq!(with.solution.velocity_source, VelocitySource::Airspeed);
        assert!(with.error_m < 50.0, "seed {seed}: {} m of 3.2 km", with.error_m);
        assert!(with.error_m < 3.0 * with.solution.horizontal_sigma_m(), "seed {seed}: {}", with.error_m);
        let found = with.navigator.filter_state().unwrap().wind_ne;
        assert!((found - wind.xy()).norm() < 1.0, "seed {seed}: wind {found}");
        assert!(with.navigator.statuses().nis(Measured::Airspeed).fused > 1000);
        // Such an IMU coasts well for two minutes, but who coasts cannot know that.
        let without = fly(scenario.clone(), suite, seed, (400.0, 520.0), &["airspeed.use=false"]);
        assert_eq!(
            (without.solution.mode, without.solution.velocity_source),
            (Mode::Lost, VelocitySource::Inertial)
        );
        assert!(without.solution.horizontal_sigma_m() > 2.0 * with.solution.horizontal_sigma_m());
    }
}

#[test]
fn rotor_drag_carries_a_multirotor() {
    let suite = SensorSuite { flow: None, ..SensorSuite::mems() };
    for seed in 1..=3 {
        let with = fly(Scenario::square(), suite, seed, (150.0, 270.0), &[]);
        assert_eq!(
            (with.solution.mode, with.solution.velocity_source),
            (Mode::Holdover, VelocitySource::Drag)
        );
        assert!(with.error_m < 20.0, "seed {seed}: {} m", with.error_m);
        let drag = with.navigator.filter_state().unwrap().drag;
        assert!((drag - 0.3).abs() < 0.06, "seed {seed}: {drag}");
        let without = fly(Scenario::square(), suite, seed, (150.0, 270.0), &["drag.use=false"]);
        assert!(
            without.error_m > 4.0 * with.error_m,
            "seed {seed}: {} and {}",
            without.error_m,
            with.error_m
        );
        assert_ne!(without.solution.velocity_source, VelocitySource::Drag);
    }
}

#[test]
fn a_disarmed_vehicle_that_stands_does_not_drift() {
    // The square flight stands for 20 s; here it never takes off.
    let stand = Scenario::square().lasting(18.0);
    let suite = SensorSuite { flow: None, ..SensorSuite::mems() };
    let flown = fly(stand, suite, 4, (10.0, 18.0), &[]);
    assert_eq!(
        (flown.solution.mode, flown.solution.velocity_source),
        (Mode::Holdover, VelocitySource::Standstill)
    );
    let velocity = flown.solution.velocity.raw();
    assert!(velocity.norm() < 0.05, "{velocity}");
    assert!(flown.navigator.statuses().nis(Measured::Standstill).fused > 50);
}

#[test]
fn airspeed_is_not_for_multirotors_and_drag_not_for_wings() {
    let mut navigator = flight::navigator(&[]);
    let suite = SensorSuite { airspeed: Some(AirspeedModel::pitot()), ..SensorSuite::mems() };
    for airframe in [Airframe::Multirotor, Airframe::FixedWing] {
        navigator.set_status(VehicleStatus { airframe: Some(airframe), armed: Some(true), landed: None });
        let before = [Measured::Airspeed, Measured::Drag].map(|m| navigator.statuses().nis(m).fused);
        for reading in Simulation::new(Scenario::circles(), suite, 1).take_while(|r| r.t_s < 40.0) {
            for sample in reading.samples.iter() {
                navigator.ingest(sample);
            }
        }
        let after = [Measured::Airspeed, Measured::Drag].map(|m| navigator.statuses().nis(m).fused);
        let wing = airframe == Airframe::FixedWing;
        assert_eq!(after[0] > before[0], wing);
        assert_eq!(after[1] > before[1], !wing);
        navigator.reboot(Simulation::ap_time(0.0), None);
    }
}

#[test]
fn a_vehicle_that_flies_while_it_says_that_it_is_disarmed_is_not_held_to_stand() {
    let suite = SensorSuite { flow: None, ..SensorSuite::mems() };
    let flown = fly(Scenario::square(), suite, 2, (150.0, 200.0), &[DISARMED]);
    assert_eq!(flown.solution.velocity_source, VelocitySource::Drag);
    // Five a second and three axes in the 20 s before take-off, some while it lifts off slowly, and none after.
    let count = flown.navigator.statuses().nis(Measured::Standstill).fused;
    assert!((1..400).contains(&count), "{count}");
}
