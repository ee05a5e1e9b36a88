//! Closed-form truth: position, velocity, acceleration, attitude and body rate at any time, all exact derivatives of one another.
//!
//! A path is given with its derivatives up to jerk; the attitude follows from it, since both a coordinated fixed wing and a multirotor are
//! differentially flat: a fixed wing's x axis lies along the velocity and its specific force in the plane of symmetry, a multirotor's
//! specific force lies along −z and its heading is free. The body rate then comes from the jerk, without any numeric derivative.

use crate::geo::{NOMINAL_GRAVITY_MPS2, so3};
use nalgebra::{Matrix3, Vector3};

/// The truth at a time. NED and body FRD, SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Time, s.
    pub t_s: f64,
    /// Position in NED, m.
    pub position_ned: Vector3<f64>,
    /// Velocity in NED, m/s.
    pub velocity_ned: Vector3<f64>,
    /// Acceleration in NED, m/s².
    pub acceleration_ned: Vector3<f64>,
    /// Attitude.
    pub r_body_to_ned: Matrix3<f64>,
    /// Angular velocity of the body relative to NED, body axes, rad/s.
    pub body_rate: Vector3<f64>,
}

impl Truth {
    /// Velocity in body axes, m/s.
    pub fn velocity_body(&self) -> Vector3<f64> {
        self.r_body_to_ned.tr_mul(&self.velocity_ned)
    }
}

/// A motion known at any time.
pub trait Trajectory {
    /// The truth at `t_s` seconds.
    fn at(&self, t_s: f64) -> Truth;
}

/// Position and its first three derivatives.
#[derive(Clone, Copy)]
pub(super) struct Path {
    pub(super) p: Vector3<f64>,
    pub(super) v: Vector3<f64>,
    pub(super) a: Vector3<f64>,
    pub(super) j: Vector3<f64>,
}

impl Path {
    /// From one point to another in `over_s`, `into_s` after its beginning: at rest to jerk at both ends.
    pub(super) fn leg(from: Vector3<f64>, to: Vector3<f64>, into_s: f64, over_s: f64) -> Self {
        let [s, ds, dds, ddds] = smooth_step(into_s / over_s);
        let (way, rate) = (to - from, 1.0 / over_s);
        Self {
            p: from + s * way,
            v: ds * rate * way,
            a: dds * rate.powi(2) * way,
            j: ddds * rate.powi(3) * way,
        }
    }
}

/// A fixed wing whose nose points along `x` (derivative `dx`) with the specific force in its plane of symmetry.
pub(super) fn coordinated(t_s: f64, path: &Path, x: Vector3<f64>, dx: Vector3<f64>) -> Truth {
    let f = path.a - Vector3::new(0.0, 0.0, NOMINAL_GRAVITY_MPS2);
    let along = f.dot(&x);
    let d_along = path.j.dot(&x) + f.dot(&dx);
    // Lift and its derivative: what is left of the specific force across the velocity.
    let (up, d_up) = unit(&(f - along * x), &(path.j - d_along * x - along * dx));
    let (z, dz) = (-up, -d_up);
    let y = z.cross(&x);
    let dy = dz.cross(&x) + z.cross(&dx);
    truth(t_s, path, [x, y, z], [dx, dy, dz])
}

/// A multirotor whose thrust makes the path's acceleration against the drag of its rotors (1/s times the velocity, in still air), with a
/// heading (rad) and its rate.
pub(super) fn thrusting(t_s: f64, path: &Path, drag_per_s: f64, (psi, dpsi): (f64, f64)) -> Truth {
    let (s, c) = psi.sin_cos();
    let (ahead, d_ahead) = (Vector3::new(c, s, 0.0), dpsi * Vector3::new(-s, c, 0.0));
    let thrust = path.a - Vector3::new(0.0, 0.0, NOMINAL_GRAVITY_MPS2) + path.v * drag_per_s;
    let (up, d_up) = unit(&thrust, &(path.j + path.a * drag_per_s));
    let (z, dz) = (-up, -d_up);
    let (y, dy) = unit(&z.cross(&ahead), &(dz.cross(&ahead) + z.cross(&d_ahead)));
    let x = y.cross(&z);
    let dx = dy.cross(&z) + y.cross(&dz);
    truth(t_s, path, [x, y, z], [dx, dy, dz])
}

/// 35τ⁴ − 84τ⁵ + 70τ⁶ − 20τ⁷ from 0 to 1 and its first three derivatives, all zero at both ends.
pub(super) fn smooth_step(tau: f64) -> [f64; 4] {
    let t = tau.clamp(0.0, 1.0);
    let u = 1.0 - t;
    [
        t.powi(4) * (35.0 + t * (-84.0 + t * (70.0 - 20.0 * t))),
        140.0 * (t * u).powi(3),
        420.0 * (t * u).powi(2) * (1.0 - 2.0 * t),
        840.0 * t * u * (1.0 - 5.0 * t * u),
    ]
}

/// The unit vector of w and its derivative.
pub(super) fn unit(w: &Vector3<f64>, dw: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let n = w.norm();
    let u = w / n;
    (u, (dw - u * u.dot(dw)) / n)
}

fn truth(t_s: f64, path: &Path, axes: [Vector3<f64>; 3], derivatives: [Vector3<f64>; 3]) -> Truth {
    let r = Matrix3::from_columns(&axes);
    let dr = Matrix3::from_columns(&derivatives);
    Truth {
        t_s,
        position_ned: path.p,
        velocity_ned: path.v,
        acceleration_ned: path.a,
        r_body_to_ned: r,
        // Ṙ = R S(ω).
        body_rate: so3::vex(&(r.transpose() * dr)),
    }
}

/// What every trajectory owes.
#[cfg(test)]
pub(super) mod testing {
    use super::{Trajectory, so3};
    use nalgebra::Matrix3;

    /// Velocity, acceleration and body rate against central differences, and the attitude a rotation.
    pub fn assert_derivatives(name: &str, tr: &dyn Trajectory, times: impl IntoIterator<Item = f64>) {
        let h = 1e-5;
        for t in times {
            let (a, b, c) = (tr.at(t - h), tr.at(t), tr.at(t + h));
            let v = (c.position_ned - a.position_ned) / (2.0 * h);
            assert!((v - b.velocity_ned).norm() < 1e-6, "{name} at {t}: {v} {}", b.velocity_ned);
            let acc = (c.velocity_ned - a.velocity_ned) / (2.0 * h);
            assert!((acc - b.acceleration_ned).norm() < 1e-6, "{name} at {t}");
            let w = so3::log(&(a.r_body_to_ned.transpose() * c.r_body_to_ned)) / (2.0 * h);
            assert!((w - b.body_rate).norm() < 1e-6, "{name} at {t}: {w} {}", b.body_rate);
            let rtr = b.r_body_to_ned.transpose() * b.r_body_to_ned;
            assert!((rtr - Matrix3::identity()).norm() < 1e-12);
            assert!((b.r_body_to_ned.determinant() - 1.0).abs() < 1e-12);
        }
    }

    /// No jump of specific force or body rate at these times.
    pub fn assert_continuous(name: &str, tr: &dyn Trajectory, times: impl IntoIterator<Item = f64>) {
        for t in times {
            let (a, b) = (tr.at(t - 1e-7), tr.at(t + 1e-7));
            let force = b.acceleration_ned - a.acceleration_ned;
            assert!(force.norm() < 1e-4, "{name} at {t}: {force}");
            assert!((b.body_rate - a.body_rate).norm() < 1e-5, "{name} at {t}");
        }
    }
}
