//! The sensors of the double: the simulator's models, read as it flies, and what each said last.

use super::recent::RecentTruth;
use crate::geo::{Body, LocalNed};
use crate::sample::{
    FlowSample, GnssSample, ImuSample, MagSample, PressureSample, RangeDirection, RangeSample,
};
use crate::sim::flight::{flow_sample, gnss_sample};
use crate::sim::models::{
    Barometer, BarometerModel, Flow, FlowModel, Gnss, GnssModel, GnssReading, Imu, ImuModel, Magnetometer,
    MagnetometerModel, OutageKind, Range, RangeModel,
};
use crate::sim::trajectory::Truth;
use crate::sim::world::Environment;
use crate::time::AutopilotTime;

/// What each sensor said last, as samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NewestSamples {
    /// Gyros and accelerometers.
    pub imu: Option<ImuSample>,
    /// Magnetometer.
    pub mag: Option<MagSample>,
    /// Barometer.
    pub pressure: Option<PressureSample>,
    /// Rangefinder.
    pub range: Option<RangeSample>,
    /// Flow.
    pub flow: Option<FlowSample>,
    /// Receiver; `None` while it is silent.
    pub gnss: Option<GnssSample>,
}

/// What is new in a step, for the double's own filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NewReadings {
    /// A fix in the simulation's frame.
    pub fix: Option<GnssReading>,
    /// Height of the barometer over where it was set to zero, m.
    pub altitude_m: Option<f64>,
}

/// The sensors in flight.
#[derive(Clone, Debug)]
pub struct VehicleSensors {
    period_us: [i64; 5],
    imu: Imu,
    magnetometer: Magnetometer,
    barometer: Barometer,
    gnss: Gnss,
    flow: Option<(Flow, Range, [f64; 2])>,
    newest: NewestSamples,
    loss: Option<OutageKind>,
}

fn micros(period_s: f64) -> i64 {
    (period_s * 1e6).round().max(1.0) as i64
}

impl VehicleSensors {
    /// A flow sensor and a rangefinder under a quadrotor, if `sees`, and what every autopilot has.
    pub fn new(imu: ImuModel, sees: bool, seed: u64, world: &Environment, frame: &LocalNed) -> Self {
        let origin_m = frame.origin().height_m;
        let (gnss, magnetometer, barometer) =
            (GnssModel::single(), MagnetometerModel::small(), BarometerModel::small());
        let (flow, range) = (FlowModel::patch(), RangeModel::lidar());
        let periods =
            [magnetometer.period_s, barometer.period_s, gnss.period_s, flow.period_s, range.period_s];
        Self {
            period_us: periods.map(micros),
            imu: Imu::new(imu, seed),
            magnetometer: Magnetometer::new(magnetometer, seed, world),
            barometer: Barometer::new(barometer, seed, origin_m),
            gnss: Gnss::new(gnss, seed),
            flow: sees.then(|| (Flow::new(flow, seed), Range::new(range, seed), range.limits_m)),
            newest: NewestSamples::default(),
            loss: None,
        }
    }

    /// What each sensor said last.
    pub fn newest(&self) -> &NewestSamples {
        &self.newest
    }

    /// The receiver has no fix, in this way, or has it again.
    pub fn lose_gnss(&mut self, loss: Option<OutageKind>) {
        self.loss = loss;
    }

    /// Whether the receiver has no fix.
    pub fn gnss_is_lost(&self) -> bool {
        self.loss.is_some()
    }

    /// Nothing was said since a reboot.
    pub fn forget(&mut self) {
        self.newest = NewestSamples::default();
    }

    /// Reads what is due at `now_us` after `from_us`, stamped `time`.
    pub fn read(
        &mut self,
        world: &Environment,
        frame: &LocalNed,
        recent: &RecentTruth,
        truth: &Truth,
        (from_us, now_us, time): (i64, i64, AutopilotTime),
    ) -> NewReadings {
        let due = self.period_us.map(|period| now_us / period != from_us / period);
        let (from_s, now_s) = (from_us as f64 * 1e-6, now_us as f64 * 1e-6);
        let imu = self.imu.sample(world, recent, from_s, truth).measured;
        self.newest.imu = Some(ImuSample {
            time,
            angular_rate: Body::new(imu.angular_rate),
            specific_force: Body::new(imu.specific_force),
        });
        if due[0] {
            let field = Body::new(self.magnetometer.sample(world, truth));
            self.newest.mag = Some(MagSample { time, sensor: 0, field });
        }
        let barometer = due[1].then(|| self.barometer.sample(truth));
        if let Some(b) = barometer {
            self.newest.pressure = Some(PressureSample { time, sensor: 0, pressure_pa: b.pressure_pa });
        }
        let fix = if due[2] { self.fix(recent, now_s, time, frame) } else { None };
        if let Some((flow, range, limits_m)) = &mut self.flow {
            if due[3] {
                self.newest.flow =
                    flow.sample(world, recent, now_s).map(|reading| flow_sample(time, &reading));
            }
            if due[4] {
                let distance_m = range.sample(world, truth);
                let (direction, limits_m) = (RangeDirection::Down, Some(*limits_m));
                self.newest.range = Some(RangeSample { time, sensor: 0, direction, distance_m, limits_m });
            }
        }
        NewReadings { fix, altitude_m: barometer.map(|b| b.altitude_m) }
    }

    /// A fix that is one; a lost receiver says so, or is silent.
    fn fix(
        &mut self,
        recent: &RecentTruth,
        now_s: f64,
        time: AutopilotTime,
        frame: &LocalNed,
    ) -> Option<GnssReading> {
        let reading = self.gnss.sample(recent, now_s)?;
        let reading = GnssReading { has_fix: self.loss.is_none(), ..reading };
        self.newest.gnss =
            (self.loss != Some(OutageKind::Silent)).then(|| gnss_sample(time, &reading, frame));
        reading.has_fix.then_some(reading)
    }
}
