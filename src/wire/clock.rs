//! The autopilot's clock: every stamp that arrives, in whatever form, on one axis that never runs backwards.
//!
//! Autopilots stamp with milliseconds since boot (32 bits, wrapping after 49.7 days), microseconds since boot, microseconds since
//! 1970, and ArduPilot's OPTICAL_FLOW with *milliseconds* in a field called `time_usec`. A frame that is old, damaged or hostile
//! must not move the axis; a reboot must. So a stamp is taken where it is near the newest and its arrival explains it (`pace`), and a jump is
//! believed only once frames that come after each other, of several kinds, agree on it while the clock before is silent (`rival`). Where the
//! arrival is known, the axis goes on over a reboot by the time that has passed.

mod date;
mod pace;
mod rival;

use crate::time::{AutopilotTime, ClockEvent, Span};

use super::counters::Cause;
use date::{Date, UNIX_EPOCH_US};
use pace::ArrivalPace;
pub use rival::Arrival;
use rival::{Claim, Rivals, Suspect};

/// How far a stamp may lie behind the newest one and still be a late sample (GNSS and pressure are up to 0.4 s late).
const LATE: Span = Span::from_millis(2000);
/// How far a stamp may lie ahead of the newest one without being confirmed.
const AHEAD: Span = Span::from_millis(2000);
/// Time put between the last stamp before a reboot and the first after it, where nobody knows it; and the least.
const REBOOT_GAP: Span = Span::from_millis(1000);
/// Ten years of uptime: beyond it a stamp is no time since boot.
const LONGEST_UPTIME_US: i64 = 10 * 366 * 86_400 * 1_000_000;
/// Milliseconds of 32 bits begin anew after so many, 49.7 days.
const WRAP_MS: i64 = 1 << 32;
const WRAP_US: i64 = WRAP_MS * 1000;
/// Stamps of microseconds that have to agree on how often those of milliseconds have wrapped, and the time that they come over.
const WRAPS_AGREE: u32 = 4;
const WRAPS_OVER_US: i64 = 500_000;

/// Maps the stamps of one autopilot onto [`AutopilotTime`].
#[derive(Clone, Debug, Default)]
pub struct AutopilotClock {
    /// Axis = boot time + `base`.
    base_us: i64,
    newest: Option<AutopilotTime>,
    newest_boot_us: i64,
    /// Where the last jump led to.
    jumped_to_us: i64,
    date: Date,
    /// How the frame came that is read.
    arrival: Option<Arrival>,
    pace: ArrivalPace,
    rivals: Rivals,
    wraps: Wraps,
    event: Option<ClockEvent>,
    reboots: u32,
}

/// How often the milliseconds have wrapped before they were first heard, as stamps of microseconds tell it.
#[derive(Clone, Copy, Debug, Default)]
struct Wraps {
    /// So often, said so many stamps in a row; the first of them.
    told: i64,
    agreed: u32,
    first_us: i64,
}

impl AutopilotClock {
    /// A clock that has heard nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// The newest time heard, for messages that carry none.
    pub fn newest(&self) -> Option<AutopilotTime> {
        self.newest
    }

    /// Reboots seen so far.
    pub fn reboots(&self) -> u32 {
        self.reboots
    }

    /// The event that the last stamp caused, once.
    pub fn take_event(&mut self) -> Option<ClockEvent> {
        self.event.take()
    }

    /// The stamps that are read next stand in a frame that came so.
    pub fn arrives(&mut self, arrival: Arrival) {
        self.arrival = Some(arrival);
    }

    /// What the autopilot itself would call `time` now: microseconds since its last boot.
    pub fn boot_micros(&self, time: AutopilotTime) -> i64 {
        time.micros().saturating_sub(self.base_us)
    }

    /// A stamp of milliseconds since boot.
    ///
    /// # Errors
    /// [`Cause::Stale`] or [`Cause::OutOfOrder`] when it is far from the newest and not (yet) confirmed as a jump.
    pub fn boot_ms(&mut self, ms: u32) -> Result<AutopilotTime, Cause> {
        self.accept(self.unwrapped(ms) * 1000)
    }

