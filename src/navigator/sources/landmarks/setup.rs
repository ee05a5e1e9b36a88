//! Which landmarks there are, where, and which cameras see them.

use nalgebra::Vector3;

use crate::geo::{Geodetic, LocalNed};
use crate::landmark::{LandmarkCamera, LandmarkMap, LandmarkSettings, MapError};

/// What the landmarks' coordinates are relative to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LandmarkFrame {
    /// The Earth: surveyed.
    Surveyed,
    /// A frame of their own with z down, whose place and heading GNSS shows.
    Local,
}

/// Where a landmark is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LandmarkPlace {
    /// In NED at the origin, or in the landmarks' own frame, m.
    Ned(Vector3<f64>),
    /// On the globe; height above mean sea level.
    Global(Geodetic),
}

/// The camera behind a component's sightings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ComponentCamera {
    /// The component whose sightings it makes; 0 stands for every other.
    pub component: u8,
    /// What it sees from where.
    pub camera: LandmarkCamera,
    /// Age of a sighting beyond its own stamp, s.
    pub delay_s: f64,
}

/// Landmarks, cameras, and what is believed of them.
#[derive(Clone, Debug, PartialEq)]
pub struct LandmarkSetup {
    /// Their frame.
    pub frame: LandmarkFrame,
    /// Ids and places.
    pub points: Vec<(u8, LandmarkPlace)>,
    /// Cameras.
    pub cameras: Vec<ComponentCamera>,
    /// The filter.
    pub filter: LandmarkSettings,
    /// How well the field as a whole was surveyed, each axis, m.
    pub survey_sigma_m: f64,
}

impl LandmarkSetup {
    /// The landmarks in a local frame.
    ///
    /// # Errors
    /// [`MapError`].
    pub fn map(&self, frame: &LocalNed) -> Result<LandmarkMap, MapError> {
        LandmarkMap::new(self.points.iter().map(|(id, place)| match place {
            LandmarkPlace::Ned(p) => (*id, *p),
            LandmarkPlace::Global(g) => (*id, frame.to_ned(g)),
        }))
    }

    /// The place among the cameras of the one that a component has, and its delay, s.
    pub(super) fn camera(&self, component: u8) -> Option<(u8, f64)> {
        let of = |wanted: u8| self.cameras.iter().position(|c| c.component == wanted);
        let index = of(component).or_else(|| of(0))?;
        Some((u8::try_from(index).ok()?, self.cameras.get(index)?.delay_s))
    }

    pub(super) fn landmark_cameras(&self) -> Vec<LandmarkCamera> {
        self.cameras.iter().map(|c| c.camera).collect()
    }
}
