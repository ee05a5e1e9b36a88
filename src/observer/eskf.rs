//! An error-state Kalman filter: attitude, position, velocity, IMU biases, and what is systematically wrong with flow and magnetometer.
//!
//! Nominal state R (body → NED), p, v, b_g, b_a, flow [b_x, b_y, s, μ] (see [`crate::camera::calibration`]) and magnetometer bias b_m.
//! Error state, 22 numbers, the attitude error on the body side (R_true = R Exp(δθ)):
//!
//! δθ̇ = −ω × δθ − δb_g,  δṗ = δv,  δv̇ = −R S(f) δθ − R δb_a,  all biases random walks.
//!
//! Linear, locally convergent, and it knows how wrong it is; the nonlinear observers, globally convergent and blind to that, start it
//! and watch it (the staged start of the observers' specification; Fusini (10), (2) is the same idea with the linearisation about the
//! observer). Measurements are scalars with a gate on the normalised innovation, fused one after the other in Joseph's form.

use nalgebra::{Matrix2, Matrix3, RowSVector, SMatrix, SVector, Vector2, Vector3};

use crate::camera::FlowCalibration;
use crate::geo::so3::{exp, hat, nearest_rotation};

/// Size of the error state.
pub const STATES: usize = 22;
const THETA: usize = 0;
const P: usize = 3;
const V: usize = 6;
const BG: usize = 9;
const BA: usize = 12;
const FLOW: usize = 15;
const BM: usize = 19;

type Covariance = SMatrix<f64, STATES, STATES>;
type Row = RowSVector<f64, STATES>;
type Rows3 = SMatrix<f64, 3, STATES>;

/// Noise densities and walks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EskfSettings {
    /// Gyro noise density, rad/s/√Hz.
    pub gyro_noise: f64,
    /// Accelerometer noise density, m/s²/√Hz.
    pub accel_noise: f64,
    /// Random walk of the gyro bias, rad/s/√s.
    pub gyro_bias_walk: f64,
    /// Random walk of the accelerometer bias, m/s²/√s.
    pub accel_bias_walk: f64,
    /// Random walk of the magnetometer bias, T/√s.
    pub magnetic_bias_walk: f64,
    /// Standard deviation of the magnetometer bias at the start, T.
    pub magnetic_bias_sigma: f64,
    /// Random walk of the flow's velocity bias, m/s/√s.
    pub flow_bias_walk: f64,
    /// Random walk of the flow's scale and misalignment, 1/√s.
    pub flow_scale_walk: f64,
    /// Innovations beyond this many sigmas are rejected.
    pub gate_sigma: f64,
}

/// The nominal state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EskfState {
    /// Body → NED, orthonormal.
    pub r_body_to_ned: Matrix3<f64>,
    /// Position, NED, m.
    pub position_ned: Vector3<f64>,
    /// Velocity, NED, m/s.
    pub velocity_ned: Vector3<f64>,
    /// Gyro bias, body, rad/s.
    pub gyro_bias: Vector3<f64>,
    /// Accelerometer bias, body, m/s².
    pub accel_bias: Vector3<f64>,
    /// Flow [b_x m/s, b_y m/s, s, μ rad].
    pub flow: SVector<f64, 4>,
    /// Magnetometer bias, body, T.
    pub magnetic_bias: Vector3<f64>,
}

/// What a correction moved: to be carried into the remembered past.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correction {
    /// Of the position, m.
    pub position_ned: Vector3<f64>,
    /// Of the velocity, m/s.
    pub velocity_ned: Vector3<f64>,
}

/// A measurement that was not used; its innovation over its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gated(pub f64);

/// See the module's documentation.
#[derive(Clone, Debug)]
pub struct Eskf {
    settings: EskfSettings,
    state: EskfState,
    p: Covariance,
    steps: u32,
}

/// Steps between two orthonormalisations.
const REORTHONORMALISE: u32 = 100;

impl Eskf {
    /// Starts at `state` with standard deviations of attitude (body, rad), position (NED, m), velocity (NED, m/s), gyro bias (rad/s),
    /// accelerometer bias (m/s²) and the covariance of the flow's errors.
    pub fn new(
        settings: EskfSettings,
        state: EskfState,
        sigma: [Vector3<f64>; 5],
        flow: &SMatrix<f64, 4, 4>,
    ) -> Self {
        let mut p = Covariance::zeros();
        for (block, s) in [THETA, P, V, BG, BA].into_iter().zip(&sigma) {
            for axis in 0..3 {
                p[(block + axis, block + axis)] = s[axis] * s[axis];
            }
        }
        p.fixed_view_mut::<4, 4>(FLOW, FLOW).copy_from(flow);
        for axis in 0..3 {
            p[(BM + axis, BM + axis)] = settings.magnetic_bias_sigma.powi(2);
        }
        Self { settings, state, p, steps: 0 }
    }

    /// The nominal state.
    pub fn state(&self) -> &EskfState {
        &self.state
    }

