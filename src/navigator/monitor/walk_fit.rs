//! What blocks of GNSS and flow say of a walk and of a calibration: normal equations of y = w t + J x + e.
//!
//! Least squares is of e made white by the innovations algorithm (Brockwell and Davis 1991, *Time Series: Theory and Methods*, section 5.2): E e_k² = q t + 2 R and
//! E e_k e_{k−1} = −R of blocks that follow each other.

use nalgebra::{Matrix4, Matrix6, SMatrix, Vector2, Vector6};

use super::witness_blocks::WitnessBlock;
use crate::filter::NoiseAndWalk;
use crate::navigator::tuning::witness_blocks::LEAST_GROWTH;

/// Information about [w x], A and b with A [w x] = b, and Σ|y|²/σ².
#[derive(Clone, Copy, Debug)]
pub(super) struct WalkSums {
    information: Matrix6<f64>,
    vector: Vector6<f64>,
    pub(super) squares: f64,
}

impl WalkSums {
    pub(super) fn of(blocks: &[WitnessBlock], noise: &NoiseAndWalk) -> Self {
        // Learned of differences of what was moved by, R′ = 1.5 R.
        let (white, growth) = noise.parts();
        let (white, growth) = (white / 1.5, growth.max(LEAST_GROWTH));
        let mut sums = Self { information: Matrix6::zeros(), vector: Vector6::zeros(), squares: 0.0 };
        // The last innovations [w x y] and their variance.
        let (mut before, mut variance) = (SMatrix::<f64, 2, 7>::zeros(), f64::INFINITY);
        for block in blocks {
            let mut row = SMatrix::<f64, 2, 7>::zeros();
            row.fixed_columns_mut::<2>(0).fill_diagonal(block.walked_s);
            row.fixed_columns_mut::<4>(2).copy_from(&block.sensitivity);
            row.set_column(6, &block.gap_ne);
            let shared = if block.follows { -white / variance } else { 0.0 };
            row -= before * shared;
            // v_k = γ_0 − γ_1²/v_{k−1}
            variance = growth * block.seconds + white * (2.0 + shared);
            before = row;
            let (g, y) = (row.fixed_columns::<6>(0), row.column(6));
            sums.information += g.tr_mul(&g) / variance;
            sums.vector += g.tr_mul(&y) / variance;
            sums.squares += y.norm_squared() / variance;
        }
        sums
    }

    /// What a walk of 0 ± `walk_sigma`, m/s, and a calibration that is wrong by 0 with the information `x` explain together of the squares, and [w x].
    pub(super) fn explained(&self, walk_sigma: f64, x: &Matrix4<f64>) -> Option<(f64, Vector6<f64>)> {
        let mut whole = self.information;
        for i in 0..2 {
            whole[(i, i)] += 1.0 / (walk_sigma * walk_sigma);
        }
        let mut corner = whole.fixed_view_mut::<4, 4>(2, 2);
        corner += x;
        let solved = whole.cholesky()?.solve(&self.vector);
        Some((self.vector.dot(&solved), solved))
    }

    /// Twice the log-likelihood of no walk at all against a walk of `step`, NE, m/s, whatever the calibration is wrong by: with b′ and A′ what is left of b and A when x
    /// is taken out, sᵀA′s − 2 sᵀb′.
    pub(super) fn against(&self, step: &Vector2<f64>, x: &Matrix4<f64>) -> Option<f64> {
        let corner = self.information.fixed_view::<4, 4>(2, 2) + x;
        let across = self.information.fixed_view::<4, 2>(2, 0) * step;
        let solved = corner.cholesky()?.solve(&across);
        let (b_w, b_x) = (self.vector.fixed_rows::<2>(0), self.vector.fixed_rows::<4>(2));
        let of_walk = (self.information.fixed_view::<2, 2>(0, 0) * step).dot(step);
        Some(of_walk - across.dot(&solved) - 2.0 * (step.dot(&b_w) - solved.dot(&b_x)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix2x4;

    /// Seconds of a vehicle at `speed` to the north, of a receiver that walks by `walk`.
    fn sums(speed: f64, walk: Vector2<f64>) -> WalkSums {
        let mut blocks = Vec::new();
        for k in 0..16 {
            let noise = Vector2::new(f64::from(k * 7 % 5) - 2.0, f64::from(k * 11 % 7) - 3.0) * 0.02;
            let mut sensitivity = Matrix2x4::zeros();
            sensitivity.set_column(2, &Vector2::new(speed, 0.0));
            sensitivity.set_column(3, &Vector2::new(0.0, speed));
            let gap_ne = walk + noise;
            let block =
                WitnessBlock { seconds: 1.0, walked_s: 1.0, gap_ne, sensitivity, ..WitnessBlock::default() };
            blocks.push(WitnessBlock { follows: k > 0, ..block });
        }
        WalkSums::of(&blocks, &NoiseAndWalk::expecting(0.1, 0.05, 60.0))
    }

    #[test]
    fn a_walk_that_would_have_shown_is_refuted_and_one_that_does_is_not() {
        let (walk, known) = (Vector2::new(0.3, 0.4), Matrix4::identity() * 2500.0);
        assert!(sums(0.0, Vector2::zeros()).against(&walk, &known).unwrap() > 20.0);
        assert!(sums(0.0, walk).against(&walk, &known).unwrap() < -20.0);
        // Half of it is as likely as none.
        let half = sums(0.0, 0.5 * walk).against(&walk, &known).unwrap();
        assert!(half.abs() < 8.0, "{half}");
        // At 30 m/s a scale of 2 % makes as much of a straight flight.
        let fast = sums(30.0, Vector2::zeros()).against(&walk, &known).unwrap();
        assert!((0.0..3.0).contains(&fast), "{fast}");
    }

    #[test]
    fn what_is_explained_agrees_with_the_likelihoods() {
        let (walk, known) = (Vector2::new(0.3, 0.4), Matrix4::identity() * 2500.0);
        let sums = sums(3.0, walk);
        let (nothing, _) = sums.explained(1e-6, &known).unwrap();
        let (free, best) = sums.explained(1e6, &known).unwrap();
        let best = Vector2::new(best[0], best[1]);
        assert!((free - nothing + sums.against(&best, &known).unwrap()).abs() < 1e-6);
    }
}
