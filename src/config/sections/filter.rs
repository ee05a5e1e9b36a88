//! `[tuning.filter]`: the error-state filter.

use crate::config::key::section;
use crate::filter::error_state::{AirModel, EskfSettings};

section! {
    /// The error-state filter.
    "tuning.filter" struct FilterTuning {
        /// Gyro noise density; covers vibration and the sampling of the stream too.
        gyro_noise: f64 = 0.001 in 0.000001 ..= 1.0 unit "rad/s/√Hz" was "kalman.gyro_noise";
        /// Accelerometer noise density.
        accel_noise: f64 = 0.03 in 0.00001 ..= 10.0 unit "m/s²/√Hz" was "kalman.accel_noise";
        /// Gyro noise that comes with rotation: density over angular rate.
        gyro_rate_noise: f64 = 0.005 in 0.0 ..= 1.0 unit "√s" was "kalman.gyro_rate_noise";
        /// Accelerometer noise that comes with manoeuvres: density over the specific force beyond gravity's.
        accel_load_noise: f64 = 0.01 in 0.0 ..= 1.0 unit "√s" was "kalman.accel_load_noise";
        /// Random walk of the gyro bias.
        gyro_bias_walk: f64 = 0.0001 in 0.0 ..= 1.0 unit "rad/s/√s" was "kalman.gyro_bias_walk";
        /// Random walk of the accelerometer bias.
        accel_bias_walk: f64 = 0.001 in 0.0 ..= 1.0 unit "m/s²/√s" was "kalman.accel_bias_walk";
        /// Magnetometer bias at the start, 1 sigma.
        magnetic_bias_sigma_ut: f64 = 3.0 in 0.0 ..= 100.0 was "kalman.magnetic_bias_sigma_ut";
        /// Random walk of the magnetometer bias.
        magnetic_bias_walk_ut: f64 = 0.02 in 0.0 ..= 10.0 unit "µT/√s" was "kalman.magnetic_bias_walk_ut";
        /// Scale errors of the gyros, 1 sigma.
        gyro_scale_sigma: f64 = 0.002 in 0.0 ..= 0.1 unit "" was "kalman.gyro_scale_sigma";
        /// Wind before it was seen, 1 sigma per axis.
        wind_sigma_mps: f64 = 6.0 in 0.0 ..= 50.0 was "kalman.wind_sigma_mps";
        /// Random walk of the wind.
        wind_walk: f64 = 0.02 in 0.0 ..= 5.0 unit "m/s/√s" was "kalman.wind_walk";
        /// Scale error of the airspeed, 1 sigma.
        airspeed_scale_sigma: f64 = 0.05 in 0.0 ..= 1.0 unit "" was "kalman.airspeed_scale_sigma";
        /// Random walk of the flow's bias.
        flow_bias_walk_radps: f64 = 0.00002 in 0.0 ..= 0.1 unit "rad/s/√s" was "kalman.flow_bias_walk", "tuning.filter.flow_bias_walk";
        /// Random walk of the flow's scale and misalignment.
        flow_scale_walk: f64 = 0.0002 in 0.0 ..= 1.0 unit "1/√s" was "kalman.flow_scale_walk";
        /// Innovations beyond this many sigmas are rejected.
        gate_sigma: f64 = 5.0 in 2.0 ..= 100.0 unit "" was "kalman.gate_sigma";
    }
}

impl FilterTuning {
    pub(super) fn settings(&self, drag_sigma: f64) -> EskfSettings {
        EskfSettings {
            gyro_noise: self.gyro_noise,
            accel_noise: self.accel_noise,
            gyro_rate_noise: self.gyro_rate_noise,
            accel_load_noise: self.accel_load_noise,
            gyro_bias_walk: self.gyro_bias_walk,
            accel_bias_walk: self.accel_bias_walk,
            magnetic_bias_sigma: self.magnetic_bias_sigma_ut * 1e-6,
            magnetic_bias_walk: self.magnetic_bias_walk_ut * 1e-6,
            gyro_scale_sigma: self.gyro_scale_sigma,
            air: AirModel {
                wind_sigma: self.wind_sigma_mps,
                wind_walk: self.wind_walk,
                airspeed_scale_sigma: self.airspeed_scale_sigma,
                drag_sigma,
            },
            flow_bias_walk: self.flow_bias_walk_radps,
            flow_scale_walk: self.flow_scale_walk,
            gate_sigma: self.gate_sigma,
        }
    }
}
