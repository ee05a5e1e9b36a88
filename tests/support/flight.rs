//! Simulated flights as the samples a decoder would have made of them: read once or step by step, and flown through a navigator.
#![allow(clippy::expect_used, reason = "helpers of tests may fail like tests")]
#![allow(dead_code, reason = "not every user needs all of it")]

use std::borrow::Borrow;
use std::collections::BTreeMap;
use std::sync::OnceLock;

use holdover::config::{Settings, Sources};
use holdover::geo::LocalNed;
use holdover::navigator::Navigator;
use holdover::navigator::solution::Mode;
use holdover::sample::{Sample, SampleKind, VehicleStatus};
use holdover::sim::models::{
    AirspeedModel, BarometerModel, FlowModel, GnssModel, ImuModel, MagnetometerModel,
};
use holdover::sim::{GaussMarkov, Scenario, SensorSuite, Simulation, Truth};
use holdover::time::Span;
use nalgebra::Vector3;

/// One IMU step of a flight: the truth, and what the sensors said, the IMU first.
pub struct Step {
    pub t_s: f64,
    pub truth: Truth,
    pub status: VehicleStatus,
    pub samples: Vec<Sample>,
}

/// The steps of a flight, read one by one.
pub fn steps(simulation: Simulation) -> impl Iterator<Item = Step> {
    let scenario = simulation.scenario().clone();
    simulation.map(move |r| Step {
        t_s: r.t_s,
        truth: r.truth,
        status: scenario.status(r.t_s),
        samples: r.samples.iter().copied().collect(),
    })
}

/// A flight, read.
pub struct Flight {
    pub frame: LocalNed,
    pub steps: Vec<Step>,
}

impl Flight {
    fn read(scenario: Scenario, mut suite: SensorSuite, period_s: f64, seed: u64) -> Self {
        suite.imu.period_s = period_s;
        let simulation = Simulation::new(scenario, suite, seed);
        Self { frame: simulation.frame().clone(), steps: steps(simulation).collect() }
    }

    /// A fixed wing with flow, magnetometer, barometer, GNSS and a pitot tube.
    pub fn wing(period_s: f64, duration_s: f64, seed: u64) -> Self {
        let suite = SensorSuite { airspeed: Some(AirspeedModel::pitot()), ..SensorSuite::tactical() };
        Self::read(Scenario::circles().lasting(duration_s), suite, period_s, seed)
    }

    /// A multirotor that flies squares, with flow, rangefinder, magnetometer, barometer and GNSS.
    pub fn rotor(period_s: f64, duration_s: f64, seed: u64) -> Self {
        let suite = SensorSuite::tactical().near_the_ground();
        Self::read(Scenario::square().lasting(duration_s), suite, period_s, seed)
    }
}

/// White noise and constant biases, and nothing late: what the papers assume of sensors. Flow velocities hold at their stamps.
pub fn white(imu: ImuModel) -> SensorSuite {
    SensorSuite {
        imu: ImuModel {
            gyro_wander: GaussMarkov::NONE,
            accel_wander: GaussMarkov::NONE,
            gyro_scale: 0.0,
            ..imu
        },
        gnss: Some(GnssModel {
            position_m: Vector3::new(1.5, 1.5, 2.5),
            velocity_mps: Vector3::new(0.1, 0.1, 0.15),
            ..GnssModel::ideal()
        }),
        magnetometer: Some(MagnetometerModel {
            period_s: 0.01,
            noise_t: 0.3e-6,
            ..MagnetometerModel::ideal()
        }),
        barometer: Some(BarometerModel { noise_m: 0.3, ..BarometerModel::ideal() }),
        flow: Some(FlowModel {
            interval_s: 0.0,
            noise_mps: Vector3::new(0.5, 0.5, 1.0),
            bias_mps: Vector3::new(0.5, 0.3, 0.0),
            ..FlowModel::ideal()
        }),
        ..SensorSuite::ideal()
    }
}

/// A navigator with the settings that Holdover has by default, but for these.
pub fn navigator(set: &[&str]) -> Navigator {
    let overrides = set.iter().map(|s| (*s).to_owned()).collect();
    let settings = Settings::load(&Sources { overrides, ..Sources::default() }).expect("valid settings");
    Navigator::new(settings.pipeline.navigator)
}

/// Flies the steps: `give` hands a sample to the navigator, or does with it what it will; `look` sees what came of each step.
pub fn fly<S: Borrow<Step>>(
    navigator: &mut Navigator,
    steps: impl IntoIterator<Item = S>,
    mut give: impl FnMut(&mut Navigator, &Step, &Sample),
    mut look: impl FnMut(&mut Navigator, &Step),
) {
    for step in steps {
        let step = step.borrow();
        navigator.set_status(step.status);
        for sample in &step.samples {
            give(navigator, step, sample);
        }
        look(navigator, step);
        navigator.drain_events().for_each(drop);
    }
}

/// Gives a sample to the navigator, but from `from_s` on it masks GNSS.
pub fn masked_from(from_s: f64) -> impl FnMut(&mut Navigator, &Step, &Sample) {
    move |navigator, step, sample| match sample {
        Sample::Gnss(fix) if step.t_s >= from_s => navigator.mask_gnss(fix.time),
        other => {
            navigator.ingest(other);
        }
    }
}

/// GNSS ends here where it is to end, s.
pub const LOST_S: f64 = 115.0;
/// The end of the flights that begin ready, s.
pub const END_S: f64 = 240.0;
/// Their IMU period, s.
pub const PERIOD_S: f64 = 0.01;

/// A vehicle that has flown until [`LOST_S`] with nothing wrong, and what comes after.
pub struct Ready {
    pub flight: Flight,
    pub navigator: Navigator,
    pub from: usize,
    pub taken: Counts,
}

pub type Counts = BTreeMap<SampleKind, u64>;

fn ready(flight: Flight) -> Ready {
    let mut navigator = navigator(&[]);
    let from = flight.steps.partition_point(|s| s.t_s < LOST_S);
    let mut taken = Counts::new();
    let count = |navigator: &mut Navigator, _: &Step, sample: &Sample| {
        navigator.ingest(sample);
        *taken.entry(sample.kind()).or_default() += 1;
    };
    fly(&mut navigator, &flight.steps[..from], count, |_, _| {});
    assert_eq!(navigator.mode(), Mode::Aided);
    Ready { flight, navigator, from, taken }
}

pub fn ready_wing() -> &'static Ready {
    static WING: OnceLock<Ready> = OnceLock::new();
    WING.get_or_init(|| ready(Flight::wing(PERIOD_S, END_S, 5)))
}

pub fn ready_rotor() -> &'static Ready {
    static ROTOR: OnceLock<Ready> = OnceLock::new();
    ROTOR.get_or_init(|| ready(Flight::rotor(PERIOD_S, END_S, 5)))
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
