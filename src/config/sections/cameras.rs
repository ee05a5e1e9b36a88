//! `[[cameras]]`: where the cameras sit. One camera, told of once, serves optical flow and landmarks alike.

use nalgebra::Vector3;

use crate::config::key::{Key, Preset, Section, TableRow, Type, section};
use crate::geo::{Body, CameraMount, Euler};
use crate::landmark::LandmarkCamera;
use crate::navigator::sources::landmarks::ComponentCamera;

section! {
    /// A camera.
    "cameras" struct CameraKeys {
        /// The component that tells of what it sees; 0 stands for every component that no other camera names.
        component: u8 = 0 in 0.0 ..= 255.0 unit "";
        /// Mounting: the rotation from body to camera axes as roll, pitch and yaw. 0, 0, 0 looks down, the top of the image is forward; roll …
        roll_deg: f64 = 0.0 in -180.0 ..= 180.0 was "flow.mount_roll_deg";
        /// … pitch: 90 looks forward …
        pitch_deg: f64 = 0.0 in -180.0 ..= 180.0 was "flow.mount_pitch_deg";
        /// … and yaw.
        yaw_deg: f64 = 0.0 in -180.0 ..= 180.0 was "flow.mount_yaw_deg";
        /// Place from the IMU, body axes: forward …
        x_m: f64 = 0.0 in -100.0 ..= 100.0 was "flow.lever_arm_x_m";
        /// … right …
        y_m: f64 = 0.0 in -100.0 ..= 100.0 was "flow.lever_arm_y_m";
        /// … and down.
        z_m: f64 = 0.0 in -100.0 ..= 100.0 was "flow.lever_arm_z_m";
        /// Half of the field of view to the sides of the image; a sighting outside is none.
        half_x_deg: f64 = 60.0 in 1.0 ..= 89.0;
        /// Half of the field of view up and down in the image.
        half_y_deg: f64 = 60.0 in 1.0 ..= 89.0;
        /// Age of a sighting of a landmark beyond its own stamp (the age of flow is flow.delay_ms).
        delay_ms: f64 = 0.0 in 0.0 ..= 1000.0;
    }
}

impl TableRow for CameraKeys {
    const KEYS: &'static [Key] = Self::SECTION.keys;
}

/// The list of cameras stands outside all sections.
pub(in crate::config) const SECTION: Section = Section {
    path: "",
    text: "Cameras, which see the ground (optical flow) and landmarks.",
    keys: &[Key {
        field: "cameras",
        kind: Type::Tables(CameraKeys::KEYS),
        range: None,
        choices: &[],
        own_unit: None,
        preset: Preset::Toml("[{}]"),
        text: "The cameras, one table each; what is left out is as here. A file with one of them tells of all.",
        was: &["landmarks.cameras"],
    }],
};

impl CameraKeys {
    /// How it is mounted.
    pub(super) fn mount(&self) -> CameraMount {
        let mounting = Euler {
            roll_rad: self.roll_deg.to_radians(),
            pitch_rad: self.pitch_deg.to_radians(),
            yaw_rad: self.yaw_deg.to_radians(),
        };
        CameraMount::turned(mounting, Body::new(Vector3::new(self.x_m, self.y_m, self.z_m)))
    }

    /// As landmarks have it.
    pub(super) fn landmark_camera(&self) -> ComponentCamera {
        ComponentCamera {
            component: self.component,
            camera: LandmarkCamera {
                mount: self.mount(),
                half_field_of_view_rad: [self.half_x_deg, self.half_y_deg].map(f64::to_radians),
            },
            delay_s: self.delay_ms * 1e-3,
        }
    }
}

/// Two cameras that one component tells of cannot be told apart.
pub(super) fn check(cameras: &[CameraKeys], complain: &mut impl FnMut(&str, String)) {
    for (i, c) in cameras.iter().enumerate() {
        if cameras.iter().take(i).any(|other| other.component == c.component) {
            complain("cameras", format!("has component {} twice", c.component));
        }
    }
}
