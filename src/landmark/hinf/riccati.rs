//! Exact steps of the filter's Riccati equation between measurements (Aguiar (12)).
//!
//! Ṗ = −P(A + λI) − (A + λI)ᵀP − γ⁻²PGGᵀP − Qe, with everything but P constant over the step. P is information-like: it shrinks between
//! measurements, and where it ceases to be positive definite the cost (10) has no minimum any more and γ was too small. An exact step cannot
//! step over that unseen, which a Runge-Kutta step can.

use nalgebra::{DMatrix, DVector};

use super::implicit::{AffineDynamics, AffineTransition};

/// The two numbers of the cost (10).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Discount {
    /// γ, the bound on the gain from disturbances to the error. Larger is safer and less sharp.
    pub gamma: f64,
    /// λ, the rate of forgetting, 1/s.
    pub lambda: f64,
}

/// A step may turn the Hamiltonian flow by this much, rad, so that P cannot go through infinity and come back positive within it.
const LARGEST_TURN: f64 = 0.5;

/// Φ and φ from the exponential of [[A, a], [0, 0]] h.
pub fn affine_transition(dynamics: &AffineDynamics, dt_s: f64) -> AffineTransition {
    let n = dynamics.constant.len();
    let mut m = DMatrix::zeros(n + 1, n + 1);
    m.view_mut((0, 0), (n, n)).copy_from(&(&dynamics.matrix * dt_s));
    m.view_mut((0, n), (n, 1)).copy_from(&(&dynamics.constant * dt_s));
    let e = m.exp();
    AffineTransition {
        matrix: e.view((0, 0), (n, n)).into(),
        constant: e.view((0, n), (n, 1)).column(0).into(),
    }
}

/// The step for any A and GGᵀ: [U; V] = exp([[A + λI, GGᵀ/γ²], [−Qe, −(A + λI)ᵀ]] h) [I; P], P⁺ = VU⁻¹. `None` when P⁺, or P on the way, is
/// not positive definite.
pub fn hamiltonian_step(
    dynamics: &AffineDynamics,
    error_weight: &DVector<f64>,
    discount: Discount,
    dt_s: f64,
    p: &DMatrix<f64>,
) -> Option<DMatrix<f64>> {
    let n = error_weight.len();
    let a = &dynamics.matrix + DMatrix::identity(n, n) * discount.lambda;
    let mut m = DMatrix::zeros(2 * n, 2 * n);
    m.view_mut((0, 0), (n, n)).copy_from(&a);
    m.view_mut((0, n), (n, n)).copy_from(&(&dynamics.disturbance / discount.gamma.powi(2)));
    m.view_mut((n, 0), (n, n)).copy_from(&DMatrix::from_diagonal(&-error_weight));
    m.view_mut((n, n), (n, n)).copy_from(&-a.transpose());
    // Only the part that is not skew can turn P through infinity, but the norm of all of it bounds that.
    let steps = steps_within(m.norm() * dt_s)?;
    let e = (m * (dt_s / f64::from(steps))).exp();
    let (e11, e12) = (e.view((0, 0), (n, n)), e.view((0, n), (n, n)));
    let (e21, e22) = (e.view((n, 0), (n, n)), e.view((n, n), (n, n)));
    let mut p = p.clone();
    for _ in 0..steps {
        let (u, v) = (e11 + e12 * &p, e21 + e22 * &p);
        p = definite(right_divide(&v, u)?)?;
    }
    Some(p)
}

/// The step for skew A with GGᵀ = diag(γ²m) and Qe = diag(q), both constant on each block of A (or A zero there): in the axes that turn with
/// Θ = exp(Ah) every pair of rows is a 2 × 2 system with k² = λ² − mq, so with sh = sinh(kh)/k and ch = cosh(kh) (sines where k² < 0)
/// U = (ch + λ sh) + m sh P, V = −q sh + (ch − λ sh) P, P⁺ = Θ V U⁻¹ Θᵀ.
///
/// `disturbance` is the diagonal of GGᵀ. `None` as in [`hamiltonian_step`].
pub fn skew_step(
    theta: &DMatrix<f64>,
    disturbance: &DVector<f64>,
    error_weight: &DVector<f64>,
    discount: Discount,
    dt_s: f64,
    p: &DMatrix<f64>,
) -> Option<DMatrix<f64>> {
    let (n, lambda) = (disturbance.len(), discount.lambda);
    let m = disturbance / discount.gamma.powi(2);
    let turn =
        m.iter().zip(error_weight.iter()).map(|(m, q)| (m * q - lambda * lambda).max(0.0).sqrt() * dt_s);
    let steps = steps_within(turn.fold(0.0, f64::max))?;
    let h = dt_s / f64::from(steps);
    let waves: Vec<(f64, f64)> =
        (0..n).map(|i| hyperbolic(lambda * lambda - m[i] * error_weight[i], h)).collect();
    let mut p = p.clone();
    for _ in 0..steps {
        let (mut u, mut v) = (p.clone(), p.clone());
        for (i, &(ch, sh)) in waves.iter().enumerate() {
            u.row_mut(i).scale_mut(m[i] * sh);
            u[(i, i)] += ch + lambda * sh;
            v.row_mut(i).scale_mut(ch - lambda * sh);
            v[(i, i)] -= error_weight[i] * sh;
        }
        p = definite(right_divide(&v, u)?)?;
    }
    Some(theta * p * theta.transpose())
}

