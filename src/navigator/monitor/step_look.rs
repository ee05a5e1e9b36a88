//! What a look at a receiver's velocity and inertia shows (`step_fit`), in sigmas, and what looks usually show.
//!
//! A step that is exceeded once in 10^d windows is a lie with the odds o = 10^(d − D): as likely as not at the limit D of a doubt. What is less is a hunch: nothing is claimed of
//! it. But other witnesses say of it, as of a doubt, how much more likely a step of this size at this time is than none; where they speak for it, and that makes it more likely
//! than not, it is doubted. So a step that a manoeuvre hides from inertia, and a gust from the air, is found by the two together.

use nalgebra::Vector2;

use super::felt_velocity::VelocityLie;
use super::step_fit::VelocityStep;
use super::usual::UsualPeak;
use crate::navigator::tuning::velocity_step::{
    CLEAR_OF, DECADES, DOUBT_DECADES, DOUBT_LEAVES, HUNCH_DECADES, HUNCH_S, HUNCHES, LEAST_MPS, MEMORY,
    STILL_SAME_S, WEIGH_S,
};
use crate::time::{AutopilotTime, Span};

/// What a look at the last seconds shows: the best step, what it explains, what it leaves, and what of that is beyond the noise, as squares of sigmas.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepLook {
    pub(super) begun: VelocityLie,
    /// In what is left, where that is more than the noise.
    pub(super) square: f64,
    /// In the noise.
    pub(super) explained: f64,
    pub(super) left: f64,
    pub(super) unexplained: f64,
    /// Too small, or a kink.
    pub(super) is_none: bool,
}

impl StepLook {
    /// With a noise variance, (m/s)², and degrees of freedom.
    pub(super) fn of(step: &VelocityStep, noise: f64, degrees: f64) -> Self {
        let explained = step.gain / noise;
        Self {
            begun: VelocityLie::new(step.since, step.size),
            square: explained / (step.left / (noise * degrees)).max(1.0),
            explained,
            left: step.left / noise,
            unexplained: (step.left / noise - degrees).max(0.0),
            is_none: step.size.norm() <= LEAST_MPS || (step.gain - step.kink) / noise <= CLEAR_OF,
        }
    }

    /// Odds that it is a lie where that is all that is known, ln.
    pub(super) fn odds(&self, usual: &UsualPeak) -> f64 {
        (usual.decades(self.square) - DOUBT_DECADES) * std::f64::consts::LN_10
    }

    fn is_clear(&self) -> bool {
        self.unexplained < DOUBT_LEAVES * self.explained
    }

    /// Whether it explains more than `limit`, and leaves less than that beyond the noise. Manoeuvres that are sampled badly leave more.
    pub(super) fn exceeds(&self, limit: f64) -> bool {
        !self.is_none && self.square > limit && self.is_clear()
    }
}

/// How much the best of all steps usually explains. The last one waits until nothing is suspected of it any more.
#[derive(Clone, Copy, Debug)]
pub(super) struct UsualStep {
    pub(super) peak: UsualPeak,
    pub(super) pending: Option<f64>,
}

impl UsualStep {
    pub(super) fn learn(&mut self, square: Option<f64>) {
        if let Some(square) = std::mem::replace(&mut self.pending, square) {
            self.peak.learn(square.min(self.peak.limit(DECADES)), MEMORY);
        }
    }
}

/// A step that is nothing unusual, and its odds, ln.
#[derive(Clone, Copy, Debug)]
struct StepHunch {
    lie: VelocityLie,
    odds: f64,
}

/// Those of the last seconds.
#[derive(Clone, Debug, Default)]
pub(super) struct StepHunches {
    kept: [Option<StepHunch>; HUNCHES],
    due: Option<AutopilotTime>,
}

impl StepHunches {
    /// Nothing of what was is of use.
    pub(super) fn clear(&mut self) {
        self.kept = [None; HUNCHES];
    }

    /// What was doubted and is no lie is no hunch either.
    pub(super) fn forget(&mut self, lie: &VelocityLie) {
        for kept in &mut self.kept {
            *kept = kept.filter(|h| h.lie.since.seconds_since(lie.since).abs() >= STILL_SAME_S);
        }
    }

    /// A look.
    pub(super) fn see(&mut self, look: &StepLook, usual: &UsualPeak) {
        if !look.exceeds(usual.limit(HUNCH_DECADES)) {
            return;
        }
        let hunch = StepHunch { lie: look.begun, odds: look.odds(usual) };
        let same = |h: &StepHunch| h.lie.since.seconds_since(hunch.lie.since).abs() < STILL_SAME_S;
        let known = self.kept.iter().position(|kept| kept.as_ref().is_some_and(same));
        let least = |at: &usize| self.kept[*at].map_or(f64::NEG_INFINITY, |h| h.odds);
        let place = known.or_else(|| (0..HUNCHES).min_by(|a, b| least(a).total_cmp(&least(b))));
        if let Some(kept) = place.map(|at| &mut self.kept[at])
            && kept.is_none_or(|h| h.odds < hunch.odds)
        {
            *kept = Some(hunch);
        }
    }

