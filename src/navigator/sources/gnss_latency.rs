//! How old a fix really is: the delay by which a receiver's velocity fits what inertia has felt.
//!
//! With I the inertial acceleration that has added up, L the latency that is assumed, and δ what that is misjudged by, a velocity with the stamp s is that of s − L − δ:
//!
//! v(s) − I(s − L) = c + a t + ψ J I + ε I − δ İ + noise,
//!
//! c and a what tilt and biases make over some seconds, ψ and ε a heading that is off and a scale. They are fitted together by least squares over windows of some seconds: a
//! heading that is off by a degree looks like a delay in many a turn, and neither is taken for the other where both are in the fit. İ is a difference around the time of
//! the fix, for what inertia has added up wrongly before it would be taken for a delay. The variance of δ̂ is what is left over, divided by the information on δ.
//!
//! İ is as noisy as inertia is: accelerometers of density w leave w²/2h in a difference over ± h, which looks like motion and says nothing. Of the information S that n fixes
//! seem to hold, S′ = S − 2 n w²/2h is there: δ̂ S/S′, with S/S′² times what is left over (errors in variables; Fuller 1987, *Measurement Error Models*, section 1.2). A vehicle
//! that flies straight on, or hovers, teaches nothing.
//!
//! What inertia adds up wrongly is not white, so that windows scatter by more than that. By how much more is learned of them, and counts in the standard deviation: a vehicle
//! whose windows contradict each other does not know its receiver's latency, however many there are.

use nalgebra::{SMatrix, SVector, Vector2};

use super::latency::Latency;
use crate::navigator::tuning::gnss_latency::{
    CLIPPED_SIGMA, EXPECTED, FIRM, LEAST_FIXES, LEAST_NOISE_MPS, LEAST_TOLD, LONGEST_S, MEMORY,
    NUISANCE_SIGMA, SLOPE_S, WALK, WINDOW_HOLE_S, WINDOW_S,
};
use crate::time::{AutopilotTime, Span};

/// c and a on both axes, ψ, ε and δ.
const UNKNOWNS: usize = 7;
const DELAY: usize = UNKNOWNS - 1;

/// Latency of one receiver, on top of its own stamps.
#[derive(Clone, Debug)]
pub(in super::super) struct GnssLatency {
    latency: Latency,
    /// The last fix, which waits until what was felt around it is known: when it was measured, and its velocity, NE, m/s.
    waits: Option<(AutopilotTime, Vector2<f64>)>,
    window: Option<Window>,
    /// What is left of windows, as multiples of the variance that they claim, and how many of them that is known from.
    scatter: f64,
    windows: f64,
}

/// Sums of the normal equations since a fix.
#[derive(Clone, Debug)]
struct Window {
    /// When it began, what inertia had added up to then, its epoch, and its difference, NE, m/s.
    from: AutopilotTime,
    impulse: Vector2<f64>,
    difference: Vector2<f64>,
    epoch: u32,
    last: AutopilotTime,
    fixes: u32,
    normal: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    right: SVector<f64, UNKNOWNS>,
    square: f64,
}

impl GnssLatency {
    /// Starts from the configured latency; a `sigma_s` of zero keeps it there.
    pub(super) fn new(latency_s: f64, sigma_s: f64) -> Self {
        let latency = Latency::new(latency_s, sigma_s, LONGEST_S);
        Self { latency, waits: None, window: None, scatter: EXPECTED, windows: FIRM }
    }

    /// The latency to assume, s.
    pub(in super::super) fn latency_s(&self) -> f64 {
        self.latency.seconds()
    }

    /// Its standard deviation, s.
    pub(in super::super) fn sigma_s(&self) -> f64 {
        self.latency.variance().sqrt()
    }

    /// Goes on from a latency and its standard deviation, s, that were learned before.
    pub(super) fn recall(&mut self, kept: [f64; 2]) {
        self.latency.recall(kept);
        self.interrupt();
    }

    /// The next fix cannot be compared with the last one.
    pub(in super::super) fn interrupt(&mut self) {
        (self.waits, self.window) = (None, None);
    }

