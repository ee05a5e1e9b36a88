//! Which vehicle Holdover serves, and what it is.
//!
//! The first autopilot whose heartbeat is heard (or the configured system id) is pinned and never changed: two vehicles on one
//! radio must not be mixed in one filter. Whatever else speaks is named by [`Sender`], and counted.

use std::fmt;

use mavlink::MessageData;
use mavlink::dialects::ardupilotmega::{AUTOPILOT_VERSION_DATA, MavCmd, MavMessage};

use super::heartbeat_fields::HeartbeatFields;
use super::{Address, command_long};
use crate::time::{Companion, Span, Stamp};
use crate::wire::frame::{ComponentId, Frame, SystemId};

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
    fn from_wire(autopilot: u8) -> Self {
        match autopilot {
            3 => AutopilotKind::ArduPilot,
            12 => AutopilotKind::Px4,
            other => AutopilotKind::Other(other),
        }
    }
}

impl fmt::Display for AutopilotKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            AutopilotKind::ArduPilot => f.write_str("ArduPilot"),
            AutopilotKind::Px4 => f.write_str("PX4"),
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
    /// An autopilot was heard for the first time, or with another firmware than before.
    Found(Vehicle),
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
    /// The firmware's version is known now, or another than before.
    Version(FirmwareVersion),
    /// The version was asked for in vain.
    VersionUnknown,
}

