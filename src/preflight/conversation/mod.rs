//! The conversation before the flight, as a state machine: it is told what was heard and what time it is, and returns what to send.
//!
//! It waits for an autopilot, asks for streams and parameters as the daemon would, listens until both are there, and, where it may, sets
//! parameters and reads them back. Every wait has an end.

mod arrivals;
mod writing;

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use crate::config::Settings;
use crate::sample::{Input, SampleKind};
use crate::time::{Companion, Span, Stamp};
use crate::wire::decode::Decoder;
use crate::wire::frame::{ComponentId, Frame, SystemId};
use crate::wire::link::{LinkEvent, LinkEventKind};
use crate::wire::messages::from_any_component;
use crate::wire::session::Address;
use crate::wire::session::autopilot::{AutopilotSession, Reply, SessionPoll};
use crate::wire::session::hand_over::Situation;
use crate::wire::session::heartbeat_fields::HeartbeatFields;
use crate::wire::session::identity::{IdentityEvent, Sender, Vehicle};
use crate::wire::session::parameter_value::{ParameterEncoding, ParameterName, ParameterValue, capabilities};
use crate::wire::session::parameters::{ParameterAnswer, ParameterConfig, ParameterDialogue};

use super::finding::{Finding, FindingGrade};
use super::readings::Readings;
use super::{Needs, judge, wanted_parameters};
use arrivals::Arrivals;
pub use arrivals::sensor_unit;

/// Streams are listened to for this long at least: they are asked for one after the other, and measured for 4 s.
const LISTEN: Span = Span::from_millis(9000);
/// And for this long at most: an IMU message that never comes is asked for by another name.
const LONGEST: Span = Span::from_millis(30_000);
/// Setting parameters takes this long at most.
const LONGEST_WRITING: Span = Span::from_millis(20_000);

/// What the check ended with.
#[derive(Clone, Debug)]
pub enum PreflightEnd {
    /// No autopilot was heard; these systems were.
    NoAutopilot(Vec<u8>),
    /// Several vehicles are heard, and the configuration does not say which is meant.
    Several(Vec<u8>),
    /// The autopilot fell silent.
    FellSilent,
    /// It was read out.
    Read(Box<PreflightReport>),
}

/// What was read, found and set.
#[derive(Clone, Debug)]
pub struct PreflightReport {
    /// What was read; parameters as they are in the end.
    pub readings: Readings,
    /// Whether any parameter was told. An autopilot without known parameters is not asked.
    pub answers_parameters: bool,
    /// What is wrong, and worth knowing, in the end.
    pub findings: Vec<Finding>,
    /// What was set.
    pub written: Vec<WrittenParameter>,
    /// Why nothing was set although it was asked for.
    pub not_written: Option<&'static str>,
}

/// A parameter that was set.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct WrittenParameter {
    /// Which.
    pub parameter: String,
    /// Its value before.
    pub before: f64,
    /// What it was set to.
    pub wanted: f64,
    /// What was read back; `None` if nothing was.
    pub after: Option<f64>,
    /// Whether it was kept.
    pub took: bool,
    /// Whether it takes effect at the next boot only.
    pub reboot: bool,
}

impl PreflightReport {
    /// Whether Holdover can be started: no fault, and nothing waits for a reboot.
    pub fn ready(&self) -> bool {
        self.faults() == 0 && !self.reboot_needed()
    }

    /// How many faults there are.
    pub fn faults(&self) -> usize {
        self.findings.iter().filter(|f| f.grade == FindingGrade::Fault).count()
    }

    /// Whether something was set that takes effect at the next boot only.
    pub fn reboot_needed(&self) -> bool {
        self.written.iter().any(|w| w.took && w.reboot)
    }
}

#[derive(Clone, Debug)]
enum PreflightPhase {
    Waiting,
    Reading { since: Stamp<Companion> },
    Writing { since: Stamp<Companion>, read: Box<PreflightReport> },
    Ended(PreflightEnd),
}

/// Who else speaks on the links.
#[derive(Clone, Debug, Default)]
struct Company {
    systems: BTreeSet<u8>,
    vehicles: BTreeSet<u8>,
}

/// The parameters, and how their numbers are to be read.
#[derive(Clone, Debug)]
struct ParameterReading {
    dialogue: ParameterDialogue,
    /// AUTOPILOT_VERSION's, once told.
    capabilities: Option<u64>,
}