    /// Covariance of the position, NED, m².
    pub fn position_covariance(&self) -> Matrix3<f64> {
        self.p.fixed_view::<3, 3>(P, P).into_owned()
    }

    /// Covariance of the velocity, NED, m²/s².
    pub fn velocity_covariance(&self) -> Matrix3<f64> {
        self.p.fixed_view::<3, 3>(V, V).into_owned()
    }

    /// Covariance of the attitude error in NED axes, rad².
    pub fn attitude_covariance_ned(&self) -> Matrix3<f64> {
        let r = &self.state.r_body_to_ned;
        r * self.p.fixed_view::<3, 3>(THETA, THETA) * r.transpose()
    }

    /// Whether everything is finite.
    pub fn is_finite(&self) -> bool {
        let s = &self.state;
        let sum = s.r_body_to_ned.sum() + s.position_ned.sum() + s.velocity_ned.sum() + s.gyro_bias.sum();
        (sum + s.accel_bias.sum() + s.flow.sum() + s.magnetic_bias.sum() + self.p.sum()).is_finite()
    }

    /// Moves the origin: positions become smaller by `moved`.
    pub fn shift_origin(&mut self, moved_ned: &Vector3<f64>) {
        self.state.position_ned -= moved_ned;
    }

    /// One IMU sample over `dt` s: mean angular rate (rad/s) and specific force (m/s²), body; gravity and Earth rate, NED.
    /// Returns the acceleration in NED that was integrated, m/s².
    pub fn predict(
        &mut self,
        dt: f64,
        angular_rate: &Vector3<f64>,
        specific_force: &Vector3<f64>,
        gravity_ned: &Vector3<f64>,
        earth_rate_ned: &Vector3<f64>,
    ) -> Vector3<f64> {
        let s = &mut self.state;
        let r = s.r_body_to_ned;
        let rate = angular_rate - s.gyro_bias - r.tr_mul(earth_rate_ned);
        let force = specific_force - s.accel_bias;
        let turn = exp(&(rate * dt));
        // The mean attitude of the interval turns the force.
        let f_ned = r * exp(&(rate * (0.5 * dt))) * force;
        let acceleration = f_ned + gravity_ned - 2.0 * earth_rate_ned.cross(&s.velocity_ned);
        s.position_ned += dt * (s.velocity_ned + 0.5 * dt * acceleration);
        s.velocity_ned += dt * acceleration;
        s.r_body_to_ned = r * turn;
        self.steps += 1;
        if self.steps.is_multiple_of(REORTHONORMALISE)
            && let Some(clean) = nearest_rotation(&s.r_body_to_ned)
        {
            s.r_body_to_ned = clean;
        }
        self.predict_covariance(dt, &turn, &(hat(&f_ned) * r), &r);
        acceleration
    }

    /// P ← Φ P Φᵀ + Q, block by block: Φ differs from I in the rows of θ, p and v only. `force` is S(R f) R = R S(f).
    fn predict_covariance(&mut self, dt: f64, turn: &Matrix3<f64>, force: &Matrix3<f64>, r: &Matrix3<f64>) {
        let turn_t = turn.transpose();
        let rows = |p: &Covariance, at: usize| -> Rows3 { p.fixed_rows::<3>(at).into_owned() };
        for _ in 0..2 {
            let (theta, v) = (rows(&self.p, THETA), rows(&self.p, V));
            let (bg, ba, p) = (rows(&self.p, BG), rows(&self.p, BA), rows(&self.p, P));
            self.p.fixed_rows_mut::<3>(THETA).copy_from(&(turn_t * theta - bg * dt));
            self.p.fixed_rows_mut::<3>(P).copy_from(&(p + v * dt));
            self.p.fixed_rows_mut::<3>(V).copy_from(&(v - (force * theta + r * ba) * dt));
            // The second time round the same is done to the columns, and the transpose undone.
            self.p.transpose_mut();
        }
        let s = &self.settings;
        let add = |p: &mut Covariance, at: usize, n: usize, density: f64| {
            for i in at..at + n {
                p[(i, i)] += density * density * dt;
            }
        };
        add(&mut self.p, THETA, 3, s.gyro_noise);
        add(&mut self.p, V, 3, s.accel_noise);
        add(&mut self.p, BG, 3, s.gyro_bias_walk);
        add(&mut self.p, BA, 3, s.accel_bias_walk);
        add(&mut self.p, FLOW, 2, s.flow_bias_walk);
        add(&mut self.p, FLOW + 2, 2, s.flow_scale_walk);
        add(&mut self.p, BM, 3, s.magnetic_bias_walk);
    }

    /// A position component (NED axis 0, 1 or 2): innovation against the state it belongs to, and its variance.
    ///
    /// # Errors
    /// [`Gated`].
    pub fn fuse_position(&mut self, axis: usize, innovation: f64, variance: f64) -> Result<Correction, Gated> {
        let mut h = Row::zeros();
        h[P + axis.min(2)] = 1.0;
        self.fuse(&h, innovation, variance)
    }

