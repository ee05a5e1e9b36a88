//! Where our frame lies in the autopilot's.
//!
//! Both are NED at the same origin once GPS_GLOBAL_ORIGIN is known, and still differ by what the two filters make of the same
//! sensors: a metre, or more in height, where the autopilot follows the barometer, and a degree or two of heading. An autopilot that switches over to our
//! position would jump by that; and one that turns our body's velocity by its own heading (PX4) would see it cross the track of our positions. So while GNSS
//! is good and the autopilot does not live on our output, the differences are averaged; in holdover they stand.
//!
//! Whether it lives on our output is told by what it stands on ([`super::handover::StandsOn`]). Where that may be wrong (a ground station can switch the source
//! set without a word to anybody else), the loop would be closed: what the autopilot lags behind would be taken for an offset, again and again. So to an
//! autopilot that is sent to, an offset follows within 5 m of where it was first learned, and no further.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::geo::so3::wrap_pi;
use crate::geo::{BodyToNed, Euler, Ned, so3};
use crate::navigator::solution::Solution;
use crate::time::AutopilotTime;

/// Averaging time, s.
const TIME_CONSTANT_S: f64 = 10.0;
/// Observations needed before the average alone is an alignment.
const ENOUGH: u32 = 20;
/// Autopilot positions older than this are not compared, s.
const MAX_AGE_S: f64 = 0.5;

/// A position this far from the offset is an outlier, m …
const OUTLIER_M: f64 = 8.0;
/// … unless this many come in a row.
const OUTLIERS_BELIEVED: u32 = 25;
/// To an autopilot that is sent to, the offset moves no further than this from where it was learned, m.
const FOLLOWED_M: f64 = 5.0;

/// Headings are not compared while the vehicle turns faster than this, rad/s: the stamps are not that good.
const TURNING_RADPS: f64 = 0.3;
/// Headings further apart than this contradict each other: neither is bent to the other, rad.
const CONTRADICTION_RAD: f64 = 0.26;

/// What was learned of the autopilot's frame, to be kept.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AlignmentMemory {
    /// What to add to our position, NED, m.
    pub offset: [f64; 3],
    /// Enough positions were compared.
    pub learned: bool,
    /// The autopilot has told its origin.
    pub origin_shared: bool,
}

/// No frame lies further off another, m.
const FARTHEST_M: f64 = 1e5;

/// Offset from our frame to the autopilot's.
#[derive(Clone, Debug)]
pub struct Alignment {
    offset: Ned<Vector3<f64>>,
    observations: u32,
    last: Option<AutopilotTime>,
    origin_shared: bool,
    outliers: u32,
    /// The offset as it was first learned, or last in a silence of ours.
    learned_at: Option<Ned<Vector3<f64>>>,
    heading: HeadingOffset,
}

/// The autopilot's heading less ours.
#[derive(Clone, Copy, Debug, Default)]
struct HeadingOffset {
    offset_rad: f64,
    observations: u32,
    last: Option<AutopilotTime>,
}

impl Alignment {
    /// Nothing known.
    pub(super) fn new() -> Self {
        Self {
            offset: Ned::new(Vector3::zeros()),
            observations: 0,
            last: None,
            origin_shared: false,
            outliers: 0,
            learned_at: None,
            heading: HeadingOffset::default(),
        }
    }

    /// What was learned, to be kept.
    pub fn memory(&self) -> AlignmentMemory {
        AlignmentMemory {
            offset: self.offset.raw().into(),
            learned: self.learned(),
            origin_shared: self.origin_shared,
        }
    }

    /// Goes on from what was kept, where that is an offset at all.
    pub(super) fn recall(&mut self, kept: &AlignmentMemory) {
        if kept.offset.iter().all(|o| o.abs() < FARTHEST_M) {
            self.offset = Ned::new(Vector3::from(kept.offset));
            self.observations = if kept.learned { ENOUGH } else { 0 };
            self.learned_at = kept.learned.then_some(self.offset);
            self.origin_shared |= kept.origin_shared;
        }
    }

    /// What to add to our position to have it in the autopilot's frame, m.
    pub fn offset(&self) -> Ned<Vector3<f64>> {
        self.offset
    }