    /// Milliseconds since boot of a stamp of 32 bits, unwrapped towards the newest: 49.7 days of uptime are rare, an axis that jumps back
    /// by them is a crash.
    fn unwrapped(&self, ms: u32) -> i64 {
        let (ms, newest_ms) = (i64::from(ms), self.newest_boot_us / 1000);
        if self.newest.is_none() {
            return ms;
        }
        ms + (newest_ms - ms + WRAP_MS / 2).div_euclid(WRAP_MS) * WRAP_MS
    }

    /// Microseconds since boot of a stamp that is milliseconds since boot in truth, if it is one.
    fn in_truth_ms(&self, stamp: i64) -> Option<i64> {
        let us = self.unwrapped(u32::try_from(stamp).ok()?) * 1000;
        (self.newest.is_some() && !self.near(stamp) && self.near(us)).then_some(us)
    }

    /// The wraps by which a stamp of microseconds, else near the newest, is ahead of it.
    fn wraps_ahead(&self, us: i64) -> i64 {
        let wraps = us.saturating_sub(self.newest_boot_us).saturating_add(WRAP_US / 2).div_euclid(WRAP_US);
        let ahead = self.newest.is_some() && wraps > 0 && self.near(us - wraps * WRAP_US);
        if ahead { wraps } else { 0 }
    }

    /// A stamp of microseconds tells how often those of milliseconds have wrapped before they were first heard. It is of the present either way;
    /// what the autopilot itself calls the present changes when several stamps agree.
    fn count_wraps(&mut self, us: i64) -> i64 {
        let told = self.wraps_ahead(us);
        let w = &mut self.wraps;
        if told == 0 || told != w.told {
            *w = Wraps { told, agreed: 0, first_us: us };
        }
        w.agreed += 1;
        if told == 0 || w.agreed < WRAPS_AGREE || us - w.first_us < WRAPS_OVER_US {
            return us - told * WRAP_US;
        }
        self.wraps = Wraps::default();
        self.newest_boot_us += told * WRAP_US;
        self.base_us -= told * WRAP_US;
        self.pace.shift(told * WRAP_US);
        self.date.shift(told * WRAP_US);
        us
    }

    /// A stamp of microseconds: since boot, since 1970, or (ArduPilot's OPTICAL_FLOW) in truth milliseconds since boot.
    ///
    /// # Errors
    /// As [`Self::boot_ms`]; also for a stamp since 1970 before SYSTEM_TIME has told what that means.
    pub fn usec(&mut self, us: u64) -> Result<AutopilotTime, Cause> {
        let us = i64::try_from(us).map_err(|_| Cause::Absurd)?;
        if us >= UNIX_EPOCH_US {
            let offset = self.date.offset_us().ok_or(Cause::Stale)?;
            return self.accept(us - offset);
        }
        if let Some(us) = self.in_truth_ms(us) {
            return self.accept(us);
        }
        let us = self.count_wraps(us);
        self.accept(us)
    }

    /// A stamp of microseconds that another component has put on this clock: since boot or since 1970. It is believed where it is near
    /// the newest time, and never moves the clock.
    ///
    /// # Errors
    /// [`Cause::Stale`] when it is on another clock, or too old.
    pub fn foreign_usec(&self, us: u64) -> Result<AutopilotTime, Cause> {
        let us = i64::try_from(us).map_err(|_| Cause::Absurd)?;
        let offset = if us >= UNIX_EPOCH_US { self.date.offset_us().ok_or(Cause::Stale)? } else { 0 };
        let boot_us = self.in_truth_ms(us).unwrap_or(us - offset);
        let near = self.newest.is_some() && self.near(boot_us);
        near.then(|| AutopilotTime::from_micros(boot_us.saturating_add(self.base_us))).ok_or(Cause::Stale)
    }

    /// A stamp of milliseconds since boot that another component has put on this clock; as [`Self::foreign_usec`].
    ///
    /// # Errors
    /// As [`Self::foreign_usec`].
    pub fn foreign_ms(&self, ms: u32) -> Result<AutopilotTime, Cause> {
        self.foreign_usec(u64::try_from(self.unwrapped(ms) * 1000).map_err(|_| Cause::Absurd)?)
    }

