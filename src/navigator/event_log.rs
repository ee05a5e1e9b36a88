//! Events that nobody has taken yet, and how often the same may be told: once a minute, and then with how often it was.
//!
//! A source that alternates (noisy, healthy, noisy) is told as it changes, but each of its words only once a minute. What is held back is
//! counted, and its last word is told when its minute is over. Where it says another thing than what was told last, that is too late: nobody
//! may read "healthy again" of what is faulty. It is told as soon as it has stayed for some seconds, with its count. So that nobody is told every
//! change of what alternates slowly, it has to stay for twice as long each time, until its word has been quiet for a minute. When nothing more
//! is heard all that waits is told. What changes once and for all (mode, origin, resets) is told at once, always.

use crate::altimeter::Channel;
use crate::time::AutopilotTime;

use super::event::{Event, EventKind};
use super::sources::status::SourceId;
use crate::navigator::tuning::event_log::{EXPECTED, STAYED_S, TOLD_EVERY_S};

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
    /// No word about its subject was told later.
    newest: bool,
    /// How long it has to stay before it is told within its minute, s.
    patience_s: f64,
    /// It is the last word about its subject, and has been held back since then.
    waiting: Option<(EventKind, AutopilotTime)>,
}

impl Word {
    fn may_be_told(&self, now: AutopilotTime) -> bool {
        // A clock that was set back makes no minute longer.
        !(0.0..TOLD_EVERY_S).contains(&now.seconds_since(self.told))
    }

    /// Tells what waits, if there is anything.
    fn tell(&mut self, now: AutopilotTime) -> Option<Event> {
        let (kind, _) = self.waiting.take()?;
        // Told again within its minute it is told with what was told before: never twice a minute without a count.
        let times = if self.may_be_told(now) { self.held_back } else { self.held_back + 1 };
        (self.told, self.held_back) = (now, 0);
        Some(Event { time: now, kind, times })
    }

    /// Whether it has stayed for long enough, where another word was told after it.
    fn has_stayed(&self, now: AutopilotTime) -> bool {
        let stayed = |(_, since)| !(0.0..self.patience_s).contains(&now.seconds_since(since));
        !self.newest && self.waiting.is_some_and(stayed)
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
        let code = kind.code();
        // What was to be said of the subject has been overtaken; the same again has been so since it was said first.
        let mut since = time;
        for word in self.words.iter_mut().filter(|w| w.subject == subject) {
            if let Some((_, before)) = word.waiting.take().filter(|_| word.code == code) {
                since = before;
            }
        }
        let known = self.words.iter().position(|w| w.subject == subject && w.code == code);
        let at = known.unwrap_or_else(|| {
            let never = Word {
                subject,
                code,
                told: time,
                held_back: 0,
                newest: false,
                patience_s: STAYED_S,
                waiting: None,
            };
            self.words.push(never);
            self.words.len() - 1
        });
        let Some(word) = self.words.get_mut(at) else { return };
        if known.is_some() && !word.may_be_told(time) {
            word.held_back += 1;
            word.waiting = Some((kind, since));
            self.waiting = true;
            return;
        }
        if word.held_back == 0 {
            word.patience_s = STAYED_S;
        }
        self.events.push(Event { time, kind, times: word.held_back + 1 });
        (word.told, word.held_back) = (time, 0);
        self.told_last(at);
    }

    /// Time goes on: what waits is told when its minute is over, or when it has stayed although another thing was told last.
    pub(super) fn go_on(&mut self, now: AutopilotTime) {
        if !self.waiting {
            return;
        }
        self.waiting = false;
        for at in 0..self.words.len() {
            let Some(word) = self.words.get_mut(at).filter(|w| w.waiting.is_some()) else { continue };
            let due = word.may_be_told(now);
            if !due && word.has_stayed(now) {
                word.patience_s = (2.0 * word.patience_s).min(TOLD_EVERY_S);
            } else if !due {
                self.waiting = true;
                continue;
            }
            self.events.extend(word.tell(now));
            self.told_last(at);
        }
    }

    /// Nothing more is heard: what waits and is not what was told last is told.
    pub(super) fn close(&mut self, now: AutopilotTime) {
        for at in 0..self.words.len() {
            let Some(word) = self.words.get_mut(at).filter(|w| !w.newest && w.waiting.is_some()) else {
                continue;
            };
            self.events.extend(word.tell(now));
            self.told_last(at);
        }
    }

