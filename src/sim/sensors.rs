//! Ideal sensors from a trajectory, and seeded errors on top of them.

use super::trajectory::{Trajectory, Truth};
use crate::geo::Geodetic;
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
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

/// Errors of the sensors: constant biases and the standard deviations of white noise, equal on all axes where scalar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseLevels {
    /// Gyro noise density, rad/s/√Hz.
    pub gyro_density: f64,
    /// Accelerometer noise density, m/s²/√Hz.
    pub accel_density: f64,
    /// Gyro bias, rad/s.
    pub gyro_bias: Vector3<f64>,
    /// Accelerometer bias, m/s².
    pub accel_bias: Vector3<f64>,
    /// GNSS position, m, per axis of NED.
    pub gnss_position_m: Vector3<f64>,
    /// GNSS velocity, m/s, per axis of NED.
    pub gnss_velocity_mps: Vector3<f64>,
    /// Magnetometer, T.
    pub magnetometer_t: f64,
    /// Magnetometer bias (hard iron), body, T.
    pub magnetometer_bias_t: Vector3<f64>,
    /// Flow velocity, m/s, per body axis.
    pub flow_mps: Vector3<f64>,
    /// Flow velocity bias b_v, body, m/s.
    pub flow_bias_mps: Vector3<f64>,
    /// Altitude, m.
    pub altitude_m: f64,
}

impl NoiseLevels {
    /// No errors at all.
    pub fn none() -> Self {
        let zero = Vector3::zeros();
        Self {
            gyro_density: 0.0,
            accel_density: 0.0,
            gyro_bias: zero,
            accel_bias: zero,
            gnss_position_m: zero,
            gnss_velocity_mps: zero,
            magnetometer_t: 0.0,
            magnetometer_bias_t: zero,
            flow_mps: zero,
            flow_bias_mps: zero,
            altitude_m: 0.0,
        }
    }

    /// A tactical-grade IMU (0.003 °/s/√Hz, biases of 0.02-0.05 °/s and 0.02 m/s²), GNSS of 1.5 m and 0.1 m/s, flow of 0.5 m/s.
    pub fn tactical() -> Self {
        Self {
            gyro_density: 0.003f64.to_radians(),
            accel_density: 2e-3,
            gyro_bias: Vector3::new(0.03, -0.02, 0.05).map(f64::to_radians),
            accel_bias: Vector3::new(0.02, -0.01, 0.02),
            gnss_position_m: Vector3::new(1.5, 1.5, 2.5),
            gnss_velocity_mps: Vector3::new(0.1, 0.1, 0.15),
            magnetometer_t: 0.3e-6,
            magnetometer_bias_t: Vector3::zeros(),
            flow_mps: Vector3::new(0.5, 0.5, 1.0),
            flow_bias_mps: Vector3::new(0.5, 0.3, 0.0),
            altitude_m: 0.3,
        }
    }

    /// A MEMS IMU (0.01 °/s/√Hz, biases of 0.3-0.8 °/s and 0.05 m/s²), otherwise as [`Self::tactical`].
    pub fn mems() -> Self {
        Self {
            gyro_density: 0.01f64.to_radians(),
            accel_density: 3e-3,
            gyro_bias: Vector3::new(0.5, -0.3, 0.8).map(f64::to_radians),
            accel_bias: Vector3::new(0.05, -0.04, 0.05),
            ..Self::tactical()
        }
    }
}

/// Sensors with errors. The same seed and the same order of calls give the same numbers.
#[derive(Clone, Debug)]
pub struct Noisy {
    levels: NoiseLevels,
    rng: ChaCha8Rng,
}

impl Noisy {
    /// Errors of these levels from a seed.
    pub fn new(levels: NoiseLevels, seed: u64) -> Self {
        Self { levels, rng: ChaCha8Rng::seed_from_u64(seed) }
    }

    fn white(&mut self, sigma: &Vector3<f64>) -> Vector3<f64> {
        let rng = &mut self.rng;
        sigma.map(|s| s * Distribution::<f64>::sample(&StandardNormal, rng))
    }