    /// SYSTEM_TIME: what 1970 means on this clock. Zero (not known) changes nothing.
    ///
    /// # Errors
    /// [`Cause::Absurd`] for a time that no clock shows, [`Cause::Unconfirmed`] for another than before.
    pub fn system_time(&mut self, unix_us: u64, boot_ms: u32) -> Result<(), Cause> {
        let boot_us = self.unwrapped(boot_ms) * 1000;
        self.date.hear(unix_us, boot_us)
    }

    /// Seconds since 1970 of an axis time, if SYSTEM_TIME has told it.
    pub fn unix_seconds(&self, time: AutopilotTime) -> Option<f64> {
        self.date.offset_us().map(|o| self.boot_micros(time).saturating_add(o) as f64 * 1e-6)
    }

    /// A stamp of microseconds that was refused before the jump that has just been believed: those that confirmed it are of the time after it. It
    /// never moves the clock.
    ///
    /// # Errors
    /// [`Cause::Stale`] when it does not belong to where the clock is now.
    pub fn confirmed_usec(&self, us: u64) -> Result<AutopilotTime, Cause> {
        let us = i64::try_from(us).map_err(|_| Cause::Absurd)?;
        let latest_us = self.newest_boot_us.saturating_add(AHEAD.micros());
        let belongs = self.near(us) || (self.jumped_to_us..=latest_us).contains(&us);
        belongs.then(|| AutopilotTime::from_micros(us.saturating_add(self.base_us))).ok_or(Cause::Stale)
    }

    fn near(&self, boot_us: i64) -> bool {
        let off = Span::from_micros(boot_us.saturating_sub(self.newest_boot_us));
        -LATE.micros() <= off.micros() && off <= AHEAD
    }

    fn accept(&mut self, boot_us: i64) -> Result<AutopilotTime, Cause> {
        if !(0..=LONGEST_UPTIME_US).contains(&boot_us) {
            return Err(Cause::Absurd);
        }
        let at = self.arrival.and_then(|a| a.at);
        let time = AutopilotTime::from_micros(boot_us.saturating_add(self.base_us));
        let Some(newest) = self.newest else {
            self.newest = Some(time);
            self.newest_boot_us = boot_us;
            self.pace.note(at, boot_us);
            return Ok(time);
        };
        let explained = boot_us <= self.newest_boot_us || self.pace.explains(at, boot_us);
        if self.near(boot_us) && explained {
            self.rivals.clear();
            if time > newest {
                self.newest = Some(time);
                self.newest_boot_us = boot_us;
                self.pace.note(at, boot_us);
            }
            return Ok(time);
        }
        let back = boot_us < self.newest_boot_us;
        let silent = self.pace.since_newest(at);
        let claim = match (back, explained) {
            (true, _) => Claim::Reboot(silent),
            (false, true) => Claim::Hole,
            (false, false) => Claim::Jump,
        };
        let Some(first_us) = self.rivals.hear(Suspect { boot_us, arrival: self.arrival }, claim, &self.pace)
        else {
            return Err(if back { Cause::OutOfOrder } else { Cause::Stale });
        };
        // Where no arrival is known nothing has been passed on meanwhile: those that confirmed it are read behind it.
        let to_us = if self.arrival.is_none() { first_us.min(boot_us) } else { boot_us };
        Ok(self.jump(newest, to_us, boot_us, silent))
    }

