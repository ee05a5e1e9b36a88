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
