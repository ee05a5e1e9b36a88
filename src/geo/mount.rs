//! How a camera is mounted: the one convention for optical flow and for landmarks.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::frame::{Body, CameraToBody};
use super::so3::Euler;

/// Where and how a camera sits.
///
/// - Camera axes: x to the top of the image, y to its right, z along the optical axis (as MAVLink's flow sensors have them).
/// - Direction: the rotation maps camera components to body components; its columns are the camera's axes seen from the body.
/// - The identity looks down with the top of the image forward, so that roll, pitch and yaw of a mounting turn from there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraMount {
    /// From camera to body axes.
    pub camera_to_body: CameraToBody,
    /// Position of the camera from the body's origin (the IMU), m.
    pub lever_arm: Body<Vector3<f64>>,
}

impl CameraMount {
    /// Looking down from the body's origin, the top of the image forward.
    pub fn downward() -> Self {
        Self {
            camera_to_body: CameraToBody::new(Rotation3::identity()),
            lever_arm: Body::new(Vector3::zeros()),
        }
    }

    /// A camera that looked down with the top of its image forward and was then turned with respect to the body by these angles, as a body
    /// is turned from north, level; its position from the body's origin, m.
    pub fn turned(mounting: Euler, lever_arm: Body<Vector3<f64>>) -> Self {
        Self { camera_to_body: CameraToBody::from_matrix(&mounting.to_rotation()), lever_arm }
    }

    /// The optical axis.
    pub fn axis(&self) -> Body<Vector3<f64>> {
        Body::new(self.camera_to_body.matrix().column(2).into_owned())
    }

    /// Cosine of the angle between the optical axis and straight down.
    pub fn cos_tilt(&self, r_body_to_ned: &Matrix3<f64>) -> f64 {
        (r_body_to_ned * self.axis().raw()).z
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::frame::Camera;

    #[test]
    fn pitched_up_by_a_quarter_a_camera_looks_forward_with_its_image_upright() {
        let forward =
            CameraMount::turned(Euler::new(0.0, 90f64.to_radians(), 0.0), CameraMount::downward().lever_arm);
        assert!((forward.axis().raw() - Vector3::x()).norm() < 1e-12);
        let right = forward.camera_to_body.to_body(Camera::new(Vector3::y())).raw();
        let top = forward.camera_to_body.to_body(Camera::new(Vector3::x())).raw();
        assert!((right - Vector3::y()).norm() < 1e-12 && (top + Vector3::z()).norm() < 1e-12);
        assert!(forward.cos_tilt(&Matrix3::identity()).abs() < 1e-12);
        assert_eq!(CameraMount::downward().cos_tilt(&Matrix3::identity()), 1.0);
    }
}
