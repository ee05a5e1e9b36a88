//! Frames of one vehicle to [`Input`]s: SI units, named frames, the autopilot's time.
//!
//! Every value is checked here once: what is not finite or not possible is counted and goes no further. Vehicles send the same
//! measurement several times (HIGHRES_IMU and RAW_IMU, say); `Preference` takes the best source that is alive.

mod aiding;
mod field_unit;
mod foreign;
mod gnss;
mod imu;
pub mod limits;
mod reference;
mod repair;
mod repeats;
mod rotors;
mod status;
#[cfg(test)]
mod tests;

use mavlink::dialects::ardupilotmega as apm;
use mavlink::dialects::ardupilotmega::MavMessage;
use nalgebra::Vector3;

use crate::sample::{Input, VehicleStatus};
use crate::time::{AutopilotTime, Companion, Span, Stamp};

use super::clock::{Arrival, AutopilotClock};
use super::counters::{Cause, Counters};
use super::frame::{ComponentId, Frame, SystemId, cause_of};
use super::gnss_integrity;
use super::messages::{from_any_component, is_input};
use super::session::identity::{AutopilotKind, Nature, Vehicle};

use aiding::FlowReadings;
use field_unit::FieldUnit;
use foreign::OwnSensors;
use gnss::Receiver;
pub use repair::{Repair, Repairs};
pub use rotors::RotorWord;
pub use status::airframe;

/// How the two autopilots fill the same messages differently.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct FieldConventions {
    /// RAW_IMU holds milli-g, mrad/s and milligauss (ArduPilot), not counts.
    raw_imu_is_scaled: bool,
    /// OPTICAL_FLOW's `flow_comp_m_x/y` holds the flow less the sensor's own rotation in rad/s (ArduPilot), not m/s.
    flow_comp_is_rate: bool,
    /// VFR_HUD's airspeed without a pitot tube is the autopilot's own estimate (ArduPilot), not NaN.
    airspeed_may_be_estimate: bool,
}

impl FieldConventions {
    fn of(vehicle: &Vehicle) -> Self {
        let ardupilot = vehicle.autopilot == AutopilotKind::ArduPilot;
        Self {
            raw_imu_is_scaled: ardupilot,
            flow_comp_is_rate: ardupilot,
            airspeed_may_be_estimate: vehicle.autopilot != AutopilotKind::Px4,
        }
    }
}

/// Turns the frames of one vehicle into inputs of the core.
#[derive(Clone, Debug)]
pub struct Decoder {
    vehicle: Option<(SystemId, ComponentId)>,
    conventions: FieldConventions,
    clock: AutopilotClock,
    counters: Counters,
    imu: Preference<5>,
    newest_inertial: Option<AutopilotTime>,
    pressure: Preference<2>,
    range: Preference<2>,
    attitude: Preference<2>,
    receivers: [Receiver; 2],
    /// Of HIGHRES_IMU, and of RAW_IMU and SCALED_IMU.
    field_units: [FieldUnit; 2],
    flows: Vec<FlowReadings>,
    own_sensors: OwnSensors,
    repairs: Repairs,
    /// What is decoded came on a link for sensors: nothing on it is the autopilot's own.
    apart: bool,
    nature: Nature,
    status: Option<VehicleStatus>,
    /// Whether there is a pitot tube, once that is known.
    pitot: Option<bool>,
}

type Out<'a> = &'a mut Vec<Input>;

impl Decoder {
    /// A decoder that follows no vehicle yet.
    pub fn new() -> Self {
        Self {
            vehicle: None,
            conventions: FieldConventions {
                raw_imu_is_scaled: false,
                flow_comp_is_rate: false,
                airspeed_may_be_estimate: true,
            },
            clock: AutopilotClock::new(),
            counters: Counters::default(),
            imu: Preference::default(),
            newest_inertial: None,
            pressure: Preference::default(),
            range: Preference::default(),
            attitude: Preference::default(),
            receivers: [Receiver::default(); 2],
            field_units: [FieldUnit::default(); 2],
            flows: Vec::new(),
            own_sensors: OwnSensors::default(),
            repairs: Repairs::default(),
            apart: false,
            nature: Nature::default(),
            status: None,
            pitot: None,
        }
    }

