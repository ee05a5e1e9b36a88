//! Simulated flights as the samples a decoder would have made of them, read once and flown as often as a test or benchmark likes.
#![allow(dead_code, reason = "not every user needs all of it")]

use std::collections::BTreeMap;
use std::sync::OnceLock;

use holdover::config::{Settings, Sources};
use holdover::geo::LocalNed;
use holdover::navigator::Navigator;
use holdover::navigator::solution::Mode;
use holdover::sample::{Sample, SampleKind, VehicleStatus};
use holdover::sim::models::AirspeedModel;
use holdover::sim::trajectory::Truth;
use holdover::sim::{Scenario, SensorSuite, Simulation};
use holdover::time::Span;

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

/// GNSS ends here where it is to end, s.
pub const LOST_S: f64 = 115.0;
/// The end of the flights that begin ready, s.
pub const END_S: f64 = 240.0;
/// Their IMU period, s.
pub const PERIOD_S: f64 = 0.01;

/// A vehicle that has flown until [`LOST_S`] with nothing wrong, and what comes after.
pub struct Ready {
    pub flown: Flown,
    pub navigator: Navigator,
    pub from: usize,
    pub taken: Counts,
}

pub type Counts = BTreeMap<SampleKind, u64>;

pub fn ready(flown: Flown) -> Ready {
    let mut navigator = navigator();
    let from = flown.steps.partition_point(|s| s.t_s < LOST_S);
    let mut taken = Counts::new();
    for step in &flown.steps[..from] {
        navigator.set_status(step.status);
        for sample in &step.samples {
            navigator.ingest(sample);
            *taken.entry(sample.kind()).or_default() += 1;
        }
        navigator.drain_events().for_each(drop);
    }
    assert_eq!(navigator.mode(), Mode::Aided);
    Ready { flown, navigator, from, taken }
}

pub fn ready_wing() -> &'static Ready {
    static WING: OnceLock<Ready> = OnceLock::new();
    WING.get_or_init(|| ready(wing(PERIOD_S, END_S, 5)))
}

pub fn ready_rotor() -> &'static Ready {
    static ROTOR: OnceLock<Ready> = OnceLock::new();
    ROTOR.get_or_init(|| ready(rotor(PERIOD_S, END_S, 5)))
}

/// The time of a sample, moved.
pub fn moved(sample: &Sample, by: Span) -> Sample {
    let mut s = *sample;
    let time = match &mut s {
        Sample::Imu(s) => &mut s.time,
        Sample::Mag(s) => &mut s.time,
        Sample::Gnss(s) => &mut s.time,
        Sample::Pressure(s) => &mut s.time,
        Sample::Flow(s) => &mut s.time,
        Sample::Range(s) => &mut s.time,
        Sample::Airspeed(s) => &mut s.time,
        Sample::Landmark(s) => &mut s.time,
    };
    *time = *time + by;
    s
}
