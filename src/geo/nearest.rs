//! The rotation nearest to a matrix, in two ways: Newton's for what is nearly a rotation, Kabsch's for anything.

use nalgebra::{Matrix3, Vector3};

/// The rotation nearest to `m` in the Frobenius norm: the orthogonal polar factor, by Newton's iteration
/// X ← (X + X⁻ᵀ)/2 (Higham, *SIAM J. Sci. Stat. Comput.* 7, 1986), quadratically convergent from any non-singular start.
///
/// The observers let their attitude matrix leave SO(3); this brings it back before angles are read off. `None` when `m` is not
/// finite, is singular or nearly so, or has a negative determinant: then no rotation is meaningfully nearest.
pub fn polar_rotation(m: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let scale = m.norm();
    if !scale.is_finite() || scale < 1e-9 {
        return None;
    }
    let mut x = m * (3f64.sqrt() / scale);
    // 1 for a rotation at this scale; the smallest singular value is of this order, too.
    if x.determinant() < 1e-6 {
        return None;
    }
    for _ in 0..40 {
        let cof = cofactors(&x);
        // m · cof(m) of the first row is the determinant.
        let det = x.m11 * cof.m11 + x.m12 * cof.m12 + x.m13 * cof.m13;
        if !det.is_finite() || det < 1e-9 {
            return None;
        }
        let next = 0.5 * (x + cof / det);
        let change = (next - x).norm();
        x = next;
        if change < 1e-9 {
            // The error is of the order of the square of the last change.
            return Some(x);
        }
    }
    None
}

/// Matrix of cofactors: `det(m) m⁻ᵀ`.
fn cofactors(m: &Matrix3<f64>) -> Matrix3<f64> {
    let (a, b, c) = (m.column(0), m.column(1), m.column(2));
    Matrix3::from_columns(&[b.cross(&c), c.cross(&a), a.cross(&b)])
}

/// The rotation nearest to `m` in the Frobenius norm *among the rotations* (Kabsch, *Acta Cryst.* A32, 1976): U diag(1, 1, det UVᵀ) Vᵀ with
/// m = UΣVᵀ. Unlike [`polar_rotation`] it also answers to reflections, which a filter that estimates nine free numbers may
/// pass on its way. `None` when `m` is not finite or has rank below 2, where no rotation is nearest.
///
/// The estimates of the filters shrink under noise (homogeneous equations), so their scale means nothing and is dropped here.
pub fn kabsch_rotation(m: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    if !m.iter().all(|v| v.is_finite()) {
        return None;
    }
    // Huge and tiny numbers must not overflow on the way.
    let largest = m.amax();
    if largest < 1e-9 {
        return None;
    }
    let svd = (m / largest).try_svd(true, true, f64::EPSILON, 200)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut sorted: [f64; 3] = svd.singular_values.into();
    sorted.sort_by(|a, b| b.total_cmp(a));
    if sorted[1] < 1e-9 * sorted[0] {
        return None;
    }
    let mut sign = Vector3::from_element(1.0);
    // The reflection is taken out of the weakest direction.
    sign[svd.singular_values.imin()] = (u * v_t).determinant().signum();
    Some(u * Matrix3::from_diagonal(&sign) * v_t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::so3::exp;
    use proptest::prelude::*;

    fn vector(bound: f64) -> impl Strategy<Value = Vector3<f64>> {
        [-bound..bound, -bound..bound, -bound..bound].prop_map(|[x, y, z]| Vector3::new(x, y, z))
    }

    proptest! {
        #[test]
        fn it_is_the_polar_factor(phi in vector(3.0), d in vector(0.5), o in vector(0.5)) {
            // m = r p with p symmetric positive definite: then r is the polar factor of m.
            let p = Matrix3::new(1.7 + d.x, 0.5 * o.x, 0.5 * o.y, 0.5 * o.x, 1.7 + d.y, 0.5 * o.z, 0.5 * o.y, 0.5 * o.z, 1.7 + d.z);
            let r = exp(&phi);
            prop_assert!((polar_rotation(&(r * p)).unwrap() - r).norm() < 1e-12);
        }

        #[test]
        fn no_matrix_makes_it_misbehave(m in proptest::array::uniform9(proptest::num::f64::ANY)) {
            if let Some(r) = polar_rotation(&Matrix3::from_row_slice(&m)) {
                prop_assert!((r.transpose() * r - Matrix3::identity()).norm() < 1e-9);
            }
        }

        #[test]
        fn both_are_the_same_rotation_where_the_determinant_is_positive(m in proptest::array::uniform9(-2.0..2.0f64)) {
            let m = Matrix3::from_row_slice(&m);
            if let (Some(a), Some(b)) = (polar_rotation(&m), kabsch_rotation(&m)) {
                prop_assume!(m.determinant() > 1e-2);
                prop_assert!((a - b).norm() < 1e-9);
            }
        }

        #[test]
        fn no_other_rotation_is_nearer_than_kabschs(m in proptest::array::uniform9(-2.0..2.0f64), phi in proptest::array::uniform3(-3.0..3.0f64)) {
            let m = Matrix3::from_row_slice(&m);
            if let Some(r) = kabsch_rotation(&m) {
                prop_assert!((r.determinant() - 1.0).abs() < 1e-9);
                let other = exp(&Vector3::from(phi));
                prop_assert!((m - r).norm() <= (m - other).norm() + 1e-9);
            }
        }

        #[test]
        fn nothing_makes_kabschs_misbehave(m in proptest::array::uniform9(proptest::num::f64::ANY)) {
            if let Some(r) = kabsch_rotation(&Matrix3::from_row_slice(&m)) {
                prop_assert!((r.transpose() * r - Matrix3::identity()).norm() < 1e-6);
            }
        }
    }

    #[test]
    fn reflections_singular_and_non_finite_matrices_have_no_polar_rotation() {
        assert!(polar_rotation(&Matrix3::zeros()).is_none());
        assert!(polar_rotation(&Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 0.0))).is_none());
        assert!(polar_rotation(&Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0))).is_none());
        assert!(polar_rotation(&Matrix3::from_element(f64::NAN)).is_none());
    }
}
