//! `[airspeed]`, `[drag]` and their tuning: velocity through the air.

use crate::config::key::section;
use crate::navigator::settings::AirSettings;
use crate::navigator::settings::DragSettings;

section! {
    /// The airspeed of a fixed wing.
    "airspeed" struct AirspeedKeys {
        /// Use the airspeed of a fixed wing with a pitot tube, which carries the velocity where there is no flow.
        r#use: bool = true;
    }
}

section! {
    /// The drag of a multirotor's rotors.
    "drag" struct DragKeys {
        /// Use the drag of a multirotor's rotors, which shows in the accelerometers and tells the velocity through the air.
        r#use: bool = true;
    }
}

section! {
    /// Airspeed and sideslip.
    "tuning.airspeed" struct AirspeedTuning {
        /// Below this airspeed it is not used.
        min_mps: f64 = 7.0 in 3.0 ..= 100.0 was "airspeed.min_mps";
        /// Noise with gusts, for a sample every 0.2 s, 1 sigma.
        sigma_mps: f64 = 2.0 in 0.05 ..= 20.0 was "airspeed.sigma_mps";
        /// How far from the front the air may come on a fixed wing, 1 sigma; 0 does not use that.
        sideslip_sigma_deg: f64 = 6.0 in 0.0 ..= 45.0 was "airspeed.sideslip_sigma_deg";
    }
}

section! {
    /// Rotor drag.
    "tuning.drag" struct DragTuning {
        /// White noise of the mean force of 0.1 s, 1 sigma.
        sigma_mps2: f64 = 0.3 in 0.01 ..= 20.0 was "drag.sigma_mps2";
        /// What is wrong with the force for some seconds (gusts, vibration, drag that is not proportional) before it was measured in flight, 1 sigma.
        lasting_mps2: f64 = 0.15 in 0.0 ..= 20.0 was "drag.lasting_mps2";
        /// Deceleration over velocity before it was seen.
        coefficient_per_s: f64 = 0.25 in 0.0 ..= 5.0 was "drag.coefficient_per_s";
        /// How well that is known, 1 sigma.
        coefficient_sigma_per_s: f64 = 0.15 in 0.0 ..= 5.0 was "drag.coefficient_sigma_per_s";
    }
}

impl AirspeedKeys {
    pub(super) fn settings(&self, tuning: &AirspeedTuning) -> AirSettings {
        AirSettings {
            enabled: self.r#use,
            min_mps: tuning.min_mps,
            sigma_mps: tuning.sigma_mps,
            sideslip_sigma_rad: tuning.sideslip_sigma_deg.to_radians(),
        }
    }
}

impl DragKeys {
    pub(super) fn settings(&self, tuning: &DragTuning) -> DragSettings {
        DragSettings {
            enabled: self.r#use,
            coefficient: tuning.coefficient_per_s,
            sigma_mps2: tuning.sigma_mps2,
            lasting_mps2: tuning.lasting_mps2,
        }
    }
}
