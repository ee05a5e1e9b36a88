//! Over a time of which nothing was measured: the state goes on with its velocity, and with the doubt that this leaves.
//!
//! Beside it, what a filter that has lost its attitude finds it by again: which way is up, and where the magnetic field points. Both set
//! the attitude at once, whatever the error was; the filter's own updates are linear, and good for small errors only.

use nalgebra::{Matrix3, Vector3};

use super::{BA, BG, BM, Eskf, FLOW, MICRO, P, SG, THETA, V, WIND};
use crate::geo::so3::exp;

/// What may have happened while nothing was measured: standard deviations an axis, rad, m and m/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Doubt {
    /// Of roll and pitch.
    pub tilt: f64,
    /// Of the heading.
    pub yaw: f64,
    /// Of the position.
    pub position: f64,
    /// Of the velocity.
    pub velocity: f64,
    /// Covariance of position and velocity over the product of their standard deviations, 0 to 1.
    pub correlation: f64,
    /// Of the accelerometers' biases, m/s².
    pub accel_bias: f64,
}

impl Doubt {
    /// None at all.
    pub const NONE: Doubt =
        Doubt { tilt: 0.0, yaw: 0.0, position: 0.0, velocity: 0.0, correlation: 0.0, accel_bias: 0.0 };
}

/// What becomes of a velocity that nobody measures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fade {
    /// What is left of it on each axis of NED, 0 to 1.
    pub kept: [f64; 3],
    /// How far it has led, s of it: the integral of what is left.
    pub way_s: f64,
}

impl Fade {
    /// It stays what it is for `seconds`.
    pub const fn none(seconds: f64) -> Self {
        Self { kept: [1.0; 3], way_s: seconds }
    }
}

impl Eskf {
    /// Adds what may have happened. Tilt and heading are rotations about NED's axes.
    pub fn doubt(&mut self, doubt: &Doubt) {
        self.propagate_covariance();
        let tilted = Vector3::new(doubt.tilt, doubt.tilt, doubt.yaw).map(|s| s * s);
        for i in 0..3 {
            self.p[(BA + i, BA + i)] += doubt.accel_bias * doubt.accel_bias;
        }
        let r = &self.state.r_body_to_ned;
        let body = r.transpose() * Matrix3::from_diagonal(&tilted) * r;
        let mut theta = self.p.fixed_view_mut::<3, 3>(THETA, THETA);
        theta += 0.5 * (body + body.transpose());
        let both = doubt.correlation * doubt.position * doubt.velocity;
        for i in 0..3 {
            self.p[(P + i, P + i)] += doubt.position * doubt.position;
            self.p[(V + i, V + i)] += doubt.velocity * doubt.velocity;
            self.p[(P + i, V + i)] += both;
            self.p[(V + i, P + i)] += both;
        }
    }

    /// The gyros may have been calibrated anew: their biases may be others by this standard deviation, rad/s.
    pub fn doubt_gyros(&mut self, sigma: f64) {
        self.propagate_covariance();
        for i in 0..3 {
            self.p[(BG + i, BG + i)] += sigma * sigma;
        }
    }

    /// What was held of the IMU's axes is not so: no bias and no scale error is known, but that they are within these, 1 sigma, rad/s and m/s².
    pub fn forget_imu(&mut self, gyro_bias: f64, accel_bias: f64) {
        self.propagate_covariance();
        let zero = Vector3::zeros();
        (self.state.gyro_bias, self.state.accel_bias, self.state.gyro_scale) = (zero, zero, zero);
        for (at, sigma) in [(BG, gyro_bias), (BA, accel_bias), (SG, self.settings.gyro_scale_sigma)] {
            (at..at + 3).for_each(|i| self.decorrelate(i, sigma));
        }
        self.forget_jumps();
    }

    /// Goes on for `seconds` without a measurement: p ← p + w v and v ← k v, of [`Fade`], with their errors likewise, and every walk walks on. The
    /// attitude stays.
    pub fn coast(&mut self, seconds: f64, fade: Fade) {
        self.propagate_covariance();
        self.state.position_ned += self.state.velocity_ned * fade.way_s;
        self.state.velocity_ned.component_mul_assign(&Vector3::from(fade.kept));
        // P ← Φ P Φᵀ with Φ = I but for δp += w δv and δv ← k δv: rows first, then columns.
        for i in 0..3 {
            let moved = self.p.row(V + i) * fade.way_s;
            self.p.row_mut(P + i).zip_apply(&moved, |p, m| *p += m);
            self.p.row_mut(V + i).scale_mut(fade.kept[i]);
        }
        for i in 0..3 {
            let moved = self.p.column(V + i) * fade.way_s;
            self.p.column_mut(P + i).zip_apply(&moved, |p, m| *p += m);
            self.p.column_mut(V + i).scale_mut(fade.kept[i]);
        }
        let s = self.settings;
        for (at, n, density) in [
            (BG, 3, s.gyro_bias_walk),
            (BA, 3, s.accel_bias_walk),
            (FLOW, 2, s.flow_bias_walk),
            (FLOW + 2, 2, s.flow_scale_walk),
            (BM, 3, s.magnetic_bias_walk * MICRO),
            (WIND, 2, s.air.wind_walk),
        ] {
            for i in at..at + n {
                self.p[(i, i)] += density * density * seconds;
            }
        }
    }

