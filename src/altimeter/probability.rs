//! The probability that a measurement channel operates normally, given its innovation: the weight of the robust filter.

use std::f64::consts::SQRT_2;

/// Posterior probability of normal operation,
///
/// prob = 1/(√(2π) σ) ∫₋ₗˡ exp(−(x − m)²/(2σ²)) dx = Φ((l − m)/σ) − Φ((−l − m)/σ),
///
/// Contreras and Hajiyev (32), with the mean `mean` and the standard deviation `sigma` of the normalised innovation and the bound
/// `limit` (theirs: 3), all without unit. It falls from 0.9973 (m = 0, σ = 1, l = 3) through ½ at |m| = l to 0.
///
/// The difference is taken between the two upper tails, so that it is exact to a few units of the last place where prob is tiny, too.
/// It is never a NaN: σ = 0 asks whether the mean is within the bound, and for a NaN, a negative σ or bound, or an infinite mean the
/// answer is 0: what cannot be judged has no weight.
pub fn normal_operation(mean: f64, sigma: f64, limit: f64) -> f64 {
    let mean = mean.abs();
    if !(mean.is_finite() && sigma >= 0.0 && limit >= 0.0) {
        return 0.0;
    }
    if sigma == 0.0 {
        return f64::from(u8::from(mean <= limit));
    }
    // Φ(x) = ½ erfc(−x/√2); a σ that is infinite, or a bound beside it, leaves 0 or a NaN.
    let tail = |bound: f64| 0.5 * libm::erfc((mean + bound) / (SQRT_2 * sigma));
    let prob = tail(-limit) - tail(limit);
    if prob.is_nan() { 0.0 } else { prob.clamp(0.0, 1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn known_values() {
        for (mean, sigma, want) in [
            (0.0, 1.0, 0.997_300_203_936_739_8),
            (3.0, 1.0, 0.499_999_999_013_412_4),
            (-3.0, 1.0, 0.499_999_999_013_412_4),
            (6.0, 1.0, 0.001_349_898_031_630_093),
            (2.0, 10.0, 0.231_290_298_551_042_1),
        ] {
            assert!((normal_operation(mean, sigma, 3.0) - want).abs() < 1e-14, "{mean} {sigma}");
        }
        // In the tail the error is relative.
        assert!((normal_operation(9.0, 1.0, 3.0) / 9.865_876_450_376_946e-10 - 1.0).abs() < 1e-12);
    }

    #[test]
    fn it_is_the_integral() {
        let (mean, sigma, limit) = (1.7, 0.8, 3.0);
        let n = 20_000;
        let step = 2.0 * limit / f64::from(n);
        let density =
            |x: f64| (-0.5 * ((x - mean) / sigma).powi(2)).exp() / (2.506_628_274_631_000_5 * sigma);
        let sum: f64 = (0..n).map(|i| density(-limit + step * (f64::from(i) + 0.5)) * step).sum();
        assert!((normal_operation(mean, sigma, limit) - sum).abs() < 1e-8);
    }

    #[test]
    fn the_edges_have_an_answer() {
        assert_eq!(normal_operation(2.0, 0.0, 3.0), 1.0);
        assert_eq!(normal_operation(4.0, 0.0, 3.0), 0.0);
        assert_eq!(normal_operation(0.0, f64::INFINITY, 3.0), 0.0);
        assert_eq!(normal_operation(f64::NAN, 1.0, 3.0), 0.0);
        assert_eq!(normal_operation(0.0, 1.0, f64::INFINITY), 1.0);
    }

    proptest! {
        #[test]
        fn it_is_a_probability_of_anything(mean: f64, sigma: f64, limit: f64) {
            let prob = normal_operation(mean, sigma, limit);
            prop_assert!((0.0..=1.0).contains(&prob), "{prob}");
        }

        #[test]
        fn it_falls_with_the_innovation(a in 0.0..12.0, b in 0.0..12.0, sigma in 0.1..5.0) {
            let (low, high) = if a < b { (a, b) } else { (b, a) };
            prop_assert!(normal_operation(low, sigma, 3.0) >= normal_operation(high, sigma, 3.0) - 1e-15);
            prop_assert_eq!(normal_operation(-low, sigma, 3.0), normal_operation(low, sigma, 3.0));
        }
    }
}
