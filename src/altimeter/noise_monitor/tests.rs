//! Grown noise is followed, and is over when it is.

use super::*;

/// The square of a number that is as good as drawn from a normal distribution (Box and Muller, of two irrational rotations).
fn square(k: u32) -> f64 {
    let u = |step: f64| (f64::from(k) * step + 0.5).fract();
    -2.0 * u(0.618_033_988_749_895).ln() * (std::f64::consts::TAU * u(0.414_213_562_373_095)).cos().powi(2)
}

/// Samples with this variance over the normal one, until the noise is over; how many that took.
fn follow(noise: &mut NoiseMonitor, factor: f64, most: u32) -> Option<u32> {
    // Variance of the prediction 0.5, of a sample 2.
    (1..=most).find(|k| noise.follow((0.5 + 2.0 * factor) * square(*k), 0.5, 2.0, 9.0))
}

#[test]
fn it_finds_the_factor_and_its_end() {
    for factor in [4.0, 25.0, 100.0] {
        let mut noise = NoiseMonitor::default();
        assert_eq!((noise.factor(), noise.since_s()), (1.0, None));
        noise.grow(2.0 * factor, 6, 12.5);
        assert_eq!((noise.factor(), noise.since_s()), (2.0 * factor, Some(12.5)));
        assert_eq!(follow(&mut noise, factor, 200), None, "{factor}");
        assert!((0.4..2.5).contains(&(noise.factor() / factor)), "{factor}: {}", noise.factor());
        let over = follow(&mut noise, 1.0, 100);
        assert!(over.is_some_and(|n| n <= 70), "{factor}: {over:?}");
        assert_eq!((noise.factor(), noise.since_s()), (1.0, None));
    }
}

#[test]
fn without_any_there_is_nothing_to_follow() {
    let mut noise = NoiseMonitor::default();
    assert!(!noise.follow(1e6, 1.0, 1.0, 9.0));
    assert_eq!(noise.factor(), 1.0);
    // Less than one and a half times is none.
    noise.grow(0.1, 0, 0.0);
    assert_eq!(noise.factor(), LEAST_NOISE_FACTOR);
}
