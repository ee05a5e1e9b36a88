//! Known landmarks in the navigator: the filter of [`crate::landmark`] is carried by the navigator's own motion and fed with sightings;
//! `pose` says when its pose is believed.
//!
//! The pose is judged by the landmarks alone: the filter takes velocity, rate and tilt from the navigator, never its position. So an error
//! of the position is not fed back into what is to correct it.

mod pose;
mod relation;
mod setup;

use std::collections::VecDeque;
use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};

use crate::landmark::{
    BodyMotion, LandmarkFilter, LandmarkMap, LandmarkSighting, MotionVerdict, PoseGuess, Seen,
    SightingVerdict,
};
use crate::sample::{LandmarkSample, Sighting};
use crate::time::{AutopilotTime, Span};

use super::super::context::Context;
use super::super::reset::Reset;
use super::super::solution::Mode;
use super::super::verdict::{Reason, Verdict};
use super::status::SourceHealth;
use crate::navigator::tuning::landmarks::{AHEAD_S, AROUND_M, BLIND_S, GUESS_M, GUESS_RAD, HELD, PUSH_S};
use pose::PoseStanding;
pub(in super::super) use pose::{LandmarkFix, PoseNews};
use relation::Relation;
pub use setup::{ComponentCamera, LandmarkFrame, LandmarkPlace, LandmarkSetup};

/// The motion since the filter was last carried on.
#[derive(Clone, Copy, Debug, Default)]
struct Moved {
    dt_s: f64,
    way_body: Vector3<f64>,
    turn_body: Vector3<f64>,
}

/// The landmarks and what is known of them.
#[derive(Clone, Debug)]
pub(in super::super) struct LandmarkSource {
    setup: Arc<LandmarkSetup>,
    filter: Option<LandmarkFilter>,
    moved: Moved,
    held: VecDeque<LandmarkSighting>,
    /// The newest sighting of a landmark that is known, and the newest that was used.
    seen_at: Option<AutopilotTime>,
    used_at: Option<AutopilotTime>,
    standing: PoseStanding,
    relation: Relation,
}

impl LandmarkSource {
    pub(in super::super) fn new(setup: Arc<LandmarkSetup>) -> Self {
        Self {
            setup,
            filter: None,
            moved: Moved::default(),
            held: VecDeque::with_capacity(HELD),
            seen_at: None,
            used_at: None,
            standing: PoseStanding::default(),
            relation: Relation::default(),
        }
    }

    /// What carried the filter is broken: it begins anew. How the landmarks' frame lies stays known.
    fn interrupt(&mut self) {
        self.filter = None;
        self.moved = Moved::default();
        self.held.clear();
        (self.seen_at, self.used_at) = (None, None);
        self.standing = PoseStanding::default();
    }

    pub(super) fn reset(&mut self, reset: &Reset) {
        match reset {
            // Surveyed landmarks have other coordinates now.
            Reset::OriginMoved(moved) => match self.setup.frame {
                LandmarkFrame::Surveyed => self.interrupt(),
                LandmarkFrame::Local => self.relation.origin_moved(moved),
            },
            Reset::StreamBroken | Reset::Reboot | Reset::ClockSetBack => self.interrupt(),
            Reset::Relocated | Reset::Bridged => {}
        }
    }

    /// The settings of the landmarks' filter.
    pub(in super::super) fn setup(&self) -> &LandmarkSetup {
        &self.setup
    }

    /// What is known against the landmarks.
    pub(super) fn health(&self) -> SourceHealth {
        if self.standing.contradicts_gnss() { SourceHealth::Suspect } else { SourceHealth::Healthy }
    }

    /// The newest fix in this outage, and what the survey is wrong by, 1 sigma, m.
    pub(super) fn fix(&self) -> Option<(AutopilotTime, f64)> {
        self.standing.fix()
    }

    /// Gives the filter a sighting.
    fn give(&mut self, sighting: LandmarkSighting) -> Verdict {
        let Some(filter) = &mut self.filter else { return Verdict::Rejected(Reason::NoReferenceYet) };
        let reason = match filter.sighting(&sighting) {
            SightingVerdict::Used(_) => {
                self.used_at = self.used_at.max(Some(sighting.time));
                return Verdict::Used;
            }
            SightingVerdict::FromTheFuture(by) if by <= AHEAD_S && self.held.len() < HELD => {
                self.held.push_back(sighting);
                return Verdict::Waiting;
            }
            SightingVerdict::FromTheFuture(_) => Reason::Early,
            SightingVerdict::Gated(_) => Reason::Innovation,
            SightingVerdict::UnknownId => Reason::UnknownLandmark,
            SightingVerdict::UnknownCamera => Reason::UnknownCamera,
            SightingVerdict::OutOfFieldOfView => Reason::OutOfRange,
            SightingVerdict::TooOld(_) => Reason::Late,
            SightingVerdict::Duplicate => Reason::Duplicate,
            SightingVerdict::NotFinite => Reason::NotFinite,
            SightingVerdict::Indefinite => Reason::Unobservable,
        };
        Verdict::Rejected(reason)
    }

