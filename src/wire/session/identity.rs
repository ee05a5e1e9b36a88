//! Which vehicle Holdover serves, and what it is.
//!
//! The vehicle is chosen by what no single packet can show (`candidates`): heartbeats that keep their rhythm, of an autopilot's component, and
//! sensors that belong to it. It is kept: two vehicles on one radio must not be mixed in one filter. Only one that is silent, or never showed
//! a sensor, gives way to another, and one that was heard with sensors only on the ground and after a minute. What it is (autopilot, type,
//! armed) is believed to change when its heartbeats go on to say so (`nature`). Whatever else speaks is named by [`Sender`], and counted.

mod candidates;
mod nature;
mod shown;

use std::fmt;

use mavlink::MessageData;
use mavlink::dialects::ardupilotmega::{AUTOPILOT_VERSION_DATA, MavCmd, MavMessage};

use super::heartbeat_fields::HeartbeatFields;
use super::{Address, command_long};
use crate::time::{Companion, Span, Stamp};
use crate::wire::frame::{ComponentId, Frame, SystemId};
use candidates::{AutopilotCandidate, Candidates};
pub(crate) use nature::{Nature, NatureWord};
pub use shown::AutopilotShown;

/// The autopilots whose ways Holdover knows.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum AutopilotKind {
    /// ArduPilot (`MAV_AUTOPILOT` 3).
    ArduPilot,
    /// PX4 (`MAV_AUTOPILOT` 12).
    Px4,
    /// Another one, with its `MAV_AUTOPILOT` number.
    Other(u8),
}

impl AutopilotKind {
    /// By its `MAV_AUTOPILOT`.
    pub fn from_wire(autopilot: u8) -> Self {
        match autopilot {
            3 => AutopilotKind::ArduPilot,
            12 => AutopilotKind::Px4,
            other => AutopilotKind::Other(other),
        }
    }

    /// Its `MAV_AUTOPILOT`.
    pub(crate) fn to_wire(self) -> u8 {
        match self {
            AutopilotKind::ArduPilot => 3,
            AutopilotKind::Px4 => 12,
            AutopilotKind::Other(number) => number,
        }
    }
}

impl fmt::Display for AutopilotKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            AutopilotKind::ArduPilot => f.write_str("ArduPilot"),
            AutopilotKind::Px4 => f.write_str("PX4"),
            // `MAV_AUTOPILOT_GENERIC`.
            AutopilotKind::Other(0) => f.write_str("another autopilot"),
            AutopilotKind::Other(number) => write!(f, "autopilot {number}"),
        }
    }
}

/// Maturity of a firmware (`FIRMWARE_VERSION_TYPE`).
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum ReleaseType {
    /// 0
    Development,
    /// 64
    Alpha,
    /// 128
    Beta,
    /// 192
    Candidate,
    /// 255
    Official,
    /// A number between those.
    Other(u8),
}

/// A firmware version, as AUTOPILOT_VERSION packs it: major, minor, patch, type from the highest byte to the lowest.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct FirmwareVersion {
    /// Major.
    pub major: u8,
    /// Minor.
    pub minor: u8,
    /// Patch.
    pub patch: u8,
    /// How finished it is.
    pub release: ReleaseType,
}

impl FirmwareVersion {
    /// Unpacks `flight_sw_version`; 0 means that the autopilot does not say.
    pub fn from_packed(packed: u32) -> Option<Self> {
        let [major, minor, patch, release] = packed.to_be_bytes();
        let release = match release {
            0 => ReleaseType::Development,
            64 => ReleaseType::Alpha,
            128 => ReleaseType::Beta,
            192 => ReleaseType::Candidate,
            255 => ReleaseType::Official,
            other => ReleaseType::Other(other),
        };
        (packed != 0).then_some(Self { major, minor, patch, release })
    }
}

impl fmt::Display for FirmwareVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}.{}", self.major, self.minor, self.patch)?;
        match self.release {
            ReleaseType::Official => Ok(()),
            ReleaseType::Development => f.write_str("-dev"),
            ReleaseType::Alpha => f.write_str("-alpha"),
            ReleaseType::Beta => f.write_str("-beta"),
            ReleaseType::Candidate => f.write_str("-rc"),
            ReleaseType::Other(number) => write!(f, "-type{number}"),
        }
    }
}

/// The vehicle that is served.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Vehicle {
    /// Its system id, which Holdover takes as its own, too.
    pub system: SystemId,
    /// The autopilot's component id.
    pub component: ComponentId,
    /// Which autopilot it is.
    pub autopilot: AutopilotKind,
    /// `MAV_TYPE`.
    pub vehicle_type: u8,
    /// Whether it is armed.
    pub armed: bool,
    /// The firmware's version, once it was told.
    pub version: Option<FirmwareVersion>,
}

