//! An autopilot's double: [`crate::sim::autopilot`] speaking MAVLink, with the manners of ArduPilot or PX4.
//!
//! Frames in, steps of time, frames out. There is no socket and no clock here: `simulate --autopilot` and the tests drive it, in real
//! time or as fast as they like. What it tells and obeys is what a companion needs; it is no autopilot.

mod clock;
mod commands;
mod estimate;
mod external;
pub mod manners;
pub mod parameters;
mod report;
mod schedule;
mod telemetry;
mod words;

use std::collections::VecDeque;

use mavlink::MessageData;
use mavlink::dialects::ardupilotmega as apm;
use nalgebra::Vector3;

use crate::sample::Sample;
use crate::sim::autopilot::link::{FaultyLink, LinkFaults};
use crate::sim::autopilot::script::FlightScript;
use crate::sim::autopilot::{SimulatedAutopilot, VehicleNews, VehicleSetup};
use crate::sim::models::ImuModel;
use crate::time::AutopilotTime;
use crate::wire::encode_vehicle;
use crate::wire::frame::{ComponentId, SystemId};
use crate::wire::frame_bytes::FrameBytes;
use crate::wire::messages::Message;
use crate::wire::session::Address;
use crate::wire::session::identity::AutopilotKind;
use crate::wire::session::outgoing::FrameWriter;

use clock::TimesyncExchange;
use manners::{Manner, Manners};
use parameters::DoubleParameters;
pub use report::DoubleReport;
use report::FlightRecord;
use schedule::{MessageSchedule, STATION_INTERVAL_US};
use telemetry::Telemetry;
use words::Words;

/// ArduPilot's loop runs at 400 Hz, PX4's SIH at 250 Hz: nothing is sent between two of these steps, µs.
const ARDUPILOT_STEP_US: i64 = 2500;
const PX4_STEP_US: i64 = 4000;
/// Between two heartbeats, µs.
const HEARTBEAT_US: i64 = 1_000_000;
/// A reboot is silent for so long, s.
const REBOOT_S: f64 = 2.0;
/// A ground station sets the rates for the first time, and between two times, s.
const STATION_S: [f64; 2] = [30.0, 120.0];
/// Parameters told in one step.
const PARAMETERS_A_STEP: usize = 2;
/// `MAV_COMP_ID_CAMERA`.
const CAMERA: ComponentId = ComponentId(100);

/// Where a frame leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DoublePort {
    /// The autopilot's link.
    Main,
    /// The camera's own.
    Camera,
}

/// What a double is made with.
#[derive(Clone, Debug)]
pub struct DoubleSettings {
    /// ArduPilot or PX4.
    pub kind: AutopilotKind,
    /// Its system id.
    pub system: SystemId,
    /// Its parameters at boot.
    pub parameters: DoubleParameters,
    /// Its manners.
    pub manners: Manners,
    /// What the pilot does.
    pub script: FlightScript,
    /// The IMU.
    pub imu: ImuModel,
    /// The steady wind, NED, m/s.
    pub wind_ned: Vector3<f64>,
    /// Whether anything sees the ground: flow and distance.
    pub sees: bool,
    /// A companion camera tells of flow and distance in the place of the autopilot, and where.
    pub camera: Option<DoublePort>,
    /// Faults of the link.
    pub faults: LinkFaults,
    /// Everything random is drawn from this.
    pub seed: u64,
}

impl DoubleSettings {
    /// An autopilot set up as the documentation says, in calm air, with a flow sensor, and this pilot.
    pub fn documented(kind: AutopilotKind, script: FlightScript) -> Self {
        Self {
            kind,
            system: SystemId(1),
            parameters: DoubleParameters::documented(kind),
            manners: Manners::usual(kind),
            script,
            imu: ImuModel::mems(),
            wind_ned: Vector3::zeros(),
            sees: true,
            camera: None,
            faults: LinkFaults::default(),
            seed: 1,
        }
    }
}

/// A companion camera that measures flow and distance.
#[derive(Clone, Debug)]
struct CompanionCamera {
    port: DoublePort,
    writer: FrameWriter,
    told: Option<AutopilotTime>,
    beat_us: i64,
}

/// The double. See the module.
#[derive(Debug)]
pub struct AutopilotDouble {
    settings: DoubleSettings,
    vehicle: SimulatedAutopilot,
    parameters: DoubleParameters,
    manners: Manners,
    schedule: MessageSchedule,
    clock: TimesyncExchange,
    words: Words,
    /// Places of the parameters that are to be told.
    to_tell: VecDeque<usize>,
    /// Stamps of the readings that were told, by message.
    told: Vec<(u32, AutopilotTime)>,
    writer: FrameWriter,
    down: FaultyLink<(DoublePort, FrameBytes)>,
    up: FaultyLink<FrameBytes>,
    camera: Option<CompanionCamera>,
    /// When the next heartbeat is due, and the ground station's next interference, s; and until when a reboot is silent.
    due_s: [f64; 3],
    record: FlightRecord,
}

