//! Is the claimed covariance honest? Normalised estimation error squared, eᵀP⁻¹e, of two axes: χ² with two degrees of freedom where it is.

use nalgebra::{Matrix2, Vector2};

/// The interval that holds 95 % of χ² with two degrees of freedom, whose distribution is 1 − e^(−x/2).
pub const BOUNDS_95: [f64; 2] = [0.050_635_6, 7.377_758_9];

/// Errors compared with their covariances.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NeesCount {
    count: u64,
    inside: u64,
    sum: f64,
}

impl NeesCount {
    /// Adds one error; a covariance without an inverse counts as out of bounds.
    pub fn add(&mut self, error: &Vector2<f64>, covariance: &Matrix2<f64>) {
        let nees = covariance.try_inverse().map_or(f64::INFINITY, |inverse| error.dot(&(inverse * error)));
        self.count += 1;
        self.sum += nees;
        if (BOUNDS_95[0]..=BOUNDS_95[1]).contains(&nees) {
            self.inside += 1;
        }
    }

    /// Both together.
    pub fn merged(self, other: Self) -> Self {
        Self {
            count: self.count + other.count,
            inside: self.inside + other.inside,
            sum: self.sum + other.sum,
        }
    }

    /// Mean; 2 for an honest covariance.
    pub fn mean(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
    }

    /// Part within [`BOUNDS_95`]; 0.95 for an honest covariance.
    pub fn in_bounds(&self) -> Option<f64> {
        (self.count > 0).then(|| self.inside as f64 / self.count as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bounds_hold_ninety_five_percent() {
        let below = |x: f64| 1.0 - (-0.5 * x).exp();
        assert!((below(BOUNDS_95[0]) - 0.025).abs() < 1e-6);
        assert!((below(BOUNDS_95[1]) - 0.975).abs() < 1e-6);
    }

    #[test]
    fn errors_are_weighed_by_their_covariance() {
        let mut n = NeesCount::default();
        assert_eq!((n.mean(), n.in_bounds()), (None, None));
        let p = Matrix2::new(4.0, 0.0, 0.0, 1.0);
        n.add(&Vector2::new(2.0, 1.0), &p);
        assert_eq!((n.mean(), n.in_bounds()), (Some(2.0), Some(1.0)));
        n.add(&Vector2::new(20.0, 0.0), &p);
        assert_eq!((n.mean(), n.in_bounds()), (Some(51.0), Some(0.5)));
        n.add(&Vector2::new(1.0, 1.0), &Matrix2::zeros());
        assert_eq!(n.mean(), Some(f64::INFINITY));
    }
}
