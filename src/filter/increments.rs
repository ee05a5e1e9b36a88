//! How much of a signal is white noise and how much of it walks, from how far it moves within a short time and within a longer one.
//!
//! What is white has a variance R, what walks moves by q a second: an axis of x has E (x(t + τ) − x(t))² = 2 R + q τ, its structure function. Measured at
//! two lags it gives both, as the autocorrelation of innovations does (Mehra 1970, "On the identification of variances and adaptive Kalman
//! filtering"), and needs no filter that would have to be right first.

use crate::time::AutopilotTime;

/// Values of the past that are kept: so many to a long lag.
const KEPT: usize = 16;
/// A single increment counts for no more than this many times what is usual: 5 sigmas.
const CLIPPED: f64 = 25.0;
/// Before anything was seen, what was expected counts as much as this long of it, s.
const PRIOR_S: f64 = 3.0;
/// Below this ratio the two lags are the same one.
const APART: f64 = 1.4;

/// The lags that are compared: from one value to the next, and two longer ones.
pub const LAGS: usize = 3;

/// A signal of the recent past, to be compared with its present: the last value, and those of two longer lags ago.
#[derive(Clone, Copy, Debug)]
pub struct Lags<T> {
    longer_s: [f64; LAGS - 1],
    last: Option<(AutopilotTime, T)>,
    past: [Option<(AutopilotTime, T)>; KEPT],
    next: usize,
}

impl<T: Copy> Lags<T> {
    /// Nothing yet; the longer lags, s, are those between two values where values are rarer.
    pub fn new(longer_s: [f64; LAGS - 1]) -> Self {
        Self { longer_s, last: None, past: [None; KEPT], next: 0 }
    }

    /// Takes a value. The value before, and those of at least a longer lag ago and less than twice that, each with how long ago it was, s.
    pub fn observe(&mut self, time: AutopilotTime, value: T) -> [Option<(f64, T)>; LAGS] {
        let gap = self.last.map_or(0.0, |(t, _)| time.seconds_since(t));
        let [middle_s, long_s] = self.longer_s;
        if !(0.0..2.0 * long_s).contains(&gap) {
            self.forget();
        }
        let ago = |(t, value): (AutopilotTime, T)| (time.seconds_since(t), value);
        let short = self.last.replace((time, value)).map(ago);
        let of = |lag_s: f64| {
            let old = self.past.iter().flatten().copied().map(ago).filter(|(s, _)| *s >= lag_s);
            old.min_by(|a, b| a.0.total_cmp(&b.0)).filter(|(s, _)| *s < 2.0 * lag_s)
        };
        let longer = [of(middle_s), of(long_s)];
        let newest = self.past[(self.next + KEPT - 1) % KEPT];
        let spacing_s = long_s / (KEPT - 2) as f64;
        if newest.is_none_or(|(t, _)| time.seconds_since(t) >= spacing_s) {
            self.past[self.next] = Some((time, value));
            self.next = (self.next + 1) % KEPT;
        }
        [short, longer[0], longer[1]]
    }

    /// What was before has nothing to do with what comes.
    pub fn forget(&mut self) {
        (self.last, self.past) = (None, [None; KEPT]);
    }
}

/// Mean square of an increment.
#[derive(Clone, Copy, Debug, Default)]
struct MeanSquare {
    /// What it stands for, and how long it was learned, s.
    square: f64,
    lag_s: f64,
    seconds: f64,
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug)]
pub struct NoiseAndWalk {
    /// Variance, and its growth a second.
    expected: (f64, f64),
    memory_s: f64,
    /// A walk that chance explains is none: how many axes are seen at once.
    axes: Option<f64>,
    /// At each of the lags.
    means: [MeanSquare; LAGS],
}

impl NoiseAndWalk {
    /// Nothing was seen: a variance R and a growth q a second are expected. Old times fade within `memory_s`, s.
    pub fn expecting(variance: f64, growth: f64, memory_s: f64) -> Self {
        Self { expected: (variance, growth), memory_s, axes: None, means: [MeanSquare::default(); LAGS] }
    }

    /// Where growth by chance, 1 sigma of so many axes that are seen at once, is to count for none.
    pub fn beyond_chance(self, axes: f64) -> Self {
        Self { axes: Some(axes), ..self }
    }

