//! The altimeter in the navigator, and when each of its channels was last heard.

use crate::altimeter::{AltimeterMemory, Change, Channel, Health, HeightFilter, HeightVerdict};
use crate::time::AutopilotTime;

use super::estimator::climb_beyond;
use super::event::EventKind;
use super::event_log::EventLog;
use super::height_wander::HeightWander;
use super::reset::Reset;
use super::settings::HeightSettings;
use super::verdict::{Reason, Verdict};
use crate::navigator::tuning::height::{KNOWN_AGAIN, SILENT_S};

/// A height of a source, above the origin, for the altimeter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct HeightReading {
    pub(super) channel: Channel,
    pub(super) height_m: f64,
    /// What the sensor claims, if it does, m.
    pub(super) sigma_m: Option<f64>,
    /// How long ago it was measured, s.
    pub(super) age_s: f64,
}

/// What a reading did.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeightUpdate {
    pub(super) verdict: Option<HeightVerdict>,
    /// How far it has moved the estimated height, m, if there was one before.
    pub(super) moved_m: Option<f64>,
    /// It was a decision (a fault found or over) or a return, and no tracking.
    pub(super) decision: bool,
    /// A fault was found or is over.
    pub(super) told: bool,
    /// The height was not known any more, for nobody had measured it over a hole.
    pub(super) unseen: bool,
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(super) struct HeightEstimate {
    filter: HeightFilter,
    wander: HeightWander,
    /// When each channel was heard last, and what it told, m.
    heard: [Option<(AutopilotTime, f64)>; 4],
    /// After a long hole, until the height is known to this again, m.
    unseen: Option<f64>,
}

impl HeightEstimate {
    pub(super) fn new(settings: &HeightSettings) -> Self {
        Self {
            filter: HeightFilter::new(settings.kind, settings.altimeter),
            wander: HeightWander::new(&settings.altimeter),
            heard: [None; 4],
            unseen: None,
        }
    }

    /// Above the origin, m.
    pub(super) fn height_m(&self) -> Option<f64> {
        self.filter.height_m()
    }

    pub(super) fn height_sigma_m(&self) -> f64 {
        self.filter.height_sigma_m()
    }

    pub(super) fn climb_mps(&self) -> f64 {
        self.filter.climb_mps()
    }

    pub(super) fn climb_sigma_mps(&self) -> f64 {
        self.filter.climb_sigma_mps()
    }

    /// Goes on by `dt` s with the upward acceleration, m/s², and noise beyond the altimeter's own, m/s²/√Hz.
    pub(super) fn predict(&mut self, dt: f64, accel_up: f64, noise: f64) {
        self.filter.predict(dt, accel_up, noise);
    }

    /// The IMU was silent for `gap_s`, a hole that is `long` where nothing was published in it either.
    pub(super) fn blind(&mut self, gap_s: f64, long: bool) {
        if long && self.unseen.is_none() {
            self.unseen = Some(KNOWN_AGAIN * self.filter.height_sigma_m());
        }
        self.filter.blind(gap_s, &climb_beyond(gap_s, self.filter.climb_mps()));
    }

    /// See [`HeightFilter::doubt`].
    pub(super) fn doubt(&mut self, climb_mps: f64, for_s: f64) {
        self.filter.doubt(climb_mps, for_s);
    }

    /// What comes on a channel is another sensor's from now on.
    pub(super) fn another(&mut self, channel: Channel) {
        self.filter.another(channel);
        self.wander.another(channel);
    }

    /// The barometers' offsets walk by `walk` m/√s for `dt` s.
    pub(super) fn loosen_barometers(&mut self, walk: f64, dt: f64) {
        for channel in [Channel::Baro, Channel::SecondBaro] {
            self.filter.loosen(channel, walk, dt);
        }
    }

    /// Sources wander by what they were found to for `dt` s more.
    pub(super) fn wander(&mut self, dt: f64, resting: bool) {
        self.wander.step(dt, resting);
        for channel in [Channel::Baro, Channel::SecondBaro, Channel::Gnss] {
            self.filter.loosen(channel, self.wander.walk(channel), dt);
        }
    }

    /// The ground under the beam changes by `walk` m/√s for `dt` s.
    pub(super) fn loosen_ground(&mut self, walk: f64, dt: f64) {
        self.filter.loosen(Channel::Range, walk, dt);
    }

