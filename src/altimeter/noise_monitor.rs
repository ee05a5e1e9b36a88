//! The noise of a channel that has grown: how large it is, and whether it is back to normal.

use super::tuning::{LEAST_NOISE_FACTOR, NOISE_MEMORY};

/// Follows the variance of a channel's noise while it is declared to have grown.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct NoiseMonitor {
    grown: Option<Grown>,
}

#[derive(Clone, Copy, Debug)]
struct Grown {
    since_s: f64,
    /// Variance over the normal one.
    factor: f64,
    samples: f64,
    /// Page's cumulative sum of the log-likelihood ratio of normal noise against the grown one.
    relief: f64,
}

impl NoiseMonitor {
    /// The variance over the normal one; 1 when nothing has grown.
    pub(super) fn factor(&self) -> f64 {
        self.grown.map_or(1.0, |g| g.factor)
    }

    /// Since when it has grown, s.
    pub(super) fn since_s(&self) -> Option<f64> {
        self.grown.map(|g| g.since_s)
    }

    /// It has grown by a factor, which so many samples have shown.
    pub(super) fn grow(&mut self, factor: f64, samples: u32, since_s: f64) {
        let samples = f64::from(samples).max(1.0);
        self.grown = Some(Grown { since_s, factor: factor.max(LEAST_NOISE_FACTOR), samples, relief: 0.0 });
    }

    /// Takes a squared innovation, what the prediction's variance has in it, and the normal variance of the noise. True when the noise
    /// is back to normal by it.
    pub(super) fn follow(&mut self, square: f64, predicted: f64, normal: f64, limit: f64) -> bool {
        let Some(g) = &mut self.grown else { return false };
        let shown = ((square - predicted) / normal).max(0.0);
        g.relief = (g.relief + 0.5 * g.factor.ln() - 0.5 * shown * (1.0 - 1.0 / g.factor)).max(0.0);
        g.samples = (g.samples + 1.0).min(NOISE_MEMORY);
        g.factor = (g.factor + (shown - g.factor) / g.samples).max(1.0);
        let over = g.relief > limit || g.factor < LEAST_NOISE_FACTOR;
        if over {
            self.grown = None;
        }
        over
    }
}

#[cfg(test)]
mod tests;