/// The conversation. See the module's documentation.
#[derive(Clone, Debug)]
pub struct Preflight {
    needs: Needs,
    system: Option<SystemId>,
    write: bool,
    /// Streams are listened to for so long at least.
    listen: Span,
    /// When to stop to wait for an autopilot.
    give_up: Stamp<Companion>,
    session: AutopilotSession,
    decoder: Decoder,
    arrivals: Arrivals,
    mavlink1: bool,
    parameters: Option<ParameterReading>,
    company: Company,
    phase: PreflightPhase,
    /// Of one frame; kept for its memory.
    inputs: Vec<Input>,
}

impl Preflight {
    /// Begins at `now`, and waits for an autopilot for `wait`. Sets parameters only with `write`.
    pub fn new(settings: &Settings, needs: Needs, write: bool, now: Stamp<Companion>, wait: Span) -> Self {
        Self {
            needs,
            system: settings.system,
            write,
            listen: LISTEN,
            give_up: now + wait,
            session: AutopilotSession::new(settings.identity(), settings.streams, settings.source_switch),
            decoder: Decoder::new(),
            arrivals: Arrivals::default(),
            mavlink1: false,
            parameters: None,
            company: Company::default(),
            phase: PreflightPhase::Waiting,
            inputs: Vec::new(),
        }
    }

    /// The same, listening for another time at least.
    pub fn listening_for(self, listen: Span) -> Self {
        Self { listen, ..self }
    }

    /// The vehicle, once its autopilot was heard.
    pub fn vehicle(&self) -> Option<&Vehicle> {
        self.session.vehicle()
    }

    /// Something happened to a link: what it has heard of an autopilot counts.
    pub fn link_event(&mut self, event: &LinkEvent) {
        if let LinkEventKind::PeerPinned { shown: Some(shown), .. } = &event.kind {
            self.session.heard_before(event.at, shown);
        }
    }

    /// Whether the autopilot that is followed sent `frame`.
    pub fn sent_by_autopilot(&self, frame: &Frame<'_>) -> bool {
        self.session.sent_by_autopilot(frame)
    }

    /// What it ended with, once it has.
    pub fn end(&self) -> Option<&PreflightEnd> {
        match &self.phase {
            PreflightPhase::Ended(end) => Some(end),
            _ => None,
        }
    }

    /// What the newest frame told of the vehicle.
    pub fn newest_inputs(&self) -> &[Input] {
        &self.inputs
    }

    /// Takes note of a frame whose checksum was tested, received at `at` and read at `now`. Returns what to answer at once.
    pub fn hear(&mut self, frame: &Frame<'_>, at: Stamp<Companion>, now: Stamp<Companion>) -> Reply {
        self.inputs.clear();
        self.company.note(frame);
        let (sender, event) = self.session.hear(at, frame);
        if let Some(IdentityEvent::Replaced { .. }) = event {
            self.decoder = Decoder::new();
        }
        if let Some(IdentityEvent::Found(vehicle) | IdentityEvent::Replaced { by: vehicle, .. }) = event {
            self.begin(&vehicle, at);
        }
        let mut reply = Reply::default();
        match sender {
            Sender::Autopilot => {
                self.mavlink1 = frame.is_mavlink1();
                if let Some(parameters) = &mut self.parameters {
                    parameters.capabilities = capabilities(frame).or(parameters.capabilities);
                    parameters.dialogue.hear(frame);
                }
                reply = self.session.converse(frame, at, now, self.decoder.clock());
            }
            Sender::SameSystem if from_any_component(frame.message_id()) => {}
            _ => return reply,
        }
        let mut inputs = std::mem::take(&mut self.inputs);
        self.decoder.decode(frame, Some(now), &mut inputs);
        self.session.stamped(self.decoder.clock().newest(), at);
        for input in &inputs {
            if matches!(input, Input::Origin(_)) {
                self.session.origin_heard();
            }
            self.arrivals.note(input, at);
        }
        self.inputs = inputs;
        reply
    }

    fn begin(&mut self, vehicle: &Vehicle, at: Stamp<Companion>) {
        self.decoder.follow(vehicle);
        self.session.begin(Address { system: vehicle.system, component: ComponentId::ODOMETRY_SOURCE });
        let mut dialogue = ParameterDialogue::new(ParameterConfig::default(), vehicle.address());
        for name in wanted_parameters(vehicle.autopilot) {
            if let Some(name) = ParameterName::new(&name) {
                dialogue.read(name);
            }
        }
        self.parameters = Some(ParameterReading { dialogue, capabilities: None });
        self.phase = PreflightPhase::Reading { since: at };
    }

