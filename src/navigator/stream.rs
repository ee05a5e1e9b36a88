//! The IMU's stream: which samples are new, sound and in time.

use crate::sample::ImuSample;
use crate::time::AutopilotTime;
use nalgebra::Vector3;

use super::reset::Reset;
use super::stream_axes::AxisWatch;
use super::verdict::Reason;
use crate::navigator::tuning::stream::{BEHIND_S, FULL_FORCE, FULL_RATE, POSSIBLE, STUCK_S};

/// What is remembered of the stream.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ImuStream {
    newest: Option<AutopilotTime>,
    last: Option<ImuSample>,
    /// Since when it has told the same.
    same_since: Option<AutopilotTime>,
    axes: AxisWatch,
    /// The vehicle stood on the ground when a sample was last navigated on: there a coarse IMU may repeat itself.
    grounded: bool,
    /// Samples older than the newest, one after the other: the first and the last of them.
    behind: Option<(AutopilotTime, AutopilotTime)>,
}

/// What a sample is to the stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Heard {
    /// The first.
    First,
    /// The next, so many seconds after the last.
    Next(f64),
    /// Of no use.
    Refused(Reason),
    /// The stream goes on in the past: the clock was set back.
    ClockSetBack,
}

impl ImuStream {
    /// The newest stamp.
    pub(super) fn newest(&self) -> Option<AutopilotTime> {
        self.newest
    }

    /// The newest sample that was navigated on.
    pub(super) fn last(&self) -> Option<&ImuSample> {
        self.last.as_ref()
    }

    /// The stream goes on after this sample.
    pub(super) fn recall(&mut self, last: ImuSample) {
        *self = Self { newest: Some(last.time), last: Some(last), ..Self::default() };
    }

    /// Whether the vehicle stands on the ground, or may.
    pub(super) fn stands(&mut self, on_ground: bool) {
        self.grounded = on_ground;
    }

    /// Takes note of a sample. `disarmed`: it stands on the ground, whatever it looks like.
    pub(super) fn hear(&mut self, s: &ImuSample, disarmed: bool, max_gap_s: f64) -> Heard {
        let possible = |v: &Vector3<f64>| v.iter().all(|c| c.abs() < POSSIBLE);
        if !possible(&s.angular_rate.raw()) || !possible(&s.specific_force.raw()) {
            return Heard::Refused(Reason::NotFinite);
        }
        let saturated = |v: &Vector3<f64>, full: f64| v.iter().any(|c| c.abs() >= full);
        if saturated(&s.angular_rate.raw(), FULL_RATE) || saturated(&s.specific_force.raw(), FULL_FORCE) {
            return Heard::Refused(Reason::OutOfRange);
        }
        let Some(newest) = self.newest else {
            self.newest = Some(s.time);
            return Heard::First;
        };
        let dt = s.time.seconds_since(newest);
        if dt <= 0.0 {
            return self.hear_old(s.time, max_gap_s);
        }
        self.behind = None;
        let grounded = disarmed || self.grounded;
        if self.is_stuck(s, grounded) {
            return Heard::Refused(Reason::Stuck);
        }
        if self.same_since.is_none() {
            self.axes.hear(s, !grounded);
        }
        self.newest = Some(s.time);
        Heard::Next(dt)
    }

    /// Whether one of its axes stands still while the others move: what it tells is no motion.
    pub(super) fn has_stuck_axis(&self) -> bool {
        self.axes.is_stuck()
    }

    /// The sample is not navigated on, and the stream goes on after it.
    pub(super) fn pass_over(&mut self, s: &ImuSample) {
        self.last = Some(*s);
    }

    /// A sample older than the newest. One may be late; a stream of them is a clock that was set back, and then everything that is
    /// remembered has times that will not come for long, or mean another moment.
    fn hear_old(&mut self, time: AutopilotTime, max_gap_s: f64) -> Heard {
        let goes_on = |last: AutopilotTime| time > last && time.seconds_since(last) <= max_gap_s;
        let since = self.behind.filter(|(_, last)| goes_on(*last)).map_or(time, |(since, _)| since);
        self.behind = Some((since, time));
        if time.seconds_since(since) >= BEHIND_S {
            self.behind = None;
            return Heard::ClockSetBack;
        }
        Heard::Refused(Reason::OutOfOrder)
    }

    /// Whether the IMU repeats itself for longer than one does that is in the air.
    fn is_stuck(&mut self, s: &ImuSample, grounded: bool) -> bool {
        let Some(last) = self.last.filter(|last| {
            last.angular_rate.raw() == s.angular_rate.raw()
                && last.specific_force.raw() == s.specific_force.raw()
        }) else {
            self.same_since = None;
            return false;
        };
        let since = *self.same_since.get_or_insert(last.time);
        !grounded && s.time.seconds_since(since) > STUCK_S
    }

    /// The sample is navigated on; what it says of the interval before it: with `instantaneous` samples the mean of the interval's two
    /// ends, which is nearer to the truth than either.
    pub(super) fn over_the_interval(&mut self, s: &ImuSample, instantaneous: bool) -> ImuSample {
        let last = self.last.replace(*s).filter(|_| instantaneous);
        last.map_or(*s, |last| ImuSample {
            time: s.time,
            angular_rate: (last.angular_rate + s.angular_rate) * 0.5,
            specific_force: (last.specific_force + s.specific_force) * 0.5,
        })
    }

    pub(super) fn reset(&mut self, reset: &Reset) {
        if reset.breaks_motion() {
            self.last = None;
        }
        if reset.reboots() {
            self.newest = None;
            self.axes = AxisWatch::default();
        }
        if reset.sets_clock_back() {
            self.same_since = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::Body;

    /// Gyros that stand still to their resolution beside accelerometers that do not, from 5 s on; whether an axis is stuck then.
    fn calm(on_ground: bool) -> bool {
        let mut stream = ImuStream::default();
        for k in 0..1000 {
            let noise = |n: i64| ((k * 7919 + n * 104_729) % 997) as f64 / 997.0 - 0.5;
            let v = |n| Vector3::new(noise(n), noise(n + 1), noise(n + 2));
            let s = ImuSample {
                time: AutopilotTime::from_micros(k * 10_000),
                angular_rate: Body::new(if k < 500 { v(1) } else { Vector3::zeros() }),
                specific_force: Body::new(v(4)),
            };
            stream.stands(on_ground && k >= 400);
            assert!(!matches!(stream.hear(&s, false, 0.5), Heard::Refused(_)));
        }
        stream.has_stuck_axis()
    }

    #[test]
    fn gyros_that_are_calm_to_their_resolution_are_stuck_in_the_air_alone() {
        assert!(!calm(true));
        assert!(calm(false));
    }
}
