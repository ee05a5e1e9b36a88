//! The pose that landmarks give, and when it is believed.
//!
//! It counts while the filter calls it converged and landmarks are in view. **With a trusted GNSS** it moves nothing: surveyed landmarks are
//! compared with GNSS, and those that contradict it are not used in the outage that follows; landmarks in a frame of their own show how that
//! frame lies. **In holdover** it is an absolute fix of position and heading. The first one is judged by what the drift may have become; one
//! that lies farther away has to stand for longer.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use crate::landmark::{LandmarkPose, Observability};
use crate::time::AutopilotTime;

use super::super::super::context::Context;
use super::super::super::event::EventKind;
use super::super::super::event_log::EventLog;
use super::super::super::monitor::gnss_integrity::{GnssFault, GnssState};
use super::super::super::solution::Mode;
use super::{LandmarkFrame, LandmarkSource};
use crate::navigator::tuning::landmark_pose::{
    AGREE, APART_M, APART_S, APART_SIGMA, BELIEVED_S, FOUND_S, FRESH_S, GATE_SIGMA, LEAST_HEADING,
    LOCKED_OUT_S, LOST_S, PERIOD_S,
};

/// What the pose is worth.
#[derive(Clone, Debug, Default)]
pub(super) struct PoseStanding {
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

impl PoseStanding {
    /// Turns `turned` to `now` when it changes; for how long it has been so.
    fn lasted(turned: &mut Option<AutopilotTime>, now: AutopilotTime, changes: bool) -> f64 {
        if changes || turned.is_none() {
            *turned = Some(now);
        }
        turned.map_or(0.0, |t| now.seconds_since(t))
    }

    pub(super) fn fix(&self) -> Option<(AutopilotTime, f64)> {
        self.fixed.map(|t| (t, self.anchor_sigma_m))
    }

    pub(super) fn contradicts_gnss(&self) -> bool {
        self.apart || self.contradiction_told
    }
}

/// A pose in NED.
#[derive(Clone, Copy, Debug)]
pub(in super::super::super) struct LandmarkFix {
    pub(in super::super::super) position_ned: Vector3<f64>,
    pub(in super::super::super) r_body_to_ned: Matrix3<f64>,
    /// Of the horizontal position.
    pub(in super::super::super) covariance: Matrix2<f64>,
    pub(in super::super::super) heading_variance: f64,
    /// What is wrong with it for good, m.
    pub(in super::super::super) anchor_sigma_m: f64,
    /// For how long poses have counted, s.
    pub(in super::super::super) lasted_s: f64,
}

/// What is to be done with a fix in an outage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super::super) enum PoseNews {
    /// Nothing: it is not believed.
    Ignore,
    /// It is the first; it may lie where the drift cannot have gone, or nothing may be known at all.
    First { elsewhere: bool },
    /// One of many.
    Again,
}

impl LandmarkFix {
    /// Horizontal distance from a position, NE, m.
    pub(in super::super::super) fn error_from(&self, position_ned: &Vector3<f64>) -> Vector2<f64> {
        (self.position_ned - position_ned).xy()
    }
}

impl LandmarkSource {
    /// Looks at the pose, every so often. A fix when it counts.
    pub(in super::super::super) fn look(
        &mut self,
        now: AutopilotTime,
        context: &Context<'_>,
        events: &mut EventLog,
    ) -> Option<LandmarkFix> {
        if self.standing.looked_at.is_some_and(|t| now.seconds_since(t) < PERIOD_S) {
            return None;
        }
        self.standing.looked_at = Some(now);
        if !context.core.dead_reckoning() {
            (self.standing.fixed, self.standing.refused_since) = (None, None);
        }
        let fresh = self.used_at.is_some_and(|t| now.seconds_since(t) < FRESH_S);
        let pose = self.filter.as_ref()?.pose().filter(|pose| fresh && pose.converged);
        let standing = &mut self.standing;
        let counts = pose.is_some();
        let lasted_s = PoseStanding::lasted(&mut standing.turned, now, counts != standing.counts);
        standing.counts = counts;
        if counts && !standing.found && lasted_s >= FOUND_S {
            standing.found = true;
            events.tell(now, EventKind::LandmarksFound);
        } else if !counts && standing.found && lasted_s >= LOST_S {
            standing.found = false;
            events.tell(now, EventKind::LandmarksLost);
        }
        self.tell_contradictions(now, events);
        let pose = pose.filter(|_| self.standing.found)?;
        if context.core.mode == Mode::Aided {
            self.learn_frame(now, &pose, context, events);
        }
        self.in_ned(&pose, lasted_s, context)
    }

    /// Landmarks that contradict the others are told once, until they do not any more.
    fn tell_contradictions(&mut self, now: AutopilotTime, events: &mut EventLog) {
        let Some(filter) = &self.filter else { return };
        let mut suspects = [0u64; 4];
        for id in filter.suspects() {
            if let Some(word) = suspects.get_mut(usize::from(id / 64)) {
                *word |= 1 << (id % 64);
            }
        }
        let told = std::mem::replace(&mut self.standing.told, suspects);
        let none = match filter.health().observability {
            Observability::Contradicted { suspect, trusted } => Some((suspect, trusted)),
            _ => None,
        };
        let was = std::mem::replace(&mut self.standing.contradiction_told, none.is_some());
        let new = |id: &u8| {
            let bit = |words: &[u64; 4]| words.get(usize::from(id / 64)).map_or(0, |w| w >> (id % 64) & 1);
            bit(&suspects) == 1 && bit(&told) == 0
        };
        for id in (0..=u8::MAX).filter(new) {
            events.tell(now, EventKind::LandmarkContradicts(id));
        }
        if let Some((suspect, trusted)) = none.filter(|_| !was) {
            events.tell(now, EventKind::LandmarksContradict { suspect, trusted });
        }
    }

