//! Markers on the ground, and a camera on a drone that sees some of them, late, and sometimes takes one for another.
//!
//! The dead reckoning's input comes from here as well: velocity and rate in body axes that lead exactly from one pose to the next when they
//! are held, then noise and bias on them.

use nalgebra::{Matrix3, Vector3};

use super::noise::{SensorRng, Stream};
use super::trajectory::{Trajectory, Truth};
use crate::geo::so3::{exp, left_jacobian, log};
use crate::geo::{Body, CameraMount};

/// Markers with their ids, NED, m.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerField {
    /// The markers.
    pub markers: Vec<(u8, Vector3<f64>)>,
}

impl MarkerField {
    /// Evenly spread over a square of ±`half_m` about the origin and up to `height_m` above the ground (0: coplanar).
    pub fn scattered(seed: u64, count: u8, half_m: f64, height_m: f64) -> Self {
        let mut rng = SensorRng::new(seed, Stream::LandmarkStart);
        let mut marker = |id| {
            let (n, e) = (rng.between(-half_m, half_m), rng.between(-half_m, half_m));
            (id, Vector3::new(n, e, -rng.between(0.0, height_m)))
        };
        Self { markers: (0..count).map(&mut marker).collect() }
    }

    /// A row of markers eastwards.
    pub fn row(count: u8, spacing_m: f64) -> Self {
        let middle = 0.5 * f64::from(count.saturating_sub(1));
        let at = |id: u8| Vector3::new(0.5, (f64::from(id) - middle) * spacing_m, 0.0);
        Self { markers: (0..count).map(|id| (id, at(id))).collect() }
    }
}

/// A camera that knows markers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerCamera {
    /// Where and how it sits.
    pub mount: CameraMount,
    /// Half of the field of view along the image's right and down, rad.
    pub half_field_of_view_rad: [f64; 2],
    /// Pictures every so many steps of the flight.
    pub every: usize,
    /// σ of the direction, each of two, rad.
    pub bearing_sigma_rad: f64,
    /// From the picture to the word of it, s.
    pub delay_s: f64,
    /// On top of it, evenly distributed up to this, s.
    pub jitter_s: f64,
    /// Probability that a sighting is lost.
    pub dropout: f64,
    /// Probability that a marker is taken for another.
    pub wrong_ids: f64,
}

impl MarkerCamera {
    /// Looks down with a wide lens, 10 pictures a second at 50 steps a second, 0.015 rad.
    pub fn downward() -> Self {
        Self {
            mount: CameraMount {
                lever_arm: Body::new(Vector3::new(0.1, 0.0, 0.05)),
                ..CameraMount::downward()
            },
            half_field_of_view_rad: [1.1, 1.1],
            every: 5,
            bearing_sigma_rad: 0.015,
            delay_s: 0.0,
            jitter_s: 0.0,
            dropout: 0.0,
            wrong_ids: 0.0,
        }
    }
}

/// Errors of the dead reckoning's input, each axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionNoise {
    /// White noise of the velocity at each step, m/s.
    pub velocity_mps: f64,
    /// Constant error of it, m/s.
    pub velocity_bias_mps: f64,
    /// White noise of the rate at each step, rad/s.
    pub rate_radps: f64,
    /// Constant error of it, rad/s.
    pub rate_bias_radps: f64,
    /// White noise of the direction of gravity, rad.
    pub gravity_rad: f64,
}

impl MotionNoise {
    /// None.
    pub const NONE: Self = Self {
        velocity_mps: 0.0,
        velocity_bias_mps: 0.0,
        rate_radps: 0.0,
        rate_bias_radps: 0.0,
        gravity_rad: 0.0,
    };

    /// What an aligned filter leaves of flow and a consumer gyro.
    pub fn mems() -> Self {
        Self {
            velocity_mps: 0.05,
            velocity_bias_mps: 0.01,
            rate_radps: 0.01,
            rate_bias_radps: 0.001,
            gravity_rad: 0.03,
        }
    }
}

