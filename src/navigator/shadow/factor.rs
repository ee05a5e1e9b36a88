//! By what factor the drift exceeds what is claimed, from the errors that were measured: Bayes' rule on a grid.
//!
//! An error d of a dead reckoning of age h, NE, is d ~ N(0, k_h² G + R): G is how much the claimed covariance has grown since its start, R what the
//! comparison itself is wrong by (the start, the receiver). The factors of the horizons are a Markov chain in log₂ k: the shortest one's is 1 to within
//! a prior before anything was measured, and the next one's is the last one's to within a quarter. So a horizon that was never reached is known by those
//! before it, less well, and a single lucky comparison moves little. Old comparisons are forgotten, exponentially: an error of the drift is no
//! constant, and who hovered may race.
//!
//! What is used is not the most likely k, but the factor that makes two sigmas hold as often as two sigmas should, over all that k may be: the
//! posterior's tail counts, so it is large while little is known. It is never below 2^LEAST_LOG2.

use nalgebra::{Matrix2, Vector2};

use crate::navigator::tuning::shadow::{CHANGE_LOG2, FACTORS, HORIZONS_S, LEAST_LOG2, LOG2_STEP, MEMORY};

const HORIZONS: usize = HORIZONS_S.len();

/// North and east of an error come of one tilt, one heading, one wind: two numbers of one degree of freedom.
const ONE_OF_TWO: f64 = 0.5;

/// See the module's documentation.
#[derive(Clone, Copy, Debug)]
pub(super) struct DriftFactor {
    /// Before anything was measured, standard deviation of log₂ k.
    prior_log2: f64,
    /// Of every horizon and factor.
    log_likelihood: [[f64; FACTORS]; HORIZONS],
    /// Comparisons, and the mean square of their errors, m².
    measured: [(u32, f64); HORIZONS],
    /// What is used, by horizon.
    factors: [f64; HORIZONS],
}

/// An error of a dead reckoning.
#[derive(Clone, Copy, Debug)]
pub(super) struct DriftError {
    /// NE, m.
    pub(super) error: Vector2<f64>,
    /// What the claimed covariance has grown by since the start, NE, m².
    pub(super) growth: Matrix2<f64>,
    /// What the comparison is wrong by, NE, m².
    pub(super) rest: Matrix2<f64>,
}

fn log2_factor(i: usize) -> f64 {
    LEAST_LOG2 + LOG2_STEP * i as f64
}

/// A normal distribution on the grid.
fn normal(i: usize, mean_log2: f64, sigma_log2: f64) -> f64 {
    (-0.5 * ((log2_factor(i) - mean_log2) / sigma_log2).powi(2)).exp()
}

fn scaled(mut p: [f64; FACTORS]) -> [f64; FACTORS] {
    let sum: f64 = p.iter().sum();
    p.iter_mut().for_each(|p| *p /= sum);
    p
}

/// From one horizon to its neighbour.
fn changed(p: &[f64; FACTORS]) -> [f64; FACTORS] {
    scaled(std::array::from_fn(|i| (0..FACTORS).map(|j| p[j] * normal(i, log2_factor(j), CHANGE_LOG2)).sum()))
}

/// The factor f by which two sigmas hold an error as often as two sigmas of a normal distribution in the plane do, 1 − e⁻⁴, though k is known no better
/// than this: Σ p(k) exp(−4 f²/k²) = e⁻⁴. Where k is known f is k.
fn honest(p: &[f64; FACTORS]) -> f64 {
    let outside = |f: f64| -> f64 {
        p.iter().enumerate().map(|(i, p)| p * (-4.0 * (f / log2_factor(i).exp2()).powi(2)).exp()).sum()
    };
    let (mut least, mut most) = (LEAST_LOG2, log2_factor(FACTORS - 1));
    for _ in 0..12 {
        let middle = 0.5 * (least + most);
        if outside(middle.exp2()) > (-4.0_f64).exp() { least = middle } else { most = middle }
    }
    most.exp2()
}

impl DriftFactor {
    /// Nothing was measured; the factor is 1 to within 2^`prior_log2`, 1 sigma.
    pub(super) fn new(prior_log2: f64) -> Self {
        let mut new = Self {
            prior_log2,
            log_likelihood: [[0.0; FACTORS]; HORIZONS],
            measured: [(0, 0.0); HORIZONS],
            factors: [1.0; HORIZONS],
        };
        new.weigh();
        new
    }