    /// The one that is more likely than not, and its odds by inertia alone, ln; `refutes`: by how much a step that began so long ago, s, of this size, NE, m/s, is more
    /// likely none by what others say, ln.
    pub(super) fn weigh(
        &mut self,
        now: AutopilotTime,
        refutes: impl Fn(f64, &Vector2<f64>) -> Option<f64>,
    ) -> Option<(VelocityLie, f64)> {
        if self.due.is_some_and(|due| now < due) {
            return None;
        }
        self.due = Some(now + Span::from_seconds(WEIGH_S));
        for kept in &mut self.kept {
            *kept = kept.filter(|h| (0.0..HUNCH_S).contains(&now.seconds_since(h.lie.since)));
        }
        let spoken_for = self.kept.iter().flatten().filter_map(|h| {
            let refuted = refutes(now.seconds_since(h.lie.since), &h.lie.step).filter(|r| *r < 0.0)?;
            Some((h, h.odds - refuted)).filter(|(_, odds)| *odds > 0.0)
        });
        let (hunch, _) = spoken_for.max_by(|a, b| a.1.total_cmp(&b.1))?;
        Some((hunch.lie, hunch.odds))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(s: f64) -> AutopilotTime {
        AutopilotTime::from_micros((s * 1e6) as i64)
    }

    /// A look at a step of 2 m/s at 10 s that explains `gain` and leaves `left`, (m/s)², in a noise of 1 (m/s)² and a hundred degrees of freedom.
    fn look(gain: f64, left: f64) -> StepLook {
        let step = VelocityStep { since: at(10.0), size: Vector2::new(2.0, 0.0), gain, kink: 0.0, left };
        StepLook::of(&step, 1.0, 100.0)
    }

    fn usual() -> UsualPeak {
        UsualPeak::expecting(8.0, 8.0, 30.0)
    }

    #[test]
    fn what_is_left_is_the_measure_where_it_is_more_than_the_noise() {
        let (clean, noisy, swamped) = (look(80.0, 100.0), look(800.0, 400.0), look(80.0, 200.0));
        assert!(clean.square == 80.0 && noisy.square == 200.0 && swamped.square == 40.0);
        assert!(clean.exceeds(60.0) && noisy.exceeds(60.0) && !noisy.exceeds(300.0));
        assert!(!swamped.exceeds(10.0), "it leaves more than it explains");
    }

    #[test]
    fn odds_are_even_at_the_limit_of_a_doubt() {
        let limit = usual().limit(DOUBT_DECADES);
        assert!(look(limit, 100.0).odds(&usual()).abs() < 1e-9);
        let rarer = look(usual().limit(DOUBT_DECADES + 1.0), 100.0).odds(&usual());
        assert!((rarer - 10f64.ln()).abs() < 1e-9, "{rarer}");
    }

    #[test]
    fn a_hunch_is_worth_nothing_alone_and_something_where_others_speak_for_it() {
        let weak = look(usual().limit(2.5), 100.0);
        let heard = |says: Option<f64>, age_s: f64| {
            let mut hunches = StepHunches::default();
            hunches.see(&weak, &usual());
            hunches.weigh(at(10.0 + age_s), |seconds, step| {
                assert!((seconds - age_s).abs() < 1e-9 && step.x == 2.0);
                says
            })
        };
        // One decade too little.
        assert!(heard(None, 8.0).is_none() && heard(Some(3.0), 8.0).is_none());
        assert!(heard(Some(-2.0), 8.0).is_none() && heard(Some(-3.0), HUNCH_S + 1.0).is_none());
        let (lie, odds) = heard(Some(-3.0), 8.0).unwrap();
        assert!(lie.since == at(10.0) && (odds + 10f64.ln()).abs() < 1e-9, "{odds}");
        // What is usual is none, and what was found to be no lie is none any more.
        let mut hunches = StepHunches::default();
        hunches.see(&look(usual().limit(0.5), 100.0), &usual());
        assert!(hunches.weigh(at(18.0), |_, _| Some(-20.0)).is_none());
        hunches.see(&weak, &usual());
        hunches.forget(&lie);
        assert!(hunches.weigh(at(20.0), |_, _| Some(-20.0)).is_none());
    }
}
