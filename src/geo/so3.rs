//! The rotation group SO(3): exponential, logarithm, left Jacobian, Euler angles.
//!
//! A rotation `r_body_to_ned` maps body components to NED components: `v_ned = r_body_to_ned * v_body`.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use std::f64::consts::PI;

/// Euler angles of `r_body_to_ned = Rz(yaw) Ry(pitch) Rx(roll)` (ZYX, the aerospace convention; Fusini, Section II), radians.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Euler {
    /// Roll φ in (−π, π].
    pub roll_rad: f64,
    /// Pitch θ in [−π/2, π/2].
    pub pitch_rad: f64,
    /// Yaw ψ in (−π, π], from true north, positive towards east.
    pub yaw_rad: f64,
}

/// The skew matrix S(x) with S(x)y = x × y (Grip, Section I-B).
pub fn hat(x: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -x.z, x.y, x.z, 0.0, -x.x, -x.y, x.x, 0.0)
}

/// `vex(P_a(m))`: the vector whose [`hat`] is the skew-symmetric part of `m` (Grip, Section I-B). On a skew matrix it is the
/// inverse of [`hat`].
pub fn vex(m: &Matrix3<f64>) -> Vector3<f64> {
    0.5 * Vector3::new(m.m32 - m.m23, m.m13 - m.m31, m.m21 - m.m12)
}

/// The rotation by the vector `phi` (axis times angle, rad): Exp(φ) = I + (sin θ/θ) S + ((1 − cos θ)/θ²) S², θ = |φ|
/// (Rodrigues). Below 10⁻⁴ rad both factors come from their series, whose next terms are below 10⁻¹⁸.
///
/// It is the filters' step at every IMU sample. [`Rotation3::from_scaled_axis`] is the same to rounding, but normalises the axis: a square
/// root and a division more at the angles of a step, where the series needs neither.
pub fn exp(phi: &Vector3<f64>) -> Matrix3<f64> {
    let t2 = phi.norm_squared();
    let (a, b) = if t2 < 1e-8 {
        (1.0 - t2 / 6.0 + t2 * t2 / 120.0, 0.5 - t2 / 24.0 + t2 * t2 / 720.0)
    } else {
        let t = t2.sqrt();
        let half = 0.5 * t;
        // 1 − cos θ as 2 sin²(θ/2): no cancellation at small angles.
        let s = half.sin() / half;
        (t.sin() / t, 0.5 * s * s)
    };
    let s = hat(phi);
    Matrix3::identity() + a * s + b * (s * s)
}

/// The mean of Exp(σφ) over σ in [0, 1], the left Jacobian of SO(3): J(φ) = I + ((1 − cos θ)/θ²) S + ((θ − sin θ)/θ³) S². A body that moves
/// at the constant body velocity v and rate ω for a time h has moved by J(ωh) v h, seen from where it started.
pub fn left_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    let t2 = phi.norm_squared();
    let (a, b) = if t2 < 1e-4 {
        (0.5 - t2 / 24.0 + t2 * t2 / 720.0, 1.0 / 6.0 - t2 / 120.0 + t2 * t2 / 5040.0)
    } else {
        let t = t2.sqrt();
        let half = 0.5 * t;
        let s = half.sin() / half;
        (0.5 * s * s, (t - t.sin()) / (t2 * t))
    };
    let s = hat(phi);
    Matrix3::identity() + a * s + b * (s * s)
}

/// The rotation vector φ with |φ| ≤ π and `exp(φ) = r`, for `r` in SO(3). By way of the quaternion, so that it stays accurate near 0 and near
/// π alike; [`Rotation3::scaled_axis`] takes the arc cosine of the trace, which loses half of the digits at both.
pub fn log(r: &Matrix3<f64>) -> Vector3<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*r)).scaled_axis()
}

impl Euler {
    /// Angles from roll, pitch and yaw in radians.
    pub const fn new(roll_rad: f64, pitch_rad: f64, yaw_rad: f64) -> Self {
        Self { roll_rad, pitch_rad, yaw_rad }
    }

    /// The angles of a rotation `r_body_to_ned` in SO(3). At ±90° of pitch only roll ∓ yaw is defined: roll is then given as 0.
    pub fn from_rotation(r_body_to_ned: &Matrix3<f64>) -> Self {
        let r = r_body_to_ned;
        let cos_pitch = r.m11.hypot(r.m21);
        let pitch_rad = (-r.m31).atan2(cos_pitch);
        if cos_pitch < 1e-9 {
            return Self { roll_rad: 0.0, pitch_rad, yaw_rad: (-r.m12).atan2(r.m22) };
        }
        Self { roll_rad: r.m32.atan2(r.m33), pitch_rad, yaw_rad: r.m21.atan2(r.m11) }
    }

