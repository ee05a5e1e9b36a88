//! Pose of a drone from landmarks with known coordinates, by bearings that come late, out of order, and sometimes of the wrong landmark.
//!
//! The caller pushes how the body moves (velocity and rate in body axes) and, when it has one, the direction of gravity; and gives sightings
//! as they come. Everything between is dead-reckoned ([`super::dead_reckoning`]), sightings take effect in the order in which they were made
//! ([`super::ordered`]), on two filters ([`super::tracker`]). The pose is the refining filter's while there is one, else the H∞ filter's.
//!
//! "NED" in names is the landmarks' frame: NED at the origin when they are surveyed; a local frame with z down otherwise.

use nalgebra::{Matrix3, Matrix6, Vector3};

use super::dead_reckoning::{DeadReckoned, DeadReckoning, MotionVerdict, NotRemembered};
use super::geometry::Observability;
use super::hinf::Definiteness;
use super::information::{Information, SeenInD};
use super::motion::BodyMotion;
use super::ordered::{NotTaken, Ordered, Place};
use super::refined::{Refined, Rigid};
use super::settings::{LandmarkCamera, LandmarkMap, LandmarkSettings};
use super::sighting::{LandmarkSighting, SightingVerdict, in_d};
use super::tracker::{Tracker, TrackerEvent};
use crate::time::{AutopilotTime, Span};

/// Where a filter starts: a pose, and how far it may be off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseGuess {
    /// Position in the landmarks' frame, m.
    pub position_ned: Vector3<f64>,
    /// Attitude.
    pub r_body_to_ned: Matrix3<f64>,
    /// σ of each axis of the position, m.
    pub position_sigma_m: f64,
    /// σ of the attitude about each axis, rad. From [`PoseGuess::ANY_ATTITUDE`] on nothing is known of it; below [`PoseGuess::GOOD_ATTITUDE`]
    /// the refining filter starts from it at once.
    pub attitude_sigma_rad: f64,
}

impl PoseGuess {
    /// σ of each element of the rotation matrix when it may be any.
    pub const ANY_ATTITUDE: f64 = 1.2;
    /// As far as a linearisation about the guess reaches.
    pub const GOOD_ATTITUDE: f64 = 0.35;
}

/// Which filter a pose is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseSource {
    /// The H∞ filter: the refining one has not begun.
    Acquiring,
    /// The refining filter.
    Refined,
}

/// A pose from landmarks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LandmarkPose {
    /// When it holds.
    pub time: AutopilotTime,
    /// Position in the landmarks' frame, m.
    pub position_ned: Vector3<f64>,
    /// Attitude.
    pub r_body_to_ned: Matrix3<f64>,
    /// Covariance of [position (m), attitude (rad)], both in the landmarks' frame.
    pub covariance: Matrix6<f64>,
    /// Of which filter.
    pub source: PoseSource,
    /// Whether it can be relied on: refined, its sigmas below the settings', most sightings used, and the landmarks able to tell.
    pub converged: bool,
}

/// How the filters are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LandmarkHealth {
    /// Whether the H∞ filter's cost has a minimum.
    pub definiteness: Definiteness,
    /// Whether what was seen can tell a pose.
    pub observability: Observability,
    /// Smoothed part of sightings that the H∞ filter and the refining filter rejected.
    pub rejected: [f64; 2],
    /// How often the H∞ filter got out of a lock-out.
    pub lockouts: u32,
    /// How often the refining filter began anew.
    pub resets: u32,
}

/// The filter.
#[derive(Clone, Debug)]
pub struct LandmarkFilter {
    settings: LandmarkSettings,
    map: LandmarkMap,
    cameras: Vec<LandmarkCamera>,
    reckoning: DeadReckoning,
    ordered: Ordered<Tracker>,
    gravity_at: AutopilotTime,
    restarts: u32,
}

/// Ranks of events of the same time: sightings by camera, landmark and where it was seen; then what comes with the motion.
const GRAVITY_RANK: u64 = 1 << 48;
const BREAK_RANK: u64 = GRAVITY_RANK + 1;

