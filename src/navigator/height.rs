//! The altimeter in the navigator: who feeds it, what it tells, and a published height that never steps unannounced.

use crate::altimeter::{Change, Channel, Health, HeightVerdict};
use crate::sample::{PressureSample, RangeSample};
use crate::time::AutopilotTime;

use super::Navigator;
use super::event::What;
use super::verdict::{Reason, Verdict};

/// What single measurements move the height by is shown over this time, s: enough that nothing steps, too little to lag.
const SMOOTHED_S: f64 = 0.25;
/// A height that a channel moves after so long a silence is a return, s.
const SILENT_S: f64 = 1.0;
/// A height whose distance to the estimate is below this has joined it, m.
const JOINED_M: f64 = 1e-3;
/// A pressure is carried to the present for this long, s.
const LATE_PRESSURE_S: f64 = 0.6;
/// A barometer that is silent for this long has left its place to another, s.
const BARO_SILENCE_S: f64 = 10.0;
/// Distances are heights this often, s, and known to this part of themselves.
const RANGE_PERIOD_S: f64 = 0.1;
const RANGE_RELATIVE: f64 = 0.03;
/// A barometer that tells exactly the same for this long, s, while the vehicle has climbed by this much, m, is stuck.
const STUCK_S: f64 = 1.0;
const STUCK_CLIMB_M: f64 = 1.5;

/// One of the two barometers that are listened to.
#[derive(Clone, Copy, Debug)]
pub(super) struct Barometer {
    sensor: u8,
    heard: AutopilotTime,
    /// Since when it tells this pressure, Pa, and where the height was then, m, if it was known and has only been climbed from since.
    same: (AutopilotTime, f64, Option<f64>),
    stuck: bool,
}

/// What the navigator remembers about heights.
#[derive(Clone, Debug, Default)]
pub(super) struct HeightState {
    /// Published less estimated height, m, after a decision: glides to zero.
    gliding_m: f64,
    /// And what tracking has moved the height by just now, m: goes at once.
    smoothed_m: f64,
    /// When each channel last had a height.
    heard: [Option<AutopilotTime>; 4],
    pub(super) barometers: [Option<Barometer>; 2],
    /// The newest distance that was taken for a height.
    ranged: Option<AutopilotTime>,
    /// The GNSS height is declared faulty.
    pub(super) gnss_faulty: bool,
}

impl HeightState {
    /// The height has moved without a climb.
    pub(super) fn moved(&mut self) {
        for barometer in self.barometers.iter_mut().flatten() {
            barometer.same.2 = None;
        }
    }

    /// Published less estimated height, m.
    pub(super) fn offset_m(&self) -> f64 {
        self.gliding_m + self.smoothed_m
    }
}

impl Navigator {
    /// Height above the origin as it is published, m.
    pub(super) fn published_height_m(&self) -> Option<f64> {
        self.height.height_m().map(|h| h + self.heights.offset_m())
    }

    /// A height of a channel, m, measured `age_s` ago, to the altimeter: the published height goes on without a step.
    pub(super) fn take_height(
        &mut self,
        now: AutopilotTime,
        channel: Channel,
        height_m: f64,
        sigma_m: Option<f64>,
        age_s: f64,
    ) -> Option<HeightVerdict> {
        let before = self.height.height_m();
        let verdict = self.height.measure(channel, height_m, sigma_m, age_s);
        let told = self.note_height_changes(now);
        let heard = self.heights.heard[channel.index()].replace(now);
        if let (Some(before), Some(after)) = (before, self.height.height_m()) {
            // A decision or a return moves the height once, and it glides there; all else is tracking.
            if told || heard.is_none_or(|t| now.seconds_since(t) > SILENT_S) {
                self.heights.gliding_m -= after - before;
            } else {
                self.heights.smoothed_m -= after - before;
            }
        }
        if self.heights.offset_m().abs() > self.settings.height.jump_m || !self.is_published() {
            self.reset_height(now);
        }
        verdict
    }

    /// Nobody was told a height yet: there is nothing to be continuous with.
    fn is_published(&self) -> bool {
        self.modes.mode() != super::solution::Mode::Aligning
    }

    /// The published height jumps to the estimate.
    fn reset_height(&mut self, now: AutopilotTime) {
        let jump = self.heights.offset_m();
        (self.heights.gliding_m, self.heights.smoothed_m) = (0.0, 0.0);
        if self.is_published() && jump != 0.0 {
            self.reset_counter = self.reset_counter.wrapping_add(1);
            self.tell(now, What::HeightReset(-jump));
        }
    }

    /// The published height glides to the estimate.
    pub(super) fn glide_height(&mut self, dt: f64) {
        self.heights.smoothed_m *= (1.0 - dt / SMOOTHED_S).max(0.0);
        let away = self.heights.gliding_m;
        if away != 0.0 {
            let left = (away.abs() - self.settings.height.glide_mps * dt).max(0.0);
            self.heights.gliding_m = if left < JOINED_M { 0.0 } else { left.copysign(away) };
        }
    }

