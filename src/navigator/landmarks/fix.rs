//! The pose that landmarks give: when it is believed, and what it is used for.
//!
//! It counts while the filter calls it converged and landmarks are in view. **With a trusted GNSS** it moves nothing: surveyed landmarks are
//! compared with GNSS, and those that contradict it are not used in the outage that follows; landmarks in a frame of their own show how that
//! frame lies. **In holdover** it is an absolute fix of position and heading. The first one is judged by what the drift may have become; one
//! that lies farther away has to stand for longer. What it moves is not shown at once: the published position glides, and where the way is
//! longer than `rejoin.jump_m` it jumps and the reset counter says so.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use crate::filter::error_state::Lag;
use crate::geo::so3;
use crate::landmark::{LandmarkPose, Observability};
use crate::time::{AutopilotTime, Span};

use super::super::Navigator;
use super::super::budget::ErrorBudget;
use super::super::event::{What, Why};
use super::super::nis::Measured;
use super::super::settings::Estimator;
use super::super::solution::{Carrier, Mode};
use super::super::trust::{GnssFault, GnssState};
use super::LandmarkFrame;

/// The pose is looked at this often, s.
const PERIOD_S: f64 = 0.2;
/// A pose without a sighting for this long is dead reckoning, s.
const FRESH_S: f64 = 1.0;
/// Landmarks are found when their pose counts for this long, s, and lost when it does not for as long.
const FOUND_S: f64 = 1.0;
const LOST_S: f64 = 2.0;
/// A heading is not believed better than this, rad: mounting.
const LEAST_HEADING: f64 = 0.004;
/// A pose further away than this many sigmas of what drift and landmarks may be off by …
const GATE_SIGMA: f64 = 4.0;
/// … is believed when it has stood for this long, s.
const BELIEVED_S: f64 = 10.0;
/// Poses that the filter will not have for this long mean that the filter is wrong, s.
const LOCKED_OUT_S: f64 = 3.0;
/// A correction beyond this is no tracking any more, and glides, m.
const SHOWN_AT_ONCE_M: f64 = 0.1;
/// An observer's velocity is off by this much in manoeuvres, m/s: more than the drift that is configured, and the landmarks' filter, which
/// it carries, lags by as much in the time that it forgets in.
const OBSERVED_SPEED_SIGMA: f64 = 0.5;
/// Landmarks and GNSS contradict each other when they are this many sigmas apart, and this far, m, …
const APART_SIGMA: f64 = 3.0;
const APART_M: f64 = 2.0;
/// … for this long, s.
const APART_S: f64 = 5.0;
/// The position counts as that of landmarks for this long after a fix, s.
const CARRIES_S: f64 = 1.5;

/// What the pose is worth.
#[derive(Clone, Debug, Default)]
pub(super) struct Standing {
    looked_at: Option<AutopilotTime>,
    /// Since when the pose has counted, or not.
    turned: Option<AutopilotTime>,
    counts: bool,
    found: bool,
    /// Since when landmarks and GNSS are apart, or agree; and which of both is told.
    apart_turned: Option<AutopilotTime>,
    apart: bool,
    /// Landmarks that were told of, by id; and that they contradict each other without a majority.
    told: [u64; 4],
    contradiction_told: bool,
    /// The newest fix in this outage; with it the error is that of the survey.
    fixed: Option<AutopilotTime>,
    anchor_sigma_m: f64,
    refused_since: Option<AutopilotTime>,
}

/// A pose in NED.
struct Fix {
    position_ned: Vector3<f64>,
    r_body_to_ned: Matrix3<f64>,
    /// Of the horizontal position.
    covariance: Matrix2<f64>,
    heading_variance: f64,
    /// What is wrong with it for good, m.
    anchor_sigma_m: f64,
}

impl Standing {
    /// Turns `turned` to `now` when `is` is another than `was`; for how long it has been so.
    fn lasted(turned: &mut Option<AutopilotTime>, now: AutopilotTime, changes: bool) -> f64 {
        if changes || turned.is_none() {
            *turned = Some(now);
        }
        turned.map_or(0.0, |t| now.seconds_since(t))
    }
}

/// The variance of one of many poses of one filter. It forgets in τ = P/drift², its errors are correlated for as long, and the mean of
/// them is as good as that of independent ones with the variance 2τ/T P. Without that the filter that is corrected is faster than the one
/// that corrects it, and as it carries that one, both oscillate.
fn repeated(variance: f64, drift: f64) -> f64 {
    let forgets_s = variance / (drift * drift);
    variance * (2.0 * forgets_s / PERIOD_S).max(1.0)
}

