//! Whether the IMU is navigated on.
//!
//! One with a stuck axis is, as soon as that moves again. One that was contradicted is tried again after a while, with GNSS to judge it by: it is believed
//! when it agrees for long enough, through a motion that would have shown what was wrong, and else the next trial comes twice as late.

use crate::navigator::tuning::inertia_witness::{FIRST_TRIAL_S, LAST_TRIAL_S, TRIAL_MOTION, TRIAL_S};
use crate::time::AutopilotTime;

/// What is done with the IMU.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum ImuStanding {
    #[default]
    Believed,
    /// It is not navigated on while an axis is stuck.
    Stuck,
    /// It was contradicted, then.
    Contradicted(AutopilotTime),
    /// It is navigated on to see whether it still is.
    OnTrial(AutopilotTime),
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct InertiaTrust {
    standing: ImuStanding,
    /// Trials that have failed in a row.
    failed: u32,
    /// Squares of the changes of velocity that the trial has seen, (m/s)².
    motion: f64,
}

impl InertiaTrust {
    /// It is not navigated on.
    pub(in super::super) fn is_out(&self) -> bool {
        matches!(self.standing, ImuStanding::Stuck | ImuStanding::Contradicted(_))
    }

    /// It is not, or nobody knows yet whether it may be.
    pub(in super::super) fn is_doubted(&self) -> bool {
        self.standing != ImuStanding::Believed
    }

    fn on_trial(&self) -> bool {
        matches!(self.standing, ImuStanding::OnTrial(_))
    }

    /// An axis is stuck. True when that is new.
    pub(in super::super) fn sticks(&mut self) -> bool {
        let new = self.standing != ImuStanding::Stuck;
        self.standing = ImuStanding::Stuck;
        new
    }

    /// No axis is stuck. True when it is navigated on again for that.
    pub(in super::super) fn moves(&mut self) -> bool {
        let again = self.standing == ImuStanding::Stuck;
        if again {
            self.standing = ImuStanding::Believed;
        }
        again
    }

    /// It was contradicted.
    pub(in super::super) fn contradict(&mut self, now: AutopilotTime) {
        self.failed = if self.on_trial() { self.failed.saturating_add(1) } else { 0 };
        self.standing = ImuStanding::Contradicted(now);
    }

    /// Somebody can judge it. True when a trial begins.
    pub(in super::super) fn tries(&mut self, now: AutopilotTime, judged: bool) -> bool {
        let ImuStanding::Contradicted(since) = self.standing else { return false };
        let wait_s = (FIRST_TRIAL_S * f64::from(self.failed.min(10)).exp2()).min(LAST_TRIAL_S);
        let begins = judged && now.seconds_since(since) > wait_s;
        if begins {
            self.standing = ImuStanding::OnTrial(now);
            self.motion = 0.0;
        }
        begins
    }

    /// On trial it agreed, over a window in which the velocity changed by `change`, m/s. True when the trial is passed by that.
    pub(in super::super) fn agrees(&mut self, now: AutopilotTime, change: f64) -> bool {
        let ImuStanding::OnTrial(since) = self.standing else { return false };
        self.motion += change * change;
        let passed = now.seconds_since(since) > TRIAL_S && self.motion > TRIAL_MOTION;
        if passed {
            *self = Self::default();
        }
        passed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(s: f64) -> AutopilotTime {
        AutopilotTime::from_micros((s * 1e6) as i64)
    }

    #[test]
    fn who_fails_is_tried_later_and_who_passes_is_believed() {
        let mut trust = InertiaTrust::default();
        trust.contradict(at(0.0));
        assert!(trust.is_out() && !trust.tries(at(9.0), true) && !trust.tries(at(20.0), false));
        assert!(trust.tries(at(20.0), true) && !trust.is_out() && trust.is_doubted());
        trust.contradict(at(25.0));
        assert!(!trust.tries(at(40.0), true) && trust.tries(at(46.0), true));
        assert!((47..90).all(|t| !trust.agrees(at(f64::from(t)), 0.1)), "nothing has moved");
        assert!((90..100).any(|t| trust.agrees(at(f64::from(t)), 2.0)) && !trust.is_doubted());
    }

    #[test]
    fn a_stuck_axis_that_moves_needs_no_trial() {
        let mut trust = InertiaTrust::default();
        assert!(trust.sticks() && !trust.sticks() && trust.is_out());
        assert!(trust.moves() && !trust.is_doubted() && !trust.moves());
    }
}