    /// The attitude is turned by `turn` (rad, about NED's axes) and known this well from then on: roll and pitch, heading, rad. It forgets
    /// what it had to do with everything else.
    pub fn set_attitude(&mut self, turn_ned: &Vector3<f64>, tilt: f64, yaw: f64) {
        self.propagate_covariance();
        self.state.r_body_to_ned = exp(turn_ned) * self.state.r_body_to_ned;
        for axis in 0..3 {
            self.decorrelate(THETA + axis, 0.0);
        }
        self.doubt(&Doubt { tilt, yaw, ..Doubt::NONE });
        self.restart_transition();
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::silent;
    use super::super::{EskfState, StartSigma};
    use super::*;
    use nalgebra::{SMatrix, SymmetricEigen};

    fn filter() -> Eskf {
        let r = exp(&Vector3::new(0.1, -0.2, 1.0));
        let state = EskfState::moving(r, Vector3::zeros(), Vector3::new(3.0, -1.0, 0.0), Vector3::zeros());
        let sigma = StartSigma {
            attitude_body: Vector3::repeat(0.01),
            position_ned: Vector3::repeat(1.0),
            velocity_ned: Vector3::repeat(0.5),
            gyro_bias: Vector3::zeros(),
            accel_bias: Vector3::zeros(),
            flow: SMatrix::zeros(),
        };
        Eskf::new(silent(), state, &sigma)
    }

    #[test]
    fn what_coasts_moves_with_its_velocity_and_its_doubt() {
        let mut filter = filter();
        filter.coast(4.0, Fade::none(4.0));
        assert!((filter.state().position_ned - Vector3::new(12.0, -4.0, 0.0)).norm() < 1e-12);
        // 1² + (4 · 0.5)²
        assert!((filter.position_covariance()[(0, 0)] - 5.0).abs() < 1e-12);
        assert!((filter.velocity_covariance()[(0, 0)] - 0.25).abs() < 1e-12);
        // Half of the velocity goes over, on a way of 3 s of it; 5 + 2 · 3 · 1 + 9 · 0.25, for cov(p, v) is 4 · 0.25.
        filter.coast(4.0, Fade { kept: [0.5; 3], way_s: 3.0 });
        assert!((filter.state().position_ned - Vector3::new(21.0, -7.0, 0.0)).norm() < 1e-12);
        assert!((filter.state().velocity_ned - Vector3::new(1.5, -0.5, 0.0)).norm() < 1e-12);
        assert!((filter.position_covariance()[(0, 0)] - 13.25).abs() < 1e-12);
        assert!((filter.velocity_covariance()[(0, 0)] - 0.0625).abs() < 1e-12);
        assert!(SymmetricEigen::new(filter.p).eigenvalues.min() > -1e-9);
    }

    #[test]
    fn doubt_that_is_correlated_is_taken_back_in_the_position_when_the_velocity_is_seen() {
        let doubt =
            Doubt { tilt: 0.1, yaw: 0.3, position: 10.0, velocity: 5.0, correlation: 0.8, accel_bias: 0.2 };
        let mut filter = filter();
        filter.doubt(&doubt);
        assert!(SymmetricEigen::new(filter.p).eigenvalues.min() > -1e-9);
        let attitude = filter.attitude_covariance_ned();
        assert!((attitude[(0, 0)] - 0.0101).abs() < 1e-9 && (attitude[(2, 2)] - 0.0901).abs() < 1e-9);
        let before = filter.position_covariance()[(0, 0)];
        let seen = super::super::covariance::SparseRow::unit(V);
        filter.fuse(&seen, 2.0, 0.01).unwrap();
        // 10 m · 0.8 / 5 m/s a metre per second, and 1 − 0.8² of the variance is left.
        assert!((filter.state().position_ned.x - 3.2).abs() < 0.1);
        assert!((filter.position_covariance()[(0, 0)] / before - 0.36).abs() < 0.03);
    }

    #[test]
    fn an_imu_that_is_forgotten_is_known_as_at_first() {
        let mut filter = filter();
        filter.state.accel_bias = Vector3::repeat(2.0);
        filter.state.gyro_scale = Vector3::repeat(-1.9);
        let seen = super::super::covariance::SparseRow::unit(BA);
        filter.fuse(&seen, 1e-3, 1e-2).unwrap();
        filter.forget_imu(0.01, 0.15);
        let s = filter.state();
        assert_eq!(s.accel_bias.norm() + s.gyro_scale.norm() + s.gyro_bias.norm(), 0.0);
        assert!((filter.p[(BA, BA)] - 0.0225).abs() < 1e-12 && (filter.p[(BG, BG)] - 1e-4).abs() < 1e-12);
        assert!(SymmetricEigen::new(filter.p).eigenvalues.min() > -1e-9);
    }

    #[test]
    fn an_attitude_that_is_set_is_known_as_told_and_forgets_the_rest() {
        let mut filter = filter();
        let before = filter.state().r_body_to_ned;
        filter.set_attitude(&Vector3::new(0.0, 0.0, 2.0), 0.2, 0.4);
        let turned = exp(&Vector3::new(0.0, 0.0, 2.0)) * before;
        assert!((filter.state().r_body_to_ned - turned).norm() < 1e-12);
        let attitude = filter.attitude_covariance_ned();
        assert!((attitude[(1, 1)] - 0.04).abs() < 1e-12 && (attitude[(2, 2)] - 0.16).abs() < 1e-12);
    }
}
