//! What was heard of somebody who says that it is an autopilot: heartbeats in the rhythm that an autopilot keeps, and frames of its IMU.
//!
//! A link gathers it of a UDP peer before it answers it, and the session goes on from there: neither waits for what the other has heard.

use super::super::Address;
use super::super::heartbeat_fields::HeartbeatFields;
use crate::time::{Companion, Span, Stamp};

/// Heartbeats closer together are one.
const APART: Span = Span::from_millis(100);
/// A rhythm has no longer pauses: one of two may be lost.
pub(super) const PAUSE: Span = Span::from_millis(2500);
/// Heartbeats that make a rhythm, and the time that they come over at least.
const BEATS: u32 = 2;
const OVER: Span = Span::from_millis(900);
/// IMU frames that make a sensor, and the time that they come over; it is silent after this.
const FRAMES: u32 = 3;
const FRAMES_OVER: Span = Span::from_millis(500);
const SILENT: Span = Span::from_millis(3000);

/// How often something came in a row, from when to when.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct InARow {
    first: Stamp<Companion>,
    newest: Stamp<Companion>,
    times: u32,
}

impl InARow {
    fn begin(now: Stamp<Companion>) -> Self {
        Self { first: now, newest: now, times: 1 }
    }

    fn go_on(&mut self, now: Stamp<Companion>) {
        self.newest = now;
        self.times = self.times.saturating_add(1);
    }

    /// With what another has heard of the same before.
    fn after(self, before: Self) -> Self {
        Self {
            first: self.first.min(before.first),
            newest: self.newest.max(before.newest),
            times: self.times.saturating_add(before.times),
        }
    }
}

/// See the module's documentation.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct AutopilotShown {
    /// Who.
    pub address: Address,
    /// Its newest heartbeat.
    pub(super) fields: HeartbeatFields,
    beats: InARow,
    inertial: Option<InARow>,
}

impl AutopilotShown {
    /// By the first heartbeat of it.
    pub(crate) fn new(now: Stamp<Companion>, address: Address, fields: HeartbeatFields) -> Self {
        Self { address, fields, beats: InARow::begin(now), inertial: None }
    }

    /// Takes note of a heartbeat of it.
    pub(crate) fn beat(&mut self, now: Stamp<Companion>, fields: HeartbeatFields) {
        self.fields = fields;
        let since = now - self.beats.newest;
        if since > PAUSE || since < Span::ZERO {
            self.beats = InARow::begin(now);
        } else if since >= APART {
            self.beats.go_on(now);
        }
    }

    /// Takes note of a frame of its IMU.
    pub(crate) fn feel(&mut self, now: Stamp<Companion>) {
        match self.inertial.as_mut().filter(|i| now - i.newest < SILENT) {
            Some(inertial) => inertial.go_on(now),
            None => self.inertial = Some(InARow::begin(now)),
        }
    }

    /// Adds what somebody else has heard of it before.
    pub(super) fn heard_before(&mut self, other: &Self) {
        if self.beats.first - other.beats.newest <= PAUSE {
            self.beats = self.beats.after(other.beats);
        }
        self.inertial = match (self.inertial, other.inertial) {
            (Some(own), Some(before)) if own.first - before.newest < SILENT => Some(own.after(before)),
            (own, before) => own.or(before),
        };
    }

    /// Since when its heartbeats have come, and when the newest came.
    pub(super) fn beats_from_to(&self) -> (Stamp<Companion>, Stamp<Companion>) {
        (self.beats.first, self.beats.newest)
    }

    /// How many heartbeats and frames of an IMU came in a row.
    pub(super) fn counts(&self) -> (u32, u32) {
        (self.beats.times, self.inertial.map_or(0, |i| i.times))
    }

    pub(super) fn keeps_rhythm(&self, now: Stamp<Companion>) -> bool {
        let InARow { first, newest, times } = self.beats;
        times >= BEATS && newest - first >= OVER && now - newest <= PAUSE
    }

    /// Whether IMU frames of its come.
    pub(super) fn shows_sensors(&self, now: Stamp<Companion>) -> bool {
        self.inertial.is_some_and(|i| {
            i.times >= FRAMES && i.newest - i.first >= FRAMES_OVER && now - i.newest < SILENT
        })
    }
}