    /// Tells what changed. True when something did.
    fn note_height_changes(&mut self, now: AutopilotTime) -> bool {
        let mut told = false;
        while let Some(change) = self.height.next_change() {
            let what = match change {
                Change::Faulty { channel, fault, for_s } => What::HeightFault { channel, fault, for_s },
                Change::Healed(channel) => What::HeightHealed(channel),
                Change::InertialAstray { height_step_m } => What::InertialHeight(height_step_m),
            };
            self.tell(now, what);
            told = true;
        }
        if told {
            self.heights.moved();
        }
        let faulty = self.height.health(Channel::Gnss).is_faulty();
        if faulty != self.heights.gnss_faulty {
            self.heights.gnss_faulty = faulty;
            self.trust.height_fault(faulty);
        }
        told
    }

    /// What the altimeter holds of its channels.
    pub fn height_health(&self) -> [(Channel, Health); 4] {
        Channel::ALL.map(|c| (c, self.height.health(c)))
    }

    /// What a channel's height is off by as a rule, m, and for how long it has been silent, s.
    pub fn height_standing(&self, channel: Channel) -> Option<(f64, f64)> {
        self.height.standing(channel)
    }

    pub(super) fn pressure(&mut self, s: &PressureSample) -> Verdict {
        let Some(altitude) = crate::geo::atmosphere::pressure_altitude_m(s.pressure_pa) else {
            return Verdict::Rejected(Reason::NotFinite);
        };
        let Some(now) = self.last_imu else { return Verdict::Rejected(Reason::NoReferenceYet) };
        let Some((index, channel)) = self.barometer(s) else { return Verdict::Rejected(Reason::Redundant) };
        let height = self.height.height_m();
        let known = self.heights.barometers[index].filter(|b| b.sensor == s.sensor);
        if known.is_some_and(|b| s.time <= b.heard) {
            return Verdict::Rejected(Reason::OutOfOrder);
        }
        if self.is_late(s.time, LATE_PRESSURE_S) {
            return Verdict::Rejected(Reason::Late);
        }
        if known.is_none() && self.heights.barometers[index].is_some() {
            self.height.another(channel);
        }
        let barometer = known.map_or_else(|| Barometer::new(s, height), |b| b.told(s, height));
        self.heights.barometers[index] = Some(barometer);
        if barometer.stuck {
            return Verdict::Rejected(Reason::Stuck);
        }
        // Before there is a place, a height has no zero.
        if self.place.is_none() {
            return Verdict::Rejected(Reason::NoReferenceYet);
        }
        verdict(self.take_height(now, channel, altitude, None, now.seconds_since(s.time)))
    }

    /// Which of the two barometers a sample is of: the first that was heard leads, another one votes.
    fn barometer(&self, s: &PressureSample) -> Option<(usize, Channel)> {
        let channels = [Channel::Baro, Channel::SecondBaro];
        let has = |i: usize| self.heights.barometers[i].is_some_and(|b| b.sensor == s.sensor);
        let free = |i: usize| {
            self.heights.barometers[i].is_none_or(|b| s.time.seconds_since(b.heard) > BARO_SILENCE_S)
        };
        let index = (0..2).find(|i| has(*i)).or_else(|| (0..2).find(|i| free(*i)))?;
        Some((index, channels[index]))
    }

    /// The distance to the ground as a height, near the ground, where the ground is one.
    pub(super) fn range_height(&mut self, s: &RangeSample, above_ground_m: f64) {
        let h = &self.settings.height;
        let Some(now) = self.last_imu else { return };
        // Rangefinders filter: their samples are not independent at a high rate.
        let due = self.heights.ranged.is_none_or(|t| s.time.seconds_since(t).abs() >= RANGE_PERIOD_S);
        if due && above_ground_m < h.range_below_m && self.is_published() {
            self.heights.ranged = Some(s.time);
            let sigma = RANGE_RELATIVE * above_ground_m;
            self.take_height(now, Channel::Range, above_ground_m, Some(sigma), now.seconds_since(s.time));
        }
    }

    /// The air under a multirotor near the ground is not what the barometer thinks: its offset is loose there.
    pub(super) fn feel_ground(&mut self, dt: f64) {
        let h = &self.settings.height;
        let near = self
            .ground_m
            .zip(self.height.height_m())
            .is_some_and(|(ground, height)| (height - ground).abs() < h.ground_effect_below_m);
        if near && !self.resting() && self.is_published() {
            let walk = h.ground_effect_walk;
            for channel in [Channel::Baro, Channel::SecondBaro] {
                self.height.loosen(channel, walk, dt);
            }
        }
    }
}

impl Barometer {
    fn new(s: &PressureSample, height_m: Option<f64>) -> Self {
        Self { sensor: s.sensor, heard: s.time, same: (s.time, s.pressure_pa, height_m), stuck: false }
    }

    /// With a sample that was just heard.
    fn told(self, s: &PressureSample, height_m: Option<f64>) -> Self {
        let (since, pressure, then_m) = self.same;
        if pressure != s.pressure_pa {
            return Self { heard: s.time, same: (s.time, s.pressure_pa, height_m), stuck: false, ..self };
        }
        let climbed = height_m.zip(then_m).is_some_and(|(now, then)| (now - then).abs() > STUCK_CLIMB_M);
        let stuck = self.stuck || (climbed && s.time.seconds_since(since) > STUCK_S);
        Self { heard: s.time, same: (since, pressure, then_m.or(height_m)), stuck, ..self }
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
