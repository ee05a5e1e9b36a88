//! What is measured, as scalars with their rows.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3, Vector4};

use super::covariance::SparseRow;
use super::jumps::MeasuredScalar;
use super::tuning::MIN_AIRSPEED;
use super::{AIRSPEED, BA, BG, BM, Correction, DRAG, Eskf, EskfState, FLOW, Gated, MICRO, P, THETA, V, WIND};
use crate::camera::FlowCalibration;
use crate::geo::so3::hat;

/// How far back a measurement's time lies, and what happened since: relates the error of then to the error of now,
/// δv_then = δv + S(F) R δθ + τ R δb_a, δp_then = δp − τ δv − ½ τ S(F) R δθ, with F = ∫ R f dt over the time τ since.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lag {
    /// τ, s.
    pub seconds: f64,
    /// F, NED, m/s.
    pub impulse_ned: Vector3<f64>,
}

impl Lag {
    /// A measurement of the present.
    pub const NONE: Lag = Lag { seconds: 0.0, impulse_ned: Vector3::new(0.0, 0.0, 0.0) };
}

/// A flow velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenFlow {
    /// Body x and y, m/s.
    pub v_xy: Vector2<f64>,
    /// Distance of the ground along the optical axis, m: what the sensor's bias, a rate, is multiplied with.
    pub distance_m: f64,
    /// Of the velocity, m²/s².
    pub covariance: Matrix2<f64>,
}

impl Eskf {
    /// A position component (NED axis 0, 1 or 2): innovation against the state of its time, and its variance.
    ///
    /// # Errors
    /// [`Gated`].
    pub fn fuse_position(
        &mut self,
        axis: usize,
        innovation: f64,
        variance: f64,
        lag: &Lag,
    ) -> Result<Correction, Gated> {
        let h = position_row(&self.state, axis.min(2), lag);
        self.fuse(&h, innovation, variance)
    }

    /// A GNSS fix: errors of the horizontal position, and of the horizontal velocity where there is one, against the state of its time.
    /// Each component is fused or [`Gated`] on its own: position north, east, velocity north, east.
    pub fn fuse_fix(
        &mut self,
        position_error: &Vector2<f64>,
        velocity_error: Option<&Vector2<f64>>,
        variances: [f64; 2],
        lag: &Lag,
    ) -> [Option<Result<Correction, Gated>>; 4] {
        let mut fused = [None; 4];
        for i in 0..4 {
            let axis = i % 2;
            let error = if i < 2 { Some(position_error) } else { velocity_error };
            let Some(error) = error else { break };
            let h = if i < 2 {
                position_row(&self.state, axis, lag)
            } else {
                velocity_row(&self.state, axis, lag)
            };
            // What the earlier components have changed of this one's expectation.
            let moved: f64 = fused.iter().flatten().flatten().map(|c: &Correction| h.dot(&c.all)).sum();
            self.jumps.measured =
                if i < 2 { MeasuredScalar::Position(axis) } else { MeasuredScalar::Velocity(axis) };
            fused[i] = Some(self.fuse(&h, error[axis] - moved, variances[i / 2]));
        }
        self.jumps.measured = MeasuredScalar::Other;
        fused
    }

    /// The heading: how far the attitude is turned about NED's z axis from where it is measured to be, rad, and its variance.
    ///
    /// # Errors
    /// [`Gated`].
    pub fn fuse_heading(&mut self, innovation: f64, variance: f64) -> Result<Correction, Gated> {
        let h = SparseRow::empty().with3(THETA, &self.state.r_body_to_ned.row(2).into_owned());
        self.fuse(&h, innovation, variance)
    }

    /// A magnetometer vector: m = Rᵀ m_n + b_m, body, T, with the noise of each axis, 1 sigma. Fused as three scalars, all of them or none.
    ///
    /// # Errors
    /// [`Gated`], with the first of them that fails.
    pub fn fuse_magnetic(
        &mut self,
        body: &Vector3<f64>,
        field_ned: &Vector3<f64>,
        sigma: &Vector3<f64>,
    ) -> Result<f64, Gated> {
        let fused = self.fuse_field(body, field_ned, &sigma.map(|sigma| (sigma * MICRO).powi(2)));
        self.jumps.measured = MeasuredScalar::Other;
        fused
    }

