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

/// The best explanation of what came since an onset.
///
/// An explanation says of every channel that it is as it was, has jumped, or has become noisy; or that the inertial altitude jumped.
/// What an explanation declares has to be ahead of every explanation without it.
pub(super) fn explain(onset: &Onset, d: &DetectionSettings) -> Explanation {
    let mut noisy = [0.0; 4];
    let mut quiet = [1.0; 4];
    let mut total = 0;
    for c in 0..4 {
        total += onset.count[c];
        let (ratio, factor) = Onset::noise(onset.square[c], onset.count[c]);
        if ratio > d.noise_cost {
            noisy[c] = ratio - d.noise_cost;
            quiet[c] = 1.0 / factor;
        }
    }
    let noise: f64 = noisy.iter().sum();
    // A channel that jumped has its own noise, one that did not has what its innovations show.
    let weights = |s: usize, t: usize| std::array::from_fn(|c| if c == s || c == t { 1.0 } else { quiet[c] });
    let heard = |c: usize| onset.may_jump(c);
    // Scores of: no jump, the inertial altitude, one channel, two channels.
    let mut tried: [(f64, Option<Fit>); 12] = [(f64::NEG_INFINITY, None); 12];
    tried[0].0 = noise;
    if let Some(fit) = onset.inertial(d.climb_jump_mps, &[1.0; 4]) {
        tried[1] = (fit.ratio - d.jump_cost, Some(fit));
    }
    let mut n = 2;
    for s in 0..4 {
        if !heard(s) {
            continue;
        }
        if let Some(fit) = onset.single(s, &weights(s, s)) {
            tried[n] = (fit.ratio - d.jump_cost + noise - noisy[s], Some(fit));
            n += 1;
        }
        for t in s + 1..4 {
            if heard(t)
                && let Some(fit) = onset.pair(s, t, &weights(s, t))
            {
                tried[n] = (fit.ratio - d.jump_cost - d.both_cost + noise - noisy[s] - noisy[t], Some(fit));
                n += 1;
            }
        }
    }
    let tried = tried.get(..n).unwrap_or(&tried);
    let best = tried.iter().fold(tried[0], |a, b| if b.0 > a.0 { *b } else { a });
    let ahead_of = |without: &dyn Fn(&Option<Fit>) -> bool| {
        tried.iter().filter(|(_, fit)| without(fit)).all(|(score, _)| best.0 > score + d.margin)
    };
    let jumps = |fit: &Option<Fit>, s: usize| fit.is_some_and(|f| f.jumps.contains(&s));
    let mut ready = true;
    let mut grown = [None; 4];
    for c in 0..4 {
        let (ratio, _) = Onset::noise(onset.bounded[c], onset.count[c]);
        let large = onset.count[c] >= d.samples && ratio > d.ratio;
        if large && !jumps(&best.1, c) && ahead_of(&|fit| jumps(fit, c)) {
            let (_, factor) = Onset::noise(onset.square[c], onset.count[c]);
            grown[c] = Some((factor, onset.count[c]));
        }
    }
    match &best.1 {
        Some(fit) => {
            ready &= fit.ratio - d.jump_cost > d.ratio;
            let mut seen = 0;
            for s in fit.jumps {
                let n = onset.count.get(s).map_or(total, |n| *n);
                seen += n;
                ready &= n >= d.samples.div_ceil(2);
                ready &= ahead_of(&|other| !jumps(other, s));
            }
            ready &= seen >= 2 * d.samples;
        }
        None => ready = grown.iter().any(Option::is_some),
    }
    let jump = best.1.map(|fit| (fit, fit.jumps.map(|s| State::from(onset.effect[s]))));
    Explanation { score: best.0, since_s: onset.time_s, jump, grown, ready }
}
