//! `[landmarks]` and `[tuning.landmarks]`: known landmarks.

use nalgebra::Vector3;
use serde::Deserialize;

use crate::config::key::{Key, TableRow, Type, Typed, section};
use crate::geo::{Geodetic, LocalNed};
use crate::landmark::LandmarkSettings;
use crate::navigator::sources::landmarks::{LandmarkFrame, LandmarkPlace, LandmarkSetup};

use super::cameras::CameraKeys;

section! {
    /// Known landmarks.
    "landmarks" struct LandmarksKeys {
        /// Use known landmarks that cameras tell of with LANDING_TARGET (target_num is the id). Without points nothing is used.
        r#use: bool = true;
        /// What the coordinates are relative to: "surveyed" is the Earth; "local" a frame of their own with z down, whose place and heading are found while GNSS is good.
        frame: FrameName = "surveyed" of "surveyed" | "local";
        /// Distance that landmarks are mostly seen from, within a factor of three.
        seen_from_m: f64 = 15.0 in 1.0 ..= 1000.0;
        /// Noise of a sighting's angle, 1 sigma.
        bearing_sigma_deg: f64 = 0.9 in 0.01 ..= 20.0;
        /// How well the field as a whole was surveyed, each axis, 1 sigma.
        survey_sigma_m: f64 = 0.05 in 0.001 ..= 100.0;
        /// The landmarks, each with either latitude, longitude and height (surveyed only) or north, east and down from the autopilot's origin or in their own frame.
        points: Vec<PointKeys> = [];
    }
}

section! {
    /// A landmark.
    "landmarks.points" struct PointKeys {
        /// Its id, which sightings name.
        id: u8 = required in 0.0 ..= 255.0 unit "";
        /// Latitude, WGS-84.
        latitude_deg: Option<f64> = absent in -90.0 ..= 90.0;
        /// Longitude, WGS-84.
        longitude_deg: Option<f64> = absent in -180.0 ..= 180.0;
        /// Height above mean sea level.
        height_m: Option<f64> = absent in -1000.0 ..= 20_000.0;
        /// North of the origin, or x in the landmarks' own frame.
        north_m: Option<f64> = absent in -1_000_000.0 ..= 1_000_000.0;
        /// East of the origin, or y in the landmarks' own frame.
        east_m: Option<f64> = absent in -1_000_000.0 ..= 1_000_000.0;
        /// Below the origin, or z in the landmarks' own frame.
        down_m: Option<f64> = absent in -1_000_000.0 ..= 1_000_000.0;
    }
}

impl TableRow for PointKeys {
    const KEYS: &'static [Key] = Self::SECTION.keys;
}

section! {
    /// The landmarks' filter.
    "tuning.landmarks" struct LandmarksTuning {
        /// Drift of the dead reckoning between sightings in position.
        position_drift: f64 = 0.15 in 0.001 ..= 10.0 unit "m/√s" was "landmarks.position_drift";
        /// Drift of the dead reckoning between sightings in attitude.
        attitude_drift_deg: f64 = 0.02 in 0.001 ..= 10.0 unit "degrees/√s" was "landmarks.attitude_drift_deg";
        /// Noise of the navigator's tilt, which is shown to the landmarks' filter five times a second, 1 sigma.
        gravity_sigma_deg: f64 = 0.7 in 0.01 ..= 20.0 was "landmarks.gravity_sigma_deg";
        /// Sightings that come later than this are not used.
        history_s: f64 = 1.0 in 0.1 ..= 5.0 was "landmarks.history_s";
    }
}

/// What the coordinates are relative to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(in crate::config) enum FrameName {
    Surveyed,
    Local,
}

impl Typed for FrameName {
    const TYPE: Type = Type::Text;
}

impl PointKeys {
    /// Where it is, or what is wrong.
    fn place(&self, frame: FrameName) -> Result<LandmarkPlace, String> {
        let global = [self.latitude_deg, self.longitude_deg, self.height_m];
        let local = [self.north_m, self.east_m, self.down_m];
        match (global, local) {
            ([None, None, None], [Some(north), Some(east), Some(down)]) => {
                Ok(LandmarkPlace::Ned(Vector3::new(north, east, down)))
            }
            ([Some(_), ..] | [_, Some(_), _] | [.., Some(_)], _) if frame == FrameName::Local => {
                Err(format!(
                    "has landmark {} on the globe: those of a local frame have north_m, east_m and down_m",
                    self.id
                ))
            }
            ([Some(latitude), Some(longitude), Some(height)], [None, None, None]) => {
                Ok(LandmarkPlace::Global(Geodetic::from_degrees(latitude, longitude, height)))
            }
            _ => Err(format!(
                "has landmark {} with neither latitude_deg, longitude_deg and height_m nor north_m, east_m and down_m alone",
                self.id
            )),
        }
    }
}

impl LandmarksKeys {
    /// What is configured; `None` when there are no landmarks to use.
    pub(super) fn setup(
        &self,
        tuning: &LandmarksTuning,
        cameras: &[CameraKeys],
        complain: &mut impl FnMut(&str, String),
    ) -> Option<LandmarkSetup> {
        let mut place = |p: &PointKeys| {
            p.place(self.frame).map_err(|e| complain("landmarks.points", e)).ok().map(|place| (p.id, place))
        };
        let points: Vec<_> = self.points.iter().filter_map(&mut place).collect();
        if !self.r#use || points.is_empty() {
            return None;
        }
        if cameras.is_empty() {
            complain("cameras", "is empty: there is no camera to see the landmarks with".into());
        }
        let setup = LandmarkSetup {
            frame: match self.frame {
                FrameName::Surveyed => LandmarkFrame::Surveyed,
                FrameName::Local => LandmarkFrame::Local,
            },
            points,
            cameras: cameras.iter().map(CameraKeys::landmark_camera).collect(),
            filter: LandmarkSettings {
                bearing_sigma_rad: self.bearing_sigma_deg.to_radians(),
                position_drift: tuning.position_drift,
                attitude_drift: tuning.attitude_drift_deg.to_radians(),
                history_s: tuning.history_s,
                gravity_sigma_rad: tuning.gravity_sigma_deg.to_radians(),
                ..LandmarkSettings::seen_from(self.seen_from_m)
            },
            survey_sigma_m: self.survey_sigma_m,
        };
        // Whatever is wrong with a map is so at any origin.
        if let Err(e) = setup.map(&LocalNed::new(Geodetic::from_degrees(0.0, 0.0, 0.0))) {
            complain("landmarks.points", format!("is no map: {e}"));
        }
        Some(setup)
    }
}
