//! A scenario flown with sensors: readings step by step, and the samples that a decoder would have made of them.

use super::models::{
    Airspeed, AirspeedModel, Barometer, BarometerModel, BarometerReading, Flow, FlowModel, FlowReading, Gnss,
    GnssModel, GnssReading, Imu, ImuModel, ImuReading, Magnetometer, MagnetometerModel, Range, RangeModel,
};
use super::scenario::Scenario;
use super::trajectory::{Trajectory, Truth};
use crate::geo::{Body, LocalNed};
use crate::sample::{
    AirspeedSample, FlowSample, GnssFix, GnssSample, GroundVelocity, ImuSample, MagSample, PressureSample,
    RangeDirection, RangeSample, Sample,
};
use crate::time::{AutopilotTime, Span};
use nalgebra::Vector3;

/// The autopilot has been up for this long when the flight begins, µs.
const BOOT_US: i64 = 10_000_000;
/// Satellites of a good fix.
const SATELLITES: u8 = 14;

/// Which sensors the vehicle has, and how wrong they are. What is `None` is not there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorSuite {
    /// Gyros and accelerometers: the other sensors are read at their steps.
    pub imu: ImuModel,
    /// Receiver.
    pub gnss: Option<GnssModel>,
    /// Magnetometer.
    pub magnetometer: Option<MagnetometerModel>,
    /// Barometer.
    pub barometer: Option<BarometerModel>,
    /// Flow.
    pub flow: Option<FlowModel>,
    /// Rangefinder.
    pub range: Option<RangeModel>,
    /// Airspeed.
    pub airspeed: Option<AirspeedModel>,
}

impl SensorSuite {
    /// IMU, GNSS, magnetometer, barometer and flow without any error.
    pub fn ideal() -> Self {
        Self {
            imu: ImuModel::ideal(),
            gnss: Some(GnssModel::ideal()),
            magnetometer: Some(MagnetometerModel::ideal()),
            barometer: Some(BarometerModel::ideal()),
            flow: Some(FlowModel::ideal()),
            range: None,
            airspeed: None,
        }
    }

    /// A fixed wing with a camera and a tactical IMU.
    pub fn tactical() -> Self {
        Self {
            imu: ImuModel::tactical(),
            gnss: Some(GnssModel::single()),
            magnetometer: Some(MagnetometerModel::small()),
            barometer: Some(BarometerModel::small()),
            flow: Some(FlowModel::camera()),
            ..Self::ideal()
        }
    }

    /// The same with a MEMS IMU.
    pub fn mems() -> Self {
        Self { imu: ImuModel::mems(), ..Self::tactical() }
    }

    /// What the scenario's vehicle usually has, around an IMU.
    pub fn of(scenario: &Scenario, imu: ImuModel) -> Self {
        let suite = Self { imu, ..Self::tactical() };
        if scenario.is_fixed_wing() { suite } else { suite.near_the_ground() }
    }

    /// As a multirotor has them: a flow sensor and a rangefinder in the place of the camera.
    pub fn near_the_ground(self) -> Self {
        Self { flow: Some(FlowModel::patch()), range: Some(RangeModel::lidar()), ..self }
    }
}

/// What all sensors said at one IMU step. Errors are in unless a field says "ideal" or "truth".
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// Seconds since the beginning of the flight.
    pub t_s: f64,
    /// The same on the autopilot's clock.
    pub time: AutopilotTime,
    /// The IMU's interval, s.
    pub dt_s: f64,
    /// The true state now.
    pub truth: Truth,
    /// IMU.
    pub imu: ImuReading,
    /// Magnetic field in body axes, T.
    pub field_body: Option<Vector3<f64>>,
    /// A fix that arrives now.
    pub gnss: Option<GnssReading>,
    /// Altitude and pressure.
    pub barometer: Option<BarometerReading>,
    /// Flow that arrives now.
    pub flow: Option<FlowReading>,
    /// Distance along body z, m.
    pub range_m: Option<f64>,
    /// Equivalent airspeed, m/s.
    pub airspeed_mps: Option<f64>,
    /// The same as samples, in the order in which they arrive: the IMU first.
    pub samples: Samples,
}

