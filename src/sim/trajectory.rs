//! Closed-form truth: position, velocity, acceleration, attitude and body rate at any time, all exact derivatives of one another.
//!
//! A path is given with its derivatives up to jerk; the attitude follows from it, since both a coordinated fixed wing and a multirotor are
//! differentially flat: a fixed wing's x axis lies along the velocity and its specific force in the plane of symmetry, a multirotor's
//! specific force lies along −z and its heading is free. The body rate then comes from the jerk, without any numeric derivative.

use crate::geo::{NOMINAL_GRAVITY_MPS2, so3};
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::{FRAC_PI_2, TAU};

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

/// amplitude · sin(rate · t + phase)
#[derive(Clone, Copy, Debug, PartialEq)]
struct Harmonic {
    axis: usize,
    amplitude_m: f64,
    rate_radps: f64,
    phase_rad: f64,
}

/// A fixed wing that flies coordinated turns without wind, angle of attack or sideslip along a sum of sinusoids and a straight line.
#[derive(Clone, Debug, PartialEq)]
pub struct FixedWing {
    start_ned: Vector3<f64>,
    drift_ned: Vector3<f64>,
    harmonics: Vec<Harmonic>,
}

impl FixedWing {
    /// Circles to the right at a constant ground speed, with a slow sinusoidal climb and descent.
    pub fn circle(radius_m: f64, speed_mps: f64, height_m: f64, climb_m: f64, climb_period_s: f64) -> Self {
        let rate_radps = speed_mps / radius_m;
        let h = |axis, phase_rad| Harmonic { axis, amplitude_m: radius_m, rate_radps, phase_rad };
        Self {
            start_ned: Vector3::new(0.0, radius_m, -height_m),
            drift_ned: Vector3::zeros(),
            // Starts at the origin, northwards.
            harmonics: vec![h(0, 0.0), h(1, -FRAC_PI_2), climb(climb_m, climb_period_s)],
        }
    }

    /// Figures of eight of the given length (north) and width (east): turns to both sides, speed and climb changing.
    pub fn figure_eight(
        length_m: f64,
        width_m: f64,
        period_s: f64,
        height_m: f64,
        climb_m: f64,
        climb_period_s: f64,
    ) -> Self {
        let w = TAU / period_s;
        let north = Harmonic { axis: 0, amplitude_m: length_m / 2.0, rate_radps: w, phase_rad: 0.0 };
        let east = Harmonic { axis: 1, amplitude_m: width_m / 2.0, rate_radps: 2.0 * w, phase_rad: 0.0 };
        Self {
            start_ned: Vector3::new(0.0, 0.0, -height_m),
            drift_ned: Vector3::zeros(),
            harmonics: vec![north, east, climb(climb_m, climb_period_s)],
        }
    }

    /// A straight flight to the north that weaves a little to the sides (amplitude 0 for none).
    pub fn straight(speed_mps: f64, height_m: f64, weave_m: f64, weave_period_s: f64) -> Self {
        let weave =
            Harmonic { axis: 1, amplitude_m: weave_m, rate_radps: TAU / weave_period_s, phase_rad: 0.0 };
        Self {
            start_ned: Vector3::new(0.0, 0.0, -height_m),
            drift_ned: Vector3::new(speed_mps, 0.0, 0.0),
            harmonics: vec![weave],
        }
    }

    fn path(&self, t: f64) -> Path {
        let zero = Vector3::zeros();
        let mut path = Path { p: self.start_ned + t * self.drift_ned, v: self.drift_ned, a: zero, j: zero };
        for h in &self.harmonics {
            let (s, c) = (h.rate_radps * t + h.phase_rad).sin_cos();
            let w = h.rate_radps;
            path.p[h.axis] += h.amplitude_m * s;
            path.v[h.axis] += h.amplitude_m * w * c;
            path.a[h.axis] -= h.amplitude_m * w * w * s;
            path.j[h.axis] -= h.amplitude_m * w * w * w * c;
        }
        path
    }
}

fn climb(climb_m: f64, period_s: f64) -> Harmonic {
    Harmonic { axis: 2, amplitude_m: -climb_m / 2.0, rate_radps: TAU / period_s, phase_rad: 0.0 }
}