    /// An increment over `lag_s` s, squared, an axis: at the lag of that number. It stands for `dt` s.
    pub fn learn(&mut self, at: usize, dt: f64, lag_s: f64, squared: f64) {
        let before = self.means.iter().take(at).rfind(|mean| mean.seconds > 0.0).copied();
        let Some(mean) = self.means.get_mut(at) else { return };
        if !(squared.is_finite() && lag_s > 0.0 && dt > 0.0) {
            return;
        }
        if mean.seconds <= 0.0 {
            // What a shorter lag has shown by now is known of this one, too.
            let (variance, growth) = self.expected;
            let square = match before {
                Some(shorter) => shorter.square + growth * (lag_s - shorter.lag_s).max(0.0),
                None => 2.0 * variance + growth * lag_s,
            };
            *mean = MeanSquare { square, lag_s, seconds: PRIOR_S };
        }
        mean.seconds = (mean.seconds + dt).min(self.memory_s);
        let gain = (dt / mean.seconds).min(1.0);
        mean.square += gain * (squared.min(CLIPPED * mean.square) - mean.square);
        mean.lag_s += gain * (lag_s - mean.lag_s);
    }

    /// R and q, as they are known.
    pub fn parts(&self) -> (f64, f64) {
        let [short, middle, long] = self.means;
        let (_, growth) = self.expected;
        if short.seconds <= 0.0 {
            return self.expected;
        }
        // Of n independent increments the mean square is known to √(2/n) of itself, 1 sigma.
        let by_chance = self.axes.map_or(0.0, |axes| (2.0 * long.lag_s / (axes * self.memory_s)).sqrt());
        let slope = |from: &MeanSquare, to: &MeanSquare, chance: f64| {
            let apart = from.seconds > 0.0 && to.seconds > 0.0 && to.lag_s > APART * from.lag_s;
            apart.then(|| (to.square - (1.0 + chance) * from.square) / (to.lag_s - from.lag_s))
        };
        // What saturates (a latency in a turn, a receiver's smoothing) does not walk.
        // Where values are rarer than the middle lag, there is none.
        let from = if middle.seconds > 0.0 { &middle } else { &short };
        let slopes = [slope(&short, &middle, 0.0), slope(from, &long, by_chance)];
        let least = slopes.into_iter().flatten().reduce(f64::min);
        let growth = least.map_or(growth, |slope| slope.max(0.0));
        let white = 0.5 * (short.square - growth * short.lag_s);
        (white.max(0.0), growth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// Five minutes at `dt` s of white noise and a walk, and what is made of them.
    fn measured(sigma: f64, walk: f64, dt: f64) -> (f64, f64) {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let (mut lags, mut of) = (Lags::new([0.5, 2.0]), NoiseAndWalk::expecting(1.0, 1.0, 100.0));
        let mut x = 0.0;
        for k in 0..(300.0 / dt) as i64 {
            x += walk * dt.sqrt() * normal();
            let seen = x + sigma * normal();
            let time = AutopilotTime::from_micros((k as f64 * dt * 1e6) as i64);
            for (at, earlier) in lags.observe(time, seen).into_iter().enumerate() {
                if let Some((lag_s, earlier)) = earlier {
                    of.learn(at, dt, lag_s, (seen - earlier).powi(2));
                }
            }
        }
        let (variance, growth) = of.parts();
        (variance.max(0.0).sqrt(), growth.sqrt())
    }

    #[test]
    fn noise_and_walk_are_told_apart_at_any_rate() {
        for dt in [0.1, 0.2, 1.0] {
            for (sigma, walk) in [(0.1, 0.05), (0.5, 0.3), (0.1, 0.5), (3.0, 0.001)] {
                let (noise, walked) = measured(sigma, walk, dt);
                let level = walk * dt.sqrt();
                assert!((noise - sigma).abs() < 0.25 * sigma + 0.3 * level, "{dt} {sigma} {walk}: {noise}");
                assert!((walked - walk).abs() < 0.35 * walk + 0.5 * sigma, "{dt} {sigma} {walk}: {walked}");
            }
        }
    }

    #[test]
    fn a_leap_is_no_noise_and_a_hole_no_increment() {
        let (mut lags, mut of) = (Lags::new([0.5, 2.0]), NoiseAndWalk::expecting(1.0, 0.0, 30.0));
        for k in 0..600 {
            let t = f64::from(k) * 0.1 + if k >= 300 { 60.0 } else { 0.0 };
            let x: f64 = if k % 2 == 0 { 1.0 } else { -1.0 } + if k == 100 { 1000.0 } else { 0.0 };
            let x = if k >= 300 { x + 500.0 } else { x };
            let time = AutopilotTime::from_micros((t * 1e6) as i64);
            for (at, earlier) in lags.observe(time, x).into_iter().enumerate() {
                if let Some((lag_s, earlier)) = earlier {
                    of.learn(at, 0.1, lag_s, (x - earlier).powi(2));
                }
            }
        }
        let (variance, _) = of.parts();
        assert!((1.0..3.0).contains(&variance), "{variance}");
        of.learn(0, 0.1, 0.1, f64::NAN);
        of.learn(7, 0.1, 0.1, 1.0);
        assert!(of.parts().0.is_finite());
    }
}
