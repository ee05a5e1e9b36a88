//! The kinematics in Euler angles and their derivatives, about which the exogenous Kalman filter is linearised (Fusini (10), (2)).

use nalgebra::{Matrix3, RowSVector, SVector, Vector3};

use super::state::ObserverState;
use super::tuning::LEAST_COS_PITCH;
use crate::geo::so3::{Euler, hat, wrap_pi};

/// Size of the state [Θ, p, v, b_ω, b_f].
pub const STATES: usize = 15;
pub(super) const THETA: usize = 0;
pub(super) const P: usize = 3;
pub(super) const V: usize = 6;
pub(super) const BW: usize = 9;
pub(super) const BF: usize = 12;

/// A row of a measurement Jacobian.
pub(super) type JacobianRow = RowSVector<f64, STATES>;

/// The state of (10), of a trajectory to linearise about or of the filter itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EulerState {
    /// Θ = [φ, θ, ψ], body → NED, ZYX.
    pub angles: Euler,
    /// p in NED, m.
    pub position_ned: Vector3<f64>,
    /// v in NED, m/s.
    pub velocity_ned: Vector3<f64>,
    /// b_ω in body axes, rad/s.
    pub gyro_bias: Vector3<f64>,
    /// b_f in body axes, m/s².
    pub accel_bias: Vector3<f64>,
}

/// What one IMU sample brings to the second stage, over (t_{k−1}, t_k].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct XkfInput {
    /// Length of the interval, s.
    pub dt_s: f64,
    /// Mean angular rate in body axes, rad/s (ω_m, with its bias).
    pub angular_rate_body: Vector3<f64>,
    /// Mean specific force in body axes, m/s² (f_m, with its bias).
    pub specific_force_body: Vector3<f64>,
    /// Gravity in NED, m/s².
    pub gravity_ned: Vector3<f64>,
    /// The Earth's rate in NED, rad/s.
    pub earth_rate_ned: Vector3<f64>,
}

/// What y3, the specific force of a motion at constant body velocity, is taken for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum SpecificForceForm {
    /// Fusini (2c) as printed: y3 = −Rᵀg + (ω_m − b_ω − Rᵀω_e) × Rᵀv. There is no b_f in it, so an accelerometer's bias is taken for a
    /// tilt. For comparison with the paper.
    AsPrinted,
    /// (2c) and b_f: y3 is what the IMU measures, which has its bias in it ((1d)). Right for a real IMU.
    WithBias,
    /// As [`Self::WithBias`] with a shorter row: Rᵀω_e counts as constant (its derivative is 10⁻⁴ of gravity's), and biases that are
    /// frozen are no states and have no columns, so they are the linearisation point's. For comparison with the independent
    /// implementation behind `tests/golden/observers/xkf_euler_y3.json`.
    Approximate,
}

impl EulerState {
    /// A point of an observer's trajectory. R̂ is brought back to SO(3) first. `None` while R̂ is degenerate or the nose points to within
    /// 1.1° of the vertical: there is nothing to linearise about then.
    pub fn of_observer(state: &ObserverState, accel_bias: Vector3<f64>) -> Option<Self> {
        let point = Self {
            angles: Euler::from_rotation(&state.r_body_to_ned()?),
            position_ned: state.position_ned,
            velocity_ned: state.velocity_ned,
            gyro_bias: state.gyro_bias,
            accel_bias,
        };
        point.is_regular().then_some(point)
    }

    /// Whether it can be linearised about: finite, and the nose not within 1.1° of the vertical.
    pub fn is_regular(&self) -> bool {
        self.angles.pitch_rad.cos() >= LEAST_COS_PITCH && self.vector().sum().is_finite()
    }

    /// The attitude as a rotation.
    pub fn r_body_to_ned(&self) -> Matrix3<f64> {
        self.angles.to_rotation()
    }

    pub(super) fn vector(&self) -> SVector<f64, STATES> {
        let a = &self.angles;
        let blocks = [
            Vector3::new(a.roll_rad, a.pitch_rad, a.yaw_rad),
            self.position_ned,
            self.velocity_ned,
            self.gyro_bias,
            self.accel_bias,
        ];
        SVector::from_iterator(blocks.iter().flat_map(|b| b.iter().copied()))
    }

    pub(super) fn from_vector(x: &SVector<f64, STATES>) -> Self {
        let block = |at| x.fixed_rows::<3>(at).into_owned();
        Self {
            angles: Euler::new(x[THETA], x[THETA + 1], x[THETA + 2]),
            position_ned: block(P),
            velocity_ned: block(V),
            gyro_bias: block(BW),
            accel_bias: block(BF),
        }
    }
}

