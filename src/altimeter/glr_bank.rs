//! What if something jumped at that time? A bank of onset times, each with the sensitivity of the filter to a jump then.
//!
//! A fault of the model is a jump of one state at an onset θ: of a channel's fault bias, or of the climb rate when the inertial
//! altitude goes astray. A linear filter that does not know of it errs by J f, with f the size of the jump and
//!
//! J(θ) = −e_s,  J ← Φ J,  r = −H J,  J ← J + pK r,
//!
//! where r is what the jump adds to an innovation ν of variance S. With the sums over the innovations since θ
//!
//! C = Σ r rᵀ/S,  d = Σ r ν/S
//!
//! (over several jumps at once) the most likely size is f̂ = C⁻¹d, its covariance C⁻¹, and the log-likelihood ratio against "nothing
//! happened" ½ dᵀC⁻¹d: the generalised likelihood ratio of Willsky and Jones (IEEE TAC 21, 1976). x̂ − J f̂ with P + J C⁻¹ Jᵀ is what the
//! filter would hold had it had the state open since θ (Friedland's separation, IEEE TAC 14, 1969): going back to the onset costs no replay.

use super::joint::{CLIMB, Channel, HEIGHT, HeightInnovation, HeightTransition, STATES, State};
use super::tuning::{BOUNDED_SQUARE, DENSE, ONSETS};

/// What may jump: a channel, or the inertial altitude.
pub(super) const JUMPS: usize = 5;
/// The inertial altitude among the jumps; the channels stand at their index.
pub(super) const INERTIAL: usize = 4;

/// The sums of one onset.
#[derive(Clone, Copy, Debug)]
pub(super) struct Onset {
    /// Before the first measurement at this time, s.
    pub(super) time_s: f64,
    /// J of every jump.
    pub(super) effect: [[f64; STATES]; JUMPS],
    /// C, upper triangle, by the channel whose innovations are in it.
    information: [[[f64; JUMPS]; JUMPS]; 4],
    /// d, likewise.
    evidence: [[f64; JUMPS]; 4],
    /// Σν²/S of each channel.
    pub(super) square: [f64; 4],
    /// The same, no sample counting for more than an outlier.
    pub(super) bounded: [f64; 4],
    /// Number of innovations of each channel.
    pub(super) count: [u32; 4],
}

/// The hypothesis that one state or two jumped, fitted to the innovations since an onset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fit {
    /// What jumped: twice the same when it is one.
    pub(super) jumps: [usize; 2],
    /// Log-likelihood ratio against "nothing happened".
    pub(super) ratio: f64,
    /// f̂.
    pub(super) size: [f64; 2],
    /// C⁻¹.
    pub(super) covariance: [[f64; 2]; 2],
}

impl Onset {
    fn new(time_s: f64) -> Self {
        let mut effect = [[0.0; STATES]; JUMPS];
        for c in Channel::ALL {
            effect[c.index()][c.fault()] = -1.0;
        }
        effect[INERTIAL][CLIMB] = -1.0;
        Self {
            time_s,
            effect,
            information: [[[0.0; JUMPS]; JUMPS]; 4],
            evidence: [[0.0; JUMPS]; 4],
            square: [0.0; 4],
            bounded: [0.0; 4],
            count: [0; 4],
        }
    }

    /// Whether a channel was heard and can be faulty: the ground may be anywhere, that is no fault of the rangefinder, but it has its say
    /// about the others.
    pub(super) fn may_jump(&self, s: usize) -> bool {
        self.count[s] > 0 && s != Channel::Range.index()
    }

    /// C of two jumps, the channels weighted.
    fn information(&self, s: usize, t: usize, weights: &[f64; 4]) -> f64 {
        (0..4).map(|c| weights[c] * self.information[c][s][t]).sum()
    }

    /// d of a jump, the channels weighted.
    fn evidence(&self, s: usize, weights: &[f64; 4]) -> f64 {
        (0..4).map(|c| weights[c] * self.evidence[c][s]).sum()
    }

    /// The hypothesis that `s` alone jumped. A channel whose noise has grown has the weight of its variance.
    pub(super) fn single(&self, s: usize, weights: &[f64; 4]) -> Option<Fit> {
        let c = self.information(s, s, weights);
        let d = self.evidence(s, weights);
        let size = d / c;
        (c > 0.0).then(|| Fit {
            jumps: [s, s],
            ratio: 0.5 * d * size,
            size: [size, 0.0],
            covariance: [[1.0 / c, 0.0], [0.0, 0.0]],
        })
    }

