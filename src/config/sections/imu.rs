//! `[tuning.imu]`, `[magnetometer]` and `[tuning.magnetometer]`: the sensors of attitude and heading.

use serde::Deserialize;

use crate::config::key::{Type, Typed, section};

section! {
    /// Heading by the magnetic field.
    "magnetometer" struct MagnetometerKeys {
        /// Use the magnetometer for heading.
        r#use: bool = true;
    }
}

section! {
    /// The IMU stream.
    "tuning.imu" struct ImuTuning {
        /// A hole in the IMU stream longer than this is carried over with the doubt that it leaves.
        max_gap_ms: f64 = 500.0 in 20.0 ..= 5000.0 was "imu.max_gap_ms";
        /// Up to this what was felt at a hole's ends carries over it, and it is no silence of GNSS; beyond, the last velocity does, and the attitude is found anew.
        bridge_ms: f64 = 1500.0 in 0.0 ..= 5000.0 was "imu.bridge_ms";
        /// What a sample is: the value of its instant, as autopilots stream it, or the mean over the interval before it.
        samples: ImuSamples = "instants" of "instants" | "means" was "imu.samples";
    }
}

section! {
    /// The magnetometer.
    "tuning.magnetometer" struct MagnetometerTuning {
        /// Largest relative deviation of the field's strength from the World Magnetic Model.
        max_norm_error: f64 = 0.4 in 0.01 ..= 2.0 unit "" was "magnetometer.max_norm_error";
        /// Noise of a magnetometer axis, 1 sigma, with what the World Magnetic Model does not know.
        noise_ut: f64 = 2.5 in 0.01 ..= 100.0 was "magnetometer.noise_ut";
    }
}

/// What an IMU sample is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(in crate::config) enum ImuSamples {
    Instants,
    Means,
}

impl Typed for ImuSamples {
    const TYPE: Type = Type::Text;
}
