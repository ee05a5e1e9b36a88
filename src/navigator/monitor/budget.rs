//! How wrong the horizontal position may be: an error budget by sensitivities.
//!
//! The observers carry no covariance. In holdover their position error is, to first order, linear in a few constants that are
//! known with a covariance when GNSS goes: p̃(t) = p̃₀ + J(t)·x̃ with x = [b_x, b_y, s, μ] of the flow
//! ([`crate::camera::calibration`]), J̇ = R_xy·∂v/∂x. So the directions count: a scale error grows with the distance from the start
//! and shrinks on the way back, a body-fixed bias averages out in circles. To that come white noise (a random walk), a heading
//! error that changes with time, and a scale that wanders with terrain. Without any velocity, the budget is that of inertial
//! coasting: initial velocity ∝ t, tilt ∝ g·t²/2, gyro bias ∝ g·t³/6.

use crate::geo::NOMINAL_GRAVITY_MPS2;
use crate::navigator::tuning::budget::SCALE_CORRELATION_M;
use nalgebra::{Matrix2, Matrix2x4, Matrix3, Matrix4, Vector2};

/// The error sources of dead reckoning that nothing measures in flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BudgetSettings {
    /// Heading error with a magnetometer that was not there when the flow was compared with GNSS (it changes with heading), rad.
    pub heading_sigma_rad: f64,
    /// Growth of the heading error without a magnetometer, rad/s.
    pub heading_drift_radps: f64,
    /// Scale error of flow that comes and goes with the ground (relative), over a path of 100 m.
    pub scale_wander: f64,
    /// Scale error when the height over ground is the altimeter's and not a rangefinder's (relative).
    pub height_scale_sigma: f64,
    /// Horizontal velocity error at the start of an outage, m/s.
    pub velocity_sigma_mps: f64,
    /// Tilt error, rad.
    pub tilt_sigma_rad: f64,
    /// Error of the gyro bias, rad/s.
    pub gyro_bias_sigma_radps: f64,
}

/// Horizontal uncertainty since the start of an outage.
#[derive(Clone, Debug)]
pub struct ErrorBudget {
    settings: BudgetSettings,
    start: Matrix2<f64>,
    calibration: Matrix4<f64>,
    sensitivity: Matrix2x4<f64>,
    /// Displacement since the start, NE, m, while carried by flow.
    moved: Vector2<f64>,
    /// ∫(time since start)·v dt: sensitivity to a heading drift.
    moved_by_time: Vector2<f64>,
    walk: f64,
    elapsed_s: f64,
    /// Time without any velocity: coasting.
    coasted_s: f64,
    velocity: Matrix2<f64>,
}

impl ErrorBudget {
    /// An outage begins with position covariance `start` (NE, m²) and the flow calibration's covariance.
    pub fn new(settings: BudgetSettings, start: Matrix2<f64>, calibration: Matrix4<f64>) -> Self {
        let v = settings.velocity_sigma_mps.powi(2);
        Self {
            settings,
            start,
            calibration,
            sensitivity: Matrix2x4::zeros(),
            moved: Vector2::zeros(),
            moved_by_time: Vector2::zeros(),
            walk: 0.0,
            elapsed_s: 0.0,
            coasted_s: 0.0,
            velocity: Matrix2::identity() * v,
        }
    }

    /// Goes on by `dt` s carried by a flow velocity: `jacobian` = ∂v_xy/∂x in body axes, `v_ne` the velocity (m/s), `noise_mps2`
    /// the white noise of the flow velocity as a density, m²/s²·s (variance of a sample times its interval).
    pub fn carried(
        &mut self,
        dt: f64,
        r_body_to_ned: &Matrix3<f64>,
        jacobian: &Matrix2x4<f64>,
        v_ne: &Vector2<f64>,
        noise_density: f64,
        ranged: bool,
    ) {
        let s = &self.settings;
        let r_xy = r_body_to_ned.fixed_view::<2, 2>(0, 0);
        let h = r_xy * jacobian;
        self.sensitivity += h * dt;
        self.moved += v_ne * dt;
        self.moved_by_time += v_ne * (self.elapsed_s * dt);
        let speed = v_ne.norm();
        let scale = if ranged { s.scale_wander } else { s.scale_wander.hypot(s.height_scale_sigma) };
        self.walk += (noise_density + scale * scale * speed * SCALE_CORRELATION_M) * dt;
        self.elapsed_s += dt;
        self.coasted_s = 0.0;
        let heading = s.heading_sigma_rad * speed;
        self.velocity = h * self.calibration * h.transpose()
            + Matrix2::identity() * ((scale * speed).powi(2) + heading * heading + 0.05f64.powi(2));
    }