impl AutopilotDouble {
    /// A double that boots.
    pub fn new(settings: DoubleSettings) -> Self {
        let step_us = if settings.kind == AutopilotKind::Px4 { PX4_STEP_US } else { ARDUPILOT_STEP_US };
        let vehicle = SimulatedAutopilot::new(VehicleSetup {
            rules: settings.parameters.rules(),
            imu: settings.imu,
            sees: settings.sees || settings.camera.is_some(),
            wind_ned: settings.wind_ned,
            script: settings.script.clone(),
            step_us,
            seed: settings.seed,
        });
        let writer = |component| FrameWriter::new(Address { system: settings.system, component });
        let camera = settings.camera.map(|port| CompanionCamera {
            port,
            writer: writer(CAMERA),
            told: None,
            beat_us: 0,
        });
        Self {
            vehicle,
            parameters: settings.parameters.clone(),
            manners: settings.manners.clone(),
            schedule: MessageSchedule::usual(settings.kind),
            clock: TimesyncExchange::default(),
            words: Words::default(),
            to_tell: VecDeque::new(),
            told: Vec::new(),
            writer: writer(ComponentId::AUTOPILOT),
            down: FaultyLink::new(settings.faults, settings.seed, 0),
            up: FaultyLink::new(settings.faults, settings.seed, 1),
            camera,
            due_s: [0.0, STATION_S[0], 0.0],
            record: FlightRecord::default(),
            settings,
        }
    }

    /// Whose double it is.
    pub fn kind(&self) -> AutopilotKind {
        self.settings.kind
    }

    fn address(&self) -> Address {
        self.writer.from()
    }

    /// The vehicle, with the truth that nobody else knows.
    pub fn vehicle(&self) -> &SimulatedAutopilot {
        &self.vehicle
    }

    /// The vehicle, to do something to it.
    pub fn vehicle_mut(&mut self) -> &mut SimulatedAutopilot {
        &mut self.vehicle
    }

    /// The report of the flight so far.
    pub fn report(&self) -> DoubleReport {
        self.record.report(self.vehicle.external_counts())
    }

    /// What happened since it was asked last, with the seconds at which it did.
    pub fn take_news(&mut self) -> Vec<(f64, VehicleNews)> {
        self.record.take_news()
    }

    /// A frame that came.
    pub fn hear(&mut self, bytes: FrameBytes) {
        self.up.give(self.vehicle.now_s(), bytes);
    }

    /// Goes on by one step of its loop; appends the frames that leave.
    pub fn step(&mut self, out: &mut Vec<(DoublePort, FrameBytes)>) {
        self.vehicle.step();
        let now_s = self.vehicle.now_s();
        self.record.look(&self.vehicle);
        let up = now_s >= self.due_s[2];
        while let Some(bytes) = self.up.take(now_s) {
            if up {
                self.listen(&bytes);
            }
        }
        if up {
            self.speak(now_s);
        }
        self.camera_speaks();
        while let Some(frame) = self.down.take(now_s) {
            out.push(frame);
        }
    }

    fn listen(&mut self, bytes: &FrameBytes) {
        let Some(frame) = bytes.frame() else { return };
        let Ok(message) = frame.parse() else { return };
        let from = Address { system: frame.system(), component: frame.component() };
        if from == self.address() || commands::converse(self, from, &message) {
            return;
        }
        let now_us = self.vehicle.boot_time().micros();
        if let Message::TIMESYNC(m) = &message {
            let answers = self.manners.has(Manner::AnswersTimesync);
            let answer = self.clock.hear(m, now_us, answers, (from.system.0, from.component.0));
            answer.into_iter().for_each(|a| self.say(a));
            return;
        }
        if let (Message::OPTICAL_FLOW_RAD(_), true) = (&message, self.manners.has(Manner::EchoesFlow)) {
            self.say(message);
            return;
        }
        let now_s = self.vehicle.now_s();
        if let Some(pose) = external::read(&message, now_s, now_s - now_us as f64 * 1e-6) {
            self.vehicle.external(&pose, self.clock.converged());
        }
    }

