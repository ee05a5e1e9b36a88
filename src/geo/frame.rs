//! Frames as types: components in one frame cannot be taken for those in another.
//!
//! They stand where parts of the program meet (samples, references, solutions, messages, mounts). Inside the mathematics the vectors are
//! nalgebra's, with the frame in the name (`v_ned`); [`raw`](Body::raw) is the way there.
//!
//! ```
//! use holdover::geo::{Body, BodyToNed, Euler, Ned};
//! use nalgebra::Vector3;
//!
//! let heading_east = BodyToNed::from_matrix(&Euler::new(0.0, 0.0, 90f64.to_radians()).to_rotation());
//! let forward: Body<_> = Body::new(Vector3::new(10.0, 0.0, 0.0));
//! let wind: Ned<_> = Ned::new(Vector3::new(0.0, 2.0, 0.0));
//! let over_ground = heading_east.to_ned(forward) + wind;
//! assert!((over_ground.raw() - Vector3::new(0.0, 12.0, 0.0)).norm() < 1e-12);
//! ```
//!
//! The same without the rotation does not compile:
//!
//! ```compile_fail
//! # use holdover::geo::{Body, Ned};
//! # use nalgebra::Vector3;
//! let forward: Body<_> = Body::new(Vector3::new(10.0, 0.0, 0.0));
//! let wind: Ned<_> = Ned::new(Vector3::new(0.0, 2.0, 0.0));
//! let over_ground = forward + wind;
//! ```
//!
//! Nor does a rotation that is applied the wrong way round:
//!
//! ```compile_fail
//! # use holdover::geo::{Body, BodyToNed};
//! # use nalgebra::{Rotation3, Vector3};
//! let level = BodyToNed::new(Rotation3::identity());
//! let velocity = level.to_body(Body::new(Vector3::new(10.0, 0.0, 0.0)));
//! ```
//!
//! They do not protect from another origin (two NED frames are one type), from another unit, or from a position taken for a velocity.

use std::ops::{Add, Mul, Sub};

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::so3::hat;

macro_rules! frame {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        #[repr(transparent)]
        pub struct $name<T>(T);

        impl<T: Copy> $name<T> {
            /// These components are in this frame.
            pub const fn new(raw: T) -> Self {
                Self(raw)
            }

            /// The components alone: from here on only names tell their frame.
            pub const fn raw(self) -> T {
                self.0
            }
        }

        impl<T: Add<Output = T>> Add for $name<T> {
            type Output = Self;
            fn add(self, other: Self) -> Self {
                Self(self.0 + other.0)
            }
        }

        impl<T: Sub<Output = T>> Sub for $name<T> {
            type Output = Self;
            fn sub(self, other: Self) -> Self {
                Self(self.0 - other.0)
            }
        }

        impl<T: Mul<f64, Output = T>> Mul<f64> for $name<T> {
            type Output = Self;
            fn mul(self, factor: f64) -> Self {
                Self(self.0 * factor)
            }
        }
    };
}

frame! {
    /// Components in the local frame.
    ///
    /// - x: true north at the origin,
    /// - y: east,
    /// - z: down.
    Ned
}

frame! {
    /// Components in the vehicle's frame (FRD), whose origin is the IMU.
    ///
    /// - x: forward,
    /// - y: to the right,
    /// - z: down, as the vehicle sits.
    Body
}

frame! {
    /// Components in a camera's frame. A camera that looks down with the top of its image forward has the body's axes.
    ///
    /// - x: to the top of the image,
    /// - y: to the right of the image,
    /// - z: along the optical axis.
    Camera
}

impl Camera<Vector3<f64>> {
    /// The ray, of length 1 along the optical axis, that meets the image plane at these coordinates over the focal length: to the right of
    /// the centre and down from it.
    pub const fn ray(right: f64, down: f64) -> Self {
        Self(Vector3::new(-down, right, 1.0))
    }

    /// The components along the image's right, along its down, and along the optical axis.
    pub fn right_down_along(self) -> [f64; 3] {
        [self.0.y, -self.0.x, self.0.z]
    }
}