    /// Takes the velocity of an accepted fix, NE, m/s, and when it was measured by the latency that is assumed; `impulse`: what inertia has added up to at a time, NE, m/s,
    /// in this `epoch`, by accelerometers of this `density`, m/s²/√Hz.
    pub(in super::super) fn observe(
        &mut self,
        measured: AutopilotTime,
        velocity_ne: &Vector2<f64>,
        (epoch, density): (u32, f64),
        impulse: impl Fn(AutopilotTime) -> Option<Vector2<f64>>,
    ) {
        if self.latency.is_fixed() {
            return;
        }
        let Some((time, velocity)) = self.waits.replace((measured, *velocity_ne)) else { return };
        let around = Span::from_seconds(SLOPE_S);
        let felt = (impulse(time - around), impulse(time), impulse(time + around));
        let (Some(before), Some(at), Some(after)) = felt else {
            self.window = None;
            return;
        };
        let slope = (after - before) / (2.0 * SLOPE_S);
        let goes_on =
            |w: &Window| w.epoch == epoch && (1e-3..WINDOW_HOLE_S).contains(&time.seconds_since(w.last));
        self.window = self.window.take().filter(goes_on);
        let Some(window) = &mut self.window else {
            self.window = Some(Window::begin(time, at, velocity - at, epoch));
            return;
        };
        window.add(time, &velocity, &at, &slope);
        if window.fixes >= LEAST_FIXES && time.seconds_since(window.from) >= WINDOW_S {
            let found = window.delay(density);
            // The fix that waits was measured by the latency of before.
            self.interrupt();
            if let Some((delay_s, variance)) = found {
                self.learn(delay_s, variance);
            }
        }
    }

    /// A window says that the latency is longer by so much, s, with this variance, s², were its noise white.
    fn learn(&mut self, delay_s: f64, variance: f64) {
        let known = self.latency.variance();
        let claimed = variance * self.scatter;
        let limit = CLIPPED_SIGMA * (known + claimed).sqrt();
        self.latency.take(delay_s.clamp(-limit, limit), claimed, WALK);
        // Of what it was off by, what the latency itself was not known to is no scatter.
        let seen =
            ((delay_s * delay_s - known) / variance).clamp(0.0, CLIPPED_SIGMA * CLIPPED_SIGMA * self.scatter);
        self.windows = (self.windows + 1.0).min(MEMORY);
        self.scatter = (self.scatter + (seen - self.scatter) / self.windows).max(1.0);
    }
}

impl Window {
    fn begin(from: AutopilotTime, impulse: Vector2<f64>, difference: Vector2<f64>, epoch: u32) -> Self {
        let normal = SMatrix::from_diagonal(&SVector::from(
            NUISANCE_SIGMA.map(|sigma| (LEAST_NOISE_MPS / sigma).powi(2)),
        ));
        let (right, square) = (SVector::zeros(), 0.0);
        Self { from, impulse, difference, epoch, last: from, fixes: 1, normal, right, square }
    }

    /// A fix, what inertia had added up to, and how fast.
    fn add(
        &mut self,
        time: AutopilotTime,
        velocity: &Vector2<f64>,
        impulse: &Vector2<f64>,
        slope: &Vector2<f64>,
    ) {
        let (t, felt) = (time.seconds_since(self.from), impulse - self.impulse);
        let difference = velocity - impulse - self.difference;
        let north = SVector::from([1.0, 0.0, t, 0.0, -felt.y, felt.x, -slope.x]);
        let east = SVector::from([0.0, 1.0, 0.0, t, felt.x, felt.y, -slope.y]);
        for (row, value) in [(north, difference.x), (east, difference.y)] {
            self.normal += row * row.transpose();
            self.right += row * value;
            self.square += value * value;
        }
        self.fixes += 1;
        self.last = time;
    }

