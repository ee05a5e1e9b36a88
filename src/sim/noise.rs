//! Seeded randomness: one stream of numbers a sensor, so that changing one sensor leaves the noise of the others alone.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Which sensor draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stream {
    Imu = 1,
    Gnss,
    Flow,
    Barometer = 5,
    Magnetometer,
    Range,
    Airspeed,
    Altimeter,
    Landmarks,
    LandmarkMotion,
    LandmarkStart,
    OwnFilter,
    Wind,
    Link,
}

/// Random numbers of one sensor.
#[derive(Clone, Debug)]
pub(super) struct SensorRng(ChaCha8Rng);

impl SensorRng {
    /// The sensor's own stream of the seed.
    pub(super) fn new(seed: u64, stream: Stream) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(stream as u64);
        Self(rng)
    }

    /// The stream of one of many runs with the seed.
    pub(super) fn of_run(seed: u64, stream: Stream, number: u32) -> Self {
        let mut rng = Self::new(seed, stream);
        rng.0.set_stream(stream as u64 | u64::from(number) << 32);
        rng
    }

    /// A standard normal number.
    pub(super) fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// Three of them.
    pub(super) fn normals(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.normal())
    }

    /// Evenly between the bounds.
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// True with a probability.
    pub(super) fn chance(&mut self, probability: f64) -> bool {
        self.between(0.0, 1.0) < probability
    }

    /// A constant error of this size with a random sign.
    pub(super) fn signed(&mut self, size: f64) -> f64 {
        if self.chance(0.5) { -size } else { size }
    }

    /// Constant errors of these sizes with random signs.
    pub(super) fn signed3(&mut self, size: &Vector3<f64>) -> Vector3<f64> {
        size.map(|s| self.signed(s))
    }
}

/// A first-order Gauss-Markov process: the level of its fluctuation and how long (in seconds, or metres where it goes with the
/// way) it remembers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaussMarkov {
    /// Standard deviation.
    pub sigma: f64,
    /// Correlation time, s, or length, m.
    pub correlation: f64,
}

impl GaussMarkov {
    /// No fluctuation.
    pub const NONE: Self = Self { sigma: 0.0, correlation: 1.0 };

    /// Its next value, `step` (s or m) after `x`: e^(−step/τ) x + σ √(1 − e^(−2 step/τ)) n with n standard normal.
    pub(super) fn next(&self, x: f64, step: f64, n: f64) -> f64 {
        let keep = (-step / self.correlation).exp();
        keep * x + self.sigma * (1.0 - keep * keep).max(0.0).sqrt() * n
    }

    /// The same for three independent processes, scaled by axis.
    pub(super) fn next3(&self, x: &Vector3<f64>, step: f64, n: &Vector3<f64>) -> Vector3<f64> {
        x.zip_map(n, |x, n| self.next(x, step, n))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gauss_markov_keeps_its_level_and_forgets_at_its_rate() {
        let gm = GaussMarkov { sigma: 2.0, correlation: 5.0 };
        let mut rng = SensorRng::new(3, Stream::Flow);
        let mut x = gm.sigma * rng.normal();
        let values: Vec<f64> = (0..200_000)
            .map(|_| {
                x = gm.next(x, 0.5, rng.normal());
                x
            })
            .collect();
        let covariance = |lag: usize| {
            let n = values.len() - lag;
            values.iter().zip(&values[lag..]).map(|(a, b)| a * b).sum::<f64>() / n as f64
        };
        assert!((covariance(0) / 4.0 - 1.0).abs() < 0.05, "{}", covariance(0));
        assert!((covariance(10) / covariance(0) - (-1f64).exp()).abs() < 0.03);
    }

    #[test]
    fn streams_of_one_seed_differ_and_repeat() {
        let draw = |stream| SensorRng::new(9, stream).normals();
        assert_eq!(draw(Stream::Imu), draw(Stream::Imu));
        assert_ne!(draw(Stream::Imu), draw(Stream::Gnss));
    }
}
