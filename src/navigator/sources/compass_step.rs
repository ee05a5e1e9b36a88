//! Whether the magnetometer's heading steps where the gyros feel no turn: with GNSS or without, nothing else is needed.
//!
//! A field that was measured a moment ago, turned by what the gyros felt since, is what should be measured now; the horizontal part of their difference, over the
//! horizontal field of the place, is the *change*: what the heading is turned by, at this attitude or at another. How large changes within [`BEFORE_S`] are, is learned of every vehicle (currents, iron, latency), as a standard deviation. A change of more than
//! 5 of them, and than [`LEAST_STEP`], that stays is a *step*, if it is one of the heading, or if most of it came between two samples: a gyro that fails turns
//! all of the field little by little. Gyros do not step: the magnetometer is wrong. A heading that moves within that time, but not from one sample to the next, may be a gyro's: it is a step after [`SOFT_STANDS_S`], if no axis of the IMU is doubted by then. (What drifts
//! more slowly may be either, and only motion tells.)
//!
//! While the vehicle turns fast what is not known of its latency hides a step. So the last field before the turn is carried through it by the gyros, and compared with the first
//! one after: what iron on the vehicle makes of another heading is learned as well, turn by turn.

use nalgebra::{Matrix3, Vector3};

use crate::geo::so3;
use crate::time::AutopilotTime;

use crate::navigator::tuning::compass_step::{
    BEFORE_S, CALM, DRIFT_RADPS, LEAST_STEP, LEAST_TURN_STEP, LONGEST_GAP_S, SHARP, SIGMAS, SOFT_STANDS_S,
    SPREAD_S, STANDS_S, TURN_S, TURN_SIGMAS, TURNS_S, USUAL_S,
};

/// Past fields that are remembered.
const PAST: usize = 8;

/// A field, and what it is compared by.
pub(super) struct ComparedField<'a> {
    pub(super) time: AutopilotTime,
    /// Body, T.
    pub(super) field: Vector3<f64>,
    /// What its latency may make of the turn that the vehicle is in: the horizontal part of that, of the place's horizontal field, rad.
    pub(super) late: f64,
    pub(super) r_body_to_ned: Matrix3<f64>,
    /// A step would be a fault. On the ground, where motors start, it is only learned of.
    pub(super) judged: bool,
    /// An axis of the IMU may have jumped: only what comes between two samples is the compass' then.
    pub(super) gyros_doubted: bool,
    /// Strength of the place's horizontal field, T.
    pub(super) horizontal_t: f64,
    /// The rotation since an earlier time, body, rad.
    pub(super) turned: &'a dyn Fn(AutopilotTime) -> Option<Vector3<f64>>,
}

/// A field of before.
#[derive(Clone, Copy, Debug)]
struct PastField {
    time: AutopilotTime,
    /// As it would be measured now by the gyros, body, T.
    field: Vector3<f64>,
    /// [`ComparedField::late`].
    late: f64,
    /// The largest change from one sample to the next since, rad.
    sharpest: f64,
}

impl PastField {
    fn of(heard: &ComparedField<'_>) -> Self {
        Self { time: heard.time, field: heard.field, late: heard.late, sharpest: 0.0 }
    }

    /// What the heading has changed by since, rad.
    fn heading_change(&self, heard: &ComparedField<'_>) -> f64 {
        let [from, to] = [self.field, heard.field].map(|field| heard.r_body_to_ned * field);
        (from.x * to.y - from.y * to.x).atan2(from.xy().dot(&to.xy())).abs()
    }

    /// The change since, rad.
    fn change(&self, heard: &ComparedField<'_>) -> f64 {
        (heard.r_body_to_ned * (heard.field - self.field)).xy().norm() / heard.horizontal_t
    }
}

/// Variances of a heading's and of a field's changes: the plain ones at first, a low pass later.
#[derive(Clone, Copy, Debug, Default)]
struct UsualChange {
    variances: [f64; 2],
    seconds: f64,
}

impl UsualChange {
    fn learn(&mut self, dt: f64, from: &PastField, heard: &ComparedField<'_>) {
        self.seconds = (self.seconds + dt).min(SPREAD_S);
        let changes = [from.heading_change(heard), from.change(heard)];
        for (variance, change) in self.variances.iter_mut().zip(changes) {
            *variance += (change * change - *variance) * (dt / self.seconds.max(1e-3)).min(1.0);
        }
    }

    fn is_known(&self) -> bool {
        self.seconds > USUAL_S
    }

    /// Beyond which one is no accident, rad.
    fn limits(&self, least: f64, more: f64) -> [f64; 2] {
        self.variances.map(|variance| (SIGMAS * variance.sqrt()).max(least) + more)
    }
}

