//! Frames that wait to be written.
//!
//! A full queue gives up its oldest frame, and a frame that waited too long is given up when its turn comes: what the
//! autopilot is told must be new. While the link is down nothing is taken in.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

use crate::time::{Companion, Span, Stamp};
use crate::wire::frame_bytes::FrameBytes;

/// What became of a frame that was to be sent.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SendOutcome {
    /// It waits for its turn.
    Queued,
    /// It waits for its turn, and the oldest that waited was dropped for it.
    QueuedOldestDropped,
    /// The link is down; it was dropped.
    LinkDown,
    /// There is no link of that number.
    NoSuchLink,
    /// It could not be signed, and there is a key; it was dropped.
    NotSigned,
}

/// A bounded queue with one reader.
#[derive(Debug)]
pub(super) struct OutboundQueue {
    state: Mutex<State>,
    arrived: Notify,
    capacity: usize,
    max_age: Span,
}

#[derive(Debug)]
struct State {
    frames: VecDeque<(FrameBytes, Stamp<Companion>)>,
    open: bool,
}

/// The next frame, and how many were given up on the way to it.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Popped {
    pub(super) frame: Option<FrameBytes>,
    pub(super) stale: u64,
}

impl OutboundQueue {
    pub(super) fn new(capacity: usize, max_age: Span) -> Self {
        let capacity = capacity.max(1);
        let state = State { frames: VecDeque::with_capacity(capacity), open: false };
        Self { state: Mutex::new(state), arrived: Notify::new(), capacity, max_age }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes frames in from now on.
    pub(super) fn open(&self) {
        self.state().open = true;
    }

    /// Takes no more frames in, and drops those that wait; returns how many.
    pub(super) fn close(&self) -> u64 {
        let mut state = self.state();
        state.open = false;
        let dropped = state.frames.len() as u64;
        state.frames.clear();
        dropped
    }

    /// Takes a frame in that tells of what was so `since`.
    pub(super) fn push(&self, frame: FrameBytes, since: Stamp<Companion>) -> SendOutcome {
        let mut state = self.state();
        if !state.open {
            return SendOutcome::LinkDown;
        }
        let full = state.frames.len() >= self.capacity;
        if full {
            state.frames.pop_front();
        }
        state.frames.push_back((frame, since));
        drop(state);
        self.arrived.notify_one();
        if full { SendOutcome::QueuedOldestDropped } else { SendOutcome::Queued }
    }

    pub(super) fn pop(&self, now: Stamp<Companion>) -> Popped {
        let mut state = self.state();
        let mut stale = 0;
        while let Some((frame, since)) = state.frames.pop_front() {
            if now - since <= self.max_age {
                return Popped { frame: Some(frame), stale };
            }
            stale += 1;
        }
        Popped { frame: None, stale }
    }

    /// Waits until a frame may have come in since the last [`OutboundQueue::pop`].
    pub(super) async fn arrived(&self) {
        self.arrived.notified().await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(i: u8) -> FrameBytes {
        FrameBytes::new(&[i]).unwrap()
    }

    fn at(ms: i64) -> Stamp<Companion> {
        Stamp::from_micros(ms * 1000)
    }

    #[test]
    fn a_full_queue_gives_up_the_oldest() {
        let queue = OutboundQueue::new(2, Span::from_millis(200));
        queue.open();
        assert_eq!(queue.push(frame(1), at(0)), SendOutcome::Queued);
        assert_eq!(queue.push(frame(2), at(0)), SendOutcome::Queued);
        assert_eq!(queue.push(frame(3), at(0)), SendOutcome::QueuedOldestDropped);
        assert_eq!(queue.pop(at(0)).frame, Some(frame(2)));
        assert_eq!(queue.pop(at(0)).frame, Some(frame(3)));
        assert_eq!(queue.pop(at(0)), Popped { frame: None, stale: 0 });
    }

    #[test]
    fn what_waited_too_long_is_not_sent() {
        let queue = OutboundQueue::new(8, Span::from_millis(200));
        queue.open();
        for (i, ms) in [0, 50, 100, 150].into_iter().enumerate() {
            queue.push(frame(i as u8), at(ms));
        }
        assert_eq!(queue.pop(at(251)), Popped { frame: Some(frame(2)), stale: 2 });
        assert_eq!(queue.pop(at(900)), Popped { frame: None, stale: 1 });
    }

    #[test]
    fn nothing_waits_for_a_link_that_is_down() {
        let queue = OutboundQueue::new(8, Span::from_millis(200));
        assert_eq!(queue.push(frame(1), at(0)), SendOutcome::LinkDown);
        queue.open();
        queue.push(frame(1), at(0));
        assert_eq!(queue.close(), 1);
        queue.open();
        assert_eq!(queue.pop(at(0)).frame, None);
    }
}