    /// An IMU sample of an interval of `dt_s` with bias and noise.
    pub fn imu(&mut self, ideal: &ImuMean, dt_s: f64) -> ImuMean {
        let root = dt_s.sqrt();
        let gyro = self.white(&Vector3::repeat(self.levels.gyro_density / root));
        let accel = self.white(&Vector3::repeat(self.levels.accel_density / root));
        ImuMean {
            angular_rate: ideal.angular_rate + self.levels.gyro_bias + gyro,
            specific_force: ideal.specific_force + self.levels.accel_bias + accel,
        }
    }

    /// A GNSS fix: position, m, and velocity, m/s, in NED.
    pub fn gnss(&mut self, truth: &Truth) -> (Vector3<f64>, Vector3<f64>) {
        let (sigma_p, sigma_v) = (self.levels.gnss_position_m, self.levels.gnss_velocity_mps);
        (truth.position_ned + self.white(&sigma_p), truth.velocity_ned + self.white(&sigma_v))
    }

    /// A magnetometer sample, body axes, T.
    pub fn magnetometer(&mut self, environment: &Environment, truth: &Truth) -> Vector3<f64> {
        let noise = self.white(&Vector3::repeat(self.levels.magnetometer_t));
        environment.magnetometer(truth) + self.levels.magnetometer_bias_t + noise
    }

    /// A flow velocity, body axes, m/s, with its bias b_v.
    pub fn flow_velocity(&mut self, truth: &Truth) -> Vector3<f64> {
        let sigma = self.levels.flow_mps;
        truth.velocity_body() + self.levels.flow_bias_mps + self.white(&sigma)
    }

    /// An altitude as p_D, m.
    pub fn altitude_down(&mut self, truth: &Truth) -> f64 {
        let sigma = self.levels.altitude_m;
        truth.position_ned.z + self.white(&Vector3::repeat(sigma)).x
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::so3;
    use crate::sim::{FixedWing, Multirotor};

    #[test]
    fn integrating_the_ideal_imu_gives_the_trajectory_back() {
        let env = Environment::trondheim();
        for tr in [
            Box::new(FixedWing::figure_eight(800.0, 400.0, 80.0, 150.0, 30.0, 50.0)) as Box<dyn Trajectory>,
            Box::new(Multirotor::square()),
        ] {
            let dt = 0.002;
            let start = tr.at(0.0);
            let (mut r, mut v, mut p) = (start.r_body_to_ned, start.velocity_ned, start.position_ned);
            let n = 20_000;
            for k in 1..=n {
                let imu = env.imu(tr.as_ref(), dt * f64::from(k - 1), dt * f64::from(k));
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
    fn noise_has_the_stated_level_and_repeats_with_its_seed() {
        let truth = FixedWing::straight(25.0, 100.0, 0.0, 1.0).at(0.0);
        let ideal = ImuMean { angular_rate: Vector3::zeros(), specific_force: Vector3::zeros() };
        let levels = NoiseLevels::mems();
        let mut a = Noisy::new(levels, 7);
        let mut b = Noisy::new(levels, 7);
        assert_eq!(a.gnss(&truth), b.gnss(&truth));
        let n = 20_000;
        let mut sum = Vector3::zeros();
        let mut sum_sq = 0.0;
        for _ in 0..n {
            let s = a.imu(&ideal, 0.01).angular_rate - levels.gyro_bias;
            sum += s;
            sum_sq += s.norm_squared();
        }
        let expected = levels.gyro_density / 0.1;
        let sigma = (sum_sq / f64::from(3 * n)).sqrt();
        assert!((sigma / expected - 1.0).abs() < 0.02);
        assert!((sum / f64::from(n)).norm() < 5.0 * expected / f64::from(n).sqrt());
    }

    #[test]
    fn a_hovering_imu_feels_gravity_upwards_and_the_earth_turn() {
        let env = Environment::trondheim();
        let imu = env.imu(&Multirotor::square(), 1.0, 1.01);
        assert!((imu.specific_force + env.gravity_ned()).norm() < 1e-12);
        assert!((imu.angular_rate - env.earth_rate_ned).norm() < 1e-15);
        assert_eq!(env.height(&Multirotor::square().at(1.0)), 30.0);
    }
}
