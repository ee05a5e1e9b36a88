//! How far two receivers are apart, and whether that is further than is usual for them.

use super::super::monitor::usual::UsualSpread;
use crate::navigator::tuning::gnss::{
    AGREE_DECADES, AGREE_EVERY_S, AGREE_FIRM, AGREE_FOR_S, AGREE_M, AGREE_MEMORY, AGREE_SIGMA,
};
use crate::time::{AutopilotTime, Span};

/// See the module's documentation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Agreement {
    /// How far the two are apart as a rule, and when that is looked at again.
    usual: UsualSpread,
    due: Option<AutopilotTime>,
    /// How far, while that is too far, m.
    apart_m: f64,
    since: Option<AutopilotTime>,
}

impl Agreement {
    pub(super) fn new() -> Self {
        let usual = UsualSpread::expecting(AGREE_M * AGREE_M, AGREE_FIRM);
        Self { usual, due: None, apart_m: 0.0, since: None }
    }

    /// How far they are apart while that is too far, m.
    pub(super) fn apart_m(&self) -> f64 {
        self.apart_m
    }

    /// One of the two is another receiver from now on.
    pub(super) fn end(&mut self) {
        (self.apart_m, self.since) = (0.0, None);
    }

    /// They are `apart_m` m apart, and together claim `claimed_m`. Whether they disagree; `None` where they have done so for too short a while.
    pub(super) fn compare(&mut self, now: AutopilotTime, apart_m: f64, claimed_m: f64) -> Option<bool> {
        let limit = self.usual.limit(AGREE_DECADES).sqrt().max(AGREE_SIGMA * claimed_m);
        let disagree = apart_m > limit * if self.apart_m > 0.0 { 0.5 } else { 1.0 };
        self.apart_m = if disagree { apart_m } else { 0.0 };
        self.since = disagree.then(|| self.since.unwrap_or(now));
        if self.since.is_some_and(|t| now.seconds_since(t) < AGREE_FOR_S) {
            return None;
        }
        if !disagree && self.due.is_none_or(|due| now >= due) {
            self.usual.learn(apart_m * apart_m, AGREE_MEMORY);
            self.due = Some(now + Span::from_seconds(AGREE_EVERY_S));
        }
        Some(disagree)
    }
}