impl Vehicle {
    /// Where the autopilot is spoken to.
    pub fn address(&self) -> Address {
        Address { system: self.system, component: self.component }
    }
}

/// Who sent a frame.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Sender {
    /// The autopilot that is served.
    Autopilot,
    /// Another component of the same vehicle: a camera, a rangefinder, Holdover itself.
    SameSystem,
    /// Another vehicle or a ground station (counted as [`crate::wire::counters::Cause::WrongSystem`]).
    WrongSystem,
    /// No autopilot was heard yet, so it cannot be told.
    NotPinned,
}

/// What changed.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum IdentityEvent {
    /// An autopilot was chosen for the first time, or has another firmware than before.
    Found(Vehicle),
    /// Another autopilot was chosen, for the one before was silent or had no sensors.
    Replaced {
        /// That one.
        before: Vehicle,
        /// The one that is served from now on.
        by: Vehicle,
    },
    /// Nothing of the autopilot for so long.
    Lost {
        /// Time since its last message.
        silent: Span,
    },
    /// It is heard again. It may have rebooted meanwhile.
    Back,
    /// Its messages come, but no heartbeat for so long: some link or router drops them. Whether it is armed is not known.
    NoHeartbeat(Span),
    /// Armed or disarmed.
    Armed(bool),
    /// Heartbeats contradict each other in what the vehicle is or whether it is armed: so many since this was told last.
    Contradicted(u32),
    /// The firmware's version is known now, or another than before.
    Version(FirmwareVersion),
    /// The version was asked for in vain.
    VersionUnknown,
}

/// Settings of [`Identity`].
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct IdentityConfig {
    /// Serve this system only; `None` serves whichever is chosen.
    pub system: Option<SystemId>,
    /// Serve this component only; `None` prefers `MAV_COMP_ID_AUTOPILOT1`, and takes another that shows sensors.
    pub component: Option<ComponentId>,
    /// Without any message for so long, the autopilot counts as lost.
    pub lost_after: Span,
    /// Time between two requests for the version.
    pub version_retry: Span,
    /// How often the version is asked for.
    pub version_attempts: u8,
}

impl Default for IdentityConfig {
    fn default() -> Self {
        Self {
            system: None,
            component: None,
            lost_after: Span::from_millis(3000),
            version_retry: Span::from_millis(1000),
            version_attempts: 5,
        }
    }
}

/// What [`Identity::poll`] has to say.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct IdentityPoll {
    /// A message to send to the autopilot.
    pub send: Option<MavMessage>,
    /// Something that changed with time.
    pub event: Option<IdentityEvent>,
}

/// Heartbeats that are missing for so long, while other messages come, are worth a word: a lossy link drops several in a row.
const HEARTBEATS_MISSING: Span = Span::from_millis(10_000);
/// Who was chosen has this long to show sensors; it is longer each time that somebody else is tried.
const SENSORLESS: Span = Span::from_millis(10_000);
/// An autopilot with sensors that is not armed is given up after so long a silence.
const GIVEN_UP: Span = Span::from_millis(60_000);
/// Contradictions are told once in this time.
const TOLD_EVERY: Span = Span::from_millis(60_000);

/// Chooses the vehicle, watches its heartbeat and asks for its version.
#[derive(Clone, Debug)]
pub struct Identity {
    config: IdentityConfig,
    candidates: Candidates,
    pinned: Option<Pinned>,
    replaced: u32,
    wrong_system: u64,
}

#[derive(Clone, Debug)]
struct Pinned {
    vehicle: Vehicle,
    nature: Nature,
    since: Stamp<Companion>,
    heartbeat: Stamp<Companion>,
    /// When any message of its came.
    heard: Stamp<Companion>,
    lost: bool,
    /// That heartbeats are missing was told.
    missing_told: bool,
    /// It has shown sensors.
    proven: bool,
    question: VersionQuestion,
    contradicted: Contradicted,
}

/// Contradictions that were not told, and when some were.
#[derive(Clone, Copy, Debug, Default)]
struct Contradicted {
    count: u32,
    told: Option<Stamp<Companion>>,
}

/// The state of the question for the firmware's version.
#[derive(Clone, Debug, PartialEq)]
enum VersionQuestion {
    Open { asked: u8, due: Stamp<Companion> },
    Answered,
    GivenUp,
}

impl Identity {
    /// Nothing is known yet.
    pub fn new(config: IdentityConfig) -> Self {
        let candidates = Candidates::new(config.system, config.component);
        Self { config, candidates, pinned: None, replaced: 0, wrong_system: 0 }
    }

