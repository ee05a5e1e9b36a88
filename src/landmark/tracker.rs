//! What every event does to the two filters: the H∞ filter acquires and watches, the refining filter follows.

use nalgebra::{Matrix3, Vector3};

use super::geometry::Geometry;
use super::information::{Information, Judged, SeenInD, Weighing};
use super::ordered::Replayed;
use super::refined::{Refined, Rigid};
use super::settings::LandmarkSettings;
use super::sighting::SightingVerdict;
use super::tuning::{
    ACQUIRED_POSITION, ACQUIRED_ROTATION, ACQUIRED_SCALE, APART, APART_S, SHAPED, SMOOTHING, TRUSTED,
};
use crate::geo::kabsch_rotation;
use crate::time::AutopilotTime;

/// What happens to a [`Tracker`].
#[derive(Clone, Copy, Debug)]
pub(super) enum TrackerEvent {
    /// A landmark of this id was seen; its Q is relative to the field's centroid.
    Sighting(u8, SeenInD),
    /// The direction of gravity in D, and where the body is.
    Gravity(Vector3<f64>, Vector3<f64>),
    /// The dead reckoning broke.
    Break,
}

/// Both filters at a time.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tracker {
    pub(super) time: AutopilotTime,
    /// Landmarks' coordinates in it are relative to their centroid, which conditions it.
    pub(super) hinf: Information,
    pub(super) refined: Option<Refined>,
    pub(super) geometry: Geometry,
    /// Smoothed parts of rejected sightings: H∞, refined.
    pub(super) rejected: [f64; 2],
    /// What the H∞ filter has acquired: the transformation, and sigmas of its attitude (rad) and centroid (m).
    acquired: Option<(Rigid, f64, f64)>,
    /// When that was looked at last: once a picture.
    looked_at: Option<AutopilotTime>,
    /// Since when the refining filter contradicts its monitor.
    apart_since: Option<AutopilotTime>,
    pub(super) resets: u32,
    pub(super) lockouts: u32,
    body_d: Vector3<f64>,
    /// Sightings used since N was free to be anything.
    shaped_by: u32,
}

impl Tracker {
    pub(super) fn new(time: AutopilotTime, hinf: Information, refined: Option<Refined>) -> Self {
        Self {
            time,
            hinf,
            refined,
            geometry: Geometry::new(),
            rejected: [0.0; 2],
            acquired: None,
            looked_at: None,
            apart_since: None,
            resets: 0,
            lockouts: 0,
            body_d: Vector3::zeros(),
            shaped_by: 0,
        }
    }

    /// Goes on to a time.
    pub(super) fn advance(&mut self, settings: &LandmarkSettings, time: AutopilotTime) {
        let dt_s = time.seconds_since(self.time).max(0.0);
        self.hinf.forget(settings.lambda, dt_s);
        self.geometry.forget(dt_s);
        if let Some(refined) = &mut self.refined {
            refined.drift(dt_s, &self.body_d, settings);
        }
        self.time = self.time.max(time);
    }

    /// The H∞ filter's transformation, when it has acquired one.
    fn acquire(&self, settings: &LandmarkSettings) -> Option<(Rigid, f64, f64)> {
        if self.rejected[0] > TRUSTED {
            return None;
        }
        let n = self.hinf.n();
        let product = n.tr_mul(&n);
        let scale = (0..3).map(|i| (product[(i, i)] - 1.0).abs()).fold(0.0, f64::max);
        let skew = product.m12.abs().max(product.m13.abs()).max(product.m23.abs());
        if scale.max(skew) > 2.0 * ACQUIRED_SCALE {
            return None;
        }
        let [position, rotation] = self.hinf.sigmas()?;
        let far = settings.distance_clip_m[1];
        if rotation > ACQUIRED_ROTATION || position > ACQUIRED_POSITION * far {
            return None;
        }
        let r_to_d = kabsch_rotation(&n)?;
        Some((Rigid { centroid_d: self.hinf.q(), r_to_d }, rotation, position))
    }

