//! Which vehicle Holdover serves, and what it is.
//!
//! The vehicle is chosen by what no single packet can show ([`candidates`]): heartbeats that keep their rhythm, of an autopilot's component, and
//! sensors that belong to it. It is kept: two vehicles on one radio must not be mixed in one filter. Only one that is silent, or never showed
//! a sensor, gives way to another, and one that was heard with sensors only on the ground and after a minute. What it is (autopilot, type,
//! armed) is believed to change when its heartbeats go on to say so ([`nature`]). Whatever else speaks is named by [`Sender`], and counted.

mod candidates;
mod nature;

use std::fmt;

use mavlink::MessageData;
use mavlink::dialects::ardupilotmega::{AUTOPILOT_VERSION_DATA, MavCmd, MavMessage};

use super::heartbeat_fields::HeartbeatFields;
use super::{Address, command_long};
use crate::time::{Companion, Span, Stamp};
use crate::wire::frame::{ComponentId, Frame, SystemId};
use candidates::{Candidate, Candidates};
pub(crate) use nature::{Nature, Told};

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
    pub(crate) fn from_wire(autopilot: u8) -> Self {
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
        self.vehicle().copied().or_else(|| self.candidates.likeliest().map(|c| vehicle_of(&c)))
    }

    /// This system was served a moment ago, by a process before: its autopilot need not prove itself again.
    pub fn expect(&mut self, system: SystemId) {
        self.candidates.expect(system);
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
        let best = self.candidates.best(now, current).filter(|best| best.address == from)?;
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
    fn gives_way(&self, now: Stamp<Companion>, pinned: &Pinned, other: &Candidate) -> bool {
        let silent = now - pinned.heard;
        if pinned.proven {
            // In flight nobody else is believed to be the vehicle, however long it is silent.
            return silent >= GIVEN_UP && !pinned.vehicle.armed && other.shows_sensors(now);
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
fn vehicle_of(candidate: &Candidate) -> Vehicle {
    Vehicle {
        system: candidate.address.system,
        component: candidate.address.component,
        autopilot: AutopilotKind::from_wire(candidate.fields.autopilot),
        vehicle_type: candidate.fields.vehicle_type,
        armed: candidate.fields.armed(),
        version: None,
    }
}

impl Pinned {
    fn new(now: Stamp<Companion>, candidate: &Candidate) -> Self {
        Self {
            vehicle: vehicle_of(candidate),
            nature: Nature::default(),
            since: now,
            heartbeat: now,
            heard: now,
            lost: false,
            missing_told: false,
            proven: candidate.shows_sensors(now),
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
            Told::Believed(nature) => {
                self.vehicle.vehicle_type = nature.vehicle_type;
                self.vehicle.armed = nature.armed();
                if AutopilotKind::from_wire(nature.autopilot) != self.vehicle.autopilot {
                    self.vehicle = Vehicle { autopilot: kind, version: None, ..self.vehicle };
                    self.question = VersionQuestion::Open { asked: 0, due: now };
                    return Some(IdentityEvent::Found(self.vehicle));
                }
                (was_armed != self.vehicle.armed).then_some(IdentityEvent::Armed(self.vehicle.armed))
            }
            Told::Doubted => {
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

    /// Heartbeats of a second that begins at `ms`; what the last of them changed.
    fn meet(identity: &mut Identity, ms: i64, bytes: &FrameBytes) -> Option<IdentityEvent> {
        [0, 500, 1000].map(|after| hear(identity, ms + after, bytes).1)[2]
    }

    /// From `from` to `to` ms: heartbeats every second and IMU frames ten times, of each of these. What changed, and when.
    fn play(
        identity: &mut Identity,
        (from, to): (i64, i64),
        all: &[(&FrameBytes, Option<&FrameBytes>)],
    ) -> Vec<(i64, IdentityEvent)> {
        let mut events = Vec::new();
        for ms in (from..to).step_by(100) {
            for (beat, imu) in all {
                if ms % 1000 == 0 {
                    events.extend(hear(identity, ms, beat).1.map(|e| (ms, e)));
                }
                if let Some(imu) = imu {
                    events.extend(hear(identity, ms, imu).1.map(|e| (ms, e)));
                }
            }
            identity.poll(at(ms));
        }
        events
    }

    fn imu(system: u8, component: u8) -> FrameBytes {
        frame_of(system, component, &MavMessage::HIGHRES_IMU(Default::default()))
    }

    fn following(identity: &Identity) -> Option<(u8, u8)> {
        identity.vehicle().map(|v| (v.system.0, v.component.0))
    }

    #[test]
    fn a_rhythm_is_waited_for_and_others_are_counted() {
        let mut identity = Identity::new(IdentityConfig::default());
        assert_eq!(hear(&mut identity, 0, &heartbeat_frame(255, 190, 6, 8, 0)), (Sender::NotPinned, None));
        assert_eq!(meet(&mut identity, 1, &heartbeat_frame(0, 1, 2, 3, 0)), None);
        let event = meet(&mut identity, 2, &heartbeat_frame(7, 1, 2, 3, 0x80));
        let Some(IdentityEvent::Found(vehicle)) = event else { panic!("{event:?}") };
        assert_eq!((vehicle.system, vehicle.component), (SystemId(7), ComponentId(1)));
        assert_eq!((vehicle.autopilot, vehicle.armed), (AutopilotKind::ArduPilot, true));

        let (sender, event) = hear(&mut identity, 1103, &heartbeat_frame(7, 1, 2, 3, 0x80));
        assert_eq!((sender, event), (Sender::Autopilot, None));
        assert_eq!(hear(&mut identity, 1103, &heartbeat_frame(8, 1, 2, 12, 0)), (Sender::WrongSystem, None));
        assert_eq!(hear(&mut identity, 1104, &heartbeat_frame(7, 100, 30, 8, 0)), (Sender::SameSystem, None));
        assert_eq!(identity.vehicle(), Some(&vehicle));
        assert_eq!(identity.wrong_system(), 1);
    }

    #[test]
    fn a_configured_system_is_waited_for() {
        let config = IdentityConfig { system: Some(SystemId(5)), ..IdentityConfig::default() };
        let mut identity = Identity::new(config);
        assert_eq!(meet(&mut identity, 0, &heartbeat_frame(1, 1, 2, 3, 0)), None);
        meet(&mut identity, 1001, &heartbeat_frame(5, 1, 2, 12, 0));
        assert_eq!(identity.vehicle().unwrap().autopilot, AutopilotKind::Px4);
    }

    #[test]
    fn heartbeats_that_come_before_the_autopilots_win_nothing() {
        // One, or a thousand at once, of other systems and of another component of its own.
        for config in [None, Some(SystemId(1))] {
            let mut identity = Identity::new(IdentityConfig { system: config, ..IdentityConfig::default() });
            for n in 0..1000 {
                for (system, component) in [(9, 1), (1, 77), (1 + (n % 200) as u8, 78)] {
                    assert_eq!(
                        hear(&mut identity, n % 10, &heartbeat_frame(system, component, 2, 12, 0)).1,
                        None
                    );
                }
            }
            let real = heartbeat_frame(1, 1, 2, 3, 0);
            let events = play(&mut identity, (1000, 5000), &[(&real, None)]);
            assert!(matches!(events[..], [(2000, IdentityEvent::Found(_))]), "{events:?}");
            assert_eq!(following(&identity), Some((1, 1)));
        }
        // A component that is no autopilot's may keep its rhythm for as long as it likes.
        let config = IdentityConfig { system: Some(SystemId(1)), ..IdentityConfig::default() };
        let mut identity = Identity::new(config);
        let (real, forged) = (heartbeat_frame(1, 1, 2, 3, 0), heartbeat_frame(1, 77, 2, 12, 0));
        assert_eq!(play(&mut identity, (0, 20_000), &[(&forged, None)]), []);
        play(&mut identity, (20_000, 22_000), &[(&forged, None), (&real, None)]);
        assert_eq!(following(&identity), Some((1, 1)));
        // Unless it is the one that is asked for, or has the sensors.
        let config = IdentityConfig { component: Some(ComponentId(77)), ..config };
        let mut identity = Identity::new(config);
        play(&mut identity, (0, 3000), &[(&real, None), (&forged, None)]);
        assert_eq!(following(&identity), Some((1, 77)));
        let mut identity = Identity::new(IdentityConfig::default());
        play(&mut identity, (0, 3000), &[(&forged, Some(&imu(1, 77)))]);
        assert_eq!(following(&identity), Some((1, 77)));
    }

    #[test]
    fn who_has_sensors_takes_the_place_of_who_has_none_and_keeps_it() {
        let (real, forged) = (heartbeat_frame(1, 1, 2, 3, 0), heartbeat_frame(9, 1, 2, 12, 0));
        let felt = imu(1, 1);
        // Together from the start: the one with sensors.
        let mut identity = Identity::new(IdentityConfig::default());
        play(&mut identity, (0, 3000), &[(&forged, None), (&real, Some(&felt))]);
        assert_eq!(following(&identity), Some((1, 1)));
        // Who has kept a rhythm before it is given up, silent or not.
        for (goes_on, by) in [(true, 13_000), (false, 7000)] {
            let mut identity = Identity::new(IdentityConfig::default());
            play(&mut identity, (0, 3000), &[(&forged, None)]);
            assert_eq!(following(&identity), Some((9, 1)));
            let both = [(&real, Some(&felt)), (&forged, None)];
            let events = play(&mut identity, (3000, 20_000), &both[..if goes_on { 2 } else { 1 }]);
            let replaced = events.iter().find(|(_, e)| matches!(e, IdentityEvent::Replaced { .. }));
            assert!(replaced.is_some_and(|(ms, _)| *ms <= by), "{events:?}");
            assert_eq!(following(&identity), Some((1, 1)));
            // And now it stays, whoever comes with whatever.
            let with_all = [(&real, Some(&felt)), (&forged, Some(&imu(9, 1)))];
            assert_eq!(play(&mut identity, (20_000, 200_000), &with_all), []);
        }
    }

    #[test]
    fn of_two_without_sensors_one_after_the_other_is_asked() {
        // Neither sends any before it is asked.
        let (real, forged) = (heartbeat_frame(1, 1, 2, 3, 0), heartbeat_frame(9, 1, 2, 12, 0));
        let mut identity = Identity::new(IdentityConfig::default());
        play(&mut identity, (0, 3000), &[(&forged, None)]);
        let felt = imu(1, 1);
        let mut events = Vec::new();
        for s in 3..60 {
            let answers = following(&identity) == Some((1, 1));
            let both = [(&real, answers.then_some(&felt)), (&forged, None)];
            events.extend(play(&mut identity, (s * 1000, s * 1000 + 1000), &both));
        }
        let replaced = events.iter().filter(|(_, e)| matches!(e, IdentityEvent::Replaced { .. }));
        assert_eq!((following(&identity), replaced.count()), (Some((1, 1)), 1));
    }

    #[test]
    fn in_flight_nobody_takes_its_place_and_on_the_ground_after_a_minute() {
        let other = (heartbeat_frame(9, 1, 2, 12, 0x80), imu(9, 1));
        for (base_mode, given_up) in [(0x80, false), (0, true)] {
            let mut identity = Identity::new(IdentityConfig::default());
            let (beat, felt) = (heartbeat_frame(1, 1, 2, 3, base_mode), imu(1, 1));
            play(&mut identity, (0, 10_000), &[(&beat, Some(&felt))]);
            play(&mut identity, (10_000, 65_000), &[(&other.0, Some(&other.1))]);
            assert_eq!(following(&identity), Some((1, 1)));
            play(&mut identity, (65_000, 300_000), &[(&other.0, Some(&other.1))]);
            assert_eq!(following(&identity) == Some((9, 1)), given_up);
        }
    }

    #[test]
    fn a_vehicle_that_was_served_a_moment_ago_is_known() {
        let mut identity = Identity::new(IdentityConfig::default());
        identity.expect(SystemId(1));
        assert_eq!(hear(&mut identity, 0, &heartbeat_frame(1, 77, 2, 3, 0)).1, None);
        assert_eq!(hear(&mut identity, 0, &heartbeat_frame(2, 1, 2, 3, 0)).1, None);
        assert!(hear(&mut identity, 0, &heartbeat_frame(1, 1, 2, 3, 0)).1.is_some());
    }

    #[test]
    fn another_autopilot_type_is_believed_with_a_reboot_only() {
        let (ardupilot, px4) = (heartbeat_frame(1, 1, 2, 3, 0x80), heartbeat_frame(1, 1, 2, 12, 0x80));
        let mut identity = Identity::new(IdentityConfig::default());
        play(&mut identity, (0, 3000), &[(&ardupilot, None)]);
        // Beside its own, and alone.
        let events = play(&mut identity, (3000, 30_000), &[(&px4, None), (&ardupilot, None)]);
        assert_eq!(events, [(3000, IdentityEvent::Contradicted(1))]);
        let events = play(&mut identity, (30_000, 50_000), &[(&px4, None)]);
        assert_eq!((events, identity.vehicle().unwrap().autopilot), (vec![], AutopilotKind::ArduPilot));
        identity.rebooted();
        let events = play(&mut identity, (50_000, 60_000), &[(&px4, None)]);
        assert!(
            matches!(events[..], [(50_000, IdentityEvent::Found(v))] if v.autopilot == AutopilotKind::Px4)
        );
    }

    #[test]
    fn other_firmware_is_evidence_of_its_own() {
        let (ardupilot, px4) = (heartbeat_frame(1, 1, 2, 3, 0), heartbeat_frame(1, 1, 2, 12, 0));
        let mut identity = Identity::new(IdentityConfig::default());
        play(&mut identity, (0, 3000), &[(&ardupilot, None)]);
        hear(&mut identity, 3000, &version(1, 0x0407_00FF));
        hear(&mut identity, 4000, &px4);
        assert!(identity.poll(at(4001)).send.is_some(), "it is asked again");
        play(&mut identity, (5000, 20_000), &[(&px4, None)]);
        hear(&mut identity, 20_002, &version(1, 0x0111_00FF));
        play(&mut identity, (21_000, 22_000), &[(&px4, None)]);
        assert_eq!(identity.vehicle().unwrap().autopilot, AutopilotKind::Px4);
    }

    #[test]
    fn armed_and_disarmed_in_turns_are_told_now_and_then() {
        let mut identity = Identity::new(IdentityConfig::default());
        let (armed, disarmed) = (heartbeat_frame(1, 1, 2, 3, 0x80), heartbeat_frame(1, 1, 2, 3, 0));
        let mut told = play(&mut identity, (0, 3000), &[(&armed, None)]).len();
        for ms in 3000..303_000 {
            let beat = if ms % 2 == 0 { &armed } else { &disarmed };
            told += usize::from(hear(&mut identity, ms, beat).1.is_some());
        }
        assert!(told <= 10, "{told} in five minutes");
        assert!(identity.vehicle().unwrap().armed);
    }

    #[test]
    fn silence_is_told_once_and_so_is_the_return() {
        let mut identity = Identity::new(IdentityConfig::default());
        let beat = heartbeat_frame(1, 1, 2, 3, 0);
        meet(&mut identity, -1000, &beat);
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
        meet(&mut identity, -1000, &heartbeat_frame(1, 1, 2, 3, 0));
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
        meet(&mut identity, -1001, &heartbeat_frame(1, 1, 2, 3, 0));
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
        meet(&mut identity, -1000, &heartbeat_frame(1, 1, 2, 12, 0));
        assert_eq!(hear(&mut identity, 1, &version(2, 0x0111_00FF)).1, None);
        assert_eq!(identity.vehicle().unwrap().version, None);
        hear(&mut identity, 2, &version(1, 0x0111_00FF));
        assert_eq!(identity.vehicle().unwrap().version.unwrap().to_string(), "1.17.0");
    }

    #[test]
    fn arming_is_told() {
        let mut identity = Identity::new(IdentityConfig::default());
        meet(&mut identity, -1000, &heartbeat_frame(1, 1, 2, 12, 0));
        let armed = hear(&mut identity, 1, &heartbeat_frame(1, 1, 2, 12, 0x80)).1;
        assert_eq!(armed, Some(IdentityEvent::Armed(true)));
        assert_eq!(hear(&mut identity, 2, &heartbeat_frame(1, 1, 2, 12, 0x80)).1, None);
    }
}