    /// The vehicle, once its autopilot was chosen; also while it is lost.
    pub fn vehicle(&self) -> Option<&Vehicle> {
        self.pinned.as_ref().map(|p| &p.vehicle)
    }

    /// Whether the autopilot is heard at present.
    pub fn is_heard(&self) -> bool {
        self.pinned.as_ref().is_some_and(|p| !p.lost)
    }

    /// Frames that came from other systems.
    pub fn wrong_system(&self) -> u64 {
        self.wrong_system
    }

    /// Of a log that has ended: who would have been chosen next, however little was heard of it.
    pub fn likeliest(&self) -> Option<Vehicle> {
        self.vehicle().copied().or_else(|| self.candidates.likeliest().map(|c| vehicle_of(&c.shown)))
    }

    /// This system was served a moment ago, by a process before: its autopilot need not prove itself again.
    pub fn expect(&mut self, system: SystemId) {
        self.candidates.expect(system);
    }

    /// A link has heard this of an autopilot before it passed anything on.
    pub fn heard_before(&mut self, now: Stamp<Companion>, shown: &AutopilotShown) {
        if self.pinned.is_none() {
            self.candidates.heard_before(now, shown);
        }
    }

    /// The autopilot's clock began anew: it may have been given other firmware.
    pub fn rebooted(&mut self) {
        if let Some(pinned) = &mut self.pinned {
            pinned.nature.independent();
        }
    }

    /// Takes note of a frame whose checksum was tested. Says who sent it, and what it changed.
    pub fn hear(&mut self, now: Stamp<Companion>, frame: &Frame<'_>) -> (Sender, Option<IdentityEvent>) {
        let from = Address { system: frame.system(), component: frame.component() };
        let heartbeat = HeartbeatFields::read(frame).filter(HeartbeatFields::is_autopilot);
        self.candidates.hear(now, from, frame.message_id(), heartbeat);
        if let Some(chosen) = self.choose(now, from) {
            return (Sender::Autopilot, Some(chosen));
        }
        let Some(pinned) = &mut self.pinned else {
            let wanted = self.config.system.is_none_or(|system| system == frame.system());
            self.wrong_system += u64::from(!wanted);
            return (if wanted { Sender::NotPinned } else { Sender::WrongSystem }, None);
        };
        if frame.system() != pinned.vehicle.system {
            self.wrong_system += 1;
            return (Sender::WrongSystem, None);
        }
        if frame.component() != pinned.vehicle.component {
            return (Sender::SameSystem, None);
        }
        pinned.proven |= self.candidates.shows_sensors(now, from);
        let back = pinned.is_back(now);
        let event = match heartbeat {
            Some(fields) => pinned.heartbeat(now, fields).or(back),
            None if back.is_some() => back,
            None if frame.message_id() == AUTOPILOT_VERSION_DATA::ID => pinned.version(frame),
            None => None,
        };
        (Sender::Autopilot, event)
    }

    /// Whether `from`, of whom there is a frame, is chosen now, or instead of who was.
    fn choose(&mut self, now: Stamp<Companion>, from: Address) -> Option<IdentityEvent> {
        let current = self.pinned.as_ref().map(|p| p.vehicle.address());
        let best = self.candidates.best(now, current).filter(|best| best.shown.address == from)?;
        let Some(pinned) = &self.pinned else {
            let pinned = Pinned::new(now, &best);
            let event = IdentityEvent::Found(pinned.vehicle);
            self.pinned = Some(pinned);
            return Some(event);
        };
        if !self.gives_way(now, pinned, &best) {
            return None;
        }
        let before = pinned.vehicle;
        let pinned = Pinned::new(now, &best);
        let by = pinned.vehicle;
        self.pinned = Some(pinned);
        self.replaced += 1;
        Some(IdentityEvent::Replaced { before, by })
    }

    /// Whether who is served is given up for `other`.
    fn gives_way(&self, now: Stamp<Companion>, pinned: &Pinned, other: &AutopilotCandidate) -> bool {
        let silent = now - pinned.heard;
        if pinned.proven {
            // In flight nobody else is believed to be the vehicle, however long it is silent.
            return silent >= GIVEN_UP && !pinned.vehicle.armed && other.shown.shows_sensors(now);
        }
        let patience = Span::from_micros(SENSORLESS.micros() << self.replaced.min(4));
        silent >= self.config.lost_after || now - pinned.since >= patience
    }

