//! What is to be said of each sensor: noise, clipping, spread, what cannot be true, and how late it is.

use nalgebra::Vector3;
use serde::Serialize;

use crate::geo::BodyToNed;
use crate::geo::atmosphere::pressure_altitude_m;
use crate::metrics::Rms;
use crate::sample::{
    FlowRotation, FlowSample, GnssSample, ImuSample, Input, MagSample, PressureSample, RangeDirection,
    RangeSample, Reference, Sample,
};
use crate::time::AutopilotTime;

use super::lag::{Changes, Integral, SensorChange, SensorLag};

/// Standard gravity, m/s², which is taken out of specific force here: what is left of an error is the same at every lag.
const GRAVITY_MPS2: f64 = 9.80665;
/// The autopilot's attitude turns specific force for so long, s.
const ATTITUDE_AGE_S: f64 = 0.15;
/// Samples of a component that repeat its extreme value in a row clip, if it is as large as this.
const CLIPPED_IN_A_ROW: u32 = 3;
const CLIP_FROM_MPS2: f64 = 30.0;
const CLIP_FROM_RADPS: f64 = 4.0;
/// A course that stays the same to the last digit this long, s, while the receiver goes as fast as this, m/s, is frozen.
const FROZEN_S: f64 = 2.0;
const FROZEN_FROM_MPS: f64 = 0.4;
const FROZEN_TIMES: u32 = 5;
/// Two samples further apart than this are not compared, s.
const APART_S: f64 = 2.5;
/// A range that is less than this part of the height by barometer, that high above where the flight began, is no echo of the ground.
const ECHO_PART: f64 = 0.4;
const ECHO_FROM_M: f64 = 6.0;
/// The field's strength may spread by this part of it.
const SPREAD: f64 = 0.05;

/// Mean and spread of a number.
#[derive(Clone, Copy, Debug, Default)]
struct Spread {
    n: u64,
    mean: f64,
    squares: f64,
}

impl Spread {
    fn add(&mut self, v: f64) {
        self.n += 1;
        let off = v - self.mean;
        self.mean += off / self.n as f64;
        self.squares += off * (v - self.mean);
    }

    fn sigma(&self) -> f64 {
        (self.squares / self.n.max(1) as f64).sqrt()
    }
}

/// White noise of a vector, from the change of change between three samples: what is smooth falls out.
#[derive(Clone, Debug, Default)]
struct Whiteness {
    last: [Option<Vector3<f64>>; 2],
    rms: Rms,
}

impl Whiteness {
    fn add(&mut self, v: Vector3<f64>) {
        if let [Some(a), Some(b)] = self.last {
            // The variance of a − 2b + c is six times that of each; three components.
            self.rms.add((v - 2.0 * b + a).norm() / 18f64.sqrt());
        }
        self.last = [self.last[1], Some(v)];
    }
}

/// Components that stay at their extreme.
#[derive(Clone, Debug, Default)]
struct Clipping {
    extreme: f64,
    last: Vector3<f64>,
    in_a_row: [u32; 3],
    /// Samples at the extreme, in rows.
    samples: u64,
}

impl Clipping {
    fn add(&mut self, v: Vector3<f64>, from: f64) {
        for axis in 0..3 {
            let size = v[axis].abs();
            if size < from || size < 0.999 * self.extreme {
                self.in_a_row[axis] = 0;
                continue;
            }
            if size > 1.001 * self.extreme {
                // A larger one: what was taken for the end of the range was none.
                (self.extreme, self.samples, self.in_a_row) = (size, 0, [0; 3]);
            }
            let same = v[axis] == self.last[axis];
            self.in_a_row[axis] = if same { self.in_a_row[axis] + 1 } else { 1 };
            match self.in_a_row[axis] {
                CLIPPED_IN_A_ROW => self.samples += u64::from(CLIPPED_IN_A_ROW),
                n if n > CLIPPED_IN_A_ROW => self.samples += 1,
                _ => {}
            }
        }
        self.last = v;
    }
}

/// What the fixes show.
#[derive(Clone, Debug, Default)]
struct Fixes {
    told: u64,
    fixed: u64,
    satellites: Spread,
    accuracy_m: Spread,
    last: Option<(AutopilotTime, Vector3<f64>)>,
    /// Since when, which, and how often it was told.
    course: Option<(AutopilotTime, f64, u32)>,
    frozen_s: f64,
    changes: Changes,
}

