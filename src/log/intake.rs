//! What the decoders of the autopilots' own logs have in common: every value is checked here once, as those of MAVLink are where they are
//! decoded, and what is not finite or not possible is counted and goes no further.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::geo::{Body, BodyToNed, Geodetic, Ned};
use crate::sample::{
    AirspeedSample, FlowSample, GnssSample, ImuSample, Input, LandmarkSample, MagSample, PressureSample,
    RangeSample, Reference, Sample, Sighting, TruthState, VehicleStatus,
};
use crate::time::{AutopilotTime, Span};
use crate::wire::clock::AutopilotClock;
use crate::wire::counters::{Cause, Counters};
use crate::wire::decode::limits;

use super::waiting::WaitingMessage;

/// Inertial units, magnetometers and airspeed sensors that are told apart.
pub(super) const MOST_SENSORS: usize = 8;
/// A better sensor that is silent for longer is replaced by the next.
const SILENCE: Span = Span::from_millis(1000);
/// A sample is measured at most so long before it is logged.
const LATEST: Span = Span::from_millis(1000);

/// Decoded, checked, on the autopilot's clock.
#[derive(Clone, Debug, Default)]
pub(super) struct Intake {
    pub(super) clock: AutopilotClock,
    pub(super) counters: Counters,
    pub(super) out: Vec<Input>,
    pub(super) imu: Ranked,
    pub(super) magnetometer: Ranked,
    pub(super) airspeed: Ranked,
    status: Option<VehicleStatus>,
    fixes: [Option<GnssSample>; 2],
    /// The last stamp has made the clock jump.
    jumped: bool,
    /// Nothing was logged for a while, and nothing has been told of the vehicle since.
    paused: bool,
}

/// The best of several sensors of one kind, listed best first, that was heard within the last second.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Ranked {
    heard: [Option<AutopilotTime>; MOST_SENSORS],
}

impl Ranked {
    /// Notes that a sensor was heard and tells whether it is the one to use.
    pub(super) fn take(&mut self, rank: usize, time: AutopilotTime) -> bool {
        let Some(slot) = self.heard.get_mut(rank) else { return false };
        *slot = Some(time);
        self.heard[..rank].iter().flatten().all(|&better| time - better > SILENCE)
    }
}

/// Finite numbers of a vector.
pub(super) fn vector(values: Option<[f64; 3]>) -> Result<Vector3<f64>, Cause> {
    let v = Vector3::from(values.ok_or(Cause::BadPayload)?);
    if v.iter().all(|c| c.is_finite()) { Ok(v) } else { Err(Cause::NotFinite) }
}

/// An attitude from a quaternion (scalar first) that is one.
pub(super) fn attitude(q: Option<[f64; 4]>) -> Result<BodyToNed, Cause> {
    let [w, x, y, z] = q.ok_or(Cause::BadPayload)?;
    let q = Quaternion::new(w, x, y, z);
    if !q.coords.iter().all(|c| c.is_finite()) {
        return Err(Cause::NotFinite);
    }
    let norm = q.norm();
    if (norm - 1.0).abs() > 0.05 {
        return Err(Cause::Absurd);
    }
    Ok(UnitQuaternion::new_unchecked(q / norm).into())
}

/// A position that a vehicle can have, and that is not the (0, 0) of those that know nothing.
pub(super) fn position(lat_deg: f64, lon_deg: f64, height_m: f64) -> Result<Geodetic, Cause> {
    let position = Geodetic::from_degrees(lat_deg, lon_deg, height_m);
    let somewhere = (lat_deg, lon_deg) != (0.0, 0.0);
    if position.is_plausible() && somewhere { Ok(position) } else { Err(Cause::Absurd) }
}

impl Intake {
    /// The time of a stamp in microseconds since boot.
    pub(super) fn time(&mut self, us: u64) -> Result<AutopilotTime, Cause> {
        let time = self.clock.usec(us);
        if let Some(event) = self.clock.take_event() {
            self.out.push(Input::Clock(event));
            (self.jumped, self.paused) = (true, true);
        }
        time
    }

    /// Whether the last stamp has made the clock jump, once: what waits is then to be read.
    pub(super) fn take_jumped(&mut self) -> bool {
        std::mem::take(&mut self.jumped)
    }

    /// The time of what has waited; `true` in `jumped` if the clock has jumped meanwhile. What a message says of the vehicle itself (`state`) holds from
    /// where it stands, whatever its stamp.
    pub(super) fn waited(
        &self,
        message: &WaitingMessage,
        jumped: bool,
        state: bool,
    ) -> Result<AutopilotTime, Cause> {
        let time = match message.us {
            Some(us) if jumped => self.clock.confirmed_usec(us),
            Some(_) => Err(message.cause),
            None => Ok(self.now()),
        };
        if state { time.or_else(|_| Ok(self.now())) } else { time }
    }

