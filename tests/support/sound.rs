//! What a solution has to be, whatever went in.
#![allow(dead_code, reason = "not every user needs all of it")]

use holdover::navigator::solution::Solution;

/// Whether every number of it is one.
pub fn is_finite(s: &Solution) -> bool {
    let matrices = [&s.r_body_to_ned, &s.position_covariance, &s.velocity_covariance];
    let vectors = [&s.position_ned, &s.velocity_ned, &s.angular_rate_body, &s.attitude_variance];
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
    assert!(is_covariance(&s.position_covariance), "{what}: {}", s.position_covariance);
    assert!(is_covariance(&s.velocity_covariance), "{what}: {}", s.velocity_covariance);
    assert!(s.attitude_variance.iter().all(|v| *v >= 0.0), "{what}: {}", s.attitude_variance);
    let r = &s.r_body_to_ned;
    assert!((r * r.transpose() - nalgebra::Matrix3::identity()).norm() < 1e-6, "{what}: {r}");
}
