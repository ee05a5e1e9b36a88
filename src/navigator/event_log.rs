//! Events that nobody has taken yet, and how often the same may be told: once a minute, and then with how often it was.
//!
//! A source that alternates (noisy, healthy, noisy) is told as it changes, but each of its words only once a minute. What is held back is
//! counted, and its last word is told when its minute is over, so that what was told last is never older than that. What changes once and for
//! all (mode, origin, resets) is told at once, always.

use crate::altimeter::Channel;
use crate::time::AutopilotTime;

use super::event::{Event, EventKind};
use super::sources::status::SourceId;
use crate::navigator::tuning::event_log::{EXPECTED, TOLD_EVERY_S};

/// Whom an event is about. Words about one subject replace each other.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Subject {
    Height(Channel),
    InertialHeight,
    Flow(u8),
    Source(SourceId),
    Receiver(u8),
    Carried,
    Bridged,
    Heading,
    Landmark(u8),
    Landmarks,
    LandmarkRelation,
    Filter,
}

impl Subject {
    /// `None` for what is always told.
    fn of(kind: &EventKind) -> Option<Self> {
        Some(match kind {
            EventKind::HeightFault { channel, .. } | EventKind::HeightHealed(channel) => {
                Self::Height(*channel)
            }
            EventKind::InertialHeight(_) => Self::InertialHeight,
            EventKind::FlowTrusted(id) | EventKind::FlowDistrusted(id, _) => Self::Flow(*id),
            EventKind::Accused(source, _) | EventKind::Acquitted(source) => Self::Source(*source),
            EventKind::Receiver(id) => Self::Receiver(*id),
            EventKind::Carried(_) => Self::Carried,
            EventKind::Bridged(_) => Self::Bridged,
            EventKind::HeadingTurned(_) => Self::Heading,
            EventKind::LandmarkContradicts(id) => Self::Landmark(*id),
            EventKind::LandmarksFound | EventKind::LandmarksLost => Self::Landmarks,
            EventKind::LandmarksApart(_)
            | EventKind::LandmarksAgree
            | EventKind::LandmarksContradict { .. } => Self::LandmarkRelation,
            EventKind::FilterRestarted(_) => Self::Filter,
            _ => return None,
        })
    }
}

/// A word about a subject: when it was told last, and how often it was held back since.
#[derive(Clone, Copy, Debug)]
struct Word {
    subject: Subject,
    code: &'static str,
    told: AutopilotTime,
    held_back: u32,
    /// It is the last word about its subject, and was held back.
    waiting: Option<EventKind>,
}

impl Word {
    fn may_be_told(&self, now: AutopilotTime) -> bool {
        // A clock that was set back makes no minute longer.
        !(0.0..TOLD_EVERY_S).contains(&now.seconds_since(self.told))
    }
}

/// See the module's documentation. Kept short: whoever runs the navigator drains it.
#[derive(Clone, Debug, Default)]
pub(super) struct EventLog {
    events: Vec<Event>,
    words: Vec<Word>,
    /// Some word waits.
    waiting: bool,
}

impl EventLog {
    pub(super) fn new() -> Self {
        Self { events: Vec::with_capacity(EXPECTED), words: Vec::with_capacity(EXPECTED), waiting: false }
    }

    pub(super) fn tell(&mut self, time: AutopilotTime, kind: EventKind) {
        let Some(subject) = Subject::of(&kind) else {
            self.events.push(Event { time, kind, times: 1 });
            return;
        };
        // What was to be said of the subject has been overtaken.
        self.words.iter_mut().filter(|w| w.subject == subject).for_each(|w| w.waiting = None);
        let code = kind.code();
        let Some(word) = self.words.iter_mut().find(|w| w.subject == subject && w.code == code) else {
            self.words.push(Word { subject, code, told: time, held_back: 0, waiting: None });
            self.events.push(Event { time, kind, times: 1 });
            return;
        };
        if word.may_be_told(time) {
            self.events.push(Event { time, kind, times: word.held_back + 1 });
            (word.told, word.held_back) = (time, 0);
        } else {
            word.held_back += 1;
            word.waiting = Some(kind);
            self.waiting = true;
        }
    }

    /// Time goes on: what waits is told when its minute is over.
    pub(super) fn go_on(&mut self, now: AutopilotTime) {
        if !self.waiting {
            return;
        }
        self.waiting = false;
        for word in &mut self.words {
            let Some(kind) = word.waiting else { continue };
            if word.may_be_told(now) {
                self.events.push(Event { time: now, kind, times: word.held_back });
                (word.told, word.held_back, word.waiting) = (now, 0, None);
            } else {
                self.waiting = true;
            }
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.events.is_empty()
    }

    pub(super) fn drain(&mut self) -> impl Iterator<Item = Event> + '_ {
        self.events.drain(..)
    }
}

#[cfg(test)]
mod tests {
    use super::super::event::TransitionReason;
    use super::super::solution::Mode;
    use super::*;
    use crate::altimeter::Fault;

    fn at(s: f64) -> AutopilotTime {
        AutopilotTime::from_micros((s * 1e6) as i64)
    }

    const NOISY: EventKind = EventKind::HeightFault {
        channel: Channel::Baro,
        fault: Fault::Noise { variance_factor: 9.0 },
        for_s: 1.0,
    };
    const WELL: EventKind = EventKind::HeightHealed(Channel::Baro);

    #[test]
    fn what_alternates_is_told_once_a_minute_with_how_often_it_was() {
        let mut log = EventLog::new();
        for k in 0..40 {
            let t = f64::from(k) * 5.0;
            log.go_on(at(t));
            log.tell(at(t), if k % 2 == 0 { NOISY } else { WELL });
        }
        let told: Vec<_> = log.drain().collect();
        for code in [NOISY.code(), WELL.code()] {
            let of: Vec<_> = told.iter().filter(|e| e.kind.code() == code).collect();
            assert!(of.windows(2).all(|w| w[1].time.seconds_since(w[0].time) >= TOLD_EVERY_S));
            assert_eq!(of.len(), 4, "{of:?}");
        }
        assert_eq!(told[2].to_string(), "barometer noise x3.0 for 1.0 s, 6 times");
    }

    #[test]
    fn the_last_word_is_told_when_its_minute_is_over() {
        let mut log = EventLog::new();
        for (t, kind) in [(0.0, NOISY), (5.0, WELL), (10.0, NOISY), (20.0, WELL), (25.0, NOISY)] {
            log.tell(at(t), kind);
        }
        assert_eq!(log.drain().count(), 2);
        log.go_on(at(59.0));
        assert!(log.is_empty());
        log.go_on(at(60.5));
        let last: Vec<_> = log.drain().collect();
        assert_eq!((last.len(), last[0].kind, last[0].times), (1, NOISY, 2));
        log.go_on(at(500.0));
        assert!(log.is_empty(), "the other word was overtaken");
    }

    #[test]
    fn other_subjects_and_modes_are_not_held_back() {
        let mut log = EventLog::new();
        let mode = |from, to| EventKind::Mode { from, to, reason: TransitionReason::Joined };
        for k in 0..5 {
            log.tell(at(f64::from(k)), mode(Mode::Aided, Mode::Holdover));
            log.tell(at(f64::from(k)), EventKind::Reset(2.0));
        }
        log.tell(at(1.0), EventKind::FlowTrusted(0));
        log.tell(at(1.0), EventKind::FlowTrusted(1));
        assert_eq!(log.drain().count(), 12);
        log.tell(at(0.5), EventKind::FlowTrusted(0));
        assert_eq!(log.drain().count(), 1, "a clock that was set back");
    }
}
