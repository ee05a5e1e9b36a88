//! What a solution has to be, whatever went in.
#![allow(dead_code, reason = "not every user needs all of it")]

use holdover::navigator::solution::Solution;

/// Whether every number of it is one.
pub fn is_finite(s: &Solution) -> bool {
    let matrices = [*s.attitude.matrix(), s.position_covariance.raw(), s.velocity_covariance.raw()];
    let vectors = [s.position.raw(), s.velocity.raw(), s.angular_rate.raw(), s.attitude_variance];
    matrices.iter().all(|m| m.iter().all(|v| v.is_finite()))
        && vectors.iter().all(|v| v.iter().all(|c| c.is_finite()))
}

/// Symmetric, and no variance in any direction below zero but for rounding.
pub fn is_covariance(m: &nalgebra::Matrix3<f64>) -> bool {
    let scale = m.trace().abs().max(1e-12);
    let symmetric = (m - m.transpose()).norm() <= 1e-9 * scale;
    symmetric && nalgebra::SymmetricEigen::new(*m).eigenvalues.min() >= -1e-9 * scale
}

pub fn check_form(s: &Solution, what: &str) {
    assert!(is_finite(s), "{what}: {s:?}");
    for covariance in [s.position_covariance.raw(), s.velocity_covariance.raw()] {
        assert!(is_covariance(&covariance), "{what}: {covariance}");
    }
    assert!(s.attitude_variance.iter().all(|v| *v >= 0.0), "{what}: {}", s.attitude_variance);
    let r = s.attitude.matrix();
    assert!((r * r.transpose() - nalgebra::Matrix3::identity()).norm() < 1e-6, "{what}: {r}");
}
