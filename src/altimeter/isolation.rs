//! Which explanation of the innovations is the best, and whether it is good enough to be declared.

use super::glr_bank::{Fit, Onset};
use super::joint::State;
use super::settings::DetectionSettings;

/// How well the innovations since an onset are explained.
#[derive(Clone, Copy, Debug)]
pub(super) struct ExplanationScore {
    /// Log-likelihood ratio of the best explanation against "nothing happened", less what it costs.
    pub(super) most: f64,
    /// The log-likelihood ratio of a jump, less what it costs; infinite when other things than a jump may have to be declared.
    pub(super) jump: f64,
}

/// What [`explain`] would give as score, without the explanation where that can be had for less.
pub(super) fn score(onset: &Onset, d: &DetectionSettings) -> ExplanationScore {
    let Some([one, two]) = onset.quiet_ratios(d.noise_cost, d.climb_jump_mps) else {
        return ExplanationScore { most: explain(onset, d).score, jump: f64::INFINITY };
    };
    let (one, two) = (one - d.jump_cost, two - d.jump_cost);
    let most = f64::max(0.0, f64::max(one, two - d.both_cost));
    let jump = if d.noise_cost > d.ratio { f64::INFINITY } else { f64::max(one, two) };
    ExplanationScore { most, jump }
}

/// What explains the innovations since an onset.
#[derive(Clone, Copy, Debug)]
pub(super) struct Explanation {
    /// Log-likelihood ratio against "nothing happened", less what it costs.
    pub(super) score: f64,
    pub(super) since_s: f64,
    /// What jumped, and that alone as log-likelihood ratio.
    pub(super) jump: Option<(Fit, [State; 2])>,
    /// Channels whose noise has grown: by which factor, and how many samples show it.
    pub(super) grown: [Option<(f64, u32)>; 4],
    /// Nothing else explains it nearly as well, and there are samples enough.
    pub(super) ready: bool,
}

/// What grown noise explains, channel by channel.
struct NoiseTerms {
    /// Log-likelihood ratio of grown noise, less what it costs; 0 where it explains nothing.
    gain: [f64; 4],
    /// Weight of the channel's innovations with that noise.
    weight: [f64; 4],
}

impl NoiseTerms {
    fn of(onset: &Onset, d: &DetectionSettings) -> Self {
        let mut terms = Self { gain: [0.0; 4], weight: [1.0; 4] };
        for c in 0..4 {
            let (ratio, factor) = Onset::noise(onset.square[c], onset.count[c]);
            if ratio > d.noise_cost {
                terms.gain[c] = ratio - d.noise_cost;
                terms.weight[c] = 1.0 / factor;
            }
        }
        terms
    }

    /// Weights where these two jumped: a channel that jumped has its own noise, one that did not has what its innovations show.
    fn weights(&self, s: usize, t: usize) -> [f64; 4] {
        std::array::from_fn(|c| if c == s || c == t { 1.0 } else { self.weight[c] })
    }
}

/// What may explain the innovations: no jump, the inertial altitude, one channel, two channels.
const HYPOTHESES: usize = 12;

/// A hypothesis with its score.
type Scored = (f64, Option<Fit>);

/// Scores of all hypotheses, and how many there are.
fn hypotheses(onset: &Onset, d: &DetectionSettings) -> ([Scored; HYPOTHESES], usize) {
    let terms = NoiseTerms::of(onset, d);
    let noise: f64 = terms.gain.iter().sum();
    let mut tried: [Scored; HYPOTHESES] = [(f64::NEG_INFINITY, None); HYPOTHESES];
    tried[0].0 = noise;
    if let Some(fit) = onset.inertial(d.climb_jump_mps, &[1.0; 4]) {
        tried[1] = (fit.ratio - d.jump_cost, Some(fit));
    }
    let mut n = 2;
    for s in (0..4).filter(|s| onset.may_jump(*s)) {
        if let Some(fit) = onset.single(s, &terms.weights(s, s)) {
            tried[n] = (fit.ratio - d.jump_cost + noise - terms.gain[s], Some(fit));
            n += 1;
        }
        for t in (s + 1..4).filter(|t| onset.may_jump(*t)) {
            if let Some(fit) = onset.pair(s, t, &terms.weights(s, t)) {
                let cost = fit.ratio - d.jump_cost - d.both_cost;
                tried[n] = (cost + noise - terms.gain[s] - terms.gain[t], Some(fit));
                n += 1;
            }
        }
    }
    (tried, n)
}

/// The hypotheses with the best of them.
struct Ranking<'a> {
    tried: &'a [Scored],
    best: Scored,
    margin: f64,
}

impl<'a> Ranking<'a> {
    fn of(tried: &'a [Scored], margin: f64) -> Self {
        let first = tried.first().copied().unwrap_or((f64::NEG_INFINITY, None));
        let best = tried.iter().fold(first, |a, b| if b.0 > a.0 { *b } else { a });
        Self { tried, best, margin }
    }

    /// Whether the best is well ahead of every hypothesis in which `s` jumped, or of every one in which it did not.
    fn is_ahead_where(&self, s: usize, jumped: bool) -> bool {
        let others = self.tried.iter().filter(|(_, fit)| jumps(fit, s) == jumped);
        others.into_iter().all(|(score, _)| self.best.0 > score + self.margin)
    }
}

fn jumps(fit: &Option<Fit>, s: usize) -> bool {
    fit.is_some_and(|f| f.jumps.contains(&s))
}

/// Channels whose noise has grown by the best explanation: by which factor, and how many samples show it.
fn grown_noise(onset: &Onset, d: &DetectionSettings, ranking: &Ranking) -> [Option<(f64, u32)>; 4] {
    std::array::from_fn(|c| {
        let (ratio, _) = Onset::noise(onset.bounded[c], onset.count[c]);
        let large = onset.count[c] >= d.samples && ratio > d.ratio;
        let grown = large && !jumps(&ranking.best.1, c) && ranking.is_ahead_where(c, true);
        grown.then(|| (Onset::noise(onset.square[c], onset.count[c]).1, onset.count[c]))
    })
}

/// Whether a jump is likely enough to be declared, ahead of every explanation without it, and shown by samples enough.
fn jump_is_ready(onset: &Onset, d: &DetectionSettings, ranking: &Ranking, fit: &Fit) -> bool {
    let total: u32 = onset.count.iter().sum();
    let mut ready = fit.ratio - d.jump_cost > d.ratio;
    let mut seen = 0;
    for s in fit.jumps {
        let n = onset.count.get(s).map_or(total, |n| *n);
        seen += n;
        ready &= n >= d.samples.div_ceil(2) && ranking.is_ahead_where(s, false);
    }
    ready && seen >= 2 * d.samples
}

/// The best explanation of what came since an onset.
///
/// An explanation says of every channel that it is as it was, has jumped, or has become noisy; or that the inertial altitude jumped.
/// What an explanation declares has to be ahead of every explanation without it.
pub(super) fn explain(onset: &Onset, d: &DetectionSettings) -> Explanation {
    let (tried, n) = hypotheses(onset, d);
    let ranking = Ranking::of(tried.get(..n).unwrap_or(&tried), d.margin);
    let grown = grown_noise(onset, d, &ranking);
    let (score, fit) = ranking.best;
    let ready = match &fit {
        Some(fit) => jump_is_ready(onset, d, &ranking, fit),
        None => grown.iter().any(Option::is_some),
    };
    let jump = fit.map(|fit| (fit, fit.jumps.map(|s| State::from(onset.effect[s]))));
    Explanation { score, since_s: onset.time_s, jump, grown, ready }
}