/// A step of the flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LandmarkStep {
    /// Truth at its end.
    pub truth: Truth,
    /// Velocity as measured over it, body axes at its beginning, m/s.
    pub velocity_body: Vector3<f64>,
    /// Rate as measured over it, rad/s.
    pub angular_rate_body: Vector3<f64>,
    /// Direction of gravity in the body at its end, as measured.
    pub down_body: Vector3<f64>,
}

/// A marker as it was seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenLandmark {
    /// When the picture was taken, s.
    pub taken_s: f64,
    /// When it is heard of, s.
    pub heard_s: f64,
    /// Which marker it is said to be.
    pub id: u8,
    /// Whether that is true.
    pub is_right: bool,
    /// Angles from the optical axis to the image's right and down, rad.
    pub angle_xy: [f64; 2],
}

/// A flight over markers: steps in order, sightings in the order in which they are heard of.
#[derive(Clone, Debug, PartialEq)]
pub struct LandmarkFlight {
    /// Truth at the start.
    pub start: Truth,
    /// The steps, the first from 0 to one step's time.
    pub steps: Vec<LandmarkStep>,
    /// The sightings.
    pub seen: Vec<SeenLandmark>,
}

impl LandmarkFlight {
    /// Flies `duration_s` in steps of `step_s`.
    pub fn fly(
        trajectory: &(impl Trajectory + ?Sized),
        field: &MarkerField,
        camera: &MarkerCamera,
        noise: &MotionNoise,
        [step_s, duration_s]: [f64; 2],
        seed: u64,
    ) -> Self {
        let mut rng = SensorRng::new(seed, Stream::LandmarkMotion);
        let velocity_bias = rng.signed3(&Vector3::from_element(noise.velocity_bias_mps));
        let rate_bias = rng.signed3(&Vector3::from_element(noise.rate_bias_radps));
        let mut eye = SensorRng::new(seed, Stream::Landmarks);
        let count = (duration_s / step_s).round() as usize;
        let start = trajectory.at(0.0);
        let (mut before, mut steps, mut seen) = (start, Vec::with_capacity(count), Vec::new());
        picture(&start, field, camera, &mut eye, &mut seen);
        for k in 1..=count {
            let truth = trajectory.at(k as f64 * step_s);
            let (velocity, rate) = held(&before, &truth, step_s);
            let gravity = truth.r_body_to_ned.tr_mul(&Vector3::z());
            steps.push(LandmarkStep {
                truth,
                velocity_body: velocity + velocity_bias + noise.velocity_mps * rng.normals(),
                angular_rate_body: rate + rate_bias + noise.rate_radps * rng.normals(),
                down_body: (gravity + noise.gravity_rad * rng.normals()).normalize(),
            });
            if k % camera.every.max(1) == 0 {
                picture(&truth, field, camera, &mut eye, &mut seen);
            }
            before = truth;
        }
        seen.sort_by(|a, b| a.heard_s.total_cmp(&b.heard_s));
        Self { start, steps, seen }
    }
}

/// The velocity and rate that lead from a pose to the next when they are held.
fn held(from: &Truth, to: &Truth, step_s: f64) -> (Vector3<f64>, Vector3<f64>) {
    let turn = log(&from.r_body_to_ned.tr_mul(&to.r_body_to_ned));
    let way = from.r_body_to_ned.tr_mul(&(to.position_ned - from.position_ned));
    let back = left_jacobian(&turn).try_inverse().unwrap_or_else(Matrix3::identity);
    (back * way / step_s, turn / step_s)
}

