//! What a landmark filter is configured with: the landmarks, the cameras, the noise, and what it may believe.

use super::tuning::FARTHEST_MAPPED_M;
use nalgebra::Vector3;

use crate::geo::{Body, Camera, CameraMount};

/// Landmarks with known coordinates, by id, in one frame: NED at the origin, or a local frame whose z axis points down.
#[derive(Clone, Debug, PartialEq)]
pub struct LandmarkMap {
    landmarks: Vec<(u8, Vector3<f64>)>,
    centroid: Vector3<f64>,
    radius_m: f64,
}

/// What is wrong with a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MapError {
    /// There is nothing to see.
    #[error("no landmarks")]
    Empty,
    /// Two landmarks cannot be told apart.
    #[error("landmark {0} is there twice")]
    Twice(u8),
    /// Coordinates are no numbers, or farther away than the Earth is large.
    #[error("landmark {0} has impossible coordinates")]
    Impossible(u8),
}

impl LandmarkMap {
    /// A map of landmarks.
    ///
    /// # Errors
    /// [`MapError`].
    pub fn new(landmarks: impl IntoIterator<Item = (u8, Vector3<f64>)>) -> Result<Self, MapError> {
        let mut landmarks: Vec<_> = landmarks.into_iter().collect();
        landmarks.sort_by_key(|(id, _)| *id);
        if landmarks.is_empty() {
            return Err(MapError::Empty);
        }
        if let Some((id, _)) = landmarks.iter().find(|(_, q)| !q.iter().all(|v| v.abs() < FARTHEST_MAPPED_M))
        {
            return Err(MapError::Impossible(*id));
        }
        if let Some(pair) = landmarks.windows(2).find(|w| w[0].0 == w[1].0) {
            return Err(MapError::Twice(pair[0].0));
        }
        let count = landmarks.len() as f64;
        let centroid = landmarks.iter().map(|(_, q)| q).sum::<Vector3<f64>>() / count;
        let spread: f64 = landmarks.iter().map(|(_, q)| (q - centroid).norm_squared()).sum();
        let radius_m = (spread / count).sqrt();
        Ok(Self { landmarks, centroid, radius_m })
    }

    /// Where a landmark is, m.
    pub fn get(&self, id: u8) -> Option<Vector3<f64>> {
        let at = self.landmarks.binary_search_by_key(&id, |(id, _)| *id).ok()?;
        self.landmarks.get(at).map(|(_, q)| *q)
    }

    /// Ids and coordinates, by id.
    pub fn iter(&self) -> impl Iterator<Item = (u8, Vector3<f64>)> + '_ {
        self.landmarks.iter().copied()
    }

    /// Their mean, m.
    pub fn centroid(&self) -> Vector3<f64> {
        self.centroid
    }

    /// Their root mean square distance from the mean, m.
    pub fn radius_m(&self) -> f64 {
        self.radius_m
    }
}

/// A camera that sees landmarks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LandmarkCamera {
    /// Where and how it sits.
    pub mount: CameraMount,
    /// Half of the field of view along the image's right and down, rad. A sighting outside is none.
    pub half_field_of_view_rad: [f64; 2],
}

impl LandmarkCamera {
    /// Looking down from the body's origin, the top of the image forward.
    pub fn downward(half_field_of_view_rad: [f64; 2]) -> Self {
        Self { mount: CameraMount::downward(), half_field_of_view_rad }
    }

    /// Where a landmark is that is seen under these angles from the optical axis to the image's right and down, rad: along the ray
    /// (tan right, tan down, 1).
    pub fn towards(&self, [right, down]: [f64; 2]) -> Body<Vector3<f64>> {
        self.mount.camera_to_body.to_body(Camera::ray(right.tan(), down.tan()))
    }

    /// Whether a direction from the camera is in the field of view.
    pub fn sees(&self, direction: Body<Vector3<f64>>) -> bool {
        let [right, down, along] = self.mount.camera_to_body.to_camera(direction).right_down_along();
        let [x, y] = self.half_field_of_view_rad;
        right.abs().atan2(along) <= x && down.abs().atan2(along) <= y
    }
}

/// What the landmark filter believes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeliefSettings {
    /// The H∞ filter's gate on the squared ratio of a sighting's residual. Without one 3 % of wrong ids keep it from ever converging.
    pub gate: f64,
    /// The same of the refining filter.
    pub refined_gate: f64,
    /// The smoothed part of rejected sightings above which a filter is taken to be locked out.
    pub lockout_part: f64,
    /// What Y is multiplied with then.
    pub lockout_factor: f64,
    /// σ of the position (each axis, m) and of the attitude (each axis, rad) below which a pose is converged.
    pub converged_sigma: [f64; 2],
}

/// Noise, memory and what is believed. The defaults are for a camera of a degree and a dead reckoning of a few cm/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LandmarkSettings {
    /// λ, the H∞ filter's rate of forgetting, 1/s: 0.25-0.5.
    pub lambda: f64,
    /// σ of a bearing, each of two directions, rad.
    pub bearing_sigma_rad: f64,
    /// Least and greatest distance by which a bearing's error is scaled, m. The estimate of the distance may be nonsense at first.
    pub distance_clip_m: [f64; 2],
    /// σ of a measured distance: this part of it, but no less than 5 cm.
    pub distance_sigma_part: f64,
    /// σ of the direction of gravity as it is given, rad.
    pub gravity_sigma_rad: f64,
    /// A direction of gravity is taken this often, s.
    pub gravity_period_s: f64,
    /// Weight of the rows that keep N near SO(3), each time a direction of gravity is taken. A coplanar field and a hover need them.
    pub orthonormality_weight: f64,
    /// Drift of the dead reckoning in position, m/√s.
    pub position_drift: f64,
    /// Drift of the dead reckoning in attitude, rad/√s.
    pub attitude_drift: f64,
    /// Sightings older than this are refused, s.
    pub history_s: f64,
    /// Motions farther apart than this break the dead reckoning, s.
    pub gap_s: f64,
    /// Motions remembered at most.
    pub motions: usize,
    /// Sightings and directions of gravity that can still be put in order, at most.
    pub events: usize,
    /// What is believed.
    pub belief: BeliefSettings,
}

impl LandmarkSettings {
    /// The default with lengths that fit a field of landmarks that is seen from about `distance_m`.
    pub fn seen_from(distance_m: f64) -> Self {
        let d = distance_m.clamp(1.0, 1e4);
        Self { distance_clip_m: [0.1 * d, 3.0 * d], ..Self::default() }
    }
}