    /// The hypothesis that the inertial altitude jumped, with a prior N(0, F²) on the climb rate's jump, m/s: its odds are
    /// exp(½ d²/(C + F⁻²))/√(1 + F² C).
    pub(super) fn inertial(&self, prior_mps: f64, weights: &[f64; 4]) -> Option<Fit> {
        let prior = prior_mps * prior_mps;
        let c = self.information(INERTIAL, INERTIAL, weights);
        let d = self.evidence(INERTIAL, weights);
        let variance = prior / (1.0 + prior * c);
        let size = d * variance;
        (prior > 0.0 && c > 0.0).then(|| Fit {
            jumps: [INERTIAL, INERTIAL],
            ratio: 0.5 * d * size - 0.5 * (1.0 + prior * c).ln(),
            size: [size, 0.0],
            covariance: [[variance, 0.0], [0.0, 0.0]],
        })
    }

    /// The log-likelihood ratios of the likeliest single jump and of the likeliest two, where no channel's noise can have grown enough
    /// to be worth `noise_cost`; `None` where it can. What explains the innovations is almost never asked for more than this.
    pub(super) fn quiet_ratios(&self, noise_cost: f64, inertial_mps: f64) -> Option<[f64; 2]> {
        for c in 0..4 {
            // Of noise(): ln x ≥ 2 (x − 1)/(x + 1) for x ≥ 1.
            let (n, over) = (f64::from(self.count[c]), self.square[c] - f64::from(self.count[c]));
            if over > 0.0 && 0.5 * over * over > noise_cost * (self.square[c] + n) {
                return None;
            }
        }
        let even = [1.0; 4];
        let ratio = |fit: Option<Fit>| fit.map_or(f64::NEG_INFINITY, |f| f.ratio);
        let larger = |a: f64, b: f64| if b > a { b } else { a };
        let mut most = [ratio(self.inertial(inertial_mps, &even)), f64::NEG_INFINITY];
        for s in (0..4).filter(|s| self.may_jump(*s)) {
            most[0] = larger(most[0], ratio(self.single(s, &even)));
            for t in (s + 1..4).filter(|t| self.may_jump(*t)) {
                most[1] = larger(most[1], ratio(self.pair(s, t, &even)));
            }
        }
        Some(most)
    }

    /// The hypothesis that `s` and a later `t` jumped.
    pub(super) fn pair(&self, s: usize, t: usize, weights: &[f64; 4]) -> Option<Fit> {
        let a = self.information(s, s, weights);
        let b = self.information(s, t, weights);
        let c = self.information(t, t, weights);
        let det = a * c - b * b;
        // Two jumps that look alike cannot be told apart.
        if det.is_nan() || det <= 1e-9 * a * c {
            return None;
        }
        let (d, e) = (self.evidence(s, weights), self.evidence(t, weights));
        let size = [(c * d - b * e) / det, (a * e - b * d) / det];
        Some(Fit {
            jumps: [s, t],
            ratio: 0.5 * (d * size[0] + e * size[1]),
            size,
            covariance: [[c / det, -b / det], [-b / det, a / det]],
        })
    }

    /// The log-likelihood ratio of the hypothesis that a channel's noise has grown since, to its most likely variance, and that as a
    /// factor on S; from squares that are bounded or not.
    pub(super) fn noise(square: f64, count: u32) -> (f64, f64) {
        let n = f64::from(count);
        let factor = if count > 0 { square / n } else { 0.0 };
        if factor <= 1.0 { (0.0, 1.0) } else { (0.5 * (square - n - n * factor.ln()), factor) }
    }
}

/// The bank.
#[derive(Clone, Debug)]
pub(super) struct GlrBank {
    onsets: [Onset; ONSETS],
    /// Places of the onsets, oldest first, then the free ones: an onset is large and stays where it is.
    order: [u8; ONSETS],
    len: usize,
    /// The onset that explains best so far: it is not thinned out.
    kept_s: f64,
    spacing_s: f64,
    window_s: f64,
}