    fn sighting(&mut self, settings: &LandmarkSettings, id: u8, seen: &SeenInD) -> SightingVerdict {
        let how = Weighing {
            bearing_sigma_rad: settings.bearing_sigma_rad,
            distance_clip_m: settings.distance_clip_m,
            gate: settings.belief.gate,
            weight: 1.0,
        };
        let monitor = self.hinf.sighting(seen, &how);
        let is_new = self.looked_at != Some(self.time);
        if is_new {
            (self.acquired, self.looked_at) = (self.acquire(settings), Some(self.time));
        }
        let about = self.acquired.map(|a| a.0);
        let fine = self.refined.as_mut().and_then(|r| {
            let about = about.unwrap_or(*r.state());
            r.sighting(seen, &seen.landmark, &about, settings)
        });
        for (rejected, judged) in self.rejected.iter_mut().zip([monitor, fine]) {
            if let Some(judged) = judged {
                *rejected += SMOOTHING * (f64::from(u8::from(!judged.used)) - *rejected);
            }
        }
        if monitor.is_some_and(|m| m.used) {
            self.shaped_by = self.shaped_by.saturating_add(1);
        }
        self.unlock(settings);
        if is_new {
            self.watch();
        }
        if let Some(judged) = fine.or(monitor) {
            self.geometry.judged(id, judged.used);
        }
        match fine.or(monitor) {
            Some(Judged { ratio, used: true }) => {
                self.geometry.used(id, &seen.landmark);
                SightingVerdict::Used(ratio)
            }
            Some(Judged { ratio, used: false }) => SightingVerdict::Gated(ratio),
            None => SightingVerdict::Indefinite,
        }
    }

    /// Ways out of a lock-out: a filter that rejects most of what it is shown is wrong.
    fn unlock(&mut self, settings: &LandmarkSettings) {
        let [hinf, refined] = &mut self.rejected;
        if *hinf > settings.belief.lockout_part {
            self.hinf.inflate(settings.belief.lockout_factor);
            *hinf = 0.5 * settings.belief.lockout_part;
            self.lockouts += 1;
            (self.shaped_by, self.acquired) = (0, None);
        }
        if *refined > settings.belief.lockout_part {
            (self.refined, *refined) = (None, 0.0);
            self.resets += 1;
        }
    }

    /// Starts the refining filter when the H∞ filter has acquired, and resets it when it contradicts for long.
    fn watch(&mut self) {
        if self.refined.as_ref().is_some_and(|r| !r.is_finite()) {
            self.refined = None;
        }
        let Some((rigid, rotation, position)) = self.acquired else {
            self.apart_since = None;
            return;
        };
        let begin = || Some(Refined::new(rigid, 3.0 * rotation, 2.0 * position));
        let Some(refined) = &self.refined else {
            self.refined = begin();
            self.rejected[1] = 0.0;
            return;
        };
        let e = refined.from(&rigid);
        let p = refined.covariance();
        let part = |from: usize, sigma: f64| {
            let s = p.fixed_view::<3, 3>(from, from) + Matrix3::from_diagonal_element(sigma * sigma);
            let e = e.fixed_rows::<3>(from).into_owned();
            s.cholesky().map_or(f64::INFINITY, |s| e.dot(&s.solve(&e)))
        };
        if part(0, rotation) + part(3, position) < APART {
            self.apart_since = None;
            return;
        }
        let since = *self.apart_since.get_or_insert(self.time);
        if self.time.seconds_since(since) > APART_S {
            self.refined = begin();
            (self.apart_since, self.rejected[1]) = (None, 0.0);
            self.resets += 1;
        }
    }
}

impl Replayed for Tracker {
    type Event = TrackerEvent;
    type Verdict = SightingVerdict;
    type Context = LandmarkSettings;

    fn apply(
        &mut self,
        settings: &LandmarkSettings,
        time: AutopilotTime,
        event: &TrackerEvent,
    ) -> SightingVerdict {
        self.advance(settings, time);
        match event {
            TrackerEvent::Sighting(id, seen) => {
                self.body_d = seen.camera_d;
                self.sighting(settings, *id, seen)
            }
            TrackerEvent::Gravity(down_d, body_d) => {
                self.body_d = *body_d;
                let sigma = settings.gravity_sigma_rad;
                let used = self.hinf.gravity(down_d, sigma);
                if settings.orthonormality_weight > 0.0 && self.shaped_by >= SHAPED {
                    self.hinf.orthonormality(settings.orthonormality_weight);
                }
                if let Some(refined) = &mut self.refined {
                    refined.gravity(down_d, sigma);
                }
                used.map_or(SightingVerdict::Indefinite, |()| SightingVerdict::Used(0.0))
            }
            TrackerEvent::Break => {
                self.hinf.inflate(settings.belief.lockout_factor);
                (self.refined, self.acquired, self.shaped_by) = (None, None, 0);
                SightingVerdict::Used(0.0)
            }
        }
    }
}
