//! `[landmarks]`: points and cameras as texts of `name=number`, and what they are made into.

use nalgebra::Vector3;
use serde::Deserialize;

use crate::geo::so3::Euler;
use crate::geo::{Body, CameraMount, Geodetic, LocalNed};
use crate::landmark::{LandmarkCamera, LandmarkSettings};
use crate::navigator::sources::landmarks::{ComponentCamera, LandmarkFrame, LandmarkPlace, LandmarkSetup};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Frame {
    Surveyed,
    Local,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Landmarks {
    r#use: bool,
    frame: Frame,
    points: Vec<String>,
    cameras: Vec<String>,
    seen_from_m: f64,
    bearing_sigma_deg: f64,
    survey_sigma_m: f64,
    gravity_sigma_deg: f64,
    position_drift: f64,
    attitude_drift_deg: f64,
    history_s: f64,
}

/// A name, and the bounds of its number.
type Field = (&'static str, f64, f64);

const FAR_M: f64 = 1e6;
const POINT_NED: [Field; 4] =
    [("id", 0.0, 255.0), ("north_m", -FAR_M, FAR_M), ("east_m", -FAR_M, FAR_M), ("down_m", -FAR_M, FAR_M)];
const POINT_GLOBAL: [Field; 4] = [
    ("id", 0.0, 255.0),
    ("latitude_deg", -90.0, 90.0),
    ("longitude_deg", -180.0, 180.0),
    ("height_m", -1000.0, 20_000.0),
];
const CAMERA: [Field; 10] = [
    ("component", 0.0, 255.0),
    ("roll_deg", -180.0, 180.0),
    ("pitch_deg", -180.0, 180.0),
    ("yaw_deg", -180.0, 180.0),
    ("x_m", -100.0, 100.0),
    ("y_m", -100.0, 100.0),
    ("z_m", -100.0, 100.0),
    ("half_x_deg", 1.0, 89.0),
    ("half_y_deg", 1.0, 89.0),
    ("delay_ms", 0.0, 1000.0),
];
/// What a camera is that does not say otherwise.
const CAMERA_DEFAULT: [f64; 10] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 60.0, 60.0, 0.0];

/// The numbers of a text in the order of `fields`; `None` where one is not told.
fn numbers<const N: usize>(text: &str, fields: &[Field; N]) -> Result<[Option<f64>; N], String> {
    let mut out = [None; N];
    for word in text.split_whitespace() {
        let (name, value) =
            word.split_once('=').ok_or_else(|| format!("\"{text}\": \"{word}\" is not name=number"))?;
        let known = || fields.iter().map(|f| f.0).collect::<Vec<_>>().join(", ");
        let at = fields
            .iter()
            .position(|f| f.0 == name)
            .ok_or_else(|| format!("\"{text}\": unknown \"{name}\"; expected {}", known()))?;
        let (_, low, high) = fields[at];
        let number = value.parse::<f64>().ok().filter(|v| (low..=high).contains(v));
        let number = number.ok_or_else(|| {
            format!("\"{text}\": {name} is to be a number from {low} to {high}, not \"{value}\"")
        })?;
        if out[at].replace(number).is_some() {
            return Err(format!("\"{text}\": {name} stands there twice"));
        }
    }
    Ok(out)
}

/// All of them.
fn complete<const N: usize>(text: &str, fields: &[Field; N]) -> Result<[f64; N], String> {
    let told = numbers(text, fields)?;
    if let Some(i) = told.iter().position(Option::is_none) {
        return Err(format!("\"{text}\": no {}", fields[i].0));
    }
    Ok(told.map(Option::unwrap_or_default))
}

/// An id is a whole number.
fn byte(text: &str, name: &str, value: f64) -> Result<u8, String> {
    if value.fract() == 0.0 { Ok(value as u8) } else { Err(format!("\"{text}\": {name} is no whole number")) }
}

fn point(text: &str, frame: Frame) -> Result<(u8, LandmarkPlace), String> {
    let global = ["latitude_deg", "longitude_deg", "height_m"].iter().any(|name| text.contains(name));
    if global && frame == Frame::Local {
        return Err(format!("\"{text}\": landmarks of a local frame have north_m, east_m and down_m"));
    }
    let [id, a, b, c] = complete(text, if global { &POINT_GLOBAL } else { &POINT_NED })?;
    let place = if global {
        LandmarkPlace::Global(Geodetic::from_degrees(a, b, c))
    } else {
        LandmarkPlace::Ned(Vector3::new(a, b, c))
    };
    Ok((byte(text, "id", id)?, place))
}

fn camera(text: &str) -> Result<ComponentCamera, String> {
    let told = numbers(text, &CAMERA)?;
    let [component, roll, pitch, yaw, x, y, z, half_x, half_y, delay_ms] =
        std::array::from_fn(|i| told[i].unwrap_or(CAMERA_DEFAULT[i]));
    let mounting =
        Euler { roll_rad: roll.to_radians(), pitch_rad: pitch.to_radians(), yaw_rad: yaw.to_radians() };
    Ok(ComponentCamera {
        component: byte(text, "component", component)?,
        camera: LandmarkCamera {
            mount: CameraMount::turned(mounting, Body::new(Vector3::new(x, y, z))),
            half_field_of_view_rad: [half_x, half_y].map(f64::to_radians),
        },
        delay_s: delay_ms * 1e-3,
    })
}

impl Landmarks {
    /// What is configured; `None` when there are no landmarks to use.
    pub(super) fn setup(&self, complain: &mut impl FnMut(&str, String)) -> Option<LandmarkSetup> {
        let mut read =
            |text: &String| point(text, self.frame).map_err(|e| complain("landmarks.points", e)).ok();
        let points: Vec<_> = self.points.iter().filter_map(&mut read).collect();
        let mut read = |text: &String| camera(text).map_err(|e| complain("landmarks.cameras", e)).ok();
        let cameras: Vec<_> = self.cameras.iter().filter_map(&mut read).collect();
        for (i, c) in cameras.iter().enumerate() {
            if cameras.iter().take(i).any(|other| other.component == c.component) {
                complain("landmarks.cameras", format!("component {} stands there twice", c.component));
            }
        }
        if !self.r#use || points.is_empty() {
            return None;
        }
        if cameras.is_empty() {
            complain("landmarks.cameras", "there is no camera to see the landmarks with".into());
        }
        let seen = LandmarkSettings::seen_from(self.seen_from_m);
        let setup = LandmarkSetup {
            frame: match self.frame {
                Frame::Surveyed => LandmarkFrame::Surveyed,
                Frame::Local => LandmarkFrame::Local,
            },
            points,
            cameras,
            filter: LandmarkSettings {
                bearing_sigma_rad: self.bearing_sigma_deg.to_radians(),
                position_drift: self.position_drift,
                attitude_drift: self.attitude_drift_deg.to_radians(),
                history_s: self.history_s,
                gravity_sigma_rad: self.gravity_sigma_deg.to_radians(),
                ..seen
            },
            survey_sigma_m: self.survey_sigma_m,
        };
        // Whatever is wrong with a map is so at any origin.
        if let Err(e) = setup.map(&LocalNed::new(Geodetic::from_degrees(0.0, 0.0, 0.0))) {
            complain("landmarks.points", e.to_string());
        }
        Some(setup)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POINTS: [&str; 2] = [
        "id=7 north_m=12.5 east_m=-3 down_m=-0.4",
        "id=200 latitude_deg=63.4000213 longitude_deg=10.4 height_m=100.4",
    ];

    fn raw(frame: Frame, points: &[&str], cameras: &[&str]) -> Landmarks {
        Landmarks {
            r#use: true,
            frame,
            points: points.iter().map(|s| (*s).to_owned()).collect(),
            cameras: cameras.iter().map(|s| (*s).to_owned()).collect(),
            seen_from_m: 15.0,
            bearing_sigma_deg: 1.0,
            survey_sigma_m: 0.05,
            gravity_sigma_deg: 0.7,
            position_drift: 0.15,
            attitude_drift_deg: 0.02,
            history_s: 1.0,
        }
    }

    fn read(
        frame: Frame,
        points: &[&str],
        cameras: &[&str],
    ) -> (Option<LandmarkSetup>, Vec<(String, String)>) {
        let mut wrong = Vec::new();
        let setup = raw(frame, points, cameras).setup(&mut |key, what| wrong.push((key.to_owned(), what)));
        (setup, wrong)
    }

    #[test]
    fn points_and_cameras_are_read() {
        let (setup, wrong) =
            read(Frame::Surveyed, &POINTS, &["", "component=100 pitch_deg=90 x_m=0.2 delay_ms=80"]);
        assert_eq!(wrong, []);
        let setup = setup.unwrap();
        assert_eq!(setup.points[0], (7, LandmarkPlace::Ned(Vector3::new(12.5, -3.0, -0.4))));
        let frame = LocalNed::new(Geodetic::from_degrees(63.4, 10.4, 100.0));
        let map = setup.map(&frame).unwrap();
        assert!((map.get(200).unwrap() - Vector3::new(2.374, 0.0, -0.4)).norm() < 2e-3);
        assert_eq!(setup.cameras[0].camera, LandmarkCamera::downward([60f64.to_radians(); 2]));
        // Pitched up by a quarter, a camera that looked down looks forward.
        let forward = setup.cameras[1];
        let mount = forward.camera.mount;
        assert!((mount.axis().raw() - Vector3::x()).norm() < 1e-12);
        assert_eq!((forward.component, forward.delay_s, mount.lever_arm.raw().x), (100, 0.08, 0.2));
    }

    #[test]
    fn without_points_there_is_nothing_to_set_up() {
        assert_eq!(read(Frame::Surveyed, &[], &[""]), (None, vec![]));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let point = |id: &str| format!("{id} north_m=1 east_m=2 down_m=3");
        for (points, word) in [
            (vec![point("id=256")], "0 to 255"),
            (vec![point("id=1.5")], "whole"),
            (vec![point("id=x")], "number"),
            (vec![point("")], "no id"),
            (vec![point("id=1 id=2")], "twice"),
            (vec![point("id=1"), point("id=1")], "landmark 1 is there twice"),
            (vec!["id=1 north_m=nan east_m=2 down_m=3".into()], "north_m"),
            (vec!["id=1 north_m=1e9 east_m=2 down_m=3".into()], "north_m"),
            (vec!["id=1 north_m=1 east_m=2".into()], "no down_m"),
            (vec!["id=1 latitude_deg=91 longitude_deg=0 height_m=0".into()], "latitude_deg"),
            (vec!["id=1 latitude_deg=9 longitude_deg=0 down_m=0".into()], "down_m"),
            (vec!["7".into()], "name=number"),
        ] {
            let texts: Vec<&str> = points.iter().map(String::as_str).collect();
            let (_, wrong) = read(Frame::Surveyed, &texts, &[""]);
            assert!(
                wrong.iter().any(|(k, e)| k == "landmarks.points" && e.contains(word)),
                "{points:?}: {wrong:?}"
            );
        }
        let (_, wrong) = read(Frame::Local, &POINTS, &[""]);
        assert!(wrong.iter().any(|(_, e)| e.contains("local frame")), "{wrong:?}");
        for (cameras, word) in [
            (vec!["half_x_deg=90"], "half_x_deg"),
            (vec!["colour=1"], "unknown \"colour\""),
            (vec!["", "component=0"], "twice"),
            (vec![], "no camera"),
        ] {
            let (_, wrong) = read(Frame::Surveyed, &POINTS[..1], &cameras);
            assert!(
                wrong.iter().any(|(k, e)| k == "landmarks.cameras" && e.contains(word)),
                "{cameras:?}: {wrong:?}"
            );
        }
    }
}