    /// Stamps that go on from `to_us` to `boot_us` are believed; there was none since `newest`, for `silent`, where that is known.
    fn jump(
        &mut self,
        newest: AutopilotTime,
        to_us: i64,
        boot_us: i64,
        silent: Option<Span>,
    ) -> AutopilotTime {
        self.rivals.clear();
        self.jumped_to_us = to_us;
        if boot_us < self.newest_boot_us {
            let after = newest + silent.unwrap_or(REBOOT_GAP).max(REBOOT_GAP);
            self.base_us = after.micros().saturating_sub(to_us);
            (self.date, self.wraps) = (Date::default(), Wraps::default());
            self.reboots += 1;
            self.event = Some(ClockEvent::Reboot { before: newest, after, known: silent.is_some() });
        } else {
            self.event = Some(ClockEvent::Gap(Span::from_micros(to_us.saturating_sub(self.newest_boot_us))));
        }
        let time = AutopilotTime::from_micros(boot_us.saturating_add(self.base_us));
        self.newest = Some(time);
        self.newest_boot_us = boot_us;
        self.pace.restart(self.arrival.and_then(|a| a.at), boot_us);
        time
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn milliseconds_microseconds_and_1970_meet_on_one_axis() {
        let mut clock = AutopilotClock::new();
        let a = clock.boot_ms(21_885).unwrap();
        assert_eq!(clock.usec(21_885_000).unwrap(), a);
        clock.system_time(1_790_000_021_885_000, 21_885).unwrap();
        assert_eq!(clock.usec(1_790_000_021_885_000).unwrap(), a);
        assert_eq!(clock.unix_seconds(a), Some(1_790_000_021.885));
    }

    #[test]
    fn ardupilots_flow_stamp_in_milliseconds_is_found_out() {
        let mut clock = AutopilotClock::new();
        let a = clock.usec(21_880_000).unwrap();
        assert_eq!(clock.usec(21_885).unwrap() - a, Span::from_millis(5));
    }

    #[test]
    fn another_components_stamp_is_read_and_moves_nothing() {
        let mut clock = AutopilotClock::new();
        assert_eq!(clock.foreign_usec(21_885_000), Err(Cause::Stale));
        let a = clock.boot_ms(21_885).unwrap();
        assert_eq!(clock.foreign_usec(21_875_000).map(|t| a - t), Ok(Span::from_millis(10)));
        assert_eq!(clock.foreign_usec(1_790_000_021_885_000), Err(Cause::Stale));
        clock.system_time(1_790_000_021_885_000, 21_885).unwrap();
        assert_eq!(clock.foreign_usec(1_790_000_021_885_000), Ok(a));
        (0..10).for_each(|_| assert_eq!(clock.foreign_usec(900_000_000), Err(Cause::Stale)));
        assert_eq!((clock.newest(), clock.reboots(), clock.take_event()), (Some(a), 0, None));
    }

    #[test]
    fn one_wild_stamp_does_not_move_the_axis() {
        let mut clock = AutopilotClock::new();
        clock.boot_ms(100_000).unwrap();
        assert_eq!(clock.boot_ms(4_000_000), Err(Cause::Stale));
        assert_eq!(clock.boot_ms(5), Err(Cause::OutOfOrder));
        assert_eq!(clock.boot_ms(100_020).unwrap(), AutopilotTime::from_micros(100_020_000));
        assert_eq!(clock.take_event(), None);
    }

    #[test]
    fn a_reboot_goes_on_along_the_axis() {
        let mut clock = AutopilotClock::new();
        let before = clock.boot_ms(100_000).unwrap();
        let mut after = None;
        for ms in (1000..=1600).step_by(10) {
            after = clock.boot_ms(ms).ok().or(after);
        }
        assert!(after.unwrap() > before);
        assert!(matches!(clock.take_event(), Some(ClockEvent::Reboot { known: false, .. })));
        assert_eq!(clock.reboots(), 1);
        assert_eq!(clock.boot_micros(after.unwrap()), 1_600_000);
    }

    #[test]
    fn thirty_two_bits_of_milliseconds_wrap() {
        let mut clock = AutopilotClock::new();
        let a = clock.boot_ms(u32::MAX - 10).unwrap();
        let b = clock.boot_ms(9).unwrap();
        assert_eq!(b - a, Span::from_millis(20));
        assert_eq!(clock.reboots(), 0);
    }

    #[test]
    fn every_stamp_of_milliseconds_is_unwrapped() {
        // 49.7 days and 10 s after boot.
        let late_us = u64::try_from(WRAP_US).unwrap() + 10_000_000;
        let mut clock = AutopilotClock::new();
        let a = clock.usec(late_us).unwrap();
        assert_eq!(clock.boot_ms(10_000), Ok(a));
        // ArduPilot's OPTICAL_FLOW, of the autopilot and of another component.
        assert_eq!(clock.usec(10_005).map(|t| t - a), Ok(Span::from_millis(5)));
        assert_eq!(clock.foreign_usec(10_002).map(|t| t - a), Ok(Span::from_millis(2)));
        clock.system_time(1_790_000_000_000_000, 10_000).unwrap();
        assert_eq!(clock.unix_seconds(a), Some(1_790_000_000.0));
        assert_eq!(clock.usec(1_790_000_000_000_000), Ok(a));
        assert_eq!((clock.reboots(), clock.take_event()), (0, None));
    }

    #[test]
    fn wraps_before_the_first_stamp_are_found_out() {
        let mut clock = AutopilotClock::new();
        let a = clock.boot_ms(10_000).unwrap();
        let late_us = u64::try_from(3 * WRAP_US).unwrap() + 10_000_000;
        let b = clock.usec(late_us + 20_000).unwrap();
        assert_eq!(b - a, Span::from_millis(20));
        assert_eq!(clock.boot_micros(b), 10_020_000, "one stamp is no proof");
        for ms in (40..600).step_by(20) {
            let c = clock.usec(late_us + ms * 1000).unwrap();
            assert_eq!(c - a, Span::from_millis(ms as i64));
        }
        assert_eq!(clock.boot_ms(10_620).map(|c| c - b), Ok(Span::from_millis(600)));
        assert_eq!(clock.boot_micros(b), 3 * WRAP_US + 10_020_000);
        assert_eq!((clock.reboots(), clock.take_event()), (0, None));
    }

    #[test]
    fn a_year_that_cannot_be_is_no_overflow() {
        let mut clock = AutopilotClock::new();
        let a = clock.boot_ms(100_000).unwrap();
        assert_eq!(clock.system_time(i64::MAX as u64, 0), Err(Cause::Absurd));
        assert_eq!(clock.unix_seconds(a), None);
        assert!(clock.system_time(4_102_444_799_000_000, 0).is_ok());
        assert!(clock.unix_seconds(a).is_some_and(f64::is_finite));
    }

    const IMU: u32 = 105;
    const SYSTEM_TIME: u32 = 2;
    const PRESSURE: u32 = 29;

    /// A clock that is heard over a link, by the receiver's clock.
    struct Heard {
        clock: AutopilotClock,
        sequence: u8,
        reboots: u32,
    }

    impl Heard {
        /// An autopilot that has been heard from 0 to `ms`; it had run for 100 s before.
        fn until(ms: i64) -> Self {
            let mut heard = Self { clock: AutopilotClock::new(), sequence: 0, reboots: 0 };
            (0..ms).step_by(10).for_each(|ms| heard.autopilot(ms));
            assert!(heard.clock.take_event().is_none());
            heard
        }

        /// A frame that comes at `at_ms` with a stamp of `boot_ms`.
        fn frame(&mut self, at_ms: i64, message_id: u32, boot_ms: i64) -> Result<AutopilotTime, Cause> {
            self.sequence = self.sequence.wrapping_add(1);
            let at = Some(crate::time::Stamp::from_micros(at_ms * 1000));
            self.clock.arrives(Arrival { at, sequence: self.sequence, message_id });
            let stamp = self.clock.usec(u64::try_from(boot_ms * 1000).unwrap());
            self.reboots += u32::from(matches!(self.clock.take_event(), Some(ClockEvent::Reboot { .. })));
            stamp
        }

        /// What comes at `at_ms` of an autopilot that has been up for `up_ms`: the IMU at 100 Hz, pressure at 5 Hz, SYSTEM_TIME every second.
        fn sends(&mut self, at_ms: i64, up_ms: i64) -> [bool; 3] {
            let mut sends = |every: i64, id| at_ms % every == 0 && self.frame(at_ms, id, up_ms).is_ok();
            [sends(10, IMU), sends(200, PRESSURE), sends(1000, SYSTEM_TIME)]
        }

        fn autopilot(&mut self, at_ms: i64) {
            assert!(self.sends(at_ms, 100_000 + at_ms)[0], "refused at {at_ms} ms");
        }
    }

    #[test]
    fn a_burst_of_stamps_is_no_reboot() {
        let mut heard = Heard::until(20_000);
        for ms in (20_000..30_000).step_by(10) {
            heard.autopilot(ms);
            // As many as there may be, of several kinds, between two frames of the autopilot.
            for n in 0..20 {
                assert!(heard.frame(ms, IMU, 500 + n * 30).is_err());
                assert!(heard.frame(ms, SYSTEM_TIME, 510 + n * 30).is_err());
                assert!(heard.frame(ms, IMU, 900_000 + n * 30).is_err());
            }
        }
        // And when the link is silent, too.
        for n in 0..200 {
            let _ = heard.frame(35_000, IMU, 500 + n * 10);
            let _ = heard.frame(35_001, SYSTEM_TIME, 505 + n * 10);
        }
        let first = (36_000..40_000).step_by(10).find(|&ms| heard.sends(ms, 100_000 + ms)[0]);
        assert_eq!((first, heard.reboots), (Some(36_010), 0));
    }

    #[test]
    fn stamps_of_the_future_do_not_carry_the_clock_away() {
        let mut heard = Heard::until(20_000);
        for ms in (20_000..30_000).step_by(10) {
            heard.autopilot(ms);
            for ahead in [600, 900, 1900, 2500] {
                assert_eq!(heard.frame(ms, IMU, 100_000 + ms + ahead), Err(Cause::Stale), "{ahead}");
            }
        }
        // Step by step they get nowhere, either.
        for n in 1..200 {
            let _ = heard.frame(30_000, IMU, 130_000 + n * 250);
        }
        let newest = heard.clock.newest().map(|t| t.micros());
        assert!(newest.is_some_and(|us| us <= 130_700_000), "{newest:?}");
        (30_010..31_000).step_by(10).for_each(|ms| heard.autopilot(ms));
        assert_eq!((heard.reboots, heard.clock.take_event()), (0, None));
    }

    #[test]
    fn stamps_that_are_late_are_no_reboot() {
        let mut heard = Heard::until(20_000);
        for ms in (20_000..80_000).step_by(10) {
            assert!(heard.frame(ms, IMU, 95_000 + ms).is_err());
            if ms % 200 == 0 {
                assert!(heard.frame(ms, PRESSURE, 100_000 + ms).is_ok());
            }
        }
        assert_eq!(heard.reboots, 0);
        // Nor if there is nothing but them: the autopilot was up before the last stamp of before.
        (80_000..88_000).step_by(10).for_each(|ms| {
            heard.sends(ms, 95_000 + ms);
        });
        assert_eq!(heard.reboots, 0);
    }

    #[test]
    fn two_clocks_on_one_link_are_told_apart_for_good() {
        let mut heard = Heard::until(20_000);
        for ms in (20_000..80_000).step_by(10) {
            heard.autopilot(ms);
            assert_eq!(heard.sends(ms, 7000 + ms), [false; 3]);
        }
        assert_eq!(heard.reboots, 0);
    }

    #[test]
    fn a_reboot_is_believed_within_a_second_and_lasts_as_long_as_it_did() {
        let mut heard = Heard::until(20_000);
        let before = heard.clock.newest().unwrap();
        // It is silent for 6.5 s, and up for 2.5 when it is heard again.
        let up = |ms: i64| ms - 24_000;
        let believed = (26_500..30_000).step_by(10).find(|&ms| heard.sends(ms, up(ms))[0]).unwrap();
        assert!((27_000..27_500).contains(&believed), "{believed}");
        assert_eq!((heard.reboots, heard.clock.reboots()), (1, 1));
        let after = heard.clock.newest().unwrap();
        let gap_s = after.seconds_since(before);
        assert!((gap_s - (believed - 19_990) as f64 * 1e-3).abs() < 0.01, "{gap_s}");
        assert_eq!(heard.clock.boot_micros(after), up(believed) * 1000);
        // What comes of the boot before is late, and nothing else.
        for ms in (believed + 10..40_000).step_by(10) {
            assert!(heard.sends(ms, up(ms))[0]);
            let _ = heard.frame(ms, IMU, 120_000);
        }
        assert_eq!(heard.reboots, 1);
    }

    #[test]
    fn a_hole_is_a_hole_however_long() {
        let mut heard = Heard::until(20_000);
        let first = (500_000..501_000).step_by(10).find(|&ms| heard.sends(ms, 100_000 + ms)[0]);
        assert!(first.is_some_and(|ms| ms <= 500_030), "{first:?}");
        assert_eq!(heard.reboots, 0);
    }

    proptest! {
        #[test]
        fn the_axis_never_runs_backwards(stamps in proptest::collection::vec(any::<u64>(), 1..200)) {
            let mut clock = AutopilotClock::new();
            let mut newest = None;
            for s in stamps {
                let _ = clock.usec(s);
                let _ = clock.boot_ms(s as u32);
                prop_assert!(clock.newest() >= newest);
                newest = clock.newest();
            }
        }
    }
}