impl Navigator {
    /// Looks at the landmarks' pose, every so often.
    pub(super) fn judge_landmarks(&mut self, now: AutopilotTime) {
        let outage = self.modes.dead_reckoning();
        let Some(sense) = &mut self.landmarks else { return };
        if sense.standing.looked_at.is_some_and(|t| now.seconds_since(t) < PERIOD_S) {
            return;
        }
        sense.standing.looked_at = Some(now);
        if !outage {
            (sense.standing.fixed, sense.standing.refused_since) = (None, None);
        }
        let Some(filter) = &sense.filter else { return };
        let fresh = sense.used_at.is_some_and(|t| now.seconds_since(t) < FRESH_S);
        let pose = filter.pose().filter(|pose| fresh && pose.converged);
        let standing = &mut sense.standing;
        let counts = pose.is_some();
        let lasted = Standing::lasted(&mut standing.turned, now, counts != standing.counts);
        standing.counts = counts;
        if counts && !standing.found && lasted >= FOUND_S {
            standing.found = true;
            self.tell(now, What::LandmarksFound);
        } else if !counts && standing.found && lasted >= LOST_S {
            standing.found = false;
            self.tell(now, What::LandmarksLost);
        }
        self.tell_contradictions(now);
        let found = self.landmarks.as_ref().is_some_and(|s| s.standing.found);
        if let Some(pose) = pose.filter(|_| found) {
            self.take_landmark_pose(now, &pose, lasted);
        }
    }

    /// Landmarks that contradict the others are told once, until they do not any more.
    fn tell_contradictions(&mut self, now: AutopilotTime) {
        let Some(sense) = &mut self.landmarks else { return };
        let Some(filter) = &sense.filter else { return };
        let mut suspects = [0u64; 4];
        for id in filter.suspects() {
            if let Some(word) = suspects.get_mut(usize::from(id / 64)) {
                *word |= 1 << (id % 64);
            }
        }
        let told = std::mem::replace(&mut sense.standing.told, suspects);
        let none = match filter.health().observability {
            Observability::Contradicted { suspect, trusted } => Some((suspect, trusted)),
            _ => None,
        };
        let was = std::mem::replace(&mut sense.standing.contradiction_told, none.is_some());
        let new = |id: &u8| {
            let bit = |words: &[u64; 4]| words.get(usize::from(id / 64)).map_or(0, |w| w >> (id % 64) & 1);
            bit(&suspects) == 1 && bit(&told) == 0
        };
        for id in (0..=u8::MAX).filter(new) {
            self.tell(now, What::LandmarkContradicts(id));
        }
        if let Some((suspect, trusted)) = none.filter(|_| !was) {
            self.tell(now, What::LandmarksContradict { suspect, trusted });
        }
    }

    fn take_landmark_pose(&mut self, now: AutopilotTime, pose: &LandmarkPose, lasted_s: f64) {
        let mode = self.modes.mode();
        if mode == Mode::Aided {
            self.learn_landmark_frame(now, pose);
        }
        let Some(fix) = self.landmark_fix(pose) else { return };
        match mode {
            Mode::Aided => self.compare_landmarks(now, &fix),
            Mode::Holdover | Mode::Lost => self.fix_by_landmarks(now, &fix, lasted_s),
            Mode::Aligning | Mode::Rejoining => {}
        }
    }

    /// The pose in NED. `None` while nobody knows how the landmarks' frame lies.
    fn landmark_fix(&self, pose: &LandmarkPose) -> Option<Fix> {
        let sense = self.landmarks.as_ref()?;
        let survey = sense.setup.survey_sigma_m;
        let (p, r) = (pose.position_ned, pose.r_body_to_ned);
        let covariance = pose.covariance.fixed_view::<3, 3>(0, 0);
        let heading_variance = pose.covariance[(5, 5)] + LEAST_HEADING * LEAST_HEADING;
        let (position_ned, r_body_to_ned, axes, relation) = match sense.setup.frame {
            LandmarkFrame::Surveyed => (p, r, Matrix3::identity(), [survey, 0.0]),
            LandmarkFrame::Local => {
                let known = sense.relation.known()?;
                let (ned, r) = known.to_ned(&p, &r);
                // GNSS has placed the frame, as well as it knows places itself.
                let sigma = survey.hypot(self.gnss_sigma_m).hypot(known.sigma_m(&ned));
                (ned, r, known.axes(), [sigma, known.heading_sigma])
            }
        };
        let covariance = axes * covariance * axes.transpose();
        Some(Fix {
            position_ned,
            r_body_to_ned,
            covariance: covariance.fixed_view::<2, 2>(0, 0).into_owned(),
            heading_variance: heading_variance + relation[1] * relation[1],
            anchor_sigma_m: relation[0],
        })
    }

