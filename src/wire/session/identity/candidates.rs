//! Who may be the autopilot, by what was heard of each.
//!
//! Anybody can send one heartbeat. What is asked for takes seconds: heartbeats in the rhythm that an autopilot keeps, and, where two claim the
//! same, sensors of the same system and component.

use super::super::Address;
use super::super::heartbeat_fields::HeartbeatFields;
use crate::time::{Companion, Span, Stamp};
use crate::wire::frame::{ComponentId, SystemId};
use crate::wire::messages::{Meaning, meaning_of};

/// As many are remembered; whoever is heard beyond that takes the place of the one with the least to show.
const MOST: usize = 8;
/// Heartbeats closer together are one.
const APART: Span = Span::from_millis(100);
/// A rhythm has no longer pauses: one of two may be lost.
const PAUSE: Span = Span::from_millis(2500);
/// Who was heard within this time may go on to prove itself.
const HEARD: Span = Span::from_millis(1500);
/// Heartbeats that make a rhythm, and the time that they come over at least.
const BEATS: u32 = 2;
const OVER: Span = Span::from_millis(900);
/// IMU frames that make a sensor, and the time that they come over; it is silent after this.
const FRAMES: u32 = 3;
const FRAMES_OVER: Span = Span::from_millis(500);
const SILENT: Span = Span::from_millis(3000);
/// Where several may be it, sensors are waited for this long.
const DECIDED: Span = Span::from_millis(3000);

/// What was heard of somebody who says that it is an autopilot.
#[derive(Clone, Copy, Debug)]
pub(super) struct AutopilotCandidate {
    pub(super) address: Address,
    /// Its newest heartbeat.
    pub(super) fields: HeartbeatFields,
    preferred: bool,
    /// It was served a moment ago.
    expected: bool,
    /// The first and the newest heartbeat of the rhythm, and how many.
    first: Stamp<Companion>,
    newest: Stamp<Companion>,
    beats: u32,
    inertial: Option<Inertial>,
}

/// IMU frames: the first and the newest, and how many.
#[derive(Clone, Copy, Debug)]
struct Inertial {
    first: Stamp<Companion>,
    newest: Stamp<Companion>,
    frames: u32,
}

impl AutopilotCandidate {
    fn beat(&mut self, now: Stamp<Companion>, fields: HeartbeatFields) {
        self.fields = fields;
        let since = now - self.newest;
        if since > PAUSE || since < Span::ZERO {
            (self.first, self.newest, self.beats) = (now, now, 1);
        } else if since >= APART {
            self.newest = now;
            self.beats += 1;
        }
    }

    fn feel(&mut self, now: Stamp<Companion>) {
        let new = Inertial { first: now, newest: now, frames: 0 };
        let kept = self.inertial.filter(|i| now - i.newest < SILENT);
        let inertial = self.inertial.insert(kept.unwrap_or(new));
        inertial.newest = now;
        inertial.frames += 1;
    }

    fn keeps_rhythm(&self, now: Stamp<Companion>) -> bool {
        self.beats >= BEATS && self.newest - self.first >= OVER && now - self.newest <= PAUSE
    }

    /// Whether IMU frames of its come.
    pub(super) fn shows_sensors(&self, now: Stamp<Companion>) -> bool {
        self.inertial.is_some_and(|i| {
            i.frames >= FRAMES && i.newest - i.first >= FRAMES_OVER && now - i.newest < SILENT
        })
    }

    /// Whether it may be chosen: a component that is not known to be an autopilot's has to show sensors.
    fn may_be_chosen(&self, now: Stamp<Companion>) -> bool {
        (self.keeps_rhythm(now) && (self.preferred || self.shows_sensors(now)))
            || (self.expected && now - self.newest <= PAUSE)
    }

    /// Sensors tell most, then the component, then who has been heard for longest.
    fn merit(&self, now: Stamp<Companion>) -> (bool, bool, bool, i64) {
        (self.expected, self.shows_sensors(now), self.preferred, -self.first.micros())
    }
}

