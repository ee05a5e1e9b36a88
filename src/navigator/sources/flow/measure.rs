//! A flow as a velocity of the body, before its systematic errors are taken out.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use crate::camera::{FlowPatch, FlowRefusal, PatchNoise, single_patch};
use crate::geo::Body;
use crate::sample::{FlowRotation, FlowSample};
use crate::time::{AutopilotTime, Span};

use super::super::super::context::Context;
use super::super::super::timeline::CORRECTED_S;
use super::super::super::verdict::Reason;
use super::super::takeoff::Ground;
use crate::navigator::tuning::flow_measure::{
    CLIMB_SIGMA_MPS, DISTANCE_SIGMA_M, DISTANCE_TOLERANCE, DISTANCE_TOLERANCE_M, LARGEST_DOUBT,
    RATE_INTERVAL_S,
};

/// What has been learned of a sensor besides its calibration.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FlowCorrection {
    /// Age of its samples beyond their stamp, s.
    pub(super) delay_s: f64,
    /// Bias of its own gyro, camera x and y, rad/s.
    pub(super) gyro_offset: Vector2<f64>,
}

/// What a sensor's own gyro tells more than the vehicle's.
pub(super) fn gyro_offset(s: &FlowSample, rate_camera: &Vector3<f64>) -> Option<Vector2<f64>> {
    match s.rotation {
        FlowRotation::SensorGyro([x, y]) => Some(Vector2::new(x, y) - rate_camera.xy()),
        FlowRotation::Contained | FlowRotation::Removed | FlowRotation::InOwnUnit => None,
    }
}

/// The middle of a flow's interval.
pub(super) struct FlowMoment {
    pub(super) time: AutopilotTime,
    pub(super) r_body_to_ned: Matrix3<f64>,
    /// Mean over the interval, bias removed.
    pub(super) rate_body: Vector3<f64>,
}

/// A flow velocity before calibration.
pub(in super::super::super) struct MeasuredFlow {
    pub(in super::super::super) time: AutopilotTime,
    pub(in super::super::super) r_body_to_ned: Matrix3<f64>,
    /// Body x and y, m/s.
    pub(in super::super::super) v_xy: Vector2<f64>,
    pub(in super::super::super) noise: Matrix2<f64>,
    /// Of the ground along the optical axis, m.
    pub(in super::super::super) distance_m: f64,
    /// Body z and its variance, where the image observes it by itself.
    pub(super) v_z: Option<(f64, f64)>,
    pub(in super::super::super) interval_s: f64,
    /// The distance came from a rangefinder.
    pub(in super::super::super) ranged: bool,
    /// What is doubtful about the distance, as a part of it, 1 sigma: for as long as it is not measured.
    pub(super) relative_sigma: f64,
    /// What the sensor's own gyro tells more than the vehicle's, camera x and y, rad/s, where it has one.
    pub(super) gyro_offset: Option<Vector2<f64>>,
}

impl MeasuredFlow {
    /// The body velocity whose x and y are `v_xy` and whose vertical part is the climb rate; body z is weighted with the image's own
    /// where it observes that.
    pub(super) fn in_body(&self, v_xy: &Vector2<f64>, climb_mps: f64) -> Vector3<f64> {
        let down = self.r_body_to_ned.row(2);
        let v_down = -climb_mps;
        let z = (v_down - down[0] * v_xy.x - down[1] * v_xy.y) / down[2].max(0.1);
        let z = self.v_z.map_or(z, |(own, variance)| {
            let climb = CLIMB_SIGMA_MPS * CLIMB_SIGMA_MPS;
            (own * climb + z * variance) / (climb + variance)
        });
        Vector3::new(v_xy.x, v_xy.y, z)
    }
}