/// Up to seven samples.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Samples([Option<Sample>; 7]);

impl Samples {
    /// In order of arrival.
    pub fn iter(&self) -> impl Iterator<Item = &Sample> {
        self.0.iter().flatten()
    }
}

/// A flight being simulated: an iterator over its readings, one an IMU step.
///
/// The same scenario, suite and seed give the same readings; a sensor that is changed or left out changes no other.
#[derive(Clone, Debug)]
pub struct Simulation {
    scenario: Scenario,
    suite: SensorSuite,
    frame: LocalNed,
    step_us: i64,
    now_us: i64,
    end_us: i64,
    imu: Imu,
    gnss: Option<Gnss>,
    magnetometer: Option<Magnetometer>,
    barometer: Option<Barometer>,
    flow: Option<Flow>,
    range: Option<Range>,
    airspeed: Option<Airspeed>,
}

impl Simulation {
    /// A flight from its beginning.
    pub fn new(scenario: Scenario, suite: SensorSuite, seed: u64) -> Self {
        let us = |s: f64| Span::from_seconds(s).micros();
        Self {
            frame: LocalNed::new(scenario.origin),
            step_us: us(suite.imu.period_s).max(1),
            now_us: 0,
            end_us: us(scenario.duration_s),
            imu: Imu::new(suite.imu, seed),
            gnss: suite.gnss.map(|m| Gnss::new(m, seed)),
            magnetometer: suite.magnetometer.map(|m| Magnetometer::new(m, seed, &scenario.environment)),
            barometer: suite.barometer.map(|m| Barometer::new(m, seed, scenario.origin.height_m)),
            flow: suite.flow.map(|m| Flow::new(m, seed)),
            range: suite.range.map(|m| Range::new(m, seed)),
            airspeed: suite.airspeed.map(|m| Airspeed::new(m, seed, scenario.origin.height_m)),
            scenario,
            suite,
        }
    }

    /// What is flown.
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// What it is flown with.
    pub fn suite(&self) -> &SensorSuite {
        &self.suite
    }

    /// The frame of NED on the globe.
    pub fn frame(&self) -> &LocalNed {
        &self.frame
    }

    /// The true state at any time.
    pub fn truth(&self, t_s: f64) -> Truth {
        self.scenario.at(t_s)
    }

    /// A time of the flight on the autopilot's clock.
    pub fn ap_time(t_s: f64) -> AutopilotTime {
        AutopilotTime::from_micros(BOOT_US) + Span::from_seconds(t_s)
    }

    /// Seconds since the beginning of the flight.
    pub fn seconds(time: AutopilotTime) -> f64 {
        time.seconds_since(AutopilotTime::from_micros(BOOT_US))
    }

    /// Whether a sensor of this period has something now.
    fn is_due(&self, period_s: f64) -> bool {
        let period_us = Span::from_seconds(period_s).micros().max(1);
        self.now_us / period_us != (self.now_us - self.step_us) / period_us
    }

