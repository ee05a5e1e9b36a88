//! What `simulate` has of markers: their options, the camera, and the configuration that tells of both.

use clap::Args;

use crate::geo::{Geodetic, LocalNed};
use crate::sample::{LandmarkSample, Sample, Sighting};
use crate::sim::{MarkerCamera, MarkerField, Scenario, SeenLandmark, Simulation};
use crate::wire::frame::{ComponentId, SystemId};
use crate::wire::session::Address;

use super::Failure;

/// Markers on the ground.
#[derive(Debug, Args)]
pub struct MarkerArgs {
    /// Lay out markers about every M metres along the route, carry a camera that sees them, and write the configuration with both beside the
    /// log (FILE.landmarks.toml)
    #[arg(long, value_name = "M")]
    pub markers: Option<f64>,
    /// The word of a picture comes this late, and up to half as much later still, ms
    #[arg(long, value_name = "MS", default_value_t = 60.0, requires = "markers")]
    pub camera_delay: f64,
    /// This part of all sightings names another marker, %
    #[arg(long, value_name = "PERCENT", default_value_t = 0.0, requires = "markers")]
    pub wrong_ids: f64,
    /// This part of all sightings is lost, %
    #[arg(long, value_name = "PERCENT", default_value_t = 0.0, requires = "markers")]
    pub lost_sightings: f64,
}

/// The camera's, which tells of markers.
pub(super) const CAMERA: Address = Address { system: SystemId(1), component: ComponentId(100) };
/// Half of its field of view, degrees, and the time between two pictures, s.
const MARKER_VIEW_DEG: f64 = 40.0;
const MARKER_PERIOD_S: f64 = 0.1;
/// Nearest and farthest that markers may be from each other, m.
const SPACING_M: std::ops::RangeInclusive<f64> = 0.5..=1000.0;

impl MarkerArgs {
    /// The markers that are asked for.
    ///
    /// # Errors
    /// [`Failure::Usage`].
    pub(super) fn field(&self, scenario: &Scenario, seed: u64) -> Result<Option<MarkerField>, Failure> {
        let Some(spacing_m) = self.markers else { return Ok(None) };
        if !SPACING_M.contains(&spacing_m) {
            return Err(Failure::Usage(format!(
                "markers every {spacing_m} m: expected --markers from {} to {}",
                SPACING_M.start(),
                SPACING_M.end()
            )));
        }
        let ground = scenario.environment.ground_down_m;
        match MarkerField::along(scenario, scenario.duration_s, ground, spacing_m, seed) {
            Some(field) => Ok(Some(field)),
            None => Err(Failure::Usage(format!(
                "markers every {spacing_m} m would be more than 256 on this route: --markers wants more metres"
            ))),
        }
    }

    /// The camera that looks down from under the vehicle, 10 pictures a second.
    ///
    /// # Errors
    /// [`Failure::Usage`].
    pub(super) fn camera(&self, step_s: f64) -> Result<MarkerCamera, Failure> {
        for (name, value, most) in [
            ("--camera-delay", self.camera_delay, 600.0),
            ("--wrong-ids", self.wrong_ids, 100.0),
            ("--lost-sightings", self.lost_sightings, 100.0),
        ] {
            if !(0.0..=most).contains(&value) {
                return Err(Failure::Usage(format!("{name} {value}: expected 0 to {most}")));
            }
        }
        let delay_s = self.camera_delay * 1e-3;
        Ok(MarkerCamera {
            half_field_of_view_rad: [MARKER_VIEW_DEG.to_radians(); 2],
            every: (MARKER_PERIOD_S / step_s).round() as usize,
            delay_s,
            jitter_s: 0.5 * delay_s,
            dropout: self.lost_sightings * 0.01,
            wrong_ids: self.wrong_ids * 0.01,
            ..MarkerCamera::downward()
        })
    }
}

/// A sighting as a sample.
pub(super) fn sighting(seen: &SeenLandmark) -> Sample {
    Sample::Landmark(LandmarkSample {
        time: Simulation::ap_time(seen.taken_s),
        camera: CAMERA.component.0,
        id: seen.id,
        sighting: Sighting::Bearing { angle_xy: seen.angle_xy, distance_m: None },
    })
}

/// The configuration that tells of the markers and of the camera.
pub(super) fn to_toml(field: &MarkerField, camera: &MarkerCamera, origin: &Geodetic) -> String {
    let frame = LocalNed::new(*origin);
    let points = field.markers.iter().map(|(id, place)| {
        let g = frame.to_geodetic(place);
        let (latitude, longitude) = (g.latitude_rad.to_degrees(), g.longitude_rad.to_degrees());
        format!(
            "  {{ id = {id}, latitude_deg = {latitude:.9}, longitude_deg = {longitude:.9}, height_m = {:.3} }},\n",
            g.height_m
        )
    });
    let lever = camera.mount.lever_arm.raw();
    let [x, y] = camera.half_field_of_view_rad.map(f64::to_degrees);
    format!(
        "[[cameras]]\ncomponent = {}\nx_m = {}\ny_m = {}\nz_m = {}\nhalf_x_deg = {x:.1}\nhalf_y_deg = {y:.1}\n\n\
         [landmarks]\npoints = [\n{}]\n",
        CAMERA.component.0,
        lever.x,
        lever.y,
        lever.z,
        points.collect::<String>(),
    )
}