/// When a flow was really measured, and how the body stood and turned then.
pub(super) fn moment(
    stamp: AutopilotTime,
    interval: Span,
    delay_s: f64,
    context: &Context<'_>,
) -> Result<FlowMoment, Reason> {
    let end = stamp - Span::from_seconds(delay_s);
    let begin = end - interval;
    let middle = end - Span::from_micros(interval.micros() / 2);
    let newest = context.now().ok_or(Reason::NoReferenceYet)?;
    // A sample a little ahead of the IMU stream is as good as its newest attitude.
    let time = middle.min(newest);
    if newest.seconds_since(time) > CORRECTED_S {
        return Err(Reason::Late);
    }
    let timeline = &context.core.timeline;
    let r_body_to_ned = timeline.attitude(time).ok_or(Reason::NoReferenceYet)?;
    let rate_body = timeline
        .mean_rate(begin.min(newest), end.min(newest))
        .unwrap_or(context.core.attitude.angular_rate_body);
    Ok(FlowMoment { time, r_body_to_ned, rate_body })
}

/// The rotation that is in a flow's rates, camera x and y, rad/s, if it is in them.
pub(super) fn rotation_in(s: &FlowSample, delay_s: f64, context: &Context<'_>) -> Option<Vector2<f64>> {
    match s.rotation {
        FlowRotation::SensorGyro([x, y]) => Some(Vector2::new(x, y)),
        FlowRotation::Contained | FlowRotation::InOwnUnit => {
            let rate_body = moment(s.time, s.interval, delay_s, context).ok()?.rate_body;
            Some(context.core.settings.flow.mount.camera_to_body.to_camera(Body::new(rate_body)).raw().xy())
        }
        FlowRotation::Removed => None,
    }
}

/// Distance along the optical axis if it is measured, and else the height over ground. The rangefinder's own message comes with
/// limits and is checked; the distance in the flow's message is taken only where there is no rangefinder, and where it does not
/// contradict the height. A rangefinder that is disputed or convicted is not asked: the distance is the height over the ground where it was
/// last seen then, and may be wrong by as much as the two are apart.
pub(super) fn distance(s: &FlowSample, cosine: f64, context: &Context<'_>) -> FlowDistance {
    let (core, facts) = (context.core, &context.facts);
    let height = core.height.height_m().zip(facts.ground).map(|(height, ground)| height - ground.height_m);
    let undisputed = facts.range.filter(|_| facts.disputed_ratio.is_none());
    let ranged = undisputed.filter(|(t, _)| s.time.seconds_since(*t).abs() < core.settings.range_max_age_s);
    let measured = match ranged {
        // The beam points along body z.
        Some((_, d)) => Some(d * core.attitude.r_body_to_ned[(2, 2)] / cosine.max(0.1)),
        None if facts.rangefinder_heard => None,
        None => s.distance_m.filter(|d| {
            height.is_none_or(|h| (d * cosine - h).abs() < DISTANCE_TOLERANCE_M.max(DISTANCE_TOLERANCE * h))
        }),
    };
    let doubt = facts.disputed_ratio.map_or(0.0, |ratio| (1.0 - ratio).abs().min(LARGEST_DOUBT));
    let known = |(ground, h): (Ground, f64)| ground.sigma_m.hypot(core.height.height_sigma_m()) / h.max(1e-3);
    let terrain = facts.ground.zip(height).map_or(0.0, known);
    FlowDistance {
        measured_m: measured,
        height_m: height,
        relative_sigma: if ranged.is_some() { 0.0 } else { doubt.hypot(terrain).min(LARGEST_DOUBT) },
    }
}

/// How far away the ground is.
#[derive(Clone, Copy, Debug)]
pub(super) struct FlowDistance {
    /// Along the optical axis, where it is measured, m.
    pub(super) measured_m: Option<f64>,
    /// The height over ground, m.
    pub(super) height_m: Option<f64>,
    /// What is doubtful about it, as a part of it, 1 sigma.
    pub(super) relative_sigma: f64,
}

