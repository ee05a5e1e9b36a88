//! Triads of two vectors and the attitude injection J.

use nalgebra::{Matrix3, Vector3};

/// The normalised triad [c₁, c₁×c₂, c₁×(c₁×c₂)], each column divided by its norm (Fusini (8b)-(8c); Grip (3b)-(3c) has the
/// same columns unnormalised, which diverge under Euler steps with |m| = 1 and specific force in m/s²).
///
/// The columns are orthonormal; the first is exactly the direction of `first`, so errors of `second` only turn about it.
/// `None` when a vector is not finite, vanishes, or the two are parallel to within a microradian.
pub fn normalised_triad(first: &Vector3<f64>, second: &Vector3<f64>) -> Option<Matrix3<f64>> {
    let (n1, n2) = (first.norm(), second.norm());
    let cross = first.cross(second);
    let nc = cross.norm();
    if !(n1 > 1e-12 && nc > 1e-6 * n1 * n2 && nc > 0.0 && nc.is_finite()) {
        return None;
    }
    let c1 = first / n1;
    let c2 = cross / nc;
    // A product of orthogonal unit vectors is a unit vector.
    let c3 = c1.cross(&c2);
    Some(Matrix3::from_columns(&[c1, c2, c3]))
}

/// Which columns the triads of Grip's observer have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TriadForm {
    /// Each divided by its norm. The one to use.
    Normalised,
    /// As Grip (3b)-(3c) prints them: the rate of convergence then depends on the vectors' lengths, and Euler steps diverge where a
    /// squared length times K_P dt passes 2. For comparison.
    Raw {
        /// Factor on the specific force inside the triads, s²/m: 1 as printed, 1/g for columns of order one.
        force_scale: f64,
    },
}

/// The columns [c₁, c₁×c₂, c₁×(c₁×c₂)] as they are (Grip (3b)-(3c)). `None` where [`normalised_triad`] has none.
pub fn raw_triad(first: &Vector3<f64>, second: &Vector3<f64>) -> Option<Matrix3<f64>> {
    normalised_triad(first, second)?;
    let cross = first.cross(second);
    Some(Matrix3::from_columns(&[*first, cross, first.cross(&cross)]))
}

/// Sine of the angle between two vectors; 0 where it is not defined.
pub fn sine_between(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    let s = a.cross(b).norm() / (a.norm() * b.norm());
    if s.is_finite() { s } else { 0.0 }
}

/// The injection J = A_n A_bᵀ − R̂ A_b A_bᵀ of two normalised triads (Grip (3a), Fusini (8a)). As A_b is orthogonal it is
/// A_n A_bᵀ − R̂: the TRIAD attitude less the estimate. Zero exactly when R̂ agrees with both vectors.
pub fn injection(triad_ned: &Matrix3<f64>, triad_body: &Matrix3<f64>, r_hat: &Matrix3<f64>) -> Matrix3<f64> {
    triad_ned * triad_body.transpose() - r_hat
}

/// The injection J of any two triads of the same kind: (A_n − R̂ A_b) A_bᵀ (Grip (3a)).
pub fn raw_injection(
    triad_ned: &Matrix3<f64>,
    triad_body: &Matrix3<f64>,
    r_hat: &Matrix3<f64>,
) -> Matrix3<f64> {
    (triad_ned - r_hat * triad_body) * triad_body.transpose()
}

/// ΔR of Ṙ = diag(k) (A_n − R̂ A_b) A_bᵀ over dt, solved exactly: the columns c_j of A_b are orthogonal, so along each of them
/// n_j − R̂c_j decays with the rate k_i |c_j|²: ΔR = Σ_j diag(1 − e^{−k_i dt |c_j|²}) (n_j − R̂c_j) c_jᵀ/|c_j|².
pub fn exact_turn(
    triad_ned: &Matrix3<f64>,
    triad_body: &Matrix3<f64>,
    r_hat: &Matrix3<f64>,
    rate: &Vector3<f64>,
    dt: f64,
) -> Matrix3<f64> {
    let missing = triad_ned - r_hat * triad_body;
    let mut out = Matrix3::zeros();
    for (n, c) in missing.column_iter().zip(triad_body.column_iter()) {
        let c2 = c.norm_squared();
        if c2 > 0.0 {
            // 1 − e^{−x}, without cancellation at small x.
            let reached = rate.map(|k| -(-k * dt * c2).exp_m1());
            out += reached.component_mul(&n) * c.transpose() / c2;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::so3;
    use proptest::prelude::*;

    fn vector() -> impl Strategy<Value = Vector3<f64>> {
        [-9.0..9.0, -9.0..9.0, -9.0..9.0].prop_map(|[x, y, z]: [f64; 3]| Vector3::new(x, y, z))
    }

    proptest! {
        #[test]
        fn triads_are_orthogonal_and_the_injection_vanishes_at_the_truth(a in vector(), b in vector(), phi in vector()) {
            let r = so3::exp(&phi);
            if a.cross(&b).norm() > 1e-3 {
                let body = normalised_triad(&a, &b).unwrap();
                prop_assert!((body.transpose() * body - Matrix3::identity()).norm() < 1e-12);
                let ned = normalised_triad(&(r * a), &(r * b)).unwrap();
                prop_assert!(injection(&ned, &body, &r).norm() < 1e-9);
                // The general form of (3a) and the short one are the same.
                let other = so3::exp(&b);
                let long = ned * body.transpose() - other * body * body.transpose();
                prop_assert!((injection(&ned, &body, &other) - long).norm() < 1e-12);
            }
        }
    }

    proptest! {
        /// In small Euler steps the injection of raw triads does what the exact solution does at once.
        #[test]
        fn the_exact_turn_is_the_limit_of_small_steps(a in vector(), b in vector(), phi in vector()) {
            let (a, b) = (a / 5.0, b / 5.0);
            if let (true, Some(body)) = (a.cross(&b).norm() > 0.1, raw_triad(&a, &b)) {
                let r = so3::exp(&phi);
                let ned = raw_triad(&(r * a), &(r * b)).unwrap();
                let rate = Vector3::new(1.0, 0.5, 0.2);
                let start = Matrix3::identity();
                let exact = start + exact_turn(&ned, &body, &start, &rate, 0.1);
                let n = 20_000;
                let mut steps = start;
                for _ in 0..n {
                    let j = raw_injection(&ned, &body, &steps);
                    steps += Matrix3::from_diagonal(&rate) * j * (0.1 / f64::from(n));
                }
                prop_assert!((exact - steps).norm() < 2e-3, "{}", (exact - steps).norm());
            }
        }
    }

    #[test]
    fn parallel_vanishing_and_non_finite_vectors_have_no_triad() {
        let x = Vector3::new(1.0, 2.0, 3.0);
        assert!(normalised_triad(&x, &(2.0 * x)).is_none());
        assert!(normalised_triad(&x, &Vector3::zeros()).is_none());
        assert!(normalised_triad(&Vector3::zeros(), &x).is_none());
        assert!(normalised_triad(&x, &Vector3::new(f64::NAN, 0.0, 0.0)).is_none());
        assert!(normalised_triad(&x, &Vector3::new(f64::INFINITY, 0.0, 0.0)).is_none());
    }
}