/// All of them.
#[derive(Clone, Debug)]
pub(super) struct Candidates {
    system: Option<SystemId>,
    component: Option<ComponentId>,
    expected: Option<SystemId>,
    heard: Vec<AutopilotCandidate>,
}

impl Candidates {
    /// Of this system and component only, where they are given.
    pub(super) fn new(system: Option<SystemId>, component: Option<ComponentId>) -> Self {
        Self { system, component, expected: None, heard: Vec::with_capacity(MOST) }
    }

    /// This system was served a moment ago.
    pub(super) fn expect(&mut self, system: SystemId) {
        self.expected = Some(system);
    }

    /// Takes note of a frame of somebody; `heartbeat`, if it is one of an autopilot.
    pub(super) fn hear(
        &mut self,
        now: Stamp<Companion>,
        from: Address,
        message_id: u32,
        heartbeat: Option<HeartbeatFields>,
    ) {
        let inertial = meaning_of(message_id) == Some(Meaning::Inertial);
        if heartbeat.is_none() && !inertial {
            return;
        }
        let known = self.heard.iter_mut().find(|c| c.address == from);
        match (known, heartbeat) {
            (Some(candidate), Some(fields)) => candidate.beat(now, fields),
            (Some(candidate), None) => candidate.feel(now),
            (None, Some(fields)) => self.remember(now, from, fields),
            (None, None) => {}
        }
    }

    fn remember(&mut self, now: Stamp<Companion>, address: Address, fields: HeartbeatFields) {
        let wanted = self.system.is_none_or(|s| s == address.system)
            && self.component.is_none_or(|c| c == address.component);
        // System 0 is everyone: nobody can be spoken to by that number.
        if !wanted || address.system.0 == 0 {
            return;
        }
        let preferred = address.component == self.component.unwrap_or(ComponentId::AUTOPILOT);
        let expected = preferred && self.expected == Some(address.system);
        let (first, newest) = (now, now);
        let new = AutopilotCandidate {
            address,
            fields,
            preferred,
            expected,
            first,
            newest,
            beats: 1,
            inertial: None,
        };
        if self.heard.len() < MOST {
            self.heard.push(new);
            return;
        }
        let weight = |c: &AutopilotCandidate| (c.keeps_rhythm(now), c.merit(now));
        if let Some(least) =
            self.heard.iter_mut().min_by_key(|c| weight(c)).filter(|c| weight(c) <= weight(&new))
        {
            *least = new;
        }
    }

    /// Who is to be chosen now, but for `current`.
    pub(super) fn best(&self, now: Stamp<Companion>, current: Option<Address>) -> Option<AutopilotCandidate> {
        let mut possible = self.heard.iter().filter(|c| Some(c.address) != current && c.may_be_chosen(now));
        let best = possible.clone().max_by_key(|c| c.merit(now))?;
        // Who else may prove to be it is waited for.
        let rival =
            |c: &AutopilotCandidate| c.address != best.address && c.preferred && now - c.newest <= HEARD;
        let alone = !self.heard.iter().any(rival) && possible.all(|c| c.address == best.address);
        let decided = current.is_some()
            || alone
            || best.expected
            || best.shows_sensors(now)
            || now - best.first >= DECIDED;
        decided.then_some(*best)
    }

    /// Who would be, if nothing more came.
    pub(super) fn likeliest(&self) -> Option<AutopilotCandidate> {
        let frames = |c: &AutopilotCandidate| c.inertial.map_or(0, |i| i.frames);
        self.heard.iter().max_by_key(|c| (frames(c), c.preferred, c.beats, -c.first.micros())).copied()
    }

    /// Whether IMU frames of this one come.
    pub(super) fn shows_sensors(&self, now: Stamp<Companion>, address: Address) -> bool {
        self.heard.iter().any(|c| c.address == address && c.shows_sensors(now))
    }
}
