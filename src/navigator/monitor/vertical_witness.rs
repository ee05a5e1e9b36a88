//! The height that a barometer was seen to gain, against what the vehicle's inertia tells: the witness of the IMU that is there without GNSS.
//!
//! h(t + T) − 2 h(t) + h(t − T) = T² times the acceleration over 2 T, with triangular weight, both of a barometer and of the double integral
//! of what inertia tells. A tilt that is off by θ leaves g (1 − cos θ) of gravity.
//!
//! What they are apart by as a rule is learned as for the horizontal ([`super::inertia_witness`]), and most of the last windows have to contradict, all upwards or
//! all downwards: a barometer that did so would have to run away. Noise of the barometer counts with 1/T², so that there are two paces: windows of a second
//! find a sound barometer's contradiction soon, and those of three see it with one that is disturbed.

use crate::navigator::tuning::heading_witness::{LONGEST_S, SHORTEST_S};
use crate::navigator::tuning::inertia_witness::{
    MEMORY_S, MOST_OF, SLOW_LONGEST_S, SLOW_MEMORY_S, SLOW_S, SLOW_WINDOWS, WINDOWS, WRONG_FOR_S,
};
use crate::time::AutopilotTime;

use super::inertia_witness::{Testimony, UsualMisfit, weigh};

/// How long windows are.
#[derive(Clone, Copy, Debug)]
struct WindowPace {
    /// T, at least and at most, s.
    shortest_s: f64,
    longest_s: f64,
    /// They are forgotten after this, s.
    memory_s: f64,
    /// How many, and how many of them have to contradict.
    windows: (usize, usize),
}

const QUICK: WindowPace = WindowPace {
    shortest_s: SHORTEST_S,
    longest_s: LONGEST_S,
    memory_s: MEMORY_S,
    windows: (WINDOWS, MOST_OF),
};
const SLOW: WindowPace = WindowPace {
    shortest_s: SLOW_S,
    longest_s: SLOW_LONGEST_S,
    memory_s: SLOW_MEMORY_S,
    windows: (SLOW_WINDOWS, SLOW_WINDOWS),
};

/// Inertia that is contradicted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct VerticalFinding {
    /// By how much, at least, m/s².
    pub(in super::super) apart: f64,
    /// For how long it may have been so, s.
    pub(in super::super) for_s: f64,
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct VerticalWitness {
    quick: VerticalWindows,
    slow: VerticalWindows,
}

impl Default for VerticalWitness {
    fn default() -> Self {
        Self { quick: VerticalWindows::new(QUICK), slow: VerticalWindows::new(SLOW) }
    }
}

impl VerticalWitness {
    /// Inertia, m/s² upwards, over `dt` s.
    pub(in super::super) fn feel(&mut self, dt: f64, accel_up: f64) {
        self.quick.feel(dt, accel_up);
        self.slow.feel(dt, accel_up);
    }

    /// A height, m.
    pub(in super::super) fn observe(&mut self, time: AutopilotTime, height_m: f64) {
        self.quick.observe(time, height_m);
        self.slow.observe(time, height_m);
    }

    /// What contradicts inertia at `now`.
    pub(in super::super) fn finding(&self, now: AutopilotTime) -> Option<VerticalFinding> {
        let found = |windows: &VerticalWindows, for_s: f64| {
            let contradicts = windows.testimony(now) == Testimony::Contradicts;
            contradicts.then(|| VerticalFinding { apart: windows.least_apart(), for_s })
        };
        found(&self.quick, WRONG_FOR_S).or_else(|| found(&self.slow, SLOW_MEMORY_S))
    }

    /// Inertia was not integrated for a while; what is usual is usual still.
    pub(in super::super) fn forget(&mut self) {
        self.quick.forget();
        self.slow.forget();
    }
}

/// Heights seen by one barometer, and the double integral of what inertia tells.
#[derive(Clone, Copy, Debug)]
struct VerticalWindows {
    pace: WindowPace,
    climb_mps: f64,
    rise_m: f64,
    /// Time, height seen, rise felt: the two before the one that comes.
    past: [Option<(AutopilotTime, f64, f64)>; 2],
    /// How much more was seen than felt, m/s², and when.
    apart: [Option<(AutopilotTime, f64)>; WINDOWS],
    next: usize,
    usual: UsualMisfit,
}

impl VerticalWindows {
    fn new(pace: WindowPace) -> Self {
        Self {
            pace,
            climb_mps: 0.0,
            rise_m: 0.0,
            past: [None; 2],
            apart: [None; WINDOWS],
            next: 0,
            usual: UsualMisfit::default(),
        }
    }

