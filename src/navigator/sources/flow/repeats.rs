//! Whether a flow sensor repeats itself where its noise alone would not let it.
//!
//! A number other than zero that is told for [`STUCK_S`] is stuck: no noise does that. Zero is what sensors tell that see nothing move,
//! so zero needs more: that the camera turns by more than the sensor's noise, where the flow has the rotation in it; or that this
//! sensor does not do that. Of the N samples that it told in the air R repeated the one before, and a run of n repeats is
//! no accident when
//!
//! −½ n ln p > D ln 10, with p = (R + a)/(N + 2a):
//!
//! p of repeats one by one, a of a prior that expects every second to be one, and the half because repeats of a hovering vehicle come
//! in company. A sensor that counts whole pixels has a p near 1 and is given seconds; one that was never seen to repeat itself a few samples. But one without
//! noise tells zero of a vehicle that hovers in still air, as simulated ones do: that has shown where its numbers scatter more than they change, Σ|Δ²x|² > Σ|Δx|²
//! (3 : 1 of white noise, next to nothing of a motion).

use nalgebra::Vector2;

use crate::sample::FlowSample;
use crate::time::AutopilotTime;

use crate::navigator::tuning::flow::{
    LONGEST_INTERVAL_S, REPEATS_DECADES, REPEATS_MEMORY, REPEATS_PRIOR, STUCK_S, ZERO_MEMORY_S,
};

/// What is known of the moment in which a flow was told.
#[derive(Clone, Copy, Debug)]
pub(super) struct RepeatScene {
    /// What the camera turned by, x and y, rad/s, where the flow has the rotation in it.
    pub(super) rate_xy: Option<Vector2<f64>>,
    /// Noise of the sensor, rad/s.
    pub(super) noise_radps: f64,
    /// The vehicle is off the ground, beyond doubt.
    pub(super) in_air: bool,
}

/// The same flow, told again and again.
#[derive(Clone, Copy, Debug)]
struct SameFlow {
    since: AutopilotTime,
    last: AutopilotTime,
    rate_xy: [f64; 2],
    /// Repeats so far that were told in the air.
    run: f64,
    /// What the camera has turned by meanwhile, x and y, rad, forgotten in [`ZERO_MEMORY_S`].
    turned: Vector2<f64>,
    stuck: bool,
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RepeatWatch {
    same: Option<SameFlow>,
    /// N and R.
    told: f64,
    repeated: f64,
    /// The last number and how it had changed, and Σ|Δx|² and Σ|Δ²x|² in the air, (rad/s)².
    changed: Option<(Vector2<f64>, Vector2<f64>)>,
    squares: [f64; 2],
}

impl RepeatWatch {
    /// Since when the sensor has told the same numbers, if that is longer than it does by itself.
    pub(super) fn note(&mut self, s: &FlowSample, scene: &RepeatScene) -> Option<AutopilotTime> {
        let p = (self.repeated + REPEATS_PRIOR) / (self.told + 2.0 * REPEATS_PRIOR);
        let noisy = self.squares[1] > self.squares[0];
        // What was told before a hole says nothing of how long it was told.
        let goes_on = |same: &&mut SameFlow| {
            same.rate_xy == s.rate_xy && s.time.seconds_since(same.last) < LONGEST_INTERVAL_S
        };
        let Some(same) = self.same.as_mut().filter(goes_on) else {
            self.end_run(scene.in_air);
            self.scatters(&Vector2::from(s.rate_xy), scene.in_air);
            let (time, rate_xy) = (s.time, s.rate_xy);
            let (run, turned) = (0.0, Vector2::zeros());
            self.same = Some(SameFlow { since: time, last: time, rate_xy, run, turned, stuck: false });
            return None;
        };
        let dt = s.time.seconds_since(same.last).max(0.0);
        same.last = s.time;
        same.turned = same.turned * (-dt / ZERO_MEMORY_S).exp() + scene.rate_xy.unwrap_or_default() * dt;
        same.run += if scene.in_air { 1.0 } else { 0.0 };
        let turns = same.turned.norm() > scene.noise_radps * ZERO_MEMORY_S;
        let unlikely = -0.5 * same.run * p.log10() > REPEATS_DECADES;
        let stands = same.rate_xy == [0.0; 2] && !turns && !(noisy && unlikely && scene.in_air);
        same.stuck |= !stands && s.time.seconds_since(same.since) > STUCK_S;
        same.stuck.then_some(same.since)
    }

    /// Stamps begin anew; how often it repeats itself stays known.
    pub(super) fn interrupt(&mut self) {
        self.same = None;
    }

    /// A sample that is no repeat: what was one counts, where that was no fault.
    fn end_run(&mut self, in_air: bool) {
        let run = self.same.filter(|same| !same.stuck).map_or(0.0, |same| same.run);
        self.repeated += run;
        self.told += run + if in_air { 1.0 } else { 0.0 };
        if self.told > REPEATS_MEMORY {
            let kept = REPEATS_MEMORY / self.told;
            (self.told, self.repeated) = (self.told * kept, self.repeated * kept);
            self.squares = self.squares.map(|square| square * kept);
        }
    }

