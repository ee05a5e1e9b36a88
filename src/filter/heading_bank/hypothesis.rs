//! One hypothesis of the bank: a small error-state Kalman filter at its own heading.
//!
//! Nominal state R (body → NED), v (north, east) and gyro bias b; error state δx = [δθ, δv, δb], 3 + 2 + 3 numbers, the attitude error on the
//! side of NED (R_true = Exp(δθ) R): δθ_D is the heading's error whatever the tilt. With F = R f,
//!
//! δθ̇ = −R δb,  δv̇ = (−S(F) δθ)_NE,  δb random walks.
//!
//! All of it is linear in sums that can be taken sample by sample, so that the covariance is propagated once a fix, exactly but for the noise:
//! with A(t) = ∫R dt, δθ⁺ = δθ − A δb and δv⁺ = δv − (S(∫F dt) δθ)_NE + (∫S(F) A dt δb)_NE.

use nalgebra::{Cholesky, Matrix2, Matrix3, SMatrix, U2, Vector2, Vector3};

use super::tuning::LARGE_TURN;
use super::{HeadingBankSettings, Waiting};
use crate::geo::polar_rotation;
use crate::geo::so3::{exp, hat};

const STATES: usize = 8;
const THETA: usize = 0;
const V: usize = 3;
const B: usize = 5;

/// Covariance of a hypothesis' error state.
type Covariance = SMatrix<f64, STATES, STATES>;

/// What the error moves by, summed over the samples since the covariance was propagated last.
#[derive(Clone, Copy, Debug)]
struct HypothesisTransition {
    span_s: f64,
    /// ∫F dt, m/s.
    impulse: Vector3<f64>,
    /// ∫R dt, s.
    turned: Matrix3<f64>,
    /// ∫S(F) A dt, m.
    coupling: Matrix3<f64>,
    /// Variance of the attitude from noise, rad².
    attitude_noise: f64,
    /// Variance of the velocity from noise, m²/s².
    velocity_noise: f64,
}

impl HypothesisTransition {
    fn new() -> Self {
        Self {
            span_s: 0.0,
            impulse: Vector3::zeros(),
            turned: Matrix3::zeros(),
            coupling: Matrix3::zeros(),
            attitude_noise: 0.0,
            velocity_noise: 0.0,
        }
    }
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(super) struct Hypothesis {
    pub(super) r_body_to_ned: Matrix3<f64>,
    pub(super) velocity_ne: Vector2<f64>,
    pub(super) gyro_bias: Vector3<f64>,
    /// Logarithm of its weight, up to a constant that all have in common.
    pub(super) log_weight: f64,
    p: Covariance,
    pending: HypothesisTransition,
}

/// Standard deviations of a hypothesis at its start.
pub(super) struct HypothesisSigma {
    pub(super) tilt: f64,
    pub(super) heading: f64,
    pub(super) velocity: f64,
    pub(super) gyro_bias: f64,
}

impl Hypothesis {
    pub(super) fn new(
        r_body_to_ned: Matrix3<f64>,
        velocity_ne: Vector2<f64>,
        sigma: &HypothesisSigma,
    ) -> Self {
        let (t, h, v, b) = (sigma.tilt, sigma.heading, sigma.velocity, sigma.gyro_bias);
        let sigma = SMatrix::<f64, STATES, 1>::from([t, t, h, v, v, b, b, b]);
        Self {
            r_body_to_ned,
            velocity_ne,
            gyro_bias: Vector3::zeros(),
            log_weight: 0.0,
            p: Covariance::from_diagonal(&sigma.component_mul(&sigma)),
            pending: HypothesisTransition::new(),
        }
    }

    /// The mean angular rate and specific force over an interval.
    pub(super) fn propagate(&mut self, w: &Waiting, settings: &HeadingBankSettings) {
        let dt = w.dt;
        let rate = w.rate_body - self.gyro_bias;
        let half = exp(&(rate * (0.5 * dt)));
        let middle = self.r_body_to_ned * half;
        let force_ned = middle * w.force_body;
        self.r_body_to_ned = middle * half;
        self.velocity_ne += dt * force_ned.xy();
        let step = &mut self.pending;
        step.coupling += hat(&force_ned) * (step.turned + middle * (0.5 * dt)) * dt;
        step.turned += middle * dt;
        step.impulse += force_ned * dt;
        step.span_s += dt;
        step.attitude_noise += dt
            * (settings.gyro_noise.powi(2)
                + settings.gyro_rate_noise.powi(2) * rate.norm_squared()
                + w.rate_variance * dt);
        step.velocity_noise += dt * (settings.accel_noise.powi(2) + w.force_variance * dt);
    }