/// x − x̄, the angles wrapped.
pub(super) fn difference(x: &SVector<f64, STATES>, about: &SVector<f64, STATES>) -> SVector<f64, STATES> {
    let mut d = x - about;
    for i in THETA..THETA + 3 {
        d[i] = wrap_pi(d[i]);
    }
    d
}

/// E(Θ) with ω = E Θ̇: the body rate that goes with angle rates. Its columns are the axes about which the three angles turn.
pub(super) fn angle_axes(angles: &Euler) -> Matrix3<f64> {
    let (sr, cr) = angles.roll_rad.sin_cos();
    let (sp, cp) = angles.pitch_rad.sin_cos();
    Matrix3::new(1.0, 0.0, -sp, 0.0, cr, sr * cp, 0.0, -sr, cr * cp)
}

/// T(Θ) = E(Θ)⁻¹ with Θ̇ = T ω (Fusini (10a)). Not defined at ±90° of pitch.
pub(super) fn rate_to_angles(angles: &Euler) -> Matrix3<f64> {
    let (sr, cr) = angles.roll_rad.sin_cos();
    let (sp, cp) = angles.pitch_rad.sin_cos();
    let tp = sp / cp;
    Matrix3::new(1.0, sr * tp, cr * tp, 0.0, cr, -sr, 0.0, sr / cp, cr / cp)
}

/// f(x̄, u) of (10) and the blocks of ∂f/∂x that are neither zero nor the identity.
pub(super) struct LinearisedKinematics {
    /// f(x̄, u).
    pub rate: SVector<f64, STATES>,
    /// ∂Θ̇/∂Θ.
    pub angles_by_angles: Matrix3<f64>,
    /// ∂Θ̇/∂b_ω = −T.
    pub angles_by_gyro_bias: Matrix3<f64>,
    /// ∂v̇/∂Θ = −R S(f) E.
    pub velocity_by_angles: Matrix3<f64>,
    /// ∂v̇/∂v = −2 S(ω_e).
    pub velocity_by_velocity: Matrix3<f64>,
    /// ∂v̇/∂b_f = −R.
    pub velocity_by_accel_bias: Matrix3<f64>,
}

impl LinearisedKinematics {
    /// Linearised about `about`. Θ̇ = T(Θ)(ω_m − b_ω − Rᵀω_e): the Earth's rate is in (1a), and (10a) leaves it out without a reason.
    pub fn new(about: &EulerState, u: &XkfInput) -> Self {
        let r = about.r_body_to_ned();
        let (axes, t) = (angle_axes(&about.angles), rate_to_angles(&about.angles));
        let earth_body = r.tr_mul(&u.earth_rate_ned);
        let w = u.angular_rate_body - about.gyro_bias - earth_body;
        let f = u.specific_force_body - about.accel_bias;
        let coriolis = -2.0 * hat(&u.earth_rate_ned);
        let acceleration = r * f + u.gravity_ned + coriolis * about.velocity_ned;
        let mut rate = SVector::<f64, STATES>::zeros();
        rate.fixed_rows_mut::<3>(THETA).copy_from(&(t * w));
        rate.fixed_rows_mut::<3>(P).copy_from(&about.velocity_ned);
        rate.fixed_rows_mut::<3>(V).copy_from(&acceleration);
        Self {
            rate,
            // The second part is T ∂(−Rᵀω_e)/∂Θ.
            angles_by_angles: turned_rates(&about.angles, &w) - t * hat(&earth_body) * axes,
            angles_by_gyro_bias: -t,
            velocity_by_angles: -r * hat(&f) * axes,
            velocity_by_velocity: coriolis,
            velocity_by_accel_bias: -r,
        }
    }
}

/// ∂(T(Θ) w)/∂Θ at constant w.
fn turned_rates(angles: &Euler, w: &Vector3<f64>) -> Matrix3<f64> {
    let (sr, cr) = angles.roll_rad.sin_cos();
    let (sp, cp) = angles.pitch_rad.sin_cos();
    let (across, along) = (w.y * cr - w.z * sr, w.y * sr + w.z * cr);
    Matrix3::new(
        across * sp / cp,
        along / (cp * cp),
        0.0,
        -along,
        0.0,
        0.0,
        across / cp,
        along * sp / (cp * cp),
        0.0,
    )
}