    /// From now on follows this autopilot.
    pub fn follow(&mut self, vehicle: &Vehicle) {
        self.vehicle = Some((vehicle.system, vehicle.component));
        self.conventions = FieldConventions::of(vehicle);
        self.nature = Nature::default();
    }

    /// Whether it follows this autopilot.
    pub fn follows(&self, vehicle: &Vehicle) -> bool {
        self.vehicle == Some((vehicle.system, vehicle.component))
    }

    /// The autopilot's clock.
    pub fn clock(&self) -> &AutopilotClock {
        &self.clock
    }

    /// What was rejected so far.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// What was put right so far.
    pub fn repairs(&self) -> &Repairs {
        &self.repairs
    }

    /// A repair that goes on and was not told yet.
    pub fn take_repair_news(&mut self) -> Option<Repair> {
        self.repairs.take_news()
    }

    /// Decodes `frame`, which had come by `at` where that was noted, and appends what it told to `out`. Frames of other systems, and anything
    /// rejected, are counted.
    pub fn decode(&mut self, frame: &Frame<'_>, at: Option<Stamp<Companion>>, out: &mut Vec<Input>) {
        if self.vehicle != Some((frame.system(), frame.component())) {
            if self.vehicle.is_none_or(|(system, _)| system != frame.system()) {
                return self.counters.count(Cause::WrongSystem);
            }
            if !from_any_component(frame.message_id()) {
                return;
            }
        }
        self.counters.frames += 1;
        if !is_input(frame.message_id()) {
            return;
        }
        self.clock.arrives(Arrival { at, sequence: frame.sequence(), message_id: frame.message_id() });
        let result = match frame.parse() {
            _ if frame.message_id() == gnss_integrity::ID => self.gnss_integrity(frame.payload()),
            Ok(message) if from_any_component(frame.message_id()) => {
                self.any_component(&message, frame.component(), out)
            }
            Ok(message) => self.message(&message, out),
            Err(error) => Err(cause_of(&error)),
        };
        if let Err(cause) = result {
            self.counters.count(cause);
        }
        if let Some(event) = self.clock.take_event() {
            // Before the sample that revealed it.
            out.insert(0, Input::Clock(event));
        }
    }

    /// Decodes a frame that came on a link for sensors, of whatever system. Whether it is a measurement that any component may make: nothing
    /// else is taken there.
    pub fn decode_sensor(&mut self, frame: &Frame<'_>, out: &mut Vec<Input>) -> bool {
        if self.vehicle.is_none() || !from_any_component(frame.message_id()) {
            return false;
        }
        self.counters.frames += 1;
        self.apart = true;
        let result = match frame.parse() {
            Ok(message) => self.any_component(&message, frame.component(), out),
            Err(error) => Err(cause_of(&error)),
        };
        self.apart = false;
        if let Err(cause) = result {
            self.counters.count(cause);
        }
        true
    }

