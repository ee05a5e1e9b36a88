//! `[holdover]`, `[tuning.holdover]` and `[tuning.rejoin]`: without GNSS, and the way back.

use crate::config::key::section;
use crate::navigator::settings::BudgetSettings;
use crate::navigator::settings::{HoldoverSettings, RejoinSettings};

section! {
    /// How far navigation without GNSS may go.
    "holdover" struct HoldoverKeys {
        /// Horizontal uncertainty (1 sigma) at which the navigator calls itself lost.
        max_sigma_m: f64 = 100.0 in 1.0 ..= 100_000.0;
        /// Longest time without any velocity: inertial coasting beyond it is lost.
        max_coast_s: f64 = 30.0 in 0.0 ..= 3600.0;
    }
}

section! {
    /// The uncertainty's growth without GNSS.
    "tuning.holdover" struct HoldoverTuning {
        /// Heading error that changes with the heading.
        heading_sigma_deg: f64 = 2.0 in 0.0 ..= 45.0 was "holdover.heading_sigma_deg";
        /// Growth of the heading error without a magnetometer.
        heading_drift_dpm: f64 = 1.0 in 0.0 ..= 600.0 was "holdover.heading_drift_dpm";
        /// Scale error of flow that comes and goes over 100 m of ground, relative.
        scale_wander: f64 = 0.02 in 0.0 ..= 1.0 unit "" was "holdover.scale_wander";
        /// Scale error without a rangefinder, relative.
        height_scale_sigma: f64 = 0.1 in 0.0 ..= 1.0 unit "" was "holdover.height_scale_sigma";
        /// Horizontal velocity error at the start of an outage.
        velocity_sigma_mps: f64 = 0.15 in 0.001 ..= 10.0 was "holdover.velocity_sigma_mps";
        /// Tilt error.
        tilt_sigma_deg: f64 = 0.8 in 0.001 ..= 45.0 was "holdover.tilt_sigma_deg";
        /// Error of the gyro bias.
        gyro_bias_sigma_dpm: f64 = 4.0 in 0.0 ..= 600.0 was "holdover.gyro_bias_sigma_dpm";
    }
}

section! {
    /// The way back to GNSS.
    "tuning.rejoin" struct RejoinTuning {
        /// Speed at which the position glides back to GNSS.
        glide_mps: f64 = 1.0 in 0.01 ..= 100.0 was "rejoin.glide_mps";
        /// A longer way is jumped, and the reset counter says so.
        jump_m: f64 = 30.0 in 0.1 ..= 100_000.0 was "rejoin.jump_m";
    }
}

/// Degrees a minute in radians a second.
fn dpm(v: f64) -> f64 {
    v.to_radians() / 60.0
}

impl HoldoverKeys {
    pub(super) fn settings(&self, tuning: &HoldoverTuning, max_speed_mps: Option<f64>) -> HoldoverSettings {
        HoldoverSettings {
            max_sigma_m: self.max_sigma_m,
            max_coast_s: self.max_coast_s,
            max_speed_mps,
            budget: BudgetSettings {
                heading_sigma_rad: tuning.heading_sigma_deg.to_radians(),
                heading_drift_radps: dpm(tuning.heading_drift_dpm),
                scale_wander: tuning.scale_wander,
                height_scale_sigma: tuning.height_scale_sigma,
                velocity_sigma_mps: tuning.velocity_sigma_mps,
                tilt_sigma_rad: tuning.tilt_sigma_deg.to_radians(),
                gyro_bias_sigma_radps: dpm(tuning.gyro_bias_sigma_dpm),
            },
        }
    }
}

impl RejoinTuning {
    pub(super) fn settings(&self) -> RejoinSettings {
        RejoinSettings { glide_mps: self.glide_mps, jump_m: self.jump_m }
    }
}