/// cosh(kh) and sinh(kh)/k for k² of any sign.
fn hyperbolic(k_squared: f64, h: f64) -> (f64, f64) {
    let x = k_squared * h * h;
    if x.abs() < 1e-6 {
        return (1.0 + x / 2.0 + x * x / 24.0, h * (1.0 + x / 6.0 + x * x / 120.0));
    }
    let k = k_squared.abs().sqrt();
    if k_squared > 0.0 { ((k * h).cosh(), (k * h).sinh() / k) } else { ((k * h).cos(), (k * h).sin() / k) }
}

/// How many steps keep each below [`LARGEST_TURN`]; `None` for what is not finite or beyond sense.
fn steps_within(turn: f64) -> Option<u32> {
    let steps = (turn / LARGEST_TURN).ceil().max(1.0);
    (steps < 1e4).then_some(steps as u32)
}

/// V U⁻¹.
fn right_divide(v: &DMatrix<f64>, u: DMatrix<f64>) -> Option<DMatrix<f64>> {
    Some(u.transpose().lu().solve(&v.transpose())?.transpose())
}

/// The symmetric part, if it is finite and positive definite.
pub(super) fn definite(p: DMatrix<f64>) -> Option<DMatrix<f64>> {
    let p = (&p + p.transpose()) * 0.5;
    if !p.iter().all(|v| v.is_finite()) {
        return None;
    }
    p.clone().cholesky().map(|_| p)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::so3;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    fn system(omega: &Vector3<f64>, g: [f64; 2]) -> AffineDynamics {
        let mut matrix = DMatrix::zeros(6, 6);
        matrix.view_mut((0, 0), (3, 3)).copy_from(&-so3::hat(omega));
        let disturbance = DVector::from_fn(6, |i, _| g[i / 3]);
        AffineDynamics {
            matrix,
            constant: DVector::zeros(6),
            disturbance: DMatrix::from_diagonal(&disturbance),
        }
    }

    fn start(seed: &[f64]) -> DMatrix<f64> {
        let a = DMatrix::from_fn(6, 6, |i, j| seed[6 * i + j]);
        &a * a.transpose() + DMatrix::identity(6, 6) * 3.0
    }

    proptest! {
        #[test]
        fn the_step_for_skew_systems_is_the_general_one(
            seed in proptest::collection::vec(-1.0..1.0f64, 36),
            omega in proptest::array::uniform3(-3.0..3.0f64),
            g in proptest::array::uniform2(0.0..4.0f64),
            gamma in 1.0..20.0f64,
            lambda in 0.0..1.0f64,
            h in 0.001..0.4f64,
        ) {
            let (omega, p) = (Vector3::from(omega), start(&seed));
            let discount = Discount { gamma, lambda };
            let d = system(&omega, g);
            let theta = affine_transition(&d, h).matrix;
            let q = DVector::from_element(6, 1.0);
            let skew = skew_step(&theta, &d.disturbance.diagonal(), &q, discount, h, &p);
            let general = hamiltonian_step(&d, &q, discount, h, &p);
            prop_assert_eq!(skew.is_some(), general.is_some());
            if let (Some(a), Some(b)) = (skew, general) {
                prop_assert!((a - b).norm() < 1e-11 * p.norm());
            }
        }

        #[test]
        fn two_steps_are_one(seed in proptest::collection::vec(-1.0..1.0f64, 36), h in 0.01..0.2f64, part in 0.1..0.9f64) {
            let (d, p) = (system(&Vector3::new(0.3, -1.0, 2.0), [0.3, 0.0]), start(&seed));
            let q = DVector::from_element(6, 1.0);
            let step = |p: &DMatrix<f64>, h: f64| hamiltonian_step(&d, &q, Discount { gamma: 3.0, lambda: 0.2 }, h, p).unwrap();
            prop_assert!((step(&step(&p, h * part), h * (1.0 - part)) - step(&p, h)).norm() < 1e-11 * p.norm());
        }
    }

    /// ṗ = −mp² − q with p(0) = 1, m = q = 1: p = tan(π/4 − t), zero at π/4 and positive again at π/4 + π.
    #[test]
    fn a_step_over_the_end_of_definiteness_is_no_way_past_it() {
        let one = DMatrix::from_element(1, 1, 1.0);
        let (q, g) = (DVector::from_element(1, 1.0), DVector::from_element(1, 1.0));
        let discount = Discount { gamma: 1.0, lambda: 0.0 };
        let dynamics = AffineDynamics {
            matrix: DMatrix::zeros(1, 1),
            constant: DVector::zeros(1),
            disturbance: DMatrix::from_diagonal(&g),
        };
        for (h, exists) in
            [(0.5, true), (0.78, true), (0.8, false), (3.0, false), (4.0, false), (f64::NAN, false)]
        {
            let skew = skew_step(&one, &g, &q, discount, h, &one);
            let general = hamiltonian_step(&dynamics, &q, discount, h, &one);
            assert_eq!((skew.is_some(), general.is_some()), (exists, exists), "{h}");
            if let (Some(a), Some(b)) = (skew, general) {
                let truth = (std::f64::consts::FRAC_PI_4 - h).tan();
                assert!((a[0] - truth).abs() < 1e-12 && (b[0] - truth).abs() < 1e-12);
            }
        }
    }
}
