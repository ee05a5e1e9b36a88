//! How old what a sensor tells really is, and how old a flow is.
//!
//! A latency is found while motion changes: a scalar Kalman filter (`Latency`) over residuals whose slope by the latency is known. A vehicle whose motion never changes
//! teaches it nothing, and its variance says so.
//!
//! **Flow.** Compared with the velocity that GNSS gives at the time at which the flow was taken to be measured, a flow that is older than
//! that is off by −δ·dv/dt, and by the rotation between the two times where the rotation was taken out with our gyros: the slope comes
//! from a second evaluation some milliseconds earlier, which knows all of that. Differences of short means are used, so that what is
//! slow (bias, heading, wandering GNSS) falls out.

use nalgebra::Vector2;

use crate::navigator::tuning::latency::{
    BLOCK_S, BLOCKS_APART_S, GATE_S, GATE_SIGMA, INDEPENDENT, LAG, LEAST_CHANGE, LONGEST_FLOW_S,
    REFERENCE_NOISE, WALK,
};
use crate::time::AutopilotTime;

/// An estimated latency: a scalar Kalman filter.
#[derive(Clone, Copy, Debug)]
pub(super) struct Latency {
    seconds: f64,
    variance: f64,
    longest_s: f64,
}

impl Latency {
    /// A `sigma_s` of zero keeps it where it is.
    pub(super) fn new(seconds: f64, sigma_s: f64, longest_s: f64) -> Self {
        Self { seconds, variance: sigma_s * sigma_s, longest_s: longest_s.max(seconds) }
    }

    /// Goes on from what was learned before, as far as it may be learned, and that is a latency.
    pub(super) fn recall(&mut self, kept: [f64; 2]) {
        let [seconds, sigma_s] = kept;
        if !self.is_fixed() && (0.0..=self.longest_s).contains(&seconds) && (1e-6..=1.0).contains(&sigma_s) {
            (self.seconds, self.variance) = (seconds, sigma_s * sigma_s);
        }
    }

    /// The latency, s, and its variance, s².
    pub(super) fn seconds(&self) -> f64 {
        self.seconds
    }

    pub(super) fn variance(&self) -> f64 {
        self.variance
    }

    pub(super) fn is_fixed(&self) -> bool {
        self.variance == 0.0
    }

    /// It is longer by `delay_s`, with a variance, s², and has walked since by `walk`, s².
    pub(super) fn take(&mut self, delay_s: f64, variance: f64, walk: f64) {
        let gain = self.variance / (self.variance + variance);
        self.seconds = (self.seconds + gain * delay_s).clamp(0.0, self.longest_s);
        self.variance = self.variance * (1.0 - gain) + walk;
    }

    /// Takes a residual (m/s, or rad) that is `slope` (of it a second) times what the latency is misjudged by (true − assumed), and noise.
    pub(super) fn observe(&mut self, residual: f64, slope: f64, noise: f64) {
        // A NaN is not within the gate, either.
        let within = residual.abs() <= GATE_SIGMA * noise + GATE_S * slope.abs();
        if !within || self.is_fixed() {
            return;
        }
        let gain = slope * self.variance / (slope * slope * self.variance + noise * noise);
        self.seconds = (self.seconds + gain * residual).clamp(0.0, self.longest_s);
        self.variance = self.variance * (1.0 - gain * slope).max(0.0) + WALK;
    }
}

/// Latency of one flow sensor, on top of its own stamps.
#[derive(Clone, Debug)]
pub struct FlowLatency {
    latency: Latency,
    block: Option<Block>,
    /// The last ones, oldest first.
    past: [Option<Block>; LAG],
}

/// Sums over a fifth of a second.
#[derive(Clone, Copy, Debug)]
struct Block {
    from: AutopilotTime,
    samples: f64,
    residual: Vector2<f64>,
    slope: Vector2<f64>,
    variance: f64,
}

impl FlowLatency {
    /// Starts from the configured latency; a `sigma_s` of zero keeps it there.
    pub fn new(latency_s: f64, sigma_s: f64) -> Self {
        Self { latency: Latency::new(latency_s, sigma_s, LONGEST_FLOW_S), block: None, past: [None; LAG] }
    }

    /// The latency to assume, s.
    pub fn latency_s(&self) -> f64 {
        self.latency.seconds
    }

    /// Its standard deviation, s.
    pub fn sigma_s(&self) -> f64 {
        self.latency.variance.sqrt()
    }