    /// Brings the covariance up to the nominal state.
    pub(super) fn propagate_covariance(&mut self, settings: &HeadingBankSettings) {
        let step = std::mem::replace(&mut self.pending, HypothesisTransition::new());
        if step.span_s <= 0.0 {
            return;
        }
        let tilting = -hat(&step.impulse).fixed_rows::<2>(0);
        let mut phi = Covariance::identity();
        phi.fixed_view_mut::<3, 3>(THETA, B).copy_from(&-step.turned);
        phi.fixed_view_mut::<2, 3>(V, THETA).copy_from(&tilting);
        phi.fixed_view_mut::<2, 3>(V, B).copy_from(&step.coupling.fixed_rows::<2>(0));
        let mut p = phi * self.p * phi.transpose();
        // White noise of the attitude over the interval, and what it has made of the velocity by then: the force is taken as constant.
        let q = step.attitude_noise;
        let cross = tilting * (0.5 * q);
        let through = tilting * tilting.transpose() * (q / 3.0);
        for i in 0..3 {
            p[(THETA + i, THETA + i)] += q;
            p[(B + i, B + i)] += settings.gyro_bias_walk.powi(2) * step.span_s;
        }
        let accel = Matrix2::identity() * step.velocity_noise;
        let mut vv = p.fixed_view_mut::<2, 2>(V, V);
        vv += through + accel;
        let mut vt = p.fixed_view_mut::<2, 3>(V, THETA);
        vt += cross;
        let mut tv = p.fixed_view_mut::<3, 2>(THETA, V);
        tv += cross.transpose();
        self.p = 0.5 * (p + p.transpose());
        if let Some(clean) = polar_rotation(&self.r_body_to_ned) {
            self.r_body_to_ned = clean;
        }
    }

    /// Innovation squared over its covariance against a measured horizontal velocity, and that covariance's determinant.
    pub(super) fn surprise(&self, velocity_ne: &Vector2<f64>, noise: &Matrix2<f64>) -> Option<(f64, f64)> {
        self.judged(velocity_ne, noise).map(|(nis, determinant, _)| (nis, determinant))
    }

    /// The same with the innovation's covariance, factored.
    fn judged(
        &self,
        velocity_ne: &Vector2<f64>,
        noise: &Matrix2<f64>,
    ) -> Option<(f64, f64, Cholesky<f64, U2>)> {
        let s = Cholesky::new(self.p.fixed_view::<2, 2>(V, V) + noise)?;
        let innovation = velocity_ne - self.velocity_ne;
        let (nis, determinant) = (innovation.dot(&s.solve(&innovation)), s.determinant());
        (nis.is_finite() && determinant > 0.0).then_some((nis, determinant, s))
    }

    /// A horizontal velocity with its covariance. The weight becomes w · N(innovation; 0, S).
    pub(super) fn fuse(&mut self, velocity_ne: &Vector2<f64>, noise: &Matrix2<f64>) {
        let Some((nis, determinant, s)) = self.judged(velocity_ne, noise) else { return };
        let ph = self.p.fixed_columns::<2>(V).into_owned();
        let gain = s.solve(&ph.transpose()).transpose();
        let dx = gain * (velocity_ne - self.velocity_ne);
        let p = self.p - gain * ph.transpose();
        self.p = 0.5 * (p + p.transpose());
        self.log_weight -= 0.5 * (nis + determinant.ln());
        let turn = dx.fixed_rows::<3>(THETA).into_owned();
        self.r_body_to_ned = exp(&turn) * self.r_body_to_ned;
        self.velocity_ne += dx.fixed_rows::<2>(V);
        self.gyro_bias += dx.fixed_rows::<3>(B);
        let angle = turn.norm();
        if angle > LARGE_TURN {
            // The next term of the series: what a linear correction of this size may be off by.
            let left = 0.5 * angle * angle;
            for i in 0..3 {
                self.p[(THETA + i, THETA + i)] += left * left;
            }
        }
    }

    pub(super) fn is_finite(&self) -> bool {
        let state = self.r_body_to_ned.sum() + self.velocity_ne.sum() + self.gyro_bias.sum();
        (state + self.p.sum() + self.log_weight).is_finite()
    }

    /// Covariance of the attitude, about NED's axes, rad².
    pub(super) fn attitude_covariance(&self) -> Matrix3<f64> {
        self.p.fixed_view::<3, 3>(THETA, THETA).into_owned()
    }

    /// Variances of the velocity, m²/s².
    pub(super) fn velocity_covariance(&self) -> Matrix2<f64> {
        self.p.fixed_view::<2, 2>(V, V).into_owned()
    }

    /// Covariance of the gyro bias, rad²/s².
    pub(super) fn bias_covariance(&self) -> Matrix3<f64> {
        self.p.fixed_view::<3, 3>(B, B).into_owned()
    }
}
