//! The conversation with the autopilot that is followed: who it is, what time it has, and what it is asked for.

use mavlink::MessageData;
use mavlink::dialects::ardupilotmega::{COMMAND_ACK_DATA, MavMessage, TIMESYNC_DATA};

use super::Address;
use super::hand_over::{HandOver, HandOverNews, Situation};
use super::identity::{AutopilotShown, Identity, IdentityConfig, IdentityEvent, Sender, Vehicle};
use super::origin_offer::OriginOffer;
use super::requests::{Refusal, StreamRequests, StreamSettings};
use super::source_switch::SwitchSettings;
use super::timesync::{TimeSync, TimeSyncConfig, TimeSyncHeard};
use crate::time::{AutopilotTime, Companion, Span, Stamp};
use crate::wire::clock::AutopilotClock;
use crate::wire::frame::{Frame, SystemId};

/// TIMESYNC and the stamps of the samples are the same clock if they agree within this.
const ONE_CLOCK: Span = Span::from_millis(1000);

/// The conversation with the autopilot that is served.
#[derive(Clone, Debug)]
pub struct AutopilotSession {
    identity: Identity,
    rates: StreamSettings,
    switch: SwitchSettings,
    dialogue: Option<Dialogue>,
    /// The newest time of the autopilot's, and when it came.
    newest: Option<(AutopilotTime, Stamp<Companion>)>,
}

/// What is said to an autopilot once it is known.
#[derive(Clone, Debug)]
struct Dialogue {
    us: Address,
    autopilot: Address,
    sync: TimeSync,
    requests: StreamRequests,
    origin: OriginOffer,
    hand_over: HandOver,
}

/// What a frame of the autopilot means for the conversation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reply {
    /// To be sent at once.
    pub answer: Option<MavMessage>,
    /// The autopilot's clock was set by this much.
    pub clock_set: Option<Span>,
}

/// What is due.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SessionPoll {
    /// To be sent to the autopilot, in this order.
    pub messages: Vec<MavMessage>,
    /// What became known of the autopilot with time.
    pub event: Option<IdentityEvent>,
    /// Streams that are no longer asked for.
    pub refusals: Vec<Refusal>,
    /// What is new of the hand-over.
    pub hand_over: Vec<HandOverNews>,
}

impl AutopilotSession {
    /// Nobody was heard yet.
    pub fn new(identity: IdentityConfig, rates: StreamSettings, switch: SwitchSettings) -> Self {
        let identity = Identity::new(identity);
        Self { identity, rates, switch, dialogue: None, newest: None }
    }

    /// This system was served a moment ago, by a process before.
    pub fn expect(&mut self, system: SystemId) {
        self.identity.expect(system);
    }

    /// A link has heard this of an autopilot before it passed anything on.
    pub fn heard_before(&mut self, now: Stamp<Companion>, shown: &AutopilotShown) {
        self.identity.heard_before(now, shown);
    }

    /// The vehicle, once its autopilot was chosen; also while it is lost.
    pub fn vehicle(&self) -> Option<&Vehicle> {
        self.identity.vehicle()
    }

    /// Whether the autopilot is heard at present.
    pub fn is_heard(&self) -> bool {
        self.identity.is_heard()
    }

    /// Frames that came from other systems.
    pub fn wrong_system(&self) -> u64 {
        self.identity.wrong_system()
    }

    /// Offset of the autopilot's clock and shortest round trip.
    pub fn timesync(&self) -> Option<(Span, Span)> {
        let sync = &self.dialogue.as_ref()?.sync;
        Some((sync.offset()?, sync.round_trip()?))
    }

    /// The autopilot's clock less ours at `at`, and the shortest round trip.
    pub fn timesync_at(&self, at: Stamp<Companion>) -> Option<(Span, Span)> {
        let sync = &self.dialogue.as_ref()?.sync;
        Some((sync.offset_at(at)?, sync.round_trip()?))
    }

