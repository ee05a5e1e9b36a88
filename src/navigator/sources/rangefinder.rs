//! A rangefinder: the distance to the ground, where the ground is, and near it a height.
//!
//! What a distance should be is asked of every height there is: the altimeter's, which may be led astray by one source, and what each source
//! tells itself, however it wanders. A distance that follows any of them is one of the ground, for an echo or a sensor that is stuck follows none.

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
    ONLY_S, RELATIVE_SIGMA, STANDS, STUCK_DRIFT_MPS, STUCK_M, STUCK_S, WITNESS_S, WITNESSED,
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
    /// Least and greatest length of the beam meanwhile, by every height that was there all the time, m.
    expected_m: [Option<[f64; 2]>; HEIGHTS],
}

impl SameDistance {
    fn new(now: AutopilotTime, distance_m: f64, beams_m: &Heights) -> Self {
        Self { since: now, distance_m, expected_m: beams_m.map(|beam| beam.map(|m| [m; 2])) }
    }

    /// Told once more.
    fn again(self, beams_m: &Heights) -> Self {
        let both = |i: usize| {
            let (seen, m) = (self.expected_m[i]?, beams_m[i]?);
            Some([seen[0].min(m), seen[1].max(m)])
        };
        Self { expected_m: std::array::from_fn(both), ..self }
    }

    /// Whether the beam has become longer or shorter by more than any resolution hides, and than heights drift of a vehicle that stands, by whichever height that is asked.
    fn is_stuck(&self, now: AutopilotTime) -> bool {
        let changed_m = least(self.expected_m.map(|seen| seen.map(|m| m[1] - m[0])));
        let lasts_s = now.seconds_since(self.since);
        let hidden_m = STUCK_M.max(RELATIVE_SIGMA * self.distance_m) + STUCK_DRIFT_MPS * lasts_s;
        lasts_s > STUCK_S && changed_m > hidden_m
    }
}

/// The altimeter's height, and those of the sources that are heard, m: each with an offset of its own.
type Heights = [Option<f64>; HEIGHTS];
const HEIGHTS: usize = 4;
const WITNESSES: [Channel; HEIGHTS - 1] = [Channel::Baro, Channel::SecondBaro, Channel::Gnss];

/// The least of what there is.
fn least(of: Heights) -> f64 {
    of.into_iter().flatten().fold(f64::INFINITY, f64::min)
}

