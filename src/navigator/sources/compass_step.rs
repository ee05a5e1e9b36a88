//! Whether the magnetometer's heading goes otherwise than the gyros', over seconds: with GNSS or without, nothing else is needed.
//!
//! A field that was measured a moment ago, turned by what the gyros felt since, is what should be measured now; the angle between their headings is the *change*.
//! δ is the heading of the field, turned to NED by the attitude, less that of the place: how far the magnetometer is from the filter, which moves slowly.
//! How large changes within [`BEFORE_S`] are, and how far δ goes from its mean over seconds, is learned of every vehicle (currents, iron, latency), as
//! standard deviations. A change of more than 5 of them, and than [`LEAST_STEP`], that stays is a *step*. Gyros do not step: the magnetometer is wrong. A δ that goes as
//! far from its mean without a step *drifts* there at a steady rate, which is what a gyro's bias does that has changed: then it is the bias that is
//! not known any more, and the magnetometer shows it. Where the vehicle has turned meanwhile, iron on it or a magnetometer that was moved looks the same: then neither is
//! believed.

use nalgebra::Vector3;

use crate::time::AutopilotTime;

use crate::geo::so3::wrap_pi;
use crate::navigator::tuning::compass_step::{
    BEFORE_S, CALM, LATENCY_S, LEAST_STEP, LONGEST_GAP_S, MEAN_S, SIGMAS, SPREAD_S, STANDS_S, TURNS, USUAL_S,
};

/// Past fields that are remembered.
const PAST: usize = 8;

/// A field, body, T, and when.
type Field = (AutopilotTime, Vector3<f64>);

/// What is compared at a time.
pub(super) struct Heard<'a> {
    pub(super) field: Field,
    /// δ, rad.
    pub(super) delta: f64,
    /// How fast the vehicle turns, rad/s.
    pub(super) rate: f64,
    /// The change since an earlier field, rad.
    pub(super) change: &'a dyn Fn(&Field) -> Option<f64>,
}

/// How the magnetometer's heading left the gyros'.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) enum Departure {
    /// At once, by so much, rad.
    Stepped(f64),
    /// At this rate, rad/s.
    Drifted(f64),
    /// At this rate, rad/s, while the vehicle turned: what is fixed to it may be what is wrong, or the gyros.
    Unclear(f64),
}

/// A standard deviation: the plain one at first, a low pass later.
#[derive(Clone, Copy, Debug, Default)]
struct Usual {
    variance: f64,
    seconds: f64,
}

impl Usual {
    fn learn(&mut self, dt: f64, value: f64) {
        self.seconds = (self.seconds + dt).min(SPREAD_S);
        self.variance += (value * value - self.variance) * (dt / self.seconds.max(1e-3)).min(1.0);
    }

    fn limit(&self) -> f64 {
        (SIGMAS * self.variance.sqrt()).max(LEAST_STEP)
    }
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StepWatch {
    last: Option<AutopilotTime>,
    /// Fields of late, body, T, and how fast the vehicle turned, rad/s.
    past: [Option<(Field, f64)>; PAST],
    next: usize,
    /// Its mean, rad.
    mean: f64,
    /// Of its changes, and of how far it is from the mean.
    changes: Usual,
    spread: Usual,
    /// It may have stepped: since when, from what.
    stepped: Option<(AutopilotTime, Field)>,
    /// Since when it has been further away than half of what it may be, and by how much then.
    half: Option<(AutopilotTime, f64)>,
    /// By how much the vehicle has turned since, rad.
    turned: f64,
}

impl StepWatch {
    pub(super) fn observe(&mut self, heard: &Heard<'_>) -> Option<Departure> {
        let time = heard.field.0;
        let dt = self.last.replace(time).map_or(0.0, |t| time.seconds_since(t));
        if !(0.0..LONGEST_GAP_S).contains(&dt) {
            self.forget();
            return None;
        }
        let fastest = self.past.iter().flatten().map(|(_, rate)| *rate).fold(heard.rate, f64::max);
        let late = LATENCY_S * fastest;
        let departure = self.steps(heard, dt, late).or_else(|| self.drifts(heard, dt, late));
        self.remember(heard.field, heard.rate);
        if departure.is_some() {
            self.forget();
        }
        departure
    }