    /// GNSS shows how the landmarks' own frame lies.
    fn learn_landmark_frame(&mut self, now: AutopilotTime, pose: &LandmarkPose) {
        let (Some((p, _)), variance) = (self.estimate(), self.attitude_variance().z) else { return };
        let r = self.r_body_to_ned;
        let Some(sense) = self.landmarks.as_mut().filter(|s| s.setup.frame == LandmarkFrame::Local) else {
            return;
        };
        let was_known = sense.relation.known().is_some();
        sense.relation.learn(PERIOD_S, (&p, &r), (&pose.position_ned, &pose.r_body_to_ned), variance);
        if let Some(known) = sense.relation.known().filter(|_| !was_known) {
            self.tell(now, What::LandmarkFrame(known.heading, known.heading_sigma));
        }
    }

    /// A trusted GNSS and landmarks have to agree.
    fn compare_landmarks(&mut self, now: AutopilotTime, fix: &Fix) {
        let Some((p, _)) = self.estimate() else { return };
        let distance = (fix.position_ned - p).xy().norm();
        let gnss = 2.0 * self.gnss_sigma_m.powi(2);
        let sigma = (fix.covariance.trace() + fix.anchor_sigma_m.powi(2) + gnss).sqrt();
        let limit = APART_M.max(APART_SIGMA * sigma);
        let Some(sense) = &mut self.landmarks else { return };
        let standing = &mut sense.standing;
        // Who is apart has to come well within the limit to agree.
        let apart = distance > if standing.apart { 0.7 * limit } else { limit };
        if apart == standing.apart {
            standing.apart_turned = None;
        } else if Standing::lasted(&mut standing.apart_turned, now, false) >= APART_S {
            (standing.apart, standing.apart_turned) = (apart, None);
            self.tell(now, if apart { What::LandmarksApart(distance) } else { What::LandmarksAgree });
        }
    }

    /// An absolute fix without GNSS.
    fn fix_by_landmarks(&mut self, now: AutopilotTime, fix: &Fix, lasted_s: f64) {
        // What GNSS said while it was walked away with says nothing against landmarks.
        let lied = matches!(self.trust.state(), GnssState::Untrusted(GnssFault::Inconsistent));
        let Some((p, _)) = self.estimate() else { return };
        let (covariance, _) = self.covariances();
        let Some(standing) = self.landmarks.as_mut().map(|s| &mut s.standing) else { return };
        standing.apart &= !lied;
        if standing.apart || self.settings.estimator == Estimator::Inertial {
            return;
        }
        let e = (fix.position_ned - p).xy();
        let lost = self.modes.mode() == Mode::Lost;
        let first = standing.fixed.is_none();
        let anchor = fix.anchor_sigma_m;
        if first {
            let variance =
                covariance.fixed_view::<2, 2>(0, 0).trace() + fix.covariance.trace() + 2.0 * anchor * anchor;
            let far = e.norm_squared() > GATE_SIGMA * GATE_SIGMA * variance;
            if (far || lost) && lasted_s < BELIEVED_S {
                return;
            }
            standing.anchor_sigma_m = anchor;
            standing.fixed = Some(now);
            // What GNSS was wrong by is the position's own error now, and to be corrected.
            if let Some(kalman) = &mut self.kalman {
                kalman.filter.inflate(0.0, self.gnss_sigma_m, 0.0);
            }
            if far || lost {
                self.relocate(now, &e, fix);
            }
            if lost && self.kalman.is_some() {
                self.jump_to_estimate(now);
                self.change_mode(now, Mode::Holdover, Why::Landmarks);
                return;
            }
        }
        if self.kalman.is_some() {
            self.fuse_landmark_fix(now, &e, fix);
        } else {
            self.relocate(now, &e, fix);
            self.landmark_fixed(now);
        }
        if self.offset_ned.norm() > self.settings.rejoin.jump_m {
            self.jump_to_estimate(now);
        }
    }

    fn landmark_fixed(&mut self, now: AutopilotTime) {
        if let Some(sense) = &mut self.landmarks {
            sense.standing.fixed = Some(now);
            sense.standing.refused_since = None;
        }
    }

