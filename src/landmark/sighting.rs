//! A landmark as a camera saw it, and what was made of it.

use nalgebra::Vector3;

use super::dead_reckoning::DeadReckoned;
use super::information::SeenInD;
use super::settings::{LandmarkCamera, LandmarkSettings};
use super::tuning::FARTHEST_SEEN_M;
use crate::geo::{Body, Camera};
use crate::time::AutopilotTime;

/// A landmark in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LandmarkSighting {
    /// When the picture was taken, not when it was heard of.
    pub time: AutopilotTime,
    /// Which camera.
    pub camera: u8,
    /// Which landmark the camera says it is.
    pub id: u8,
    /// Where.
    pub seen: Seen,
}

/// Where a landmark was seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Seen {
    /// Angles from the optical axis along the image's x (right) and y (down), rad: the direction (tan x, tan y, 1). With the distance, m,
    /// where it is known.
    Angles {
        /// Along x and y, rad.
        angle_xy: [f64; 2],
        /// Distance, m.
        distance_m: Option<f64>,
    },
    /// The landmark's position from the camera, m.
    InCamera(Camera<Vector3<f64>>),
    /// The landmark's position from the body's origin, m.
    InBody(Body<Vector3<f64>>),
}

/// What was made of a sighting.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum SightingVerdict {
    /// Used; the squared ratio of its residual to what was to be expected.
    Used(f64),
    /// Not used: its ratio is above the gate.
    Gated(f64),
    /// No landmark has this id.
    UnknownId,
    /// There is no such camera.
    UnknownCamera,
    /// Outside what the camera can see.
    OutOfFieldOfView,
    /// As many seconds older than what is remembered.
    TooOld(f64),
    /// As many seconds after the present of the dead reckoning: to be given again when that has come.
    FromTheFuture(f64),
    /// The camera has already told of this landmark at this time.
    Duplicate,
    /// Not finite, or no direction.
    NotFinite,
    /// The filter has lost its definiteness and starts again.
    Indefinite,
}

impl SightingVerdict {
    /// Whether it went into the estimate.
    pub fn is_used(&self) -> bool {
        matches!(self, SightingVerdict::Used(_))
    }
}

/// Brings a sighting from the camera to D, where the body was at `then` when it was made.
///
/// # Errors
/// The verdict on a sighting that is none.
pub(super) fn in_d(
    seen: &Seen,
    landmark: &Vector3<f64>,
    camera: &LandmarkCamera,
    then: &DeadReckoned,
    settings: &LandmarkSettings,
) -> Result<SeenInD, SightingVerdict> {
    let mount = &camera.mount;
    let (towards, distance_m) = match *seen {
        Seen::Angles { angle_xy: [x, y], distance_m } => {
            if !(x.is_finite() && y.is_finite()) {
                return Err(SightingVerdict::NotFinite);
            }
            if x.abs().max(y.abs()) >= std::f64::consts::FRAC_PI_2 {
                return Err(SightingVerdict::OutOfFieldOfView);
            }
            (camera.towards([x, y]).raw(), distance_m)
        }
        Seen::InCamera(p) => (mount.camera_to_body.to_body(p).raw(), Some(p.raw().norm())),
        Seen::InBody(p) => {
            let p = (p - mount.lever_arm).raw();
            (p, Some(p.norm()))
        }
    };
    let norm = towards.norm();
    let possible = |d: f64| d > 0.0 && d < FARTHEST_SEEN_M;
    if !(norm > 1e-6 && norm < 1e12) || distance_m.is_some_and(|d| !possible(d)) {
        return Err(SightingVerdict::NotFinite);
    }
    if !camera.sees(Body::new(towards)) {
        return Err(SightingVerdict::OutOfFieldOfView);
    }
    Ok(SeenInD {
        landmark: *landmark,
        direction_d: then.r_body_to_d * (towards / norm),
        camera_d: then.position_d + then.r_body_to_d * mount.lever_arm.raw(),
        distance: distance_m.map(|d| [d, (settings.distance_sigma_part * d).max(0.05)]),
    })
}
