//! Patches of one image, one message each: gathered by their stamp and solved together, Fusini (3).
//!
//! An image is solved when its last patch has come, when a patch of a later image comes, or when the rest is not there after a moment:
//! with what there is. Where the patches lie so that they observe all three components of the velocity, those are taken; else the height
//! filter's climb rate is one more equation, as it is for a single patch.

use nalgebra::{Vector2, Vector3};

use crate::camera::features::rotational_flow;
use crate::camera::{
    Feature, FlowRefusal, KnownComponent, Method, SolveLimits, SolveNoise, View, solve_velocity,
};
use crate::geo::Body;
use crate::sample::{FlowRotation, FlowSample};
use crate::time::AutopilotTime;

use super::super::super::context::Context;
use super::super::super::settings::FlowSettings;
use super::super::super::verdict::{Reason, Verdict};
use super::measure::{FlowCorrection, FlowDistance, MeasuredFlow, distance, gyro_offset, moment};
use crate::navigator::tuning::flow_image::{MAX_DILUTION, TOGETHER, WAIT};
use crate::navigator::tuning::flow_measure::{CLIMB_SIGMA_MPS, DISTANCE_SIGMA_M};

/// The patches of the image that is coming in.
#[derive(Clone, Debug)]
pub(in super::super::super) struct ImageAssembly {
    samples: Vec<FlowSample>,
    /// Newest IMU stamp when the first one came.
    since: Option<AutopilotTime>,
    /// Stamp of the last image that was solved.
    solved: Option<AutopilotTime>,
}

/// What a patch does to the images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super::super) enum PatchArrival {
    /// It belongs to the image that is coming in.
    Fits,
    /// It is of a later one: what waits is solved first.
    Later,
}

impl ImageAssembly {
    pub(super) fn new() -> Self {
        Self { samples: Vec::with_capacity(crate::camera::MAX_PATCHES), since: None, solved: None }
    }

    /// Forgets what waits and how far time has come.
    pub(super) fn clear(&mut self) {
        self.samples.clear();
        self.solved = None;
    }

    /// The stamp of the image that is coming in.
    pub(in super::super::super) fn stamp(&self) -> Option<AutopilotTime> {
        self.samples.first().map(|s| s.time)
    }

    /// Where a patch belongs.
    pub(in super::super::super) fn arrival(
        &self,
        s: &FlowSample,
        settings: &FlowSettings,
    ) -> Result<PatchArrival, Reason> {
        if !(s.rate_xy[0].is_finite() && s.rate_xy[1].is_finite() && s.quality.is_finite()) {
            return Err(Reason::NotFinite);
        }
        if s.quality < settings.limits.min_quality {
            return Err(Reason::LowQuality);
        }
        if self.solved.is_some_and(|t| s.time <= t + TOGETHER) {
            return Err(Reason::OutOfOrder);
        }
        match self.stamp() {
            Some(stamp) if s.time < stamp - TOGETHER => Err(Reason::OutOfOrder),
            Some(stamp) if s.time > stamp + TOGETHER => Ok(PatchArrival::Later),
            _ => Ok(PatchArrival::Fits),
        }
    }

    /// Adds a patch. True when the image is whole.
    pub(in super::super::super) fn add(
        &mut self,
        s: &FlowSample,
        now: AutopilotTime,
        settings: &FlowSettings,
    ) -> Result<bool, Reason> {
        if self.samples.iter().any(|p| p.sensor == s.sensor) {
            return Err(Reason::Redundant);
        }
        if self.samples.is_empty() {
            self.since = Some(now);
        }
        self.samples.push(*s);
        Ok(self.samples.len() >= settings.patches.iter().count())
    }

    /// Whether an image waits whose rest does not come.
    pub(in super::super::super) fn has_waited(&self, now: AutopilotTime) -> bool {
        !self.samples.is_empty() && self.since.is_none_or(|t| now > t + WAIT)
    }

    /// The image is solved, with this verdict: its patches, to be counted, and the next begins.
    pub(in super::super::super) fn solved(
        &mut self,
        verdict: Verdict,
        mut count: impl FnMut(&FlowSample, Verdict),
    ) {
        self.solved = self.stamp();
        self.samples.drain(..).for_each(|s| count(&s, verdict));
    }

