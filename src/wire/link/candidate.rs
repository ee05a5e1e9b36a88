//! Who may be answered: what was heard from an address, and how it compares with others.
//!
//! Nothing that comes over UDP proves who sent it. What can be asked for is that it looks like an autopilot for a while: heartbeats over
//! seconds, or IMU messages beside one, with sequence numbers that run on. Where an autopilot was heard before, going on with its clock
//! since boot weighs more than anything else.

use std::cmp::Reverse;
use std::net::SocketAddr;

use super::boot_clock::BootClock;
use super::pin::PinPolicy;
use crate::time::{Companion, Span, Stamp};
use crate::wire::frame::{ComponentId, Frame, SystemId};
use crate::wire::messages::{Meaning, from_any_component, meaning_of};
use crate::wire::session::Address;
use crate::wire::session::heartbeat_fields::HeartbeatFields;
use crate::wire::session::identity::AutopilotShown;

/// Heartbeats that make a rate of them.
const BEATS: u32 = 3;
/// IMU messages, or measurements on a link for sensors, that are no accident.
const MEASUREMENTS: u32 = 5;
const SENSOR_MEASUREMENTS: u32 = 3;
/// Frames that go on with a clock, of which one may be chance.
const GOING_ON: u32 = 3;
/// A number that is this little ahead of the last one runs on, with a few frames lost.
const FEW_LOST: u8 = 8;

/// What a frame says of its sender.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Evidence {
    /// An autopilot's heartbeat.
    Beat,
    /// An IMU message; on a link for sensors a measurement.
    Measurement,
}

impl Evidence {
    /// `None` for what anybody may send.
    pub(super) fn of(frame: &Frame<'_>, policy: &PinPolicy) -> Option<Self> {
        let id = frame.message_id();
        if policy.for_sensors {
            return from_any_component(id).then_some(Self::Measurement);
        }
        let other_system = policy.system.is_some_and(|system| system != frame.system());
        if other_system || policy.component.is_some_and(|component| component != frame.component()) {
            return None;
        }
        if meaning_of(id) == Some(Meaning::Inertial) {
            return Some(Self::Measurement);
        }
        HeartbeatFields::read(frame).filter(HeartbeatFields::is_autopilot).map(|_| Self::Beat)
    }
}

/// How many of something came, and from when to when.
#[derive(Clone, Copy, Debug)]
struct Occurrences {
    count: u32,
    from: Stamp<Companion>,
    to: Stamp<Companion>,
}

impl Occurrences {
    fn empty(now: Stamp<Companion>) -> Self {
        Self { count: 0, from: now, to: now }
    }

    fn note(&mut self, now: Stamp<Companion>) {
        if self.count == 0 {
            self.from = now;
        }
        self.count = self.count.saturating_add(1);
        self.to = now;
    }

    fn lasts(&self) -> Span {
        self.to - self.from
    }
}

/// Sequence numbers of the sender that was heard first.
#[derive(Clone, Copy, Debug)]
struct Sequence {
    sender: (SystemId, ComponentId),
    last: u8,
    ran_on: u32,
    jumped: u32,
}

impl Sequence {
    fn note(&mut self, frame: &Frame<'_>) {
        if (frame.system(), frame.component()) != self.sender {
            return;
        }
        let ahead = frame.sequence().wrapping_sub(self.last);
        if (1..=FEW_LOST).contains(&ahead) {
            self.ran_on = self.ran_on.saturating_add(1);
        } else {
            self.jumped = self.jumped.saturating_add(1);
        }
        self.last = frame.sequence();
    }

    fn runs_on(&self) -> bool {
        self.ran_on >= 2 * self.jumped
    }
}

/// An address that may be the autopilot's.
#[derive(Clone, Copy, Debug)]
pub(super) struct PeerCandidate {
    pub(super) peer: SocketAddr,
    heard: Occurrences,
    beats: Occurrences,
    measurements: Occurrences,
    /// The autopilot whose heartbeat was heard first, alone.
    shown: Option<AutopilotShown>,
    sequence: Sequence,
    /// Frames that go on with the clock of the peer before.
    going_on: u32,
}

