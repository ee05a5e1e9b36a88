//! The conversation with the autopilot that is followed: who it is, what time it has, and what it is asked for.

use mavlink::dialects::ardupilotmega::MavMessage;

use crate::pipeline::dialect_of;
use crate::time::{Companion, Span, Stamp};
use crate::wire::frame::Frame;
use crate::wire::protocol::Address;
use crate::wire::protocol::identity::{IdentityEvent, Vehicle};
use crate::wire::protocol::timesync::{TimeSync, TimeSyncConfig, TimeSyncHeard};

use super::Daemon;
use super::voice::Weight;
use super::wishes::Wishes;

const COMMAND_ACK: u32 = 77;
const TIMESYNC: u32 = 111;

/// TIMESYNC and the stamps of the samples are the same clock if they agree within this.
const ONE_CLOCK: Span = Span::from_millis(1000);

/// The state of the conversation.
#[derive(Clone, Debug)]
pub(super) struct Contact {
    us: Address,
    autopilot: Address,
    sync: TimeSync,
    pub(super) wishes: Wishes,
}

impl Contact {
    fn new(us: Address, vehicle: &Vehicle, streams: crate::config::StreamSettings) -> Self {
        Self {
            us,
            autopilot: vehicle.address(),
            sync: TimeSync::new(TimeSyncConfig::default(), us, vehicle.address()),
            wishes: Wishes::new(streams, vehicle),
        }
    }

    /// Offset and shortest round trip.
    pub(super) fn timesync(&self) -> Option<(Span, Span)> {
        Some((self.sync.offset()?, self.sync.round_trip()?))
    }

    /// Questions that were answered.
    pub(super) fn answered(&self) -> u64 {
        self.sync.counters().answered
    }
}

impl Daemon {
    pub(super) fn identity_event(&mut self, event: IdentityEvent) {
        let now = self.clock.now();
        match event {
            IdentityEvent::Found(vehicle) => {
                self.decoder.follow(vehicle.system, vehicle.component, dialect_of(&vehicle));
                self.pipeline.follow(&vehicle);
                let us = self.speaker.belong_to(vehicle.system);
                self.contact = Some(Contact::new(us, &vehicle, self.streams));
                self.watch.expect(now);
                self.say(
                    Weight::Info,
                    &format!("following {}, system {}", vehicle.autopilot, vehicle.system.0),
                );
            }
            IdentityEvent::Lost { silent } => {
                self.say(Weight::Critical, &format!("autopilot silent for {:.1} s", silent.seconds()));
            }
            IdentityEvent::Back => {
                self.say(Weight::Notice, "the autopilot is back");
                self.begin_anew();
            }
            IdentityEvent::Armed(armed) => tracing::info!("{}", if armed { "armed" } else { "disarmed" }),
            IdentityEvent::Version(version) => tracing::info!("firmware {version}"),
            IdentityEvent::VersionUnknown => tracing::info!("the firmware's version is not told"),
        }
    }

    /// Autopilot or link began anew: what was asked for is forgotten, and the clock may be another.
    pub(super) fn begin_anew(&mut self) {
        if let Some(contact) = &mut self.contact {
            contact.sync.restart();
            contact.wishes.restart();
        }
    }

    /// Time now on the autopilot's boot clock, in our estimation, µs. This is the clock that our messages are stamped with, so
    /// TIMESYNC refines it but does not replace it: answers of another clock are not followed.
    fn boot_now(&self, now: Stamp<Companion>) -> Option<i64> {
        let stamped = self
            .newest
            .map(|(time, at)| self.decoder.clock().boot_micros(time).saturating_add((now - at).micros()));
        let offset = self.contact.as_ref().and_then(|c| c.sync.offset());
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

    /// What a frame of the autopilot means for the conversation.
    pub(super) fn conversation(&mut self, frame: &Frame<'_>, at: Stamp<Companion>) {
        let id = frame.message_id();
        let boot_now = if id == TIMESYNC { self.boot_now(self.clock.now()) } else { None };
        let Some(contact) = &mut self.contact else { return };
        contact.wishes.streams().hear(at, id);
        match id {
            COMMAND_ACK => {
                if let Ok(MavMessage::COMMAND_ACK(ack)) = frame.parse() {
                    let us = contact.us;
                    contact.wishes.streams().acknowledge(us, &ack);
                }
            }
            TIMESYNC => {
                let Ok(MavMessage::TIMESYNC(message)) = frame.parse() else { return };
                // Without an idea of its clock a question cannot be answered: an answer of ours would be another time base.
                if message.tc1 == 0 && boot_now.is_none() {
                    return;
                }
                let answer_ns = boot_now.unwrap_or(0).saturating_mul(1000);
                match contact.sync.hear(at, contact.autopilot, &message, answer_ns) {
                    TimeSyncHeard::Answer(answer) => {
                        self.speaker.answer(&MavMessage::TIMESYNC(answer));
                    }
                    TimeSyncHeard::Stepped { step } => {
                        tracing::warn!("the autopilot's clock was set by {:.3} s", step.seconds());
                        contact.wishes.restart();
                    }
                    TimeSyncHeard::Measured { .. } | TimeSyncHeard::Ignored => {}
                }
            }
            _ => {}
        }
    }

    /// Sends the questions that are due.
    pub(super) fn ask(&mut self, now: Stamp<Companion>) {
        if !self.identity.is_heard() {
            return;
        }
        let (Some(contact), Some(vehicle)) = (&mut self.contact, self.identity.vehicle()) else { return };
        if let Some(question) = contact.sync.poll(now) {
            self.speaker.answer(&question);
        }
        let (wish, refusals) = contact.wishes.poll(now, vehicle);
        if let Some(wish) = wish {
            self.speaker.answer(&wish);
        }
        for refusal in refusals {
            tracing::warn!("{refusal}");
        }
    }
}