/// The flow of one patch as velocity: v_x = d·(ω_flow,y − ω_y), v_y = −d·(ω_flow,x − ω_x) at the camera (spec of OPTICAL_FLOW_RAD), turned
/// to body axes and moved to the IMU. The vertical component, which one patch does not see, is the height filter's climb rate.
pub(super) fn of_patch(
    s: &FlowSample,
    interval_s: f64,
    correction: &FlowCorrection,
    context: &Context<'_>,
) -> Result<MeasuredFlow, Reason> {
    let settings = &context.core.settings.flow;
    let [rate_x, rate_y] = s.rate_xy;
    if !(rate_x.is_finite() && rate_y.is_finite() && s.quality.is_finite()) {
        return Err(Reason::NotFinite);
    }
    let FlowMoment { time, r_body_to_ned: r, rate_body } =
        moment(s.time, s.interval, correction.delay_s, context)?;
    let mount = &settings.mount;
    let cosine = mount.cos_tilt(&r);
    let FlowDistance { measured_m: distance_m, height_m, relative_sigma } = distance(s, cosine, context);
    // A message that gives a rate is a flow over any interval.
    let dt = if s.interval > Span::ZERO { s.interval.seconds() } else { RATE_INTERVAL_S };
    let rate_camera = mount.camera_to_body.to_camera(Body::new(rate_body)).raw();
    let rotation = match s.rotation {
        FlowRotation::SensorGyro([x, y]) => Vector2::new(x, y) - correction.gyro_offset,
        FlowRotation::Contained | FlowRotation::InOwnUnit => rate_camera.xy(),
        FlowRotation::Removed => Vector2::zeros(),
    };
    let patch = FlowPatch {
        integration_time_s: dt,
        flow_rad: Vector2::new(rate_x, rate_y) * dt,
        rotation_rad: rotation * dt,
        body_rate: rate_body,
        distance_m,
        height_m,
        quality: s.quality,
    };
    let noise = PatchNoise {
        flow_rad: settings.rate_noise_radps * dt,
        rotation_rad: 0.0,
        distance_m: DISTANCE_SIGMA_M,
        distance_fraction: relative_sigma,
    };
    let seen = single_patch::solve(&patch, mount, &r, &settings.limits, &noise)?;
    let v_body = body_velocity(&seen, &r, context.core.height.climb_mps())?;
    Ok(MeasuredFlow {
        time,
        r_body_to_ned: r,
        v_xy: v_body.xy(),
        noise: seen.covariance,
        distance_m: distance_m.or(height_m.map(|h| h / cosine.max(0.1))).unwrap_or_default(),
        v_z: None,
        interval_s,
        ranged: distance_m.is_some(),
        relative_sigma,
        gyro_offset: gyro_offset(s, &rate_camera),
    })
}

/// The body's velocity: two rows from the camera, one from the climb rate.
fn body_velocity(
    seen: &single_patch::FlowVelocity,
    r: &Matrix3<f64>,
    climb_mps: f64,
) -> Result<Vector3<f64>, Reason> {
    let c = &seen.body_to_measurement;
    let rows = Matrix3::from_rows(&[c.row(0).into_owned(), c.row(1).into_owned(), r.row(2).into_owned()]);
    let v = &seen.velocity_camera;
    let v_body = rows.try_inverse().ok_or(Reason::Tilt)? * Vector3::new(v.x, v.y, -climb_mps);
    if v_body.iter().all(|v| v.is_finite()) { Ok(v_body) } else { Err(Reason::NotFinite) }
}

impl From<FlowRefusal> for Reason {
    fn from(refusal: FlowRefusal) -> Self {
        match refusal {
            FlowRefusal::NotFinite => Reason::NotFinite,
            FlowRefusal::IntegrationTime(_)
            | FlowRefusal::Distance(_)
            | FlowRefusal::Height(_)
            | FlowRefusal::FocalLength(_) => Reason::OutOfRange,
            FlowRefusal::Quality(_) => Reason::LowQuality,
            FlowRefusal::Tilt(_) | FlowRefusal::Horizon => Reason::Tilt,
            FlowRefusal::DistanceMissing => Reason::NoDistance,
            FlowRefusal::TooFew(_) | FlowRefusal::Rank(_) | FlowRefusal::Condition(_) => Reason::Unobservable,
            FlowRefusal::Residual(_) | FlowRefusal::Consensus { .. } => Reason::Inconsistent,
        }
    }
}
