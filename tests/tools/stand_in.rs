//! What answers `holdover preflight` over a socket: streams of a simulated flight, and parameters in the manner of ArduPilot or PX4.

use std::collections::{BTreeMap, VecDeque};
use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{JoinHandle, sleep};
use std::time::Duration;

use holdover::sample::{Airframe, VehicleStatus};
use holdover::sim::models::ImuModel;
use holdover::sim::{Scenario, SensorSuite, Simulation};
use holdover::time::Span;
use holdover::wire::companion_clock::CompanionClock;
use holdover::wire::encode_vehicle;
use holdover::wire::frame::{ComponentId, Scan, SystemId, scan};
use holdover::wire::session::Address;
use holdover::wire::session::identity::AutopilotKind;
use holdover::wire::session::outgoing::FrameWriter;
use mavlink::dialects::ardupilotmega as apm;
use mavlink::dialects::ardupilotmega::{MavMessage, MavParamType, MavProtocolCapability};

/// Types of parameters.
pub const INT8: u8 = 2;
pub const INT32: u8 = 6;
pub const REAL32: u8 = 9;

/// Where in its flight the vehicle is met, s.
const AIRBORNE_S: f64 = 60.0;

/// An autopilot that can be set up.
#[derive(Clone)]
pub struct StandIn {
    pub kind: AutopilotKind,
    /// Value and type, by name.
    pub parameters: BTreeMap<String, (f64, u8)>,
    /// One of so many questions for a parameter is lost.
    pub loses_one_of: Option<usize>,
    /// Parameters that keep their value, whatever is set.
    pub stubborn: Vec<&'static str>,
    pub answers_parameters: bool,
    pub armed: bool,
    pub flow: bool,
    /// Another vehicle speaks on the same link.
    pub company: bool,
    /// On the way back.
    pub delay: Duration,
}

/// What it has been told to do.
#[derive(Clone, Default)]
pub struct Told {
    pub parameters: BTreeMap<String, (f64, u8)>,
    pub sets: usize,
    pub reads: usize,
}

/// A stand-in that is running, until it is dropped.
pub struct Running {
    pub endpoint: String,
    told: Arc<Mutex<Told>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl StandIn {
    pub fn new(kind: AutopilotKind, parameters: &[(&str, f64, u8)]) -> Self {
        Self {
            kind,
            parameters: parameters.iter().map(|(n, v, t)| ((*n).to_owned(), (*v, *t))).collect(),
            loses_one_of: None,
            stubborn: Vec::new(),
            answers_parameters: true,
            armed: false,
            flow: true,
            company: false,
            delay: Duration::ZERO,
        }
    }

    pub fn start(self) -> Running {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_nonblocking(true).unwrap();
        let endpoint = format!("udpout:{}", socket.local_addr().unwrap());
        let told = Arc::new(Mutex::new(Told { parameters: self.parameters.clone(), ..Told::default() }));
        let stop = Arc::new(AtomicBool::new(false));
        let (shared, end) = (Arc::clone(&told), Arc::clone(&stop));
        let thread = std::thread::spawn(move || Stage::new(self, socket, shared).play(&end));
        Running { endpoint, told, stop, thread: Some(thread) }
    }
}

impl Running {
    pub fn told(&self) -> Told {
        self.told.lock().unwrap().clone()
    }

    pub fn value(&self, name: &str) -> f64 {
        self.told().parameters[name].0
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap();
    }
}

struct Stage {
    set_up: StandIn,
    socket: UdpSocket,
    told: Arc<Mutex<Told>>,
    clock: CompanionClock,
    peer: Option<SocketAddr>,
    writer: FrameWriter,
    waiting: VecDeque<(i64, Vec<u8>)>,
    /// A linear congruential generator's state.
    asked: u32,
}

fn address(system: u8) -> Address {
    Address { system: SystemId(system), component: ComponentId::AUTOPILOT }
}

impl Stage {
    fn new(set_up: StandIn, socket: UdpSocket, told: Arc<Mutex<Told>>) -> Self {
        let writer = FrameWriter::new(address(1));
        let clock = CompanionClock::new();
        Self { set_up, socket, told, clock, peer: None, writer, waiting: VecDeque::new(), asked: 0 }
    }

    fn now_us(&self) -> i64 {
        self.clock.now().micros()
    }

    fn play(mut self, stop: &AtomicBool) {
        let scenario = Scenario::square();
        let mut suite = SensorSuite::of(&scenario, ImuModel::mems());
        if !self.set_up.flow {
            suite.flow = None;
        }
        // In the air.
        let mut readings = Simulation::new(scenario, suite, 1).skip_while(|r| r.t_s < AIRBORNE_S).peekable();
        let (mut beat_us, mut buffer) = (0, [0; 2000]);
        while !stop.load(Ordering::Relaxed) {
            let now_us = self.now_us();
            while let Ok((n, from)) = self.socket.recv_from(&mut buffer) {
                self.peer = Some(from);
                self.hear(&buffer[..n]);
            }
            if now_us >= beat_us {
                beat_us = now_us + 500_000;
                self.beat();
            }
            while let Some(reading) = readings.next_if(|r| (r.t_s - AIRBORNE_S) * 1e6 <= now_us as f64) {
                let mut messages = Vec::new();
                encode_vehicle::samples(reading.samples.iter(), &mut messages);
                messages.iter().for_each(|m| self.send(m));
            }
            self.flush();
            sleep(Duration::from_millis(1));
        }
    }