impl GlrBank {
    /// GlrBank at least `spacing_s` apart, no older than `window_s`.
    pub(super) fn new(spacing_s: f64, window_s: f64) -> Self {
        let order = std::array::from_fn(|i| i as u8);
        Self { onsets: [Onset::new(0.0); ONSETS], order, len: 0, kept_s: f64::NAN, spacing_s, window_s }
    }

    pub(super) fn clear(&mut self) {
        self.len = 0;
    }

    /// The offset of a channel was set anew, so that the channel reads what the height is: its error is the height's, from any jump.
    pub(super) fn restarted(&mut self, offset: usize) {
        for effect in self.onsets.iter_mut().flat_map(|onset| onset.effect.iter_mut()) {
            effect[offset] = -effect[HEIGHT];
        }
    }

    /// This onset explains what came best so far.
    pub(super) fn keep(&mut self, time_s: f64) {
        self.kept_s = time_s;
    }

    /// Oldest first.
    pub(super) fn iter(&self) -> impl Iterator<Item = &Onset> {
        self.order.iter().take(self.len).filter_map(|place| self.onsets.get(usize::from(*place)))
    }

    fn time_s(&self, i: usize) -> f64 {
        self.onsets[usize::from(self.order[i])].time_s
    }

    /// Time goes on.
    pub(super) fn predict(&mut self, phi: &HeightTransition, in_use: [bool; JUMPS]) {
        for place in self.order.iter().take(self.len) {
            let onset = &mut self.onsets[usize::from(*place)];
            for (effect, _) in onset.effect.iter_mut().zip(in_use).filter(|(_, used)| *used) {
                phi.apply(effect);
            }
        }
    }

    /// Opens an onset before the measurement that comes now, when the newest is old enough or when something may begin with it.
    pub(super) fn open(&mut self, now_s: f64, suspicious: bool) {
        while self.len > 0 && now_s - self.time_s(0) > self.window_s {
            self.remove(0);
        }
        if !suspicious && self.len > 0 && now_s - self.time_s(self.len - 1) < self.spacing_s - 1e-9 {
            return;
        }
        if self.len == ONSETS {
            self.thin(now_s);
        }
        self.onsets[usize::from(self.order[self.len])] = Onset::new(now_s);
        self.len += 1;
    }

    /// Removes the onset that its neighbours stand in for best.
    fn thin(&mut self, now_s: f64) {
        let mut least = (f64::INFINITY, 1);
        for i in 1..ONSETS - DENSE {
            let gap = self.time_s(i + 1) - self.time_s(i - 1);
            let age = now_s - self.time_s(i);
            if gap / age < least.0 && self.time_s(i) != self.kept_s {
                least = (gap / age, i);
            }
        }
        self.remove(least.1);
    }

    fn remove(&mut self, i: usize) {
        self.order[i..self.len].rotate_left(1);
        self.len -= 1;
    }

    /// Takes an innovation of a channel, and the gain with which it was used.
    pub(super) fn measured(
        &mut self,
        channel: Channel,
        innovation: &HeightInnovation,
        gain: &State,
        in_use: [bool; JUMPS],
    ) {
        let (o, f) = (channel.offset(), channel.fault());
        let c = channel.index();
        let separate = f != o;
        let weight = 1.0 / innovation.variance;
        let scaled = innovation.value * weight;
        let square = innovation.value * scaled;
        for place in self.order.iter().take(self.len) {
            let onset = &mut self.onsets[usize::from(*place)];
            let mut response = [0.0; JUMPS];
            for s in 0..JUMPS {
                if !in_use[s] {
                    continue;
                }
                let effect = &mut onset.effect[s];
                let r = -(effect[0] + effect[o] + if separate { effect[f] } else { 0.0 });
                response[s] = r;
                for (e, g) in effect.iter_mut().zip(gain.iter()) {
                    *e += g * r;
                }
                onset.evidence[c][s] += r * scaled;
            }
            for s in (0..JUMPS).filter(|s| in_use[*s]) {
                for t in s..JUMPS {
                    onset.information[c][s][t] += response[s] * response[t] * weight;
                }
            }
            onset.square[c] += square;
            onset.bounded[c] += square.min(BOUNDED_SQUARE);
            onset.count[c] += 1;
        }
    }
}

#[cfg(test)]
mod tests;
