//! How old a GNSS fix really is.
//!
//! Over a second or two the inertial prediction follows the change of velocity between two times, the receiver that between the
//! times δ earlier, if δ is what the latency is misjudged by. Each fix resets the prediction, so the innovations of the fixes in
//! between add up to −δ·(a(t) − a(t′)), a the acceleration at the window's ends. A scalar Kalman filter turns that into an estimate.
//! A vehicle that never accelerates teaches it nothing, and its variance says so.

use nalgebra::Vector2;

/// Latency of one receiver, on top of its own stamps.
#[derive(Clone, Debug)]
pub struct LatencyEstimator {
    latency_s: f64,
    variance: f64,
    window: Option<Window>,
}

#[derive(Clone, Debug)]
struct Window {
    fixes: u32,
    /// Acceleration at its beginning, m/s².
    from_ne: Vector2<f64>,
    /// Sum of the innovations since, m/s.
    sum_ne: Vector2<f64>,
}

/// Fixes in a window: 2 s at 5 Hz.
const WINDOW_FIXES: u32 = 10;
/// Noise of the sum of the innovations in a window, m/s: two velocity samples and the accelerometer's error over the window.
const VELOCITY_NOISE: f64 = 0.25;
/// Only a change of the acceleration of at least this much teaches anything, m/s².
const LEAST_CHANGE: f64 = 0.5;
/// No receiver is older than this, s.
const LONGEST_S: f64 = 0.5;
/// Latencies do not change much in flight: walk of the estimate, s²/fix.
const WALK: f64 = 1e-8;

impl LatencyEstimator {
    /// Starts from the configured latency; a `sigma_s` of zero keeps it there.
    pub fn new(latency_s: f64, sigma_s: f64) -> Self {
        Self { latency_s, variance: sigma_s * sigma_s, window: None }
    }

    /// The latency to assume, s.
    pub fn latency_s(&self) -> f64 {
        self.latency_s
    }

    /// Its standard deviation, s.
    pub fn sigma_s(&self) -> f64 {
        self.variance.sqrt()
    }

    /// The next fix cannot be compared with the last one.
    pub fn interrupt(&mut self) {
        self.window = None;
    }

    /// Takes the velocity innovation of an accepted fix and the acceleration when it was measured, both horizontal.
    pub fn observe(&mut self, innovation_ne: &Vector2<f64>, acceleration_ne: &Vector2<f64>) {
        if self.variance == 0.0 {
            return;
        }
        let fresh = Window { fixes: 0, from_ne: *acceleration_ne, sum_ne: Vector2::zeros() };
        let Some(window) = &mut self.window else {
            self.window = Some(fresh);
            return;
        };
        window.fixes += 1;
        window.sum_ne += innovation_ne;
        if window.fixes < WINDOW_FIXES {
            return;
        }
        let (innovation_ne, change) = (window.sum_ne, acceleration_ne - window.from_ne);
        self.window = Some(fresh);
        let size = change.norm();
        let along = innovation_ne.dot(&change) / size.max(1e-9);
        if size < LEAST_CHANGE || along.abs() > 4.0 * VELOCITY_NOISE + 0.3 * size {
            return;
        }
        let s = size * size * self.variance + VELOCITY_NOISE * VELOCITY_NOISE;
        let gain = -size * self.variance / s;
        self.latency_s = (self.latency_s + gain * along).clamp(0.0, LONGEST_S);
        self.variance = self.variance * (1.0 + gain * size).max(0.0) + WALK;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A receiver that is `true_s` late on a path with changing acceleration; each fix resets the prediction.
    fn run(true_s: f64, assumed_s: f64, sigma_s: f64) -> LatencyEstimator {
        let v = |t: f64| Vector2::new(3.0 * (0.9 * t).sin(), 2.0 * (0.6 * t).cos());
        let a = |t: f64| Vector2::new(2.7 * (0.9 * t).cos(), -1.2 * (0.6 * t).sin());
        let mut e = LatencyEstimator::new(assumed_s, sigma_s);
        for k in 1..1500 {
            let (t, last) = (0.2 * f64::from(k), 0.2 * f64::from(k - 1));
            // Stamp t; valid at t − true; taken for t − latency.
            let at = t - e.latency_s();
            let before = last - e.latency_s();
            let predicted = v(last - true_s) + v(at) - v(before);
            e.observe(&(v(t - true_s) - predicted), &a(at));
        }
        e
    }

    #[test]
    fn the_latency_is_found_from_either_side() {
        for (truth, assumed) in [(0.1, 0.0), (0.0, 0.12), (0.22, 0.1)] {
            let e = run(truth, assumed, 0.1);
            assert!((e.latency_s() - truth).abs() < 0.02, "{truth}: {} ± {}", e.latency_s(), e.sigma_s());
        }
    }

    #[test]
    fn a_configured_latency_can_be_final() {
        assert_eq!(run(0.2, 0.1, 0.0).latency_s(), 0.1);
    }
}