    /// The newest time, for what has none of its own.
    pub(super) fn now(&self) -> AutopilotTime {
        self.clock.newest().unwrap_or(AutopilotTime::from_micros(0))
    }

    /// What time of day it was at a stamp, µs since 1970 and since boot, as a receiver tells it.
    pub(super) fn date(&mut self, unix_us: u64, boot_us: u64) {
        if let Err(cause) = self.clock.system_time(unix_us, (boot_us / 1000) as u32) {
            self.counters.count(cause);
        }
    }

    /// When a sample was measured that was logged at `logged`, a stamp of `logged_us`: its own stamp where it has one that can be.
    pub(super) fn measured(logged: AutopilotTime, logged_us: u64, sample_us: Option<u64>) -> AutopilotTime {
        let late = sample_us.and_then(|s| i64::try_from(logged_us.checked_sub(s)?).ok());
        match late.map(Span::from_micros) {
            Some(late) if late <= LATEST => logged - late,
            _ => logged,
        }
    }

    fn sample(&mut self, sample: Sample) -> Result<(), Cause> {
        self.out.push(Input::Sample(sample));
        Ok(())
    }

    /// Angular rate, rad/s, and specific force, m/s², in the body's axes, of the `rank`-th best unit.
    pub(super) fn inertial(
        &mut self,
        rank: usize,
        time: AutopilotTime,
        rate_body: Vector3<f64>,
        force_body: Vector3<f64>,
    ) -> Result<(), Cause> {
        if force_body.amax() > limits::SPECIFIC_FORCE_MPS2 || rate_body.amax() > limits::ANGULAR_RATE_RADPS {
            return Err(Cause::Absurd);
        }
        // An accelerometer never reads exactly zero on all axes: the message is a shell without a sensor.
        if force_body == Vector3::zeros() || !self.imu.take(rank, time) {
            return Ok(());
        }
        let (angular_rate, specific_force) = (Body::new(rate_body), Body::new(force_body));
        self.sample(Sample::Imu(ImuSample { time, angular_rate, specific_force }))
    }

    /// Magnetic field, T, in the body's axes, of the `rank`-th best magnetometer.
    pub(super) fn magnetic(
        &mut self,
        rank: usize,
        time: AutopilotTime,
        field: Vector3<f64>,
    ) -> Result<(), Cause> {
        if field == Vector3::zeros() {
            return Ok(());
        }
        if !limits::FIELD_T.contains(&field.norm()) {
            return Err(Cause::Absurd);
        }
        if !self.magnetometer.take(rank, time) {
            return Ok(());
        }
        self.sample(Sample::Mag(MagSample { time, sensor: 0, field: Body::new(field) }))
    }

    /// Static pressure, Pa.
    pub(super) fn pressure(
        &mut self,
        sensor: u8,
        time: AutopilotTime,
        pressure_pa: f64,
    ) -> Result<(), Cause> {
        possible(pressure_pa, limits::PRESSURE_PA)?;
        self.sample(Sample::Pressure(PressureSample { time, sensor, pressure_pa }))
    }

    /// A fix, unless it was told before: receivers are logged by several messages.
    pub(super) fn gnss(&mut self, fix: GnssSample) -> Result<(), Cause> {
        if !fix.is_possible() {
            return Err(Cause::Absurd);
        }
        let last = self.fixes.get_mut(usize::from(fix.receiver)).ok_or(Cause::WrongSystem)?;
        if last.is_some_and(|last| is_repeated(&last, &fix)) {
            return Ok(());
        }
        *last = Some(fix);
        self.sample(Sample::Gnss(fix))
    }

    /// Optical flow.
    pub(super) fn flow(&mut self, flow: FlowSample) -> Result<(), Cause> {
        for rate in flow.rate_xy {
            possible(rate, -limits::FLOW_RADPS..=limits::FLOW_RADPS)?;
        }
        self.sample(Sample::Flow(flow))
    }

    /// A range.
    pub(super) fn range(&mut self, range: RangeSample) -> Result<(), Cause> {
        possible(range.distance_m, 0.0..=limits::RANGE_M)?;
        self.sample(Sample::Range(range))
    }

