//! How far the autopilot's own position is from what it was sent: whether it follows.

use nalgebra::Vector3;

use crate::geo::Ned;
use crate::time::AutopilotTime;

/// Positions kept, a second of them at the fastest rate.
const KEPT: usize = 50;
/// A position of the autopilot's is compared with one that was sent at most this long before or after it, s.
const NEAR_S: f64 = 0.3;

/// The positions that were sent last, in the autopilot's frame.
#[derive(Clone, Debug)]
pub(super) struct FollowingWatch {
    sent: [Option<(AutopilotTime, Ned<Vector3<f64>>)>; KEPT],
    next: usize,
    apart: Option<Departure>,
}

/// How far the autopilot is from what it was sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Departure {
    /// When.
    pub time: AutopilotTime,
    /// Horizontally, m.
    pub horizontal_m: f64,
    /// What a filter may be behind by that follows as it should, m: it is noisy, and late by a part of a second.
    pub allowed_m: f64,
}

/// What an autopilot's filter scatters by that follows, m.
const SCATTER_M: f64 = 2.0;
/// What it may lag behind by, s: transport, its fusion horizon, and the smoothing of its output.
const LAG_S: f64 = 0.5;

impl FollowingWatch {
    pub(super) fn new() -> Self {
        Self { sent: [None; KEPT], next: 0, apart: None }
    }

    pub(super) fn sent(&mut self, time: AutopilotTime, position: Ned<Vector3<f64>>) {
        if let Some(slot) = self.sent.get_mut(self.next) {
            *slot = Some((time, position));
        }
        self.next = (self.next + 1) % KEPT;
    }

    /// The autopilot says where it is, and how fast.
    pub(super) fn compare(
        &mut self,
        time: AutopilotTime,
        position: Ned<Vector3<f64>>,
        velocity: Ned<Vector3<f64>>,
    ) {
        let apart_s = |t: &AutopilotTime| t.seconds_since(time).abs();
        let nearest = self.sent.iter().flatten().min_by(|a, b| apart_s(&a.0).total_cmp(&apart_s(&b.0)));
        self.apart = nearest.filter(|(t, _)| apart_s(t) <= NEAR_S).map(|(t, sent)| {
            let then = position + velocity * t.seconds_since(time);
            Departure {
                time,
                horizontal_m: (then - *sent).raw().xy().norm(),
                allowed_m: SCATTER_M + LAG_S * velocity.raw().xy().norm(),
            }
        });
    }

    /// As it was when the autopilot last told its position; `None` while nothing is sent, or heard.
    pub(super) fn departure(&self) -> Option<Departure> {
        self.apart
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: i64) -> AutopilotTime {
        AutopilotTime::from_micros(ms * 1000)
    }

    fn north(m: f64) -> Ned<Vector3<f64>> {
        Ned::new(Vector3::new(m, 0.0, 0.0))
    }

    #[test]
    fn positions_of_the_same_time_are_compared() {
        let mut following = FollowingWatch::new();
        for ms in (0..10_000).step_by(20) {
            following.sent(at(ms), north(10.0 * ms as f64 * 1e-3));
        }
        // 10 m/s: at 9.987 s it is at 99.87 m.
        following.compare(at(9987), north(99.87), north(10.0));
        let apart = following.departure().unwrap();
        assert!(apart.horizontal_m < 1e-6 && (apart.allowed_m - 7.0).abs() < 1e-9, "{apart:?}");
        following.compare(at(9987), north(57.0), north(10.0));
        assert!((following.departure().unwrap().horizontal_m - 42.87).abs() < 1e-6);
    }

    #[test]
    fn what_was_sent_long_ago_is_not_compared_with() {
        let mut following = FollowingWatch::new();
        following.compare(at(0), north(0.0), north(0.0));
        assert_eq!(following.departure(), None);
        following.sent(at(0), north(0.0));
        following.compare(at(301), north(5.0), north(0.0));
        assert_eq!(following.departure(), None);
    }
}
