//! The exogenous Kalman filter: a linear Kalman filter about the trajectory of a nonlinear observer (Fusini, Section V).
//!
//! The observer converges from anywhere but filters with constant gains; a Kalman filter has the gains right but may diverge when it is
//! linearised about its own error. Here the second stage is linearised about the *observer's* trajectory x̄ (exogenous), so what it
//! estimates never comes back into its own linearisation. State x = [Θ, p, v, b_ω, b_f], (10):
//!
//! x⁺ = x + dt (f(x̄, u) + F(x̄)(x − x̄)),  P⁺ = (I + F dt) P (I + F dt)ᵀ + Q dt,  Q = diag(T q_ω Tᵀ, 0, q_f I, q_bω I, q_bf I),
//!
//! and scalar updates with the innovation y − h(x̄) − H(x̄)(x − x̄). Measurements are those of (2): altitude y1, flow velocity y2, specific
//! force y3 (optional), GNSS position y4 and velocity y5; and a magnetic direction where the observer is Grip's. In dead reckoning y4 and
//! y5 are gone and the biases are frozen.
//!
//! Start it when the observer has converged, not at t = 0: its covariance would shrink during the observer's transient; and start
//! it anew when the observer disagrees. It fails with the nose near the vertical, where Euler angles do.

use nalgebra::{Matrix3, SMatrix, SVector, Vector2, Vector3};

use super::euler_model::{
    BF, BW, JacobianRow, LinearisedKinematics, P, THETA, V, angle_axes, body_velocity, difference, direction,
    rate_to_angles, turning_force,
};
pub use super::euler_model::{EulerState, STATES, SpecificForceForm, XkfInput};
use super::state::{StepRefusal, check};
use crate::filter::error_state::Gated;
use crate::geo::so3::wrap_pi;

/// Noise and gates of the second stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct XkfSettings {
    /// Gyro noise density n_ω, rad/s/√Hz.
    pub gyro_noise: f64,
    /// Accelerometer noise density n_f, m/s²/√Hz.
    pub accel_noise: f64,
    /// Random walk of the gyro bias, rad/s/√s.
    pub gyro_bias_walk: f64,
    /// Random walk of the accelerometer bias, m/s²/√s.
    pub accel_bias_walk: f64,
    /// Time constant of the flow velocity bias's low-pass, s (Fusini, Section IV; in body axes, see
    /// [`super::fusini::FlowBiasForm::Body`]).
    pub flow_bias_time_constant_s: f64,
    /// Innovations beyond this many sigmas are rejected; infinite as published.
    pub gate_sigma: f64,
    /// What the specific force y3 is taken for.
    pub specific_force: SpecificForceForm,
}

/// Whether the biases are estimated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BiasMode {
    /// With GNSS.
    Estimated,
    /// In dead reckoning, as published: their rows and columns of P and Q are zero, so nothing moves them, and nothing is known of
    /// their errors any more either.
    Frozen,
}

/// What an update moved: a remembered past moves with it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct XkfCorrection {
    /// Of the position, NED, m.
    pub position_ned: Vector3<f64>,
    /// Of the velocity, NED, m/s.
    pub velocity_ned: Vector3<f64>,
    /// Normalised innovation squared; 1 on average where the filter is honest.
    pub nis: f64,
}

/// The second stage. See the module's documentation.
#[derive(Clone, Debug)]
pub struct Xkf {
    settings: XkfSettings,
    x: SVector<f64, STATES>,
    p: SMatrix<f64, STATES, STATES>,
    flow_bias: Vector3<f64>,
    /// Of the last prediction.
    biases: BiasMode,
}

impl Xkf {
    /// Starts at `start` with standard deviations of [Θ (rad), p (m), v (m/s), b_ω (rad/s), b_f (m/s²)] and a flow velocity bias b_v (body,
    /// m/s).
    pub fn new(
        settings: XkfSettings,
        start: &EulerState,
        sigma: &[Vector3<f64>; 5],
        flow_bias: Vector3<f64>,
    ) -> Self {
        let sigma = SVector::<f64, STATES>::from_iterator(sigma.iter().flat_map(|s| s.iter().copied()));
        let p = SMatrix::from_diagonal(&sigma.component_mul(&sigma));
        Self { settings, x: start.vector(), p, flow_bias, biases: BiasMode::Estimated }
    }