macro_rules! rotation {
    ($(#[$doc:meta])* $name:ident, $from:ident $to_from:ident, $to:ident $to_to:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[repr(transparent)]
        pub struct $name(Rotation3<f64>);

        impl $name {
            /// This rotation maps so.
            pub const fn new(rotation: Rotation3<f64>) -> Self {
                Self(rotation)
            }

            /// The rotation with this matrix, which is orthonormal to rounding and taken as it is.
            pub const fn from_matrix(matrix: &Matrix3<f64>) -> Self {
                Self(Rotation3::from_matrix_unchecked(*matrix))
            }

            /// Its matrix.
            pub const fn matrix(&self) -> &Matrix3<f64> {
                self.0.matrix()
            }

            /// Forwards.
            pub fn $to_to(&self, v: $from<Vector3<f64>>) -> $to<Vector3<f64>> {
                $to(self.0 * v.0)
            }

            /// Backwards.
            pub fn $to_from(&self, v: $to<Vector3<f64>>) -> $from<Vector3<f64>> {
                $from(self.0.inverse_transform_vector(&v.0))
            }
        }
    };
}

rotation! {
    /// The attitude: maps components in the body's frame to those in NED.
    BodyToNed, Body to_body, Ned to_ned
}

rotation! {
    /// The mounting of a camera: maps components in its frame to those in the body's.
    CameraToBody, Camera to_camera, Body to_body
}

impl BodyToNed {
    /// The same as a unit quaternion (Hamilton), with a scalar that is not negative.
    pub fn quaternion(&self) -> UnitQuaternion<f64> {
        let q = UnitQuaternion::from_rotation_matrix(&self.0);
        if q.w < 0.0 { UnitQuaternion::new_unchecked(-q.into_inner()) } else { q }
    }

    /// A covariance in the body's axes: Rᵀ P R.
    pub fn covariance_to_body(&self, covariance: Ned<Matrix3<f64>>) -> Body<Matrix3<f64>> {
        Body(self.0.matrix().tr_mul(&covariance.0) * self.0.matrix())
    }
}

impl From<UnitQuaternion<f64>> for BodyToNed {
    /// I + 2w S(v) + 2 S(v)² of q = (w, v), its norm taken out once more. nalgebra's `to_rotation_matrix` is the same to rounding; in this form the errors against a
    /// simulator's truth are, to the last digit, those that were recorded.
    fn from(q: UnitQuaternion<f64>) -> Self {
        let n = q.as_ref().norm();
        let s = hat(&(q.imag() / n));
        Self::from_matrix(&(Matrix3::identity() + (2.0 * q.w / n) * s + 2.0 * (s * s)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::so3::{Euler, exp};
    use proptest::prelude::*;

    fn vector(bound: f64) -> impl Strategy<Value = Vector3<f64>> {
        [-bound..bound, -bound..bound, -bound..bound].prop_map(Vector3::from)
    }

    proptest! {
        #[test]
        fn there_and_back_is_the_same_vector(phi in vector(3.0), v in vector(50.0)) {
            let attitude = BodyToNed::from_matrix(&exp(&phi));
            let back = attitude.to_body(attitude.to_ned(Body::new(v)));
            prop_assert!((back.raw() - v).norm() < 1e-12);
            let mounting = CameraToBody::from_matrix(&exp(&phi));
            prop_assert!((mounting.to_camera(mounting.to_body(Camera::new(v))).raw() - v).norm() < 1e-12);
        }

        #[test]
        fn quaternion_and_matrix_are_one_rotation(phi in vector(3.1)) {
            let attitude = BodyToNed::from_matrix(&exp(&phi));
            let q = attitude.quaternion();
            prop_assert!(q.w >= 0.0 && (q.norm() - 1.0).abs() < 1e-12);
            prop_assert!((BodyToNed::from(q).matrix() - attitude.matrix()).norm() < 1e-13);
        }

        #[test]
        fn a_direction_keeps_its_variance(phi in vector(3.0), along in vector(1.0), sigma in vector(4.0)) {
            let attitude = BodyToNed::from_matrix(&exp(&phi));
            let p = Ned::new(Matrix3::from_diagonal(&sigma.component_mul(&sigma)));
            let in_ned = attitude.to_ned(Body::new(along)).raw();
            let (ned, body) = (in_ned.dot(&(p.raw() * in_ned)), along.dot(&(attitude.covariance_to_body(p).raw() * along)));
            prop_assert!((ned - body).abs() < 1e-10);
        }
    }

    #[test]
    fn nose_up_forward_is_up() {
        let attitude = BodyToNed::from_matrix(&Euler::new(0.0, 0.3, 0.0).to_rotation());
        assert!(attitude.to_ned(Body::new(Vector3::x())).raw().z < 0.0);
    }

    #[test]
    fn an_image_on_the_ground_lies_as_the_body_does() {
        // The camera looks down: what is at the top of the image lies ahead, what is at its right lies to the right.
        let down = CameraToBody::new(Rotation3::identity());
        assert_eq!(down.to_body(Camera::ray(0.0, -0.5)).raw(), Vector3::new(0.5, 0.0, 1.0));
        assert_eq!(down.to_body(Camera::ray(0.5, 0.0)).raw().y, 0.5);
        assert_eq!(Camera::ray(0.2, 0.7).right_down_along(), [0.2, 0.7, 1.0]);
    }
}
