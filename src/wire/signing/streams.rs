//! The stamps of every stream heard, and the rules that they keep.

use serde::{Deserialize, Serialize};

use super::signature::SigningStamp;
use crate::wire::counters::Cause;

/// Streams that are remembered at once: vehicles, ground stations and cameras on several links are some ten.
pub(super) const MOST_STREAMS: usize = 64;
/// A new stream may be so far behind the newest stamp known.
const MOST_BEHIND: u64 = 60 * SigningStamp::PER_SECOND;

/// Who sends, by which of its links.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct StreamName {
    pub(super) system: u8,
    pub(super) component: u8,
    pub(super) link_id: u8,
}

/// One of them, and the last stamp that it was heard with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct HeardStream {
    #[serde(flatten)]
    pub(super) name: StreamName,
    pub(super) last: u64,
}

/// See the module's documentation. Only frames whose signature fits come here.
#[derive(Clone, Debug, Default)]
pub(super) struct StampBook {
    pub(super) heard: Vec<HeardStream>,
    /// The newest stamp known: heard, sent, or told by the clock.
    pub(super) newest: SigningStamp,
}

impl StampBook {
    /// Whether a stamp may be.
    ///
    /// # Errors
    /// [`Cause::Replayed`] or [`Cause::OldSignature`].
    pub(super) fn judge(&self, name: StreamName, stamp: SigningStamp) -> Result<(), Cause> {
        match self.heard.iter().find(|s| s.name == name) {
            Some(known) if stamp.0 <= known.last => Err(Cause::Replayed),
            None if stamp.after(MOST_BEHIND) < self.newest => Err(Cause::OldSignature),
            // Whoever could open so many within a minute has the key, and no need to.
            None if self.heard.len() >= MOST_STREAMS && self.forgettable().is_none() => {
                Err(Cause::OldSignature)
            }
            _ => Ok(()),
        }
    }

    /// Notes a stamp that may be. Whether its stream is new.
    pub(super) fn note(&mut self, name: StreamName, stamp: SigningStamp) -> bool {
        self.newest = self.newest.max(stamp);
        if let Some(known) = self.heard.iter_mut().find(|s| s.name == name) {
            known.last = stamp.0;
            return false;
        }
        let new = HeardStream { name, last: stamp.0 };
        match self.forgettable().filter(|_| self.heard.len() >= MOST_STREAMS) {
            Some(at) => self.heard[at] = new,
            None => self.heard.push(new),
        }
        true
    }

    /// One whose frames would be refused as too old if it were new: nothing of it can be replayed.
    fn forgettable(&self) -> Option<usize> {
        let oldest = self.heard.iter().enumerate().min_by_key(|(_, s)| s.last)?;
        (SigningStamp(oldest.1.last).after(MOST_BEHIND) < self.newest).then_some(oldest.0)
    }

    /// The next stamp to send with, at this time of day; it never comes again. `None` when there are no more.
    pub(super) fn next(&mut self, clock: SigningStamp) -> Option<SigningStamp> {
        let next = self.newest.after(1).max(clock);
        (next > self.newest).then(|| {
            self.newest = next;
            next
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn name(link_id: u8) -> StreamName {
        StreamName { system: 1, component: 1, link_id }
    }

    fn take(book: &mut StampBook, link_id: u8, stamp: u64) -> Result<(), Cause> {
        book.judge(name(link_id), SigningStamp(stamp))?;
        book.note(name(link_id), SigningStamp(stamp));
        Ok(())
    }

    #[test]
    fn stamps_of_a_stream_increase_and_a_new_one_is_of_the_last_minute() {
        let now = 1_000 * SigningStamp::PER_SECOND;
        let mut book = StampBook { newest: SigningStamp(now), ..StampBook::default() };
        assert_eq!(take(&mut book, 0, now - MOST_BEHIND - 1), Err(Cause::OldSignature));
        assert_eq!(take(&mut book, 0, now - MOST_BEHIND), Ok(()));
        assert_eq!(take(&mut book, 0, now - MOST_BEHIND), Err(Cause::Replayed));
        assert_eq!(take(&mut book, 0, now - MOST_BEHIND + 1), Ok(()), "slow, but it goes on");
        assert_eq!(take(&mut book, 1, now - 5), Ok(()), "another link counts by itself");
        assert_eq!(take(&mut book, 1, now - 6), Err(Cause::Replayed));
        assert_eq!(take(&mut book, 1, now + 7), Ok(()));
        assert_eq!(book.newest.0, now + 7, "ours follows");
        assert_eq!(book.next(SigningStamp(now)).unwrap().0, now + 8);
        assert_eq!(book.next(SigningStamp(now + 100)).unwrap().0, now + 100);
        assert_eq!(book.next(SigningStamp(now)).unwrap().0, now + 101);
    }

    #[test]
    fn streams_are_bounded_and_only_those_are_forgotten_that_cannot_be_replayed() {
        let mut book = StampBook::default();
        for link in 0..MOST_STREAMS as u8 {
            assert_eq!(take(&mut book, link, 100 + u64::from(link)), Ok(()));
        }
        assert_eq!(take(&mut book, 200, 200), Err(Cause::OldSignature));
        assert_eq!(take(&mut book, 5, 2 * MOST_BEHIND), Ok(()));
        assert_eq!(take(&mut book, 200, 2 * MOST_BEHIND), Ok(()));
        assert_eq!(book.heard.len(), MOST_STREAMS);
        assert_eq!(take(&mut book, 0, 101), Err(Cause::OldSignature), "it was forgotten");
    }

    #[test]
    fn the_last_stamp_is_the_last() {
        let mut book = StampBook { newest: SigningStamp(SigningStamp::LAST.0 - 1), ..StampBook::default() };
        assert_eq!(book.next(SigningStamp(0)), Some(SigningStamp::LAST));
        assert_eq!(book.next(SigningStamp(0)), None);
    }

    proptest! {
        #[test]
        fn nothing_is_taken_twice(stamps in prop::collection::vec((0u8..3, 0u64..50), 0..200)) {
            let (mut book, mut taken) = (StampBook::default(), std::collections::BTreeSet::new());
            for (link, stamp) in stamps {
                if take(&mut book, link, stamp).is_ok() {
                    prop_assert!(taken.insert((link, stamp)));
                }
            }
        }
    }
}
