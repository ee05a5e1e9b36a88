//! Whether a receiver has begun to lie, with position and velocity together: by all that the filter has been told since.
//!
//! A velocity that is wrong by f since θ, and positions that walk off with it, show in the receiver's innovations; and, as the filter follows, in everybody
//! else's ([`crate::filter::error_state::JumpWindow`]). Whatever may have changed instead (an axis of the IMU, the flow, wind, compass) has to explain the same innovations: where the receiver's
//! lie explains far more than is usual ([`UsualSpread`]), and clearly more than any of those, for a while, it is a lie. Flow, drag, airspeed, magnetometer and inertia
//! testify together, and the filter is what it would be had it known. What is only more likely than not is a doubt: how far it has led since is in sigma.

use nalgebra::Vector2;

use crate::filter::error_state::{JUMPS, JumpWindow, RECEIVER_JUMPS};
use crate::time::{AutopilotTime, Span};

use super::usual::UsualSpread;
use crate::navigator::tuning::receiver_lie::{
    CLEAR_OF, DECADES, FIRM, LASTS_S, LEARN_S, LEARNED, LEAST_MPS, LOOK_S, MEMORY, SAME_S, SPREAD, STILL,
    UNLIKELY, YOUNGEST_S,
};

/// A lie that a window shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct ShownLie {
    pub(in super::super) window: usize,
    /// For how long it has gone on, s.
    pub(in super::super) age_s: f64,
    /// What the velocity is wrong by, NE, m/s.
    pub(in super::super) step: Vector2<f64>,
    /// What it explains, and the most that anything else does, as squares of sigmas.
    square: f64,
    rival: f64,
    /// Odds that it is one, ln: what it explains, in what is usual, against how unlikely it was before anything was seen.
    pub(in super::super) odds: f64,
}

impl ShownLie {
    fn by(number: usize, window: &JumpWindow) -> Self {
        let others = (0..JUMPS).filter(|jump| !RECEIVER_JUMPS.contains(jump));
        let squares = others.filter_map(|jump| window.fit(jump)).map(|fit| fit.square);
        Self {
            window: number,
            age_s: window.age_s(),
            step: window.receiver_step(),
            square: window.explained_by_receiver(),
            rival: squares.fold(0.0, f64::max),
            odds: 0.0,
        }
    }
}

/// What the innovations say of the receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) enum ReceiverFinding {
    /// More likely than not it lies.
    Suspected(ShownLie),
    /// It does.
    Lies(ShownLie),
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct ReceiverLies {
    usual: UsualSpread,
    learned: u32,
    learn_due: Option<AutopilotTime>,
    look_due: Option<AutopilotTime>,
    /// Since when one has been likely, and beyond doubt.
    likely: Option<AutopilotTime>,
    beyond: Option<AutopilotTime>,
    /// The most that what is suspected has explained.
    suspected: Option<f64>,
}

impl Default for ReceiverLies {
    fn default() -> Self {
        let usual = UsualSpread::expecting(SPREAD, FIRM);
        Self {
            usual,
            learned: 0,
            learn_due: None,
            look_due: None,
            likely: None,
            beyond: None,
            suspected: None,
        }
    }
}

impl ReceiverLies {
    /// Looks at the windows of a filter that follows the receiver in flight, and whose velocity something else than inertia tells as well: against inertia alone nothing is
    /// likely enough.
    pub(in super::super) fn judge(
        &mut self,
        now: AutopilotTime,
        windows: &[JumpWindow],
    ) -> Option<ReceiverFinding> {
        if self.look_due.is_some_and(|due| now < due) {
            return None;
        }
        self.look_due = Some(now + Span::from_seconds(LOOK_S));
        let old = windows.iter().enumerate().filter(|(_, w)| w.age_s() > YOUNGEST_S);
        let shown = old.map(|(number, window)| ShownLie::by(number, window));
        let shown = shown.max_by(|a, b| a.square.total_cmp(&b.square))?;
        let unit = self.usual.variance().max(1.0);
        let shown = ShownLie { odds: shown.square / (2.0 * unit) - UNLIKELY, ..shown };
        let likely = self.learned >= LEARNED
            && shown.odds > 0.0
            && shown.square - shown.rival > CLEAR_OF * unit
            && shown.step.norm() > LEAST_MPS;
        let beyond = likely && shown.square > self.usual.limit(DECADES);
        self.likely = if likely { self.likely.or(Some(now)) } else { None };
        self.beyond = if beyond { self.beyond.or(Some(now)) } else { None };
        if !likely {
            self.learn(now, shown.square);
        }
        let lasts = |since: Option<AutopilotTime>| since.is_some_and(|t| now.seconds_since(t) >= LASTS_S);
        if lasts(self.beyond) {
            self.rest();
            return Some(ReceiverFinding::Lies(shown));
        }
        if !lasts(self.likely) {
            return None;
        }
        self.suspected = Some(self.suspected.map_or(shown.square, |square| square.max(shown.square)));
        Some(ReceiverFinding::Suspected(shown))
    }

    /// Whether one that was suspected to have begun at `since` does not show any more in windows that reach back to then.
    pub(in super::super) fn has_vanished(
        &self,
        now: AutopilotTime,
        since: AutopilotTime,
        windows: &[JumpWindow],
    ) -> bool {
        let age_s = now.seconds_since(since);
        let whole = windows.iter().filter(|w| w.age_s() > age_s - SAME_S);
        let best = whole.map(|window| ShownLie::by(0, window)).max_by(|a, b| a.square.total_cmp(&b.square));
        best.is_some_and(|shown| {
            let unit = self.usual.variance().max(1.0);
            shown.square < STILL * 2.0 * UNLIKELY * unit || shown.square < shown.rival
        })
    }

    /// What was suspected has ended, and was no lie: what looked like one is usual for this vehicle.
    pub(in super::super) fn came_to_nothing(&mut self) {
        if let Some(square) = self.suspected.take() {
            self.usual.learn(square.min(self.usual.limit(DECADES)), MEMORY);
        }
    }

    /// What is beyond its limit again and again is usual, too, but no more than the limit at once.
    fn learn(&mut self, now: AutopilotTime, square: f64) {
        if self.learn_due.is_none_or(|due| now >= due) {
            self.learn_due = Some(now + Span::from_seconds(LEARN_S));
            self.learned = self.learned.saturating_add(1);
            self.usual.learn(square.min(self.usual.limit(DECADES)), MEMORY);
        }
    }

    /// The filter does not follow the receiver, which may have been charged: what was suspected of it is not known to be none.
    pub(in super::super) fn rest(&mut self) {
        (self.likely, self.beyond, self.suspected) = (None, None, None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_suspicion_that_came_to_nothing_is_usual_from_then_on_and_a_lie_is_not() {
        let (square, mut lies) = (60.0, ReceiverLies::default());
        let odds = |lies: &ReceiverLies| square / (2.0 * lies.usual.variance().max(1.0)) - UNLIKELY;
        let first = odds(&lies);
        lies.suspected = Some(square);
        lies.rest();
        lies.came_to_nothing();
        assert_eq!((odds(&lies), lies.suspected), (first, None));
        for _ in 0..6 {
            lies.suspected = Some(square);
            lies.came_to_nothing();
            // Told once.
            lies.came_to_nothing();
        }
        assert!(first > 5.0 && odds(&lies) < 0.0, "{first} {}", odds(&lies));
    }
}
