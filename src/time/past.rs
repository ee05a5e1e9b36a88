//! The recent past of something that is sampled, for what comes late: a ring of stamped values.

use super::AutopilotTime;

/// A value that knows its time.
pub trait Stamped {
    /// When it was so.
    fn stamp(&self) -> AutopilotTime;
}

/// The newest `capacity` values, the oldest overwritten first. Allocated once, at construction and when cloned.
///
/// Values are pushed in the order of their stamps; whoever pushes sees to that. What lies between two of them is not its business: users
/// interpolate, and correct, as their values demand.
#[derive(Debug)]
pub struct Past<T> {
    /// Grows up to the capacity, then is overwritten in turn.
    entries: Vec<T>,
    /// Where the next value goes: all before it are newer than all from it on.
    next: usize,
    capacity: usize,
}

impl<T> Past<T> {
    /// An empty past with room for `capacity` values, at least one.
    pub fn new(capacity: usize) -> Self {
        let capacity = capacity.max(1);
        Self { entries: Vec::with_capacity(capacity), next: 0, capacity }
    }

    /// Adds the newest value; when there is no room the oldest is forgotten.
    pub fn push(&mut self, value: T) {
        match self.entries.get_mut(self.next) {
            Some(oldest) => *oldest = value,
            None => self.entries.push(value),
        }
        self.next = (self.next + 1) % self.capacity;
    }

    /// Forgets everything and keeps the room.
    pub fn clear(&mut self) {
        self.entries.clear();
        self.next = 0;
    }

    /// From the newest to the oldest.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &T> {
        let (newer, older) = self.entries.split_at(self.next);
        newer.iter().rev().chain(older.iter().rev())
    }

    /// From the newest to the oldest, to be changed.
    pub fn iter_mut(&mut self) -> impl DoubleEndedIterator<Item = &mut T> {
        let (newer, older) = self.entries.split_at_mut(self.next);
        newer.iter_mut().rev().chain(older.iter_mut().rev())
    }

    /// The value pushed last.
    pub fn newest(&self) -> Option<&T> {
        self.iter().next()
    }
}

impl<T: Stamped> Past<T> {
    /// The newest value that is not later than `time` and has a later neighbour, that neighbour, and how far `time` lies between the
    /// two: 0 at the earlier, 1 at the later. At the newest stamp itself the fraction is 1. `None` after the newest and before the oldest.
    pub fn around(&self, time: AutopilotTime) -> Option<(&T, &T, f64)> {
        let mut later = self.newest()?;
        if time > later.stamp() {
            return None;
        }
        for earlier in self.iter().skip(1) {
            if earlier.stamp() <= time {
                let step = later.stamp().seconds_since(earlier.stamp());
                let since = time.seconds_since(earlier.stamp());
                return Some((earlier, later, if step > 0.0 { since / step } else { 1.0 }));
            }
            later = earlier;
        }
        None
    }
}

impl<T: Clone> Clone for Past<T> {
    /// With the same room: a vector's own clone has only room for what is in it, and would grow at a push.
    fn clone(&self) -> Self {
        let mut entries = Vec::with_capacity(self.capacity);
        entries.extend_from_slice(&self.entries);
        Self { entries, next: self.next, capacity: self.capacity }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: i64) -> AutopilotTime {
        AutopilotTime::from_micros(ms * 1000)
    }

    #[derive(Clone, Debug, PartialEq)]
    struct Reading(i64);

    impl Stamped for Reading {
        fn stamp(&self) -> AutopilotTime {
            at(self.0)
        }
    }

    fn filled(capacity: usize, stamps_ms: impl IntoIterator<Item = i64>) -> Past<Reading> {
        let mut past = Past::new(capacity);
        stamps_ms.into_iter().for_each(|ms| past.push(Reading(ms)));
        past
    }

    fn stamps(past: &Past<Reading>) -> Vec<i64> {
        past.iter().map(|r| r.0).collect()
    }

    #[test]
    fn the_newest_values_stay_in_their_order_at_any_fill() {
        for pushed in 0..20 {
            let past = filled(6, 0..pushed);
            let expected: Vec<i64> = (0..pushed).rev().take(6).collect();
            assert_eq!(stamps(&past), expected);
            assert_eq!(past.newest().map(|r| r.0), expected.first().copied());
            assert_eq!(past.iter().next_back().map(|r| r.0), expected.last().copied());
        }
    }

    #[test]
    fn changes_go_from_the_newest_to_the_oldest() {
        let mut past = filled(4, 0..7);
        past.iter_mut().zip(0..).for_each(|(r, n)| r.0 = 10 * r.0 + n);
        assert_eq!(stamps(&past), [60, 51, 42, 33]);
    }

    #[test]
    fn a_time_has_its_neighbours_and_its_place_between_them() {
        let past = filled(4, [0, 10, 20, 40, 50]);
        let around = |ms| past.around(at(ms)).map(|(a, b, f)| (a.0, b.0, f));
        assert_eq!(around(25), Some((20, 40, 0.25)));
        assert_eq!(around(20), Some((20, 40, 0.0)));
        assert_eq!(around(10), Some((10, 20, 0.0)), "the oldest");
        assert_eq!(around(50), Some((40, 50, 1.0)), "the newest");
        assert_eq!(around(9), None, "forgotten");
        assert_eq!(around(51), None, "not yet");
        assert_eq!(filled(4, [7]).around(at(7)).map(|(_, _, f)| f), None, "one has no neighbour");
        assert_eq!(filled(4, [7, 7]).around(at(7)).map(|(_, _, f)| f), Some(1.0), "no time between them");
    }

    #[test]
    fn nothing_is_allocated_after_construction() {
        let past = filled(100, 0..3);
        for mut past in [past.clone(), past] {
            let room = past.entries.as_ptr();
            (3..500).for_each(|ms| past.push(Reading(ms)));
            past.clear();
            assert!(past.newest().is_none() && past.around(at(499)).is_none());
            (500..800).for_each(|ms| past.push(Reading(ms)));
            assert_eq!((past.entries.as_ptr(), past.iter().count()), (room, 100));
        }
    }
}
