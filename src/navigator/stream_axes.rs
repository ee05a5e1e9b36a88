//! One axis of the IMU that stands still while the others move.
//!
//! A sensor in the air changes from sample to sample: with its noise, or with the motion that its resolution shows. How often, is learned of each axis
//! in flight, as the mean length L of a run of equal values. Were the axis sound, a run of n samples would come with probability (1 − 1/L)^n; when
//! that is below the false alarms that a flight may have, it is stuck. A calm vehicle's coarse axis changes less than the mean, and its changes are not
//! independent: a run is no news, either, while it is not several times as long as the longest one of a sound axis. An axis that has never moved is measured by the laziest
//! of its neighbours (the other axes of the same gyro or accelerometer). One that moves again for long enough is sound.

use nalgebra::Vector6;

use crate::sample::ImuSample;
use crate::time::AutopilotTime;

use crate::navigator::tuning::stream::{
    AXIS_ALARM_LOG, AXIS_LEAST_RUN, AXIS_MOVES, AXIS_RUN_GAIN, AXIS_RUNS, AXIS_SHORTEST_RUN,
    AXIS_TIMES_LONGEST, STUCK_S,
};

/// What is remembered of an axis.
#[derive(Clone, Copy, Debug, Default)]
struct Axis {
    value: f64,
    /// Samples of the run that goes on, and when it began.
    run: u32,
    since: Option<AutopilotTime>,
    /// Mean length of a run, and of how many.
    mean_run: f64,
    runs: u32,
    /// The longest.
    longest: u32,
    stuck: bool,
    /// Runs that ended since it was found stuck.
    moves: u32,
}

impl Axis {
    fn hear(&mut self, now: AutopilotTime, value: f64, flies: bool) {
        if value == self.value && self.since.is_some() {
            self.run = self.run.saturating_add(1);
            if self.run >= AXIS_LEAST_RUN {
                self.moves = 0;
            }
            if !flies {
                // A run counts from where it should have ended.
                (self.run, self.since) = (1, Some(now));
            }
            return;
        }
        if self.since.is_some() && !self.stuck && flies {
            self.longest = self.longest.max(self.run);
            // The plain mean at first, a low pass later.
            self.runs = self.runs.saturating_add(1);
            let gain = (1.0 / f64::from(self.runs)).max(AXIS_RUN_GAIN);
            self.mean_run += gain * (f64::from(self.run) - self.mean_run);
        }
        self.moves += 1;
        if self.moves >= AXIS_MOVES {
            self.stuck = false;
        }
        (self.value, self.run, self.since) = (value, 1, Some(now));
    }

    /// Its mean run and its longest, once they are known.
    fn known_runs(&self) -> Option<(f64, u32)> {
        (self.runs >= AXIS_RUNS).then_some((self.mean_run, self.longest))
    }

    /// Whether the run that goes on is longer than any of a sound axis whose runs are like that.
    fn stands(&self, now: AutopilotTime, (mean_run, longest): (f64, u32)) -> bool {
        if self.run < AXIS_LEAST_RUN.max(AXIS_TIMES_LONGEST * longest) {
            return false;
        }
        let long = self.since.is_some_and(|t| now.seconds_since(t) > STUCK_S);
        let stays = 1.0 - 1.0 / mean_run.max(AXIS_SHORTEST_RUN);
        long && f64::from(self.run) * stays.ln() < AXIS_ALARM_LOG
    }
}

/// The six axes: gyros, accelerometers.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct AxisWatch([Axis; 6]);

impl AxisWatch {
    /// Takes a sample that is not the last one over again. Whether an axis is stuck; `flies`: on the ground nothing need move.
    pub(super) fn hear(&mut self, s: &ImuSample, flies: bool) -> bool {
        let (w, f) = (s.angular_rate.raw(), s.specific_force.raw());
        let values = Vector6::new(w.x, w.y, w.z, f.x, f.y, f.z);
        for (axis, value) in self.0.iter_mut().zip(values.iter()) {
            axis.hear(s.time, *value, flies);
        }
        for i in 0..6 {
            let triad = i / 3 * 3;
            let neighbours = (triad..triad + 3).filter(|j| *j != i);
            let laziest = neighbours
                .map(|j| self.0[j].known_runs())
                .try_fold((0.0_f64, 0), |a, b| b.map(|b| (a.0.max(b.0), a.1.max(b.1))));
            let runs = self.0[i].known_runs().or(laziest);
            if flies && runs.is_some_and(|runs| self.0[i].stands(s.time, runs)) {
                self.0[i].stuck = true;
            }
        }
        self.is_stuck()
    }

    /// Whether an axis is.
    pub(super) fn is_stuck(&self) -> bool {
        self.0.iter().any(|a| a.stuck)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::Body;
    use nalgebra::Vector3;

    /// Noise on a grid of `lsb`, repeated over and over.
    fn sample(k: i64, lsb: f64) -> ImuSample {
        let noise = |n: i64| ((k * 7919 + n * 104_729) % 997) as f64 / 997.0 - 0.5;
        let v = |n| Vector3::new(noise(n), noise(n + 1), noise(n + 2)).map(|x| (x / lsb).round() * lsb);
        ImuSample {
            time: AutopilotTime::from_micros(k * 10_000),
            angular_rate: Body::new(v(1)),
            specific_force: Body::new(v(4)),
        }
    }

    fn stuck(s: &ImuSample, axis: usize, value: f64) -> ImuSample {
        let mut rate = s.angular_rate.raw();
        rate[axis] = value;
        ImuSample { angular_rate: Body::new(rate), ..*s }
    }

    #[test]
    fn an_axis_that_stands_still_is_found_in_tenths_of_a_second_and_believed_when_it_moves() {
        let mut watch = AxisWatch::default();
        assert!((0..500).all(|k| !watch.hear(&sample(k, 1e-3), true)));
        let found = (500..600).position(|k| watch.hear(&stuck(&sample(k, 1e-3), 1, 0.2), true)).unwrap();
        assert!(found < 60, "{found}");
        assert!((600..620).any(|k| !watch.hear(&sample(k, 1e-3), true)));
    }

    #[test]
    fn one_that_never_moved_is_measured_by_its_neighbours() {
        let mut watch = AxisWatch::default();
        let found = (0..300).position(|k| watch.hear(&stuck(&sample(k, 1e-3), 2, 0.0), true)).unwrap();
        assert!(found < 100, "{found}");
        let mut grounded = AxisWatch::default();
        assert!((0..300).all(|k| !grounded.hear(&stuck(&sample(k, 1e-3), 2, 0.0), false)));
    }

    #[test]
    fn a_coarse_axis_repeats_itself_and_is_not_stuck() {
        // One step of the grid is as large as the noise: half of the samples are the last one over again.
        let mut watch = AxisWatch::default();
        assert!((0..20_000).all(|k| !watch.hear(&sample(k, 0.8), true)));
    }
}
