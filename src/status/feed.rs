//! The navigation's end: it hands over copies, and never waits. What there is no room for is dropped; the next copy tells it all again.

use tokio::sync::mpsc::Sender;

use super::view::{EventView, StatusView};
use crate::geo::Geodetic;
use crate::navigator::solution::Mode;
use crate::time::{Companion, Span, Stamp};

/// Between two views.
const EVERY: Span = Span::from_millis(200);

/// What goes to whoever shows it.
#[derive(Debug)]
pub enum FeedItem {
    /// How everything fares.
    View(Box<StatusView>),
    /// What happened.
    Event(EventView),
}

/// See the module's documentation.
#[derive(Debug)]
pub struct StatusFeed {
    told: Sender<FeedItem>,
    begun: Stamp<Companion>,
    /// When the next view is due.
    due: Stamp<Companion>,
    mode: (Option<Mode>, Stamp<Companion>),
    reason: Option<String>,
    events: u64,
    /// The newest fix of GNSS and the autopilot's own place, and when they came.
    pub(super) gnss: Option<(Geodetic, Stamp<Companion>)>,
    pub(super) autopilot: Option<(Geodetic, Stamp<Companion>)>,
}

impl StatusFeed {
    pub(super) fn new(told: Sender<FeedItem>, now: Stamp<Companion>) -> Self {
        Self {
            told,
            begun: now,
            due: now,
            mode: (None, now),
            reason: None,
            events: 0,
            gnss: None,
            autopilot: None,
        }
    }

    /// Whether a view is due.
    pub fn is_due(&self, now: Stamp<Companion>) -> bool {
        now >= self.due
    }

    /// A receiver's fix.
    pub fn fix(&mut self, place: Geodetic, at: Stamp<Companion>) {
        self.gnss = Some((place, at));
    }

    /// Where the autopilot believes to be.
    pub fn autopilot(&mut self, place: Geodetic, at: Stamp<Companion>) {
        self.autopilot = Some((place, at));
    }

    /// Since the daemon began, s.
    pub fn uptime_s(&self, now: Stamp<Companion>) -> f64 {
        now.seconds_since(self.begun)
    }

    /// For how long the mode has been this one, s, and why it changed.
    pub fn mode(&mut self, mode: Mode, now: Stamp<Companion>) -> (f64, Option<String>) {
        if self.mode.0 != Some(mode) {
            self.mode = (Some(mode), now);
        }
        (now.seconds_since(self.mode.1), self.reason.clone())
    }

    /// The mode has changed, for this reason.
    pub fn mode_changed(&mut self, reason: String) {
        self.reason = Some(reason);
    }

    /// Hands over how everything fares.
    pub fn show(&mut self, view: StatusView, now: Stamp<Companion>) {
        self.due = now + EVERY;
        // What is full is not read at present.
        let _ = self.told.try_send(FeedItem::View(Box::new(view)));
    }

    /// Hands over what happened; its number and its time are put in.
    pub fn tell(&mut self, event: EventView, now: Stamp<Companion>) {
        self.events += 1;
        let event = EventView { number: self.events, at_s: self.uptime_s(now), ..event };
        let _ = self.told.try_send(FeedItem::Event(event));
    }
}