/// A camera may see two landmarks of one id, of which one is another: both are judged, in an order that is the same whichever comes first.
/// The same message heard twice has the same rank.
fn rank(sighting: &LandmarkSighting, seen: &SeenInD) -> u64 {
    let fold = |hash: u64, v: &f64| (hash ^ v.to_bits()).wrapping_mul(0x0100_0000_01b3).rotate_left(23);
    let distance = seen.distance.map_or(0.0, |d| d[0]);
    let hash = seen.direction_d.iter().chain([&distance]).fold(0xcbf2_9ce4_8422_2325, fold);
    u64::from(sighting.camera) << 40 | u64::from(sighting.id) << 32 | hash >> 32
}

impl LandmarkFilter {
    /// Starts at `time` with a guess of the pose, which may be far off.
    pub fn new(
        settings: LandmarkSettings,
        map: LandmarkMap,
        cameras: Vec<LandmarkCamera>,
        time: AutopilotTime,
        guess: &PoseGuess,
    ) -> Self {
        let reckoning = DeadReckoning::new(time, settings.history_s, settings.gap_s, settings.motions);
        let tracker = started(&map, time, guess, &reckoning.present());
        let ordered = Ordered::new(tracker, settings.events);
        Self { settings, map, cameras, reckoning, ordered, gravity_at: time, restarts: 0 }
    }

    /// Starts again at the present from a guess of the pose.
    pub fn restart(&mut self, guess: &PoseGuess) {
        let (time, at) = (self.reckoning.time(), self.reckoning.present());
        let tracker = started(&self.map, time, guess, &at);
        self.ordered = Ordered::new(tracker, self.settings.events);
        self.restarts += 1;
    }

    /// The landmarks.
    pub fn map(&self) -> &LandmarkMap {
        &self.map
    }

    /// Until when the motion is known.
    pub fn time(&self) -> AutopilotTime {
        self.reckoning.time()
    }

    /// Goes on to `time` with a motion that was held since the last. `down_body` is the direction of gravity (down) in the body, where it is
    /// known to [`LandmarkSettings::gravity_sigma_rad`]. Allocates nothing.
    pub fn push(
        &mut self,
        time: AutopilotTime,
        motion: &BodyMotion,
        down_body: Option<&Vector3<f64>>,
    ) -> MotionVerdict {
        let verdict = self.reckoning.push(time, motion);
        match verdict {
            MotionVerdict::Used => {}
            MotionVerdict::Gap(_) => self.take((time, BREAK_RANK), TrackerEvent::Break),
            MotionVerdict::NotFinite | MotionVerdict::OutOfOrder => return verdict,
        }
        self.ordered.close(time - Span::from_seconds(self.settings.history_s));
        let due = time - self.gravity_at >= Span::from_seconds(self.settings.gravity_period_s);
        if let Some(down) = down_body.filter(|_| due)
            && let Some(down) = down.try_normalize(1e-3).filter(|d| d.iter().all(|v| v.is_finite()))
        {
            let at = self.reckoning.present();
            self.gravity_at = time;
            self.take((time, GRAVITY_RANK), TrackerEvent::Gravity(at.r_body_to_d * down, at.position_d));
        }
        verdict
    }

    fn take(&mut self, place: Place, event: TrackerEvent) {
        // An event of the present is never too late, and is the only one of its rank.
        let _ = self.ordered.insert(&self.settings, place, event);
    }

    /// Takes a sighting, however late within the history.
    pub fn sighting(&mut self, sighting: &LandmarkSighting) -> SightingVerdict {
        let Some(landmark) = self.map.get(sighting.id) else { return SightingVerdict::UnknownId };
        let Some(camera) = self.cameras.get(usize::from(sighting.camera)) else {
            return SightingVerdict::UnknownCamera;
        };
        let then = match self.reckoning.at(sighting.time) {
            Ok(then) => then,
            Err(NotRemembered::Future(by)) => return SightingVerdict::FromTheFuture(by),
            Err(NotRemembered::Past(by)) => return SightingVerdict::TooOld(by),
        };
        let offset = landmark - self.map.centroid();
        let seen = match in_d(&sighting.seen, &offset, camera, &then, &self.settings) {
            Ok(seen) => seen,
            Err(verdict) => return verdict,
        };
        let place = (sighting.time, rank(sighting, &seen));
        match self.ordered.insert(&self.settings, place, TrackerEvent::Sighting(sighting.id, seen)) {
            Ok(SightingVerdict::Indefinite) => {
                if let Some(pose) = self.pose() {
                    self.restart(&PoseGuess {
                        position_ned: pose.position_ned,
                        r_body_to_ned: pose.r_body_to_ned,
                        position_sigma_m: self.settings.distance_clip_m[1],
                        attitude_sigma_rad: PoseGuess::ANY_ATTITUDE,
                    });
                }
                SightingVerdict::Indefinite
            }
            Ok(verdict) => verdict,
            Err(NotTaken::Taken) => SightingVerdict::Duplicate,
            Err(NotTaken::Closed) => SightingVerdict::TooOld(0.0),
        }
    }