    /// Watches the time: the heartbeat's silence and the unanswered question for the version.
    pub fn poll(&mut self, now: Stamp<Companion>) -> IdentityPoll {
        let Some(pinned) = &mut self.pinned else { return IdentityPoll::default() };
        let (silent, beatless) = (now - pinned.heard, now - pinned.heartbeat);
        if !pinned.lost && silent > self.config.lost_after {
            pinned.lost = true;
            return IdentityPoll { send: None, event: Some(IdentityEvent::Lost { silent }) };
        }
        if !pinned.lost && !pinned.missing_told && beatless > HEARTBEATS_MISSING {
            pinned.missing_told = true;
            return IdentityPoll { send: None, event: Some(IdentityEvent::NoHeartbeat(beatless)) };
        }
        let VersionQuestion::Open { asked, due } = pinned.question else { return IdentityPoll::default() };
        if pinned.lost || now < due {
            return IdentityPoll::default();
        }
        if asked >= self.config.version_attempts {
            pinned.question = VersionQuestion::GivenUp;
            return IdentityPoll { send: None, event: Some(IdentityEvent::VersionUnknown) };
        }
        pinned.question = VersionQuestion::Open { asked: asked + 1, due: now + self.config.version_retry };
        let command = MavCmd::MAV_CMD_REQUEST_MESSAGE;
        let ask = command_long(pinned.vehicle.address(), command, AUTOPILOT_VERSION_DATA::ID as f32, 0.0);
        IdentityPoll { send: Some(ask), event: None }
    }
}

/// What a candidate's heartbeats say.
fn vehicle_of(shown: &AutopilotShown) -> Vehicle {
    Vehicle {
        system: shown.address.system,
        component: shown.address.component,
        autopilot: AutopilotKind::from_wire(shown.fields.autopilot),
        vehicle_type: shown.fields.vehicle_type,
        armed: shown.fields.armed(),
        version: None,
    }
}

impl Pinned {
    fn new(now: Stamp<Companion>, candidate: &AutopilotCandidate) -> Self {
        Self {
            vehicle: vehicle_of(&candidate.shown),
            nature: Nature::default(),
            since: now,
            heartbeat: now,
            heard: now,
            lost: false,
            missing_told: false,
            proven: candidate.shown.shows_sensors(now),
            question: VersionQuestion::Open { asked: 0, due: now },
            contradicted: Contradicted::default(),
        }
    }

    /// A message of its came; whether it is back by that.
    fn is_back(&mut self, now: Stamp<Companion>) -> Option<IdentityEvent> {
        self.heard = now;
        std::mem::take(&mut self.lost).then(|| {
            // Other firmware may have been loaded meanwhile.
            self.question = VersionQuestion::Open { asked: 0, due: now };
            self.nature.independent();
            IdentityEvent::Back
        })
    }

    fn heartbeat(&mut self, now: Stamp<Companion>, fields: HeartbeatFields) -> Option<IdentityEvent> {
        let was_armed = self.vehicle.armed;
        let kind = AutopilotKind::from_wire(fields.autopilot);
        self.heartbeat = now;
        self.missing_told = false;
        match self.nature.hear(now.micros(), fields) {
            NatureWord::Believed(nature) => {
                self.vehicle.vehicle_type = nature.vehicle_type;
                self.vehicle.armed = nature.armed();
                if AutopilotKind::from_wire(nature.autopilot) != self.vehicle.autopilot {
                    self.vehicle = Vehicle { autopilot: kind, version: None, ..self.vehicle };
                    self.question = VersionQuestion::Open { asked: 0, due: now };
                    return Some(IdentityEvent::Found(self.vehicle));
                }
                (was_armed != self.vehicle.armed).then_some(IdentityEvent::Armed(self.vehicle.armed))
            }
            NatureWord::Doubted => {
                if kind != self.vehicle.autopilot && self.question == VersionQuestion::Answered {
                    // What the firmware says of itself is evidence of its own.
                    self.question = VersionQuestion::Open { asked: 0, due: now };
                }
                self.contradicted.count += 1;
                self.contradicted.told(now).map(IdentityEvent::Contradicted)
            }
        }
    }

    fn version(&mut self, frame: &Frame<'_>) -> Option<IdentityEvent> {
        let Ok(MavMessage::AUTOPILOT_VERSION(data)) = frame.parse() else { return None };
        let version = FirmwareVersion::from_packed(data.flight_sw_version)?;
        self.question = VersionQuestion::Answered;
        let before = self.vehicle.version.replace(version);
        if before != Some(version) && before.is_some() {
            self.nature.independent();
        }
        (before != Some(version)).then_some(IdentityEvent::Version(version))
    }
}

impl Contradicted {
    /// How many are to be told now, if any.
    fn told(&mut self, now: Stamp<Companion>) -> Option<u32> {
        if self.told.is_some_and(|then| now - then < TOLD_EVERY) {
            return None;
        }
        self.told = Some(now);
        Some(std::mem::take(&mut self.count))
    }
}

#[cfg(test)]
mod tests;
