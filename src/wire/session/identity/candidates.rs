//! Who may be the autopilot, by what was heard of each.
//!
//! Anybody can send one heartbeat. What is asked for takes seconds: heartbeats in the rhythm that an autopilot keeps, and, where two claim the
//! same, sensors of the same system and component.

use super::super::Address;
use super::super::heartbeat_fields::HeartbeatFields;
use super::shown::{AutopilotShown, PAUSE};
use crate::time::{Companion, Span, Stamp};
use crate::wire::frame::{ComponentId, SystemId};
use crate::wire::messages::{Meaning, meaning_of};

/// As many are remembered; whoever is heard beyond that takes the place of the one with the least to show.
const MOST: usize = 8;
/// Who was heard within this time may go on to prove itself.
const HEARD: Span = Span::from_millis(1500);
/// Where several may be it, sensors are waited for this long.
const DECIDED: Span = Span::from_millis(3000);

/// Somebody who says that it is an autopilot.
#[derive(Clone, Copy, Debug)]
pub(super) struct AutopilotCandidate {
    pub(super) shown: AutopilotShown,
    preferred: bool,
    /// It was served a moment ago.
    expected: bool,
}

impl AutopilotCandidate {
    fn address(&self) -> Address {
        self.shown.address
    }

    /// Whether it may be chosen: a component that is not known to be an autopilot's has to show sensors.
    fn may_be_chosen(&self, now: Stamp<Companion>) -> bool {
        let (_, newest) = self.shown.beats_from_to();
        (self.shown.keeps_rhythm(now) && (self.preferred || self.shown.shows_sensors(now)))
            || (self.expected && now - newest <= PAUSE)
    }

    /// Sensors tell most, then the component, then who has been heard for longest.
    fn merit(&self, now: Stamp<Companion>) -> (bool, bool, bool, i64) {
        let (first, _) = self.shown.beats_from_to();
        (self.expected, self.shown.shows_sensors(now), self.preferred, -first.micros())
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
        match (self.of(from), heartbeat) {
            (Some(candidate), Some(fields)) => candidate.shown.beat(now, fields),
            (Some(candidate), None) => candidate.shown.feel(now),
            (None, Some(fields)) => self.remember(now, AutopilotShown::new(now, from, fields)),
            (None, None) => {}
        }
    }

    /// Takes note of what a link has heard of somebody before it passed anything on.
    pub(super) fn heard_before(&mut self, now: Stamp<Companion>, shown: &AutopilotShown) {
        match self.of(shown.address) {
            Some(candidate) => candidate.shown.heard_before(shown),
            None => self.remember(now, *shown),
        }
    }

    fn of(&mut self, address: Address) -> Option<&mut AutopilotCandidate> {
        self.heard.iter_mut().find(|c| c.address() == address)
    }

    fn remember(&mut self, now: Stamp<Companion>, shown: AutopilotShown) {
        let address = shown.address;
        let wanted = self.system.is_none_or(|s| s == address.system)
            && self.component.is_none_or(|c| c == address.component);
        // System 0 is everyone: nobody can be spoken to by that number.
        if !wanted || address.system.0 == 0 {
            return;
        }
        let preferred = address.component == self.component.unwrap_or(ComponentId::AUTOPILOT);
        let expected = preferred && self.expected == Some(address.system);
        let new = AutopilotCandidate { shown, preferred, expected };
        if self.heard.len() < MOST {
            self.heard.push(new);
            return;
        }
        let weight = |c: &AutopilotCandidate| (c.shown.keeps_rhythm(now), c.merit(now));
        if let Some(least) =
            self.heard.iter_mut().min_by_key(|c| weight(c)).filter(|c| weight(c) <= weight(&new))
        {
            *least = new;
        }
    }

    /// Who is to be chosen now, but for `current`.
    pub(super) fn best(&self, now: Stamp<Companion>, current: Option<Address>) -> Option<AutopilotCandidate> {
        let mut possible = self.heard.iter().filter(|c| Some(c.address()) != current && c.may_be_chosen(now));
        let best = possible.clone().max_by_key(|c| c.merit(now))?;
        // Who else may prove to be it is waited for.
        let rival = |c: &AutopilotCandidate| {
            c.address() != best.address() && c.preferred && now - c.shown.beats_from_to().1 <= HEARD
        };
        let alone = !self.heard.iter().any(rival) && possible.all(|c| c.address() == best.address());
        let decided = current.is_some()
            || alone
            || best.expected
            || best.shown.shows_sensors(now)
            || now - best.shown.beats_from_to().0 >= DECIDED;
        decided.then_some(*best)
    }

    /// Who would be, if nothing more came.
    pub(super) fn likeliest(&self) -> Option<AutopilotCandidate> {
        let weight = |c: &AutopilotCandidate| {
            let ((beats, frames), (first, _)) = (c.shown.counts(), c.shown.beats_from_to());
            (frames, c.preferred, beats, -first.micros())
        };
        self.heard.iter().max_by_key(|c| weight(c)).copied()
    }

    /// Whether IMU frames of this one come.
    pub(super) fn shows_sensors(&self, now: Stamp<Companion>, address: Address) -> bool {
        self.heard.iter().any(|c| c.address() == address && c.shown.shows_sensors(now))
    }
}