/// Settings of [`Identity`].
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct IdentityConfig {
    /// Serve this system only; `None` serves the first that is heard.
    pub system: Option<SystemId>,
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

/// Pins the vehicle, watches its heartbeat and asks for its version.
#[derive(Clone, Debug)]
pub struct Identity {
    config: IdentityConfig,
    pinned: Option<Pinned>,
    wrong_system: u64,
}

#[derive(Clone, Debug)]
struct Pinned {
    vehicle: Vehicle,
    heartbeat: Stamp<Companion>,
    /// When any message of its came.
    heard: Stamp<Companion>,
    lost: bool,
    /// That heartbeats are missing was told.
    missing_told: bool,
    question: VersionQuestion,
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
        Self { config, pinned: None, wrong_system: 0 }
    }

    /// The vehicle, once its autopilot was heard; also while it is lost.
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

    /// Takes note of a frame whose checksum was tested. Says who sent it, and what it changed.
    pub fn hear(&mut self, now: Stamp<Companion>, frame: &Frame<'_>) -> (Sender, Option<IdentityEvent>) {
        let heartbeat = HeartbeatFields::read(frame).filter(HeartbeatFields::is_autopilot);
        let Some(pinned) = &mut self.pinned else {
            let wanted = self.config.system.is_none_or(|system| system == frame.system());
            return match heartbeat {
                // System 0 is everyone: nobody can be spoken to by that number.
                Some(fields) if wanted && frame.system().0 != 0 => {
                    let pinned = Pinned::new(now, frame, fields);
                    let event = IdentityEvent::Found(pinned.vehicle);
                    self.pinned = Some(pinned);
                    (Sender::Autopilot, Some(event))
                }
                _ if wanted => (Sender::NotPinned, None),
                _ => {
                    self.wrong_system += 1;
                    (Sender::WrongSystem, None)
                }
            };
        };
        if frame.system() != pinned.vehicle.system {
            self.wrong_system += 1;
            return (Sender::WrongSystem, None);
        }
        if frame.component() != pinned.vehicle.component {
            return (Sender::SameSystem, None);
        }
        let back = pinned.is_back(now);
        let event = match heartbeat {
            Some(fields) => pinned.heartbeat(now, frame, fields).or(back),
            None if back.is_some() => back,
            None if frame.message_id() == AUTOPILOT_VERSION_DATA::ID => pinned.version(frame),
            None => None,
        };
        (Sender::Autopilot, event)
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

impl Pinned {
    fn new(now: Stamp<Companion>, frame: &Frame<'_>, fields: HeartbeatFields) -> Self {
        let vehicle = Vehicle {
            system: frame.system(),
            component: frame.component(),
            autopilot: AutopilotKind::from_wire(fields.autopilot),
            vehicle_type: fields.vehicle_type,
            armed: fields.armed(),
            version: None,
        };
        let question = VersionQuestion::Open { asked: 0, due: now };
        Self { vehicle, heartbeat: now, heard: now, lost: false, missing_told: false, question }
    }

    /// A message of its came; whether it is back by that.
    fn is_back(&mut self, now: Stamp<Companion>) -> Option<IdentityEvent> {
        self.heard = now;
        std::mem::take(&mut self.lost).then(|| {
            // Other firmware may have been loaded meanwhile.
            self.question = VersionQuestion::Open { asked: 0, due: now };
            IdentityEvent::Back
        })
    }

    fn heartbeat(
        &mut self,
        now: Stamp<Companion>,
        frame: &Frame<'_>,
        fields: HeartbeatFields,
    ) -> Option<IdentityEvent> {
        self.heartbeat = now;
        self.missing_told = false;
        if AutopilotKind::from_wire(fields.autopilot) != self.vehicle.autopilot {
            *self = Self::new(now, frame, fields);
            return Some(IdentityEvent::Found(self.vehicle));
        }
        self.vehicle.vehicle_type = fields.vehicle_type;
        let was_armed = std::mem::replace(&mut self.vehicle.armed, fields.armed());
        (was_armed != self.vehicle.armed).then_some(IdentityEvent::Armed(self.vehicle.armed))
    }

    fn version(&mut self, frame: &Frame<'_>) -> Option<IdentityEvent> {
        let Ok(MavMessage::AUTOPILOT_VERSION(data)) = frame.parse() else { return None };
        let version = FirmwareVersion::from_packed(data.flight_sw_version)?;
        self.question = VersionQuestion::Answered;
        let before = self.vehicle.version.replace(version);
        (before != Some(version)).then_some(IdentityEvent::Version(version))
    }
}

#[cfg(test)]
mod tests {
    use mavlink::dialects::ardupilotmega::MavProtocolCapability;

    use super::super::heartbeat_fields::testing::{frame_of, heartbeat_frame};
    use super::*;
    use crate::wire::frame_bytes::FrameBytes;

    fn at(ms: i64) -> Stamp<Companion> {
        Stamp::from_micros(ms * 1000)
    }

    fn hear(identity: &mut Identity, ms: i64, bytes: &FrameBytes) -> (Sender, Option<IdentityEvent>) {
        identity.hear(at(ms), &bytes.frame().unwrap())
    }

    fn version(system: u8, packed: u32) -> FrameBytes {
        let data = AUTOPILOT_VERSION_DATA {
            capabilities: MavProtocolCapability::empty(),
            uid: 0,
            flight_sw_version: packed,
            middleware_sw_version: 0,
            os_sw_version: 0,
            board_version: 0,
            vendor_id: 0,
            product_id: 0,
            flight_custom_version: [0; 8],
            middleware_custom_version: [0; 8],
            os_custom_version: [0; 8],
            uid2: [0; 18],
        };
        frame_of(system, 1, &MavMessage::AUTOPILOT_VERSION(data))
    }

    #[test]
    fn the_first_autopilot_is_pinned_and_others_are_counted() {
        let mut identity = Identity::new(IdentityConfig::default());
        assert_eq!(hear(&mut identity, 0, &heartbeat_frame(255, 190, 6, 8, 0)), (Sender::NotPinned, None));
        assert_eq!(hear(&mut identity, 1, &heartbeat_frame(0, 1, 2, 3, 0)), (Sender::NotPinned, None));
        let (sender, event) = hear(&mut identity, 2, &heartbeat_frame(7, 1, 2, 3, 0x80));
        assert_eq!(sender, Sender::Autopilot);
        let Some(IdentityEvent::Found(vehicle)) = event else { panic!("{event:?}") };
        assert_eq!((vehicle.system, vehicle.component), (SystemId(7), ComponentId(1)));
        assert_eq!((vehicle.autopilot, vehicle.armed), (AutopilotKind::ArduPilot, true));

        assert_eq!(hear(&mut identity, 3, &heartbeat_frame(8, 1, 2, 12, 0)), (Sender::WrongSystem, None));
        assert_eq!(hear(&mut identity, 4, &heartbeat_frame(7, 100, 30, 8, 0)), (Sender::SameSystem, None));
        assert_eq!(identity.vehicle(), Some(&vehicle));
        assert_eq!(identity.wrong_system(), 1);
    }

    #[test]
    fn a_configured_system_is_waited_for() {
        let mut identity =
            Identity::new(IdentityConfig { system: Some(SystemId(5)), ..IdentityConfig::default() });
        assert_eq!(hear(&mut identity, 0, &heartbeat_frame(1, 1, 2, 3, 0)).0, Sender::WrongSystem);
        assert_eq!(hear(&mut identity, 1, &heartbeat_frame(5, 1, 2, 12, 0)).0, Sender::Autopilot);
        assert_eq!(identity.vehicle().unwrap().autopilot, AutopilotKind::Px4);
    }

    #[test]
    fn silence_is_told_once_and_so_is_the_return() {
        let mut identity = Identity::new(IdentityConfig::default());
        let beat = heartbeat_frame(1, 1, 2, 3, 0);
        hear(&mut identity, 0, &beat);
        hear(&mut identity, 1, &version(1, 0x0407_00FF));
        assert_eq!(identity.poll(at(3001)).event, None);
        let lost = identity.poll(at(3002)).event;
        assert_eq!(lost, Some(IdentityEvent::Lost { silent: Span::from_millis(3001) }));
        assert_eq!(identity.poll(at(9000)), IdentityPoll::default());
        assert!(!identity.is_heard() && identity.vehicle().is_some());
        assert_eq!(hear(&mut identity, 9500, &beat).1, Some(IdentityEvent::Back));
        assert!(identity.is_heard());
        assert!(identity.poll(at(9501)).send.is_some(), "the version is asked for again");
    }

    #[test]
    fn an_autopilot_whose_heartbeats_are_lost_is_not_silent() {
        let mut identity = Identity::new(IdentityConfig::default());
        hear(&mut identity, 0, &heartbeat_frame(1, 1, 2, 3, 0));
        let mut told = Vec::new();
        for ms in (100..30_000).step_by(100) {
            hear(&mut identity, ms, &version(1, 0x0407_00FF));
            told.extend(identity.poll(at(ms)).event);
            assert!(identity.is_heard());
        }
        assert_eq!(told, [IdentityEvent::NoHeartbeat(Span::from_millis(10_100))]);
        assert!(matches!(identity.poll(at(33_000)).event, Some(IdentityEvent::Lost { .. })));
        // Any message of its shows that it is back.
        assert_eq!(hear(&mut identity, 34_000, &version(1, 0x0407_00FF)).1, Some(IdentityEvent::Back));
    }

    #[test]
    fn the_version_is_asked_for_a_few_times_only() {
        let mut identity = Identity::new(IdentityConfig::default());
        let mut asked = 0;
        let mut given_up = 0;
        for ms in (0..60_000).step_by(100) {
            if ms % 1000 == 0 {
                hear(&mut identity, ms, &heartbeat_frame(1, 1, 2, 3, 0));
            }
            let polled = identity.poll(at(ms));
            given_up += usize::from(polled.event == Some(IdentityEvent::VersionUnknown));
            if let Some(MavMessage::COMMAND_LONG(command)) = polled.send {
                asked += 1;
                assert_eq!(command.command, MavCmd::MAV_CMD_REQUEST_MESSAGE);
                assert_eq!((command.param1, command.target_system, command.target_component), (148.0, 1, 1));
            }
        }
        assert_eq!((asked, given_up), (5, 1));
        // A late answer is still welcome.
        let event = hear(&mut identity, 60_001, &version(1, 0x0407_02C0)).1;
        let Some(IdentityEvent::Version(version)) = event else { panic!("{event:?}") };
        assert_eq!(version.to_string(), "4.7.2-rc");
        assert_eq!(identity.vehicle().unwrap().version, Some(version));
    }

    #[test]
    fn a_version_of_another_vehicle_is_not_ours() {
        let mut identity = Identity::new(IdentityConfig::default());
        hear(&mut identity, 0, &heartbeat_frame(1, 1, 2, 12, 0));
        assert_eq!(hear(&mut identity, 1, &version(2, 0x0111_00FF)).1, None);
        assert_eq!(identity.vehicle().unwrap().version, None);
        hear(&mut identity, 2, &version(1, 0x0111_00FF));
        assert_eq!(identity.vehicle().unwrap().version.unwrap().to_string(), "1.17.0");
    }

    #[test]
    fn arming_is_told() {
        let mut identity = Identity::new(IdentityConfig::default());
        hear(&mut identity, 0, &heartbeat_frame(1, 1, 2, 12, 0));
        let armed = hear(&mut identity, 1, &heartbeat_frame(1, 1, 2, 12, 0x80)).1;
        assert_eq!(armed, Some(IdentityEvent::Armed(true)));
        assert_eq!(hear(&mut identity, 2, &heartbeat_frame(1, 1, 2, 12, 0x80)).1, None);
    }
}