    /// This word is the newest about its subject.
    fn told_last(&mut self, at: usize) {
        let Some(subject) = self.words.get(at).map(|w| w.subject) else { return };
        for (i, word) in self.words.iter_mut().enumerate().filter(|(_, w)| w.subject == subject) {
            word.newest = i == at;
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
            let t = f64::from(k) * 4.0;
            log.go_on(at(t));
            log.tell(at(t), if k % 2 == 0 { NOISY } else { WELL });
        }
        let told: Vec<_> = log.drain().collect();
        for code in [NOISY.code(), WELL.code()] {
            let of: Vec<_> = told.iter().filter(|e| e.kind.code() == code).collect();
            assert!(of.windows(2).all(|w| w[1].time.seconds_since(w[0].time) >= TOLD_EVERY_S));
            assert_eq!(of.len(), 3, "{of:?}");
        }
        assert_eq!(told[2].to_string(), "barometer noise x3.0 for 1.0 s, 7 times");
    }

    #[test]
    fn the_last_word_is_told_when_its_minute_is_over() {
        let mut log = EventLog::new();
        for (t, kind) in [(0.0, NOISY), (5.0, WELL), (10.0, NOISY), (20.0, WELL), (21.0, NOISY), (25.0, WELL)]
        {
            log.tell(at(t), kind);
        }
        // That it is well again is what was told last.
        assert_eq!(log.drain().count(), 2);
        log.go_on(at(64.0));
        assert!(log.is_empty());
        log.go_on(at(65.5));
        let last: Vec<_> = log.drain().collect();
        assert_eq!((last.len(), last[0].kind, last[0].times), (1, WELL, 2));
        log.go_on(at(500.0));
        assert!(log.is_empty(), "the other word was overtaken");
    }

    #[test]
    fn what_stays_is_told_before_its_minute_is_over_with_its_count() {
        let mut log = EventLog::new();
        log.tell(at(0.0), NOISY);
        log.tell(at(12.0), WELL);
        log.drain().for_each(drop);
        log.tell(at(15.0), NOISY);
        log.go_on(at(15.0 + 0.9 * STAYED_S));
        assert!(log.is_empty());
        // The same again does not begin its time anew.
        log.tell(at(15.0 + 0.9 * STAYED_S), NOISY);
        log.go_on(at(15.0 + STAYED_S));
        let told: Vec<_> = log.drain().collect();
        assert_eq!((told.len(), told[0].kind, told[0].times), (1, NOISY, 3));
        assert_eq!(told[0].to_string(), "barometer noise x3.0 for 1.0 s, 3 times");
        // It is told to be so: nothing is to be added to it within its minute.
        log.tell(at(25.0), NOISY);
        log.go_on(at(25.0 + 2.0 * STAYED_S));
        assert!(log.is_empty());
    }

    #[test]
    fn whatever_alternates_the_last_word_is_never_long_the_wrong_one_nor_told_without_end() {
        for period_s in [1.0, 4.0, 5.5, 7.0, 12.0, 25.0, 45.0, 70.0] {
            let mut log = EventLog::new();
            let (mut told, mut wrong_s) = (Vec::<Event>::new(), 0.0);
            for second in 0..600 {
                let t = f64::from(second);
                let so = if ((t / period_s) as u32).is_multiple_of(2) { NOISY } else { WELL };
                let before = if (((t - 1.0) / period_s) as u32).is_multiple_of(2) { NOISY } else { WELL };
                if second == 0 || so != before {
                    log.tell(at(t), so);
                }
                log.go_on(at(t));
                told.extend(log.drain());
                let right = told.last().is_some_and(|e| e.kind == so);
                wrong_s = if right { 0.0 } else { wrong_s + 1.0 };
                assert!(wrong_s <= TOLD_EVERY_S, "{period_s} s: {told:?}");
            }
            // Two words, ten minutes: twenty, and what was told early while the patience grew.
            assert!(told.len() <= 28, "{period_s} s: {}", told.len());
            for code in [NOISY.code(), WELL.code()] {
                let of: Vec<_> = told.iter().filter(|e| e.kind.code() == code).collect();
                let bare = of.windows(2).filter(|w| w[1].times == 1);
                let soon = bare.filter(|w| w[1].time.seconds_since(w[0].time) < TOLD_EVERY_S).count();
                assert_eq!(soon, 0, "{period_s} s: twice a minute without a count: {of:?}");
            }
        }
    }

    #[test]
    fn what_waits_when_nothing_more_is_heard_is_told() {
        let mut log = EventLog::new();
        for (t, kind) in [(0.0, NOISY), (1.0, WELL), (2.0, NOISY)] {
            log.tell(at(t), kind);
        }
        log.drain().for_each(drop);
        log.close(at(3.0));
        let told: Vec<_> = log.drain().collect();
        assert_eq!((told.len(), told[0].kind, told[0].times), (1, NOISY, 2));
        log.tell(at(3.5), NOISY);
        log.close(at(4.0));
        assert!(log.is_empty(), "it is what was told last");
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
