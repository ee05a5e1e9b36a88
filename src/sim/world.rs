//! The world around the vehicle, and what ideal sensors measure in it.

use super::trajectory::{Trajectory, Truth};
use crate::geo::Geodetic;
use nalgebra::Vector3;
use std::ops::{Add, Mul};

/// The year whose magnetic field the simulated world has: the navigator's while no clock has told the date.
const FIELD_YEAR: f64 = 2026.0;

/// The world around the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Environment {
    /// Gravity, m/s², down.
    pub gravity_mps2: f64,
    /// The Earth's rate in NED, rad/s.
    pub earth_rate_ned: Vector3<f64>,
    /// Magnetic field in NED, T.
    pub magnetic_ned: Vector3<f64>,
    /// The ground's p_D, m.
    pub ground_down_m: f64,
}

impl Environment {
    /// The normal gravity, Earth rate and magnetic field (of the beginning of 2026) of a place, which is the origin; the ground
    /// `ground_down_m` below it. The world is flat: gravity is the same everywhere and points along NED's z.
    ///
    /// # Errors
    /// [`crate::geo::MagneticError`] for a place that is none.
    pub fn of(origin: &Geodetic, ground_down_m: f64) -> Result<Self, crate::geo::MagneticError> {
        Ok(Self {
            gravity_mps2: crate::geo::normal_gravity(origin.latitude_rad, origin.height_m),
            earth_rate_ned: crate::geo::earth_rate_ned(origin.latitude_rad),
            magnetic_ned: crate::geo::magnetic_field(origin, FIELD_YEAR)?.raw(),
            ground_down_m,
        })
    }

    /// Central Norway: 63.4° N, a steep field of 52 µT, ground at the origin's level.
    pub fn trondheim() -> Self {
        Self {
            gravity_mps2: 9.821,
            earth_rate_ned: crate::geo::earth_rate_ned(63.4f64.to_radians()),
            magnetic_ned: Vector3::new(13.6e-6, 1.1e-6, 50.3e-6),
            ground_down_m: 0.0,
        }
    }

    /// The gravity vector in NED, m/s².
    pub fn gravity_ned(&self) -> Vector3<f64> {
        Vector3::new(0.0, 0.0, self.gravity_mps2)
    }

    /// Specific force in body axes, m/s²: Rᵀ(v̇ − g + 2ω_e × v) (Fusini (1d)).
    pub fn specific_force(&self, truth: &Truth) -> Vector3<f64> {
        let coriolis = 2.0 * self.earth_rate_ned.cross(&truth.velocity_ned);
        truth.r_body_to_ned.tr_mul(&(truth.acceleration_ned - self.gravity_ned() + coriolis))
    }

    /// What ideal gyros read, rad/s: the body rate relative to NED plus Rᵀω_e (Fusini (1a)).
    pub fn angular_rate(&self, truth: &Truth) -> Vector3<f64> {
        truth.body_rate + truth.r_body_to_ned.tr_mul(&self.earth_rate_ned)
    }

    /// What an ideal magnetometer reads, body axes, T.
    pub fn magnetometer(&self, truth: &Truth) -> Vector3<f64> {
        truth.r_body_to_ned.tr_mul(&self.magnetic_ned)
    }

    /// Height over the ground, m.
    pub fn height(&self, truth: &Truth) -> f64 {
        self.ground_down_m - truth.position_ned.z
    }

    /// The ideal IMU sample stamped `to_s`: means over (from, to], by five-point Gauss-Legendre quadrature (exact to the ninth order).
    pub fn imu(&self, trajectory: &(impl Trajectory + ?Sized), from_s: f64, to_s: f64) -> ImuMean {
        mean(from_s, to_s, ImuMean::zero(), |t| self.imu_at(&trajectory.at(t)))
    }

    /// What an ideal IMU feels at one instant.
    pub fn imu_at(&self, truth: &Truth) -> ImuMean {
        ImuMean { angular_rate: self.angular_rate(truth), specific_force: self.specific_force(truth) }
    }
}

/// The mean of `f` over an interval, by five-point Gauss-Legendre quadrature, added to `zero`.
pub(super) fn mean<T>(from_s: f64, to_s: f64, zero: T, f: impl Fn(f64) -> T) -> T
where
    T: Add<Output = T> + Mul<f64, Output = T>,
{
    const NODES: [(f64, f64); 5] = [
        (0.0, 128.0 / 225.0),
        (0.538_469_310_105_683_1, 0.478_628_670_499_366_47),
        (-0.538_469_310_105_683_1, 0.478_628_670_499_366_47),
        (0.906_179_845_938_664, 0.236_926_885_056_189_08),
        (-0.906_179_845_938_664, 0.236_926_885_056_189_08),
    ];
    let (middle, half) = (0.5 * (from_s + to_s), 0.5 * (to_s - from_s));
    NODES.into_iter().fold(zero, |sum, (x, w)| sum + f(middle + half * x) * (0.5 * w))
}

/// An IMU sample: means over its interval, body axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuMean {
    /// rad/s.
    pub angular_rate: Vector3<f64>,
    /// m/s².
    pub specific_force: Vector3<f64>,
}

impl ImuMean {
    /// Nothing felt.
    fn zero() -> Self {
        Self { angular_rate: Vector3::zeros(), specific_force: Vector3::zeros() }
    }
}

impl Add for ImuMean {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            angular_rate: self.angular_rate + other.angular_rate,
            specific_force: self.specific_force + other.specific_force,
        }
    }
}

impl Mul<f64> for ImuMean {
    type Output = Self;
    fn mul(self, by: f64) -> Self {
        Self { angular_rate: self.angular_rate * by, specific_force: self.specific_force * by }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::so3;
    use crate::sim::Scenario;

    #[test]
    fn integrating_the_ideal_imu_gives_the_trajectory_back() {
        let env = Environment::trondheim();
        for tr in [Scenario::figure_eight(), Scenario::corners()] {
            let dt = 0.002;
            let start = tr.at(0.0);
            let (mut r, mut v, mut p) = (start.r_body_to_ned, start.velocity_ned, start.position_ned);
            let n = 20_000;
            for k in 1..=n {
                let imu = env.imu(&tr, dt * f64::from(k - 1), dt * f64::from(k));
                let w = imu.angular_rate - r.tr_mul(&env.earth_rate_ned);
                let middle = r * so3::exp(&(0.5 * dt * w));
                let a = middle * imu.specific_force + env.gravity_ned() - 2.0 * env.earth_rate_ned.cross(&v);
                p += dt * (v + 0.5 * dt * a);
                v += dt * a;
                r *= so3::exp(&(dt * w));
            }
            let end = tr.at(dt * f64::from(n));
            assert!(so3::angle_between(&r, &end.r_body_to_ned) < 1e-6);
            assert!((v - end.velocity_ned).norm() < 1e-3, "{}", (v - end.velocity_ned).norm());
            assert!((p - end.position_ned).norm() < 1e-2, "{}", (p - end.position_ned).norm());
        }
    }

    #[test]
    fn a_hovering_imu_feels_gravity_upwards_and_the_earth_turn() {
        let env = Environment::trondheim();
        let imu = env.imu(&Scenario::corners(), 1.0, 1.01);
        assert!((imu.specific_force + env.gravity_ned()).norm() < 1e-12);
        assert!((imu.angular_rate - env.earth_rate_ned).norm() < 1e-15);
        assert_eq!(env.height(&Scenario::corners().at(1.0)), 30.0);
    }
}
