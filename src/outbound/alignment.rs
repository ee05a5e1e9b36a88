//! Where our frame lies in the autopilot's.
//!
//! Both are NED at the same origin once GPS_GLOBAL_ORIGIN is known, and still differ by what the two filters make of the same
//! sensors (a metre, or more in height, where the autopilot follows the barometer). An autopilot that switches over to our position
//! would jump by that. So while GNSS is good and the autopilot does not live on our output, the difference is averaged; in
//! holdover it stands.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::geo::Ned;
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
            self.origin_shared |= kept.origin_shared;
        }
    }

    /// What to add to our position to have it in the autopilot's frame, m.
    pub fn offset(&self) -> Ned<Vector3<f64>> {
        self.offset
    }

    /// Whether the frames are known to agree: by a shared origin, or by comparing positions.
    pub fn aligned(&self) -> bool {
        self.origin_shared || self.learned()
    }

    /// Whether enough positions were compared for the offset to stand on them.
    pub(super) fn learned(&self) -> bool {
        self.observations >= ENOUGH
    }

    pub(super) fn origin_shared(&mut self) {
        self.origin_shared = true;
    }

    pub(super) fn observe(&mut self, time: AutopilotTime, autopilot: Ned<Vector3<f64>>, solution: &Solution) {
        let age = solution.time.seconds_since(time);
        if age.abs() > MAX_AGE_S || self.last.is_some_and(|t| time <= t) {
            return;
        }
        let ours = solution.position - solution.velocity * age;
        let difference = autopilot - ours;
        if self.learned() && (difference - self.offset).raw().norm() > OUTLIER_M {
            // One wild position is no new frame; many in a row are: the autopilot has reset its own.
            self.outliers += 1;
            if self.outliers < OUTLIERS_BELIEVED {
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
    }
}