    /// The estimate. Angles are wrapped.
    pub fn state(&self) -> EulerState {
        EulerState::from_vector(&self.x)
    }

    /// b_v, bias of the flow velocity, body, m/s.
    pub fn flow_bias(&self) -> Vector3<f64> {
        self.flow_bias
    }

    /// P, in the order [Θ, p, v, b_ω, b_f].
    pub fn covariance(&self) -> &SMatrix<f64, STATES, STATES> {
        &self.p
    }

    /// Covariance of the position, NED, m².
    pub fn position_covariance(&self) -> Matrix3<f64> {
        self.p.fixed_view::<3, 3>(P, P).into_owned()
    }

    /// Covariance of the velocity, NED, m²/s².
    pub fn velocity_covariance(&self) -> Matrix3<f64> {
        self.p.fixed_view::<3, 3>(V, V).into_owned()
    }

    /// Covariance of the attitude error as a rotation vector in NED axes, rad²: R E P_Θ Eᵀ Rᵀ.
    pub fn attitude_covariance_ned(&self) -> Matrix3<f64> {
        let s = self.state();
        let to_ned = s.r_body_to_ned() * angle_axes(&s.angles);
        to_ned * self.p.fixed_view::<3, 3>(THETA, THETA) * to_ned.transpose()
    }

    /// Whether everything is finite.
    pub fn is_finite(&self) -> bool {
        (self.x.sum() + self.p.sum() + self.flow_bias.sum()).is_finite()
    }

    /// One IMU sample. `about` is the observer's state *before* the sample.
    ///
    /// # Errors
    /// [`StepRefusal`] when an input is not finite or the interval is out of (0, 1] s; nothing is changed then.
    pub fn predict(
        &mut self,
        about: &EulerState,
        input: &XkfInput,
        biases: BiasMode,
    ) -> Result<(), StepRefusal> {
        let u = input;
        check(u.dt_s, &[&u.angular_rate_body, &u.specific_force_body, &u.gravity_ned, &u.earth_rate_ned])?;
        let d = LinearisedKinematics::new(about, u);
        let delta = difference(&self.x, &about.vector());
        let part = |at| delta.fixed_rows::<3>(at).into_owned();
        let mut rate = d.rate;
        let mut add = |at: usize, v: Vector3<f64>| {
            let mut rows = rate.fixed_rows_mut::<3>(at);
            rows += v;
        };
        add(THETA, d.angles_by_angles * part(THETA) + d.angles_by_gyro_bias * part(BW));
        add(P, part(V));
        add(
            V,
            d.velocity_by_angles * part(THETA)
                + d.velocity_by_velocity * part(V)
                + d.velocity_by_accel_bias * part(BF),
        );
        self.x += u.dt_s * rate;
        self.biases = biases;
        self.wrap();
        self.predict_covariance(&d, about, u.dt_s, biases);
        Ok(())
    }

    /// (I + F dt) P (I + F dt)ᵀ + Q dt, by blocks: the identity's rows are not multiplied.
    fn predict_covariance(
        &mut self,
        d: &LinearisedKinematics,
        about: &EulerState,
        dt: f64,
        biases: BiasMode,
    ) {
        type Rows = SMatrix<f64, 3, STATES>;
        let rows =
            |p: &SMatrix<f64, STATES, STATES>, at: usize| -> Rows { p.fixed_rows::<3>(at).into_owned() };
        for _ in 0..2 {
            let (theta, v) = (rows(&self.p, THETA), rows(&self.p, V));
            let (bw, bf, p) = (rows(&self.p, BW), rows(&self.p, BF), rows(&self.p, P));
            let theta_moves = d.angles_by_angles * theta + d.angles_by_gyro_bias * bw;
            let v_moves =
                d.velocity_by_angles * theta + d.velocity_by_velocity * v + d.velocity_by_accel_bias * bf;
            self.p.fixed_rows_mut::<3>(THETA).copy_from(&(theta + theta_moves * dt));
            self.p.fixed_rows_mut::<3>(P).copy_from(&(p + v * dt));
            self.p.fixed_rows_mut::<3>(V).copy_from(&(v + v_moves * dt));
            // The second time round the same is done to the columns, and the transpose undone.
            self.p.transpose_mut();
        }
        let s = &self.settings;
        let t = rate_to_angles(&about.angles);
        let mut angles = self.p.fixed_view_mut::<3, 3>(THETA, THETA);
        angles += t * t.transpose() * (s.gyro_noise.powi(2) * dt);
        let mut walk = |at: usize, density: f64| {
            for i in at..at + 3 {
                self.p[(i, i)] += density * density * dt;
            }
        };
        walk(V, s.accel_noise);
        match biases {
            BiasMode::Estimated => {
                walk(BW, s.gyro_bias_walk);
                walk(BF, s.accel_bias_walk);
            }
            BiasMode::Frozen => {
                self.p.fixed_rows_mut::<6>(BW).fill(0.0);
                self.p.fixed_columns_mut::<6>(BW).fill(0.0);
            }
        }
        self.no_negative_variance();
    }