    fn speak(&mut self, now_s: f64) {
        let now_us = self.vehicle.boot_time().micros();
        if now_s >= self.due_s[0] {
            self.due_s[0] = now_s + HEARTBEAT_US as f64 * 1e-6;
            let beat = self.tells().heartbeat();
            self.say(beat);
        }
        if self.manners.has(Manner::StationRates) && now_s >= self.due_s[1] {
            self.due_s[1] = now_s + STATION_S[1];
            self.schedule.set_all(STATION_INTERVAL_US);
        }
        let due: Vec<u32> = self.schedule.due(now_us).collect();
        for id in due {
            if self.is_news(id)
                && let Some(message) = self.telemetry(id)
            {
                self.say(message);
            }
        }
        if self.manners.has(Manner::AsksTimesync) {
            let question = self.clock.question(now_us);
            question.into_iter().for_each(|q| self.say(q));
        }
        for _ in 0..PARAMETERS_A_STEP {
            let told = self.to_tell.pop_front().and_then(|index| self.parameters.message(index));
            told.into_iter().for_each(|m| self.say(m));
        }
        for news in self.vehicle.take_news() {
            self.record.keep(now_s, news);
            let words = self.words.news(self.settings.kind, news);
            words.into_iter().for_each(|m| self.say(m));
        }
    }

    fn tells(&self) -> Telemetry<'_> {
        Telemetry {
            kind: self.settings.kind,
            vehicle: &self.vehicle,
            manners: &self.manners,
            sees: self.settings.camera.is_none() && self.settings.sees,
        }
    }

    fn telemetry(&self, id: u32) -> Option<Message> {
        self.tells().message(id)
    }

    /// Whether a message is sent now that it is due: PX4 sends a reading once, ArduPilot at the stream's rate.
    fn is_news(&mut self, id: u32) -> bool {
        let newest = self.vehicle.newest();
        let (time, repeats) = match id {
            apm::GPS_RAW_INT_DATA::ID => (newest.gnss.map(|s| s.time), Manner::RepeatedGnss),
            apm::OPTICAL_FLOW_DATA::ID | apm::OPTICAL_FLOW_RAD_DATA::ID => {
                (newest.flow.map(|s| s.time), Manner::RepeatedFlow)
            }
            apm::SCALED_PRESSURE_DATA::ID => (newest.pressure.map(|s| s.time), Manner::RepeatedGnss),
            apm::DISTANCE_SENSOR_DATA::ID => (newest.range.map(|s| s.time), Manner::RepeatedGnss),
            _ => return true,
        };
        let Some(time) = time else { return false };
        if self.manners.has(repeats) {
            return true;
        }
        match self.told.iter_mut().find(|(told, _)| *told == id) {
            Some((_, told)) => std::mem::replace(told, time) != time,
            None => {
                self.told.push((id, time));
                true
            }
        }
    }

    /// Everything but the vehicle begins anew, in silence.
    fn rebooted(&mut self) {
        let now_s = self.vehicle.now_s();
        self.schedule = MessageSchedule::usual(self.settings.kind);
        self.clock = TimesyncExchange::default();
        self.told.clear();
        self.due_s = [0.0, now_s + STATION_S[0], now_s + REBOOT_S];
    }

    fn say(&mut self, message: Message) {
        self.send(DoublePort::Main, &message);
    }

    fn send(&mut self, port: DoublePort, message: &Message) {
        if let Some(bytes) = self.writer.write(message) {
            self.down.give(self.vehicle.now_s(), (port, bytes));
        }
    }

    fn camera_speaks(&mut self) {
        let Some(camera) = &mut self.camera else { return };
        let newest = self.vehicle.newest();
        let (now_s, now_us) = (self.vehicle.now_s(), (self.vehicle.now_s() * 1e6) as i64);
        let mut messages = Vec::new();
        if now_us >= camera.beat_us {
            camera.beat_us = now_us + HEARTBEAT_US;
            messages.push(camera_heartbeat());
        }
        if let Some(flow) = newest.flow.filter(|f| camera.told != Some(f.time)) {
            camera.told = Some(flow.time);
            let samples = [Some(Sample::Flow(flow)), newest.range.map(Sample::Range)];
            encode_vehicle::samples(samples.iter().flatten(), &mut messages);
        }
        let (port, echoes) = (camera.port, self.manners.has(Manner::EchoesFlow));
        for message in &messages {
            if let Some(bytes) = camera.writer.write(message) {
                self.down.give(now_s, (port, bytes));
            }
        }
        // PX4 hears the camera on any of its links.
        let echoed = |m: &Message| echoes && matches!(m, Message::OPTICAL_FLOW_RAD(_));
        for message in messages.into_iter().filter(echoed) {
            self.send(DoublePort::Main, &message);
        }
    }
}

fn camera_heartbeat() -> Message {
    Message::HEARTBEAT(apm::HEARTBEAT_DATA {
        custom_mode: 0,
        mavtype: apm::MavType::MAV_TYPE_CAMERA,
        autopilot: apm::MavAutopilot::MAV_AUTOPILOT_INVALID,
        base_mode: apm::MavModeFlag::empty(),
        system_status: apm::MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
    })
}

#[cfg(test)]
mod tests;
