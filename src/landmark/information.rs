//! The H∞ filter of the drone: twelve unknowns that do not move, in information form.
//!
//! In the dead-reckoned frame D (see [`super::dead_reckoning`]) a landmark whose coordinates Q are known stands at q + NQ, with N the rotation
//! from the landmarks' frame to D. x = [q; vec N], columns stacked, is constant, and every output is affine in it, so that the filter of
//! [`super::hinf`] has Φ = I and no drift: a sighting's delay costs nothing but the look-up of where the body was. The nine numbers of N are
//! free: no start is too far, which is the point of it. With Y = P/γ² in the limit of a large γ:
//!
//! - forgetting Y ← fY + (1 − f)Y₀, f = exp(−2λh), with the floor Y₀ that the prior gave: the cost keeps its minimum however long nothing
//!   is seen, so P cannot lose definiteness;
//! - an output r = c − Ax with metric R⁻¹: Y ← Y + AᵀR⁻¹A, x ← x + Y⁻¹AᵀR⁻¹r. All outputs here have A = aᵀ ⊗ I, hence AᵀR⁻¹A = aaᵀ ⊗ R⁻¹:
//!   a = [1, Q] for a landmark, [0, e₃] for the direction of gravity;
//! - a bearing b leaves the distance free, (16): Π_b(q + NQ − d − Ψ·lever) = 0 with Π_b = I − bbᵀ and variance (σ_b clip(ρ̂))².

use nalgebra::{Cholesky, Const, Matrix3, SMatrix, SVector, Vector3, Vector4};

use super::dead_reckoning::DeadReckoned;
use crate::geo::kabsch_rotation;

/// Unknowns.
pub const N: usize = 12;
/// x = [q; vec N].
pub type State = SVector<f64, N>;
/// Y.
pub type Matrix12 = SMatrix<f64, N, N>;

/// A landmark as it was seen, in D.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenInD {
    /// Coordinates Q of the landmark in the landmarks' frame, m.
    pub landmark: Vector3<f64>,
    /// Unit vector from the camera to it.
    pub direction_d: Vector3<f64>,
    /// The camera, m.
    pub camera_d: Vector3<f64>,
    /// Distance as measured, with its sigma, m.
    pub distance: Option<[f64; 2]>,
}

/// How a sighting is weighed and judged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weighing {
    /// σ_b, rad.
    pub bearing_sigma_rad: f64,
    /// Least and greatest distance that a bearing's error is scaled with, m.
    pub distance_clip_m: [f64; 2],
    /// Largest squared ratio of the residual to what is to be expected, χ² with 2 degrees of freedom for a bearing, 3 with a distance.
    pub gate: f64,
    /// Weight of its information, in (0, 1]: exp(−2λτ) for one that is τ old and was not put in its place in time.
    pub weight: f64,
}

/// A residual that was judged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judged {
    /// Squared ratio of the residual to what is to be expected.
    pub ratio: f64,
    /// Whether it was used: below the gate.
    pub used: bool,
}

/// The estimate and its information.
#[derive(Clone, Debug, PartialEq)]
pub struct Information {
    x: State,
    y: Matrix12,
    floor: State,
}

impl Information {
    /// Starts with the body at `position` turned by `r_body` in the landmarks' frame and at `at` in D, sigmas of the position (m) and of each
    /// element of N.
    pub fn new(
        position: &Vector3<f64>,
        r_body: &Matrix3<f64>,
        at: &DeadReckoned,
        position_sigma_m: f64,
        rotation_sigma: f64,
    ) -> Self {
        let n = at.r_body_to_d * r_body.transpose();
        let q = at.position_d - n * position;
        let mut x = State::zeros();
        x.fixed_rows_mut::<3>(0).copy_from(&q);
        x.fixed_rows_mut::<9>(3).copy_from_slice(n.as_slice());
        let sigma = |i: usize| if i < 3 { position_sigma_m } else { rotation_sigma };
        let floor = State::from_fn(|i, _| sigma(i).powi(-2));
        Self { x, y: Matrix12::from_diagonal(&floor), floor }
    }

    /// x = [q; vec N].
    pub fn state(&self) -> &State {
        &self.x
    }

    /// Y.
    pub fn information(&self) -> &Matrix12 {
        &self.y
    }

    /// Forgets: Y ← fY + (1 − f)Y₀. Two spans one after the other are their sum.
    pub fn forget(&mut self, lambda: f64, dt_s: f64) {
        let f = (-2.0 * lambda * dt_s).exp();
        self.y *= f;
        for i in 0..N {
            self.y[(i, i)] += (1.0 - f) * self.floor[i];
        }
    }

    /// Y ← factor · Y, but not below the floor's scale: the way out of a lock-out.
    pub fn inflate(&mut self, factor: f64) {
        self.y *= factor;
        for i in 0..N {
            self.y[(i, i)] += (1.0 - factor).max(0.0) * 0.1 * self.floor[i];
        }
    }

