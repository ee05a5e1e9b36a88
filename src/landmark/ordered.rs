//! Events that arrive in any order take effect in the order of their times.
//!
//! Behind every event of a bounded past stands the state after it. One that comes late is put in its place, and what came after it is done
//! again: the result is that of an arrival in order, gates, weights and linearisation included, to the last bit.

use std::collections::VecDeque;

use crate::time::AutopilotTime;

/// A state that events change.
pub trait Replayed: Clone {
    /// What happens.
    type Event: Copy + std::fmt::Debug;
    /// What was made of it.
    type Verdict: Copy;
    /// What does not change.
    type Context;

    /// Goes on to `time` and takes the event.
    fn apply(&mut self, context: &Self::Context, time: AutopilotTime, event: &Self::Event) -> Self::Verdict;
}

/// Where an event stands: its time, and a rank among those of the same time.
pub type Place = (AutopilotTime, u64);

#[derive(Clone, Debug)]
struct OrderedEvent<S: Replayed> {
    place: Place,
    event: S::Event,
    after: S,
}

/// Events in order, and the state behind each.
#[derive(Clone, Debug)]
pub struct Ordered<S: Replayed> {
    base: S,
    base_place: Option<Place>,
    entries: VecDeque<OrderedEvent<S>>,
    capacity: usize,
}

/// Why an event was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NotTaken {
    /// It belongs before what is still open.
    Closed,
    /// Something stands at its place.
    Taken,
}

impl<S: Replayed> Ordered<S> {
    /// Begins with a state. Allocates for `capacity` events, and never again.
    pub fn new(base: S, capacity: usize) -> Self {
        let capacity = capacity.max(1);
        Self { base, base_place: None, entries: VecDeque::with_capacity(capacity + 1), capacity }
    }

    /// The state after everything so far.
    pub fn latest(&self) -> &S {
        self.entries.back().map_or(&self.base, |e| &e.after)
    }

    /// Events before `time` are final.
    pub fn close(&mut self, time: AutopilotTime) {
        while self.entries.front().is_some_and(|e| e.place.0 < time) {
            self.settle();
        }
    }

    /// Takes an event at its place.
    ///
    /// # Errors
    /// [`NotTaken`].
    pub fn insert(
        &mut self,
        context: &S::Context,
        place: Place,
        event: S::Event,
    ) -> Result<S::Verdict, NotTaken> {
        if self.base_place.is_some_and(|b| place <= b) {
            return Err(NotTaken::Closed);
        }
        let at = self.entries.partition_point(|e| e.place < place);
        if self.entries.get(at).is_some_and(|e| e.place == place) {
            return Err(NotTaken::Taken);
        }
        let mut state = self.before(at).clone();
        let verdict = state.apply(context, place.0, &event);
        self.entries.insert(at, OrderedEvent { place, event, after: state.clone() });
        for entry in self.entries.range_mut(at + 1..) {
            state.apply(context, entry.place.0, &entry.event);
            entry.after = state.clone();
        }
        if self.entries.len() > self.capacity {
            self.settle();
        }
        Ok(verdict)
    }

    fn before(&self, at: usize) -> &S {
        at.checked_sub(1).and_then(|i| self.entries.get(i)).map_or(&self.base, |e| &e.after)
    }

    fn settle(&mut self) {
        if let Some(entry) = self.entries.pop_front() {
            (self.base, self.base_place) = (entry.after, Some(entry.place));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Does not commute: x ← 3x + event, modulo a prime.
    #[derive(Clone, Debug, PartialEq)]
    struct Chain(u64);

    impl Replayed for Chain {
        type Event = u64;
        type Verdict = u64;
        type Context = ();
        fn apply(&mut self, (): &(), time: AutopilotTime, event: &u64) -> u64 {
            self.0 = (3 * self.0 + event + time.micros() as u64) % 1_000_003;
            self.0
        }
    }

    proptest! {
        #[test]
        fn the_order_of_arrival_does_not_matter(events in proptest::collection::vec((0..50i64, 0..9u64), 1..40), seed in 0..1000usize) {
            let all: Vec<(Place, u64)> = events.iter().enumerate().map(|(i, (t, e))| ((AutopilotTime::from_micros(*t), i as u64), *e)).collect();
            let run = |order: &[(Place, u64)]| {
                let mut ordered = Ordered::new(Chain(7), 64);
                order.iter().for_each(|(place, e)| { ordered.insert(&(), *place, *e).unwrap(); });
                ordered.latest().clone()
            };
            let mut other = all.clone();
            let n = other.len();
            (0..n).for_each(|i| other.swap(i, (i * 7 + seed) % n));
            prop_assert_eq!(run(&all), run(&other));
        }
    }

    #[test]
    fn the_past_closes_and_a_place_is_taken_once() {
        let at = |us| (AutopilotTime::from_micros(us), 0);
        let mut ordered = Ordered::new(Chain(1), 3);
        for us in [10, 20, 30] {
            ordered.insert(&(), at(us), 1).unwrap();
        }
        assert_eq!(ordered.insert(&(), at(20), 1), Err(NotTaken::Taken));
        ordered.close(AutopilotTime::from_micros(20));
        assert_eq!(ordered.insert(&(), at(10), 1), Err(NotTaken::Closed));
        assert!(ordered.insert(&(), at(15), 1).is_ok());
        // Full: the oldest becomes final.
        ordered.insert(&(), at(40), 1).unwrap();
        assert_eq!(ordered.insert(&(), at(12), 1), Err(NotTaken::Closed));
        assert_eq!(ordered.entries.len(), 3);
    }
}
