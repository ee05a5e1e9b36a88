//! Stamps that do not belong to the clock that is followed: what has to come together before they are a clock of their own.
//!
//! Four stamps in a burst are no reboot. An autopilot that has rebooted sends frame after frame, numbered one after the other, of several kinds, whose
//! stamps pass as time does and began after the last stamp of before; and of the old clock nothing comes any more. The last is what no
//! burst can bring about: any stamp of the clock that is followed ends the suspicion.

use super::pace::ArrivalPace;
use crate::time::{Companion, Span, Stamp};
use crate::wire::messages::{Meaning, meaning_of};

/// How a frame came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// When, on its receiver's clock; `None` where nobody has noted it.
    pub at: Option<Stamp<Companion>>,
    /// The sender's running number of it.
    pub sequence: u8,
    /// Which message it is.
    pub message_id: u32,
}

/// Stamps in a row that have to agree on a hole that their arrival explains.
const AFTER_A_HOLE: u32 = 4;
/// How closely stamps that follow each other have to agree.
const AGREE_US: i64 = 1_500_000;
/// Frames, and the time they come over, before they are another clock.
const FRAMES: u32 = 4;
const LASTS: Span = Span::from_millis(500);
/// Where the IMU or SYSTEM_TIME is missing, two kinds of frames have to come for this long …
const TWO_KINDS: Span = Span::from_millis(3000);
/// … and whatever comes, and whatever its stamps, is believed after this.
const ALONE: Span = Span::from_millis(10_000);
/// Time passes by stamps as it does by arrival to within this factor; in a simulation by this.
const AS_TIME_DOES: f64 = 2.0;
const SIMULATED: f64 = 4.0;
/// Frames are numbered in a row if no more than this are missing between two.
const MISSING: u8 = 64;

/// A stamp and how it came.
#[derive(Clone, Copy, Debug)]
pub(super) struct Suspect {
    pub(super) boot_us: i64,
    pub(super) arrival: Option<Arrival>,
}

impl Suspect {
    fn at(&self) -> Option<Stamp<Companion>> {
        self.arrival.and_then(|a| a.at)
    }

    /// Time between two, by arrival.
    fn since(&self, earlier: &Self) -> Option<Span> {
        self.at().zip(earlier.at()).map(|(a, b)| a - b)
    }
}

/// What is claimed by a jump.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Claim {
    /// A hole in the stream that the arrival explains, or of which no arrival is known.
    Hole,
    /// Another time.
    Jump,
    /// A reboot; for how long there has been no stamp of the clock before, where that is known.
    Reboot(Option<Span>),
}

/// Stamps that agree with each other.
#[derive(Clone, Copy, Debug)]
struct Rival {
    first: Suspect,
    newest: Suspect,
    frames: u32,
    in_order: u32,
    inertial: bool,
    date: bool,
    other: bool,
}

impl Rival {
    fn new(s: Suspect) -> Self {
        let (inertial, date, other) = (false, false, false);
        let mut rival = Self { first: s, newest: s, frames: 1, in_order: 1, inertial, date, other };
        rival.note_kind(&s);
        rival
    }

    fn note_kind(&mut self, s: &Suspect) {
        match s.arrival.and_then(|a| meaning_of(a.message_id)) {
            Some(Meaning::Inertial) => self.inertial = true,
            Some(Meaning::Date) => self.date = true,
            _ => self.other = true,
        }
    }

    fn agrees(&self, s: &Suspect, pace: &ArrivalPace) -> bool {
        let passed = s.since(&self.newest).map_or(0, |span| (span.micros() as f64 * pace.rate()) as i64);
        let most_us = (AGREE_US as f64 * pace.rate()) as i64;
        s.boot_us.saturating_sub(self.newest.boot_us).saturating_sub(passed).abs() <= most_us
    }

    fn hear(&mut self, s: Suspect) {
        if let Some((now, last)) = s.arrival.zip(self.newest.arrival) {
            let next = now.sequence.wrapping_sub(last.sequence);
            self.in_order += u32::from((1..=MISSING).contains(&next));
        }
        self.frames += 1;
        self.note_kind(&s);
        self.newest = s;
    }

    fn is_believed(&self, claim: Claim, pace: &ArrivalPace) -> bool {
        if claim == Claim::Hole {
            return self.frames >= AFTER_A_HOLE;
        }
        let own = Span::from_micros(self.newest.boot_us.saturating_sub(self.first.boot_us));
        let Some(lasted) = self.newest.since(&self.first) else {
            // Of a log without arrival nothing but the stamps' own time is known. The autopilot's own log is nobody else's.
            return self.frames >= FRAMES && (own >= LASTS || self.newest.arrival.is_none());
        };
        let ratio = own.seconds() / (lasted.seconds() * pace.rate()).max(1e-6);
        let within = if pace.is_simulated() { SIMULATED } else { AS_TIME_DOES };
        let runs = lasted >= LASTS && (1.0 / within..=within).contains(&ratio);
        let numbered = self.in_order * 4 >= self.frames * 3;
        runs && numbered
            && self.frames >= FRAMES
            && (lasted >= ALONE || (self.kinds_agree(lasted) && self.began_after(claim, pace)))
    }

    /// The IMU and SYSTEM_TIME agree; or whatever two kinds, for longer.
    fn kinds_agree(&self, lasted: Span) -> bool {
        let kinds = [self.inertial, self.date, self.other].iter().filter(|k| **k).count();
        (self.inertial && self.date) || (kinds >= 2 && lasted >= TWO_KINDS)
    }

    /// Whoever has rebooted did so after the last stamp of before. How fast a simulation ran meanwhile is not known.
    fn began_after(&self, claim: Claim, pace: &ArrivalPace) -> bool {
        match claim {
            Claim::Reboot(Some(silent)) if !pace.is_simulated() => {
                self.newest.boot_us <= silent.micros().saturating_add(AGREE_US)
            }
            _ => true,
        }
    }
}

/// The suspicions: more than one, so that who stirs up another does not take away what was seen of the first.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Rivals([Option<Rival>; 3]);

impl Rivals {
    /// The clock that is followed was heard.
    pub(super) fn clear(&mut self) {
        self.0 = [None; 3];
    }

    /// A stamp that does not belong to the clock that is followed; if it is believed now, the first of those that it agrees with, microseconds
    /// since boot.
    pub(super) fn hear(&mut self, s: Suspect, claim: Claim, pace: &ArrivalPace) -> Option<i64> {
        if let Some(rival) = self.0.iter_mut().flatten().find(|r| r.agrees(&s, pace)) {
            rival.hear(s);
            return rival.is_believed(claim, pace).then_some(rival.first.boot_us);
        }
        // The one that has been silent for longest is the least of them.
        let age = |r: &Option<Rival>| r.map(|r| (r.newest.at(), r.frames));
        if let Some(slot) = self.0.iter_mut().min_by_key(|r| age(r)) {
            *slot = Some(Rival::new(s));
        }
        None
    }
}