    /// A position component (y4; with axis 2 the altimeter's y1), NED, m. The model is linear: the innovation is y − p, or, for a late
    /// sample, y less the p of its time.
    ///
    /// # Errors
    /// [`Gated`].
    pub fn fuse_position(
        &mut self,
        axis: usize,
        innovation: f64,
        variance: f64,
    ) -> Result<XkfCorrection, Gated> {
        self.fuse(&unit(P + axis.min(2)), innovation, variance)
    }

    /// A velocity component (y5), NED, m/s: the innovation is y − v.
    ///
    /// # Errors
    /// [`Gated`].
    pub fn fuse_velocity(
        &mut self,
        axis: usize,
        innovation: f64,
        variance: f64,
    ) -> Result<XkfCorrection, Gated> {
        self.fuse(&unit(V + axis.min(2)), innovation, variance)
    }

    /// One axis of the flow velocity v_m, body, m/s (y2 = Rᵀv + b_v). `about` is the observer's state at the measurement.
    ///
    /// # Errors
    /// [`Gated`].
    pub fn fuse_flow(
        &mut self,
        about: &EulerState,
        axis: usize,
        flow_velocity_mps: f64,
        variance: f64,
    ) -> Result<XkfCorrection, Gated> {
        let axis = axis.min(2);
        self.fuse_about(about, body_velocity(about, axis), flow_velocity_mps - self.flow_bias[axis], variance)
    }

    /// A flow velocity, body x and y, of some time ago: `innovation_xy` is v_m less Rᵀv + b_v of its time, which the caller remembers;
    /// the rows are those about `about`.
    ///
    /// # Errors
    /// [`Gated`]: then neither component is used.
    pub fn fuse_late_flow(
        &mut self,
        about: &EulerState,
        innovation_xy: &Vector2<f64>,
        variance_xy: &Vector2<f64>,
    ) -> Result<[XkfCorrection; 2], Gated> {
        let rows = [0, 1].map(|axis| body_velocity(about, axis).1);
        for axis in 0..2 {
            self.gate(&rows[axis], innovation_xy[axis], variance_xy[axis])?;
        }
        let before = self.x;
        let first = self.fuse(&rows[0], innovation_xy.x, variance_xy.x)?;
        // What the first has changed of the second's expectation.
        let moved = (rows[1] * difference(&self.x, &before))[0];
        let second = self.fuse(&rows[1], innovation_xy.y - moved, variance_xy.y)?;
        Ok([first, second])
    }

    /// Position and velocity are known anew, horizontally, with these standard deviations; the rest stays, and forgets what it had to do
    /// with the old ones.
    pub fn reset_motion(
        &mut self,
        position_ne: &Vector2<f64>,
        velocity_ne: &Vector2<f64>,
        sigma_position_m: f64,
        sigma_velocity_mps: f64,
    ) {
        for (block, value, sigma) in
            [(P, position_ne, sigma_position_m), (V, velocity_ne, sigma_velocity_mps)]
        {
            for axis in 0..2 {
                let i = block + axis;
                self.p.row_mut(i).fill(0.0);
                self.p.column_mut(i).fill(0.0);
                self.p[(i, i)] = sigma * sigma;
                self.x[i] = value[axis];
            }
        }
    }

    /// One axis of the IMU's specific force f_m, m/s², where the vehicle's acceleration is that of a steady turn (y3). Only for motions
    /// whose body velocity hardly changes.
    ///
    /// # Errors
    /// [`Gated`].
    pub fn fuse_specific_force(
        &mut self,
        about: &EulerState,
        input: &XkfInput,
        axis: usize,
        variance: f64,
    ) -> Result<XkfCorrection, Gated> {
        let axis = axis.min(2);
        let frozen = self.biases == BiasMode::Frozen;
        let expected = turning_force(about, input, self.settings.specific_force, frozen, axis);
        self.fuse_about(about, expected, input.specific_force_body[axis], variance)
    }

