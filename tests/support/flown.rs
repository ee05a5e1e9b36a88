//! Simulated flights as the samples a decoder would have made of them, read once and flown as often as a test or benchmark likes.
#![allow(dead_code, reason = "not every user needs all of it")]

use holdover::config::{Settings, Sources};
use holdover::geo::LocalNed;
use holdover::navigator::Navigator;
use holdover::sample::{Sample, VehicleStatus};
use holdover::sim::models::AirspeedModel;
use holdover::sim::trajectory::Truth;
use holdover::sim::{Scenario, SensorSuite, Simulation};

/// One IMU step of a flight: the truth, and what the sensors said, the IMU first.
pub struct Step {
    pub t_s: f64,
    pub truth: Truth,
    pub status: VehicleStatus,
    pub samples: Vec<Sample>,
}

/// A flight, read.
pub struct Flown {
    pub frame: LocalNed,
    pub steps: Vec<Step>,
}

/// A fixed wing with flow, magnetometer, barometer, GNSS and a pitot tube.
pub fn wing(period_s: f64, duration_s: f64, seed: u64) -> Flown {
    let suite = SensorSuite { airspeed: Some(AirspeedModel::pitot()), ..SensorSuite::tactical() };
    fly(Scenario::circles().lasting(duration_s), suite, period_s, seed)
}

/// A multirotor that flies squares, with flow, rangefinder, magnetometer, barometer and GNSS.
pub fn rotor(period_s: f64, duration_s: f64, seed: u64) -> Flown {
    let suite = SensorSuite::tactical().near_the_ground();
    fly(Scenario::square().lasting(duration_s), suite, period_s, seed)
}

fn fly(scenario: Scenario, mut suite: SensorSuite, period_s: f64, seed: u64) -> Flown {
    suite.imu.period_s = period_s;
    let simulation = Simulation::new(scenario.clone(), suite, seed);
    let frame = simulation.frame().clone();
    let steps = simulation
        .map(|r| Step {
            t_s: r.t_s,
            truth: r.truth,
            status: scenario.status(r.t_s),
            samples: r.samples.iter().copied().collect(),
        })
        .collect();
    Flown { frame, steps }
}

/// A navigator with the settings that Holdover has by default.
pub fn navigator() -> Navigator {
    let settings = Settings::load(&Sources::default()).expect("the defaults are valid");
    Navigator::new(settings.pipeline.navigator)
}