/// Rᵀ a for a vector a fixed in NED, and its derivative by Θ: S(Rᵀa) E.
fn seen_from_body(about: &EulerState, a_ned: &Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
    let body = about.r_body_to_ned().tr_mul(a_ned);
    (body, hat(&body) * angle_axes(&about.angles))
}

/// A row with blocks at places.
fn row<const N: usize>(axis: usize, blocks: [(usize, Matrix3<f64>); N]) -> JacobianRow {
    let mut h = JacobianRow::zeros();
    for (at, block) in blocks {
        let mut part = h.fixed_columns_mut::<3>(at);
        part += block.row(axis);
    }
    h
}

/// One axis of a direction known in NED: Rᵀ a and its row.
pub(super) fn direction(about: &EulerState, a_ned: &Vector3<f64>, axis: usize) -> (f64, JacobianRow) {
    let (body, by_angles) = seen_from_body(about, a_ned);
    (body[axis], row(axis, [(THETA, by_angles)]))
}

/// One axis of the body velocity Rᵀv, y2 − b_v of (2b), and its row.
pub(super) fn body_velocity(about: &EulerState, axis: usize) -> (f64, JacobianRow) {
    let (body, by_angles) = seen_from_body(about, &about.velocity_ned);
    let r_t = about.r_body_to_ned().transpose();
    (body[axis], row(axis, [(THETA, by_angles), (V, r_t)]))
}

