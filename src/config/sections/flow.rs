//! `[flow]` and `[tuning.flow]`: optical flow.

use crate::camera::{CalibrationSettings, MAX_PATCHES, PatchCentre, PatchLimits, PatchTable};
use crate::config::key::{Key, TableRow, section};
use crate::geo::CameraMount;
use crate::navigator::settings::FlowSettings;

use super::cameras::CameraKeys;

section! {
    /// Optical flow.
    "flow" struct FlowKeys {
        /// Use optical flow.
        r#use: bool = true;
        /// The component of the camera in [[cameras]] that the flow comes from; without a camera of component 0, 0 looks down from the IMU.
        camera: u8 = 0 in 0.0 ..= 255.0 unit "";
        /// Age of a flow sample beyond its own stamp.
        delay_ms: f64 = 0.0 in 0.0 ..= 500.0;
        /// How well that age is known, 1 sigma; unless this is 0 it is estimated in flight, against GNSS.
        delay_sigma_ms: f64 = 60.0 in 0.0 ..= 300.0;
        /// Largest tilt at which the ground is seen.
        max_tilt_deg: f64 = 50.0 in 5.0 ..= 80.0;
        /// Least height over ground.
        min_height_m: f64 = 0.3 in 0.0 ..= 100.0;
        /// Greatest distance to the ground.
        max_height_m: f64 = 300.0 in 1.0 ..= 10_000.0;
        /// Sensor ids that are patches of one image, and where their centres lie. Those stamped alike are solved together; other ids are sensors of their own, centred.
        patches: Vec<PatchKeys> = [] was "flow.patches_deg";
    }
}

section! {
    /// A patch of an image.
    "flow.patches" struct PatchKeys {
        /// The sensor id of its messages.
        id: u8 = required in 0.0 ..= 255.0 unit "";
        /// Its centre: angle from the optical axis to the right in the image …
        right_deg: f64 = required in -70.0 ..= 70.0;
        /// … and forward, which is up in the image.
        forward_deg: f64 = required in -70.0 ..= 70.0;
    }
}

impl TableRow for PatchKeys {
    const KEYS: &'static [Key] = Self::SECTION.keys;
}

section! {
    /// Noise and calibration of optical flow.
    "tuning.flow" struct FlowTuning {
        /// Worst quality, 0 to 1, that is used.
        min_quality: f64 = 0.1 in 0.0 ..= 1.0 unit "" was "flow.min_quality";
        /// Noise of the flow rate of one sample.
        rate_noise_radps: f64 = 0.04 in 0.0001 ..= 10.0 was "flow.rate_noise_radps";
        /// Bias, a rate of the image, before it is compared with GNSS, 1 sigma.
        bias_sigma_radps: f64 = 0.0005 in 0.00001 ..= 1.0 was "flow.bias_sigma_mps", "tuning.flow.bias_sigma_mps";
        /// Scale error before it is compared with GNSS, 1 sigma.
        scale_sigma: f64 = 0.1 in 0.001 ..= 1.0 unit "" was "flow.scale_sigma";
        /// Misalignment and heading error together before it is compared with GNSS, 1 sigma.
        misalignment_sigma_deg: f64 = 5.0 in 0.01 ..= 90.0 was "flow.misalignment_sigma_deg";
        /// How fast the bias may change.
        bias_walk_radps: f64 = 0.00002 in 0.0 ..= 0.1 unit "rad/s/√s" was "flow.bias_walk", "tuning.flow.bias_walk";
        /// How fast scale and misalignment may change.
        scale_walk: f64 = 0.0003 in 0.0 ..= 1.0 unit "1/√s" was "flow.scale_walk";
        /// A larger scale error is no working sensor.
        max_scale_error: f64 = 0.4 in 0.01 ..= 2.0 unit "" was "flow.max_scale_error";
        /// A larger bias is no working sensor.
        max_bias_radps: f64 = 0.1 in 0.001 ..= 5.0 was "flow.max_bias_mps", "tuning.flow.max_bias_mps";
    }
}

impl FlowKeys {
    pub(super) fn settings(
        &self,
        tuning: &FlowTuning,
        cameras: &[CameraKeys],
        complain: &mut impl FnMut(&str, String),
    ) -> FlowSettings {
        FlowSettings {
            enabled: self.r#use,
            delay_s: self.delay_ms * 1e-3,
            delay_sigma_s: self.delay_sigma_ms * 1e-3,
            rate_noise_radps: tuning.rate_noise_radps,
            limits: PatchLimits {
                max_tilt_rad: self.max_tilt_deg.to_radians(),
                min_distance_m: self.min_height_m,
                max_distance_m: self.max_height_m,
                min_quality: tuning.min_quality,
                min_integration_s: 1e-3,
                max_integration_s: 0.5,
            },
            mount: self.mount(cameras, complain),
            patches: self.patch_table(complain),
            calibration: CalibrationSettings {
                bias_sigma_radps: tuning.bias_sigma_radps,
                scale_sigma: tuning.scale_sigma,
                misalignment_sigma_rad: tuning.misalignment_sigma_deg.to_radians(),
                bias_walk: tuning.bias_walk_radps,
                scale_walk: tuning.scale_walk,
                max_scale_error: tuning.max_scale_error,
                max_bias_radps: tuning.max_bias_radps,
            },
        }
    }

    fn mount(&self, cameras: &[CameraKeys], complain: &mut impl FnMut(&str, String)) -> CameraMount {
        if let Some(camera) = cameras.iter().find(|c| c.component == self.camera) {
            return camera.mount();
        }
        if self.camera != 0 {
            complain("flow.camera", format!("is {}, but no [[cameras]] has that component", self.camera));
        }
        CameraMount::downward()
    }

    fn patch_table(&self, complain: &mut impl FnMut(&str, String)) -> PatchTable {
        let mut table = PatchTable::default();
        for p in &self.patches {
            let (right, forward) = (p.right_deg.to_radians(), p.forward_deg.to_radians());
            if !table.add(PatchCentre::from_angles(p.id, right, forward)) {
                complain(
                    "flow.patches",
                    format!("has id {} twice, or more than {MAX_PATCHES} patches", p.id),
                );
            }
        }
        table
    }
}