impl PeerCandidate {
    pub(super) fn new(peer: SocketAddr, frame: &Frame<'_>, now: Stamp<Companion>) -> Self {
        let sender = (frame.system(), frame.component());
        // So that the first number runs on.
        let last = frame.sequence().wrapping_sub(1);
        Self {
            peer,
            heard: Occurrences::empty(now),
            beats: Occurrences::empty(now),
            measurements: Occurrences::empty(now),
            shown: None,
            sequence: Sequence { sender, last, ran_on: 0, jumped: 0 },
            going_on: 0,
        }
    }

    pub(super) fn hear(
        &mut self,
        frame: &Frame<'_>,
        evidence: Option<Evidence>,
        before: Option<&BootClock>,
        now: Stamp<Companion>,
    ) {
        self.heard.note(now);
        self.sequence.note(frame);
        self.show(frame, now);
        match evidence {
            Some(Evidence::Beat) => self.beats.note(now),
            Some(Evidence::Measurement) => self.measurements.note(now),
            None => {}
        }
        match before.and_then(|clock| clock.goes_on(frame, now)) {
            Some(true) => self.going_on = self.going_on.saturating_add(1),
            Some(false) => self.going_on = 0,
            None => {}
        }
    }

    fn show(&mut self, frame: &Frame<'_>, now: Stamp<Companion>) {
        let address = Address { system: frame.system(), component: frame.component() };
        let beat = HeartbeatFields::read(frame).filter(HeartbeatFields::is_autopilot);
        match (&mut self.shown, beat) {
            (None, Some(fields)) => self.shown = Some(AutopilotShown::new(now, address, fields)),
            (Some(shown), Some(fields)) if shown.address == address => shown.beat(now, fields),
            (Some(shown), None)
                if shown.address == address && meaning_of(frame.message_id()) == Some(Meaning::Inertial) =>
            {
                shown.feel(now);
            }
            _ => {}
        }
    }

    /// What was heard of its autopilot.
    pub(super) fn shown(&self) -> Option<AutopilotShown> {
        self.shown
    }

    pub(super) fn first_heard(&self) -> Stamp<Companion> {
        self.heard.from
    }

    pub(super) fn last_heard(&self) -> Stamp<Companion> {
        self.heard.to
    }

    /// The first sender that was heard from this address.
    pub(super) fn sender(&self) -> (SystemId, ComponentId) {
        self.sequence.sender
    }

    /// Whether it goes on with the clock of the peer before.
    pub(super) fn goes_on(&self) -> bool {
        self.going_on >= GOING_ON && self.sequence.runs_on()
    }

    /// Whether it has measurements, as what is to be answered should.
    pub(super) fn has_sensors(&self, policy: &PinPolicy) -> bool {
        if policy.for_sensors {
            return self.measurements.count >= SENSOR_MEASUREMENTS;
        }
        self.measurements.count >= MEASUREMENTS && self.sequence.runs_on()
    }

    /// Whether it may be an autopilot for all that one can ask.
    pub(super) fn qualifies(&self, policy: &PinPolicy) -> bool {
        let confirm = policy.confirm.micros();
        if policy.for_sensors {
            return self.has_sensors(policy) && self.measurements.lasts().micros() >= confirm / 8;
        }
        let told = self.beats.count > 0
            && self.has_sensors(policy)
            && self.measurements.lasts().micros() >= confirm / 4;
        // Three heartbeats a second apart come within two seconds, more or less.
        let beats = self.beats.count >= BEATS && self.beats.lasts().micros() >= confirm / 10 * 9;
        told || beats
    }

    /// The larger, the better.
    pub(super) fn rank(&self, policy: &PinPolicy) -> impl Ord + use<> {
        (
            self.goes_on(),
            self.has_sensors(policy),
            self.sequence.sender.1 == policy.component.unwrap_or(ComponentId::AUTOPILOT),
            self.sequence.runs_on(),
            Reverse(self.first_heard().micros()),
        )
    }

    /// How much was heard, for what must make room.
    pub(super) fn weight(&self) -> (u32, i64) {
        let evidence = self.beats.count.saturating_add(self.measurements.count);
        (evidence.min(MEASUREMENTS), self.last_heard().micros())
    }
}