/// One axis of the specific force of a motion at constant body velocity, y3 of (2c), in one of its forms, and its row. `frozen` biases
/// are not estimated.
pub(super) fn turning_force(
    about: &EulerState,
    u: &XkfInput,
    form: SpecificForceForm,
    frozen: bool,
    axis: usize,
) -> (f64, JacobianRow) {
    let (gravity, gravity_by_angles) = seen_from_body(about, &u.gravity_ned);
    let (v, v_by_angles) = seen_from_body(about, &about.velocity_ned);
    let (earth, earth_by_angles) = seen_from_body(about, &u.earth_rate_ned);
    let w = u.angular_rate_body - about.gyro_bias - earth;
    let mut value = -gravity + w.cross(&v);
    let mut by_angles = -gravity_by_angles + hat(&w) * v_by_angles;
    let by_velocity = hat(&w) * about.r_body_to_ned().transpose();
    let (mut by_gyro_bias, mut by_accel_bias) = (hat(&v), Matrix3::zeros());
    if form != SpecificForceForm::AsPrinted {
        value += about.accel_bias;
        by_accel_bias = Matrix3::identity();
    }
    if form != SpecificForceForm::Approximate {
        by_angles += hat(&v) * earth_by_angles;
    } else if frozen {
        (by_gyro_bias, by_accel_bias) = (Matrix3::zeros(), Matrix3::zeros());
    }
    let h = row(axis, [(THETA, by_angles), (V, by_velocity), (BW, by_gyro_bias), (BF, by_accel_bias)]);
    (value[axis], h)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::SMatrix;
    use proptest::prelude::*;

    fn state() -> impl Strategy<Value = EulerState> {
        let v = |b: f64| [-b..b, -b..b, -b..b].prop_map(|a: [f64; 3]| Vector3::from(a));
        (-3.0..3.0, -1.3..1.3, -3.0..3.0, v(100.0), v(30.0), v(0.03), v(0.3)).prop_map(
            |(roll, pitch, yaw, position_ned, velocity_ned, gyro_bias, accel_bias)| EulerState {
                angles: Euler::new(roll, pitch, yaw),
                position_ned,
                velocity_ned,
                gyro_bias,
                accel_bias,
            },
        )
    }

    /// An Earth that turns a thousand times faster, lest its terms go unseen.
    fn input() -> XkfInput {
        XkfInput {
            dt_s: 0.01,
            angular_rate_body: Vector3::new(0.2, -0.1, 0.4),
            specific_force_body: Vector3::new(1.0, -2.0, -11.0),
            gravity_ned: Vector3::new(0.0, 0.0, 9.82),
            earth_rate_ned: Vector3::new(0.04, 0.01, -0.06),
        }
    }

    /// A numeric derivative by the state.
    fn numeric<const N: usize>(
        about: &EulerState,
        of: impl Fn(&EulerState) -> SVector<f64, N>,
    ) -> SMatrix<f64, N, STATES> {
        let h = 1e-5;
        let x = about.vector();
        let mut out = SMatrix::<f64, N, STATES>::zeros();
        for i in 0..STATES {
            let at = |d: f64| {
                let mut y = x;
                y[i] += d;
                of(&EulerState::from_vector(&y))
            };
            out.set_column(i, &((at(h) - at(-h)) / (2.0 * h)));
        }
        out
    }

    proptest! {
        #[test]
        fn the_dynamics_blocks_are_the_derivatives(about in state()) {
            let u = input();
            let d = LinearisedKinematics::new(&about, &u);
            let n = numeric(&about, |x| LinearisedKinematics::new(x, &u).rate);
            let block = |row: usize, col: usize| n.fixed_view::<3, 3>(row, col).into_owned();
            for (name, analytic, row, col) in [
                ("angles by angles", d.angles_by_angles, THETA, THETA),
                ("angles by gyro bias", d.angles_by_gyro_bias, THETA, BW),
                ("velocity by angles", d.velocity_by_angles, V, THETA),
                ("velocity by velocity", d.velocity_by_velocity, V, V),
                ("velocity by accelerometer bias", d.velocity_by_accel_bias, V, BF),
                ("position by velocity", Matrix3::identity(), P, V),
                ("angles by accelerometer bias", Matrix3::zeros(), THETA, BF),
            ] {
                let apart = (analytic - block(row, col)).norm();
                prop_assert!(apart < 1e-6 * (1.0 + analytic.norm()), "{name}: {apart}");
            }
        }

        #[test]
        fn the_rows_are_the_derivatives(about in state()) {
            let u = input();
            let field = Vector3::new(13.0, 1.0, 50.0);
            for axis in 0..3 {
                let one = |v: f64| SVector::<f64, 1>::new(v);
                let force = |x: &EulerState, form| turning_force(x, &u, form, false, axis);
                for (name, analytic, n) in [
                    ("flow", body_velocity(&about, axis).1, numeric(&about, |x| one(body_velocity(x, axis).0))),
                    ("force", force(&about, SpecificForceForm::WithBias).1, numeric(&about, |x| one(force(x, SpecificForceForm::WithBias).0))),
                    ("printed force", force(&about, SpecificForceForm::AsPrinted).1, numeric(&about, |x| one(force(x, SpecificForceForm::AsPrinted).0))),
                    ("field", direction(&about, &field, axis).1, numeric(&about, |x| one(direction(x, &field, axis).0))),
                ] {
                    prop_assert!((analytic - n).norm() < 1e-5, "{name} {axis}: {analytic} {n}");
                }
            }
        }

        #[test]
        fn the_approximate_force_lacks_the_earths_derivative_and_what_is_frozen(about in state()) {
            let still = XkfInput { earth_rate_ned: Vector3::zeros(), ..input() };
            for axis in 0..3 {
                let of = |form, frozen| turning_force(&about, &still, form, frozen, axis);
                let (whole, short) = (of(SpecificForceForm::WithBias, true), of(SpecificForceForm::Approximate, true));
                prop_assert_eq!(of(SpecificForceForm::WithBias, false), whole);
                prop_assert_eq!(of(SpecificForceForm::Approximate, false), whole);
                prop_assert_eq!(short.0, whole.0);
                prop_assert_eq!(short.1.fixed_columns::<9>(0), whole.1.fixed_columns::<9>(0));
                prop_assert_eq!(short.1.fixed_columns::<6>(BW).abs().max(), 0.0);
            }
        }

        #[test]
        fn angle_rates_and_body_rates_are_each_others_inverse(about in state()) {
            let product = rate_to_angles(&about.angles) * angle_axes(&about.angles);
            prop_assert!((product - Matrix3::identity()).norm() < 1e-12);
            prop_assert_eq!(EulerState::from_vector(&about.vector()), about);
        }
    }

    #[test]
    fn there_is_no_trajectory_point_straight_up_or_in_a_degenerate_matrix() {
        let at = |r| {
            EulerState::of_observer(
                &ObserverState::new(r, Vector3::zeros(), Vector3::zeros()),
                Vector3::zeros(),
            )
        };
        assert!(at(Euler::new(0.1, 1.56, 0.3).to_rotation()).is_none());
        assert!(at(Matrix3::zeros()).is_none());
        assert!(at(Matrix3::repeat(f64::NAN)).is_none());
        let level = at(Euler::new(0.1, 1.2, 0.3).to_rotation() * 1.02).unwrap();
        assert!((level.angles.yaw_rad - 0.3).abs() < 1e-12);
    }
}
