//! One centred patch of optical flow: two components of the body velocity.
//!
//! Flow and rotation angles are right-handed about the x and y axes of the [camera's frame](crate::geo::Camera), as in MAVLink's
//! OPTICAL_FLOW_RAD.
//!
//! For a centred patch (x = y = 0) Fusini (3)-(4) becomes, per integration time Δt and distance d along the optical axis,
//! v_x = d (i_y − g_y)/Δt, v_y = −d (i_x − g_x)/Δt: the flow less the rotation, times the distance. It does not see v_z.

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3};
use std::f64::consts::FRAC_PI_2;

use super::refusal::FlowRefusal;
use crate::geo::CameraMount;

/// What one message about a patch says (OPTICAL_FLOW_RAD), SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowPatch {
    /// Δt, s.
    pub integration_time_s: f64,
    /// i: flow about the camera's x and y axes, integrated over Δt, rad.
    pub flow_rad: Vector2<f64>,
    /// g: rotation about the same axes over the same Δt, rad. From the sensor's own gyro, or better from the IMU with its bias removed.
    pub rotation_rad: Vector2<f64>,
    /// Mean body rate over Δt, rad/s, bias removed: for the lever arm.
    pub body_rate: Vector3<f64>,
    /// Distance to the ground along the optical axis, m, if measured.
    pub distance_m: Option<f64>,
    /// Height of the camera over the ground, m, used with the tilt where there is no distance.
    pub height_m: Option<f64>,
    /// Quality in [0, 1].
    pub quality: f64,
}

/// Bounds outside which a patch is refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchLimits {
    /// Largest angle of the optical axis from straight down, rad.
    pub max_tilt_rad: f64,
    /// Nearest distance at which the image is sharp, m.
    pub min_distance_m: f64,
    /// Farthest distance at which its texture carries, m.
    pub max_distance_m: f64,
    /// Least quality, in [0, 1].
    pub min_quality: f64,
    /// Shortest believable Δt, s.
    pub min_integration_s: f64,
    /// Longest believable Δt, s.
    pub max_integration_s: f64,
}

impl Default for PatchLimits {
    fn default() -> Self {
        Self {
            max_tilt_rad: 40f64.to_radians(),
            min_distance_m: 0.3,
            max_distance_m: 250.0,
            min_quality: 0.2,
            min_integration_s: 1e-3,
            max_integration_s: 0.5,
        }
    }
}

/// Standard deviations behind the covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchNoise {
    /// Of the flow angle of one message and axis, rad.
    pub flow_rad: f64,
    /// Of the rotation angle of one message and axis, rad.
    pub rotation_rad: f64,
    /// Of the distance, m.
    pub distance_m: f64,
    /// Of the distance, as a fraction of it (scale errors of flow belong here, too).
    pub distance_fraction: f64,
}

impl Default for PatchNoise {
    fn default() -> Self {
        Self { flow_rad: 1.5e-3, rotation_rad: 3e-4, distance_m: 0.05, distance_fraction: 0.03 }
    }
}

/// Velocity of the body's origin seen by one patch: two components, in the camera's x and y axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowVelocity {
    /// Components of the body origin's velocity along the camera's x and y, m/s.
    pub velocity_camera: Vector2<f64>,
    /// Their covariance, m²/s².
    pub covariance: Matrix2<f64>,
    /// H: the camera's x and y axes seen from the body, so that `velocity_camera` = H v_body.
    pub body_to_measurement: Matrix2x3<f64>,
    /// Distance along the optical axis that was used, m.
    pub distance_m: f64,
    axis_body: Vector3<f64>,
}

impl FlowVelocity {
    /// The full body velocity, m/s, when the component along the optical axis (m/s, positive towards the ground for a camera that
    /// looks down) is taken from elsewhere: the observer's own, or a climb rate.
    pub fn velocity_body(&self, along_axis_mps: f64) -> Vector3<f64> {
        self.body_to_measurement.transpose() * self.velocity_camera + self.axis_body * along_axis_mps
    }
}

/// Translation of a centred patch, m/s in the camera's x and y: [d (i_y − g_y)/Δt, −d (i_x − g_x)/Δt].
pub fn patch_velocity(
    flow_rad: &Vector2<f64>,
    rotation_rad: &Vector2<f64>,
    dt_s: f64,
    distance_m: f64,
) -> Vector2<f64> {
    let u = flow_rad - rotation_rad;
    Vector2::new(u.y, -u.x) * (distance_m / dt_s)
}