    fn fuse_field(
        &mut self,
        body: &Vector3<f64>,
        field_ned: &Vector3<f64>,
        variance: &Vector3<f64>,
    ) -> Result<f64, Gated> {
        let expected = self.state.expected_magnetic(field_ned);
        let field_body = expected - self.state.magnetic_bias;
        let turned = Vector3::z().cross(&field_body) * MICRO;
        for axis in 0..3 {
            let h = magnetic_row(&field_body, axis);
            self.jumps.measured = MeasuredScalar::Magnetic(turned[axis]);
            self.gate(&h, (body[axis] - expected[axis]) * MICRO, variance[axis])?;
        }
        let mut nis = 0.0;
        for axis in 0..3 {
            let expected = self.state.expected_magnetic(field_ned);
            let h = magnetic_row(&(expected - self.state.magnetic_bias), axis);
            self.jumps.measured = MeasuredScalar::Magnetic(turned[axis]);
            nis += self.fuse(&h, (body[axis] - expected[axis]) * MICRO, variance[axis])?.nis / 3.0;
        }
        Ok(nis)
    }

    /// A flow velocity: (1 + s)(I + μJ) v_xy + d·b, with the velocity and the attitude of its time.
    ///
    /// # Errors
    /// [`Gated`]: then neither component is used.
    pub fn fuse_flow(
        &mut self,
        seen: &SeenFlow,
        velocity_ned: &Vector3<f64>,
        r_body_to_ned: &Matrix3<f64>,
        lag: &Lag,
    ) -> Result<[Correction; 2], Gated> {
        let SeenFlow { v_xy, distance_m, covariance } = seen;
        let v_body = r_body_to_ned.tr_mul(velocity_ned);
        let innovation = v_xy - flow_model(&self.state.flow, &v_body, *distance_m);
        let rows = flow_rows(&self.state, &v_body, *distance_m, r_body_to_ned, lag);
        self.jumps.measured = MeasuredScalar::Flow;
        let fused = self.fuse_pair(&rows, &innovation, [covariance[(0, 0)], covariance[(1, 1)]]);
        self.jumps.measured = MeasuredScalar::Other;
        fused
    }

    /// Both or neither.
    fn fuse_pair(
        &mut self,
        rows: &[SparseRow; 2],
        innovation: &Vector2<f64>,
        variance: [f64; 2],
    ) -> Result<[Correction; 2], Gated> {
        for i in 0..2 {
            self.gate(&rows[i], innovation[i], variance[i])?;
        }
        let first = self.fuse(&rows[0], innovation.x, variance[0])?;
        // What the first has changed of the second's expectation.
        let moved = rows[1].dot(&first.all);
        let second = self.fuse(&rows[1], innovation.y - moved, variance[1])?;
        Ok([first, second])
    }

    /// The airspeed, m/s: (1 + k) ‖v − w‖.
    ///
    /// # Errors
    /// [`Gated`]; also when there is hardly any.
    pub fn fuse_airspeed(&mut self, airspeed: f64, sigma: f64) -> Result<Correction, Gated> {
        let (expected, h) = self.state.airspeed_row().ok_or(Gated(f64::INFINITY))?;
        self.fuse(&h, airspeed - expected, sigma * sigma)
    }

    /// What an airspeed should be, m/s, and the variance of that, (m/s)². `None` when there is hardly any.
    pub fn expected_airspeed(&self) -> Option<(f64, f64)> {
        let (expected, h) = self.state.airspeed_row()?;
        Some((expected, h.dot(&h.times(&self.p)).max(0.0)))
    }

    /// A fixed wing flies nose first: the air comes from the side by no more than `sigma_rad`, (Rᵀ(v − w))_y = 0.
    ///
    /// # Errors
    /// [`Gated`]; also when there is hardly any airspeed.
    pub fn fuse_sideslip(&mut self, sigma_rad: f64) -> Result<Correction, Gated> {
        let (expected, speed, h) = self.state.sideslip_row().ok_or(Gated(f64::INFINITY))?;
        self.fuse(&h, -expected, (sigma_rad * speed).powi(2))
    }

    /// How far a specific force is from what the drag should make it, m/s²; see [`Self::fuse_drag`].
    pub fn drag_innovation(&self, force_xy: &Vector2<f64>, air_body: &Vector3<f64>) -> Vector2<f64> {
        force_xy - self.state().expected_drag(air_body)
    }

