//! Known landmarks in the navigator: the filter of [`crate::landmark`] is carried by the navigator's own motion and fed with sightings;
//! `fix` says what its pose is used for.
//!
//! The pose is judged by the landmarks alone: the filter takes velocity, rate and tilt from the navigator, never its position. So an error
//! of the position is not fed back into what is to correct it.

mod fix;
mod relation;
mod setup;

use std::collections::VecDeque;
use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};

use crate::landmark::{
    BodyMotion, LandmarkFilter, LandmarkMap, LandmarkSighting, MotionVerdict, PoseGuess, Seen,
    SightingVerdict,
};
use crate::sample::{LandmarkSample, SampleKind, Sighting};
use crate::time::{AutopilotTime, Span};

use super::Navigator;
use super::solution::Mode;
use super::verdict::{Reason, Tally, Verdict};
use fix::Standing;
use relation::Relation;
pub use setup::{ComponentCamera, LandmarkFrame, LandmarkPlace, LandmarkSetup};

/// The filter is carried on in steps of this, s: at fast streams several samples at once.
const PUSH_S: f64 = 0.009;
/// A sighting may overtake the IMU stream by this much, s, …
const AHEAD_S: f64 = 0.5;
/// … and so many of them may wait.
const HELD: usize = 64;
/// Nothing was seen for this long, s: the filter begins anew where the navigator believes to be, for what it knows has drifted away.
const BLIND_S: f64 = 5.0;
/// The least that a guess for the filter may be off, m and rad.
const GUESS_M: f64 = 0.5;
const GUESS_RAD: f64 = 0.05;
/// Beyond the field, m: from how far away it may be seen when nothing is known.
const AROUND_M: f64 = 30.0;

/// The motion since the filter was last carried on.
#[derive(Clone, Copy, Debug, Default)]
struct Moved {
    dt_s: f64,
    way_body: Vector3<f64>,
    turn_body: Vector3<f64>,
}

/// The landmarks and what is known of them.
#[derive(Clone, Debug)]
pub(super) struct LandmarkSense {
    setup: Arc<LandmarkSetup>,
    filter: Option<LandmarkFilter>,
    moved: Moved,
    held: VecDeque<LandmarkSighting>,
    /// The newest sighting of a landmark that is known, and the newest that was used.
    seen_at: Option<AutopilotTime>,
    used_at: Option<AutopilotTime>,
    standing: Standing,
    relation: Relation,
}

impl LandmarkSense {
    pub(super) fn new(setup: Arc<LandmarkSetup>) -> Self {
        Self {
            setup,
            filter: None,
            moved: Moved::default(),
            held: VecDeque::with_capacity(HELD),
            seen_at: None,
            used_at: None,
            standing: Standing::default(),
            relation: Relation::default(),
        }
    }

    /// What carried the filter is broken: it begins anew. How the landmarks' frame lies stays known.
    pub(super) fn interrupt(&mut self) {
        self.filter = None;
        self.moved = Moved::default();
        self.held.clear();
        (self.seen_at, self.used_at) = (None, None);
        self.standing = Standing::default();
    }