impl Fixes {
    fn add(&mut self, fix: &GnssSample) {
        self.told += 1;
        if fix.position.is_none() {
            return;
        }
        self.fixed += 1;
        if let Some(n) = fix.satellites {
            self.satellites.add(f64::from(n));
        }
        if let Some(accuracy_m) = fix.horizontal_accuracy_m {
            self.accuracy_m.add(accuracy_m);
        }
        let Some(ground) = fix.ground_velocity else { return };
        let (north, east) = ground.north_east();
        let velocity = Vector3::new(north, east, 0.0);
        if let Some((from, before)) = self.last.replace((fix.time, velocity))
            && fix.time.seconds_since(from) < APART_S
        {
            self.changes.add(SensorChange { from, to: fix.time, by: velocity - before, turned: None });
        }
        self.note_course(fix.time, ground.course_rad, ground.speed_mps);
    }

    fn note_course(&mut self, time: AutopilotTime, course_rad: f64, speed_mps: f64) {
        match &mut self.course {
            Some((since, course, times)) if *course == course_rad && speed_mps > FROZEN_FROM_MPS => {
                *times += 1;
                let whole_s = time.seconds_since(*since);
                // What was only suspected before counts from its beginning.
                if whole_s >= FROZEN_S && *times >= FROZEN_TIMES {
                    self.frozen_s += whole_s;
                    *since = time;
                }
            }
            _ => self.course = Some((time, course_rad, 1)),
        }
    }
}

/// Echoes.
#[derive(Clone, Debug, Default)]
struct Ranges {
    n: u64,
    beyond_limits: u64,
    not_the_ground: u64,
    limits_m: Option<[f64; 2]>,
    nearest_false_m: Option<f64>,
}

/// What is known of a log's sensors while it is read. Only the first unit of a kind is looked at.
#[derive(Debug, Default)]
pub(super) struct Sensors {
    attitude: Option<(AutopilotTime, BodyToNed)>,
    own_attitude: bool,
    velocity: Integral,
    turned: Integral,
    gyro: Whiteness,
    accelerometer: Whiteness,
    clipped: [Clipping; 2],
    imu: u64,
    field: Spread,
    field_last: Option<(AutopilotTime, Vector3<f64>)>,
    field_changes: Changes,
    fixes: Fixes,
    flow: Flows,
    ranges: Ranges,
    barometer: BarometerTally,
}

/// Optical flow.
#[derive(Clone, Debug, Default)]
struct Flows {
    n: u64,
    blind: u64,
    own_unit: u64,
    last: Option<AutopilotTime>,
    angle: Vector3<f64>,
    before: Option<(AutopilotTime, Vector3<f64>)>,
    changes: Changes,
}

/// Height by pressure, above where it was first.
#[derive(Clone, Debug, Default)]
struct BarometerTally {
    first_m: Option<f64>,
    above_m: Option<f64>,
    noise: Whiteness,
}

/// What is said of a sensor.
#[derive(Clone, Debug, Serialize)]
pub(super) struct SensorReport {
    pub(super) sensor: &'static str,
    /// In a few words each.
    pub(super) remarks: Vec<String>,
    /// Numbers by name, with their unit in it.
    #[serde(flatten)]
    pub(super) numbers: std::collections::BTreeMap<&'static str, f64>,
    /// How late it is after the inertial unit, as far as the motion shows it.
    pub(super) lag: Option<SensorLag>,
}

impl SensorReport {
    fn new(sensor: &'static str) -> Self {
        Self { sensor, remarks: Vec::new(), numbers: Default::default(), lag: None }
    }

    fn number(&mut self, name: &'static str, value: f64) {
        if value.is_finite() {
            self.numbers.insert(name, value);
        }
    }
}

impl Sensors {
    /// Notes what comes.
    pub(super) fn note(&mut self, input: &Input) {
        match input {
            Input::Sample(Sample::Imu(s)) => self.inertial(s),
            Input::Sample(Sample::Mag(s)) if s.sensor == 0 => self.magnetic(s),
            Input::Sample(Sample::Gnss(s)) if s.receiver == 0 => self.fixes.add(s),
            Input::Sample(Sample::Flow(s)) if s.sensor == 0 => self.flow(s),
            Input::Sample(Sample::Range(s)) if s.sensor == 0 => self.range(s),
            Input::Sample(Sample::Pressure(s)) if s.sensor == 0 => self.pressure(s),
            Input::Reference(Reference::Attitude { time, attitude }) if !self.own_attitude => {
                self.attitude = Some((*time, *attitude));
            }
            _ => {}
        }
    }