    /// Airspeed, m/s, of the `rank`-th best sensor.
    pub(super) fn airspeed(
        &mut self,
        rank: usize,
        time: AutopilotTime,
        airspeed_mps: f64,
    ) -> Result<(), Cause> {
        possible(airspeed_mps, limits::AIRSPEED_MPS)?;
        if !self.airspeed.take(rank, time) {
            return Ok(());
        }
        self.sample(Sample::Airspeed(AirspeedSample { time, airspeed_mps }))
    }

    /// A landmark, seen at two angles (rad) along the image's x and y.
    pub(super) fn landmark(&mut self, id: u8, time: AutopilotTime, angle_xy: [f64; 2]) -> Result<(), Cause> {
        for angle in angle_xy {
            possible(angle, -std::f64::consts::FRAC_PI_2..=std::f64::consts::FRAC_PI_2)?;
        }
        let sighting = Sighting::Bearing { angle_xy, distance_m: None };
        self.sample(Sample::Landmark(LandmarkSample { time, camera: 0, id, sighting }))
    }

    /// Whether it is armed, if that was told.
    pub(super) fn is_armed(&self) -> Option<bool> {
        self.status.and_then(|status| status.armed)
    }

    /// What has changed just now, which also tells what was before. A log that begins in flight tells of the end of what it never told the
    /// beginning of; and who is armed for a second time was disarmed while nothing was logged, for many write no more once they are.
    /// What was before is passed on first, in the same moment.
    pub(super) fn changed(&mut self, told: VehicleStatus) {
        let before = self.status.unwrap_or_default();
        let mut past = VehicleStatus::default();
        if before.armed.is_none() {
            past.armed = told.armed.filter(|armed| !armed).map(|_| true);
            past.landed = told.landed.filter(|landed| *landed && before.landed.is_none()).map(|_| false);
        } else if self.paused && told.armed == Some(true) && before.armed == told.armed {
            past = VehicleStatus { airframe: None, armed: Some(false), landed: before.landed.map(|_| true) };
        }
        if past != VehicleStatus::default() {
            self.status(past);
        }
        self.status(told);
    }

    /// What the vehicle is, whether it is armed and has landed: passed on when it changes. What is not told stays as it was.
    pub(super) fn status(&mut self, told: VehicleStatus) {
        self.paused = false;
        let before = self.status.unwrap_or_default();
        let status = VehicleStatus {
            airframe: told.airframe.or(before.airframe),
            armed: told.armed.or(before.armed),
            landed: told.landed.or(before.landed),
        };
        if self.status != Some(status) {
            self.status = Some(status);
            self.out.push(Input::Status(status));
        }
    }

    /// The autopilot's attitude.
    pub(super) fn attitude(&mut self, time: AutopilotTime, attitude: BodyToNed) {
        self.out.push(Input::Reference(Reference::Attitude { time, attitude }));
    }

    /// The autopilot's position, m, and velocity, m/s, at its own origin.
    pub(super) fn local(
        &mut self,
        time: AutopilotTime,
        position_ned: Vector3<f64>,
        velocity_ned: Vector3<f64>,
    ) -> Result<(), Cause> {
        if position_ned.amax() > limits::LOCAL_M || velocity_ned.amax() > limits::LOCAL_MPS {
            return Err(Cause::Absurd);
        }
        let (position, velocity) = (Ned::new(position_ned), Ned::new(velocity_ned));
        self.out.push(Input::Reference(Reference::Local { time, position, velocity }));
        Ok(())
    }

    /// The autopilot's position on the globe, and its velocity, m/s.
    pub(super) fn global(&mut self, time: AutopilotTime, position: Geodetic, velocity_ned: Vector3<f64>) {
        let velocity = Ned::new(velocity_ned);
        self.out.push(Input::Reference(Reference::Global { time, position, velocity }));
    }

    /// What the simulator knows.
    pub(super) fn truth(&mut self, truth: TruthState) {
        self.out.push(Input::Reference(Reference::Truth(truth)));
    }
}

/// A number within bounds.
pub(super) fn possible(value: f64, bounds: std::ops::RangeInclusive<f64>) -> Result<f64, Cause> {
    if !value.is_finite() {
        Err(Cause::NotFinite)
    } else if !bounds.contains(&value) {
        Err(Cause::Absurd)
    } else {
        Ok(value)
    }
}

/// Whether a fix tells what the one before did: the same stamp, or the same numbers within the time between two fixes of any receiver.
fn is_repeated(last: &GnssSample, fix: &GnssSample) -> bool {
    const SAME_FIX: Span = Span::from_millis(30);
    let numbers = |f: &GnssSample| (f.fix, f.position, f.ground_velocity);
    fix.position.is_some()
        && (fix.time <= last.time || (fix.time - last.time <= SAME_FIX && numbers(fix) == numbers(last)))
}
