//! A rangefinder: the distance to the ground, where the ground is, and near it a height.

use crate::altimeter::Channel;
use crate::sample::RangeSample;
use crate::time::AutopilotTime;

use super::super::context::Context;
use super::super::height::HeightReading;
use super::super::reset::Reset;
use super::super::solution::Mode;
use super::super::verdict::Reason;
use super::following::Following;
use super::status::SourceHealth;
use crate::navigator::tuning::every_source::LATE_S;
use crate::navigator::tuning::rangefinder::{
    DISPUTE_S, FOLLOW_STEP_S, GROUND_BELIEVED_S, GROUND_RATE_MPS, GROUND_SLOPE, GROUND_STEP_FRACTION,
    GROUND_STEP_M, GROUND_TELLS_M, HEIGHT_PERIOD_S, LEVEL_COSINE, MIN_COSINE, NEAR_GREATEST, NEAR_LEAST,
    ONLY_S, RELATIVE_SIGMA, STANDS, STUCK_M, STUCK_S,
};

/// The ground is seen elsewhere than it was.
#[derive(Clone, Copy, Debug)]
struct Dispute {
    since: AutopilotTime,
    last: AutopilotTime,
    /// How much higher, m.
    rise_m: f64,
    /// Least and greatest height of the vehicle meanwhile, m.
    heights_m: [f64; 2],
    /// The distance that is measured over the one that it should be.
    ratio: f64,
    /// It has stood for long enough: the ground is elsewhere.
    believed: bool,
}

/// The same distance, told again and again.
#[derive(Clone, Copy, Debug)]
struct SameDistance {
    since: AutopilotTime,
    distance_m: f64,
    /// Least and greatest length of the beam meanwhile, by the altimeter, m.
    expected_m: [f64; 2],
}

impl SameDistance {
    /// Whether the beam has become longer or shorter by more than any resolution hides.
    fn is_stuck(&self, now: AutopilotTime) -> bool {
        let changed_m = self.expected_m[1] - self.expected_m[0];
        now.seconds_since(self.since) > STUCK_S && changed_m > STUCK_M.max(RELATIVE_SIGMA * self.distance_m)
    }
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RangefinderSource {
    same: Option<SameDistance>,
    /// The least that it has told, m: what it tells of a vehicle that stands.
    least_m: Option<f64>,
    newest: Option<(AutopilotTime, f64)>,
    /// Height of the ground above the origin, where it was last seen beyond dispute, m.
    ground_m: Option<f64>,
    dispute: Option<Dispute>,
    following: Following,
    /// When the ground was last followed.
    followed: Option<AutopilotTime>,
    /// The newest distance that was taken for a height.
    taken: Option<AutopilotTime>,
}

impl RangefinderSource {
    /// The newest distance along body z, m.
    pub(super) fn newest(&self) -> Option<(AutopilotTime, f64)> {
        self.newest
    }

    /// The ground is where it was last seen.
    pub(super) fn recalling(ground_m: f64) -> Self {
        Self { ground_m: Some(ground_m), ..Self::default() }
    }

    /// Height of the ground above the origin, m.
    pub(super) fn ground_m(&self) -> Option<f64> {
        self.ground_m
    }

    /// Tests that need no height.
    fn admit(&self, s: &RangeSample, context: &Context<'_>) -> Result<(), Reason> {
        if !s.distance_m.is_finite() {
            return Err(Reason::NotFinite);
        }
        if self.newest.is_some_and(|(t, _)| s.time < t) {
            return Err(Reason::OutOfOrder);
        }
        if context.is_late(s.time, LATE_S) {
            return Err(Reason::Late);
        }
        let outside =
            |[low, high]: [f64; 2]| s.distance_m <= NEAR_LEAST * low || s.distance_m >= NEAR_GREATEST * high;
        if s.distance_m <= 0.0 || s.limits_m.is_some_and(outside) {
            return Err(Reason::OutOfRange);
        }
        Ok(())
    }

    /// Takes a distance. A height when one is due: near the ground, where the ground is one.
    pub(super) fn observe(
        &mut self,
        s: &RangeSample,
        context: &Context<'_>,
    ) -> Result<Option<HeightReading>, Reason> {
        self.admit(s, context)?;
        let cosine = context.core.attitude.r_body_to_ned[(2, 2)];
        let height = context.core.height.height_m().filter(|_| cosine > MIN_COSINE);
        let height = height.ok_or(Reason::NoReferenceYet)?;
        if self.repeats(s.time, s.distance_m, height / cosine) {
            return Err(Reason::Stuck);
        }
        // In a bank an error of the attitude is one of the distance.
        if cosine > LEVEL_COSINE {
            self.following.note(s.time, s.distance_m * cosine, height);
        }
        let ground = height - s.distance_m * cosine;
        if let Some(known) = self.ground_m
            && !self.is_plausible(s.time, ground - known, height, height - known)
        {
            return Err(Reason::Innovation);
        }
        if self.dispute.take().is_some_and(|d| d.believed) {
            self.ground_m = None;
        }
        self.newest = Some((s.time, s.distance_m));
        // What the altimeter has convicted does not say where the ground is.
        let doubted = self.following.is_astray() || context.core.height.health(Channel::Range).is_faulty();
        if self.ground_m.is_none() || !doubted {
            self.follow_ground(s.time, ground, context);
        }
        Ok(self.height(s, s.distance_m * cosine, context))
    }