    /// The rotation `r_body_to_ned` with these angles.
    pub fn to_rotation(self) -> Matrix3<f64> {
        let (sr, cr) = self.roll_rad.sin_cos();
        let (sp, cp) = self.pitch_rad.sin_cos();
        let (sy, cy) = self.yaw_rad.sin_cos();
        Matrix3::new(
            cy * cp,
            cy * sp * sr - sy * cr,
            cy * sp * cr + sy * sr,
            sy * cp,
            sy * sp * sr + cy * cr,
            sy * sp * cr - cy * sr,
            -sp,
            cp * sr,
            cp * cr,
        )
    }
}

/// The same angle in (−π, π]. A value that is not finite stays so.
pub fn wrap_pi(angle_rad: f64) -> f64 {
    let a = angle_rad - 2.0 * PI * ((angle_rad + PI) / (2.0 * PI)).floor();
    if a <= -PI { a + 2.0 * PI } else { a }
}

/// The angle in [0, π] by which two rotations differ, rad.
pub fn angle_between(a: &Matrix3<f64>, b: &Matrix3<f64>) -> f64 {
    log(&(a.transpose() * b)).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector(bound: f64) -> impl Strategy<Value = Vector3<f64>> {
        [-bound..bound, -bound..bound, -bound..bound].prop_map(|[x, y, z]| Vector3::new(x, y, z))
    }

    proptest! {
        #[test]
        fn exp_is_a_rotation_and_log_inverts_it(phi in vector(1.8)) {
            let r = exp(&phi);
            prop_assert!((r.transpose() * r - Matrix3::identity()).norm() < 1e-14);
            prop_assert!((r.determinant() - 1.0).abs() < 1e-14);
            prop_assert!((log(&r) - phi).norm() < 1e-12);
        }

        #[test]
        fn the_left_jacobian_is_the_mean_rotation(phi in vector(2.0), scale in 1e-6..1.0f64) {
            let phi = scale * phi;
            // Simpson's rule with 64 intervals.
            let weight = |i: u32| if i == 0 || i == 64 { 1.0 } else if i % 2 == 1 { 4.0 } else { 2.0 };
            let mean: Matrix3<f64> = (0..=64).map(|i| weight(i) / 192.0 * exp(&(f64::from(i) / 64.0 * phi))).sum();
            prop_assert!((left_jacobian(&phi) - mean).norm() < 1e-7);
            // S J = Exp − I holds exactly.
            prop_assert!((hat(&phi) * left_jacobian(&phi) - (exp(&phi) - Matrix3::identity())).norm() < 1e-13);
        }

        #[test]
        fn exp_commutes_with_a_change_of_frame(phi in vector(3.0), psi in vector(3.0)) {
            let r = exp(&psi);
            prop_assert!((exp(&(r * phi)) - r * exp(&phi) * r.transpose()).norm() < 1e-13);
        }

        #[test]
        fn vex_inverts_hat_and_hat_is_the_cross_product(x in vector(9.0), y in vector(9.0)) {
            prop_assert_eq!(vex(&hat(&x)), x);
            prop_assert!((hat(&x) * y - x.cross(&y)).norm() < 1e-12);
        }

        #[test]
        fn euler_angles_round_trip(roll in -3.1..3.1, pitch in -1.55..1.55, yaw in -3.1..3.1) {
            let e = Euler::from_rotation(&Euler::new(roll, pitch, yaw).to_rotation());
            prop_assert!((e.roll_rad - roll).abs() < 1e-10);
            prop_assert!((e.pitch_rad - pitch).abs() < 1e-10);
            prop_assert!((e.yaw_rad - yaw).abs() < 1e-10);
        }

        #[test]
        fn wrapped_angles_are_the_same_angle(a in -100.0..100.0f64) {
            let w = wrap_pi(a);
            prop_assert!(w > -PI && w <= PI);
            prop_assert!((w.sin() - a.sin()).abs() < 1e-12 && (w.cos() - a.cos()).abs() < 1e-12);
        }
    }

    #[test]
    fn log_at_half_a_turn_is_half_a_turn() {
        for axis in [Vector3::x(), Vector3::y(), Vector3::z(), Vector3::new(0.6, 0.0, -0.8)] {
            let l = log(&exp(&(PI * axis)));
            assert!((l.norm() - PI).abs() < 1e-12);
            assert!(l.cross(&axis).norm() < 1e-7);
        }
    }

    #[test]
    fn angles_follow_the_aerospace_convention() {
        // Nose up: the body's x axis points upwards, that is, to negative D.
        assert!((Euler::new(0.0, 0.3, 0.0).to_rotation() * Vector3::x()).z < 0.0);
        // Right wing down: the body's y axis points downwards.
        assert!((Euler::new(0.3, 0.0, 0.0).to_rotation() * Vector3::y()).z > 0.0);
        // Heading east.
        let x = Euler::new(0.0, 0.0, PI / 2.0).to_rotation() * Vector3::x();
        assert!((x - Vector3::y()).norm() < 1e-15);
    }

    #[test]
    fn gimbal_lock_gives_a_finite_and_equal_attitude() {
        for pitch in [PI / 2.0, -PI / 2.0] {
            let r = Euler::new(0.4, pitch, 1.1).to_rotation();
            assert!((Euler::from_rotation(&r).to_rotation() - r).norm() < 1e-9);
        }
    }
}
