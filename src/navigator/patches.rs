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
use crate::sample::{FlowRotation, FlowSample, SampleKind};
use crate::time::{AutopilotTime, Span};

use super::Navigator;
use super::flow::{CLIMB_SIGMA_MPS, FIRST_INTERVAL_S, Measured};
use super::verdict::{Reason, Verdict};

/// Stamps that lie this close are of the same image.
const TOGETHER: Span = Span::from_millis(2);
/// The rest of an image is waited for this long after its first patch came.
const WAIT: Span = Span::from_millis(30);
/// Beyond this ratio of the best observed direction to the worst the climb rate is the better third component.
const MAX_DILUTION: f64 = 8.0;
/// Distance noise, m, as for one patch: the calibration learns the scale.
const HEIGHT_SIGMA_M: f64 = 0.05;

/// The patches of the image that is coming in.
#[derive(Clone, Debug)]
pub(super) struct Gathering {
    samples: Vec<FlowSample>,
    /// Newest IMU stamp when the first one came.
    since: Option<AutopilotTime>,
    /// Stamp of the last image that was solved.
    solved: Option<AutopilotTime>,
}

impl Gathering {
    pub(super) fn new() -> Self {
        Self { samples: Vec::with_capacity(crate::camera::MAX_PATCHES), since: None, solved: None }
    }

    /// Forgets what waits and how far time has come.
    pub(super) fn clear(&mut self) {
        self.samples.clear();
        self.solved = None;
    }

    fn stamp(&self) -> Option<AutopilotTime> {
        self.samples.first().map(|s| s.time)
    }
}

impl Navigator {
    /// A patch has come.
    pub(super) fn patch(&mut self, s: &FlowSample) -> Verdict {
        if !(s.rate_xy[0].is_finite() && s.rate_xy[1].is_finite() && s.quality.is_finite()) {
            return Verdict::Rejected(Reason::NotFinite);
        }
        if s.quality < self.settings.flow.limits.min_quality {
            return Verdict::Rejected(Reason::LowQuality);
        }
        let Some(now) = self.last_imu else { return Verdict::Rejected(Reason::NoReferenceYet) };
        if self.patches.solved.is_some_and(|t| s.time <= t + TOGETHER) {
            return Verdict::Rejected(Reason::OutOfOrder);
        }
        if let Some(stamp) = self.patches.stamp() {
            if s.time < stamp - TOGETHER {
                return Verdict::Rejected(Reason::OutOfOrder);
            }
            if s.time > stamp + TOGETHER {
                self.solve_waiting();
            }
        }
        if self.patches.samples.iter().any(|p| p.sensor == s.sensor) {
            return Verdict::Rejected(Reason::Redundant);
        }
        if self.patches.samples.is_empty() {
            self.patches.since = Some(now);
        }
        self.patches.samples.push(*s);
        if self.patches.samples.len() < self.settings.flow.patches.iter().count() {
            return Verdict::Waiting;
        }
        // The one in hand is counted by whoever brought it.
        let verdict = self.solve_image();
        self.count_waiting(verdict, 1);
        verdict
    }

    /// Time goes on: an image whose rest does not come is solved without it.
    pub(super) fn patches_waited(&mut self, now: AutopilotTime) {
        if !self.patches.samples.is_empty() && self.patches.since.is_none_or(|t| now > t + WAIT) {
            self.solve_waiting();
        }
    }

    fn solve_waiting(&mut self) {
        let verdict = self.solve_image();
        self.count_waiting(verdict, 0);
    }

    /// Counts the patches of an image by its verdict, but for `besides`, and begins the next.
    fn count_waiting(&mut self, verdict: Verdict, besides: usize) {
        for _ in besides..self.patches.samples.len() {
            self.tally.count(SampleKind::Flow, verdict);
        }
        self.patches.solved = self.patches.stamp();
        self.patches.samples.clear();
    }

    fn solve_image(&mut self) -> Verdict {
        let Some(index) = self.settings.flow.patches.camera_id().and_then(|id| self.flow_sensor(id)) else {
            return Verdict::Rejected(Reason::Redundant);
        };
        let Some(stamp) = self.patches.stamp() else { return Verdict::Rejected(Reason::NotUsed) };
        let last = self.flows[index].last;
        let interval_s = last.map_or(FIRST_INTERVAL_S, |t| stamp.seconds_since(t)).min(1.0);
        self.flow_measured(stamp, index, |navigator, delay_s| {
            navigator.measure_image(stamp, interval_s, delay_s)
        })
    }

    /// The velocity of the body's origin from the patches that wait.
    fn measure_image(&self, stamp: AutopilotTime, interval_s: f64, delay_s: f64) -> Result<Measured, Reason> {
        let (settings, samples) = (&self.settings.flow, &self.patches.samples);
        let first = samples.first().ok_or(Reason::NotUsed)?;
        let moment = self.flow_moment(stamp, first.interval, delay_s)?;
        let (r, mount) = (moment.r_body_to_ned, &settings.mount);
        let cosine = mount.cos_tilt(&r);
        let with_distance = samples.iter().find(|s| s.distance_m.is_some()).unwrap_or(first);
        let (distance_m, height_m) = self.distance(with_distance, cosine);
        let height_m = distance_m.map(|d| d * cosine).or(height_m).ok_or(Reason::NoDistance)?;
        let rate_camera = mount.camera_to_body.to_camera(Body::new(moment.rate_body)).raw();
        let view = View::mounted(1.0, mount, &r, height_m);
        let features: Vec<Feature> = samples
            .iter()
            .filter_map(|s| {
                let image = settings.patches.find(s.sensor)?.image;
                let turned = match s.rotation {
                    // The sensor tells two axes; around the third the image turns as well where it is not centred.
                    FlowRotation::SensorGyro([x, y]) => Vector3::new(x, y, rate_camera.z),
                    FlowRotation::Contained => rate_camera,
                    FlowRotation::Removed => Vector3::zeros(),
                };
                let rotation = rotational_flow(1.0, &image, &turned);
                Some(Feature { image, flow: Vector2::from(s.rate_xy) - rotation })
            })
            .collect();
        let noise = SolveNoise { flow: settings.rate_noise_radps, height_m: HEIGHT_SIGMA_M, rate_radps: 0.0 };
        let limits = SolveLimits {
            max_tilt_rad: settings.limits.max_tilt_rad,
            min_height_m: settings.limits.min_distance_m,
            max_height_m: settings.limits.max_distance_m,
            max_dilution: MAX_DILUTION,
            ..SolveLimits::default()
        };
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
                    speed_mps: (r.row(2) * lever)[0] - self.height.climb_mps(),
                    sigma_mps: CLIMB_SIGMA_MPS,
                };
                (solve(Some(&known))?, false)
            }
            Err(refusal) => return Err(refusal.into()),
        };
        let (v_body, covariance) = solved.at_body_origin(mount, &moment.rate_body);
        Ok(Measured {
            time: moment.time,
            r_body_to_ned: r,
            v_xy: v_body.xy(),
            noise: covariance.fixed_view::<2, 2>(0, 0).into_owned(),
            v_z: observed.then_some((v_body.z, covariance[(2, 2)])),
            interval_s,
            ranged: distance_m.is_some(),
        })
    }
}