fn heights(now: AutopilotTime, height_m: f64, context: &Context<'_>) -> Heights {
    let told = |channel| {
        let (t, m) = context.core.height.reading(channel)?;
        (now.seconds_since(t).abs() < WITNESS_S).then_some(m)
    };
    let [a, b, c] = WITNESSES.map(told);
    [Some(height_m), a, b, c]
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RangefinderSource {
    same: Option<SameDistance>,
    /// The least that it has told, m: what it tells of a vehicle that stands.
    least_m: Option<f64>,
    newest: Option<(AutopilotTime, f64)>,
    /// The newest height over ground that it told, m, whatever became of it.
    told: Option<(AutopilotTime, f64)>,
    /// Height of the ground above the origin, where it was last seen beyond dispute, m, and above what each source counts from.
    grounds_m: Heights,
    dispute: Option<Dispute>,
    /// Whether it follows each of the heights.
    following: [Following; HEIGHTS],
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
        Self { grounds_m: [Some(ground_m), None, None, None], ..Self::default() }
    }

    /// Height of the ground above the origin, m.
    pub(super) fn ground_m(&self) -> Option<f64> {
        self.grounds_m[0]
    }

    /// The newest height over ground that it told, m, whatever became of it.
    pub(super) fn told(&self) -> Option<(AutopilotTime, f64)> {
        self.told
    }

    /// Whether it was seen to follow no height: neither the altimeter's nor what any source tells.
    fn is_astray(&self) -> bool {
        let [altimeter, sources @ ..] = &self.following;
        altimeter.is_astray() && !sources.iter().any(|source| source.excuses(altimeter))
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
        let (heights, above) = (heights(s.time, height, context), s.distance_m * cosine);
        if self.repeats(s.time, s.distance_m, &heights.map(|m| m.map(|m| m / cosine))) {
            return Err(Reason::Stuck);
        }
        self.told = Some((s.time, above));
        // In a bank an error of the attitude is one of the distance.
        if cosine > LEVEL_COSINE {
            for (following, m) in self.following.iter_mut().zip(heights) {
                if let Some(m) = m {
                    following.note(s.time, above, m);
                }
            }
        }
        if self.is_elsewhere(s.time, &heights, height, above) {
            return Err(Reason::Innovation);
        }
        if self.dispute.take().is_some_and(|d| d.believed) {
            self.grounds_m = Heights::default();
        }
        self.newest = Some((s.time, s.distance_m));
        // What the altimeter has convicted does not say where the ground is.
        let doubted = self.is_astray() || context.core.height.health(Channel::Range).is_faulty();
        if self.ground_m().is_none() || !doubted {
            self.follow_ground(s.time, &heights.map(|m| m.map(|m| m - above)), context);
        }
        // An altimeter that hears nobody else is no witness: it may have been led astray itself, and then the distance is all there is.
        let [_, sources @ ..] = &heights;
        let witnessed = sources.iter().any(Option::is_some);
        Ok(self.height(s, above, context).filter(|_| !(witnessed && self.is_astray())))
    }

    /// Whether the ground is where it cannot be, `above` m below the heights.
    fn is_elsewhere(&mut self, now: AutopilotTime, heights: &Heights, height_m: f64, above: f64) -> bool {
        let Some(known) = self.ground_m() else { return false };
        let rise = |i: usize| Some(heights[i]? - above - self.grounds_m[i]?);
        let rises = std::array::from_fn(rise);
        !self.is_plausible(now, &rises, height_m, height_m - known)
    }

    /// Whether it tells the same distance, whatever the vehicle does, but for what it tells of one that stands; `beams_m` is the beam's length but for where the ground is, by every
    /// height. Until it tells another.
    fn repeats(&mut self, now: AutopilotTime, distance_m: f64, beams_m: &Heights) -> bool {
        let same = self.same.filter(|same| same.distance_m == distance_m);
        let same =
            same.map_or_else(|| SameDistance::new(now, distance_m, beams_m), |same| same.again(beams_m));
        self.same = Some(same);
        let least_m = self.least_m.map_or(distance_m, |least| least.min(distance_m));
        self.least_m = Some(least_m);
        distance_m > STANDS * least_m && same.is_stuck(now)
    }

    /// Whether the ground may be this much higher than it was, by the altimeter and by what each source tells.
    fn is_plausible(&mut self, now: AutopilotTime, rises_m: &Heights, height_m: f64, above_m: f64) -> bool {
        let rise_m = rises_m[0].unwrap_or(f64::INFINITY);
        let most_m = GROUND_STEP_M.max(GROUND_STEP_FRACTION * above_m);
        // What a source tells is noisier, and there are more of them: they have to agree the better.
        if rise_m.abs() < most_m || least(rises_m.map(|rise| rise.map(f64::abs))) < WITNESSED * most_m {
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
    fn follow_ground(&mut self, now: AutopilotTime, seen_m: &Heights, context: &Context<'_>) {
        let speed = context.core.estimator.estimate().map_or(0.0, |(_, v)| v.xy().norm());
        let dt = self.followed.replace(now).map_or(0.0, |t| now.seconds_since(t)).clamp(0.0, FOLLOW_STEP_S);
        let most = (GROUND_RATE_MPS + GROUND_SLOPE * speed) * dt;
        for (ground_m, seen_m) in self.grounds_m.iter_mut().zip(seen_m) {
            // One that was not heard for a while begins anew.
            *ground_m = seen_m.map(|seen| ground_m.map_or(seen, |g| g + (seen - g).clamp(-most, most)));
        }
    }

    /// While it is disputed where the ground is, or the distance does not follow the height: the distance that is measured over the one
    /// that it should be.
    pub(super) fn disputed_ratio(&self, now: AutopilotTime, height_m: Option<f64>) -> Option<f64> {
        if let Some(dispute) = self.dispute.filter(|d| now.seconds_since(d.last) < DISPUTE_S) {
            return Some(dispute.ratio);
        }
        let (measured, distance_m) = self.newest.filter(|_| self.is_astray())?;
        let above_m = height_m? - self.ground_m()?;
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
        match (self.is_astray(), self.dispute.is_some()) {
            (true, _) => SourceHealth::Faulty,
            (false, true) => SourceHealth::Suspect,
            (false, false) => SourceHealth::Healthy,
        }
    }

    pub(super) fn reset(&mut self, reset: &Reset) {
        match reset {
            Reset::OriginMoved(moved) => {
                let of_gnss = HEIGHTS - 1;
                for i in [0, of_gnss] {
                    self.grounds_m[i] = self.grounds_m[i].map(|g| g + moved.z);
                }
            }
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A distance that is told ten times a second for `for_s`, while the beam becomes longer by these rates, m/s, by each height.
    fn stuck(for_s: f64, rates: [Option<f64>; HEIGHTS]) -> bool {
        let beams = |t: f64| rates.map(|rate| rate.map(|rate| 10.0 + rate * t));
        let at = |t: f64| AutopilotTime::from_micros((t * 1e6) as i64);
        let steps = (10.0 * for_s) as u32;
        let first = SameDistance::new(at(0.0), 9.9, &beams(0.0));
        let told = (1..=steps).fold(first, |same, k| same.again(&beams(0.1 * f64::from(k))));
        told.is_stuck(at(for_s))
    }

    #[test]
    fn one_is_stuck_while_the_vehicle_moves_by_every_height_and_not_while_one_of_them_does() {
        assert!(stuck(2.0, [Some(0.5), Some(0.45), None, Some(0.6)]));
        assert!(stuck(2.0, [Some(0.5), None, None, None]));
        // The altimeter's height is led astray, or a barometer is washed: who hovers moves by neither.
        assert!(!stuck(2.0, [Some(1.5), Some(2.0), None, Some(0.05)]));
        assert!(!stuck(2.0, [Some(1.5), Some(0.02), None, Some(1.5)]));
        // Over a minute every height drifts by a metre, and the vehicle stands; one that moves by more does not.
        assert!(!stuck(60.0, [Some(0.02), Some(-0.025), None, Some(0.05)]));
        assert!(stuck(60.0, [Some(0.04), Some(-0.04), None, Some(0.05)]));
        assert!(!stuck(0.9, [Some(2.0), Some(2.0), None, None]));
    }

    /// A source at 5 m over ground that is known to every height, and whether it believes what it would see if the heights had moved by these, m.
    fn plausible(rises: Heights) -> bool {
        RangefinderSource::default().is_plausible(AutopilotTime::from_micros(0), &rises, 5.0, 5.0)
    }

    #[test]
    fn a_distance_that_follows_a_source_is_one_while_the_altimeter_is_led_astray() {
        assert!(!plausible([Some(3.0), None, None, None]));
        assert!(plausible([Some(3.0), Some(0.3), None, Some(3.2)]));
        assert!(!plausible([Some(3.0), Some(0.8), None, Some(3.2)]));
        assert!(plausible([Some(0.8), Some(3.0), None, None]));
    }
}
