//! Whether the magnetometer's heading steps where the gyros feel no turn: with GNSS or without, nothing else is needed.
//!
//! A field that was measured a moment ago, turned by what the gyros felt since, is what should be measured now; the angle between their headings is the
//! *change*. How large changes within [`BEFORE_S`] are, is learned of every vehicle (currents, iron, latency), as a standard deviation. A change of more than
//! 5 of them, and than [`LEAST_STEP`], that stays is a *step*. Gyros do not step: the magnetometer is wrong. (What drifts may be either, and only motion tells.)

use nalgebra::Vector3;

use crate::time::AutopilotTime;

use crate::navigator::tuning::compass_step::{
    BEFORE_S, CALM, LATENCY_S, LEAST_STEP, LONGEST_GAP_S, SIGMAS, SPREAD_S, STANDS_S, USUAL_S,
};

/// Past fields that are remembered.
const PAST: usize = 8;

/// A field, body, T, and when.
type Field = (AutopilotTime, Vector3<f64>);

/// What is compared at a time.
pub(super) struct ComparedField<'a> {
    pub(super) field: Field,
    /// How fast the vehicle turns, rad/s.
    pub(super) rate: f64,
    /// The change since an earlier field, rad.
    pub(super) change: &'a dyn Fn(&Field) -> Option<f64>,
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
    /// Of its changes.
    changes: Usual,
    /// It may have stepped: since when, from what.
    stepped: Option<(AutopilotTime, Field)>,
}

impl StepWatch {
    /// A field. By how much it has stepped, rad, when it has.
    pub(super) fn observe(&mut self, heard: &ComparedField<'_>) -> Option<f64> {
        let time = heard.field.0;
        let dt = self.last.replace(time).map_or(0.0, |t| time.seconds_since(t));
        if !(0.0..LONGEST_GAP_S).contains(&dt) {
            self.forget();
            return None;
        }
        let fastest = self.past.iter().flatten().map(|(_, rate)| *rate).fold(heard.rate, f64::max);
        let late = LATENCY_S * fastest;
        let departure = self.steps(heard, dt, late);
        self.remember(heard.field, heard.rate);
        if departure.is_some() {
            self.forget();
        }
        departure
    }

    fn steps(&mut self, heard: &ComparedField<'_>, dt: f64, late: f64) -> Option<f64> {
        let (time, limit) = (heard.field.0, self.changes.limit() + late);
        if let Some((since, from)) = self.stepped {
            let by = (heard.change)(&from);
            if by.is_none_or(|by| by.abs() < 0.5 * limit) {
                // It was a spike: what was remembered of it is no measure.
                (self.stepped, self.past) = (None, [None; PAST]);
            }
            return by.filter(|_| time.seconds_since(since) > STANDS_S);
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
    use crate::geo::so3::wrap_pi;

    /// Ten samples a second of noise of 3 degrees, and what is added to it after a minute.
    fn fly(added: impl Fn(f64) -> f64) -> Option<(f64, f64)> {
        let mut watch = StepWatch::default();
        (0..1200).find_map(|k| {
            let t = f64::from(k) * 0.1;
            let noise = 0.07 * (7.3 * t).sin() + 0.03 * (0.4 * t).cos();
            let delta = noise + if t > 60.0 { added(t - 60.0) } else { 0.0 };
            let field = Vector3::new(delta.cos(), delta.sin(), 0.0);
            let change = |(_, then): &Field| Some(wrap_pi(delta - then.y.atan2(then.x)));
            let time = AutopilotTime::from_micros(i64::from(k) * 100_000);
            let heard = ComparedField { field: (time, field), rate: 0.0, change: &change };
            watch.observe(&heard).map(|d| (t, d))
        })
    }

    #[test]
    fn a_step_is_found_and_a_drift_is_nobodys() {
        assert_eq!(fly(|_| 0.0), None);
        for step in [0.52, -1.57, 3.0] {
            let Some((t, by)) = fly(|_| step) else { panic!("{step}") };
            assert!(t < 62.0 && (by - step).abs() < 0.2, "{t} {by}");
        }
        assert_eq!(fly(|t| 0.052 * t), None);
    }

    #[test]
    fn a_spike_is_neither() {
        assert_eq!(fly(|t| if t < 0.3 { 1.0 } else { 0.0 }), None);
    }
}
