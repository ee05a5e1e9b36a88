//! What may be a lie of a receiver's velocity: how likely it is, and how long that is feared.
//!
//! By itself inertia errs in manoeuvres that are sampled badly. A step stays one: what was seen young has to be seen when it is older, and as long as it can be. Other
//! witnesses weigh it with their own likelihoods: a doubt whose odds are o is a lie with the probability o / (1 + o), so that what it leads by has the mean square
//! o / (1 + o) |s t|².

use super::felt_velocity::VelocityLie;
use super::step_look::StepLook;
use super::usual::UsualPeak;
use crate::navigator::tuning::velocity_step::{DOUBT_S, OLDEST_S, REFUTED, VANISHED_S, WINDOW_S};
use crate::time::{AutopilotTime, Span};

/// What may be a velocity that is a lie, and until when it may lead away.
#[derive(Clone, Copy, Debug)]
pub(super) struct VelocityDoubt {
    pub(super) lie: VelocityLie,
    pub(super) until: AutopilotTime,
    pub(super) kind: DoubtKind,
    /// The odds that it is a lie where nobody else is heard, ln.
    pub(super) odds: f64,
    /// By how much other witnesses find it more likely that it is none, ln.
    pub(super) refuted: f64,
    /// What it explained, and when that was seen last, where it was seen by a look.
    pub(super) look: Option<(f64, AutopilotTime)>,
}

/// How a doubt came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DoubtKind {
    /// A step that is too young to tell it from a manoeuvre: it has to be seen again when it is older.
    Young,
    /// A step that is far from usual.
    Likely,
    /// One that is not, and that other witnesses find.
    Witnessed,
    /// The filter's innovations show it.
    Suspected,
    /// It was beyond doubt, and nobody has disproven it.
    Charged,
}

impl VelocityDoubt {
    pub(super) fn of(lie: VelocityLie, from: AutopilotTime, kind: DoubtKind) -> Self {
        let for_s = if kind == DoubtKind::Young { OLDEST_S } else { DOUBT_S };
        Self { lie, until: from + Span::from_seconds(for_s), kind, odds: 0.0, refuted: 0.0, look: None }
    }

    /// That it is a lie: of one that was charged odds do not count.
    pub(super) fn probability(&self) -> f64 {
        if self.kind == DoubtKind::Charged {
            return 1.0;
        }
        1.0 / (1.0 + (self.refuted - self.odds).exp())
    }

    /// A look shows it, with these odds, ln.
    pub(super) fn seen(look: &StepLook, odds: f64, now: AutopilotTime, kind: DoubtKind) -> Self {
        Self { look: Some((look.square, now)), odds, ..Self::of(look.begun, look.begun.since, kind) }
    }

    /// Another look shows it as well.
    pub(super) fn seen_again(&mut self, look: &StepLook, usual: &UsualPeak, now: AutopilotTime) {
        if let Some((square, _)) = self.look {
            self.look = Some((square.max(look.square), now));
            self.odds = self.odds.max(look.odds(usual));
        }
    }

    /// Whether others have seen that it is none.
    pub(super) fn is_refuted(&self) -> bool {
        self.probability() < REFUTED
    }

    /// What other witnesses make likely, with its odds by inertia alone, ln.
    pub(super) fn witnessed(lie: VelocityLie, odds: f64) -> Self {
        Self { odds, ..Self::of(lie, lie.since, DoubtKind::Witnessed) }
    }

    /// Whether what it was seen by does not show it any more, though it still could.
    pub(super) fn has_vanished(&self, now: AutopilotTime) -> bool {
        let age = now.seconds_since(self.lie.since);
        match (self.kind, self.look) {
            (DoubtKind::Young, _) => now >= self.until,
            (DoubtKind::Likely, Some((_, seen))) => {
                (OLDEST_S..WINDOW_S).contains(&age)
                    && OLDEST_S - seen.seconds_since(self.lie.since) > VANISHED_S
            }
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::step_fit::VelocityStep;
    use super::*;
    use nalgebra::Vector2;

    fn at(s: f64) -> AutopilotTime {
        AutopilotTime::from_micros((s * 1e6) as i64)
    }

    fn seen(kind: DoubtKind, until_s: f64) -> VelocityDoubt {
        let size = Vector2::new(1.0, 0.0);
        let step = VelocityStep { since: at(0.0), size, gain: 80.0, kink: 0.0, left: 100.0 };
        let look = StepLook::of(&step, 1.0, 100.0);
        VelocityDoubt { look: Some((80.0, at(until_s))), ..VelocityDoubt::seen(&look, 0.0, at(1.6), kind) }
    }

    #[test]
    fn a_step_stays_one_as_long_as_it_can_be_seen() {
        // A manoeuvre's, that an older look does not show.
        let young = seen(DoubtKind::Young, 1.0);
        assert!(!young.has_vanished(at(4.0)) && young.has_vanished(at(OLDEST_S)));
        let manoeuvre = seen(DoubtKind::Likely, 2.5);
        assert!(!manoeuvre.has_vanished(at(4.0)) && manoeuvre.has_vanished(at(OLDEST_S + 0.1)));
        let step = seen(DoubtKind::Likely, OLDEST_S - 0.2);
        assert!(!step.has_vanished(at(OLDEST_S + 0.1)) && !step.has_vanished(at(30.0)));
        // Who was charged, and whom the innovations suspect, is not judged by looks.
        let charged = VelocityDoubt::of(step.lie, at(20.0), DoubtKind::Charged);
        let suspected = VelocityDoubt::of(step.lie, at(20.0), DoubtKind::Suspected);
        assert!(!charged.has_vanished(at(30.0)) && !suspected.has_vanished(at(8.0)));
    }

    #[test]
    fn it_is_as_likely_as_witnesses_leave_it() {
        let mut doubt = seen(DoubtKind::Likely, OLDEST_S);
        let alone = doubt.probability();
        doubt.refuted = 4.6;
        let refuted = doubt.probability();
        doubt.refuted = -4.6;
        assert!((alone - 0.5).abs() < 1e-9 && (refuted - 0.01).abs() < 1e-3, "{alone} {refuted}");
        assert!(doubt.probability() > 0.98 && !doubt.is_refuted());
        doubt.refuted = 4.7;
        assert!(doubt.is_refuted());
        // Seen again, and clearer.
        let step = VelocityStep { since: at(0.0), size: doubt.lie.step, gain: 300.0, kink: 0.0, left: 100.0 };
        doubt.seen_again(&StepLook::of(&step, 1.0, 100.0), &UsualPeak::expecting(8.0, 8.0, 30.0), at(4.0));
        assert!(doubt.odds > 2.0 && !doubt.is_refuted());
        let charged =
            VelocityDoubt { refuted: 4.6, ..VelocityDoubt::of(doubt.lie, at(0.0), DoubtKind::Charged) };
        assert_eq!(charged.probability(), 1.0);
    }
}
