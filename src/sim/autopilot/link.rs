//! What a bad link does to messages: it loses some, delays all, and is silent for a while.

use std::collections::VecDeque;

use crate::sim::noise::{SensorRng, Stream};

/// The faults of a link, the same in both directions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkFaults {
    /// Part of the messages that is lost, 0 to 1.
    pub loss: f64,
    /// How late each comes, s.
    pub delay_s: f64,
    /// From when to when nothing comes, s of the simulation.
    pub silent_s: Option<(f64, f64)>,
}

/// One direction of a link with faults.
#[derive(Clone, Debug)]
pub struct FaultyLink<T> {
    faults: LinkFaults,
    waiting: VecDeque<(f64, T)>,
    rng: SensorRng,
}

impl<T> FaultyLink<T> {
    /// A link; `number` tells the directions of one flight apart.
    pub fn new(faults: LinkFaults, seed: u64, number: u32) -> Self {
        Self { faults, waiting: VecDeque::new(), rng: SensorRng::of_run(seed, Stream::Link, number) }
    }

    /// Gives a message to the link.
    pub fn give(&mut self, now_s: f64, message: T) {
        let silent = self.faults.silent_s.is_some_and(|(from, to)| (from..to).contains(&now_s));
        if !silent && !self.rng.chance(self.faults.loss) {
            self.waiting.push_back((now_s + self.faults.delay_s, message));
        }
    }

    /// The next message that has come by now.
    pub fn take(&mut self, now_s: f64) -> Option<T> {
        let due = self.waiting.front().is_some_and(|(t, _)| *t <= now_s);
        if due { self.waiting.pop_front().map(|(_, message)| message) } else { None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_lost_late_and_silent_as_told() {
        let faults = LinkFaults { loss: 0.3, delay_s: 0.1, silent_s: Some((50.0, 60.0)) };
        let mut link = FaultyLink::new(faults, 1, 0);
        let mut came = Vec::new();
        for k in 0..10_000u32 {
            let now_s = 0.01 * f64::from(k);
            link.give(now_s, now_s);
            while let Some(sent) = link.take(now_s) {
                assert!((now_s - sent - 0.1).abs() < 0.011, "{sent} at {now_s}");
                came.push(sent);
            }
        }
        assert!((0.62..0.64).contains(&(came.len() as f64 / 1e4)), "70 % of 90 s: {}", came.len());
        assert!(!came.iter().any(|t| (50.0..59.99).contains(t)));
    }
}