    /// The variance of [`Self::drag_innovation`] by what the filter does not know, the mean of both axes, m²/s⁴.
    pub fn drag_variance(&self, air_body: &Vector3<f64>) -> f64 {
        let of = |axis| {
            let row = self.state().drag_row(air_body, axis);
            row.dot(&row.times(&self.p))
        };
        0.5 * (of(0) + of(1))
    }

    /// A multirotor's specific force along body x and y, m/s², mean over a short while in which the velocity through the air was
    /// `air_body` (body axes, m/s) in the mean: f = b_a − D u (Leishman et al. 2014, "Quadrotors and accelerometers").
    ///
    /// # Errors
    /// [`Gated`]: then neither component is used.
    pub fn fuse_drag(
        &mut self,
        force_xy: &Vector2<f64>,
        air_body: &Vector3<f64>,
        sigma: f64,
    ) -> Result<[Correction; 2], Gated> {
        let innovation = self.drag_innovation(force_xy, air_body);
        let rows = [0, 1].map(|axis| self.state.drag_row(air_body, axis));
        self.fuse_pair(&rows, &innovation, [sigma * sigma; 2])
    }

    /// The vehicle stands: the velocity is zero, and the gyros show their bias and the Earth's rate.
    ///
    /// # Errors
    /// [`Gated`]: the filter does not believe it.
    pub fn fuse_standstill(
        &mut self,
        angular_rate: &Vector3<f64>,
        earth_rate_ned: &Vector3<f64>,
        sigma_mps: f64,
        sigma_radps: f64,
    ) -> Result<[Correction; 3], Gated> {
        for axis in 0..3 {
            let innovation = -self.state.velocity_ned[axis];
            self.gate(&SparseRow::unit(V + axis), innovation, sigma_mps.powi(2))?;
        }
        let mut corrections = [None; 3];
        for axis in 0..3 {
            let innovation = -self.state.velocity_ned[axis];
            corrections[axis] = Some(self.fuse(&SparseRow::unit(V + axis), innovation, sigma_mps.powi(2))?);
        }
        for axis in 0..3 {
            let s = &self.state;
            let expected = s.gyro_bias + s.r_body_to_ned.tr_mul(earth_rate_ned);
            let innovation = angular_rate[axis] - expected[axis];
            self.fuse(&SparseRow::unit(BG + axis), innovation, sigma_radps.powi(2))?;
        }
        match corrections {
            [Some(a), Some(b), Some(c)] => Ok([a, b, c]),
            _ => Err(Gated(f64::NAN)),
        }
    }
}

impl EskfState {
    /// What the magnetometer should show, body, T.
    pub(super) fn expected_magnetic(&self, field_ned: &Vector3<f64>) -> Vector3<f64> {
        self.r_body_to_ned.tr_mul(field_ned) + self.magnetic_bias
    }

    /// Velocity through the air, body axes, m/s.
    pub fn air_velocity_body(&self) -> Vector3<f64> {
        let wind = Vector3::new(self.wind_ne.x, self.wind_ne.y, 0.0);
        self.r_body_to_ned.tr_mul(&(self.velocity_ned - wind))
    }

    /// What the accelerometers should show along body x and y, m/s².
    pub(super) fn expected_drag(&self, air_body: &Vector3<f64>) -> Vector2<f64> {
        self.accel_bias.xy() - air_body.xy() * self.drag
    }

    /// Its derivative.
    pub(super) fn drag_row(&self, air_body: &Vector3<f64>, axis: usize) -> SparseRow {
        let along_ned = self.r_body_to_ned.column(axis).transpose();
        SparseRow::unit(BA + axis)
            .with3(THETA, &(hat(air_body).row(axis) * -self.drag))
            .with3(V, &(along_ned * -self.drag))
            .with(WIND, along_ned.x * self.drag)
            .with(WIND + 1, along_ned.y * self.drag)
            .with(DRAG, -air_body[axis])
    }

    /// Velocity through the air, NED, m/s, where there is enough of it.
    fn through_air(&self) -> Option<(Vector3<f64>, f64)> {
        let v = self.velocity_ned - Vector3::new(self.wind_ne.x, self.wind_ne.y, 0.0);
        let speed = v.norm();
        (speed > MIN_AIRSPEED).then_some((v, speed))
    }