    /// Whether Y is positive definite and x finite: the minimum exists.
    pub fn is_definite(&self) -> bool {
        self.x.iter().all(|v| v.is_finite()) && Cholesky::new(self.y).is_some()
    }

    /// Where the landmark is seen from the camera now, in D, m.
    fn predicted(&self, seen: &SeenInD) -> Vector3<f64> {
        self.q() + self.n() * seen.landmark - seen.camera_d
    }

    /// Judges a sighting, and uses it if it passes. `None`, and no change, when Y is not definite.
    pub fn sighting(&mut self, seen: &SeenInD, how: &Weighing) -> Option<Judged> {
        let predicted = self.predicted(seen);
        let [near, far] = how.distance_clip_m;
        let sigma = how.bearing_sigma_rad * predicted.norm().clamp(near, far);
        let b = seen.direction_d;
        let along = b * b.transpose();
        let across = Matrix3::identity() - along;
        // Π is idempotent up to rounding only; its square cannot be indefinite.
        let squared = across.tr_mul(&across);
        let a = seen.landmark.insert_row(0, 1.0);
        let prior = self.covariance_of(&a)?;
        let (residual, expected, metric) = match seen.distance {
            None => {
                let expected = Matrix3::from_diagonal_element(sigma * sigma) + across * prior * across;
                (-across * predicted, expected, squared / (sigma * sigma))
            }
            Some([distance, s]) => {
                let noise = across * sigma.powi(2) + along * s.powi(2);
                (b * distance - predicted, noise + prior, squared / sigma.powi(2) + along / s.powi(2))
            }
        };
        let ratio = residual.dot(&Cholesky::new(expected)?.solve(&residual));
        let used = ratio <= how.gate;
        if used {
            self.fuse(&a, &residual, &(metric * how.weight))?;
        }
        ratio.is_finite().then_some(Judged { ratio, used })
    }

    /// N e₃ = the direction of gravity in D, each component with the same sigma.
    pub fn gravity(&mut self, down_d: &Vector3<f64>, sigma: f64) -> Option<()> {
        let a = Vector4::new(0.0, 0.0, 0.0, 1.0);
        let residual = down_d - self.n().column(2);
        self.fuse(&a, &residual, &Matrix3::from_diagonal_element(sigma.powi(-2)))
    }

    /// sym(N̂ᵀN) = I with N̂ the rotation nearest to N: six rows of the given weight that pull N towards SO(3) without turning it. What they
    /// add, they add to Y for good, so their weight is that of a span.
    pub fn orthonormality(&mut self, weight: f64) -> Option<()> {
        let n = self.n();
        let near = kabsch_rotation(&n)?;
        let product = near.tr_mul(&n);
        let (mut y, mut rhs) = (self.y, State::zeros());
        for i in 0..3 {
            for j in i..3 {
                // ½(n̂_iᵀ n_j + n̂_jᵀ n_i) = δ_ij
                let mut row = State::zeros();
                for k in 0..3 {
                    row[3 + 3 * j + k] += 0.5 * near[(k, i)];
                    row[3 + 3 * i + k] += 0.5 * near[(k, j)];
                }
                let want = if i == j { 1.0 } else { 0.0 };
                let error = want - 0.5 * (product[(i, j)] + product[(j, i)]);
                y.ger(weight, &row, &row, 1.0);
                rhs += row * (weight * error);
            }
        }
        self.solved(y, &rhs)
    }

    /// Y ← Y + aaᵀ ⊗ M, x ← x + Y⁻¹(a ⊗ Mr).
    fn fuse(&mut self, a: &Vector4<f64>, residual: &Vector3<f64>, metric: &Matrix3<f64>) -> Option<()> {
        let pull = metric * residual;
        let (mut y, mut rhs) = (self.y, State::zeros());
        for i in 0..4 {
            rhs.fixed_rows_mut::<3>(3 * i).copy_from(&(a[i] * pull));
            for j in 0..4 {
                let mut block = y.fixed_view_mut::<3, 3>(3 * i, 3 * j);
                block += a[i] * a[j] * metric;
            }
        }
        self.solved(y, &rhs)
    }

    fn solved(&mut self, y: Matrix12, rhs: &State) -> Option<()> {
        let step = Cholesky::new(y)?.solve(rhs);
        if !step.iter().all(|v| v.is_finite()) {
            return None;
        }
        self.x += step;
        self.y = y;
        Some(())
    }