impl Trajectory for FixedWing {
    fn at(&self, t_s: f64) -> Truth {
        let path = self.path(t_s);
        let (x, dx) = unit(&path.v, &path.a);
        coordinated(t_s, &path, x, dx)
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

/// A multirotor that flies a square with hovers at its corners.
///
/// It hovers, flies a leg, hovers and turns right by 90° (if it turns), and so on. Legs are seventh-order polynomials with velocity,
/// acceleration and jerk zero at both ends, so that body rates are continuous. Every other corner is higher by the climb.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Multirotor {
    /// Side of the square, m.
    pub side_m: f64,
    /// Duration of a leg, s. The top speed is 35/16 of side over duration.
    pub leg_s: f64,
    /// Duration of a hover, s.
    pub hover_s: f64,
    /// Height at the first corner, m.
    pub height_m: f64,
    /// How much higher the second and fourth corners are, m.
    pub climb_m: f64,
    /// Whether the nose points along the leg; else north.
    pub turns: bool,
}

impl Multirotor {
    /// A square of 60 m at up to 8.75 m/s, with hovers of 10 s.
    pub fn square() -> Self {
        Self { side_m: 60.0, leg_s: 15.0, hover_s: 10.0, height_m: 30.0, climb_m: 5.0, turns: true }
    }

    fn corner(&self, k: i64) -> Vector3<f64> {
        let (n, e, up) = match k.rem_euclid(4) {
            0 => (0.0, 0.0, 0.0),
            1 => (1.0, 0.0, 1.0),
            2 => (1.0, 1.0, 0.0),
            _ => (0.0, 1.0, 1.0),
        };
        Vector3::new(n * self.side_m, e * self.side_m, -self.height_m - up * self.climb_m)
    }
}

impl Trajectory for Multirotor {
    fn at(&self, t_s: f64) -> Truth {
        let cycle = self.hover_s + self.leg_s;
        let k = (t_s / cycle).floor();
        let into = t_s - k * cycle;
        let from = self.corner(k as i64);
        let zero = Vector3::zeros();
        let mut path = Path { p: from, v: zero, a: zero, j: zero };
        let mut heading = (k * FRAC_PI_2, 0.0);
        if into < self.hover_s {
            if k > 0.0 {
                let [s, ds, ..] = smooth_step(into / self.hover_s);
                heading = ((k - 1.0 + s) * FRAC_PI_2, FRAC_PI_2 * ds / self.hover_s);
            }
        } else {
            path = Path::leg(from, self.corner(k as i64 + 1), into - self.hover_s, self.leg_s);
        }
        thrusting(t_s, &path, 0.0, if self.turns { heading } else { (0.0, 0.0) })
    }
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
fn unit(w: &Vector3<f64>, dw: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
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

#[cfg(test)]
mod tests {
    use super::testing::{assert_continuous, assert_derivatives};
    use super::*;

    fn all() -> Vec<Box<dyn Trajectory>> {
        vec![
            Box::new(FixedWing::circle(300.0, 25.0, 120.0, 40.0, 70.0)),
            Box::new(FixedWing::figure_eight(800.0, 400.0, 80.0, 150.0, 30.0, 50.0)),
            Box::new(FixedWing::straight(27.0, 120.0, 20.0, 40.0)),
            Box::new(Multirotor::square()),
            Box::new(Multirotor { turns: false, ..Multirotor::square() }),
        ]
    }

    #[test]
    fn every_quantity_is_the_derivative_of_the_one_before() {
        for (i, tr) in all().iter().enumerate() {
            let times = (0..400).map(|k| 0.37 * f64::from(k) + 0.011);
            assert_derivatives(&format!("trajectory {i}"), tr.as_ref(), times);
        }
    }

    #[test]
    fn a_circle_banks_by_the_textbook_angle_and_turns_right() {
        let c = FixedWing::circle(300.0, 25.0, 120.0, 0.0, 70.0);
        for t in [0.0, 3.3, 100.0] {
            let x = c.at(t);
            let e = so3::Euler::from_rotation(&x.r_body_to_ned);
            assert!((e.roll_rad.tan() - 25.0 * 25.0 / (300.0 * NOMINAL_GRAVITY_MPS2)).abs() < 1e-12);
            assert!((x.velocity_ned.norm() - 25.0).abs() < 1e-9);
            assert!((x.velocity_body() - Vector3::new(25.0, 0.0, 0.0)).norm() < 1e-9);
        }
        let e = so3::Euler::from_rotation(&c.at(1.0).r_body_to_ned);
        assert!(e.yaw_rad > 0.08, "started northwards, now turning east");
    }

    #[test]
    fn a_hover_is_level_and_at_rest_and_the_nose_follows_the_legs() {
        let m = Multirotor::square();
        let x = m.at(5.0);
        assert_eq!(x.velocity_ned.norm(), 0.0);
        assert!((x.r_body_to_ned - Matrix3::identity()).norm() < 1e-12);
        let on_second_leg = m.at(25.0 + 10.0 + 7.5);
        assert!(on_second_leg.velocity_body().x > 8.0 && on_second_leg.velocity_body().y.abs() < 1e-9);
        assert!((m.at(50.0).position_ned - Vector3::new(60.0, 60.0, -30.0)).norm() < 1e-9);
    }

    #[test]
    fn body_rates_are_continuous_at_the_corners() {
        assert_continuous("square", &Multirotor::square(), [10.0, 25.0, 35.0, 50.0]);
    }
}
