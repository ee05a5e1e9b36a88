//! The viewers' end: the newest view, the events of late, the track, and what was counted of requests.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::{Semaphore, watch};

use super::feed::FeedItem;
use super::rates::SourceRates;
use super::view::{EventView, StatusView};

/// Events that are remembered.
const MOST_EVENTS: usize = 200;
/// Points of the track, one a second.
const MOST_POINTS: usize = 1800;
const POINT_EVERY_S: f64 = 1.0;
/// Viewers of the stream at a time.
const MOST_VIEWERS: usize = 12;

/// What became of requests.
#[derive(Debug, Default)]
pub(super) struct RequestCounts {
    pub(super) served: AtomicU64,
    /// Of a host or an origin that is not ours.
    pub(super) foreign: AtomicU64,
    /// Of no such path or method.
    pub(super) unknown: AtomicU64,
    /// Too many at a time, too slow, or no HTTP.
    pub(super) dropped: AtomicU64,
}

impl RequestCounts {
    pub(super) fn note(count: &AtomicU64) {
        count.fetch_add(1, Ordering::Relaxed);
    }
}

/// A point of the track: s since the daemon began, north and east, m.
pub(super) type TrackPoint = [f64; 3];

/// A view, and the same as it is sent.
#[derive(Debug, Default)]
pub(super) struct Shown {
    pub(super) view: StatusView,
    pub(super) json: String,
}

/// See the module's documentation.
#[derive(Debug)]
pub(super) struct Board {
    pub(super) newest: watch::Sender<Arc<Shown>>,
    pub(super) viewers: Arc<Semaphore>,
    pub(super) requests: RequestCounts,
    past: Mutex<ShownPast>,
}

#[derive(Debug, Default)]
struct ShownPast {
    events: VecDeque<EventView>,
    counts: BTreeMap<String, u64>,
    track: VecDeque<TrackPoint>,
    rates: SourceRates,
}

impl Board {
    pub(super) fn new() -> Self {
        Self {
            newest: watch::Sender::new(Arc::default()),
            viewers: Arc::new(Semaphore::new(MOST_VIEWERS)),
            requests: RequestCounts::default(),
            past: Mutex::default(),
        }
    }

    fn past(&self) -> MutexGuard<'_, ShownPast> {
        self.past.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes what the navigation tells.
    pub(super) fn take(&self, told: FeedItem) {
        let mut past = self.past();
        match told {
            FeedItem::Event(event) => {
                if past.events.len() >= MOST_EVENTS {
                    past.events.pop_front();
                }
                *past.counts.entry(event.severity.clone()).or_default() += 1;
                past.events.push_back(event);
            }
            FeedItem::View(mut view) => {
                past.rates.complete(&mut view);
                past.follow(&view);
                drop(past);
                // A view holds nothing that cannot be written.
                let json = serde_json::to_string(&view).unwrap_or_default();
                self.newest.send_replace(Arc::new(Shown { view: *view, json }));
            }
        }
    }

    /// Events after this number, the oldest first.
    pub(super) fn events(&self, after: u64) -> Vec<EventView> {
        self.past().events.iter().filter(|e| e.number > after).cloned().collect()
    }

    /// Events by severity, since the daemon began.
    pub(super) fn event_counts(&self) -> BTreeMap<String, u64> {
        self.past().counts.clone()
    }

    /// The track of the last half hour.
    pub(super) fn track(&self) -> Vec<TrackPoint> {
        self.past().track.iter().copied().collect()
    }
}

impl ShownPast {
    fn follow(&mut self, view: &StatusView) {
        let Some(plan) = view.plan.as_ref().filter(|_| view.mode.name != "Aligning") else { return };
        if self.track.back().is_some_and(|[t, ..]| view.uptime_s - t < POINT_EVERY_S) {
            return;
        }
        if self.track.len() >= MOST_POINTS {
            self.track.pop_front();
        }
        let [north, east, _] = plan.position_ned_m;
        self.track.push_back([view.uptime_s, north, east]);
    }
}