    /// Whether it tells the same distance, whatever the vehicle does, but for what it tells of one that stands; `beam_m` is the beam's length but for where the ground is. Until it tells
    /// another.
    fn repeats(&mut self, now: AutopilotTime, distance_m: f64, beam_m: f64) -> bool {
        let same = self.same.filter(|same| same.distance_m == distance_m).map_or(
            SameDistance { since: now, distance_m, expected_m: [beam_m; 2] },
            |same| SameDistance {
                expected_m: [same.expected_m[0].min(beam_m), same.expected_m[1].max(beam_m)],
                ..same
            },
        );
        self.same = Some(same);
        let least_m = self.least_m.map_or(distance_m, |least| least.min(distance_m));
        self.least_m = Some(least_m);
        distance_m > STANDS * least_m && same.is_stuck(now)
    }

    /// Whether the ground may be this much higher than it was.
    fn is_plausible(&mut self, now: AutopilotTime, rise_m: f64, height_m: f64, above_m: f64) -> bool {
        if rise_m.abs() < GROUND_STEP_M.max(GROUND_STEP_FRACTION * above_m) {
            return true;
        }
        let ratio = if above_m > GROUND_STEP_M { ((above_m - rise_m) / above_m).max(0.0) } else { 0.0 };
        let goes_on = |d: &Dispute| (rise_m - d.rise_m).abs() < 0.5 * GROUND_STEP_M;
        let dispute = match self.dispute.filter(goes_on) {
            Some(d) => Dispute {
                last: now,
                heights_m: [d.heights_m[0].min(height_m), d.heights_m[1].max(height_m)],
                ratio,
                ..d
            },
            None => {
                Dispute { since: now, last: now, rise_m, heights_m: [height_m; 2], ratio, believed: false }
            }
        };
        let moved_m = dispute.heights_m[1] - dispute.heights_m[0];
        let believed = now.seconds_since(dispute.since) > GROUND_BELIEVED_S && moved_m > GROUND_TELLS_M;
        self.dispute = Some(Dispute { believed, ..dispute });
        believed
    }

    /// The ground is where it is measured, as fast as terrain passes below: echoes of something else do not carry it along with the vehicle.
    fn follow_ground(&mut self, now: AutopilotTime, ground_m: f64, context: &Context<'_>) {
        let speed = context.core.estimator.estimate().map_or(0.0, |(_, v)| v.xy().norm());
        let dt = self.followed.replace(now).map_or(0.0, |t| now.seconds_since(t)).clamp(0.0, FOLLOW_STEP_S);
        let most = (GROUND_RATE_MPS + GROUND_SLOPE * speed) * dt;
        self.ground_m = Some(self.ground_m.map_or(ground_m, |g| g + (ground_m - g).clamp(-most, most)));
    }

    /// While it is disputed where the ground is, or the distance does not follow the height: the distance that is measured over the one
    /// that it should be.
    pub(super) fn disputed_ratio(&self, now: AutopilotTime, height_m: Option<f64>) -> Option<f64> {
        if let Some(dispute) = self.dispute.filter(|d| now.seconds_since(d.last) < DISPUTE_S) {
            return Some(dispute.ratio);
        }
        let (measured, distance_m) = self.newest.filter(|_| self.following.is_astray())?;
        let above_m = height_m? - self.ground_m?;
        let fresh = now.seconds_since(measured) < DISPUTE_S && above_m > GROUND_STEP_M;
        fresh.then_some(distance_m / above_m)
    }

    /// The distance as a height. Rangefinders filter: their samples are not independent at a high rate.
    fn height(&mut self, s: &RangeSample, above_m: f64, context: &Context<'_>) -> Option<HeightReading> {
        let now = context.now()?;
        let due = self.taken.is_none_or(|t| s.time.seconds_since(t).abs() >= HEIGHT_PERIOD_S);
        let near = above_m < context.core.settings.height.range_below_m || is_only_height(context);
        if !due || !near || context.core.mode == Mode::Aligning {
            return None;
        }
        self.taken = Some(s.time);
        Some(HeightReading {
            channel: Channel::Range,
            height_m: above_m,
            sigma_m: Some(RELATIVE_SIGMA * above_m),
            age_s: now.seconds_since(s.time),
        })
    }

    /// What is known against it.
    pub(super) fn health(&self) -> SourceHealth {
        match (self.following.is_astray(), self.dispute.is_some()) {
            (true, _) => SourceHealth::Faulty,
            (false, true) => SourceHealth::Suspect,
            (false, false) => SourceHealth::Healthy,
        }
    }

    pub(super) fn reset(&mut self, reset: &Reset) {
        match reset {
            Reset::OriginMoved(moved) => self.ground_m = self.ground_m.map(|g| g + moved.z),
            Reset::StreamBroken => self.newest = None,
            Reset::Reboot | Reset::ClockSetBack => *self = Self::default(),
            Reset::Relocated | Reset::Bridged => {}
        }
    }
}

/// Whether no other height has been heard for a while: then the ground is one at any distance, with the doubt that terrain leaves.
fn is_only_height(context: &Context<'_>) -> bool {
    let silent = |c: Channel| context.core.height.standing(c).is_none_or(|(_, quiet_s)| quiet_s > ONLY_S);
    [Channel::Baro, Channel::SecondBaro, Channel::Gnss].into_iter().all(silent)
}