    /// The navigation's attitude, once it has one: that follows the gyro, where the autopilot's may be of another clock.
    pub(super) fn note_attitude(&mut self, time: AutopilotTime, attitude: BodyToNed) {
        (self.own_attitude, self.attitude) = (true, Some((time, attitude)));
    }

    fn inertial(&mut self, s: &ImuSample) {
        let (rate, force) = (s.angular_rate.raw(), s.specific_force.raw());
        self.imu += 1;
        self.gyro.add(rate);
        self.accelerometer.add(force);
        self.clipped[0].add(rate, CLIP_FROM_RADPS);
        self.clipped[1].add(force, CLIP_FROM_MPS2);
        self.turned.add(s.time, rate);
        if let Some((time, attitude)) = &self.attitude
            && s.time.seconds_since(*time).abs() < ATTITUDE_AGE_S
        {
            let force_ned = attitude.matrix() * force;
            self.velocity.add(s.time, force_ned + Vector3::new(0.0, 0.0, GRAVITY_MPS2));
        }
    }

    fn magnetic(&mut self, s: &MagSample) {
        let field = s.field.raw();
        self.field.add(field.norm());
        if let Some((from, before)) = self.field_last.replace((s.time, field))
            && s.time.seconds_since(from) < APART_S
        {
            let (by, turned) = (field - before, Some((field + before) * 0.5));
            self.field_changes.add(SensorChange { from, to: s.time, by, turned });
        }
    }

    fn flow(&mut self, s: &FlowSample) {
        self.flow.n += 1;
        self.flow.blind += u64::from(s.quality <= 0.0);
        self.flow.own_unit += u64::from(s.rotation == FlowRotation::InOwnUnit);
        // Rotation that is in the flow shows when it was: the way over ground does not change with the angular rate.
        if let FlowRotation::SensorGyro(gyro) = s.rotation
            && let Some(before) = self.flow.last.replace(s.time)
        {
            let dt = s.time.seconds_since(before);
            if dt > 0.0 && dt < APART_S {
                self.flow.angle += Vector3::new(gyro[0], gyro[1], 0.0) * dt;
                if let Some((from, angle)) = self.flow.before.replace((s.time, self.flow.angle)) {
                    let by = self.flow.angle - angle;
                    self.flow.changes.add(SensorChange { from, to: s.time, by, turned: None });
                }
            } else {
                self.flow.before = None;
            }
        }
    }

    fn range(&mut self, s: &RangeSample) {
        if s.direction != RangeDirection::Down {
            return;
        }
        let ranges = &mut self.ranges;
        ranges.n += 1;
        ranges.limits_m = s.limits_m.or(ranges.limits_m);
        if s.limits_m.is_some_and(|[least, most]| s.distance_m < least || s.distance_m > most) {
            ranges.beyond_limits += 1;
            return;
        }
        if let Some(above_m) = self.barometer.above_m
            && above_m > ECHO_FROM_M
            && s.distance_m < ECHO_PART * above_m
        {
            ranges.not_the_ground += 1;
            ranges.nearest_false_m =
                Some(ranges.nearest_false_m.map_or(s.distance_m, |m| m.min(s.distance_m)));
        }
    }

    fn pressure(&mut self, s: &PressureSample) {
        let Some(height_m) = pressure_altitude_m(s.pressure_pa) else { return };
        let first_m = *self.barometer.first_m.get_or_insert(height_m);
        self.barometer.above_m = Some(height_m - first_m);
        self.barometer.noise.add(Vector3::new(height_m, 0.0, 0.0));
    }

    /// What is to be said, of the sensors that were heard.
    pub(super) fn report(&self) -> Vec<SensorReport> {
        [
            self.of_imu(),
            self.of_field(),
            self.of_fixes(),
            self.of_flow(),
            self.of_ranges(),
            self.of_barometer(),
        ]
        .into_iter()
        .flatten()
        .collect()
    }

