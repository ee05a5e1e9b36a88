//! How much the IMU shakes: vibration is noise, and it differs between vehicles by a factor of ten.

use nalgebra::Vector3;

/// Time over which vibration is averaged, s.
const MEAN_S: f64 = 5.0;
/// Samples in a block, at each of the scales.
const BLOCKS: [u32; 3] = [1, 4, 16];

/// What of the samples is white, from second differences of the means of n samples in a row: motion is smoother than that.
///
/// White noise of variance σ² at the interval dt leaves 6 σ²/n in a second difference of such means, a density of σ² dt at every n. Motion
/// shows more at a larger n, a vibration at one frequency less: its integral is bounded. So the least of the scales is what is white.
#[derive(Clone, Copy, Debug, Default)]
pub struct Jitter {
    scales: [Scale; BLOCKS.len()],
}

/// One of the scales.
#[derive(Clone, Copy, Debug, Default)]
struct Scale {
    /// Of the block that is being filled: samples, seconds, sums.
    count: u32,
    seconds: f64,
    sum: Pair,
    last: Option<[Pair; 2]>,
    /// Mean square of the noise density of the rate, and over how long it was taken, s.
    density: f64,
    heard_s: f64,
}

/// Rate and force.
type Pair = (Vector3<f64>, Vector3<f64>);

impl Jitter {
    /// Noise density of the gyros, rad/s/√Hz.
    pub fn gyro_density(&self) -> f64 {
        self.scales.iter().map(|s| s.density).fold(f64::INFINITY, f64::min).sqrt()
    }

    /// Takes a sample over `dt` s. With `shared_instants` samples are the means of two instants, one of them shared with the sample before.
    /// Returns the variances of a component of rate and force that the newest three samples show.
    pub fn add(
        &mut self,
        dt: f64,
        rate: &Vector3<f64>,
        force: &Vector3<f64>,
        shared_instants: bool,
    ) -> (f64, f64) {
        let [first, rest @ ..] = &mut self.scales;
        for (scale, n) in rest.iter_mut().zip(&BLOCKS[1..]) {
            scale.add(dt, &(*rate, *force), *n, shared_instants);
        }
        first.add(dt, &(*rate, *force), BLOCKS[0], shared_instants)
    }
}

impl Scale {
    fn add(&mut self, dt: f64, sample: &Pair, n: u32, shared_instants: bool) -> (f64, f64) {
        self.count += 1;
        self.seconds += dt;
        self.sum = (self.sum.0 + sample.0, self.sum.1 + sample.1);
        if self.count < n {
            return (0.0, 0.0);
        }
        let mean = (self.sum.0 / f64::from(n), self.sum.1 / f64::from(n));
        let dt = self.seconds;
        (self.count, self.seconds, self.sum) = (0, 0.0, Pair::default());
        let Some([a, b]) = self.last.replace(self.last.map_or([mean; 2], |[_, b]| [b, mean])) else {
            return (0.0, 0.0);
        };
        // (1 + 4 + 1) σ²/n of blocks of instants; blocks of shared means overlap: (6 n − 5) σ²/n².
        let n = f64::from(n);
        let share = if shared_instants { (6.0 * n - 5.0) / n } else { 6.0 };
        let of = |a: Vector3<f64>, b: Vector3<f64>, c: Vector3<f64>| {
            (a - 2.0 * b + c).norm_squared() / (3.0 * share)
        };
        let variance = (of(a.0, b.0, mean.0), of(a.1, b.1, mean.1));
        // The plain mean at first, a low pass later.
        self.heard_s = (self.heard_s + dt).min(MEAN_S);
        let gain = (dt / self.heard_s.max(dt)).min(1.0);
        self.density += gain * (variance.0 * dt - self.density);
        variance
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    const DT: f64 = 0.005;

    fn density(shared: bool, rate: impl Fn(f64) -> Vector3<f64>) -> f64 {
        let mut jitter = Jitter::default();
        let mut last = rate(0.0);
        for k in 1..4000 {
            let instant = rate(f64::from(k) * DT);
            let sample = if shared { (last + instant) * 0.5 } else { instant };
            jitter.add(DT, &sample, &Vector3::zeros(), shared);
            last = instant;
        }
        jitter.gyro_density()
    }

    #[test]
    fn white_noise_is_measured_as_it_is_and_motion_is_none() {
        let rng = std::cell::RefCell::new(rand_chacha::ChaCha8Rng::seed_from_u64(4));
        let noise = |t: f64| {
            let one = || StandardNormal.sample(&mut *rng.borrow_mut());
            let slow = Vector3::new(1.0, 0.5, 0.2) * (2.0 * t).sin();
            slow + Vector3::<f64>::new(one(), one(), one()) * 0.1
        };
        let truth = 0.1 * DT.sqrt();
        for shared in [false, true] {
            let found = density(shared, noise);
            assert!((found / truth - 1.0).abs() < 0.15, "{shared}: {found} instead of {truth}");
        }
        assert!(density(false, |t| Vector3::repeat((2.0 * t).sin())) < 1e-3 * truth);
    }

    #[test]
    fn a_vibration_at_one_frequency_counts_for_less_than_its_size() {
        let tone =
            |t: f64| Vector3::repeat(0.1 * 2f64.sqrt() * (2.0 * std::f64::consts::PI * 70.0 * t).sin());
        assert!(density(false, tone) < 0.5 * 0.1 * DT.sqrt());
    }
}