    /// Goes on by `dt` s without any measured velocity.
    pub fn coasted(&mut self, dt: f64) {
        let s = self.settings;
        let (before, after) = (self.coasting_m(), {
            self.coasted_s += dt;
            self.coasting_m()
        });
        // The growth of the standard deviation goes on from where the flow left off.
        self.walk += after * after - before * before;
        self.elapsed_s += dt;
        let t = self.coasted_s;
        let v = s.velocity_sigma_mps
            + NOMINAL_GRAVITY_MPS2 * (s.tilt_sigma_rad * t + 0.5 * s.gyro_bias_sigma_radps * t * t);
        self.velocity = Matrix2::identity() * v * v;
    }

    fn coasting_m(&self) -> f64 {
        let (s, t) = (&self.settings, self.coasted_s);
        let terms = [
            s.velocity_sigma_mps * t,
            NOMINAL_GRAVITY_MPS2 * s.tilt_sigma_rad * t * t / 2.0,
            NOMINAL_GRAVITY_MPS2 * s.gyro_bias_sigma_radps * t.powi(3) / 6.0,
        ];
        terms.iter().map(|v| v * v).sum::<f64>().sqrt()
    }

    /// Covariance of the horizontal position, NE, m².
    pub fn position(&self, magnetometer: bool) -> Matrix2<f64> {
        let s = &self.settings;
        let across = Vector2::new(-self.moved.y, self.moved.x);
        let mut p = self.start + self.sensitivity * self.calibration * self.sensitivity.transpose();
        p += Matrix2::identity() * self.walk;
        p += across * across.transpose() * s.heading_sigma_rad.powi(2);
        if !magnetometer {
            let drift = Vector2::new(-self.moved_by_time.y, self.moved_by_time.x) * s.heading_drift_radps;
            p += drift * drift.transpose();
        }
        p
    }

    /// Time since the outage began, s.
    pub fn elapsed_s(&self) -> f64 {
        self.elapsed_s
    }

    /// Covariance of the horizontal velocity, NE, m²/s².
    pub fn velocity(&self) -> Matrix2<f64> {
        self.velocity
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::calibration::FlowCalibration;
    use nalgebra::Vector4;

    fn settings() -> BudgetSettings {
        BudgetSettings {
            heading_sigma_rad: 0.0,
            heading_drift_radps: 0.0,
            scale_wander: 0.0,
            height_scale_sigma: 0.0,
            velocity_sigma_mps: 0.1,
            tilt_sigma_rad: 0.005,
            gyro_bias_sigma_radps: 1e-4,
        }
    }

    fn carry(b: &mut ErrorBudget, yaw: f64, v: Vector2<f64>, seconds: f64) {
        let r = crate::geo::so3::Euler { roll_rad: 0.0, pitch_rad: 0.0, yaw_rad: yaw }.to_rotation();
        let v_ne = r.fixed_view::<2, 2>(0, 0) * v;
        for _ in 0..(seconds / 0.1) as usize {
            b.carried(0.1, &r, &FlowCalibration::jacobian(&v, 10.0), &v_ne, 0.0, true);
        }
    }

    #[test]
    fn a_scale_error_is_undone_on_the_way_back_and_a_body_bias_too() {
        let calibration = Matrix4::from_diagonal(&Vector4::new(1e-4, 1e-4, 0.0025, 0.0));
        let mut b = ErrorBudget::new(settings(), Matrix2::zeros(), calibration);
        carry(&mut b, 0.0, Vector2::new(10.0, 0.0), 100.0);
        let out = b.position(true);
        // 0.1 m/s for 100 s and 5 % of 1000 m along the track, 0.1 m/s across it.
        assert!((out[(0, 0)].sqrt() - 10f64.hypot(50.0)).abs() < 0.1);
        assert!((out[(1, 1)].sqrt() - 10.0).abs() < 0.1);
        carry(&mut b, std::f64::consts::PI, Vector2::new(10.0, 0.0), 100.0);
        assert!(b.position(true).trace().sqrt() < 0.1);
    }

    #[test]
    fn coasting_grows_with_the_cube_of_time() {
        let mut b = ErrorBudget::new(settings(), Matrix2::zeros(), Matrix4::zeros());
        for _ in 0..600 {
            b.coasted(0.1);
        }
        let expected = (0.1f64 * 60.0).hypot(9.81 * 0.005 * 1800.0).hypot(9.81 * 1e-4 * 36000.0);
        assert!((b.position(true)[(0, 0)].sqrt() - expected).abs() < 0.01 * expected);
    }
}
