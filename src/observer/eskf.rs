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
    /// Of the whole error state.
    all: SVector<f64, STATES>,
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

    /// Position and velocity are known anew (horizontally: the vertical stays), with these standard deviations; attitude and biases
    /// stay, and forget what they had to do with the old ones.
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
                if block == P {
                    self.state.position_ned[axis] = value[axis];
                } else {
                    self.state.velocity_ned[axis] = value[axis];
                }
            }
        }
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
    pub fn fuse_position(
        &mut self,
        axis: usize,
        innovation: f64,
        variance: f64,
    ) -> Result<Correction, Gated> {
        self.fuse(&unit_row(P + axis.min(2)), innovation, variance)
    }

    /// A velocity component (NED).
    ///
    /// # Errors
    /// [`Gated`].
    pub fn fuse_velocity(
        &mut self,
        axis: usize,
        innovation: f64,
        variance: f64,
    ) -> Result<Correction, Gated> {
        self.fuse(&unit_row(V + axis.min(2)), innovation, variance)
    }

    /// A magnetometer vector: m = Rᵀ m_n + b_m, body, T. Fused as three scalars.
    ///
    /// # Errors
    /// [`Gated`], when the first of them that fails does.
    pub fn fuse_magnetic(
        &mut self,
        body: &Vector3<f64>,
        field_ned: &Vector3<f64>,
        sigma: f64,
    ) -> Result<(), Gated> {
        for axis in 0..3 {
            let expected = self.expected_magnetic(field_ned);
            let h = magnetic_row(&(expected - self.state.magnetic_bias), axis);
            self.fuse(&h, body[axis] - expected[axis], sigma * sigma)?;
        }
        Ok(())
    }

    fn expected_magnetic(&self, field_ned: &Vector3<f64>) -> Vector3<f64> {
        self.state.r_body_to_ned.tr_mul(field_ned) + self.state.magnetic_bias
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
        let innovation = flow_xy - flow_model(&self.state.flow, &v_body);
        let rows = flow_rows(&self.state.flow, &v_body, r_body_to_ned);
        for i in 0..2 {
            self.gate(&rows[i], innovation[i], covariance[(i, i)])?;
        }
        let first = self.fuse(&rows[0], innovation.x, covariance[(0, 0)])?;
        // What the first has changed of the second's expectation.
        let moved = (rows[1] * first.all)[0];
        let second = self.fuse(&rows[1], innovation.y - moved, covariance[(1, 1)])?;
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
            all: dx,
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

/// The row of a measurement of one state itself.
fn unit_row(index: usize) -> Row {
    let mut h = Row::zeros();
    h[index] = 1.0;
    h
}

/// ∂m/∂x of one magnetometer axis; `field_body` is Rᵀ m_n. Exp(−δθ) x ≈ x + S(x) δθ.
fn magnetic_row(field_body: &Vector3<f64>, axis: usize) -> Row {
    let mut h = Row::zeros();
    h.fixed_columns_mut::<3>(THETA).copy_from(&hat(field_body).row(axis));
    h[BM + axis] = 1.0;
    h
}

/// What the flow sensor shows of a body velocity: (1 + s)(I + μJ) v_xy + b, to first order (1 + s) I + μJ.
fn flow_model(flow: &SVector<f64, 4>, v_body: &Vector3<f64>) -> Vector2<f64> {
    flow_scale(flow) * v_body.xy() + flow.fixed_rows::<2>(0)
}

fn flow_scale(flow: &SVector<f64, 4>) -> Matrix2<f64> {
    Matrix2::new(1.0 + flow[2], -flow[3], flow[3], 1.0 + flow[2])
}

/// ∂flow/∂x of both components.
fn flow_rows(flow: &SVector<f64, 4>, v_body: &Vector3<f64>, r_body_to_ned: &Matrix3<f64>) -> [Row; 2] {
    let scale = flow_scale(flow);
    let by_velocity = scale * r_body_to_ned.transpose().fixed_rows::<2>(0);
    let by_attitude = scale * hat(v_body).fixed_rows::<2>(0);
    let by_flow = FlowCalibration::jacobian(&v_body.xy());
    [0, 1].map(|i| {
        let mut h = Row::zeros();
        h.fixed_columns_mut::<3>(THETA).copy_from(&by_attitude.row(i));
        h.fixed_columns_mut::<3>(V).copy_from(&by_velocity.row(i));
        h.fixed_columns_mut::<4>(FLOW).copy_from(&by_flow.row(i));
        h
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::so3::log;
    use nalgebra::Matrix4;

    fn silent() -> EskfSettings {
        EskfSettings {
            gyro_noise: 0.0,
            accel_noise: 0.0,
            gyro_bias_walk: 0.0,
            accel_bias_walk: 0.0,
            magnetic_bias_walk: 0.0,
            magnetic_bias_sigma: 0.0,
            flow_bias_walk: 0.0,
            flow_scale_walk: 0.0,
            gate_sigma: 5.0,
        }
    }

    fn state() -> EskfState {
        EskfState {
            r_body_to_ned: exp(&Vector3::new(0.4, -0.3, 2.0)),
            position_ned: Vector3::new(100.0, -50.0, -120.0),
            velocity_ned: Vector3::new(12.0, -7.0, 1.5),
            gyro_bias: Vector3::new(0.01, -0.02, 0.005),
            accel_bias: Vector3::new(0.05, -0.1, 0.02),
            flow: SVector::from([0.2, -0.1, 0.05, -0.03]),
            magnetic_bias: Vector3::new(1e-6, -2e-6, 5e-7),
        }
    }

    fn filter(state: EskfState) -> Eskf {
        Eskf::new(silent(), state, [Vector3::zeros(); 5], &Matrix4::zeros())
    }

    fn perturbed(index: usize, by: f64) -> EskfState {
        let mut f = filter(state());
        let mut dx = SVector::<f64, STATES>::zeros();
        dx[index] = by;
        f.inject(&dx);
        *f.state()
    }

    /// b less a, as an error state.
    fn difference(a: &EskfState, b: &EskfState) -> SVector<f64, STATES> {
        let mut d = SVector::<f64, STATES>::zeros();
        d.fixed_rows_mut::<3>(THETA).copy_from(&log(&(a.r_body_to_ned.transpose() * b.r_body_to_ned)));
        d.fixed_rows_mut::<3>(P).copy_from(&(b.position_ned - a.position_ned));
        d.fixed_rows_mut::<3>(V).copy_from(&(b.velocity_ned - a.velocity_ned));
        d.fixed_rows_mut::<3>(BG).copy_from(&(b.gyro_bias - a.gyro_bias));
        d.fixed_rows_mut::<3>(BA).copy_from(&(b.accel_bias - a.accel_bias));
        d.fixed_rows_mut::<4>(FLOW).copy_from(&(b.flow - a.flow));
        d.fixed_rows_mut::<3>(BM).copy_from(&(b.magnetic_bias - a.magnetic_bias));
        d
    }

    const RATE: Vector3<f64> = Vector3::new(0.3, -0.2, 0.5);
    const FORCE: Vector3<f64> = Vector3::new(1.0, 0.5, -11.0);
    const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, 9.81);

    #[test]
    fn the_covariance_moves_as_the_error_does() {
        let (dt, eps) = (0.01, 1e-5);
        for index in 0..STATES {
            let (mut a, mut b) = (filter(state()), filter(perturbed(index, eps)));
            a.p[(index, index)] = 1.0;
            a.predict(dt, &RATE, &FORCE, &GRAVITY, &Vector3::zeros());
            b.predict(dt, &RATE, &FORCE, &GRAVITY, &Vector3::zeros());
            let moved = difference(a.state(), b.state()) / eps;
            let expected = moved * moved.transpose();
            // Second order in dt and what the mean attitude of the interval adds is left out of Φ.
            assert!((a.p - expected).amax() < 5e-3, "{index}: {}", (a.p - expected).amax());
        }
    }

    #[test]
    fn measurement_rows_are_the_derivatives() {
        let eps = 1e-6;
        let field = Vector3::new(2e-5, 1e-6, 4.5e-5);
        let base = filter(state());
        let r = state().r_body_to_ned;
        let v_body = r.tr_mul(&state().velocity_ned);
        let rows = flow_rows(&state().flow, &v_body, &r);
        let magnetic = r.tr_mul(&field);
        for index in 0..STATES {
            let other = filter(perturbed(index, eps));
            let s = other.state();
            let v_other = s.r_body_to_ned.tr_mul(&s.velocity_ned);
            let d_flow = (flow_model(&s.flow, &v_other) - flow_model(&state().flow, &v_body)) / eps;
            for i in 0..2 {
                assert!((d_flow[i] - rows[i][index]).abs() < 1e-4, "flow {i} by {index}");
            }
            let d = (other.expected_magnetic(&field) - base.expected_magnetic(&field)) / eps;
            for axis in 0..3 {
                assert!(
                    (d[axis] - magnetic_row(&magnetic, axis)[index]).abs() < 1e-6,
                    "field {axis} by {index}"
                );
            }
        }
    }

    #[test]
    fn the_covariance_stays_symmetric_and_positive() {
        let settings = EskfSettings { gyro_noise: 1e-3, accel_noise: 0.05, gyro_bias_walk: 1e-5, ..silent() };
        let sigma = [0.1, 3.0, 0.5, 0.01, 0.1].map(Vector3::repeat);
        let mut f = Eskf::new(settings, state(), sigma, &(Matrix4::identity() * 0.01));
        let field = Vector3::new(2e-5, 1e-6, 4.5e-5);
        for k in 0..5000 {
            f.predict(0.01, &RATE, &FORCE, &GRAVITY, &Vector3::zeros());
            if k % 20 == 0 {
                let _ = f.fuse_position(k % 3, 0.5, 1.0);
                let _ = f.fuse_velocity(k % 2, 0.1, 0.04);
                let body = f.expected_magnetic(&field);
                let _ = f.fuse_magnetic(&body, &field, 1e-6);
                let (v, r) = (f.state().velocity_ned, f.state().r_body_to_ned);
                let xy = flow_model(&f.state().flow, &r.tr_mul(&v));
                let _ = f.fuse_flow(&xy, &v, &r, &(Matrix2::identity() * 0.25));
            }
        }
        assert!(f.is_finite());
        assert!((f.p - f.p.transpose()).amax() < 1e-9);
        assert!(f.p.symmetric_eigenvalues().min() > -1e-9, "{}", f.p.symmetric_eigenvalues().min());
        let r = f.state().r_body_to_ned;
        assert!((r.transpose() * r - Matrix3::identity()).amax() < 1e-9);
    }

    #[test]
    fn an_outlier_is_gated_and_changes_nothing() {
        let mut f = Eskf::new(silent(), state(), [Vector3::repeat(0.5); 5], &Matrix4::identity());
        let (before, p) = (*f.state(), f.p);
        assert!(f.fuse_position(0, 50.0, 1.0).is_err());
        assert!(f.fuse_position(0, f64::NAN, 1.0).is_err());
        let flow = Vector2::new(500.0, 0.0);
        assert!(
            f.fuse_flow(&flow, &before.velocity_ned, &before.r_body_to_ned, &Matrix2::identity()).is_err()
        );
        assert_eq!((*f.state(), f.p), (before, p));
    }
}
