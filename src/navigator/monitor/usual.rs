//! What is usual for a horizontal deviation, learned from itself, and where what is usual ends.
//!
//! A deviation is taken for normal with zero mean and an unknown variance s² an axis, whose conjugate prior (inverse gamma) is worth n₀
//! observations of s₀². After n in all, |d|²/2s² of the next one has Fisher's F distribution with 2 and 2n degrees of freedom, for which
//! P(> x) = (1 + x/n)⁻ⁿ (Bernardo and Smith 1994, *Bayesian Theory*, section 5.2): the less has been seen, the wider the limit.

/// See the module's documentation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct UsualSpread {
    /// Sum of |d|²/2.
    sum: f64,
    n: f64,
}

impl UsualSpread {
    /// A variance an axis of `variance` is expected, as firmly as `n` observations would show it.
    pub(in super::super) const fn expecting(variance: f64, n: f64) -> Self {
        Self { sum: variance * n, n }
    }

    /// The variance of an axis, as it is known.
    pub(in super::super) fn variance(&self) -> f64 {
        self.sum / self.n
    }

    /// The squared deviation that is exceeded with a probability of 10^−`decades`.
    pub(in super::super) fn limit(&self, decades: f64) -> f64 {
        2.0 * self.variance() * self.n * (10f64.powf(decades / self.n) - 1.0)
    }

    /// Takes a squared deviation that was usual; the last `memory` count.
    pub(in super::super) fn learn(&mut self, squared: f64, memory: f64) {
        if !squared.is_finite() {
            return;
        }
        self.sum += 0.5 * squared;
        self.n += 1.0;
        if self.n > memory {
            self.sum *= memory / self.n;
            self.n = memory;
        }
    }
}

/// What is usual for the greatest of several statistics, each of them with the tail of a χ²: Gumbel's law, P(> x) = 1 − exp(−e^−(x − μ)/β), whose mean is
/// μ + γ β and whose variance π² β²/6 (Gumbel 1958, *Statistics of Extremes*, section 5.2), as both are learned. Far out its tail is exponential, so that
/// what is little known of β widens it as it does for [`UsualSpread`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct UsualPeak {
    mean: f64,
    variance: f64,
    n: f64,
}

/// Euler's γ.
const EULER: f64 = 0.577_215_664_901_532_9;

impl UsualPeak {
    /// Peaks of `mean` ± `deviation` are expected, as firmly as `n` of them would show it.
    pub(in super::super) const fn expecting(mean: f64, deviation: f64, n: f64) -> Self {
        Self { mean, variance: deviation * deviation, n }
    }

    /// The peak that is exceeded with a probability of 10^−`decades`.
    pub(in super::super) fn limit(&self, decades: f64) -> f64 {
        let beta = (6.0 * self.variance).sqrt() / std::f64::consts::PI;
        self.mean + beta * (self.n * (10f64.powf(decades / self.n) - 1.0) - EULER)
    }

    /// How rarely a peak is so high: with a probability of 10^−d.
    pub(in super::super) fn decades(&self, peak: f64) -> f64 {
        let beta = (6.0 * self.variance).sqrt() / std::f64::consts::PI;
        let beyond = ((peak - self.mean) / beta + EULER).max(0.0);
        self.n * (1.0 + beyond / self.n).log10()
    }

    /// The same, were β no less than the mean: peaks of a flight that has shown little so far say nothing of what it will show.
    pub(in super::super) fn wide_limit(&self, decades: f64) -> f64 {
        self.limit(decades).max(self.mean * self.n * (10f64.powf(decades / self.n) - 1.0))
    }

    /// Takes a peak that was usual; the last `memory` count.
    pub(in super::super) fn learn(&mut self, peak: f64, memory: f64) {
        if !peak.is_finite() {
            return;
        }
        self.n = (self.n + 1.0).min(memory);
        let (apart, gain) = (peak - self.mean, 1.0 / self.n);
        self.mean += gain * apart;
        self.variance += gain * ((1.0 - gain) * apart * apart - self.variance);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn the_limit_is_exceeded_as_often_as_it_says() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let mut normal = || {
            let (u, v): (f64, f64) = (rng.random_range(1e-12..1.0), rng.random_range(0.0..1.0));
            (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
        };
        let (mut beyond, trials) = (0, 40_000);
        for k in 0..trials {
            // The true variance is drawn anew, and known from ten observations only.
            let scale = 0.5 + f64::from(k % 7);
            let mut usual = UsualSpread::expecting(1.0, 1e-9);
            for _ in 0..10 {
                usual.learn((normal() * scale).powi(2) + (normal() * scale).powi(2), 100.0);
            }
            let next = (normal() * scale).powi(2) + (normal() * scale).powi(2);
            beyond += i32::from(next > usual.limit(2.0));
        }
        let share = f64::from(beyond) / f64::from(trials);
        assert!((0.008..0.012).contains(&share), "{share}");
    }

    #[test]
    fn the_greatest_of_several_exceeds_its_limit_as_often_as_it_says() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let (mut beyond, trials) = (0, 4000);
        for k in 0..trials {
            let (several, scale) = (10 + k % 20, 1.0 + f64::from(k % 5));
            let mut peak = || {
                (0..several).map(|_| -2.0 * scale * rng.random_range(1e-12..1.0f64).ln()).fold(0.0, f64::max)
            };
            let mut usual = UsualPeak::expecting(8.0, 8.0, 2.0);
            for _ in 0..60 {
                usual.learn(peak(), 60.0);
            }
            beyond += i32::from(peak() > usual.limit(2.0));
            assert!((usual.decades(usual.limit(2.5)) - 2.5).abs() < 1e-9);
        }
        let share = f64::from(beyond) / f64::from(trials);
        assert!((0.004..0.014).contains(&share), "{share}");
    }

    #[test]
    fn what_is_little_known_has_a_wide_limit_and_old_times_are_forgotten() {
        let mut usual = UsualSpread::expecting(1.0, 8.0);
        let at_first = usual.limit(6.0);
        for _ in 0..200 {
            usual.learn(2.0, 60.0);
        }
        assert!((usual.variance() - 1.0).abs() < 1e-9 && usual.limit(6.0) < 0.6 * at_first);
        for _ in 0..200 {
            usual.learn(200.0, 60.0);
        }
        assert!(usual.variance() > 90.0);
        usual.learn(f64::NAN, 60.0);
        assert!(usual.variance().is_finite());
    }
}