    /// Gives the filter the sightings that had overtaken the motion, as far as that has come; `count` hears what became of each.
    fn give_held(&mut self, count: &mut impl FnMut(u8, AutopilotTime, Verdict)) {
        let Some(now) = self.filter.as_ref().map(LandmarkFilter::time) else { return };
        for _ in 0..self.held.len() {
            match self.held.pop_front() {
                Some(s) if s.time > now => self.held.push_back(s),
                Some(s) => {
                    let component = self.setup.cameras.get(usize::from(s.camera)).map_or(0, |c| c.component);
                    let verdict = self.give(s);
                    count(component, s.time, verdict);
                }
                None => return,
            }
        }
    }

    pub(in super::super) fn observe(&mut self, s: &LandmarkSample, context: &Context<'_>) -> Verdict {
        let Some((camera, delay_s)) = self.setup.camera(s.camera) else {
            return Verdict::Rejected(Reason::UnknownCamera);
        };
        let time = s.time - Span::from_seconds(delay_s);
        let seen = match s.sighting {
            Sighting::Bearing { angle_xy, distance_m } => Seen::Angles { angle_xy, distance_m },
            Sighting::Body(p) => Seen::InBody(p),
        };
        let Some(filter) = &self.filter else { return Verdict::Rejected(Reason::NoReferenceYet) };
        let blind = self.seen_at.is_none_or(|t| filter.time().seconds_since(t) > BLIND_S);
        if filter.map().get(s.id).is_none() {
            return Verdict::Rejected(Reason::UnknownLandmark);
        }
        let guess = if blind { self.guess(filter.map(), context) } else { None };
        if let (Some(guess), Some(filter)) = (guess, &mut self.filter) {
            filter.restart(&guess);
        }
        let newest = self.filter.as_ref().map(LandmarkFilter::time);
        self.seen_at = self.seen_at.max(newest);
        self.give(LandmarkSighting { time, camera, id: s.id, seen })
    }

    /// One IMU sample over `dt` s: the filter is carried on. True when it has moved and may be looked at; `count` hears what became of
    /// sightings that had waited.
    pub(in super::super) fn carry_on(
        &mut self,
        now: AutopilotTime,
        dt: f64,
        context: &Context<'_>,
        mut count: impl FnMut(u8, AutopilotTime, Verdict),
    ) -> bool {
        let core = context.core;
        if core.mode == Mode::Aligning {
            return false;
        }
        let Some((_, velocity_ned)) = core.estimator.estimate() else { return false };
        let r = &core.attitude.r_body_to_ned;
        let Some(filter) = &mut self.filter else {
            self.start(now, context);
            return false;
        };
        let moved = &mut self.moved;
        moved.dt_s += dt;
        moved.way_body += r.tr_mul(&velocity_ned) * dt;
        moved.turn_body += core.attitude.angular_rate_body * dt;
        if moved.dt_s < PUSH_S {
            return false;
        }
        let motion = BodyMotion {
            velocity_body: moved.way_body / moved.dt_s,
            angular_rate_body: moved.turn_body / moved.dt_s,
        };
        *moved = Moved::default();
        let down: Vector3<f64> = r.row(2).transpose();
        if filter.push(now, &motion, Some(&down)) == MotionVerdict::OutOfOrder {
            self.interrupt();
            return false;
        }
        self.give_held(&mut count);
        true
    }

    fn start(&mut self, now: AutopilotTime, context: &Context<'_>) {
        let Some(environment) = context.core.surroundings.environment() else { return };
        let Ok(map) = self.setup.map(&environment.frame) else { return };
        let Some(guess) = self.guess(&map, context) else { return };
        let filter = LandmarkFilter::new(self.setup.filter, map, self.setup.landmark_cameras(), now, &guess);
        self.filter = Some(filter);
    }

    /// Where the navigator believes to be in the landmarks' frame.
    fn guess(&self, map: &LandmarkMap, context: &Context<'_>) -> Option<PoseGuess> {
        let (core, facts) = (context.core, &context.facts);
        let (p, _) = core.estimator.estimate()?;
        let (covariance, _) = core.covariances(facts);
        let sigma = covariance.diagonal().max().max(0.0).sqrt().max(GUESS_M);
        let attitude_sigma_rad = core.attitude_variance(facts).max().max(0.0).sqrt().max(GUESS_RAD);
        let r = core.attitude.r_body_to_ned;
        let at = |(position_ned, r_body_to_ned): (Vector3<f64>, Matrix3<f64>), position_sigma_m: f64| {
            PoseGuess { position_ned, r_body_to_ned, position_sigma_m, attitude_sigma_rad }
        };
        Some(match (self.setup.frame, self.relation.known()) {
            (LandmarkFrame::Surveyed, _) => at((p, r), sigma),
            (LandmarkFrame::Local, Some(known)) => at(known.to_local(&p, &r), sigma.hypot(known.sigma_m(&p))),
            (LandmarkFrame::Local, None) => PoseGuess {
                position_ned: map.centroid() - Vector3::z() * AROUND_M,
                r_body_to_ned: r,
                position_sigma_m: map.radius_m() + AROUND_M,
                attitude_sigma_rad: PoseGuess::ANY_ATTITUDE,
            },
        })
    }
}
