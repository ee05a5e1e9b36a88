//! `[tuning.height]` and `[tuning.range]`: the altimeter and the rangefinder.

use crate::altimeter::{AltimeterSettings, ChannelSettings, DetectionSettings, InertialModel, OffsetModel};
use crate::config::key::section;
use crate::navigator::settings::HeightSettings;

use super::navigator::AltimeterName;

section! {
    /// The altimeter.
    "tuning.height" struct HeightTuning {
        /// Noise density of the vertical acceleration.
        accel_noise: f64 = 0.3 in 0.0001 ..= 100.0 unit "m/s²/√Hz" was "height.accel_noise";
        /// So much more noise density for every m/s² of acceleration, at most (the barometer's innovations tell how much of it there is): a wrong attitude shows in manoeuvres.
        accel_load_noise: f64 = 1.0 in 0.0 ..= 10.0 unit "1/√Hz" was "height.accel_load_noise";
        /// Random walk of the vertical acceleration's bias.
        accel_bias_walk: f64 = 0.003 in 0.0 ..= 10.0 unit "m/s³/√Hz" was "height.accel_bias_walk";
        /// Noise of one barometer sample.
        baro_noise_m: f64 = 0.4 in 0.01 ..= 100.0 was "height.baro_noise_m";
        /// Random walk of the barometer's offset (weather, temperature).
        baro_offset_walk: f64 = 0.03 in 0.0 ..= 10.0 unit "m/√s" was "height.baro_offset_walk";
        /// Least noise of a GNSS height.
        gnss_noise_m: f64 = 1.5 in 0.01 ..= 100.0 was "height.gnss_noise_m";
        /// What a GNSS height is off by for minutes, 1 sigma …
        gnss_wander_m: f64 = 1.5 in 0.0 ..= 100.0 was "height.gnss_wander_m";
        /// … and for how long.
        gnss_wander_s: f64 = 60.0 in 1.0 ..= 100_000.0 was "height.gnss_wander_s";
        /// Below this height over ground the rangefinder is a source of heights.
        range_below_m: f64 = 8.0 in 0.0 ..= 1000.0 was "height.range_below_m";
        /// Noise of the rangefinder's distance as a height.
        range_noise_m: f64 = 0.2 in 0.001 ..= 10.0 was "height.range_noise_m";
        /// How much the ground under a vehicle that moves changes.
        ground_walk: f64 = 0.5 in 0.0 ..= 100.0 unit "m/√s" was "height.ground_walk";
        /// Below this height over ground the rotors' air disturbs the barometer …
        ground_effect_below_m: f64 = 2.5 in 0.0 ..= 100.0 was "height.ground_effect_below_m";
        /// … whose offset then walks by this much.
        ground_effect_walk: f64 = 0.7 in 0.0 ..= 100.0 unit "m/√s" was "height.ground_effect_walk";
        /// Log-likelihood ratio at which a source of heights is declared faulty.
        fault_evidence: f64 = 100.0 in 5.0 ..= 10_000.0 unit "" was "height.fault_evidence";
        /// For how long back the beginning of a fault is sought.
        fault_window_s: f64 = 20.0 in 1.0 ..= 600.0 was "height.fault_window_s";
        /// Size that faults have, 1 sigma: how near to zero one has to be to be over.
        fault_size_m: f64 = 30.0 in 0.1 ..= 1000.0 was "height.fault_size_m";
        /// Size of an error of the inertial climb rate that is held possible, 1 sigma.
        climb_jump_mps: f64 = 1.0 in 0.0 ..= 100.0 was "height.climb_jump_mps";
        /// Speed at which the published height glides to a corrected one.
        glide_mps: f64 = 0.5 in 0.01 ..= 100.0 was "height.glide_mps";
        /// A longer way is jumped, and the reset counter says so.
        jump_m: f64 = 30.0 in 0.1 ..= 100_000.0 was "height.jump_m";
    }
}

section! {
    /// The rangefinder.
    "tuning.range" struct RangeTuning {
        /// Rangefinder samples are used for this long.
        max_age_s: f64 = 0.5 in 0.05 ..= 10.0 was "range.max_age_s";
    }
}

impl HeightTuning {
    pub(super) fn settings(&self, altimeter: AltimeterName) -> HeightSettings {
        HeightSettings {
            kind: altimeter.into(),
            altimeter: AltimeterSettings {
                inertial: InertialModel {
                    accel_noise: self.accel_noise,
                    accel_bias_sigma: 0.2,
                    accel_bias_walk: self.accel_bias_walk,
                    accel_bias_rate: 0.0,
                    start_sigma: [100.0, 2.0],
                    gravity_gradient: 0.0,
                },
                channels: self.channels(),
                least_prob: 0.02,
                detection: DetectionSettings {
                    climb_jump_mps: self.climb_jump_mps,
                    bias_m: self.fault_size_m,
                    ..DetectionSettings::recorded(self.fault_evidence, self.fault_window_s)
                },
            },
            accel_load_noise: self.accel_load_noise,
            range_below_m: self.range_below_m,
            ground_effect_below_m: self.ground_effect_below_m,
            ground_effect_walk: self.ground_effect_walk,
            ground_walk: self.ground_walk,
            glide_mps: self.glide_mps,
            jump_m: self.jump_m,
        }
    }

    fn channels(&self) -> [ChannelSettings; 4] {
        // Of a barometer's offset, of the ground and of a climb rate nothing is known at first.
        const UNKNOWN_M: f64 = 1e4;
        let walking = |noise_m, walk| ChannelSettings {
            noise_m,
            offset: OffsetModel { sigma_m: UNKNOWN_M, walk, rate: 0.0 },
        };
        let rate = 1.0 / self.gnss_wander_s;
        let gnss = ChannelSettings {
            noise_m: self.gnss_noise_m,
            offset: OffsetModel {
                sigma_m: self.gnss_wander_m,
                walk: self.gnss_wander_m * (2.0 * rate).sqrt(),
                rate,
            },
        };
        let baro = walking(self.baro_noise_m, self.baro_offset_walk);
        // The ground walks as the vehicle moves over it: that is the navigator's to say.
        [baro, gnss, baro, walking(self.range_noise_m, 0.0)]
    }
}
