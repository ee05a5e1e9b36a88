//! A simulated flight over markers, run through the landmark filter and through an extended Kalman filter. Shared by the tests, the benchmark
//! and the example.
#![allow(dead_code, reason = "each uses its part")]

use holdover::geo::so3::angle_between;
use holdover::landmark::dead_reckoning::DeadReckoning;
use holdover::landmark::information::SeenInD;
use holdover::landmark::refined::{Refined, Rigid};
use holdover::landmark::{
    BodyMotion, LandmarkCamera, LandmarkFilter, LandmarkMap, LandmarkPose, LandmarkSettings,
    LandmarkSighting, PoseGuess, Seen, SightingVerdict,
};
use holdover::sim::landmarks::{LandmarkStep, wrong_start};
use holdover::sim::{LandmarkFlight, MarkerCamera, MarkerField, SeenLandmark, Trajectory, Truth};
use holdover::time::AutopilotTime;
use nalgebra::{Matrix3, Vector3};

/// IMU period, s.
pub const STEP_S: f64 = 0.02;

pub fn stamp(t_s: f64) -> AutopilotTime {
    AutopilotTime::from_micros((t_s * 1e6).round() as i64)
}

pub fn landmark_camera(camera: &MarkerCamera) -> LandmarkCamera {
    LandmarkCamera {
        mount: camera.mount,
        half_field_of_view_rad: camera.half_field_of_view_rad.map(|a| a + 0.01),
    }
}

pub fn motion(step: &LandmarkStep) -> BodyMotion {
    BodyMotion { velocity_body: step.velocity_body, angular_rate_body: step.angular_rate_body }
}

pub fn sighting(seen: &SeenLandmark) -> LandmarkSighting {
    LandmarkSighting {
        time: stamp(seen.taken_s),
        camera: 0,
        id: seen.id,
        seen: Seen::Angles { angle_xy: seen.angle_xy, distance_m: None },
    }
}

/// Position error, m, and attitude error, rad.
pub type Error = [f64; 2];

pub fn error(truth: &Truth, position: &Vector3<f64>, r: &Matrix3<f64>) -> Error {
    [(truth.position_ned - position).norm(), angle_between(&truth.r_body_to_ned, r)]
}

/// Errors over time, s.
pub type Track = Vec<(f64, Error)>;

/// What is flown, and with what the filter is told.
pub struct Case<'a> {
    pub trajectory: &'a dyn Trajectory,
    pub field: &'a MarkerField,
    pub camera: MarkerCamera,
    pub noise: holdover::sim::MotionNoise,
    pub settings: LandmarkSettings,
    /// Initial error of the attitude, rad; any when absent.
    pub attitude_rad: Option<f64>,
    /// Whether the filter is told how wrong its first attitude may be; else it takes it for any.
    pub tells_attitude: bool,
    pub duration_s: f64,
    pub seed: u64,
}

impl Case<'_> {
    pub fn flight(&self) -> LandmarkFlight {
        let times = [STEP_S, self.duration_s];
        LandmarkFlight::fly(self.trajectory, self.field, &self.camera, &self.noise, times, self.seed)
    }

    pub fn start(&self, flight: &LandmarkFlight) -> (Vector3<f64>, Matrix3<f64>) {
        wrong_start(&flight.start, 3.0, self.attitude_rad, self.seed)
    }

    /// The start and how far off the filter is told that it may be.
    pub fn guess(&self, flight: &LandmarkFlight) -> PoseGuess {
        let (position_ned, r_body_to_ned) = self.start(flight);
        let told = self.attitude_rad.map_or(PoseGuess::ANY_ATTITUDE, |a| a.max(0.02));
        let attitude_sigma_rad = if self.tells_attitude { told } else { PoseGuess::ANY_ATTITUDE };
        PoseGuess { position_ned, r_body_to_ned, position_sigma_m: 4.0, attitude_sigma_rad }
    }

    pub fn map(&self) -> LandmarkMap {
        LandmarkMap::new(self.field.markers.iter().copied()).expect("a map")
    }

    pub fn filter(&self, flight: &LandmarkFlight) -> LandmarkFilter {
        let cameras = vec![landmark_camera(&self.camera)];
        LandmarkFilter::new(self.settings, self.map(), cameras, stamp(0.0), &self.guess(flight))
    }
}

/// Flies on, telling of each step before its sightings; `each` sees the filter after them.
pub fn fly(
    filter: &mut LandmarkFilter,
    flight: &LandmarkFlight,
    mut verdict: impl FnMut(&SeenLandmark, SightingVerdict),
    mut each: impl FnMut(&LandmarkStep, &LandmarkFilter),
) {
    let mut next = flight.seen.iter().peekable();
    for step in &flight.steps {
        filter.push(stamp(step.truth.t_s), &motion(step), Some(&step.down_body));
        while let Some(seen) = next.next_if(|s| s.heard_s <= step.truth.t_s + 1e-9) {
            verdict(seen, filter.sighting(&sighting(seen)));
        }
        each(step, filter);
    }
}

