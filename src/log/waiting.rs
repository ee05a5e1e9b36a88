//! Messages whose stamps are far from the clock's, while it is not known whether the clock has jumped there.
//!
//! A jump of time is believed when four messages agree on it (`wire::clock`): one damaged stamp must not carry the flight away. The first three of
//! them are as good as the fourth, and after a pause of logging they are often the ones that tell why it goes on: armed, a new origin. So
//! they wait here, and are read when the jump is believed, in their order. What waits in vain has a stamp that is damaged or too old.

use std::collections::VecDeque;

use crate::wire::counters::Cause;

/// Messages that wait at most: the clock follows three suspicions, and needs four messages for each.
const MOST: usize = 32;

/// A message that waits.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct WaitingMessage {
    /// The format's number of it.
    pub(super) id: u16,
    /// Its stamp, µs since boot; `None` for one without, which is as old as what it came behind.
    pub(super) us: Option<u64>,
    /// Why its stamp was not believed.
    pub(super) cause: Cause,
    pub(super) payload: Vec<u8>,
}

/// See the module's documentation.
#[derive(Clone, Debug, Default)]
pub(super) struct WaitingMessages(VecDeque<WaitingMessage>);

impl WaitingMessages {
    /// Nothing waits.
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// One more waits; the one that has waited longest, where there is no room for both.
    pub(super) fn hold(&mut self, message: WaitingMessage) -> Option<WaitingMessage> {
        let oldest = if self.0.len() >= MOST { self.0.pop_front() } else { None };
        self.0.push_back(message);
        oldest
    }

    /// The next that has waited, in the order in which they came.
    pub(super) fn next(&mut self) -> Option<WaitingMessage> {
        self.0.pop_front()
    }
}

/// Whether a message that was refused for this may be of a time that the clock will jump to.
pub(super) fn may_wait(cause: Cause) -> bool {
    matches!(cause, Cause::Stale | Cause::OutOfOrder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn they_leave_in_their_order_and_only_so_many_wait() {
        let message =
            |id| WaitingMessage { id, us: Some(1), cause: Cause::Stale, payload: vec![id as u8; 3] };
        let mut waiting = WaitingMessages::default();
        let pushed: Vec<_> = (0..40).filter_map(|id| waiting.hold(message(id))).map(|m| m.id).collect();
        assert_eq!(pushed, (0..8).collect::<Vec<_>>());
        let rest: Vec<_> = std::iter::from_fn(|| waiting.next()).map(|m| m.id).collect();
        assert!(waiting.is_empty());
        assert_eq!(rest, (8..40).collect::<Vec<_>>());
    }
}
