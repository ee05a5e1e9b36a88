//! How noisy a magnetometer is, and how fast what is wrong with it changes: currents of motors, iron nearby.
//!
//! A field turned back by what the gyros felt should stay as it was. What it moves by within a sample is noise; what it moves by more within
//! [`LAGS_S`] is a bias that walks (see [`NoiseAndWalk`]): 0.05 µT/√s on clean vehicles, 4 on one whose motors bend the field. The filter's own
//! heading has no part in it: a magnetometer that it follows would fit it well, however wrong.

use nalgebra::{Matrix3, Vector3};

use crate::filter::{Lags, NoiseAndWalk};
use crate::geo::{polar_rotation, so3};
use crate::time::AutopilotTime;

use crate::navigator::tuning::magnetic_noise::{LAGS_S, LEAST_T, LEAST_WALK, MEMORY_S, MOST_WALK, SPACING_S};

/// See the module's documentation.
#[derive(Clone, Copy, Debug)]
pub(super) struct MagneticNoise {
    /// Body to where the body was at first, by gyros alone.
    turned: Matrix3<f64>,
    last: Option<AutopilotTime>,
    fields: Lags<Vector3<f64>>,
    noise: NoiseAndWalk,
}

impl MagneticNoise {
    /// Nothing was heard: noise, T, and walk, T/√s, as configured.
    pub(super) fn expecting(sigma_t: f64, walk_t: f64) -> Self {
        Self {
            turned: Matrix3::identity(),
            last: None,
            fields: Lags::new(LAGS_S),
            noise: NoiseAndWalk::expecting(sigma_t * sigma_t, walk_t * walk_t, MEMORY_S).beyond_chance(3.0),
        }
    }

    /// When a field is due again.
    pub(super) fn is_due(&self, time: AutopilotTime) -> bool {
        self.last.is_none_or(|t| time.seconds_since(t) >= SPACING_S || time < t)
    }

    /// A field, body, T, less the bias that is known of it, and the mean rate of the body since one time, rad/s.
    pub(super) fn observe(
        &mut self,
        time: AutopilotTime,
        field: &Vector3<f64>,
        rate_since: impl Fn(AutopilotTime) -> Option<Vector3<f64>>,
        gyro_density: f64,
    ) {
        let before = self.last.replace(time);
        let Some((since, rate)) = before.and_then(|t| Some((t, rate_since(t)?))) else {
            return self.fields.forget();
        };
        let dt = time.seconds_since(since);
        let turned = self.turned * so3::exp(&(rate * dt));
        self.turned = polar_rotation(&turned).unwrap_or_else(Matrix3::identity);
        let turned = self.turned * field;
        for (at, earlier) in self.fields.observe(time, turned).into_iter().enumerate() {
            if let Some((lag_s, earlier)) = earlier {
                // Gyro noise turns the field by an angle of this variance a second about each of two axes.
                let by_gyros = 2.0 * field.norm_squared() * gyro_density.powi(2) * lag_s;
                let moved = ((turned - earlier).norm_squared() - by_gyros) / 3.0;
                self.noise.learn(at, dt, lag_s, moved);
            }
        }
    }

    /// Standard deviation of a sample, an axis, T, and the random walk of the bias, T/√s.
    pub(super) fn sigma(&self) -> (f64, f64) {
        let (white, growth) = self.noise.parts();
        (white.sqrt().max(LEAST_T), growth.sqrt().clamp(LEAST_WALK, MOST_WALK))
    }

    /// What comes is not compared with what was.
    pub(super) fn interrupt(&mut self) {
        self.last = None;
        self.fields.forget();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// Three minutes at 10 Hz, turning at `rate` rad/s, of a field with this noise and a bias that walks, µT and µT/√s.
    fn heard(sigma: f64, walk: f64, rate: f64) -> (f64, f64) {
        let mut of = MagneticNoise::expecting(2.5e-6, 0.02e-6);
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let mut three = || -> Vector3<f64> { Vector3::from_fn(|_, _| StandardNormal.sample(&mut rng)) };
        let mut bias = Vector3::zeros();
        for k in 0..1800_i64 {
            let t = k as f64 * 0.1;
            bias += three() * (walk * 0.1_f64.sqrt());
            let earth = so3::exp(&Vector3::new(0.0, 0.0, -rate * t)) * Vector3::new(20.0, 0.0, 45.0);
            let field = (earth + bias + three() * sigma) * 1e-6;
            let turning = |_| Some(Vector3::new(0.0, 0.0, rate));
            of.observe(AutopilotTime::from_micros(k * 100_000), &field, turning, 1e-4);
        }
        let (sigma_t, walk_t) = of.sigma();
        (sigma_t * 1e6, walk_t * 1e6)
    }

    #[test]
    fn a_clean_field_has_noise_whether_the_vehicle_turns_or_not_and_a_bent_one_walks() {
        for rate in [0.0, 0.7] {
            let (sigma, walk) = heard(1.4, 0.0, rate);
            assert!((sigma - 1.4).abs() < 0.2 && walk < 0.2, "{rate}: {sigma} {walk}");
        }
        let (sigma, walk) = heard(0.4, 3.0, 0.0);
        assert!(sigma < 1.0 && (1.8..4.5).contains(&walk), "{sigma} {walk}");
    }

    #[test]
    fn what_gyros_make_of_it_is_not_the_field() {
        let mut of = MagneticNoise::expecting(0.3e-6, 0.02e-6);
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        for k in 0..1800_i64 {
            // Still, with gyros of 0.01 rad/s/√Hz.
            let rate = Vector3::from_fn(|_, _| StandardNormal.sample(&mut rng)) * (0.01 / 0.1_f64.sqrt());
            let field = Vector3::new(20e-6, 0.0, 45e-6);
            of.observe(AutopilotTime::from_micros(k * 100_000), &field, |_| Some(rate), 0.01);
        }
        assert!(of.sigma().1 < 0.2e-6, "{:?}", of.sigma());
    }
}
