//! From the nine numbers that a filter holds in place of a rotation to a rotation.

use nalgebra::{Matrix3, Vector3};

/// The rotation nearest to `m` in the Frobenius norm *among the rotations* (Kabsch, *Acta Cryst.* A32, 1976): U diag(1, 1, det UVᵀ) Vᵀ with
/// m = UΣVᵀ. Unlike [`crate::geo::so3::nearest_rotation`] it also answers to reflections, which a filter that estimates nine free numbers may
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
    use crate::geo::so3;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn it_is_the_polar_factor_where_that_is_a_rotation(m in proptest::array::uniform9(-2.0..2.0f64)) {
            let m = Matrix3::from_row_slice(&m);
            if let (Some(a), Some(b)) = (so3::nearest_rotation(&m), kabsch_rotation(&m)) {
                prop_assume!(m.determinant() > 1e-2);
                prop_assert!((a - b).norm() < 1e-9);
            }
        }

        #[test]
        fn no_other_rotation_is_nearer(m in proptest::array::uniform9(-2.0..2.0f64), phi in proptest::array::uniform3(-3.0..3.0f64)) {
            let m = Matrix3::from_row_slice(&m);
            if let Some(r) = kabsch_rotation(&m) {
                prop_assert!((r.determinant() - 1.0).abs() < 1e-9);
                let other = so3::exp(&Vector3::from(phi));
                prop_assert!((m - r).norm() <= (m - other).norm() + 1e-9);
            }
        }

        #[test]
        fn nothing_makes_it_misbehave(m in proptest::array::uniform9(proptest::num::f64::ANY)) {
            if let Some(r) = kabsch_rotation(&Matrix3::from_row_slice(&m)) {
                prop_assert!((r.transpose() * r - Matrix3::identity()).norm() < 1e-6);
            }
        }
    }
}