    /// By what the standard deviation is to be multiplied at an age of `age_s`, s.
    pub(super) fn at(&self, age_s: f64) -> f64 {
        let log = |s: f64| s.max(1e-3).ln();
        let Some(next) = HORIZONS_S.iter().position(|h| age_s < *h) else {
            return self.factors[HORIZONS - 1];
        };
        if next == 0 {
            return self.factors[0];
        }
        let part =
            (log(age_s) - log(HORIZONS_S[next - 1])) / (log(HORIZONS_S[next]) - log(HORIZONS_S[next - 1]));
        self.factors[next - 1] + part * (self.factors[next] - self.factors[next - 1])
    }

    /// How many errors at a horizon were measured, and their root mean square, m, where there are any.
    pub(super) fn measured(&self, horizon: usize) -> (u32, Option<f64>) {
        let (n, square) = self.measured[horizon];
        (n, (n > 0).then(|| square.sqrt()))
    }

    /// What the comparisons say by themselves, as a normal distribution of log₂ k at each horizon: mean and standard deviation.
    pub(super) fn memory(&self) -> [Option<[f64; 2]>; HORIZONS] {
        std::array::from_fn(|h| {
            let (first, last) = (self.log_likelihood[h][0], self.log_likelihood[h][FACTORS - 1]);
            // Equal everywhere: nothing was measured.
            if first == last {
                return None;
            }
            let p = scaled(self.log_likelihood[h].map(f64::exp));
            let mean: f64 = p.iter().enumerate().map(|(i, p)| p * log2_factor(i)).sum();
            let square: f64 = p.iter().enumerate().map(|(i, p)| p * (log2_factor(i) - mean).powi(2)).sum();
            Some([mean, square.sqrt().max(LOG2_STEP)])
        })
    }

    /// What comparisons of before said. What cannot have been said is not taken.
    pub(super) fn recall(&mut self, memory: &[Option<[f64; 2]>; HORIZONS]) {
        for (of, memory) in self.log_likelihood.iter_mut().zip(memory) {
            let possible = |[mean, sigma]: &[f64; 2]| mean.abs() < 10.0 && (LOG2_STEP..10.0).contains(sigma);
            if let Some([mean, sigma]) = memory.filter(possible) {
                *of = std::array::from_fn(|i| -0.5 * ((log2_factor(i) - mean) / sigma).powi(2));
            }
        }
        self.weigh();
    }

    /// Takes an error at a horizon.
    pub(super) fn learn(&mut self, horizon: usize, e: &DriftError) {
        let mut fits = [0.0; FACTORS];
        for (i, fit) in fits.iter_mut().enumerate() {
            let s = e.growth * (2.0 * log2_factor(i)).exp2() + e.rest;
            let sound = s.determinant() > 0.0 && s.trace() > 0.0;
            let Some(inverse) = s.try_inverse().filter(|_| sound) else { return };
            *fit = -0.5 * ONE_OF_TWO * (e.error.dot(&(inverse * e.error)) + s.determinant().ln());
        }
        if !fits.iter().all(|f| f.is_finite()) {
            return;
        }
        let (n, square) = &mut self.measured[horizon];
        *n += 1;
        *square += (e.error.norm_squared() - *square) / f64::from(*n).min(MEMORY);
        let kept = 1.0 - 1.0 / MEMORY;
        for (l, fit) in self.log_likelihood[horizon].iter_mut().zip(fits) {
            *l = *l * kept + fit;
        }
        let most = self.log_likelihood[horizon].iter().copied().fold(f64::NEG_INFINITY, f64::max);
        self.log_likelihood[horizon].iter_mut().for_each(|l| *l -= most);
        self.weigh();
    }