    /// The velocity of the body's origin from the patches that wait.
    pub(super) fn measure(
        &self,
        stamp: AutopilotTime,
        interval_s: f64,
        correction: &FlowCorrection,
        context: &Context<'_>,
    ) -> Result<MeasuredFlow, Reason> {
        let (settings, samples) = (&context.core.settings.flow, &self.samples);
        let first = samples.first().ok_or(Reason::NotUsed)?;
        let moment = moment(stamp, first.interval, correction.delay_s, context)?;
        let (r, mount) = (moment.r_body_to_ned, &settings.mount);
        let cosine = mount.cos_tilt(&r);
        let with_distance = samples.iter().find(|s| s.distance_m.is_some()).unwrap_or(first);
        let FlowDistance { measured_m: distance_m, height_m, relative_sigma } =
            distance(with_distance, cosine, context);
        let height_m = distance_m.map(|d| d * cosine).or(height_m).ok_or(Reason::NoDistance)?;
        let rate_camera = mount.camera_to_body.to_camera(Body::new(moment.rate_body)).raw();
        let view = View::mounted(1.0, mount, &r, height_m);
        let features = self.features(settings, &rate_camera, &correction.gyro_offset);
        let noise = SolveNoise {
            flow: settings.rate_noise_radps,
            height_m: DISTANCE_SIGMA_M.hypot(relative_sigma * height_m),
            rate_radps: 0.0,
        };
        let limits = solve_limits(settings);
        // The rotation has been taken out already, patch by patch.
        let solve = |known: Option<&KnownComponent>| {
            solve_velocity(&view, &features, &Vector3::zeros(), known, Method::RANSAC, &noise, &limits)
        };
        let (solved, observed) = match solve(None) {
            Ok(solved) => (solved, true),
            Err(FlowRefusal::Rank(_) | FlowRefusal::Condition(_)) => {
                let lever = moment.rate_body.cross(&mount.lever_arm.raw());
                let known = KnownComponent {
                    direction_camera: view.down_camera,
                    speed_mps: (r.row(2) * lever)[0] - context.core.height.climb_mps(),
                    sigma_mps: CLIMB_SIGMA_MPS,
                };
                (solve(Some(&known))?, false)
            }
            Err(refusal) => return Err(refusal.into()),
        };
        let (v_body, covariance) = solved.at_body_origin(mount, &moment.rate_body);
        Ok(MeasuredFlow {
            time: moment.time,
            r_body_to_ned: r,
            v_xy: v_body.xy(),
            noise: covariance.fixed_view::<2, 2>(0, 0).into_owned(),
            v_z: observed.then_some((v_body.z, covariance[(2, 2)])),
            distance_m: height_m / cosine.max(0.1),
            interval_s,
            ranged: distance_m.is_some(),
            relative_sigma,
            gyro_offset: gyro_offset(first, &rate_camera),
        })
    }

    /// The patches as features of the image, with the rotation taken out.
    fn features(
        &self,
        settings: &FlowSettings,
        rate_camera: &Vector3<f64>,
        gyro_offset: &Vector2<f64>,
    ) -> Vec<Feature> {
        self.samples
            .iter()
            .filter_map(|s| {
                let image = settings.patches.find(s.sensor)?.image;
                let turned = match s.rotation {
                    // The sensor tells two axes; around the third the image turns as well where it is not centred.
                    FlowRotation::SensorGyro([x, y]) => {
                        Vector3::new(x - gyro_offset.x, y - gyro_offset.y, rate_camera.z)
                    }
                    FlowRotation::Contained | FlowRotation::InOwnUnit => *rate_camera,
                    FlowRotation::Removed => Vector3::zeros(),
                };
                let rotation = rotational_flow(1.0, &image, &turned);
                Some(Feature { image, flow: Vector2::from(s.rate_xy) - rotation })
            })
            .collect()
    }
}

fn solve_limits(settings: &FlowSettings) -> SolveLimits {
    SolveLimits {
        max_tilt_rad: settings.limits.max_tilt_rad,
        min_height_m: settings.limits.min_distance_m,
        max_height_m: settings.limits.max_distance_m,
        max_dilution: MAX_DILUTION,
        ..SolveLimits::default()
    }
}