    fn message(&mut self, message: &MavMessage, out: Out<'_>) -> Result<(), Cause> {
        match message {
            MavMessage::HEARTBEAT(m) => self.heartbeat(m, out),
            MavMessage::SYS_STATUS(m) => self.sys_status(m),
            MavMessage::EXTENDED_SYS_STATE(m) => self.extended_sys_state(m, out),
            MavMessage::HIGHRES_IMU(m) => self.highres_imu(m, out),
            MavMessage::SCALED_IMU(m) => self.scaled_imu(1, m, out),
            MavMessage::RAW_IMU(m) => self.raw_imu(m, out),
            MavMessage::SCALED_IMU2(m) => self.scaled_imu2(m, out),
            MavMessage::SCALED_IMU3(m) => self.scaled_imu3(m, out),
            MavMessage::GPS_RAW_INT(m) => self.gps_raw_int(m, out),
            MavMessage::GPS2_RAW(m) => self.gps2_raw(m, out),
            MavMessage::GPS_GLOBAL_ORIGIN(m) => gnss::origin(m).map(|o| out.push(Input::Origin(o))),
            MavMessage::SCALED_PRESSURE(m) => self.scaled_pressure(m, out),
            MavMessage::SCALED_PRESSURE2(m) => self.pressure(1, m.time_boot_ms, m.press_abs, out),
            MavMessage::SCALED_PRESSURE3(m) => self.pressure(2, m.time_boot_ms, m.press_abs, out),
            MavMessage::RANGEFINDER(m) => self.rangefinder(m, out),
            MavMessage::VFR_HUD(m) => self.airspeed(m.airspeed, out),
            MavMessage::SYSTEM_TIME(m) => self.system_time(m),
            MavMessage::SIM_STATE(m) => self.sim_state(m, out),
            MavMessage::SIMSTATE(m) => self.simstate(m, out),
            MavMessage::HIL_STATE_QUATERNION(m) => self.hil_state(m, out),
            MavMessage::ATTITUDE(m) => self.attitude(m, out),
            MavMessage::ATTITUDE_QUATERNION(m) => self.attitude_quaternion(m, out),
            MavMessage::LOCAL_POSITION_NED(m) => self.local_position(m, out),
            MavMessage::GLOBAL_POSITION_INT(m) => self.global_position(m, out),
            _ => Ok(()),
        }
    }

    /// A measurement that any component of the vehicle may make.
    fn any_component(&mut self, message: &MavMessage, from: ComponentId, out: Out<'_>) -> Result<(), Cause> {
        match message {
            MavMessage::OPTICAL_FLOW(m) => self.optical_flow(m, from, out),
            MavMessage::OPTICAL_FLOW_RAD(m) => self.optical_flow_rad(m, from, out),
            MavMessage::DISTANCE_SENSOR(m) => self.distance_sensor(m, from, out),
            MavMessage::LANDING_TARGET(m) => self.landing_target(m, from, out),
            _ => Ok(()),
        }
    }

    fn system_time(&mut self, m: &apm::SYSTEM_TIME_DATA) -> Result<(), Cause> {
        self.clock.boot_ms(m.time_boot_ms)?;
        self.clock.system_time(m.time_unix_usec, m.time_boot_ms)
    }

    /// The newest time of the stream, for messages that carry none.
    fn now(&self) -> Result<AutopilotTime, Cause> {
        self.clock.newest().ok_or(Cause::Stale)
    }
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

/// Chooses among several sources of the same measurement, listed best first: the best one that was heard within the last second.
#[derive(Clone, Debug)]
struct Preference<const N: usize> {
    heard: [Option<AutopilotTime>; N],
}

impl<const N: usize> Default for Preference<N> {
    fn default() -> Self {
        Self { heard: [None; N] }
    }
}

impl<const N: usize> Preference<N> {
    const SILENCE: Span = Span::from_millis(1000);

    /// Notes that source `rank` was heard and tells whether it is the one to use.
    fn take(&mut self, rank: usize, time: AutopilotTime) -> bool {
        let Some(slot) = self.heard.get_mut(rank) else { return false };
        *slot = Some(time);
        self.heard[..rank].iter().flatten().all(|&better| time - better > Self::SILENCE)
    }
}

/// A vector of finite numbers.
fn finite(x: f32, y: f32, z: f32) -> Result<Vector3<f64>, Cause> {
    let v = Vector3::new(f64::from(x), f64::from(y), f64::from(z));
    if v.iter().all(|c| c.is_finite()) { Ok(v) } else { Err(Cause::NotFinite) }
}

/// `value` if it is finite and within the bounds.
fn within(value: f32, low: f64, high: f64) -> Result<f64, Cause> {
    let v = f64::from(value);
    if !v.is_finite() {
        Err(Cause::NotFinite)
    } else if v < low || v > high {
        Err(Cause::Absurd)
    } else {
        Ok(v)
    }
}
