//! The rangefinder: the distance to the ground, where the ground is, and near it a height.

use crate::altimeter::Channel;
use crate::sample::{RangeDirection, RangeSample};
use crate::time::AutopilotTime;

use super::super::context::Context;
use super::super::height::HeightReading;
use super::super::reset::Reset;
use super::super::solution::Mode;
use super::super::verdict::Reason;
use super::LATE_S;
use super::status::SourceHealth;

/// Steepest tilt at which a range beam still measures the height over ground: cos 60°.
const MIN_COSINE: f64 = 0.5;
/// The ground may step by this much, m, or this part of the height over it, from one sample to the next …
const GROUND_STEP_M: f64 = 1.5;
const GROUND_STEP_FRACTION: f64 = 0.2;
/// … and by more when it stays there for this long, s.
const GROUND_BELIEVED_S: f64 = 5.0;
/// Distances are heights this often, s, and known to this part of themselves.
const HEIGHT_PERIOD_S: f64 = 0.1;
const RELATIVE_SIGMA: f64 = 0.03;
/// At their limits sensors report the limit: this near to the least and the greatest they are not believed.
const NEAR_LEAST: f64 = 1.05;
const NEAR_GREATEST: f64 = 0.98;

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct RangefinderSource {
    newest: Option<(AutopilotTime, f64)>,
    /// Height of the ground above the origin, where it was last seen, m.
    ground_m: Option<f64>,
    /// Since when the ground has been seen elsewhere, and by how much, m.
    disputed_since: Option<(AutopilotTime, f64)>,
    /// The newest distance that was taken for a height.
    taken: Option<AutopilotTime>,
}

impl RangefinderSource {
    /// The newest distance along body z, m.
    pub(super) fn newest(&self) -> Option<(AutopilotTime, f64)> {
        self.newest
    }

    /// Height of the ground above the origin, m.
    pub(super) fn ground_m(&self) -> Option<f64> {
        self.ground_m
    }

    /// Takes a distance. A height when one is due: near the ground, where the ground is one.
    pub(in super::super) fn observe(
        &mut self,
        s: &RangeSample,
        context: &Context<'_>,
    ) -> Result<Option<HeightReading>, Reason> {
        if s.direction != RangeDirection::Down {
            return Err(Reason::NotUsed);
        }
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
        let cosine = context.core.attitude.r_body_to_ned[(2, 2)];
        let height = context.core.height.height_m().filter(|_| cosine > MIN_COSINE);
        let height = height.ok_or(Reason::NoReferenceYet)?;
        let ground = height - s.distance_m * cosine;
        if let Some(known) = self.ground_m
            && !self.is_plausible(s.time, ground - known, height - known)
        {
            return Err(Reason::Innovation);
        }
        self.disputed_since = None;
        self.newest = Some((s.time, s.distance_m));
        self.ground_m = Some(ground);
        Ok(self.height(s, s.distance_m * cosine, context))
    }

    /// Whether the ground may be this much higher than it was. A stuck rangefinder makes the ground climb with the vehicle; a
    /// roof or a cliff stays where it is, and is believed after a while.
    fn is_plausible(&mut self, now: AutopilotTime, rise_m: f64, above_m: f64) -> bool {
        if rise_m.abs() < GROUND_STEP_M.max(GROUND_STEP_FRACTION * above_m) {
            return true;
        }
        match self.disputed_since {
            Some((since, rise)) if (rise_m - rise).abs() < 0.5 * GROUND_STEP_M => {
                now.seconds_since(since) > GROUND_BELIEVED_S
            }
            _ => {
                self.disputed_since = Some((now, rise_m));
                false
            }
        }
    }

    /// The distance as a height. Rangefinders filter: their samples are not independent at a high rate.
    fn height(&mut self, s: &RangeSample, above_m: f64, context: &Context<'_>) -> Option<HeightReading> {
        let now = context.now()?;
        let due = self.taken.is_none_or(|t| s.time.seconds_since(t).abs() >= HEIGHT_PERIOD_S);
        if !due
            || above_m >= context.core.settings.height.range_below_m
            || context.core.mode == Mode::Aligning
        {
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
        if self.disputed_since.is_some() { SourceHealth::Suspect } else { SourceHealth::Healthy }
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