    /// Questions of the autopilot that were answered.
    pub fn answered(&self) -> u64 {
        self.dialogue.as_ref().map_or(0, |d| d.sync.counters().answered)
    }

    /// Whether the autopilot that is followed sent `frame`.
    pub fn sent_by_autopilot(&self, frame: &Frame<'_>) -> bool {
        self.vehicle().is_some_and(|v| (v.system, v.component) == (frame.system(), frame.component()))
    }

    /// Takes note of a frame whose checksum was tested. Says who sent it, and what it changed.
    pub fn hear(&mut self, at: Stamp<Companion>, frame: &Frame<'_>) -> (Sender, Option<IdentityEvent>) {
        self.identity.hear(at, frame)
    }

    /// Begins to talk to the autopilot that was chosen, as `us`.
    pub fn begin(&mut self, us: Address) {
        self.newest = None;
        if let Some(vehicle) = self.identity.vehicle() {
            self.dialogue = Some(Dialogue {
                us,
                autopilot: vehicle.address(),
                sync: TimeSync::new(TimeSyncConfig::default(), us, vehicle.address()),
                requests: StreamRequests::new(self.rates, vehicle),
                hand_over: HandOver::new(self.switch, us, vehicle),
                origin: OriginOffer::default(),
            });
        }
    }

    /// The link began anew: what was asked for may be forgotten, and the clock may be another.
    pub fn restart(&mut self) {
        if let Some(dialogue) = &mut self.dialogue {
            dialogue.sync.restart();
            dialogue.requests.restart();
        }
    }

    /// The autopilot rebooted: it knows nothing of what it was asked for, and its clock began anew.
    pub fn reboot(&mut self) {
        self.identity.rebooted();
        if let Some(dialogue) = &mut self.dialogue {
            dialogue.sync.restart();
            dialogue.requests.reboot();
            dialogue.hand_over.restart();
            dialogue.origin = OriginOffer::default();
        }
    }

    /// The hand-over to the autopilot, once it is known.
    pub fn hand_over(&self) -> Option<&HandOver> {
        self.dialogue.as_ref().map(|d| &d.hand_over)
    }

    /// For what is sent to it, and for its receiver's fixes.
    pub fn hand_over_mut(&mut self) -> Option<&mut HandOver> {
        self.dialogue.as_mut().map(|d| &mut d.hand_over)
    }

    /// How old a sample of `time` that is sent now will be when it comes to the autopilot, s, by its own clock and half of the shortest
    /// round trip; `None` before the clocks are synchronised.
    pub fn age_on_arrival_s(
        &self,
        now: Stamp<Companion>,
        time: AutopilotTime,
        clock: &AutopilotClock,
    ) -> Option<f64> {
        let sync = &self.dialogue.as_ref()?.sync;
        let there_now = now.micros().saturating_add(sync.offset_at(now)?.micros());
        let age = Span::from_micros(there_now.saturating_sub(clock.boot_micros(time)));
        let age_s = age.seconds() + 0.5 * sync.round_trip()?.seconds();
        // Another clock tells no age.
        (age.micros().unsigned_abs() <= ONE_CLOCK.micros().unsigned_abs()).then_some(age_s)
    }

    /// The origin of the autopilot's frame came.
    pub fn origin_heard(&mut self) {
        if let Some(dialogue) = &mut self.dialogue {
            dialogue.requests.origin_heard();
            dialogue.origin.known();
        }
    }

    /// Takes note of the newest time that the autopilot's stamps have told, by a frame that came at `at`.
    pub fn stamped(&mut self, newest: Option<AutopilotTime>, at: Stamp<Companion>) {
        if newest != self.newest.map(|(time, _)| time) {
            self.newest = newest.map(|time| (time, at));
        }
    }