    /// Inertia, m/s² upwards, over `dt` s.
    fn feel(&mut self, dt: f64, accel_up: f64) {
        self.rise_m += (self.climb_mps + 0.5 * accel_up * dt) * dt;
        self.climb_mps += accel_up * dt;
    }

    /// A height, m.
    fn observe(&mut self, time: AutopilotTime, height_m: f64) {
        let [before, last] = self.past;
        let Some((t1, h1, r1)) = last else {
            self.past = [None, Some((time, height_m, self.rise_m))];
            return;
        };
        let step = time.seconds_since(t1);
        if (0.0..self.pace.shortest_s).contains(&step) {
            return;
        }
        if let Some((t0, h0, r0)) = before.filter(|_| step < self.pace.longest_s) {
            let earlier = t1.seconds_since(t0);
            let bend = |a: f64, b: f64, c: f64| 2.0 * ((c - b) / step - (b - a) / earlier) / (step + earlier);
            let seen = bend(h0, h1, height_m);
            if seen == 0.0 {
                // It stands still to the last digit, and sees nothing.
                return self.forget();
            }
            let apart = seen - bend(r0, r1, self.rise_m);
            self.usual.learn(apart.abs());
            self.apart[self.next] = Some((time, apart));
            self.next = (self.next + 1) % self.pace.windows.0;
        }
        // Only differences matter: what is integrated does not grow without bounds.
        let (rise, climb) = (self.rise_m, self.climb_mps);
        (self.rise_m, self.climb_mps) = (0.0, 0.0);
        let moved = |(t, h, r): (AutopilotTime, f64, f64)| (t, h, r - rise - climb * t.seconds_since(time));
        self.past = [last.map(moved), Some((time, height_m, 0.0))];
    }

    /// What it says at `now`.
    fn testimony(&self, now: AutopilotTime) -> Testimony {
        let memory_s = self.pace.memory_s;
        let fresh =
            || self.apart.iter().flatten().filter(|(t, _)| (0.0..memory_s).contains(&now.seconds_since(*t)));
        let limit = self.usual.limit();
        let up = fresh().filter(|(_, a)| *a > limit).count();
        let down = fresh().filter(|(_, a)| *a < -limit).count();
        weigh(fresh().count(), up.max(down), self.pace.windows)
    }

    /// The least that its windows are apart by where it contradicts, m/s².
    fn least_apart(&self) -> f64 {
        let limit = self.usual.limit();
        let apart = self.apart.iter().flatten().map(|(_, a)| a.abs()).filter(|a| *a > limit);
        apart.fold(f64::INFINITY, f64::min)
    }

    /// Inertia was not integrated for a while; what is usual is usual still.
    fn forget(&mut self) {
        *self = Self { usual: self.usual, ..Self::new(self.pace) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(s: f64) -> AutopilotTime {
        AutopilotTime::from_micros((s * 1e6).round() as i64)
    }

    /// When inertia is contradicted, s.
    fn vertical(felt: impl Fn(f64) -> f64, seen: impl Fn(f64) -> f64) -> Option<f64> {
        let mut w = VerticalWitness::default();
        for k in 0..12000 {
            let t = f64::from(k) * 0.01;
            w.feel(0.01, felt(t));
            if k % 10 == 9 {
                w.observe(at(t + 0.01), seen(t + 0.01));
                if w.finding(at(t + 0.01)).is_some() {
                    return Some(t);
                }
            }
        }
        None
    }

    #[test]
    fn gravity_that_is_not_felt_contradicts_and_a_gust_does_not() {
        let height = |t: f64| 5.0 * (0.5 * t).sin();
        let accel = |t: f64| -1.25 * (0.5 * t).sin();
        assert_eq!(vertical(accel, height), None);
        let falls = |t: f64| accel(t) - if t > 80.0 { 9.8 } else { 0.0 };
        assert!(vertical(falls, height).is_some_and(|t| (80.0..87.0).contains(&t)));
        let gust = |t: f64| height(t) + if (81.0..83.0).contains(&t) { 3.0 } else { 0.0 };
        assert_eq!(vertical(accel, gust), None);
    }

    #[test]
    fn a_barometer_that_is_disturbed_sees_it_later() {
        let height = |t: f64| 2.0 * f64::from(((t * 10.0) as u32 * 7919) % 31) / 31.0;
        assert_eq!(vertical(|_| 0.0, height), None);
        let inverted = |t: f64| if t > 80.0 { -9.8 } else { 0.0 };
        let found = vertical(inverted, height);
        assert!(found.is_some_and(|t| (80.0..95.0).contains(&t)), "{found:?}");
    }
}