/// What may be a step.
#[derive(Clone, Copy, Debug)]
struct MayHaveStepped {
    since: AutopilotTime,
    from: PastField,
    /// Changes that are below this are none, rad.
    limit: f64,
    /// It came little by little: it may be a gyro's.
    soft: bool,
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StepWatch {
    last: Option<PastField>,
    /// Fields of late.
    past: [Option<PastField>; PAST],
    next: usize,
    /// The last while the vehicle did not turn fast.
    calm: Option<PastField>,
    /// Of its changes within [`BEFORE_S`], and over a turn.
    within: UsualChange,
    over_turns: UsualChange,
    stepped: Option<MayHaveStepped>,
}

impl StepWatch {
    /// A field. By how much it has stepped, rad, when it has.
    pub(super) fn observe(&mut self, heard: &ComparedField<'_>) -> Option<f64> {
        let dt = self.last.map_or(0.0, |last| heard.time.seconds_since(last.time));
        if !(0.0..LONGEST_GAP_S).contains(&dt) {
            self.last = Some(PastField::of(heard));
            self.forget();
            return None;
        }
        if let Some(last) = self.last {
            self.carry(&so3::exp(&-(heard.turned)(last.time)?));
        }
        self.sharpen(heard);
        let late = self.past.iter().flatten().map(|past| past.late).fold(heard.late, f64::max);
        let departure = self.steps(heard, dt, late);
        self.remember(heard);
        if departure.is_some() {
            self.forget();
        }
        departure
    }

    /// Whether it may have stepped at once: that is not to be believed before it has gone or is known.
    pub(super) fn is_doubted(&self) -> bool {
        self.stepped.is_some_and(|stepped| !stepped.soft)
    }

    /// The vehicle has turned: so do the fields of before.
    fn carry(&mut self, rotation: &Matrix3<f64>) {
        let stepped = self.stepped.iter_mut().map(|stepped| &mut stepped.from);
        let before = self.past.iter_mut().flatten().chain(&mut self.calm).chain(&mut self.last);
        for past in before.chain(stepped) {
            past.field = rotation * past.field;
        }
    }

    /// What has changed since the last sample.
    fn sharpen(&mut self, heard: &ComparedField<'_>) {
        let Some(last) = self.last.replace(PastField::of(heard)) else { return };
        let change = last.change(heard);
        for past in self.past.iter_mut().flatten().chain(&mut self.calm) {
            past.sharpest = past.sharpest.max(change);
        }
    }

    fn steps(&mut self, heard: &ComparedField<'_>, dt: f64, late: f64) -> Option<f64> {
        if let Some(stepped) = self.stepped {
            let by = stepped.from.change(heard);
            if by < 0.5 * stepped.limit {
                // It was a spike: what was remembered of it is no measure.
                (self.stepped, self.past, self.calm) = (None, [None; PAST], None);
                return None;
            }
            if stepped.soft && heard.gyros_doubted {
                self.stepped = None;
                return None;
            }
            let stands_s = if stepped.soft { SOFT_STANDS_S } else { STANDS_S };
            return Some(by).filter(|_| heard.time.seconds_since(stepped.since) > stands_s);
        }
        if let Some(before) = self.before(heard.time) {
            let limits = self.within.limits(LEAST_STEP, late);
            if self.is_borne_out(heard, 0.5 * limits[0]) {
                self.compare(heard, &before, limits);
            }
            if self.stepped.is_none() && late < CALM {
                self.within.learn(dt, &before, heard);
            }
        }
        if late < CALM && self.stepped.is_none() {
            self.after_turn(heard);
        }
        None
    }

    /// Against a field of before, within `[heading, field]` rad.
    fn compare(&mut self, heard: &ComparedField<'_>, from: &PastField, [heading, field]: [f64; 2]) {
        let change = from.change(heard);
        let sharp = from.sharpest > SHARP * change;
        let turned = from.heading_change(heard) > heading && (sharp || !heard.gyros_doubted);
        let bent = change > field && sharp;
        if self.within.is_known() && heard.judged && (turned || bent) {
            let limit = if turned { heading } else { field };
            self.stepped = Some(MayHaveStepped { since: heard.time, from: *from, limit, soft: !sharp });
        }
    }

    /// Whether it is not one past field alone, which may be an outlier, that shows a change.
    fn is_borne_out(&self, heard: &ComparedField<'_>, least: f64) -> bool {
        let age_s = |past: &PastField| heard.time.seconds_since(past.time);
        let mut old = self.past.iter().flatten().filter(|past| age_s(past) >= 0.5 * BEFORE_S);
        old.clone().count() > 1 && old.all(|past| past.change(heard) > least)
    }