    /// Goes on from a latency and its standard deviation, s, that were learned before.
    pub fn recall(&mut self, kept: [f64; 2]) {
        self.latency.recall(kept);
    }

    /// Whether there is anything to learn.
    pub fn learns(&self) -> bool {
        !self.latency.is_fixed()
    }

    /// What comes next cannot be compared with what was.
    pub fn interrupt(&mut self) {
        (self.block, self.past) = (None, [None; LAG]);
    }

    /// Takes flow less GNSS velocity (m/s, body x and y), its derivative by the latency assumed (m/s²), and its variance on an axis.
    pub fn observe(
        &mut self,
        time: AutopilotTime,
        residual: &Vector2<f64>,
        by_latency: &Vector2<f64>,
        variance: f64,
    ) {
        let zero = Vector2::zeros();
        let fresh = Block { from: time, samples: 0.0, residual: zero, slope: zero, variance: 0.0 };
        let block = self.block.get_or_insert(fresh);
        block.samples += 1.0;
        block.residual += residual;
        block.slope -= by_latency;
        block.variance += variance;
        if time.seconds_since(block.from) < BLOCK_S {
            return;
        }
        let done = Block {
            residual: block.residual / block.samples,
            slope: block.slope / block.samples,
            variance: block.variance / block.samples / block.samples.min(INDEPENDENT)
                + REFERENCE_NOISE * REFERENCE_NOISE,
            ..*block
        };
        self.block = None;
        let last = self.past[0];
        self.past.rotate_left(1);
        self.past[LAG - 1] = Some(done);
        if let Some(last) = last.filter(|l| done.from.seconds_since(l.from).abs() < BLOCKS_APART_S) {
            // Every block is compared twice.
            let noise = (2.0 * (done.variance + last.variance)).max(0.0).sqrt();
            for axis in 0..2 {
                let slope = done.slope[axis] - last.slope[axis];
                if slope.abs() >= LEAST_CHANGE {
                    self.latency.observe(done.residual[axis] - last.residual[axis], slope, noise);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flow that is `true_s` late, with a bias, a scale error and noise, against a GNSS velocity that is right.
    fn run_flow(true_s: f64, assumed_s: f64, sigma_s: f64) -> FlowLatency {
        let v = |t: f64| Vector2::new(3.0 * (0.9 * t).sin(), 2.0 * (0.6 * t).cos());
        let mut e = FlowLatency::new(assumed_s, sigma_s);
        for k in 1..6000 {
            let t = 0.02 * f64::from(k);
            // Noise without a random generator: incommensurable sines.
            let noise = Vector2::new((1234.5 * t).sin(), (2345.6 * t).cos()) * 0.3;
            let flow = v(t - true_s) * 0.95 + Vector2::new(0.3, -0.2) + noise;
            let residual = |assumed: f64| flow - v(t - assumed);
            let (now, earlier) = (e.latency_s(), e.latency_s() + 0.04);
            let by_latency = (residual(earlier) - residual(now)) / 0.04;
            e.observe(AutopilotTime::from_micros(20_000 * i64::from(k)), &residual(now), &by_latency, 0.09);
        }
        e
    }

    #[test]
    fn the_latency_of_flow_is_found_from_either_side_and_within_its_sigma() {
        for (truth, assumed) in [(0.1, 0.0), (0.0, 0.12), (0.22, 0.1)] {
            let e = run_flow(truth, assumed, 0.06);
            let error = (e.latency_s() - truth).abs();
            assert!(
                error < 0.03 && error < 4.0 * e.sigma_s(),
                "{truth}: {} ± {}",
                e.latency_s(),
                e.sigma_s()
            );
            assert!(e.sigma_s() < 0.02);
        }
        assert_eq!(run_flow(0.2, 0.1, 0.0).latency_s(), 0.1);
        assert!(run_flow(0.5, 0.2, 0.1).latency_s() <= LONGEST_FLOW_S);
    }

    #[test]
    fn nonsense_teaches_nothing() {
        let mut e = FlowLatency::new(0.05, 0.05);
        for k in 0..500 {
            let x = [f64::NAN, f64::INFINITY, 1e300, -50.0][k % 4];
            let v = Vector2::new(x, -x);
            e.observe(AutopilotTime::from_micros(20_000 * k as i64), &v, &(v * 0.1), 0.1);
        }
        assert!((0.0..=LONGEST_FLOW_S).contains(&e.latency_s()) && e.sigma_s().is_finite());
    }
}