    /// A number that is no repeat.
    fn scatters(&mut self, rate_xy: &Vector2<f64>, in_air: bool) {
        let Some((before, was)) = self.changed.filter(|_| in_air) else {
            self.changed = Some((*rate_xy, Vector2::zeros()));
            return;
        };
        let change = rate_xy - before;
        self.squares[0] += change.norm_squared();
        self.squares[1] += (change - was).norm_squared();
        self.changed = Some((*rate_xy, change));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::FlowRotation;
    use crate::time::Span;

    const IN_AIR: RepeatScene = RepeatScene { rate_xy: None, noise_radps: 0.03, in_air: true };

    fn sample(micros: i64, rate: f64) -> FlowSample {
        FlowSample {
            time: AutopilotTime::from_micros(micros),
            sensor: 0,
            interval: Span::from_micros(50_000),
            rate_xy: [rate, 0.0],
            rotation: FlowRotation::Removed,
            quality: 1.0,
            distance_m: None,
        }
    }

    /// Samples at 20 Hz; after how many of them the sensor was called stuck.
    fn tell(
        watch: &mut RepeatWatch,
        from: u32,
        rates: impl Iterator<Item = f64>,
        scene: &RepeatScene,
    ) -> Option<u32> {
        let mut stuck = None;
        for (k, rate) in (0u32..).zip(rates) {
            let s = sample(i64::from(from + k) * 50_000, rate);
            if watch.note(&s, scene).is_some() {
                stuck = stuck.or(Some(k));
            }
        }
        stuck
    }

    /// Numbers with noise, none of them told twice.
    fn noisy(n: u32) -> impl Iterator<Item = f64> {
        (0..n).map(|k| 0.01 + 1e-4 * f64::from(k * 7919 % 1013))
    }

    /// A sensor that counts: so many zeros, then a one.
    fn counts(zeros: u32, n: u32) -> impl Iterator<Item = f64> {
        (0..n).map(move |k| f64::from(u8::from(k % (zeros + 1) == zeros)))
    }

    #[test]
    fn a_zero_of_a_sensor_that_has_noise_is_stuck_within_half_a_second_though_nothing_turns() {
        let mut watch = RepeatWatch::default();
        assert_eq!(tell(&mut watch, 0, noisy(600), &IN_AIR), None);
        let stuck = tell(&mut watch, 600, std::iter::repeat_n(0.0, 100), &IN_AIR);
        assert!(stuck.is_some_and(|k| k <= 10), "{stuck:?}");
        // The way back is the first other number.
        assert_eq!(tell(&mut watch, 700, noisy(100), &IN_AIR), None);
    }

    #[test]
    fn a_sensor_that_counts_whole_pixels_is_given_what_it_takes() {
        let mut watch = RepeatWatch::default();
        assert_eq!(tell(&mut watch, 0, counts(9, 2000), &IN_AIR), None);
        // Three times as long as it did so far.
        assert_eq!(tell(&mut watch, 2000, counts(30, 310), &IN_AIR), None);
        let stuck = tell(&mut watch, 2310, std::iter::repeat_n(0.0, 2000), &IN_AIR);
        assert!(stuck.is_some_and(|k| k > 30), "{stuck:?}");
    }

    #[test]
    fn nothing_is_held_against_a_zero_on_the_ground_and_nothing_learned_of_it() {
        let mut watch = RepeatWatch::default();
        assert_eq!(tell(&mut watch, 0, noisy(600), &IN_AIR), None);
        let ground = RepeatScene { in_air: false, ..IN_AIR };
        assert_eq!(tell(&mut watch, 600, std::iter::repeat_n(0.0, 6000), &ground), None);
        let stuck = tell(&mut watch, 6600, noisy(20).chain(std::iter::repeat_n(0.0, 100)), &IN_AIR);
        assert!(stuck.is_some_and(|k| k < 40), "{stuck:?}");
    }

    #[test]
    fn a_simulated_sensor_without_noise_tells_zero_of_a_hover() {
        let mut watch = RepeatWatch::default();
        let moves = (0..600).map(|k| (0.02 * f64::from(k)).sin());
        assert_eq!(tell(&mut watch, 0, moves, &IN_AIR), None);
        assert_eq!(tell(&mut watch, 600, std::iter::repeat_n(0.0, 2000), &IN_AIR), None);
    }

    #[test]
    fn two_equal_numbers_beside_a_hole_are_not_stuck() {
        let mut watch = RepeatWatch::default();
        assert_eq!(watch.note(&sample(0, 0.4), &IN_AIR), None);
        assert_eq!(watch.note(&sample(2_000_000, 0.4), &IN_AIR), None);
        assert_eq!(watch.note(&sample(2_100_000, 0.4), &IN_AIR), None);
    }

    #[test]
    fn a_number_that_is_not_zero_is_stuck_wherever_it_is_told() {
        let mut watch = RepeatWatch::default();
        let ground = RepeatScene { in_air: false, ..IN_AIR };
        let stuck = tell(&mut watch, 0, std::iter::repeat_n(0.4, 100), &ground);
        assert!(stuck.is_some_and(|k| k <= 8), "{stuck:?}");
    }
}