    /// How far down the ground is, m, by a rangefinder, whatever becomes of that as a height.
    pub(super) fn hear_ground(&mut self, above_m: f64) {
        self.wander.hear(Channel::Range, above_m, None);
    }

    /// Takes a reading and tells what it changed.
    pub(super) fn take(
        &mut self,
        now: AutopilotTime,
        reading: &HeightReading,
        events: &mut EventLog,
    ) -> HeightUpdate {
        let before = self.filter.height_m();
        let HeightReading { channel, height_m, sigma_m, age_s } = *reading;
        if channel != Channel::Range && !(channel == Channel::Gnss && self.health(channel).is_faulty()) {
            self.wander.hear(channel, height_m + self.filter.climb_mps() * age_s, sigma_m);
        }
        let sigma_m = self.wander.sigma_m(channel, sigma_m);
        let verdict = self.filter.measure(channel, height_m, sigma_m, age_s);
        let told = self.tell_changes(now, events);
        let heard = self.heard[channel.index()].replace((now, height_m));
        let moved_m = before.zip(self.filter.height_m()).map(|(before, after)| after - before);
        let returned = heard.is_none_or(|(t, _)| now.seconds_since(t) > SILENT_S);
        let known_m = self.unseen.take();
        self.unseen = known_m.filter(|m| self.filter.height_sigma_m() > *m);
        HeightUpdate { verdict, moved_m, decision: told || returned, told, unseen: known_m.is_some() }
    }

    fn tell_changes(&mut self, now: AutopilotTime, events: &mut EventLog) -> bool {
        let mut told = false;
        while let Some(change) = self.filter.next_change() {
            let kind = match change {
                Change::Faulty { channel, fault, for_s } => {
                    self.wander.forget(channel);
                    EventKind::HeightFault { channel, fault, for_s }
                }
                Change::Healed(channel) => {
                    self.wander.forget(channel);
                    EventKind::HeightHealed(channel)
                }
                Change::InertialAstray { height_step_m } => EventKind::InertialHeight(height_step_m),
            };
            events.tell(now, kind);
            told = true;
        }
        told
    }

    /// What the altimeter knows, and knows again. See [`HeightFilter::memory`].
    pub(super) fn memory(&self) -> Option<AltimeterMemory> {
        self.filter.memory()
    }

    /// See [`HeightFilter::remember`].
    pub(super) fn remember(&mut self, memory: &AltimeterMemory) -> bool {
        self.filter.remember(memory)
    }

    /// What the altimeter holds of a channel.
    pub(super) fn health(&self, channel: Channel) -> Health {
        self.filter.health(channel)
    }

    /// What a channel's height is off by as a rule, m, and for how long it has been silent, s.
    pub(super) fn standing(&self, channel: Channel) -> Option<(f64, f64)> {
        self.filter.standing(channel)
    }

    /// When a channel was heard last, and what height it told, m above the origin.
    pub(super) fn reading(&self, channel: Channel) -> Option<(AutopilotTime, f64)> {
        self.heard[channel.index()]
    }

    /// Whether a height lies more than `gate` sigmas from what the channel should tell.
    pub(super) fn contradicts(&self, channel: Channel, height_m: f64, sigma_m: f64, gate: f64) -> bool {
        let apart = self.filter.disagreement(channel, height_m, sigma_m);
        apart.is_some_and(|sigmas| sigmas.abs() > gate)
    }

    pub(super) fn reset(&mut self, reset: &Reset, settings: &HeightSettings) {
        match reset {
            Reset::OriginMoved(moved) => {
                self.filter.shift_origin(-moved.z);
                // Of all heights it is those of fixes that count from it.
                self.wander.forget(Channel::Gnss);
            }
            // Nobody knows how high it stands.
            Reset::Reboot | Reset::ClockSetBack => *self = Self::new(settings),
            Reset::Relocated | Reset::Bridged | Reset::StreamBroken => {}
        }
    }
}

/// A height's verdict as everybody's.
pub(super) fn verdict(height: Option<HeightVerdict>) -> Verdict {
    match height {
        Some(HeightVerdict::Used { .. }) => Verdict::Used,
        Some(HeightVerdict::Rejected(normalised)) if normalised.is_nan() => {
            Verdict::Rejected(Reason::NotFinite)
        }
        Some(HeightVerdict::Rejected(_)) => Verdict::Rejected(Reason::Innovation),
        None => Verdict::Rejected(Reason::NotUsed),
    }
}
