//! Covariances as lists of numbers, and back: the upper triangle, row by row.

use nalgebra::SMatrix;

/// Variances beyond this are no variances of anything here: squares of them stay finite.
const LARGEST: f64 = 1e12;
/// What rounding may leave of a correlation beyond ±1, and of an eigenvalue of the correlations below zero.
const ROUNDING: f64 = 1e-6;

/// The upper triangle of a symmetric matrix.
pub fn upper<const N: usize>(m: &SMatrix<f64, N, N>) -> Vec<f64> {
    (0..N).flat_map(|i| (i..N).map(move |j| m[(i, j)])).collect()
}

/// The covariance whose upper triangle this is. `None` where it has another size, or is none: not finite, with a variance below zero, or
/// with correlations that no random vector has.
pub fn covariance<const N: usize>(upper: &[f64]) -> Option<SMatrix<f64, N, N>> {
    if upper.len() != N * (N + 1) / 2 || !upper.iter().all(|v| v.abs() <= LARGEST) {
        return None;
    }
    let mut m = SMatrix::<f64, N, N>::zeros();
    let mut rest = upper.iter();
    for i in 0..N {
        for j in i..N {
            let value = *rest.next()?;
            m[(i, j)] = value;
            m[(j, i)] = value;
        }
    }
    is_covariance(&m).then_some(m)
}

fn is_covariance<const N: usize>(m: &SMatrix<f64, N, N>) -> bool {
    // Of the correlations, whatever the units are.
    let mut correlations = SMatrix::<f64, N, N>::identity();
    for i in 0..N {
        for j in 0..N {
            let (a, b) = (m[(i, i)], m[(j, j)]);
            if a < 0.0 || (a == 0.0 && m[(i, j)] != 0.0) {
                return false;
            }
            if i != j && a > 0.0 && b > 0.0 {
                correlations[(i, j)] = m[(i, j)] / (a * b).sqrt();
            }
        }
    }
    is_positive(correlations)
}

/// Cholesky's decomposition exists, but for rounding.
fn is_positive<const N: usize>(mut m: SMatrix<f64, N, N>) -> bool {
    for j in 0..N {
        let pivot = m[(j, j)] + ROUNDING;
        if pivot.is_nan() || pivot <= 0.0 {
            return false;
        }
        for i in j + 1..N {
            let by = m[(i, j)] / pivot;
            for k in i..N {
                m[(k, i)] -= by * m[(k, j)];
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Matrix3};

    #[test]
    fn a_covariance_comes_back_as_it_was() {
        let l = Matrix3::new(1.0, 0.0, 0.0, 3.0, 1e-3, 0.0, -2.0, 5e-4, 1e3);
        let m = l * l.transpose();
        assert_eq!(covariance(&upper(&m)), Some(m));
        // A state that is none has neither variance nor correlations.
        let known = Matrix3::from_diagonal(&nalgebra::Vector3::new(0.0, 1.0, 2.0));
        assert_eq!(covariance(&upper(&known)), Some(known));
    }

    #[test]
    fn what_is_no_covariance_is_refused() {
        let wrong = [
            Matrix2::new(-1.0, 0.0, 0.0, 1.0),
            Matrix2::new(1.0, 1.1, 1.1, 1.0),
            Matrix2::new(0.0, 0.5, 0.5, 1.0),
            Matrix2::new(1.0, f64::NAN, f64::NAN, 1.0),
            Matrix2::new(1e13, 0.0, 0.0, 1.0),
        ];
        assert!(wrong.iter().all(|m| covariance::<2>(&upper(m)).is_none()));
        assert!(covariance::<2>(&[1.0, 0.0]).is_none() && covariance::<2>(&[1.0; 4]).is_none());
        // Every pair may be as it is, and all three together not.
        let r = -0.9;
        let three = Matrix3::new(1.0, r, r, r, 1.0, r, r, r, 1.0);
        assert!(covariance::<3>(&upper(&three)).is_none());
    }
}