pub(super) fn picture(
    truth: &Truth,
    field: &MarkerField,
    camera: &MarkerCamera,
    rng: &mut SensorRng,
    seen: &mut Vec<SeenLandmark>,
) {
    let heard_s = truth.t_s + camera.delay_s + camera.jitter_s * rng.between(0.0, 1.0);
    for (id, marker) in &field.markers {
        let in_body =
            Body::new(truth.r_body_to_ned.tr_mul(&(marker - truth.position_ned))) - camera.mount.lever_arm;
        let in_image = camera.mount.camera_to_body.to_camera(in_body).right_down_along();
        let direction = Vector3::from(in_image).normalize();
        let noisy = (direction + camera.bearing_sigma_rad * rng.normals()).normalize();
        let (lost, wrong, other) =
            (rng.chance(camera.dropout), rng.chance(camera.wrong_ids), rng.between(0.0, 1.0));
        let angle_xy = [noisy.x.atan2(noisy.z), noisy.y.atan2(noisy.z)];
        let in_view = (0..2).all(|i| angle_xy[i].abs() <= camera.half_field_of_view_rad[i]);
        if lost || !in_view {
            continue;
        }
        let others: Vec<u8> = field.markers.iter().map(|m| m.0).filter(|i| i != id).collect();
        let mistaken = others.get((other * others.len() as f64) as usize).filter(|_| wrong);
        seen.push(SeenLandmark {
            taken_s: truth.t_s,
            heard_s,
            id: *mistaken.unwrap_or(id),
            is_right: mistaken.is_none(),
            angle_xy,
        });
    }
}

/// A pose that is wrong: by a normal 1 σ of `position_m` each axis, and by an angle about a random axis, or by any angle up to half a turn.
pub fn wrong_start(
    truth: &Truth,
    position_m: f64,
    attitude_rad: Option<f64>,
    seed: u64,
) -> (Vector3<f64>, Matrix3<f64>) {
    let mut rng = SensorRng::new(seed, Stream::LandmarkStart);
    let axis = rng.normals().try_normalize(1e-9).unwrap_or_else(Vector3::z);
    let any = rng.between(0.0, std::f64::consts::PI);
    let turn = exp(&(axis * attitude_rad.unwrap_or(any)));
    (truth.position_ned + position_m * rng.normals(), turn * truth.r_body_to_ned)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::Wander;

    fn flight(camera: &MarkerCamera, noise: &MotionNoise) -> LandmarkFlight {
        let field = MarkerField::scattered(5, 10, 4.0, 1.3);
        LandmarkFlight::fly(&Wander::over_field(0.2), &field, camera, noise, [0.02, 40.0], 3)
    }

    #[test]
    fn held_motions_lead_from_pose_to_pose() {
        let f = flight(&MarkerCamera::downward(), &MotionNoise::NONE);
        let (mut p, mut r) = (f.start.position_ned, f.start.r_body_to_ned);
        for s in &f.steps {
            let turn = s.angular_rate_body * 0.02;
            p += r * left_jacobian(&turn) * s.velocity_body * 0.02;
            r *= exp(&turn);
            assert!((p - s.truth.position_ned).norm() < 1e-9 && (r - s.truth.r_body_to_ned).norm() < 1e-9);
        }
    }

    #[test]
    fn loss_mistakes_and_delays_are_as_often_and_long_as_told() {
        let all = flight(&MarkerCamera::downward(), &MotionNoise::NONE).seen;
        assert!(all.len() > 2000 && all.iter().all(|s| s.is_right && s.heard_s == s.taken_s));
        let camera = MarkerCamera {
            dropout: 0.4,
            wrong_ids: 0.1,
            delay_s: 0.1,
            jitter_s: 0.2,
            ..MarkerCamera::downward()
        };
        let some = flight(&camera, &MotionNoise::NONE).seen;
        let part = some.len() as f64 / all.len() as f64;
        assert!((part - 0.6).abs() < 0.03, "{part}");
        let wrong = some.iter().filter(|s| !s.is_right).count() as f64 / some.len() as f64;
        assert!((wrong - 0.1).abs() < 0.02, "{wrong}");
        let delays = some.iter().map(|s| s.heard_s - s.taken_s);
        assert!(delays.clone().all(|d| (0.1..0.3 + 1e-9).contains(&d)) && delays.clone().any(|d| d > 0.28));
        assert!(some.windows(2).any(|w| w[0].taken_s > w[1].taken_s), "some overtake others");
    }
}
