//! How good a filter was over many runs.

use holdover::sim::altimeter::AltimeterRun;

/// A filter has this long to come back, steps.
pub const GRACE: usize = 50;
/// And is looked at for this long, steps.
pub const LOOK: usize = 20;
/// A healthy channel with less weight than this is locked out.
pub const LEAST_WEIGHT: f64 = 0.5;
/// A mean error beyond this is locked out, m.
pub const LARGEST_ERROR_M: f64 = 5.0;

/// Errors of all steps of all runs.
#[derive(Clone, Copy, Debug, Default)]
pub struct Score {
    n: f64,
    sum: f64,
    abs: f64,
    squares: f64,
    max_m: f64,
    runs: u32,
    locked: u32,
}

impl Score {
    /// Adds a run's errors (m) and the weights of its two channels by step.
    pub fn add(&mut self, run: &AltimeterRun, errors: &[f64], weights: &[[Option<f64>; 2]]) {
        for e in errors {
            self.n += 1.0;
            self.sum += e;
            self.abs += e.abs();
            self.squares += e * e;
            // A NaN stays.
            self.max_m = if e.abs() > self.max_m || e.is_nan() { e.abs() } else { self.max_m };
        }
        self.runs += 1;
        self.locked += u32::from(is_locked(run, errors, weights));
    }

    /// Mean size of the error, m.
    pub fn mean_abs_m(&self) -> f64 {
        self.abs / self.n
    }

    /// Standard deviation of the error, m.
    pub fn std_m(&self) -> f64 {
        (self.squares / self.n - (self.sum / self.n).powi(2)).max(0.0).sqrt()
    }

    /// Root of its mean square, m.
    pub fn rms_m(&self) -> f64 {
        (self.squares / self.n).sqrt()
    }

    /// Its largest size, m.
    pub fn max_m(&self) -> f64 {
        self.max_m
    }

    /// The share of runs that stayed locked out, %.
    pub fn locked_percent(&self) -> f64 {
        100.0 * f64::from(self.locked) / f64::from(self.runs)
    }
}

/// Whether, over [`LOOK`] steps that begin [`GRACE`] steps after the last fault or outage has cleared, a channel that is healthy all the
/// while has a mean weight below [`LEAST_WEIGHT`], or the mean size of the error is beyond [`LARGEST_ERROR_M`]. Where nothing clears, the
/// steps are the run's last.
fn is_locked(run: &AltimeterRun, errors: &[f64], weights: &[[Option<f64>; 2]]) -> bool {
    let from = run.clears_at().map_or(run.steps.len() - LOOK, |at| at + GRACE);
    let window = from..from + LOOK;
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let error = mean(&errors[window.clone()].iter().map(|e| e.abs()).collect::<Vec<_>>());
    let ignored = (0..2).any(|c| {
        let healthy = run.steps[window.clone()].iter().all(|s| [s.baro, s.gps][c].is_healthy());
        let weights: Vec<f64> = weights[window.clone()].iter().filter_map(|w| w[c]).collect();
        healthy && !weights.is_empty() && mean(&weights) < LEAST_WEIGHT
    });
    ignored || error.is_nan() || error > LARGEST_ERROR_M
}