    /// A Y⁻¹ Aᵀ for A = aᵀ ⊗ I: the covariance of q + NQ.
    fn covariance_of(&self, a: &Vector4<f64>) -> Option<Matrix3<f64>> {
        let mut rows = SMatrix::<f64, N, 3>::zeros();
        for i in 0..4 {
            rows.fixed_view_mut::<3, 3>(3 * i, 0).copy_from(&Matrix3::from_diagonal_element(a[i]));
        }
        let chol: Cholesky<f64, Const<N>> = Cholesky::new(self.y)?;
        chol.l_dirty().solve_lower_triangular_mut(&mut rows).then(|| rows.tr_mul(&rows))
    }

    /// Sigmas of q (m) and of the elements of N: the largest of each.
    pub fn sigmas(&self) -> Option<[f64; 2]> {
        // The diagonal of Y⁻¹ itself is asked for.
        let covariance = Cholesky::new(self.y)?.inverse();
        let largest =
            |from: usize, to: usize| (from..to).map(|i| covariance[(i, i)]).fold(0.0, f64::max).sqrt();
        Some([largest(0, 3), largest(3, N)])
    }

    /// q, where the landmarks' origin is in D, m.
    pub fn q(&self) -> Vector3<f64> {
        self.x.fixed_rows::<3>(0).into()
    }

    /// N as it is estimated, not a rotation.
    pub fn n(&self) -> Matrix3<f64> {
        Matrix3::from_column_slice(self.x.fixed_rows::<9>(3).as_slice())
    }

    /// The body's position and attitude in the landmarks' frame where it is at `at` in D: N⁻¹(d − q), for N's scale is q's as well, and
    /// Nᵀ made a rotation. `None` while N is singular.
    pub fn pose(&self, at: &DeadReckoned) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let n = self.n();
        let position = n.lu().solve(&(at.position_d - self.q()))?;
        let r = kabsch_rotation(&n)?.tr_mul(&at.r_body_to_d);
        position.iter().all(|v| v.is_finite()).then_some((position, r))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::so3::exp;

    fn started(position_sigma_m: f64) -> (Information, DeadReckoned) {
        let at = DeadReckoned { r_body_to_d: Matrix3::identity(), position_d: Vector3::zeros() };
        let r = exp(&Vector3::new(0.3, -0.2, 1.0));
        (Information::new(&Vector3::new(1.0, 2.0, -3.0), &r, &at, position_sigma_m, 1.2), at)
    }

    #[test]
    fn it_starts_where_it_is_told_to() {
        let (filter, at) = started(4.0);
        let (position, r) = filter.pose(&at).unwrap();
        assert!((position - Vector3::new(1.0, 2.0, -3.0)).norm() < 1e-12);
        assert!((r - exp(&Vector3::new(0.3, -0.2, 1.0))).norm() < 1e-12);
        let [position, rotation] = filter.sigmas().unwrap();
        assert!((position - 4.0).abs() < 1e-12 && (rotation - 1.2).abs() < 1e-12);
    }

    #[test]
    fn forgetting_in_parts_is_forgetting_at_once_and_ends_at_the_floor() {
        let (mut filter, _) = started(4.0);
        filter.gravity(&Vector3::z(), 0.03).unwrap();
        let (mut once, mut parts) = (filter.clone(), filter.clone());
        once.forget(0.25, 1.7);
        (0..17).for_each(|_| parts.forget(0.25, 0.1));
        assert!((once.y - parts.y).norm() < 1e-9);
        once.forget(0.25, 1e4);
        assert!((once.y - Matrix12::from_diagonal(&filter.floor)).norm() < 1e-12);
    }

    /// The rows of the orthonormality are exact for a symmetric stretch of N, and blind to a turn of it.
    #[test]
    fn orthonormality_takes_out_a_stretch_and_keeps_a_turn() {
        let (mut filter, _) = started(4.0);
        let n = filter.n();
        let stretch = Matrix3::new(0.7, 0.05, 0.0, 0.05, 1.2, -0.1, 0.0, -0.1, 0.9);
        filter.x.fixed_rows_mut::<9>(3).copy_from_slice((n * stretch).as_slice());
        filter.orthonormality(1e9).unwrap();
        assert!((filter.n() - n).norm() < 1e-6, "{}", filter.n() - n);
        let before = filter.x;
        filter.orthonormality(1e9).unwrap();
        assert!((filter.x - before).norm() < 1e-6);
    }

    #[test]
    fn a_sighting_above_the_gate_changes_nothing() {
        let (mut filter, _) = started(0.1);
        let how = Weighing { bearing_sigma_rad: 0.01, distance_clip_m: [0.5, 12.0], gate: 20.0, weight: 1.0 };
        let seen = SeenInD {
            landmark: Vector3::zeros(),
            direction_d: Vector3::x(),
            camera_d: Vector3::new(-1.0, 2.0, 0.0),
            distance: Some([50.0, 0.1]),
        };
        let before = filter.clone();
        let judged = filter.sighting(&seen, &how).unwrap();
        assert!(!judged.used && judged.ratio > 1000.0);
        assert_eq!(filter, before);
    }
}