    /// What is due now.
    pub fn poll(&mut self, now: Stamp<Companion>) -> SessionPoll {
        if self.end().is_some() {
            return SessionPoll::default();
        }
        if self.system.is_none() && self.company.vehicles.len() > 1 {
            let vehicles = self.company.vehicles.iter().copied().collect();
            self.phase = PreflightPhase::Ended(PreflightEnd::Several(vehicles));
            return SessionPoll::default();
        }
        self.advance(now);
        let mut due = self.session.poll(now, &Situation::LISTENING);
        if let Some(parameters) = &mut self.parameters {
            due.messages.extend(parameters.dialogue.poll(now));
        }
        due
    }

    fn advance(&mut self, now: Stamp<Companion>) {
        let asked = self.parameters.as_ref().is_none_or(|p| p.dialogue.done());
        match &self.phase {
            PreflightPhase::Waiting if now >= self.give_up => {
                let systems = self.company.systems.iter().copied().collect();
                self.phase = PreflightPhase::Ended(PreflightEnd::NoAutopilot(systems));
            }
            PreflightPhase::Reading { since } => {
                let imu = self.arrivals.rates_hz(now)[SampleKind::Imu as usize] > 0.0;
                let elapsed = now - *since;
                if elapsed >= LONGEST.max(self.listen) || (elapsed >= self.listen && asked && imu) {
                    self.read_out(now);
                }
            }
            PreflightPhase::Writing { since, read } if asked || now - *since >= LONGEST_WRITING => {
                let read = read.clone();
                self.written(*read);
            }
            PreflightPhase::Waiting | PreflightPhase::Writing { .. } | PreflightPhase::Ended(_) => {}
        }
    }

    /// Everything was read: judges it, and goes on to set what mends it.
    fn read_out(&mut self, now: Stamp<Companion>) {
        let Some(&vehicle) = self.session.vehicle().filter(|_| self.session.is_heard()) else {
            self.phase = PreflightPhase::Ended(PreflightEnd::FellSilent);
            return;
        };
        let (parameters, untold) = self.told();
        let readings = Readings {
            airframe: self.arrivals.airframe(),
            mavlink1: self.mavlink1,
            rates_hz: self.arrivals.rates_hz(now),
            gnss_fix: self.arrivals.gnss_fix(),
            round_trip: self.session.timesync().map(|(_, round_trip)| round_trip),
            parameters,
            untold,
            vehicle,
        };
        let answers = self.parameters.as_ref().is_some_and(|p| p.dialogue.answers());
        let mut report = PreflightReport {
            answers_parameters: answers || wanted_parameters(vehicle.autopilot).is_empty(),
            findings: judge(&readings, &self.needs),
            readings,
            written: Vec::new(),
            not_written: None,
        };
        if self.write {
            self.start_writing(&mut report);
        }
        self.phase = if report.written.is_empty() {
            PreflightPhase::Ended(PreflightEnd::Read(Box::new(report)))
        } else {
            PreflightPhase::Writing { since: now, read: Box::new(report) }
        };
    }

    fn encoding(&self) -> Option<ParameterEncoding> {
        let told = self.parameters.as_ref()?.capabilities;
        Some(ParameterEncoding::of(told, self.session.vehicle()?.autopilot))
    }

    /// The values that were told, and what was asked for and not told.
    fn told(&self) -> (BTreeMap<String, f64>, Vec<String>) {
        let (mut told, mut untold) = (BTreeMap::new(), Vec::new());
        let Some((reading, encoding)) = self.parameters.as_ref().zip(self.encoding()) else {
            return (told, untold);
        };
        for (name, answer) in reading.dialogue.results() {
            let number = match answer {
                ParameterAnswer::Value(value) => value.number(encoding),
                _ => None,
            };
            match number {
                Some(number) => drop(told.insert(name.to_string(), number)),
                None => untold.push(name.to_string()),
            }
        }
        (told, untold)
    }

    fn value(&self, name: &str) -> Option<ParameterValue> {
        let mut results = self.parameters.as_ref()?.dialogue.results();
        results.find_map(|(n, answer)| match answer {
            ParameterAnswer::Value(value) if n.as_str() == name => Some(value),
            _ => None,
        })
    }
}

impl Company {
    fn note(&mut self, frame: &Frame<'_>) {
        let system = frame.system().0;
        self.systems.insert(system);
        if system != 0 && HeartbeatFields::read(frame).is_some_and(|h| h.is_autopilot()) {
            self.vehicles.insert(system);
        }
    }
}
