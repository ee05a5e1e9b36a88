//! How noisy the difference of a receiver's velocity and inertia is, by how hard the vehicle manoeuvres.
//!
//! Its times jitter, what was felt is sampled: an error of time δt is one of velocity, a δt, so that with a² the mean square of the acceleration in a window the variance
//! on an axis is n + k a². Both are learned of the mean squares of windows by least squares, weighted by 1/(n + k a²)² as the variance of a mean square is, with
//! old ones fading. What the last seconds show besides, whatever it is, is noise as well.

use nalgebra::{Matrix2, Vector2};

use crate::navigator::tuning::velocity_step::{
    LEAST_NOISE_MPS, NOISE_FIRM, NOISE_GAIN, NOISE_MEMORY, START_JITTER_S, START_NOISE_MPS,
};

/// See the module's documentation.
#[derive(Clone, Copy, Debug)]
pub(super) struct DifferenceNoise {
    /// Normal equations of n, (m/s)², and k, s².
    information: Matrix2<f64>,
    vector: Vector2<f64>,
    n: f64,
    k: f64,
    /// Mean square of the last seconds, and how often it was seen.
    lately: f64,
    looks: u32,
}

impl Default for DifferenceNoise {
    fn default() -> Self {
        let (n, k) = (START_NOISE_MPS * START_NOISE_MPS, START_JITTER_S * START_JITTER_S);
        // As firmly as so many windows at rest and in a turn of 1 g would tell.
        let information = Matrix2::new(1.0 / (n * n), 0.0, 0.0, 1.0 / (k * k)) * NOISE_FIRM;
        Self { information, vector: information * Vector2::new(n, k), n, k, lately: n, looks: 0 }
    }
}

impl DifferenceNoise {
    /// Variance on an axis, (m/s)², where the acceleration has this mean square, m²/s⁴.
    pub(super) fn of(&self, manoeuvre: f64) -> f64 {
        self.model(manoeuvre).max(self.lately)
    }

    fn model(&self, manoeuvre: f64) -> f64 {
        (self.n + self.k * manoeuvre).max(LEAST_NOISE_MPS * LEAST_NOISE_MPS)
    }

    /// A window's mean square, (m/s)².
    pub(super) fn learn(&mut self, manoeuvre: f64, mean_square: f64) {
        if !(manoeuvre + mean_square).is_finite() {
            return;
        }
        let expected = self.model(manoeuvre);
        self.looks = self.looks.saturating_add(1);
        let gain = NOISE_GAIN.max(1.0 / f64::from(self.looks + 1));
        self.lately += gain * (mean_square.min(9.0 * self.lately) - self.lately);
        let square = mean_square.min(9.0 * expected);
        let row = Vector2::new(1.0, manoeuvre) / expected;
        let keeps = 1.0 - 1.0 / NOISE_MEMORY;
        self.information = self.information * keeps + row * row.transpose();
        self.vector = self.vector * keeps + row * (square / expected);
        let Some(inverse) = self.information.try_inverse() else { return };
        let [n, k]: [f64; 2] = (inverse * self.vector).into();
        // Neither is below zero: where one would be, the other explains all.
        (self.n, self.k) = if k < 0.0 {
            (self.vector.x / self.information.m11, 0.0)
        } else if n < 0.0 {
            (0.0, self.vector.y / self.information.m22)
        } else {
            (n, k)
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is learned of windows in calm and in turns of 8 m/s², of a receiver with this noise, m/s, and jitter, s.
    fn learned(noise: f64, jitter: f64) -> DifferenceNoise {
        let mut learned = DifferenceNoise::default();
        for k in 0..1500 {
            let manoeuvre = if k % 100 < 80 { 0.1 } else { 64.0 };
            let spread = 1.0 + 0.3 * f64::from(k % 7 - 3) / 3.0;
            learned.learn(manoeuvre, (noise * noise + jitter * jitter * manoeuvre) * spread);
        }
        learned
    }

    #[test]
    fn noise_and_jitter_are_told_apart() {
        let jittery = learned(0.1, 0.04);
        assert!((jittery.model(0.0).sqrt() - 0.1).abs() < 0.01, "{}", jittery.model(0.0).sqrt());
        assert!((jittery.model(64.0).sqrt() - 0.335).abs() < 0.03, "{}", jittery.model(64.0).sqrt());
        // One that has none is as noisy in a turn, whatever was expected.
        let exact = learned(0.1, 0.0);
        assert!(exact.model(64.0).sqrt() < 0.12, "{}", exact.model(64.0).sqrt());
    }

    #[test]
    fn what_the_last_seconds_show_is_noise_and_what_is_no_number_is_not() {
        let mut noisy = learned(0.1, 0.0);
        for _ in 0..60 {
            noisy.learn(0.1, 0.25);
        }
        assert!(noisy.of(0.0) > 0.1, "{}", noisy.of(0.0));
        let before = noisy.of(1.0);
        noisy.learn(f64::NAN, 0.1);
        noisy.learn(0.1, f64::INFINITY);
        assert_eq!(noisy.of(1.0), before);
    }
}