    /// One axis of a direction known in NED and seen in body axes, a_b = Rᵀ a_n: the magnetic field of Grip's measurements.
    ///
    /// # Errors
    /// [`Gated`].
    pub fn fuse_direction(
        &mut self,
        about: &EulerState,
        axis: usize,
        seen_body: f64,
        known_ned: &Vector3<f64>,
        variance: f64,
    ) -> Result<XkfCorrection, Gated> {
        self.fuse_about(about, direction(about, known_ned, axis.min(2)), seen_body, variance)
    }

    /// Low-pass of the flow velocity bias at a flow frame, while there is GNSS: b_v += a (v_m − R(Θ)ᵀ v − b_v), a = 1 − e^{−dt/τ}, with the
    /// filter's own Θ and v. `interval_s` is the time since the last frame. What is not finite is ignored.
    pub fn update_flow_bias(&mut self, flow_velocity_body: &Vector3<f64>, interval_s: f64) {
        if check(interval_s.min(1.0), &[flow_velocity_body]).is_err() {
            return;
        }
        let a = -(-interval_s / self.settings.flow_bias_time_constant_s).exp_m1();
        let s = self.state();
        let sample = flow_velocity_body - s.r_body_to_ned().tr_mul(&s.velocity_ned);
        self.flow_bias += a * (sample - self.flow_bias);
    }

    /// The position moves by `by`, NED, m: an origin that moved, or a decision. No measurement.
    pub fn shift_position(&mut self, by_ned: &Vector3<f64>) {
        let mut rows = self.x.fixed_rows_mut::<3>(P);
        rows += by_ned;
    }

    /// An update with a model that is linearised about `about`: the innovation is y − h(x̄) − H(x̄)(x − x̄).
    fn fuse_about(
        &mut self,
        about: &EulerState,
        (expected, h): (f64, JacobianRow),
        measured: f64,
        variance: f64,
    ) -> Result<XkfCorrection, Gated> {
        let ahead = (h * difference(&self.x, &about.vector()))[0];
        self.fuse(&h, measured - expected - ahead, variance)
    }

    fn fuse(&mut self, h: &JacobianRow, innovation: f64, variance: f64) -> Result<XkfCorrection, Gated> {
        let (ph, s) = self.gate(h, innovation, variance)?;
        let dx = ph * (innovation / s);
        self.x += dx;
        self.wrap();
        // For a scalar, Joseph's form is P − P hᵀ h P/s.
        self.p -= ph * (ph / s).transpose();
        self.p = 0.5 * (self.p + self.p.transpose());
        self.no_negative_variance();
        Ok(XkfCorrection {
            position_ned: dx.fixed_rows::<3>(P).into_owned(),
            velocity_ned: dx.fixed_rows::<3>(V).into_owned(),
            nis: innovation * innovation / s,
        })
    }

    /// P hᵀ and the innovation's variance, if the innovation is likely enough.
    fn gate(
        &self,
        h: &JacobianRow,
        innovation: f64,
        variance: f64,
    ) -> Result<(SVector<f64, STATES>, f64), Gated> {
        let ph = self.p * h.transpose();
        let s = (h * ph)[0] + variance;
        let normalised = innovation / s.sqrt();
        // NaN fails, too. An infinite gate lets everything finite pass.
        if normalised.is_finite() && normalised.abs() <= self.settings.gate_sigma {
            Ok((ph, s))
        } else {
            Err(Gated(normalised))
        }
    }

    /// After absurd samples the numbers are so large that rounding alone makes a variance negative.
    fn no_negative_variance(&mut self) {
        for i in 0..STATES {
            // NaN stays: it has to be seen.
            if self.p[(i, i)] < 0.0 {
                self.p[(i, i)] = 0.0;
            }
        }
    }

    fn wrap(&mut self) {
        for i in THETA..THETA + 3 {
            self.x[i] = wrap_pi(self.x[i]);
        }
    }
}

/// The row of a measurement of one state itself.
fn unit(index: usize) -> JacobianRow {
    let mut h = JacobianRow::zeros();
    h[index] = 1.0;
    h
}
