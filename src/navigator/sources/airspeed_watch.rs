//! Whether a pitot tube tells what the filter expects of it.
//!
//! What it tells less what velocity, wind and scale make of it, and what it has itself moved that by in the last seconds added back (a filter without
//! GNSS follows its airspeed), in the mean of a second, less what that lasts at: the *deviation*. Gusts make some of it, which is learned of every vehicle; what the filter does
//! not know, and what a tilt that is wrong adds in those seconds, make the rest. One beyond [`SIGMAS`] of all of that, and beyond what a scale within
//! its prior can be, that stays for [`STANDS_S`], is the tube's: neither inertia nor GNSS shows it, and no wind changes so.

use nalgebra::{Vector2, Vector3};

use super::parting::{LedAway, Parted, PartingPoint, parted};
use crate::geo::STANDARD_GRAVITY_MPS2;
use crate::time::{AutopilotTime, Span};

use crate::navigator::tuning::airspeed::{
    BACK, BACK_S, BACK_SIGMAS, LASTING_S, LEARNED, LONGEST_GAP_S, MEAN_S, MOVED_S, POINT_S, POINTS, PRIOR_S,
    SCALE_SIGMAS, SIGMAS, SPREAD_S, STANDS_S, USUAL_S,
};

/// What is weighed at a time.
pub(super) struct WeighedAirspeed {
    pub(super) time: AutopilotTime,
    /// What it tells, and what is expected, m/s; the variance of the latter, (m/s)².
    pub(super) told: f64,
    pub(super) expected: f64,
    pub(super) variance: f64,
    /// Standard deviation of the tilt, rad.
    pub(super) tilt: f64,
    /// Standard deviations of gusts before they were seen, m/s, and of the scale.
    pub(super) gusts: f64,
    pub(super) scale: f64,
    /// GNSS tells the velocity.
    pub(super) gnss: bool,
    /// Direction of the velocity through the air, NE, and what the acceleration has added up to in this epoch, m/s.
    pub(super) along_ne: Vector2<f64>,
    pub(super) impulse_ne: Option<Vector2<f64>>,
    pub(super) epoch: u32,
}

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) enum AirFinding {
    /// It does not tell the airspeed; it did until this time. It may be inertia that has led away, so.
    Astray { since: AutopilotTime, or_led: Option<LedAway> },
    /// It does, and it is inertia that has led away, so.
    LedAway(LedAway),
    /// It does again.
    Back,
    /// It did: the wind is another, by as much, north and east, known to this, m/s.
    AnotherWind(Vector2<f64>, f64),
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct AirspeedWatch {
    last: Option<AutopilotTime>,
    /// What was expected of it last, m/s, and the specific force then, NED, m/s².
    expected: f64,
    force_ned: Vector3<f64>,
    /// What it has moved the velocity by of late, m/s, and by way of tilt and bias the acceleration, m/s².
    moved: f64,
    bent: f64,
    /// The mean of a second, and what it lasts at, which is wind and scale that the filter still learns, m/s.
    mean: f64,
    lasting: f64,
    /// Sum of its squares over time, m²/s, and that time, s.
    squares: f64,
    seconds: f64,
    /// Since when it is beyond its limit, or within it again where it is astray.
    since: Option<AutopilotTime>,
    /// By how much it was astray at most, m/s.
    gone: Option<f64>,
    parting: PartingPoints,
}

/// What it tells, along the nose, less what inertia has added up to, in the means of some tenths of a second.
#[derive(Clone, Copy, Debug, Default)]
struct PartingPoints {
    /// The newest first; the first goes on.
    points: [PartingPoint; POINTS],
    known: usize,
    samples: f64,
    epoch: u32,
}

impl PartingPoints {
    fn add(&mut self, w: &WeighedAirspeed) {
        let Some(felt_ne) = w.impulse_ne else { return };
        if self.epoch != w.epoch {
            *self = Self { epoch: w.epoch, ..Self::default() };
        }
        let t = w.time.seconds_since(AutopilotTime::from_micros(0));
        if self.known == 0 || !(0.0..POINT_S).contains(&(t - self.points[0].t)) {
            self.points.rotate_right(1);
            self.known = (self.known + 1).min(POINTS);
            self.samples = 0.0;
            self.points[0] = PartingPoint { t, ..PartingPoint::default() };
        }
        self.samples += 1.0;
        let point = &mut self.points[0];
        point.apart += (w.along_ne * w.told - felt_ne - point.apart) / self.samples;
        point.felt += (felt_ne - point.felt) / self.samples;
        point.off += (w.along_ne * (w.expected - w.told) - point.off) / self.samples;
    }

    fn parted(&self) -> Option<Parted> {
        let mut oldest_first = self.points;
        let known = &mut oldest_first[..self.known];
        known.reverse();
        parted(known)
    }
}

impl AirspeedWatch {
    /// Whether it can be believed.
    pub(super) fn fits(&self) -> bool {
        self.gone.is_none() && self.since.is_none()
    }

    /// Whether it is astray.
    pub(super) fn is_astray(&self) -> bool {
        self.gone.is_some()
    }

    /// The wind may be another: what fits has to be seen anew.
    pub(super) fn doubt(&mut self) {
        (self.squares, self.seconds, self.since) = (0.0, 0.0, None);
    }

    /// It is believed again, whatever it was.
    pub(super) fn believe(&mut self) {
        *self = Self { last: self.last, ..Self::default() };
    }

    /// It cannot be weighed at present.
    pub(super) fn pause(&mut self) {
        (self.last, self.since) = (None, None);
    }

    /// It says nothing at this moment, or is about to be used: what is expected of it, m/s, and the specific force, NED, m/s².
    pub(super) fn expect(&mut self, expected: f64, force_ned: Vector3<f64>) {
        (self.expected, self.force_ned) = (expected, force_ned);
    }

    /// It was used, and now this is expected of it, and the specific force is this, along the airspeed's direction.
    pub(super) fn followed(&mut self, expected: f64, force_ned: &Vector3<f64>, along: &Vector3<f64>) {
        if self.last.is_some() {
            self.moved += expected - self.expected;
            self.bent += along.dot(&(force_ned - self.force_ned));
        }
    }

    fn deviation(&self) -> f64 {
        self.mean - self.lasting
    }

    pub(super) fn weigh(&mut self, w: &WeighedAirspeed) -> Option<AirFinding> {
        self.parting.add(w);
        let dt = self.last.replace(w.time).map_or(f64::INFINITY, |t| w.time.seconds_since(t));
        if !(0.0..LONGEST_GAP_S).contains(&dt) {
            (self.mean, self.moved, self.bent, self.since) = (w.told - w.expected, 0.0, 0.0, None);
            return None;
        }
        self.moved += self.bent * dt;
        if self.fits() {
            self.moved *= 1.0 - dt / MOVED_S;
            self.bent *= 1.0 - dt / MOVED_S;
        }
        let off = w.told - w.expected + self.moved;
        self.mean += (off - self.mean) * (dt / MEAN_S).min(1.0);
        let gusts = (self.squares + w.gusts.powi(2) * PRIOR_S) / (self.seconds + PRIOR_S);
        let tilted = STANDARD_GRAVITY_MPS2 * w.tilt * MOVED_S;
        let sigma = (w.variance + gusts + tilted * tilted).sqrt();
        match self.gone {
            Some(gone) => self.comes_back(w, gone, sigma),
            None => self.goes_astray(w, dt, (SIGMAS * sigma).max(SCALE_SIGMAS * w.scale * w.expected)),
        }
    }

    fn goes_astray(&mut self, w: &WeighedAirspeed, dt: f64, limit: f64) -> Option<AirFinding> {
        if self.seconds < USUAL_S || self.deviation().abs() < limit {
            self.since = None;
            let kept = if self.seconds < SPREAD_S { 1.0 } else { 1.0 - dt / SPREAD_S };
            self.squares = self.squares * kept + self.deviation().abs().min(LEARNED * limit).powi(2) * dt;
            self.seconds = self.seconds * kept + dt;
            let lasts = if self.deviation().abs() < LEARNED * limit { self.deviation() } else { 0.0 };
            self.lasting += lasts * (dt / self.seconds.min(LASTING_S)).min(1.0);
            return None;
        }
        let since = *self.since.get_or_insert(w.time);
        if w.time.seconds_since(since) < STANDS_S {
            return None;
        }
        let parted = self.parting.parted().filter(|_| !w.gnss);
        if let Some(Parted::LedAway(led)) = parted {
            // What is usual is seen anew, with an inertia that it has corrected.
            self.believe();
            return Some(AirFinding::LedAway(led));
        }
        (self.gone, self.since) = (Some(self.deviation().abs()), None);
        (self.moved, self.bent) = (0.0, 0.0);
        let or_led = parted.and_then(Parted::led);
        Some(AirFinding::Astray { since: since - Span::from_seconds(2.0 * MEAN_S), or_led })
    }

    fn comes_back(&mut self, w: &WeighedAirspeed, gone: f64, sigma: f64) -> Option<AirFinding> {
        let gone = gone.max(self.deviation().abs());
        self.gone = Some(gone);
        let limit = BACK_SIGMAS * sigma;
        // Without GNSS inertia has to know the velocity still, to say that it is this.
        if self.deviation().abs() > limit || !w.gnss && limit > BACK * gone {
            self.since = None;
            return None;
        }
        let since = *self.since.get_or_insert(w.time);
        if w.time.seconds_since(since) < BACK_S {
            return None;
        }
        self.believe();
        Some(AirFinding::Back)
    }
}