    /// Time now on the autopilot's boot clock, in our estimation, µs. This is the clock that our messages are stamped with, so
    /// TIMESYNC refines it but does not replace it: answers of another clock are not followed.
    fn boot_now(&self, now: Stamp<Companion>, clock: &AutopilotClock) -> Option<i64> {
        let stamped =
            self.newest.map(|(time, at)| clock.boot_micros(time).saturating_add((now - at).micros()));
        let offset = self.dialogue.as_ref().and_then(|d| d.sync.offset_at(now));
        let synced = offset.map(|o| now.micros().saturating_add(o.micros()));
        match (synced, stamped) {
            (Some(synced), Some(stamped))
                if synced.abs_diff(stamped) <= ONE_CLOCK.micros().unsigned_abs() =>
            {
                Some(synced)
            }
            (_, Some(stamped)) => Some(stamped),
            (synced, None) => synced,
        }
    }

    /// What a frame of the autopilot, received at `at` and read at `now`, means for the conversation.
    pub fn converse(
        &mut self,
        frame: &Frame<'_>,
        at: Stamp<Companion>,
        now: Stamp<Companion>,
        clock: &AutopilotClock,
    ) -> Reply {
        let id = frame.message_id();
        let boot_now = if id == TIMESYNC_DATA::ID { self.boot_now(now, clock) } else { None };
        let Some(dialogue) = &mut self.dialogue else { return Reply::default() };
        dialogue.requests.streams().hear(at, id);
        dialogue.hand_over.hear(at, frame);
        match id {
            COMMAND_ACK_DATA::ID => {
                if let Ok(MavMessage::COMMAND_ACK(ack)) = frame.parse() {
                    dialogue.requests.streams().acknowledge(at, dialogue.us, &ack);
                    dialogue.hand_over.acknowledge(&ack);
                }
                Reply::default()
            }
            TIMESYNC_DATA::ID => match frame.parse() {
                Ok(MavMessage::TIMESYNC(message)) => dialogue.timesync(at, &message, boot_now),
                _ => Reply::default(),
            },
            _ => Reply::default(),
        }
    }

    /// What is due now.
    pub fn poll(&mut self, now: Stamp<Companion>, situation: &Situation) -> SessionPoll {
        let polled = self.identity.poll(now);
        let mut due = SessionPoll {
            messages: Vec::from_iter(polled.send),
            event: polled.event,
            ..SessionPoll::default()
        };
        if !self.identity.is_heard() {
            return due;
        }
        if let (Some(dialogue), Some(vehicle)) = (&mut self.dialogue, self.identity.vehicle()) {
            // The switch first: it is what the flight hangs on.
            let (command, news) = dialogue.hand_over.poll(now, situation);
            due.messages.extend(command);
            due.hand_over = news;
            due.messages.extend(dialogue.origin.poll(now, dialogue.autopilot, situation.place));
            due.messages.extend(dialogue.sync.poll(now));
            let (request, refusals) = dialogue.requests.poll(now, vehicle);
            due.messages.extend(request);
            due.refusals = refusals;
        }
        due
    }
}

impl Dialogue {
    fn timesync(&mut self, at: Stamp<Companion>, message: &TIMESYNC_DATA, boot_now: Option<i64>) -> Reply {
        // Without an idea of its clock a question cannot be answered: an answer of ours would be another time base.
        if message.tc1 == 0 && boot_now.is_none() {
            return Reply::default();
        }
        let answer_ns = boot_now.unwrap_or(0).saturating_mul(1000);
        match self.sync.hear(at, self.autopilot, message, answer_ns) {
            TimeSyncHeard::Answer(answer) => {
                Reply { answer: Some(MavMessage::TIMESYNC(answer)), clock_set: None }
            }
            TimeSyncHeard::Stepped { step } => {
                // A clock that falls back is that of an autopilot that rebooted, and has forgotten what it was asked for.
                if step < Span::ZERO {
                    self.requests.reboot();
                }
                Reply { answer: None, clock_set: Some(step) }
            }
            TimeSyncHeard::Measured { .. } | TimeSyncHeard::Slipped { .. } | TimeSyncHeard::Ignored => {
                Reply::default()
            }
        }
    }
}