    /// The filters at the present.
    fn now(&self) -> Tracker {
        let mut tracker = self.ordered.latest().clone();
        tracker.advance(&self.settings, self.reckoning.time());
        tracker
    }

    /// The pose at the present. `None` while N says nothing of an attitude.
    pub fn pose(&self) -> Option<LandmarkPose> {
        let (now, at, time) = (self.now(), self.reckoning.present(), self.reckoning.time());
        let Some(refined) = &now.refined else {
            return self.acquiring_pose();
        };
        let (position_ned, r_body_to_ned, covariance) = refined.pose(&at, &self.map.centroid());
        let sigma =
            |from: usize| (from..from + 3).map(|i| covariance[(i, i)]).fold(0.0, f64::max).max(0.0).sqrt();
        let [position, attitude] = self.settings.belief.converged_sigma;
        let converged = sigma(0) < position
            && sigma(3) < attitude
            && now.rejected[1] < self.settings.belief.lockout_part
            && now.geometry.observability() == Observability::Observable;
        let source = PoseSource::Refined;
        let pose = LandmarkPose { time, position_ned, r_body_to_ned, covariance, source, converged };
        pose.covariance.iter().chain(pose.position_ned.iter()).all(|v| v.is_finite()).then_some(pose)
    }

    /// The H∞ filter's pose at the present, whichever is the shipped one. Its covariance takes its errors as independent.
    pub fn acquiring_pose(&self) -> Option<LandmarkPose> {
        let (now, at) = (self.now(), self.reckoning.present());
        let (from_centroid, r_body_to_ned) = now.hinf.pose(&at)?;
        let [position, rotation] = now.hinf.sigmas()?;
        let arm = (at.position_d - now.hinf.q()).norm();
        let variance =
            |i: usize| if i < 3 { position.powi(2) + (rotation * arm).powi(2) } else { rotation.powi(2) };
        Some(LandmarkPose {
            time: self.reckoning.time(),
            position_ned: from_centroid + self.map.centroid(),
            r_body_to_ned,
            covariance: Matrix6::from_fn(|i, j| if i == j { variance(i) } else { 0.0 }),
            source: PoseSource::Acquiring,
            converged: false,
        })
    }

    /// Ids of landmarks most of whose sightings are rejected of late.
    pub fn suspects(&self) -> impl Iterator<Item = u8> + '_ {
        self.ordered.latest().geometry.suspects()
    }

    /// How the filters are.
    pub fn health(&self) -> LandmarkHealth {
        let now = self.ordered.latest();
        let definite = now.hinf.is_definite();
        LandmarkHealth {
            definiteness: if definite { Definiteness::Definite } else { Definiteness::Indefinite },
            observability: now.geometry.observability(),
            rejected: now.rejected,
            lockouts: now.lockouts,
            resets: now.resets + self.restarts,
        }
    }
}

fn started(map: &LandmarkMap, time: AutopilotTime, guess: &PoseGuess, at: &DeadReckoned) -> Tracker {
    let (position, rotation) =
        (guess.position_sigma_m, guess.attitude_sigma_rad.min(PoseGuess::ANY_ATTITUDE));
    let from_centroid = guess.position_ned - map.centroid();
    let hinf = Information::new(&from_centroid, &guess.r_body_to_ned, at, position, rotation);
    let refined = (rotation < PoseGuess::GOOD_ATTITUDE).then(|| {
        let rigid = Rigid { centroid_d: hinf.q(), r_to_d: hinf.n() };
        // The centroid's doubt is the position's and what the attitude's makes of the way there.
        Refined::new(rigid, rotation, position.hypot(rotation * from_centroid.norm()))
    });
    Tracker::new(time, hinf, refined)
}