    fn steps(&mut self, heard: &Heard<'_>, dt: f64, late: f64) -> Option<Departure> {
        let (time, limit) = (heard.field.0, self.changes.limit() + late);
        if let Some((since, from)) = self.stepped {
            let by = (heard.change)(&from);
            if by.is_none_or(|by| by.abs() < 0.5 * limit) {
                // It was a spike: what was remembered of it is no measure.
                (self.stepped, self.past) = (None, [None; PAST]);
            }
            return by.filter(|_| time.seconds_since(since) > STANDS_S).map(Departure::Stepped);
        }
        let before = self.before(time)?;
        let change = (heard.change)(&before)?;
        if self.changes.seconds > USUAL_S && change.abs() > limit {
            self.stepped = Some((time, before));
        } else if late < CALM {
            self.changes.learn(dt, change);
        }
        None
    }

    fn drifts(&mut self, heard: &Heard<'_>, dt: f64, late: f64) -> Option<Departure> {
        let time = heard.field.0;
        let away = wrap_pi(heard.delta - self.mean);
        let limit = self.spread.limit() + late;
        if self.stepped.is_some() {
            return None;
        }
        if self.spread.seconds < USUAL_S || away.abs() < 0.5 * limit {
            self.mean += away * (dt / self.spread.seconds.clamp(1e-3, MEAN_S)).min(1.0);
            if late < CALM {
                self.spread.learn(dt, away);
            }
            (self.half, self.turned) = (None, 0.0);
            return None;
        }
        self.turned += heard.rate * dt;
        let (since, then) = *self.half.get_or_insert((time, away));
        let seconds = time.seconds_since(since);
        if away.abs() < limit || away * then < 0.0 || seconds < STANDS_S {
            return None;
        }
        let rate = (away - then) / seconds;
        Some(if self.turned < TURNS { Departure::Drifted(rate) } else { Departure::Unclear(rate) })
    }

    /// The field of [`BEFORE_S`] ago.
    fn before(&self, time: AutopilotTime) -> Option<Field> {
        let old = self
            .past
            .iter()
            .flatten()
            .map(|(field, _)| field)
            .filter(|(t, _)| time.seconds_since(*t) >= BEFORE_S);
        old.max_by_key(|(t, _)| *t).copied()
    }

    fn remember(&mut self, field: Field, rate: f64) {
        let newest = self.past[(self.next + PAST - 1) % PAST];
        if newest.is_none_or(|((t, _), _)| field.0.seconds_since(t) >= BEFORE_S / (PAST - 2) as f64) {
            self.past[self.next] = Some((field, rate));
            self.next = (self.next + 1) % PAST;
        }
    }

    /// What is usual is not known.
    pub(super) fn forget(&mut self) {
        *self = Self { last: self.last, ..Self::default() };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten samples a second of noise of 3 degrees, and what is added to it after a minute.
    fn fly(added: impl Fn(f64) -> f64) -> Option<(f64, Departure)> {
        let mut watch = StepWatch::default();
        (0..1200).find_map(|k| {
            let t = f64::from(k) * 0.1;
            let noise = 0.07 * (7.3 * t).sin() + 0.03 * (0.4 * t).cos();
            // What the gyros feel is nothing: a drift is all of it theirs.
            let delta = noise + if t > 60.0 { added(t - 60.0) } else { 0.0 };
            let field = Vector3::new(delta.cos(), delta.sin(), 0.0);
            let change = |(_, then): &Field| Some(wrap_pi(delta - then.y.atan2(then.x)));
            let time = AutopilotTime::from_micros(i64::from(k) * 100_000);
            let heard = Heard { field: (time, field), delta, rate: 0.0, change: &change };
            watch.observe(&heard).map(|d| (t, d))
        })
    }

    #[test]
    fn a_step_is_the_magnetometers_and_a_drift_the_gyros() {
        assert_eq!(fly(|_| 0.0), None);
        for step in [0.52, -1.57, 3.0] {
            let Some((t, Departure::Stepped(by))) = fly(|_| step) else { panic!("{step}") };
            assert!(t < 62.0 && (by - step).abs() < 0.2, "{t} {by}");
        }
        let Some((t, Departure::Drifted(rate))) = fly(|t| 0.052 * t) else { panic!("a drift") };
        assert!(t < 75.0 && (0.03..0.2).contains(&rate), "{t} {rate}");
    }

    #[test]
    fn a_spike_is_neither() {
        assert_eq!(fly(|t| if t < 0.3 { 1.0 } else { 0.0 }), None);
    }
}