    /// The autopilot's heading less ours, rad; 0 while it is not known, or where they contradict each other.
    pub fn heading_offset_rad(&self) -> f64 {
        let known = self.heading_learned() && self.heading.offset_rad.abs() < CONTRADICTION_RAD;
        if known { self.heading.offset_rad } else { 0.0 }
    }

    /// Our attitude with the autopilot's heading.
    pub(super) fn attitude(&self, ours: &BodyToNed) -> BodyToNed {
        match self.heading_offset_rad() {
            0.0 => *ours,
            turn => BodyToNed::from_matrix(&(so3::exp(&Vector3::new(0.0, 0.0, turn)) * ours.matrix())),
        }
    }

    /// Whether the frames are known to agree: by a shared origin, or by comparing positions.
    pub fn aligned(&self) -> bool {
        self.origin_shared || self.learned()
    }

    /// Whether enough positions were compared for the offset to stand on them.
    pub(super) fn learned(&self) -> bool {
        self.observations >= ENOUGH
    }

    /// The same of headings.
    pub(super) fn heading_learned(&self) -> bool {
        self.heading.observations >= ENOUGH
    }

    /// Our frame's origin is the autopilot's now, and has `moved` for that, if it did: what was learned holds in the new coordinates.
    pub(super) fn origin_shared(&mut self, moved: Option<Ned<Vector3<f64>>>) {
        self.origin_shared = true;
        if let Some(moved) = moved.filter(|_| self.observations > 0) {
            self.offset = self.offset + moved;
            self.learned_at = self.learned_at.map(|anchor| anchor + moved);
        }
    }

    /// The autopilot's position; `silent` where it was sent nothing that could be in it.
    pub(super) fn observe(
        &mut self,
        time: AutopilotTime,
        autopilot: Ned<Vector3<f64>>,
        solution: &Solution,
        silent: bool,
    ) {
        let age = solution.time.seconds_since(time);
        if age.abs() > MAX_AGE_S || self.last.is_some_and(|t| time <= t) {
            return;
        }
        let ours = solution.position - solution.velocity * age;
        let difference = autopilot - ours;
        if self.learned() && (difference - self.offset).raw().norm() > OUTLIER_M {
            // One wild position is no new frame; many in a row are: the autopilot has reset its own.
            self.outliers += 1;
            if self.outliers < OUTLIERS_BELIEVED || !silent {
                return;
            }
            self.observations = 0;
        }
        self.outliers = 0;
        let dt = self.last.map_or(0.2, |t| time.seconds_since(t).min(1.0));
        // The plain mean at first, a low pass later.
        let gain = (dt / TIME_CONSTANT_S).max(1.0 / f64::from(self.observations + 1));
        self.offset = self.offset + (difference - self.offset) * gain.min(1.0);
        self.observations = self.observations.saturating_add(1);
        self.last = Some(time);
        self.bound(silent);
    }

    /// See the module's documentation.
    fn bound(&mut self, silent: bool) {
        if silent || self.learned_at.is_none() {
            self.learned_at = self.learned().then_some(self.offset);
        } else if let Some(anchor) = self.learned_at {
            let moved = self.offset - anchor;
            let away = moved.raw().norm();
            if away > FOLLOWED_M {
                self.offset = anchor + moved * (FOLLOWED_M / away);
            }
        }
    }

    /// The autopilot's attitude.
    pub(super) fn observe_attitude(
        &mut self,
        time: AutopilotTime,
        autopilot: &BodyToNed,
        solution: &Solution,
    ) {
        let turning = solution.angular_rate.raw().norm() > TURNING_RADPS;
        let heading = &mut self.heading;
        if turning
            || solution.time.seconds_since(time).abs() > MAX_AGE_S
            || heading.last.is_some_and(|t| time <= t)
        {
            return;
        }
        let yaw = |attitude: &BodyToNed| Euler::from_rotation(attitude.matrix()).yaw_rad;
        let difference = wrap_pi(yaw(autopilot) - yaw(&solution.attitude));
        let dt = heading.last.map_or(0.2, |t| time.seconds_since(t).min(1.0));
        let gain = (dt / TIME_CONSTANT_S).max(1.0 / f64::from(heading.observations + 1)).min(1.0);
        heading.offset_rad = wrap_pi(heading.offset_rad + gain * wrap_pi(difference - heading.offset_rad));
        heading.observations = heading.observations.saturating_add(1);
        heading.last = Some(time);
    }
}
