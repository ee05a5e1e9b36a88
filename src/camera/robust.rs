//! Rows of the flow equations with their weights: least squares, Huber's reweighting, and RANSAC.
//!
//! Residuals are taken a feature at a time (the length of [ṙ, ṡ]'s residual): a feature is tracked well or it is not.

use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};

/// The equations A·v = y of one feature, in units of the flow.
#[derive(Clone, Copy, Debug)]
pub(super) struct FlowRow {
    /// First three columns of M_j.
    pub(super) a: Matrix2x3<f64>,
    /// Last three columns of M_j.
    pub(super) b: Matrix2x3<f64>,
    /// −(flow + B·ω).
    pub(super) y: Vector2<f64>,
}

/// What is known besides the features: Σ and right-hand side of further equations.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prior {
    pub(super) normal: Matrix3<f64>,
    pub(super) right: Vector3<f64>,
}

/// Huber's reweighting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Huber {
    pub(super) threshold: f64,
    pub(super) iterations: u32,
}

/// Hypotheses that RANSAC tries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ransac {
    pub(super) threshold: f64,
    pub(super) samples: u32,
}

/// Where the sequence of sampled pairs begins: always the same, so that the same image gives the same velocity.
const SEED: u64 = 0x9E37_79B9_7F4A_7C15;

/// Normal matrix Σ w AᵀA of the features with their weights, and the prior.
pub(super) fn normal_matrix(rows: &[FlowRow], weights: &[f64], prior: &Prior) -> Matrix3<f64> {
    let sum = |n: Matrix3<f64>, (row, w): (&FlowRow, &f64)| n + row.a.tr_mul(&row.a) * *w;
    rows.iter().zip(weights).fold(prior.normal, sum)
}

/// Weighted least squares; `None` when the matrix is singular.
pub(super) fn least_squares(rows: &[FlowRow], weights: &[f64], prior: &Prior) -> Option<Vector3<f64>> {
    let right = rows.iter().zip(weights).fold(prior.right, |g, (row, w)| g + row.a.tr_mul(&row.y) * *w);
    let v = normal_matrix(rows, weights, prior).cholesky()?.solve(&right);
    v.iter().all(|c| c.is_finite()).then_some(v)
}

/// Length of a feature's residual.
pub(super) fn residual(row: &FlowRow, v: &Vector3<f64>) -> f64 {
    (row.y - row.a * v).norm()
}

/// Iteratively reweighted least squares from `v`, w = min(1, k/|e|), over the features whose `weights` are not zero.
pub(super) fn huber(
    rows: &[FlowRow],
    weights: &mut [f64],
    prior: &Prior,
    mut v: Vector3<f64>,
    settings: Huber,
) -> Option<Vector3<f64>> {
    for _ in 0..settings.iterations {
        for (row, w) in rows.iter().zip(weights.iter_mut()).filter(|(_, w)| **w > 0.0) {
            let e = residual(row, &v);
            *w = if e > settings.threshold { settings.threshold / e } else { 1.0 };
            if *w <= 0.0 || w.is_nan() {
                // Infinitely far off.
                *w = f64::MIN_POSITIVE;
            }
        }
        let next = least_squares(rows, weights, prior)?;
        let moved = (next - v).norm();
        v = next;
        if moved <= 1e-12 * (1.0 + v.norm()) {
            break;
        }
    }
    Some(v)
}

/// The velocity of the largest set of features that agree, found from pairs of them; `weights` become 1 for those in it and 0 for the
/// rest. All pairs are tried where there are no more than `samples`, else that many of a fixed pseudo-random sequence.
pub(super) fn consensus(
    rows: &[FlowRow],
    weights: &mut [f64],
    prior: &Prior,
    settings: Ransac,
) -> Option<Vector3<f64>> {
    let n = rows.len();
    let mut best: Option<(usize, f64, Vector3<f64>)> = None;
    let mut consider = |i: usize, j: usize| {
        let pair = [rows[i], rows[j]];
        let Some(v) = least_squares(&pair, &[1.0, 1.0], prior) else { return };
        let (mut inliers, mut sum) = (0, 0.0);
        for e in rows.iter().map(|row| residual(row, &v)).filter(|e| *e <= settings.threshold) {
            inliers += 1;
            sum += e * e;
        }
        if best.is_none_or(|(most, least, _)| inliers > most || (inliers == most && sum < least)) {
            best = Some((inliers, sum, v));
        }
    };
    if n * n.saturating_sub(1) / 2 <= settings.samples as usize {
        (0..n).for_each(|i| (0..i).for_each(|j| consider(i, j)));
    } else {
        let mut state = SEED;
        let mut draw = |below: usize| {
            // Marsaglia's xorshift.
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            ((state >> 33) as usize) % below
        };
        for _ in 0..settings.samples {
            let i = draw(n);
            let j = (i + 1 + draw(n - 1)) % n;
            consider(i, j);
        }
    }
    let (_, _, mut v) = best?;
    // Once more with all that agreed: the pair's own noise is in its verdict.
    for _ in 0..2 {
        for (row, w) in rows.iter().zip(weights.iter_mut()) {
            *w = if residual(row, &v) <= settings.threshold { 1.0 } else { 0.0 };
        }
        v = least_squares(rows, weights, prior)?;
    }
    Some(v)
}
