//! One axis of the double's own filter: position, velocity and the error of the acceleration, as a Kalman filter.

use nalgebra::{Matrix3, RowVector3, Vector3};

/// What is measured of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AxisQuantity {
    /// Position, m.
    Position,
    /// Velocity, m/s.
    Velocity,
}

/// Noise density of the acceleration: EK3_ACC_P_NSE and EKF2_ACC_NOISE of 0.35 m/s² a sample at 100 Hz, m/s²/√Hz.
const ACCELERATION_DENSITY: f64 = 0.035;
/// Random walk of the acceleration's error, m/s²/√s.
const BIAS_WALK: f64 = 0.002;
/// The acceleration's error before anything was measured, 1 sigma, m/s².
const BIAS_SIGMA: f64 = 0.1;
/// Velocity after a reset, 1 sigma, m/s.
const RESET_VELOCITY_SIGMA: f64 = 0.5;

/// An axis of NED.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisFilter {
    /// Position, velocity, error of the acceleration.
    x: Vector3<f64>,
    p: Matrix3<f64>,
}

impl AxisFilter {
    /// At rest at a place that is known to 0.1 m.
    pub fn at_rest(position_m: f64) -> Self {
        let p = Matrix3::from_diagonal(&Vector3::new(0.01, 0.01, BIAS_SIGMA.powi(2)));
        Self { x: Vector3::new(position_m, 0.0, 0.0), p }
    }

    /// Position, m.
    pub fn position(&self) -> f64 {
        self.x.x
    }

    /// Velocity, m/s.
    pub fn velocity(&self) -> f64 {
        self.x.y
    }

    /// Variance of the position, m².
    pub fn position_variance(&self) -> f64 {
        self.p[(0, 0)]
    }

    /// The acceleration without what it is thought to be off by, m/s².
    pub fn corrected(&self, acceleration_mps2: f64) -> f64 {
        acceleration_mps2 - self.x.z
    }

    /// Goes on by `dt_s` with a measured acceleration.
    pub fn predict(&mut self, dt_s: f64, acceleration_mps2: f64) {
        let a = self.corrected(acceleration_mps2);
        self.x.x += self.x.y * dt_s + 0.5 * a * dt_s.powi(2);
        self.x.y += a * dt_s;
        let half = 0.5 * dt_s.powi(2);
        let f = Matrix3::new(1.0, dt_s, -half, 0.0, 1.0, -dt_s, 0.0, 0.0, 1.0);
        self.p = f * self.p * f.transpose();
        self.p[(1, 1)] += ACCELERATION_DENSITY.powi(2) * dt_s;
        self.p[(2, 2)] += BIAS_WALK.powi(2) * dt_s;
    }

    /// Innovation squared over its variance times the gate squared: at most 1 for what is believed.
    pub fn test_ratio(&self, what: AxisQuantity, innovation: f64, variance: f64, gate_sigma: f64) -> f64 {
        let i = what as usize;
        innovation.powi(2) / ((self.p[(i, i)] + variance) * gate_sigma.powi(2))
    }

    /// Takes a measurement, without asking whether it is believed.
    pub fn fuse(&mut self, what: AxisQuantity, innovation: f64, variance: f64) {
        let mut h = RowVector3::zeros();
        h[what as usize] = 1.0;
        let s = (h * self.p * h.transpose())[(0, 0)] + variance;
        let k = self.p * h.transpose() / s;
        self.x += k * innovation;
        // Joseph's form keeps it symmetric and positive.
        let i_kh = Matrix3::identity() - k * h;
        self.p = i_kh * self.p * i_kh.transpose() + k * k.transpose() * variance;
    }

    /// Puts the position somewhere else, and leaves the velocity what it is, but less sure.
    pub fn reset_position(&mut self, position_m: f64, variance: f64) {
        self.x.x = position_m;
        self.forget(0, variance);
        self.p[(1, 1)] = self.p[(1, 1)].max(RESET_VELOCITY_SIGMA.powi(2));
    }

    /// Puts the velocity.
    pub fn reset_velocity(&mut self, velocity_mps: f64, variance: f64) {
        self.x.y = velocity_mps;
        self.forget(1, variance);
    }

    /// One element has this variance now, and nothing in common with the others.
    fn forget(&mut self, i: usize, variance: f64) {
        self.p.row_mut(i).fill(0.0);
        self.p.column_mut(i).fill(0.0);
        self.p[(i, i)] = variance;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steady_error_of_the_acceleration_is_learned_from_positions() {
        let mut axis = AxisFilter::at_rest(0.0);
        for k in 0..30_000 {
            axis.predict(0.004, 0.05);
            if k % 50 == 0 {
                axis.fuse(AxisQuantity::Position, 1.0 - axis.position(), 0.25);
            }
        }
        assert!((axis.position() - 1.0).abs() < 0.05, "{axis:?}");
        assert!((axis.corrected(0.05)).abs() < 0.01 && axis.velocity().abs() < 0.02, "{axis:?}");
    }

    #[test]
    fn dead_reckoning_grows_and_a_far_measurement_is_doubted() {
        let mut axis = AxisFilter::at_rest(0.0);
        let ratio = |axis: &AxisFilter| axis.test_ratio(AxisQuantity::Position, 5.0, 0.04, 5.0);
        assert!(ratio(&axis) > 1.0);
        for _ in 0..15_000 {
            axis.predict(0.004, 0.0);
        }
        assert!(ratio(&axis) < 1.0, "after a minute 5 m may be: {}", ratio(&axis));
        axis.reset_position(7.0, 0.04);
        assert_eq!(axis.position(), 7.0);
        assert!(ratio(&axis) > 0.5 && axis.position_variance() == 0.04);
    }
}