    /// Marginals of the chain: forward and backward.
    fn weigh(&mut self) {
        let likelihood = self.log_likelihood.map(|of| of.map(f64::exp));
        let times = |a: &[f64; FACTORS], b: &[f64; FACTORS]| scaled(std::array::from_fn(|i| a[i] * b[i]));
        let mut forward = [scaled(std::array::from_fn(|i| normal(i, 0.0, self.prior_log2))); HORIZONS];
        for h in 1..HORIZONS {
            forward[h] = changed(&times(&forward[h - 1], &likelihood[h - 1]));
        }
        let mut backward = [[1.0; FACTORS]; HORIZONS];
        for h in (1..HORIZONS).rev() {
            backward[h - 1] = changed(&times(&backward[h], &likelihood[h]));
        }
        for h in 0..HORIZONS {
            let p = times(&times(&forward[h], &backward[h]), &likelihood[h]);
            self.factors[h] = honest(&p);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::navigator::tuning::shadow::{PRIOR_LOG2, PRIOR_LOG2_FLOW};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// Errors of 10 m a sigma by what is claimed, which are `k` times that, and 1 m of the comparison's own.
    fn learn(factor: &mut DriftFactor, horizon: usize, k: f64, n: u32, rng: &mut ChaCha8Rng) {
        for _ in 0..n {
            let mut normal = || -> f64 { StandardNormal.sample(&mut *rng) };
            let error = Vector2::new(normal(), normal()) * (10.0 * k) + Vector2::new(normal(), normal());
            let (growth, rest) = (Matrix2::identity() * 100.0, Matrix2::identity());
            factor.learn(horizon, &DriftError { error, growth, rest });
        }
    }

    #[test]
    fn the_factor_is_found_and_is_above_it_while_little_is_known() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for k in [0.7, 1.0, 4.0, 8.0] {
            let mut factor = DriftFactor::new(PRIOR_LOG2);
            learn(&mut factor, 0, k, 40, &mut rng);
            assert!((0.9..1.5).contains(&(factor.at(10.0) / k)), "{k}: {}", factor.at(10.0));
            assert!(factor.at(120.0) > factor.at(10.0), "{k}: what was not measured is known less well");
        }
        assert!(DriftFactor::new(PRIOR_LOG2).at(5.0) > DriftFactor::new(PRIOR_LOG2_FLOW).at(5.0));
        assert!(DriftFactor::new(PRIOR_LOG2_FLOW).at(5.0) > 1.0);
    }

    #[test]
    fn two_sigmas_hold_after_few_comparisons_and_after_many() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for n in [1, 3, 10, 40] {
            let (mut inside, mut all) = (0.0, 0.0);
            for flight in 0..400 {
                let k = f64::from(flight % 40 - 13) / 13.0;
                let k = k.exp2();
                let mut factor = DriftFactor::new(PRIOR_LOG2);
                learn(&mut factor, 0, k, n, &mut rng);
                let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
                let error = Vector2::new(normal(), normal()).norm() * k;
                all += 1.0;
                // The expected length of the error is √2 times an axis' sigma.
                inside += f64::from(u8::from(error < 2.0 * 2f64.sqrt() * factor.at(10.0)));
            }
            assert!(inside / all > 0.955, "{n}: {}", inside / all);
        }
    }

    #[test]
    fn a_vehicle_that_was_rough_is_believed_again_and_one_that_becomes_rough_is_not() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut factor = DriftFactor::new(PRIOR_LOG2);
        learn(&mut factor, 0, 1.0, 40, &mut rng);
        learn(&mut factor, 0, 8.0, 4, &mut rng);
        assert!(factor.at(10.0) > 2.5, "{}", factor.at(10.0));
        learn(&mut factor, 0, 1.0, 80, &mut rng);
        assert!(factor.at(10.0) < 1.6, "{}", factor.at(10.0));
    }

    #[test]
    fn what_was_learned_is_kept() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut factor = DriftFactor::new(PRIOR_LOG2);
        learn(&mut factor, 0, 4.0, 40, &mut rng);
        let mut other = DriftFactor::new(PRIOR_LOG2);
        other.recall(&factor.memory());
        for age_s in [10.0, 60.0] {
            assert!((other.at(age_s) / factor.at(age_s) - 1.0).abs() < 0.15, "{age_s}: {}", other.at(age_s));
        }
        let before = other.at(10.0);
        other.recall(&[Some([f64::NAN, 1.0]), Some([1.0, 0.0]), Some([1.0, f64::INFINITY]), None]);
        assert_eq!(other.at(10.0), before);
        assert_eq!(DriftFactor::new(PRIOR_LOG2).memory(), [None; 4]);
    }

    #[test]
    fn nothing_narrows_below_the_bound_and_nonsense_changes_nothing() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut factor = DriftFactor::new(PRIOR_LOG2);
        learn(&mut factor, 1, 0.05, 200, &mut rng);
        assert!(factor.at(30.0) >= LEAST_LOG2.exp2() && factor.at(30.0) < 0.6, "{}", factor.at(30.0));
        let before = factor.at(30.0);
        for error in [f64::NAN, f64::INFINITY, 1e300] {
            let error = Vector2::repeat(error);
            factor.learn(1, &DriftError { error, growth: Matrix2::identity(), rest: Matrix2::identity() });
        }
        let (growth, rest) = (-Matrix2::identity(), Matrix2::zeros());
        factor.learn(1, &DriftError { error: Vector2::zeros(), growth, rest });
        assert_eq!(factor.at(30.0), before);
        assert_eq!(factor.measured(1).0, 200);
    }
}