    fn beat(&mut self) {
        let (airframe, armed) = (Some(Airframe::Multirotor), Some(self.set_up.armed));
        let status = VehicleStatus { airframe, armed, landed: None };
        let beat = encode_vehicle::heartbeat(self.set_up.kind, &status);
        self.send(&beat);
        if self.set_up.company {
            let frame = FrameWriter::new(address(2)).write(&beat).unwrap();
            self.waiting.push_back((self.now_us(), frame.to_vec()));
        }
    }

    fn send(&mut self, message: &MavMessage) {
        let due = self.clock.now() + Span::from_seconds(self.set_up.delay.as_secs_f64());
        self.waiting.push_back((due.micros(), self.writer.write(message).unwrap().to_vec()));
    }

    fn flush(&mut self) {
        let Some(peer) = self.peer else { return self.waiting.clear() };
        while self.waiting.front().is_some_and(|(due, _)| *due <= self.clock.now().micros()) {
            let (_, bytes) = self.waiting.pop_front().unwrap();
            // Who is gone hears nothing.
            let _ = self.socket.send_to(&bytes, peer);
        }
    }

    fn hear(&mut self, mut bytes: &[u8]) {
        while let Scan::Frame(frame) = scan(bytes, true) {
            bytes = &bytes[frame.len()..];
            match frame.parse().unwrap() {
                MavMessage::COMMAND_LONG(command) => self.command(&command),
                MavMessage::TIMESYNC(t) if t.tc1 == 0 => {
                    let tc1 = self.now_us() * 1000 + 1;
                    self.send(&MavMessage::TIMESYNC(apm::TIMESYNC_DATA {
                        tc1,
                        ts1: t.ts1,
                        target_system: 1,
                        target_component: 197,
                    }));
                }
                MavMessage::PARAM_REQUEST_READ(ask) if self.arrives() => {
                    assert_eq!((ask.target_system, ask.target_component, ask.param_index), (1, 1, -1));
                    self.told.lock().unwrap().reads += 1;
                    self.value(ask.param_id.to_str().unwrap());
                }
                MavMessage::PARAM_SET(set) if self.arrives() => {
                    assert_eq!((set.target_system, set.target_component), (1, 1));
                    self.set(&set);
                }
                _ => {}
            }
        }
    }

    /// Not every n-th in turn: questions that are repeated in step would meet the same fate each time.
    fn arrives(&mut self) -> bool {
        self.asked = self.asked.wrapping_mul(1_103_515_245).wrapping_add(12_345);
        let dice = (self.asked >> 16) as usize;
        self.set_up.answers_parameters && self.set_up.loses_one_of.is_none_or(|n| !dice.is_multiple_of(n))
    }

    fn command(&mut self, command: &apm::COMMAND_LONG_DATA) {
        let version = apm::AUTOPILOT_VERSION_DATA {
            capabilities: match self.set_up.kind {
                AutopilotKind::Px4 => MavProtocolCapability::from_bits_retain(2 | 16),
                _ => MavProtocolCapability::from_bits_retain(2),
            },
            flight_sw_version: 0x0407_00FF,
            ..apm::AUTOPILOT_VERSION_DATA::DEFAULT
        };
        if command.command == apm::MavCmd::MAV_CMD_REQUEST_MESSAGE && command.param1 == 148.0 {
            self.send(&MavMessage::AUTOPILOT_VERSION(version));
        }
        let ack = apm::COMMAND_ACK_DATA {
            command: command.command,
            result: apm::MavResult::MAV_RESULT_ACCEPTED,
            target_system: 1,
            target_component: 197,
            ..apm::COMMAND_ACK_DATA::DEFAULT
        };
        self.send(&MavMessage::COMMAND_ACK(ack));
    }

    /// Tells a parameter; PX4 says that it has none of that name, ArduPilot is silent.
    fn value(&mut self, name: &str) {
        let known = self.told.lock().unwrap().parameters.get(name).copied();
        let Some((value, kind)) = known else {
            if self.set_up.kind == AutopilotKind::Px4 {
                self.send(&MavMessage::PARAM_ERROR(apm::PARAM_ERROR_DATA {
                    param_index: -1,
                    target_system: 1,
                    target_component: 197,
                    param_id: name.into(),
                    error: apm::MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST,
                }));
            }
            return;
        };
        let bytewise = self.set_up.kind == AutopilotKind::Px4 && kind == INT32;
        let (param_value, param_type) = match kind {
            INT32 => (
                if bytewise { f32::from_bits(value as i32 as u32) } else { value as f32 },
                MavParamType::MAV_PARAM_TYPE_INT32,
            ),
            INT8 => (value as f32, MavParamType::MAV_PARAM_TYPE_INT8),
            _ => (value as f32, MavParamType::MAV_PARAM_TYPE_REAL32),
        };
        let param_id = name.into();
        let data =
            apm::PARAM_VALUE_DATA { param_value, param_count: 900, param_index: 1, param_id, param_type };
        self.send(&MavMessage::PARAM_VALUE(data));
    }

    fn set(&mut self, set: &apm::PARAM_SET_DATA) {
        let name = set.param_id.to_str().unwrap().to_owned();
        let px4 = self.set_up.kind == AutopilotKind::Px4;
        {
            let mut told = self.told.lock().unwrap();
            told.sets += 1;
            let stubborn = self.set_up.stubborn.contains(&name.as_str());
            if let Some((value, kind)) = told.parameters.get_mut(&name) {
                assert_eq!(set.param_type as u8, *kind, "PX4 refuses another type");
                let bytewise = px4 && *kind == INT32;
                let wanted = if bytewise {
                    f64::from(set.param_value.to_bits() as i32)
                } else {
                    f64::from(set.param_value)
                };
                if !stubborn {
                    *value = wanted;
                }
            }
        }
        self.value(&name);
    }
}