    /// Position and heading to the filter.
    fn fuse_landmark_fix(&mut self, now: AutopilotTime, e: &Vector2<f64>, fix: &Fix) {
        let Some(kalman) = &mut self.kalman else { return };
        let Some(filter) = self.landmarks.as_ref().map(|s| s.setup.filter) else { return };
        let turn = so3::log(&(fix.r_body_to_ned * kalman.filter.state().r_body_to_ned.transpose())).z;
        let before = kalman.filter.state().position_ned;
        let mut corrections = [None; 3];
        for axis in 0..2 {
            // Of the second the first has taken its part.
            let taken = kalman.filter.state().position_ned[axis] - before[axis];
            let variance = repeated(fix.covariance[(axis, axis)], filter.position_drift);
            let fused = kalman.filter.fuse_position(axis, e[axis] - taken, variance, &Lag::NONE);
            corrections[axis] = self.nis.note(Measured::LandmarkPosition, fused, |c| c.nis);
        }
        if corrections.iter().take(2).all(Option::is_some) {
            let fused =
                kalman.filter.fuse_heading(turn, repeated(fix.heading_variance, filter.attitude_drift));
            corrections[2] = self.nis.note(Measured::LandmarkHeading, fused, |c| c.nis);
            self.landmark_fixed(now);
        } else {
            let Some(standing) = self.landmarks.as_mut().map(|s| &mut s.standing) else { return };
            let since = *standing.refused_since.get_or_insert(now);
            if now.seconds_since(since) > LOCKED_OUT_S {
                standing.refused_since = None;
                return self.relocate(now, e, fix);
            }
        }
        let moved: Vector3<f64> = corrections.iter().flatten().map(|c| c.position_ned).sum();
        self.carry_back(now, corrections.iter().flatten());
        self.show_later(&moved.xy());
    }

    /// The position is where the landmarks say, whatever was believed of it.
    fn relocate(&mut self, now: AutopilotTime, e: &Vector2<f64>, fix: &Fix) {
        let shift = Vector3::new(e.x, e.y, 0.0);
        if let Some(kalman) = &mut self.kalman {
            let position = kalman.filter.state().position_ned.xy() + e;
            kalman.filter.reset_position(&position, fix.covariance.trace().max(0.0).sqrt());
        } else {
            self.move_estimate(&shift);
            let drift = self.landmarks.as_ref().map_or(f64::INFINITY, |s| s.setup.filter.position_drift);
            let forgets_s = fix.covariance.trace() * 0.5 / (drift * drift);
            let lag = OBSERVED_SPEED_SIGMA * (forgets_s + PERIOD_S);
            let anchor = Matrix2::identity() * (fix.anchor_sigma_m.powi(2) + lag.powi(2));
            let calibration = *self.carrying_calibration().covariance();
            let budget = self.settings.holdover.budget;
            self.budget = Some(ErrorBudget::new(budget, fix.covariance + anchor, calibration));
        }
        self.history.correct(now, &shift, &Vector3::zeros());
        self.show_later(e);
    }

    /// A correction that is too large to be shown at once glides.
    fn show_later(&mut self, moved: &Vector2<f64>) {
        if moved.norm() > SHOWN_AT_ONCE_M {
            self.offset_ned -= Vector3::new(moved.x, moved.y, 0.0);
        }
    }

    /// The published position jumps to the estimate.
    fn jump_to_estimate(&mut self, now: AutopilotTime) {
        let away = std::mem::take(&mut self.offset_ned).norm();
        self.reset_counter = self.reset_counter.wrapping_add(1);
        self.tell(now, What::Reset(away));
    }

    /// Whether the position is that of landmarks.
    fn on_landmarks(&self, now: AutopilotTime) -> bool {
        let fixed = self.landmarks.as_ref().and_then(|s| s.standing.fixed);
        self.modes.dead_reckoning() && fixed.is_some_and(|t| now - t < Span::from_seconds(CARRIES_S))
    }

    /// What carries, as it is told: landmarks where they are in view.
    pub(in super::super) fn shown_carrier(&self, now: AutopilotTime) -> Carrier {
        if self.on_landmarks(now) { Carrier::Landmarks } else { self.carrier }
    }

    /// What the position is wrong by for longer than any filter averages: the receiver's error of before the outage, or the survey's.
    pub(in super::super) fn anchor_sigma_m(&self) -> f64 {
        match &self.landmarks {
            Some(s) if s.standing.fixed.is_some() && self.modes.dead_reckoning() => s.standing.anchor_sigma_m,
            _ => self.gnss_sigma_m,
        }
    }
}