    /// NED's origin has moved: surveyed landmarks have other coordinates now.
    pub(super) fn origin_moved(&mut self, moved_ned: &Vector3<f64>) {
        match self.setup.frame {
            LandmarkFrame::Surveyed => self.interrupt(),
            LandmarkFrame::Local => self.relation.origin_moved(moved_ned),
        }
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

    /// Gives the filter the sightings that had overtaken the motion, as far as that has come.
    fn give_held(&mut self, tally: &mut Tally) {
        let Some(now) = self.filter.as_ref().map(LandmarkFilter::time) else { return };
        for _ in 0..self.held.len() {
            match self.held.pop_front() {
                Some(s) if s.time > now => self.held.push_back(s),
                Some(s) => {
                    let verdict = self.give(s);
                    tally.count(SampleKind::Landmark, verdict);
                }
                None => return,
            }
        }
    }
}

impl Navigator {
    pub(super) fn landmark(&mut self, s: &LandmarkSample) -> Verdict {
        let Some(sense) = &self.landmarks else { return Verdict::Rejected(Reason::NotUsed) };
        let Some((camera, delay_s)) = sense.setup.camera(s.camera) else {
            return Verdict::Rejected(Reason::UnknownCamera);
        };
        let time = s.time - Span::from_seconds(delay_s);
        let seen = match s.sighting {
            Sighting::Bearing { angle_xy, distance_m } => Seen::Angles { angle_xy, distance_m },
            Sighting::Body(p) => Seen::InBody(p),
        };
        let Some(filter) = &sense.filter else { return Verdict::Rejected(Reason::NoReferenceYet) };
        let blind = sense.seen_at.is_none_or(|t| filter.time().seconds_since(t) > BLIND_S);
        if filter.map().get(s.id).is_none() {
            return Verdict::Rejected(Reason::UnknownLandmark);
        }
        let guess = if blind { self.landmark_guess(filter.map()) } else { None };
        let Some(sense) = &mut self.landmarks else { return Verdict::Rejected(Reason::NotUsed) };
        if let (Some(guess), Some(filter)) = (guess, &mut sense.filter) {
            filter.restart(&guess);
        }
        let newest = sense.filter.as_ref().map(LandmarkFilter::time);
        sense.seen_at = sense.seen_at.max(newest);
        sense.give(LandmarkSighting { time, camera, id: s.id, seen })
    }

    /// One IMU sample: the filter is carried on.
    pub(super) fn feel_landmarks(&mut self, now: AutopilotTime, dt: f64) {
        if self.landmarks.is_none() || self.modes.mode() == Mode::Aligning {
            return;
        }
        let Some((_, velocity_ned)) = self.estimate() else { return };
        let velocity_body = self.r_body_to_ned.tr_mul(&velocity_ned);
        let rate = self.angular_rate_body;
        let down: Vector3<f64> = self.r_body_to_ned.row(2).transpose();
        let Some(sense) = &mut self.landmarks else { return };
        if sense.filter.is_none() {
            self.start_landmarks(now);
            return;
        }
        let Some(filter) = &mut sense.filter else { return };
        let moved = &mut sense.moved;
        moved.dt_s += dt;
        moved.way_body += velocity_body * dt;
        moved.turn_body += rate * dt;
        if moved.dt_s < PUSH_S {
            return;
        }
        let motion = BodyMotion {
            velocity_body: moved.way_body / moved.dt_s,
            angular_rate_body: moved.turn_body / moved.dt_s,
        };
        *moved = Moved::default();
        if filter.push(now, &motion, Some(&down)) == MotionVerdict::OutOfOrder {
            return sense.interrupt();
        }
        sense.give_held(&mut self.tally);
        self.judge_landmarks(now);
    }

    fn start_landmarks(&mut self, now: AutopilotTime) {
        let (Some(sense), Some(place)) = (&self.landmarks, &self.place) else { return };
        let Ok(map) = sense.setup.map(&place.frame) else { return };
        let Some(guess) = self.landmark_guess(&map) else { return };
        let setup = &sense.setup;
        let filter = LandmarkFilter::new(setup.filter, map, setup.landmark_cameras(), now, &guess);
        if let Some(sense) = &mut self.landmarks {
            sense.filter = Some(filter);
        }
    }

    /// Where the navigator believes to be in the landmarks' frame.
    fn landmark_guess(&self, map: &LandmarkMap) -> Option<PoseGuess> {
        let sense = self.landmarks.as_ref()?;
        let (p, _) = self.estimate()?;
        let (covariance, _) = self.covariances();
        let sigma = covariance.diagonal().max().max(0.0).sqrt().max(GUESS_M);
        let attitude_sigma_rad = self.attitude_variance().max().max(0.0).sqrt().max(GUESS_RAD);
        let r = self.r_body_to_ned;
        let at = |(position_ned, r_body_to_ned): (Vector3<f64>, Matrix3<f64>), position_sigma_m: f64| {
            PoseGuess { position_ned, r_body_to_ned, position_sigma_m, attitude_sigma_rad }
        };
        Some(match (sense.setup.frame, sense.relation.known()) {
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
