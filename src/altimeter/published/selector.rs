//! Whether a channel is faulty, from the innovations of its optimal filter: what the published recommendation needs and leaves open.

use super::filter::{PublishedFilter, WeightedInnovation};
use super::tuning::{SQUARES, SUM, SUM_BACK, WINDOW};

/// A test over the last 20 normalised innovations of a channel, which are white and of variance 1 while it is healthy: it becomes faulty
/// when their squares sum to more than 56 (excess noise, large bias) or their sum over √n exceeds 4.5 in size (small bias). Fewer than 20
/// are held to the same bounds. A fault-free channel becomes faulty at about 4 of 100 000 innovations.
///
/// While it is faulty, the filter does not use its measurements, and the error of the prediction is common to all innovations of the window:
/// the bound on their sum, 2.5 then, is widened by it, and the squares are those about their mean.
#[derive(Clone, Copy, Debug, Default)]
pub struct ChannelTest {
    window: [f64; WINDOW],
    count: usize,
    next: usize,
    faulty: bool,
}

impl ChannelTest {
    /// Takes in a normalised innovation, of whose variance the share `predicted` is the prediction's (the rest is the measurement's own noise).
    /// What is no number is left out.
    pub fn add(&mut self, normalised: f64, predicted: f64) {
        let Some(place) = self.window.get_mut(self.next).filter(|_| normalised.is_finite()) else { return };
        *place = normalised;
        self.next = (self.next + 1) % WINDOW;
        self.count = (self.count + 1).min(WINDOW);
        let n = self.count as f64;
        let squares: f64 = self.window.iter().map(|v| v * v).sum();
        let sum: f64 = self.window.iter().sum();
        self.faulty = if self.faulty {
            let common = 1.0 + (n - 1.0) * predicted;
            squares - sum * sum / n > SQUARES || sum.abs() > SUM_BACK * (n * common).sqrt()
        } else {
            squares > SQUARES || sum.abs() > SUM * n.sqrt()
        };
    }

    /// Lets an optimal filter use a measurement unless the channel is faulty: its innovations stay against what it was before the fault,
    /// and tell when the fault has gone. A filter that went on would take the bias in and then find nothing wrong.
    pub(super) fn guard<const N: usize>(
        &mut self,
        filter: &mut PublishedFilter<N>,
        z: f64,
    ) -> Option<WeightedInnovation> {
        let innovation = filter.innovation(z)?;
        self.add(innovation.normalised, 1.0 - filter.noise_variance() / innovation.variance);
        if self.is_faulty() { Some(WeightedInnovation { prob: 0.0, ..innovation }) } else { filter.update(z) }
    }

    /// The verdict after the innovations so far.
    pub fn is_faulty(&self) -> bool {
        self.faulty
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// The share of steps on which the channel is held for faulty.
    fn alarms(steps: usize, scale: f64, bias: f64) -> f64 {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let mut test = ChannelTest::default();
        let mut alarms = 0u32;
        for _ in 0..steps {
            let n: f64 = StandardNormal.sample(&mut rng);
            test.add(scale * n + bias, 0.0);
            alarms += u32::from(test.is_faulty());
        }
        f64::from(alarms) / steps as f64
    }

    #[test]
    fn a_healthy_channel_is_healthy_and_a_faulty_one_is_not() {
        let healthy = alarms(2_000_000, 1.0, 0.0);
        assert!((1e-5..1e-4).contains(&healthy), "{healthy}");
        assert!(alarms(10_000, 3.0, 0.0) > 0.99);
        assert!(alarms(10_000, 1.0, 2.0) > 0.99);
        assert!(alarms(10_000, 1.0, -2.0) > 0.99);
    }

    #[test]
    fn three_bad_innovations_are_enough_and_no_number_is_left_out() {
        let mut test = ChannelTest::default();
        (0..WINDOW).for_each(|_| test.add(0.0, 0.0));
        test.add(f64::NAN, 0.0);
        for _ in 0..3 {
            assert!(!test.is_faulty());
            test.add(4.4, 0.0);
        }
        assert!(test.is_faulty());
    }
}
