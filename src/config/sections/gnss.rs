//! `[gnss]` and `[tuning.gnss]`: the receiver, and when it is believed.

use crate::config::key::section;
use crate::navigator::settings::GnssSettings;
use crate::navigator::settings::TrustSettings;

section! {
    /// The GNSS receiver.
    "gnss" struct GnssKeys {
        /// Age of a fix beyond its own stamp.
        delay_ms: f64 = 100.0 in 0.0 ..= 500.0;
        /// How well that age is known, 1 sigma; it is estimated in flight unless this is 0.
        delay_sigma_ms: f64 = 60.0 in 0.0 ..= 500.0;
        /// Fewer satellites are no fix.
        min_satellites: u8 = 5 in 0.0 ..= 50.0 unit "";
        /// Worst horizontal accuracy that a receiver may claim.
        max_horizontal_accuracy_m: f64 = 10.0 in 0.1 ..= 1000.0;
    }
}

section! {
    /// When GNSS is lost, jumps, and is trusted again.
    "tuning.gnss" struct GnssTuning {
        /// No good fix for this long is a loss.
        loss_s: f64 = 1.0 in 0.2 ..= 60.0 was "gnss.loss_s";
        /// Good fixes for this long make GNSS trusted.
        recover_s: f64 = 3.0 in 0.2 ..= 600.0 was "gnss.recover_s";
        /// The same when the fixes lie further away than the uncertainty explains.
        recover_far_s: f64 = 120.0 in 0.2 ..= 3600.0 was "gnss.recover_far_s";
        /// Innovations beyond this many sigmas are a jump.
        gate_sigma: f64 = 5.0 in 2.0 ..= 100.0 unit "" was "gnss.gate_sigma";
        /// No deviation below this is a jump of the position.
        min_position_gate_m: f64 = 5.0 in 0.1 ..= 1000.0 was "gnss.min_position_gate_m";
        /// No deviation below this is a jump of the velocity.
        min_velocity_gate_mps: f64 = 3.0 in 0.1 ..= 100.0 was "gnss.min_velocity_gate_mps";
        /// Horizontal noise of a fix that claims no accuracy.
        default_accuracy_m: f64 = 1.5 in 0.01 ..= 100.0 was "gnss.default_accuracy_m";
    }
}

impl GnssKeys {
    pub(super) fn settings(&self, tuning: &GnssTuning) -> GnssSettings {
        GnssSettings {
            delay_s: self.delay_ms * 1e-3,
            delay_sigma_s: self.delay_sigma_ms * 1e-3,
            default_accuracy_m: tuning.default_accuracy_m,
            trust: TrustSettings {
                loss_s: tuning.loss_s,
                recover_s: tuning.recover_s,
                recover_far_s: tuning.recover_far_s,
                min_satellites: self.min_satellites,
                max_horizontal_accuracy_m: self.max_horizontal_accuracy_m,
                gate_sigma: tuning.gate_sigma,
                min_position_gate_m: tuning.min_position_gate_m,
                min_velocity_gate_mps: tuning.min_velocity_gate_mps,
            },
        }
    }
}
