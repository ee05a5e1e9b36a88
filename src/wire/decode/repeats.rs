//! The same reading is used once, however often it is sent and whatever its stamp.
//!
//! ArduPilot sends OPTICAL_FLOW at the stream's rate, 2.5 to 5 times for each reading of the sensor, each time with a new stamp. Used as
//! often, one reading's error counts as the mean of several.

use crate::time::{AutopilotTime, Span};

/// A reading that stays the same is passed on this often at least: a sensor that is stuck must be seen to be, and a flow of exactly
/// zero at rest is a measurement. Longer for sensors whose readings are further apart, but never beyond [`SLOWEST`].
const HOLD: Span = Span::from_millis(100);
const SLOWEST: Span = Span::from_millis(250);

/// What to do with a reading.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Novelty {
    /// It is new. The time since the reading before it, where that was sent more than once: what this one was integrated over.
    New(Option<Span>),
    /// It is the one before, and has been for so long that it is worth a word.
    Held,
    /// It is the one before.
    Repeated,
}

/// Tells readings of one sensor from repetitions. `R` is everything in the message but its stamp.
#[derive(Clone, Copy, Debug)]
pub(super) struct Repeats<R> {
    reading: R,
    /// When it first came.
    since: AutopilotTime,
    passed: AutopilotTime,
    repeated: bool,
    hold: Span,
}

impl<R: PartialEq> Repeats<R> {
    /// Judges the next message of the sensor, and remembers it.
    pub(super) fn judge(before: &mut Option<Self>, time: AutopilotTime, reading: R) -> Novelty {
        let Some(last) = before else {
            *before = Some(Self { reading, since: time, passed: time, repeated: false, hold: HOLD });
            return Novelty::New(None);
        };
        if last.reading != reading {
            let apart = time - last.since;
            let interval = (last.repeated && Span::ZERO < apart && apart <= SLOWEST).then_some(apart);
            let hold = Span::from_micros(apart.micros().saturating_mul(3) / 2).clamp(HOLD, SLOWEST);
            *last = Self { reading, since: time, passed: time, repeated: false, hold };
            return Novelty::New(interval);
        }
        last.repeated = true;
        if time - last.passed >= last.hold {
            last.passed = time;
            return Novelty::Held;
        }
        Novelty::Repeated
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: i64) -> AutopilotTime {
        AutopilotTime::from_micros(ms * 1000)
    }

    /// What is made of a message every `every` ms for a second, with a new reading every `reading` ms.
    fn second(every: usize, reading: i64) -> Vec<Novelty> {
        let mut state = None;
        (0..1000).step_by(every).map(|ms| Repeats::judge(&mut state, at(ms), ms / reading)).collect()
    }

    #[test]
    fn each_reading_is_used_once() {
        let judged = second(20, 50);
        let new: Vec<_> = judged.iter().filter(|j| matches!(j, Novelty::New(_))).collect();
        assert_eq!((new.len(), judged.len()), (20, 50));
        // Readings are 40 or 60 ms apart as they are sent.
        assert!(
            new[1..]
                .iter()
                .all(|n| matches!(n, Novelty::New(Some(s)) if (40..=60).contains(&(s.micros() / 1000))))
        );
        assert!(judged.iter().all(|j| *j != Novelty::Held));
    }

    #[test]
    fn a_slow_sensor_is_not_taken_for_a_stuck_one() {
        // Once it has told twice.
        assert!(second(20, 120).iter().skip(6).all(|j| *j != Novelty::Held));
    }

    #[test]
    fn a_sensor_that_is_not_repeated_is_left_as_it_is() {
        assert!(second(50, 50).iter().all(|j| *j == Novelty::New(None)));
    }

    #[test]
    fn what_stays_the_same_is_passed_on_ten_times_a_second() {
        let judged = second(20, 100_000);
        let held = judged.iter().filter(|j| **j == Novelty::Held).count();
        assert_eq!((held, judged[0]), (9, Novelty::New(None)));
    }
}
