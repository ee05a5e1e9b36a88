//! Whether nothing but inertia carries, and so nobody should follow it.
//!
//! Inertia alone is good for seconds. An autopilot that is told nothing lands at once where GNSS is lost (PX4: 1.2-1.7 m from there); one that is
//! led on by a position that only inertia carries drifts tens of metres in the time that its failsafe waits. So an outage in which nothing else
//! has carried from the beginning is not sent at all, and a gap in what carries (flow over water) only while the velocity's standard
//! deviation is small.

use crate::navigator::solution::{Mode, Solution, VelocitySource};
use crate::time::AutopilotTime;

use super::settings::Coasting;

/// What carries may take this long to be known, s.
const PATIENCE_S: f64 = 0.5;
/// Over a gap inertia alone is followed while the velocity, horizontal, is known to this, m/s.
const BRIEF_SIGMA_MPS: f64 = 0.5;

/// What has carried in this outage.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CoastWatch {
    since: Option<AutopilotTime>,
    /// Something else than inertia has.
    carried: bool,
}

impl CoastWatch {
    /// Whether the solution is inertia's alone, and not to be sent for that.
    pub(super) fn coasts(&mut self, s: &Solution, allowed: Coasting) -> bool {
        if s.mode != Mode::Holdover {
            *self = Self::default();
            return false;
        }
        let since = *self.since.get_or_insert(s.time);
        if s.velocity_source != VelocitySource::Inertial {
            self.carried = true;
            return false;
        }
        let v = s.velocity_covariance.raw();
        let sigma_mps = (v[(0, 0)] + v[(1, 1)]).max(0.0).sqrt();
        let never_carried = !self.carried && s.time.seconds_since(since) > PATIENCE_S;
        match allowed {
            Coasting::Always => false,
            Coasting::Never => s.time.seconds_since(since) > PATIENCE_S,
            Coasting::Briefly => never_carried || sigma_mps > BRIEF_SIGMA_MPS || sigma_mps.is_nan(),
        }
    }
}