    fn read(&mut self) -> Reading {
        let t_s = self.now_us as f64 * 1e-6;
        let from_s = (self.now_us - self.step_us) as f64 * 1e-6;
        let truth = self.scenario.at(t_s);
        let due = {
            let s = &self.suite;
            [
                s.gnss.map(|m| m.period_s),
                s.magnetometer.map(|m| m.period_s),
                s.barometer.map(|m| m.period_s),
                s.flow.map(|m| m.period_s),
                s.range.map(|m| m.period_s),
                s.airspeed.map(|m| m.period_s),
            ]
            .map(|period| period.is_some_and(|p| self.is_due(p)))
        };
        let (scenario, world) = (&self.scenario, &self.scenario.environment);
        let mut reading = Reading {
            t_s,
            time: Self::ap_time(t_s),
            dt_s: t_s - from_s,
            truth,
            imu: self.imu.sample(world, scenario, from_s, &truth),
            gnss: self.gnss.as_mut().filter(|_| due[0]).and_then(|g| g.sample(scenario, t_s)),
            field_body: self.magnetometer.as_mut().filter(|_| due[1]).map(|m| m.sample(world, &truth)),
            barometer: self.barometer.as_mut().filter(|_| due[2]).map(|b| b.sample(&truth)),
            flow: self.flow.as_mut().filter(|_| due[3]).and_then(|f| f.sample(world, scenario, t_s)),
            range_m: self.range.as_mut().filter(|_| due[4]).map(|r| r.sample(world, &truth)),
            airspeed_mps: self
                .airspeed
                .as_mut()
                .filter(|_| due[5])
                .map(|a| a.sample(&scenario.wind_ned, &truth)),
            samples: Samples::default(),
        };
        reading.samples = reading.to_samples(&self.frame, self.suite.range.map(|r| r.limits_m));
        reading
    }
}

impl Iterator for Simulation {
    type Item = Reading;

    fn next(&mut self) -> Option<Reading> {
        let next = self.now_us + self.step_us;
        if next > self.end_us {
            return None;
        }
        self.now_us = next;
        Some(self.read())
    }
}

impl Reading {
    fn to_samples(&self, frame: &LocalNed, range_limits_m: Option<[f64; 2]>) -> Samples {
        let time = self.time;
        let imu = ImuSample {
            time,
            angular_rate: Body::new(self.imu.measured.angular_rate),
            specific_force: Body::new(self.imu.measured.specific_force),
        };
        let range = |distance_m| RangeSample {
            time,
            sensor: 0,
            direction: RangeDirection::Down,
            distance_m,
            limits_m: range_limits_m,
        };
        Samples([
            Some(Sample::Imu(imu)),
            self.field_body.map(|field| Sample::Mag(MagSample { time, sensor: 0, field: Body::new(field) })),
            self.barometer
                .map(|b| Sample::Pressure(PressureSample { time, sensor: 0, pressure_pa: b.pressure_pa })),
            self.range_m.map(|d| Sample::Range(range(d))),
            self.flow.map(|f| Sample::Flow(flow_sample(time, &f))),
            self.airspeed_mps.map(|airspeed_mps| Sample::Airspeed(AirspeedSample { time, airspeed_mps })),
            self.gnss.filter(|g| g.is_sent).map(|g| Sample::Gnss(gnss_sample(time, &g, frame))),
        ])
    }
}

pub(super) fn flow_sample(time: AutopilotTime, f: &FlowReading) -> FlowSample {
    FlowSample {
        time,
        sensor: 0,
        interval: Span::from_seconds(f.interval_s),
        rate_xy: f.rate_xy,
        rotation: f.rotation,
        quality: 1.0,
        distance_m: f.tells_distance.then_some(f.distance_m),
    }
}

pub(super) fn gnss_sample(time: AutopilotTime, g: &GnssReading, frame: &LocalNed) -> GnssSample {
    let velocity = g.velocity_ned;
    let ground = GroundVelocity {
        speed_mps: velocity.xy().norm(),
        course_rad: velocity.y.atan2(velocity.x).rem_euclid(std::f64::consts::TAU),
    };
    let [horizontal, vertical, speed] = g.claims.map(|c| g.has_fix.then_some(c));
    GnssSample {
        time,
        receiver: 0,
        fix: if g.has_fix { GnssFix::ThreeD } else { GnssFix::None },
        position: g.has_fix.then(|| frame.to_geodetic(&g.position_ned)),
        ground_velocity: g.has_fix.then_some(ground),
        horizontal_accuracy_m: horizontal,
        vertical_accuracy_m: vertical,
        speed_accuracy_mps: speed,
        satellites: Some(if g.has_fix { SATELLITES } else { 0 }),
        warning: None,
    }
}

#[cfg(test)]
mod tests;