/// The velocity of the body's origin from one patch.
///
/// The camera moves with v_body + ω × l (lever arm l), so R(ω × l) is taken off. Without a measured distance d = h / cos(tilt) over level
/// ground. The covariance is (d/Δt)² (σ_flow² + σ_rotation²) I + (v/d)(v/d)ᵀ σ_d², v the camera's own velocity: angular noise is
/// isotropic, distance noise stretches along the motion.
///
/// # Errors
/// [`FlowRefusal`] says why there is none.
pub fn solve(
    patch: &FlowPatch,
    mount: &CameraMount,
    r_body_to_ned: &Matrix3<f64>,
    limits: &PatchLimits,
    noise: &PatchNoise,
) -> Result<FlowVelocity, FlowRefusal> {
    let dt = patch.integration_time_s;
    let sum = patch.flow_rad.abs().sum() + patch.rotation_rad.abs().sum() + patch.body_rate.abs().sum();
    if !(dt + sum + patch.quality + r_body_to_ned.sum()).is_finite() {
        return Err(FlowRefusal::NotFinite);
    }
    if !(limits.min_integration_s..=limits.max_integration_s).contains(&dt) || dt <= 0.0 {
        return Err(FlowRefusal::IntegrationTime(dt));
    }
    if patch.quality < limits.min_quality {
        return Err(FlowRefusal::Quality(patch.quality));
    }
    let cos_tilt = mount.cos_tilt(r_body_to_ned).clamp(-1.0, 1.0);
    let tilt = cos_tilt.acos();
    if tilt > limits.max_tilt_rad.min(FRAC_PI_2 - 0.05) {
        return Err(FlowRefusal::Tilt(tilt));
    }
    let distance = match (patch.distance_m, patch.height_m) {
        (Some(d), _) => d,
        (None, Some(h)) => h / cos_tilt,
        (None, None) => return Err(FlowRefusal::DistanceMissing),
    };
    // A NaN is not contained, either.
    if !(limits.min_distance_m..=limits.max_distance_m).contains(&distance) || distance <= 0.0 {
        return Err(FlowRefusal::Distance(distance));
    }
    let h = mount.camera_to_body.matrix().fixed_columns::<2>(0).transpose();
    let camera = patch_velocity(&patch.flow_rad, &patch.rotation_rad, dt, distance);
    let lever = h * patch.body_rate.cross(&mount.lever_arm.raw());
    let angular = (distance / dt).powi(2) * (noise.flow_rad.powi(2) + noise.rotation_rad.powi(2));
    let sigma_d2 = noise.distance_m.powi(2) + (noise.distance_fraction * distance).powi(2);
    let per_metre = camera / distance;
    Ok(FlowVelocity {
        velocity_camera: camera - lever,
        covariance: Matrix2::identity() * angular + per_metre * per_metre.transpose() * sigma_d2,
        body_to_measurement: h,
        distance_m: distance,
        axis_body: mount.axis().raw(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::so3::{self, Euler};
    use crate::geo::{Body, CameraToBody};
    use proptest::prelude::*;

    fn patch() -> FlowPatch {
        FlowPatch {
            integration_time_s: 0.05,
            flow_rad: Vector2::new(0.01, 0.02),
            rotation_rad: Vector2::zeros(),
            body_rate: Vector3::zeros(),
            distance_m: Some(20.0),
            height_m: None,
            quality: 0.9,
        }
    }

    fn solve_level(p: &FlowPatch) -> Result<FlowVelocity, FlowRefusal> {
        solve(
            p,
            &CameraMount::downward(),
            &Matrix3::identity(),
            &PatchLimits::default(),
            &PatchNoise::default(),
        )
    }

    /// Flow of a ground point on the optical axis, from its motion in the camera frame: the truth the solver must invert.
    fn exact_patch(
        mount: &CameraMount,
        r: &Matrix3<f64>,
        v_body: &Vector3<f64>,
        w: &Vector3<f64>,
        height: f64,
    ) -> FlowPatch {
        let dt = 0.02;
        let d = height / mount.cos_tilt(r);
        let w_camera = mount.camera_to_body.to_camera(Body::new(*w)).raw();
        let v_camera =
            mount.camera_to_body.to_camera(Body::new(v_body + w.cross(&mount.lever_arm.raw()))).raw();
        // A static point at [0, 0, d] moves with −v − ω × x; its direction turns with (−v_x/d − ω_y, −v_y/d + ω_x), and the angles about
        // x and y that the sensor integrates are those of the camera: i_x = ω_x − v_y/d, i_y = ω_y + v_x/d.
        FlowPatch {
            integration_time_s: dt,
            flow_rad: dt * Vector2::new(w_camera.x - v_camera.y / d, w_camera.y + v_camera.x / d),
            rotation_rad: dt * w_camera.xy(),
            body_rate: *w,
            distance_m: None,
            height_m: Some(height),
            quality: 1.0,
        }
    }

    proptest! {
        #[test]
        fn mounting_lever_arm_tilt_and_rotation_are_undone(
            v in [-20.0..20.0, -20.0..20.0, -5.0..5.0f64], w in [-1.0..1.0, -1.0..1.0, -1.0..1.0f64],
            l in [-1.0..1.0, -1.0..1.0, -0.3..0.3f64], mounting in [-0.3..0.3, -0.3..0.3, -3.0..3.0f64],
            roll in -0.25..0.25f64, pitch in -0.25..0.25f64, height in 2.0..150.0f64) {
            let turned = so3::exp(&Vector3::new(mounting[0], mounting[1], 0.0)) * so3::exp(&Vector3::new(0.0, 0.0, mounting[2]));
            let mount = CameraMount { camera_to_body: CameraToBody::from_matrix(&turned), lever_arm: Body::new(Vector3::from(l)) };
            let r = Euler::new(roll, pitch, 1.0).to_rotation();
            let (v, w) = (Vector3::from(v), Vector3::from(w));
            let p = exact_patch(&mount, &r, &v, &w, height);
            let limits = PatchLimits { max_tilt_rad: 1.2, max_distance_m: 1e3, ..PatchLimits::default() };
            let out = solve(&p, &mount, &r, &limits, &PatchNoise::default()).unwrap();
            prop_assert!((out.velocity_camera - out.body_to_measurement * v).norm() < 1e-9);
            prop_assert!((out.velocity_body(v.dot(&mount.axis().raw())) - v).norm() < 1e-9);
            prop_assert!(out.covariance.cholesky().is_some());
        }

        #[test]
        fn arbitrary_numbers_give_a_finite_velocity_or_a_reason(x in proptest::array::uniform9(proptest::num::f64::ANY)) {
            let p = FlowPatch {
                integration_time_s: x[0], flow_rad: Vector2::new(x[1], x[2]), rotation_rad: Vector2::new(x[3], x[4]),
                body_rate: Vector3::new(x[5], x[5], x[6]), distance_m: Some(x[7]), height_m: None, quality: x[8],
            };
            if let Ok(out) = solve_level(&p) {
                prop_assert!(!out.velocity_camera.x.is_nan() && !out.velocity_camera.y.is_nan());
            }
        }
    }

    #[test]
    fn the_covariance_is_that_of_perturbed_measurements() {
        let noise =
            PatchNoise { flow_rad: 1e-3, rotation_rad: 5e-4, distance_m: 0.1, distance_fraction: 0.02 };
        let p = patch();
        let v = |p: &FlowPatch| {
            solve(p, &CameraMount::downward(), &Matrix3::identity(), &PatchLimits::default(), &noise).unwrap()
        };
        let base = v(&p);
        let sigma_d = (noise.distance_m.powi(2) + (0.02f64 * 20.0).powi(2)).sqrt();
        let mut sum = Matrix2::zeros();
        let mut add = |q: &FlowPatch| {
            let d = v(q).velocity_camera - base.velocity_camera;
            sum += d * d.transpose();
        };
        for axis in 0..2 {
            let mut q = p;
            q.flow_rad[axis] += noise.flow_rad;
            add(&q);
            let mut q = p;
            q.rotation_rad[axis] += noise.rotation_rad;
            add(&q);
        }
        add(&FlowPatch { distance_m: Some(20.0 + sigma_d), ..p });
        assert!((sum - base.covariance).norm() < 1e-12 * sum.norm());
    }

    #[test]
    fn refusals_carry_their_reason() {
        let p = patch();
        assert_eq!(solve_level(&FlowPatch { quality: 0.1, ..p }), Err(FlowRefusal::Quality(0.1)));
        assert_eq!(solve_level(&FlowPatch { distance_m: None, ..p }), Err(FlowRefusal::DistanceMissing));
        assert_eq!(solve_level(&FlowPatch { distance_m: Some(0.0), ..p }), Err(FlowRefusal::Distance(0.0)));
        assert_eq!(solve_level(&FlowPatch { distance_m: Some(1e4), ..p }), Err(FlowRefusal::Distance(1e4)));
        assert!(matches!(
            solve_level(&FlowPatch { distance_m: Some(f64::NAN), ..p }),
            Err(FlowRefusal::Distance(_))
        ));
        for dt in [0.0, -0.01, 3.0] {
            assert_eq!(
                solve_level(&FlowPatch { integration_time_s: dt, ..p }),
                Err(FlowRefusal::IntegrationTime(dt))
            );
        }
        let nan = FlowPatch { flow_rad: Vector2::new(f64::NAN, 0.0), ..p };
        assert_eq!(solve_level(&nan), Err(FlowRefusal::NotFinite));
        for roll in [0.8, 3.0] {
            let r = Euler::new(roll, 0.0, 0.0).to_rotation();
            let out =
                solve(&p, &CameraMount::downward(), &r, &PatchLimits::default(), &PatchNoise::default());
            assert!(matches!(out, Err(FlowRefusal::Tilt(t)) if (t - roll).abs() < 1e-9));
        }
    }
}