    /// A velocity component (NED).
    ///
    /// # Errors
    /// [`Gated`].
    pub fn fuse_velocity(&mut self, axis: usize, innovation: f64, variance: f64) -> Result<Correction, Gated> {
        let mut h = Row::zeros();
        h[V + axis.min(2)] = 1.0;
        self.fuse(&h, innovation, variance)
    }

    /// A magnetometer vector: m = Rᵀ m_n + b_m, body, T. Fused as three scalars.
    ///
    /// # Errors
    /// [`Gated`], when the first of them that fails does.
    pub fn fuse_magnetic(&mut self, body: &Vector3<f64>, field_ned: &Vector3<f64>, sigma: f64) -> Result<(), Gated> {
        for axis in 0..3 {
            let expected = self.state.r_body_to_ned.tr_mul(field_ned);
            let innovation = body[axis] - expected[axis] - self.state.magnetic_bias[axis];
            let mut h = Row::zeros();
            // Exp(−δθ) x ≈ x + S(x) δθ.
            h.fixed_columns_mut::<3>(THETA).copy_from(&hat(&expected).row(axis));
            h[BM + axis] = 1.0;
            self.fuse(&h, innovation, sigma * sigma)?;
        }
        Ok(())
    }

    /// A flow velocity, body x and y, m/s: (1 + s)(I + μJ) v_xy + b, with the velocity that the state had then and the attitude of
    /// then.
    ///
    /// # Errors
    /// [`Gated`]: then neither component is used.
    pub fn fuse_flow(
        &mut self,
        flow_xy: &Vector2<f64>,
        velocity_ned: &Vector3<f64>,
        r_body_to_ned: &Matrix3<f64>,
        covariance: &Matrix2<f64>,
    ) -> Result<[Correction; 2], Gated> {
        let v_body = r_body_to_ned.tr_mul(velocity_ned);
        let (s, mu) = (self.state.flow[2], self.state.flow[3]);
        let scale = Matrix2::new(1.0 + s, -mu, mu, 1.0 + s);
        let expected = scale * v_body.xy() + self.state.flow.fixed_rows::<2>(0);
        let innovation = flow_xy - expected;
        let by_velocity = scale * r_body_to_ned.transpose().fixed_rows::<2>(0);
        let by_attitude = scale * hat(&v_body).fixed_rows::<2>(0);
        let by_flow = FlowCalibration::jacobian(&v_body.xy());
        let row = |i: usize| {
            let mut h = Row::zeros();
            h.fixed_columns_mut::<3>(THETA).copy_from(&by_attitude.row(i));
            h.fixed_columns_mut::<3>(V).copy_from(&by_velocity.row(i));
            h.fixed_columns_mut::<4>(FLOW).copy_from(&by_flow.row(i));
            h
        };
        let rows = [row(0), row(1)];
        for i in 0..2 {
            self.gate(&rows[i], innovation[i], covariance[(i, i)])?;
        }
        let first = self.fuse(&rows[0], innovation.x, covariance[(0, 0)])?;
        // What the first has changed of the second's expectation.
        let moved = by_velocity.row(1) * first.velocity_ned;
        let second = self.fuse(&rows[1], innovation.y - moved[0], covariance[(1, 1)])?;
        Ok([first, second])
    }

    fn gate(&self, h: &Row, innovation: f64, variance: f64) -> Result<f64, Gated> {
        let s = (h * self.p * h.transpose())[0] + variance;
        let normalised = innovation / s.sqrt();
        if normalised.is_finite() && normalised.abs() <= self.settings.gate_sigma {
            Ok(s)
        } else {
            Err(Gated(normalised))
        }
    }

    /// A scalar update. Joseph's form for a scalar: P − K hP − (K hP)ᵀ + K s Kᵀ, symmetric by construction.
    fn fuse(&mut self, h: &Row, innovation: f64, variance: f64) -> Result<Correction, Gated> {
        let s = self.gate(h, innovation, variance)?;
        let ph = self.p * h.transpose();
        let k = ph / s;
        let cross = k * ph.transpose();
        self.p -= cross;
        // K hP is symmetric in exact arithmetic; make it so here.
        self.p = 0.5 * (self.p + self.p.transpose());
        let dx = k * innovation;
        self.inject(&dx);
        Ok(Correction {
            position_ned: dx.fixed_rows::<3>(P).into_owned(),
            velocity_ned: dx.fixed_rows::<3>(V).into_owned(),
        })
    }

    fn inject(&mut self, dx: &SVector<f64, STATES>) {
        let s = &mut self.state;
        s.r_body_to_ned *= exp(&dx.fixed_rows::<3>(THETA).into_owned());
        s.position_ned += dx.fixed_rows::<3>(P);
        s.velocity_ned += dx.fixed_rows::<3>(V);
        s.gyro_bias += dx.fixed_rows::<3>(BG);
        s.accel_bias += dx.fixed_rows::<3>(BA);
        s.flow += dx.fixed_rows::<4>(FLOW);
        s.magnetic_bias += dx.fixed_rows::<3>(BM);
    }
}