    /// Expected airspeed and its derivative.
    pub(super) fn airspeed_row(&self) -> Option<(f64, SparseRow)> {
        let (v, speed) = self.through_air()?;
        let gain = 1.0 + self.airspeed_scale;
        let along = v * (gain / speed);
        let h = SparseRow::empty()
            .with3(V, &along.transpose())
            .with(WIND, -along.x)
            .with(WIND + 1, -along.y)
            .with(AIRSPEED, speed);
        Some((gain * speed, h))
    }

    /// Expected velocity of the air along body y, the airspeed, and the derivative of the former.
    pub(super) fn sideslip_row(&self) -> Option<(f64, f64, SparseRow)> {
        let (v, speed) = self.through_air()?;
        let body = self.r_body_to_ned.tr_mul(&v);
        let y_ned = self.r_body_to_ned.column(1).transpose();
        let h = SparseRow::empty()
            .with3(THETA, &hat(&body).row(1).into_owned())
            .with3(V, &y_ned)
            .with(WIND, -y_ned.x)
            .with(WIND + 1, -y_ned.y);
        Some((body.y, speed, h))
    }
}

/// ∂p_then/∂x of one axis.
pub(super) fn position_row(state: &EskfState, axis: usize, lag: &Lag) -> SparseRow {
    let h = SparseRow::unit(P + axis);
    if lag.seconds <= 0.0 {
        return h;
    }
    let tilt = hat(&lag.impulse_ned) * state.r_body_to_ned * (-0.5 * lag.seconds);
    h.with(V + axis, -lag.seconds).with3(THETA, &tilt.row(axis).into_owned())
}

/// ∂v_then/∂x of one axis.
pub(super) fn velocity_row(state: &EskfState, axis: usize, lag: &Lag) -> SparseRow {
    let h = SparseRow::unit(V + axis);
    if lag.seconds <= 0.0 {
        return h;
    }
    let r = &state.r_body_to_ned;
    let tilt = hat(&lag.impulse_ned) * r;
    h.with3(THETA, &tilt.row(axis).into_owned()).with3(BA, &(r.row(axis) * lag.seconds))
}

/// ∂m/∂x of one magnetometer axis, µT; `field_body` is Rᵀ m_n in T. Exp(−δθ) x ≈ x + S(x) δθ.
pub(super) fn magnetic_row(field_body: &Vector3<f64>, axis: usize) -> SparseRow {
    SparseRow::unit(BM + axis).with3(THETA, &(hat(field_body).row(axis) * MICRO))
}

/// What the flow sensor shows of a body velocity at a distance of the ground: (1 + s)(I + μJ) v_xy + d·b, to first order (1 + s) I + μJ.
pub(super) fn flow_model(flow: &Vector4<f64>, v_body: &Vector3<f64>, distance_m: f64) -> Vector2<f64> {
    flow_scale(flow) * v_body.xy() + flow.fixed_rows::<2>(0) * distance_m
}

fn flow_scale(flow: &Vector4<f64>) -> Matrix2<f64> {
    Matrix2::new(1.0 + flow[2], -flow[3], flow[3], 1.0 + flow[2])
}

/// ∂flow/∂x of both components, where velocity and attitude are those of `lag` ago. The attitude error of then in the body axes of then
/// is R_thenᵀ R (δθ + τ δb_g).
pub(super) fn flow_rows(
    state: &EskfState,
    v_body: &Vector3<f64>,
    distance_m: f64,
    r_then: &Matrix3<f64>,
    lag: &Lag,
) -> [SparseRow; 2] {
    let scale = flow_scale(&state.flow);
    let r_now = &state.r_body_to_ned;
    let by_velocity = scale * r_then.transpose().fixed_rows::<2>(0);
    let by_attitude = scale * hat(v_body).fixed_rows::<2>(0);
    let by_flow = FlowCalibration::jacobian(&v_body.xy(), distance_m);
    let late = lag.seconds > 0.0;
    let turned = if late { by_attitude * r_then.transpose() * r_now } else { by_attitude };
    let by_theta = if late { turned + by_velocity * hat(&lag.impulse_ned) * r_now } else { turned };
    [0, 1].map(|i| {
        let mut h = SparseRow::empty()
            .with3(THETA, &by_theta.row(i).into_owned())
            .with3(V, &by_velocity.row(i).into_owned());
        for k in 0..4 {
            h = h.with(FLOW + k, by_flow[(i, k)]);
        }
        if late {
            h = h.with3(BG, &(turned.row(i) * lag.seconds));
        }
        h
    })
}