/// Flies on to the end: the verdicts, and the errors of the shipped pose at every step.
pub fn track(
    filter: &mut LandmarkFilter,
    flight: &LandmarkFlight,
) -> (Vec<(SeenLandmark, SightingVerdict)>, Track) {
    let (mut verdicts, mut errors) = (Vec::new(), Vec::new());
    fly(
        filter,
        flight,
        |seen, v| verdicts.push((*seen, v)),
        |step, f| errors.push((step.truth.t_s, error_of(&step.truth, f.pose()))),
    );
    (verdicts, errors)
}

/// Without a pose it is as large as can be.
pub fn error_of(truth: &Truth, pose: Option<LandmarkPose>) -> Error {
    pose.map_or([f64::INFINITY; 2], |p| error(truth, &p.position_ned, &p.r_body_to_ned))
}

/// Errors of the H∞ filter and of the shipped pose, at every `every`th step.
pub fn errors(case: &Case<'_>, every: usize) -> (Track, Track) {
    let flight = case.flight();
    let mut filter = case.filter(&flight);
    let (mut hinf, mut refined, mut k) = (Vec::new(), Vec::new(), 0);
    fly(
        &mut filter,
        &flight,
        |_, _| {},
        |step, filter| {
            k += 1;
            if k % every == 0 {
                hinf.push((step.truth.t_s, error_of(&step.truth, filter.acquiring_pose())));
                refined.push((step.truth.t_s, error_of(&step.truth, filter.pose())));
            }
        },
    );
    (hinf, refined)
}

/// Errors of an extended Kalman filter with the same rows, noise, gate and memory, linearised about itself.
pub fn ekf_errors(case: &Case<'_>, every: usize) -> Track {
    let flight = case.flight();
    let (p, r) = case.start(&flight);
    let (map, camera, settings) = (case.map(), landmark_camera(&case.camera), case.settings);
    let mut reckoning = DeadReckoning::new(stamp(0.0), settings.history_s, settings.gap_s, settings.motions);
    let n = r.transpose();
    let start = Rigid { centroid_d: n * (map.centroid() - p), r_to_d: n };
    let guess = case.guess(&flight);
    let mut ekf = Refined::new(start, guess.attitude_sigma_rad, guess.position_sigma_m);
    let mut out = Vec::new();
    let mut next = flight.seen.iter().peekable();
    for (k, step) in flight.steps.iter().enumerate() {
        reckoning.push(stamp(step.truth.t_s), &motion(step));
        let at = reckoning.present();
        ekf.drift(STEP_S, &at.position_d, &settings);
        if k % 10 == 0 {
            ekf.gravity(&(at.r_body_to_d * step.down_body), settings.gravity_sigma_rad);
        }
        while let Some(seen) = next.next_if(|s| s.heard_s <= step.truth.t_s + 1e-9) {
            let (Some(q), Ok(then)) = (map.get(seen.id), reckoning.at(stamp(seen.taken_s))) else { continue };
            let direction = camera.towards(seen.angle_xy).raw().normalize();
            let offset = q - map.centroid();
            let seen = SeenInD {
                landmark: offset,
                direction_d: then.r_body_to_d * direction,
                camera_d: then.position_d + then.r_body_to_d * camera.mount.lever_arm.raw(),
                distance: None,
            };
            let about = *ekf.state();
            ekf.sighting(&seen, &offset, &about, &settings);
        }
        if (k + 1) % every == 0 {
            let (position, r, _) = ekf.pose(&at, &map.centroid());
            out.push((step.truth.t_s, error(&step.truth, &position, &r)));
        }
    }
    out
}

/// Since when a run is within `limits` to its end; `None` when it is not from `by_s` on.
pub fn converged_at(errors: &[(f64, Error)], limits: Error, by_s: f64) -> Option<f64> {
    let within = |e: &Error| e[0] <= limits[0] && e[1] <= limits[1];
    let last_out = errors.iter().rposition(|(_, e)| !within(e));
    let since = last_out.map_or(Some(0.0), |i| errors.get(i + 1).map(|(t, _)| *t))?;
    (since <= by_s).then_some(since)
}

/// Root mean square from `from_s` on.
pub fn rms(errors: &[(f64, Error)], from_s: f64) -> Error {
    let late: Vec<&Error> = errors.iter().filter(|(t, _)| *t >= from_s).map(|(_, e)| e).collect();
    std::array::from_fn(|i| (late.iter().map(|e| e[i] * e[i]).sum::<f64>() / late.len() as f64).sqrt())
}