    fn of_imu(&self) -> Option<SensorReport> {
        let mut r = SensorReport::new("IMU");
        let (gyro, force) = (self.gyro.rms.value()?, self.accelerometer.rms.value()?);
        r.number("gyro_noise_radps", gyro);
        r.number("accelerometer_noise_mps2", force);
        r.remarks.push(format!(
            "noise and vibration from sample to sample {:.2} deg/s, {force:.2} m/s²",
            gyro.to_degrees()
        ));
        for (clipped, (what, unit)) in self.clipped.iter().zip([("gyro", "rad/s"), ("accelerometer", "m/s²")])
        {
            if clipped.samples > 0 {
                let (n, at) = (clipped.samples, clipped.extreme);
                r.remarks.push(format!("the {what} clips at {at:.1} {unit}: {n} samples"));
            }
        }
        r.number("gyro_clipped", self.clipped[0].samples as f64);
        r.number("accelerometer_clipped", self.clipped[1].samples as f64);
        Some(r)
    }

    fn of_field(&self) -> Option<SensorReport> {
        let mut r = SensorReport::new("magnetometer");
        let part = (self.field.n > 1).then(|| self.field.sigma() / self.field.mean)?;
        r.number("field_t", self.field.mean);
        r.number("field_spread", part);
        let disturbed = if part > SPREAD { ": disturbed, or not calibrated" } else { "" };
        r.remarks.push(format!(
            "field {:.1} µT, its strength spreads by {:.1} %{disturbed}",
            self.field.mean * 1e6,
            100.0 * part
        ));
        r.lag = self.field_changes.lag(&self.turned);
        Some(r)
    }

    fn of_fixes(&self) -> Option<SensorReport> {
        let mut r = SensorReport::new("GNSS");
        let f = &self.fixes;
        if f.told == 0 {
            return None;
        }
        r.number("without_fix", (f.told - f.fixed) as f64);
        if f.fixed == 0 {
            r.remarks.push(format!("never a fix, in {} messages", f.told));
            return Some(r);
        }
        if f.fixed < f.told {
            r.remarks.push(format!("no fix in {} of {} messages", f.told - f.fixed, f.told));
        }
        if f.satellites.n > 0 {
            r.number("satellites_mean", f.satellites.mean);
            r.remarks.push(format!("{:.0} satellites on average", f.satellites.mean));
        }
        if f.accuracy_m.n > 0 {
            r.number("claimed_accuracy_m", f.accuracy_m.mean);
            r.remarks.push(format!("claims to be off by {:.1} m on average", f.accuracy_m.mean));
        }
        r.number("course_frozen_s", f.frozen_s);
        if f.frozen_s > 0.0 {
            r.remarks.push(format!("its course is frozen while it moves: {:.0} s in all", f.frozen_s));
        }
        r.lag = f.changes.lag(&self.velocity);
        Some(r)
    }

    fn of_flow(&self) -> Option<SensorReport> {
        let mut r = SensorReport::new("optical flow");
        let f = &self.flow;
        if f.n == 0 {
            return None;
        }
        r.number("blind", f.blind as f64 / f.n as f64);
        r.remarks.push(format!("quality 0 in {:.0} % of the samples", 100.0 * f.blind as f64 / f.n as f64));
        if f.own_unit > 0 {
            r.remarks.push("in a unit of its own: its scale has to be learned against GNSS".to_owned());
        }
        r.lag = f.changes.lag(&self.turned);
        Some(r)
    }

    fn of_ranges(&self) -> Option<SensorReport> {
        let mut r = SensorReport::new("rangefinder");
        let ranges = &self.ranges;
        if ranges.n == 0 {
            return None;
        }
        r.number("beyond_limits", ranges.beyond_limits as f64);
        r.number("not_the_ground", ranges.not_the_ground as f64);
        if let Some([least, most]) = ranges.limits_m {
            r.remarks.push(format!("measures {least:.1} to {most:.1} m"));
        }
        if ranges.beyond_limits > 0 {
            r.remarks.push(format!("{} of {} beyond that", ranges.beyond_limits, ranges.n));
        }
        if let Some(nearest_m) = ranges.nearest_false_m {
            r.remarks.push(format!(
                "{} of {} far below the height by barometer (down to {nearest_m:.1} m): echoes of something else, or of nothing",
                ranges.not_the_ground, ranges.n
            ));
        }
        Some(r)
    }

    fn of_barometer(&self) -> Option<SensorReport> {
        let mut r = SensorReport::new("barometer");
        // One component of three is told.
        let noise_m = self.barometer.noise.rms.value()? * 3f64.sqrt();
        r.number("noise_m", noise_m);
        r.remarks.push(format!("noise from sample to sample {noise_m:.2} m"));
        Some(r)
    }
}
