//! How often something came of late.

use std::collections::VecDeque;

use crate::time::{Companion, Span, Stamp};

/// Of late: the last so long.
const WINDOW: Span = Span::from_millis(4000);

/// See the module's documentation.
#[derive(Clone, Debug, Default)]
pub struct RecentRate {
    stamps: VecDeque<Stamp<Companion>>,
}

impl RecentRate {
    /// It came at `at`.
    pub fn note(&mut self, at: Stamp<Companion>) {
        self.stamps.push_back(at);
        while self.stamps.front().is_some_and(|&first| at - first > WINDOW) {
            self.stamps.pop_front();
        }
    }

    /// How often it came, Hz, over the last 4 s.
    pub fn hz(&self, now: Stamp<Companion>) -> f64 {
        let n = self.stamps.iter().filter(|&&s| now - s <= WINDOW).count();
        n as f64 / WINDOW.seconds()
    }
}
