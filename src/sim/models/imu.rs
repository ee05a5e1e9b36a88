//! Gyros and accelerometers.

use crate::sim::noise::{GaussMarkov, SensorRng, Stream};
use crate::sim::trajectory::{Trajectory, Truth};
use crate::sim::world::{Environment, ImuMean};
use nalgebra::Vector3;

/// Errors of an IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuModel {
    /// Time between samples, s.
    pub period_s: f64,
    /// Gyro noise density, rad/s/√Hz.
    pub gyro_density: f64,
    /// Accelerometer noise density, m/s²/√Hz.
    pub accel_density: f64,
    /// Constant gyro bias, size an axis, rad/s.
    pub gyro_bias: Vector3<f64>,
    /// Constant accelerometer bias, size an axis, m/s².
    pub accel_bias: Vector3<f64>,
    /// Bias instability of a gyro: wander on top of the constant, rad/s.
    pub gyro_wander: GaussMarkov,
    /// Bias instability of an accelerometer, m/s².
    pub accel_wander: GaussMarkov,
    /// Scale error of a gyro, size.
    pub gyro_scale: f64,
}

impl ImuModel {
    /// No errors, 100 Hz.
    pub fn ideal() -> Self {
        Self {
            period_s: 0.01,
            gyro_density: 0.0,
            accel_density: 0.0,
            gyro_bias: Vector3::zeros(),
            accel_bias: Vector3::zeros(),
            gyro_wander: GaussMarkov::NONE,
            accel_wander: GaussMarkov::NONE,
            gyro_scale: 0.0,
        }
    }

    /// Tactical grade: 0.003 °/s/√Hz, biases of 0.02-0.05 °/s and 0.02 m/s², wandering by 1 °/h and 10⁻³ m/s², 300 ppm.
    pub fn tactical() -> Self {
        Self {
            gyro_density: 0.003f64.to_radians(),
            accel_density: 2e-3,
            gyro_bias: Vector3::new(0.03, 0.02, 0.05).map(f64::to_radians),
            accel_bias: Vector3::new(0.02, 0.01, 0.02),
            gyro_wander: GaussMarkov { sigma: (1.0f64 / 3600.0).to_radians(), correlation: 500.0 },
            accel_wander: GaussMarkov { sigma: 1e-3, correlation: 500.0 },
            gyro_scale: 3e-4,
            ..Self::ideal()
        }
    }

    /// MEMS: 0.01 °/s/√Hz, biases of 0.3-0.8 °/s and 0.05 m/s², wandering by 6 °/h and 3·10⁻³ m/s², 0.2 % of scale. With the biases
    /// known when GNSS goes, ten minutes of coasting end 71 % of the way off straight on and 23 % in circles (the tactical grade:
    /// 14 % and 7 %; medians of 20 seeds).
    pub fn mems() -> Self {
        Self {
            gyro_density: 0.01f64.to_radians(),
            accel_density: 3e-3,
            gyro_bias: Vector3::new(0.5, 0.3, 0.8).map(f64::to_radians),
            accel_bias: Vector3::new(0.05, 0.04, 0.05),
            gyro_wander: GaussMarkov { sigma: (6.0f64 / 3600.0).to_radians(), correlation: 300.0 },
            accel_wander: GaussMarkov { sigma: 3e-3, correlation: 300.0 },
            gyro_scale: 2e-3,
            ..Self::ideal()
        }
    }
}

/// What the IMU said, and what it should have said.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuReading {
    /// With errors.
    pub measured: ImuMean,
    /// Without.
    pub ideal: ImuMean,
    /// The gyro bias in it, rad/s, body (constant and wander; scale and noise come on top).
    pub gyro_bias: Vector3<f64>,
    /// The accelerometer bias in it, m/s², body.
    pub accel_bias: Vector3<f64>,
    /// The scale error of the gyros in it, an axis.
    pub gyro_scale: Vector3<f64>,
}

/// An IMU in flight.
#[derive(Clone, Debug)]
pub(in crate::sim) struct Imu {
    model: ImuModel,
    rng: SensorRng,
    constant: [Vector3<f64>; 2],
    wander: [Vector3<f64>; 2],
    scale: Vector3<f64>,
}

impl Imu {
    pub(in crate::sim) fn new(model: ImuModel, seed: u64) -> Self {
        let mut rng = SensorRng::new(seed, Stream::Imu);
        let constant = [rng.signed3(&model.gyro_bias), rng.signed3(&model.accel_bias)];
        let scale = rng.signed3(&Vector3::repeat(model.gyro_scale));
        // The wander begins at zero: where it is when the flight begins is part of the constant.
        Self { model, rng, constant, wander: [Vector3::zeros(); 2], scale }
    }

    /// The sample of the interval that ends now; `truth` is the state now.
    pub(in crate::sim) fn sample(
        &mut self,
        environment: &Environment,
        trajectory: &dyn Trajectory,
        from_s: f64,
        truth: &Truth,
    ) -> ImuReading {
        let m = self.model;
        let dt = truth.t_s - from_s;
        let ideal = environment.imu(trajectory, from_s, truth.t_s);
        for (wander, process) in self.wander.iter_mut().zip([m.gyro_wander, m.accel_wander]) {
            *wander = process.next3(wander, dt, &self.rng.normals());
        }
        let [gyro_bias, accel_bias] = [0, 1].map(|i: usize| self.constant[i] + self.wander[i]);
        let root = dt.sqrt();
        let gyro_noise = self.rng.normals() * (m.gyro_density / root);
        let accel_noise = self.rng.normals() * (m.accel_density / root);
        let scaled = ideal.angular_rate + self.scale.component_mul(&ideal.angular_rate);
        let measured = ImuMean {
            angular_rate: scaled + gyro_bias + gyro_noise,
            specific_force: ideal.specific_force + accel_bias + accel_noise,
        };
        ImuReading { measured, ideal, gyro_bias, accel_bias, gyro_scale: self.scale }
    }
}