    /// The pose in NED. `None` while nobody knows how the landmarks' frame lies.
    fn in_ned(&self, pose: &LandmarkPose, lasted_s: f64, context: &Context<'_>) -> Option<LandmarkFix> {
        let survey = self.setup.survey_sigma_m;
        let (p, r) = (pose.position_ned, pose.r_body_to_ned);
        let covariance = pose.covariance.fixed_view::<3, 3>(0, 0);
        let heading_variance = pose.covariance[(5, 5)] + LEAST_HEADING * LEAST_HEADING;
        let (position_ned, r_body_to_ned, axes, relation) = match self.setup.frame {
            LandmarkFrame::Surveyed => (p, r, Matrix3::identity(), [survey, 0.0]),
            LandmarkFrame::Local => {
                let known = self.relation.known()?;
                let (ned, r) = known.to_ned(&p, &r);
                // GNSS has placed the frame, as well as it knows places itself.
                let sigma = survey.hypot(context.facts.gnss_sigma_m).hypot(known.sigma_m(&ned));
                (ned, r, known.axes(), [sigma, known.heading_sigma])
            }
        };
        let covariance = axes * covariance * axes.transpose();
        Some(LandmarkFix {
            position_ned,
            r_body_to_ned,
            covariance: covariance.fixed_view::<2, 2>(0, 0).into_owned(),
            heading_variance: heading_variance + relation[1] * relation[1],
            anchor_sigma_m: relation[0],
            lasted_s,
        })
    }

    /// GNSS shows how the landmarks' own frame lies.
    fn learn_frame(
        &mut self,
        now: AutopilotTime,
        pose: &LandmarkPose,
        context: &Context<'_>,
        events: &mut EventLog,
    ) {
        let Some((p, _)) = context.core.estimator.estimate() else { return };
        if self.setup.frame != LandmarkFrame::Local {
            return;
        }
        let variance = context.core.attitude_variance(&context.facts).z;
        let was_known = self.relation.known().is_some();
        let ned = (&p, &context.core.attitude.r_body_to_ned);
        self.relation.learn(PERIOD_S, ned, (&pose.position_ned, &pose.r_body_to_ned), variance);
        if let Some(known) = self.relation.known().filter(|_| !was_known) {
            events.tell(now, EventKind::LandmarkFrame(known.heading, known.heading_sigma));
        }
    }

    /// A trusted GNSS and landmarks have to agree.
    pub(in super::super::super) fn compare(
        &mut self,
        now: AutopilotTime,
        fix: &LandmarkFix,
        context: &Context<'_>,
        events: &mut EventLog,
    ) {
        let Some((p, _)) = context.core.estimator.estimate() else { return };
        let distance = fix.error_from(&p).norm();
        let gnss = 2.0 * context.facts.gnss_sigma_m.powi(2);
        let sigma = (fix.covariance.trace() + fix.anchor_sigma_m.powi(2) + gnss).sqrt();
        let limit = APART_M.max(APART_SIGMA * sigma);
        let standing = &mut self.standing;
        let apart = distance > if standing.apart { AGREE * limit } else { limit };
        if apart == standing.apart {
            standing.apart_turned = None;
        } else if PoseStanding::lasted(&mut standing.apart_turned, now, false) >= APART_S {
            (standing.apart, standing.apart_turned) = (apart, None);
            let kind = if apart { EventKind::LandmarksApart(distance) } else { EventKind::LandmarksAgree };
            events.tell(now, kind);
        }
    }

    /// Whether a fix of an outage is believed.
    pub(in super::super::super) fn judge(
        &mut self,
        now: AutopilotTime,
        fix: &LandmarkFix,
        context: &Context<'_>,
    ) -> PoseNews {
        let core = context.core;
        // What GNSS said while it was walked away with says nothing against landmarks.
        let lied = matches!(core.integrity.state(), GnssState::Untrusted(GnssFault::Inconsistent));
        let Some((p, _)) = core.estimator.estimate() else { return PoseNews::Ignore };
        self.standing.apart &= !lied;
        if self.standing.apart || core.coasts() {
            return PoseNews::Ignore;
        }
        if self.standing.fixed.is_some() {
            return PoseNews::Again;
        }
        let (covariance, _) = core.covariances(&context.facts);
        let variance = covariance.fixed_view::<2, 2>(0, 0).trace()
            + fix.covariance.trace()
            + 2.0 * fix.anchor_sigma_m * fix.anchor_sigma_m;
        let far = fix.error_from(&p).norm_squared() > GATE_SIGMA * GATE_SIGMA * variance;
        let elsewhere = far || core.mode == Mode::Lost;
        if elsewhere && fix.lasted_s < BELIEVED_S {
            return PoseNews::Ignore;
        }
        self.standing.anchor_sigma_m = fix.anchor_sigma_m;
        self.standing.fixed = Some(now);
        PoseNews::First { elsewhere }
    }

    /// A fix was taken.
    pub(in super::super::super) fn fixed(&mut self, now: AutopilotTime) {
        self.standing.fixed = Some(now);
        self.standing.refused_since = None;
    }

    /// A fix was refused by the filter. True when that has gone on for so long that the filter must be wrong.
    pub(in super::super::super) fn refused(&mut self, now: AutopilotTime) -> bool {
        let since = *self.standing.refused_since.get_or_insert(now);
        let locked_out = now.seconds_since(since) > LOCKED_OUT_S;
        if locked_out {
            self.standing.refused_since = None;
        }
        locked_out
    }
}
