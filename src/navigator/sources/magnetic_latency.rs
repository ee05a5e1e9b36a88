//! How late a magnetometer is: its field turns after the vehicle does.
//!
//! Autopilots average their compass and tell the mean for a while: a tenth of a second is usual, and in a flip of 400 °/s 40 degrees. A field that is τ late
//! shows b(t − τ), so that from one sample b′ to the next b the vehicle has turned by exp(θ(t′ − τ, t − τ)), θ what the gyros felt between two times, and
//!
//! r(τ) = exp(θ(t′ − τ, t − τ)) b − b′
//!
//! is noise. It is −ε r′(τ̂) where τ is misjudged by ε, and r′ is large when the vehicle begins or ends to turn: a scalar Kalman filter, as for the other
//! latencies. One that turns steadily, or not at all, teaches it nothing.
//!
//! No latency is the same every time. What is left of r beyond the noise, over |ω × b| √2, is by how much it scatters: a measurement of this vehicle as well.

use nalgebra::Vector3;

use super::latency::Latency;
use crate::geo::so3;
use crate::navigator::tuning::magnetic_latency::{
    CLIPPED, LEAST_CHANGE, LEAST_SCATTER_S, LONGEST_S, SCATTER_AFTER, SCATTER_MEMORY, SCATTER_S, SIGMA_S,
    SLOPE_S,
};
use crate::navigator::tuning::magnetic_noise::SPACING_S;
use crate::navigator::tuning::magnetometer::STUCK_LOOK_S;
use crate::time::{AutopilotTime, Span};

/// See the module's documentation.
#[derive(Clone, Copy, Debug)]
pub(super) struct MagneticLatency {
    latency: Latency,
    /// Variance of a single one, s², and the weight that this has, rad²/s².
    scatter: f64,
    weight: f64,
    /// When a field was taken for measured if it were not late, and that field, body, T.
    last: Option<(AutopilotTime, Vector3<f64>)>,
}

impl MagneticLatency {
    /// Nothing was heard.
    pub(super) fn new() -> Self {
        Self {
            latency: Latency::new(0.0, SIGMA_S, LONGEST_S),
            scatter: SCATTER_S * SCATTER_S,
            weight: SCATTER_AFTER,
            last: None,
        }
    }

    /// The latency to assume, s.
    pub(super) fn latency_s(&self) -> f64 {
        self.latency.seconds()
    }

    /// By how much a field may be later or earlier than that, 1 sigma, s.
    pub(super) fn sigma_s(&self) -> f64 {
        (self.latency.variance() + self.scatter).sqrt()
    }

    /// A field that was not told before, body, T, less the bias that is known of it, its noise, T, and the rotation between two times, body, rad.
    pub(super) fn observe(
        &mut self,
        time: AutopilotTime,
        field: &Vector3<f64>,
        noise_t: f64,
        turned: impl Fn(AutopilotTime, AutopilotTime) -> Option<Vector3<f64>>,
    ) {
        let Some((since, before)) = self.last else {
            self.last = Some((time, *field));
            return;
        };
        let dt = time.seconds_since(since);
        if (0.0..SPACING_S).contains(&dt) {
            return;
        }
        self.last = Some((time, *field));
        let strength = field.norm();
        if !(SPACING_S..STUCK_LOOK_S).contains(&dt) || strength <= 0.0 {
            return;
        }
        let rest = |late_s: f64| {
            let late = Span::from_seconds(late_s);
            let theta = turned(since - late, time - late)?;
            Some(((so3::exp(&theta) * field - before) / strength, theta.cross(field) / (strength * dt)))
        };
        let late_s = self.latency.seconds();
        if let (Some((rest, drift)), Some((earlier, _))) = (rest(late_s), rest(late_s + SLOPE_S)) {
            self.learn(&rest, &((earlier - rest) / SLOPE_S), &drift, 2.0 * (noise_t / strength).powi(2));
        }
    }

    /// What does not fit, rad, its derivative by the latency and how fast the field turns, rad/s, and the variance of noise, rad².
    fn learn(&mut self, rest: &Vector3<f64>, slope: &Vector3<f64>, drift: &Vector3<f64>, noise: f64) {
        let size = slope.norm();
        let weight = 2.0 * drift.norm_squared();
        if size >= LEAST_CHANGE {
            let sigma = (noise + weight * self.scatter).sqrt();
            self.latency.observe(rest.dot(slope) / size, -size, sigma);
        }
        // Where the turn shows beside the noise.
        if weight * SCATTER_S * SCATTER_S > noise {
            let along = rest.dot(drift).powi(2) / drift.norm_squared();
            self.weight = (self.weight + weight).min(SCATTER_MEMORY);
            // What a gyro that goes wrong makes of a turn is not learned at once.
            let seen = ((along - noise) / weight).min(CLIPPED * self.scatter);
            let learned = self.scatter + (seen - self.scatter) * (weight / self.weight).min(1.0);
            self.scatter = learned.clamp(LEAST_SCATTER_S * LEAST_SCATTER_S, LONGEST_S * LONGEST_S);
        }
    }

    /// What comes is not compared with what was.
    pub(super) fn interrupt(&mut self) {
        self.last = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// What is learned in `seconds` of a field that is `late_s` late, and by up to `jitter_s` more, of a vehicle that rolls to and fro by `swing` rad.
    fn fly(late_s: f64, jitter_s: f64, swing: f64, seconds: i64) -> MagneticLatency {
        let mut of = MagneticLatency::new();
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let roll = |t: f64| swing * (1.3 * t).sin();
        let at = |t: f64| AutopilotTime::from_micros((t * 1e6).round() as i64);
        for k in 1..seconds * 10 {
            let t = k as f64 * 0.1;
            let jitter = jitter_s * f64::from((k * 7919 % 31) as i32) / 31.0;
            let noise = Vector3::from_fn(|_, _| StandardNormal.sample(&mut rng)) * 0.3;
            let turn = so3::exp(&(Vector3::x() * -roll(t - late_s - jitter)));
            let field = (turn * Vector3::new(20.0, 0.0, 45.0) + noise) * 1e-6;
            of.observe(at(t), &field, 0.3e-6, |from, to| {
                let [from, to] = [from, to].map(|x| roll(x.seconds_since(at(0.0))));
                Some(Vector3::x() * (to - from))
            });
        }
        of
    }

    #[test]
    fn a_latency_is_found_within_its_sigma_and_so_is_its_scatter() {
        for late_s in [0.0, 0.06, 0.15] {
            let of = fly(late_s, 0.0, 0.4, 120);
            let error = (of.latency_s() - late_s).abs();
            assert!(
                error < 0.01 && error < 3.0 * of.sigma_s(),
                "{late_s}: {} ± {}",
                of.latency_s(),
                of.sigma_s()
            );
            assert!(of.sigma_s() < 0.02, "{}", of.sigma_s());
        }
        let of = fly(0.05, 0.1, 0.8, 120);
        // A mean of 0.1 s, and 0.1 s/√12.
        assert!((of.latency_s() - 0.1).abs() < 0.02, "{}", of.latency_s());
        assert!((0.02..0.045).contains(&of.sigma_s()), "{}", of.sigma_s());
    }

    #[test]
    fn who_does_not_turn_learns_nothing() {
        let of = fly(0.1, 0.0, 0.0, 120);
        assert_eq!(of.latency_s(), 0.0);
        assert!(of.sigma_s() > 0.1, "{}", of.sigma_s());
    }
}