    /// δ̂, s, and its variance, s², as the fit leaves it beside the noise of accelerometers; `None` where there is nothing that tells it.
    fn delay(&self, density: f64) -> Option<(f64, f64)> {
        let inverse = self.normal.cholesky()?.inverse();
        let solution = inverse * self.right;
        let rows = f64::from(2 * self.fixes);
        let left = (self.square - solution.dot(&self.right)) / (rows - UNKNOWNS as f64).max(1.0);
        let seems = inverse[(DELAY, DELAY)].recip();
        let noise = rows * density * density / (2.0 * SLOPE_S);
        let there = seems - noise;
        if there.is_nan() || there < LEAST_TOLD * seems {
            return None;
        }
        let variance = left.max(LEAST_NOISE_MPS * LEAST_NOISE_MPS) * seems / (there * there);
        let delay_s = solution[DELAY] * (seems / there);
        (delay_s.is_finite() && variance.is_finite() && variance > 0.0).then_some((delay_s, variance))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// Ten minutes of a flight with this velocity, NE, m/s, at 5 Hz: a receiver that is `true_s` late, felt at a heading that is off by 5 degrees, with a scale, a tilt, and
    /// accelerometers of density `walk`, m/s²/√Hz.
    fn fly(
        [true_s, assumed_s, sigma_s]: [f64; 3],
        walk: f64,
        seed: u64,
        velocity: impl Fn(f64) -> Vector2<f64>,
    ) -> GnssLatency {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let walked: Vec<Vector2<f64>> = (0..60_100)
            .scan(Vector2::zeros(), |sum, _| {
                *sum += Vector2::new(normal(), normal()) * (walk * 0.1);
                Some(*sum)
            })
            .collect();
        let impulse = |time: AutopilotTime| {
            let t = time.micros() as f64 * 1e-6;
            let turned = nalgebra::Rotation2::new(0.09) * velocity(t) * 1.02;
            Some(turned + Vector2::new(0.1, -0.2) * t + walked.get((t * 100.0) as usize)?)
        };
        let mut latency = GnssLatency::new(assumed_s, sigma_s);
        for k in 5..3000 {
            let stamp = 0.2 * f64::from(k);
            let measured = AutopilotTime::from_micros(((stamp - latency.latency_s()) * 1e6) as i64);
            latency.observe(measured, &velocity(stamp - true_s), (1, walk), impulse);
        }
        latency
    }

    fn turns(t: f64) -> Vector2<f64> {
        Vector2::new((0.5 * t).sin() + 0.4 * (1.3 * t).cos(), (0.4 * t).cos()) * 12.0
    }

    #[test]
    fn it_is_found_from_either_side_at_a_heading_that_is_off() {
        for (truth, assumed) in [(0.1, 0.0), (0.0, 0.12), (0.25, 0.1), (0.02, 0.2)] {
            let found = fly([truth, assumed, 0.1], 0.0, 1, turns);
            let error = (found.latency_s() - truth).abs();
            assert!(error < 0.005, "{truth}: {} ± {}", found.latency_s(), found.sigma_s());
        }
    }

    #[test]
    fn it_is_as_uncertain_as_it_is_off_where_inertia_walks() {
        let errors = (0..12).map(|seed| {
            let found = fly([0.12, 0.06, 0.06], 0.6, seed, turns);
            assert!((0.002..0.03).contains(&found.sigma_s()), "{}", found.sigma_s());
            ((found.latency_s() - 0.12) / found.sigma_s()).powi(2)
        });
        let mean = errors.sum::<f64>() / 12.0;
        assert!((0.1..2.0).contains(&mean), "{mean}");
    }

    #[test]
    fn who_flies_straight_on_and_who_is_told_it_learns_nothing() {
        let straight = fly([0.2, 0.1, 0.06], 0.1, 3, |_| Vector2::new(20.0, 0.0));
        assert!(straight.sigma_s() > 0.05, "{} ± {}", straight.latency_s(), straight.sigma_s());
        assert_eq!(fly([0.2, 0.1, 0.0], 0.0, 3, turns).latency_s(), 0.1);
    }

    #[test]
    fn nonsense_teaches_nothing() {
        let mut latency = GnssLatency::new(0.1, 0.06);
        for k in 0..2000_u32 {
            let x = [f64::NAN, f64::INFINITY, 1e300, -50.0][k as usize % 4];
            let (time, v) = (AutopilotTime::from_micros(200_000 * i64::from(k)), Vector2::new(x, -x));
            latency.observe(time, &v, (k / 100, x), |_| Some(v * 0.3));
        }
        assert!((0.0..=LONGEST_S).contains(&latency.latency_s()) && latency.sigma_s().is_finite());
    }
}