    /// A field while the vehicle does not turn fast, against the last of before a turn.
    fn after_turn(&mut self, heard: &ComparedField<'_>) {
        let here = PastField::of(heard);
        let Some(before) = self.calm.replace(here) else { return };
        let took_s = heard.time.seconds_since(before.time);
        if (TURN_S..TURNS_S).contains(&took_s) {
            let [heading, field] = self.over_turns.limits(LEAST_TURN_STEP, DRIFT_RADPS * took_s);
            // The two fields have their noise whether it turned between them or not; a turn is compared once.
            let usual = self.within.variances.map(|variance| TURN_SIGMAS * variance.sqrt());
            self.compare(heard, &before, [heading.max(usual[0]), field.max(usual[1])]);
            if self.stepped.is_none() {
                self.over_turns.learn(took_s, &before, heard);
            }
        }
    }

    /// The field of [`BEFORE_S`] ago.
    fn before(&self, time: AutopilotTime) -> Option<PastField> {
        let old = self.past.iter().flatten().filter(|past| time.seconds_since(past.time) >= BEFORE_S);
        old.max_by_key(|past| past.time).copied()
    }

    fn remember(&mut self, heard: &ComparedField<'_>) {
        let newest = self.past[(self.next + PAST - 1) % PAST];
        let every_s = BEFORE_S / (PAST - 2) as f64;
        if newest.is_none_or(|past| heard.time.seconds_since(past.time) >= every_s) {
            self.past[self.next] = Some(PastField::of(heard));
            self.next = (self.next + 1) % PAST;
        }
    }

    /// What was measured is not comparable with what comes; what is usual is usual still.
    pub(super) fn forget(&mut self) {
        *self = Self { last: self.last, within: self.within, over_turns: self.over_turns, ..Self::default() };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten samples a second of a vehicle whose heading is `turned`, rad, of noise of 3 degrees, and what is added to it after a minute. When it is found, and
    /// by how much.
    fn fly_turning(turned: impl Fn(f64) -> f64, added: impl Fn(f64) -> f64) -> Option<(f64, f64)> {
        let mut watch = StepWatch::default();
        let time = |t: f64| AutopilotTime::from_micros((t * 1e6).round() as i64);
        (0..1200).find_map(|k| {
            let t = f64::from(k) * 0.1;
            let noise = 0.07 * (7.3 * t).sin() + 0.03 * (0.4 * t).cos();
            let delta = noise + if t > 60.0 { added(t - 60.0) } else { 0.0 };
            let heading = turned(t);
            let in_body = delta - heading;
            let heard = ComparedField {
                time: time(t),
                field: Vector3::new(in_body.cos(), in_body.sin(), 0.0),
                late: (turned(t + 0.05) - turned(t - 0.05)).abs() * 3.0,
                r_body_to_ned: so3::exp(&(Vector3::z() * heading)),
                judged: true,
                gyros_doubted: false,
                horizontal_t: 1.0,
                turned: &|since| {
                    let from = turned(since.seconds_since(time(0.0)));
                    Some(Vector3::z() * (heading - from))
                },
            };
            watch.observe(&heard).map(|d| (t, d))
        })
    }

    fn fly(added: impl Fn(f64) -> f64) -> Option<(f64, f64)> {
        fly_turning(|_| 0.0, added)
    }

    /// Turns of 90 degrees within a second, every ten.
    fn squares(t: f64) -> f64 {
        ((t / 10.0).floor() + (t % 10.0).min(1.0)) * std::f64::consts::FRAC_PI_2
    }

    #[test]
    fn a_step_is_found_and_a_drift_is_nobodys() {
        assert_eq!(fly(|_| 0.0), None);
        for step in [0.52, -1.57, 3.0] {
            let (t, by) = fly(|_| step).unwrap();
            let chord = 2.0 * (0.5 * step).sin().abs();
            assert!(t < 62.0 && (by - chord).abs() < 0.2, "{t} {by}");
        }
        assert_eq!(fly(|t| 0.052 * t), None);
    }

    #[test]
    fn a_step_that_a_fast_turn_hides_is_found_after_it_and_what_headings_differ_by_is_none() {
        assert_eq!(fly_turning(squares, |_| 0.0), None);
        for step in [0.52, -0.6, 1.57] {
            let found = fly_turning(squares, |t| if t > 10.4 { step } else { 0.0 });
            let chord = 2.0 * (0.5 * step).sin().abs();
            let fits = |(t, by): (f64, f64)| (70.0..73.0).contains(&t) && (by - chord).abs() < 0.25;
            assert!(found.is_some_and(fits), "{step}: {found:?}");
        }
        // Iron that shifts every other heading by 10 degrees.
        assert_eq!(fly_turning(squares, |t| if (t / 10.0) as i64 % 2 == 0 { 0.17 } else { 0.0 }), None);
    }

    #[test]
    fn a_spike_is_neither() {
        assert_eq!(fly(|t| if t < 0.3 { 1.0 } else { 0.0 }), None);
    }
}
