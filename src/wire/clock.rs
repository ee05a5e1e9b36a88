//! The autopilot's clock: every stamp that arrives, in whatever form, on one axis that never runs backwards.
//!
//! Autopilots stamp with milliseconds since boot (32 bits, wrapping after 49.7 days), microseconds since boot, microseconds since
//! 1970, and ArduPilot's OPTICAL_FLOW with *milliseconds* in a field called `time_usec`. A frame that is old, damaged or hostile
//! must not move the axis; a reboot must. So a jump is believed only when `CONFIRM` stamps in a row agree on it.

use crate::time::{AutopilotTime, ClockEvent, Span};

use super::counters::Cause;

/// How far a stamp may lie behind the newest one and still be a late sample (GNSS and pressure are up to 0.4 s late).
const LATE: Span = Span::from_millis(2000);
/// How far a stamp may lie ahead of the newest one without being confirmed.
const AHEAD: Span = Span::from_millis(2000);
/// Stamps in a row that have to agree before the axis jumps.
const CONFIRM: u32 = 4;
/// How closely the stamps of a jump have to agree with each other.
const AGREE: Span = Span::from_millis(1500);
/// Time put between the last stamp before a reboot and the first after it.
const REBOOT_GAP: Span = Span::from_millis(1000);
/// Microsecond stamps beyond this (2001-09-09) are counted from 1970.
const UNIX_EPOCH_US: i64 = 1_000_000_000_000_000;
/// Ten years of uptime: beyond it a stamp is no time since boot.
const LONGEST_UPTIME_US: i64 = 10 * 366 * 86_400 * 1_000_000;
/// Milliseconds of 32 bits begin anew after so many, 49.7 days.
const WRAP_MS: i64 = 1 << 32;
const WRAP_US: i64 = WRAP_MS * 1000;

/// Maps the stamps of one autopilot onto [`AutopilotTime`].
#[derive(Clone, Debug, Default)]
pub struct AutopilotClock {
    /// Axis = boot time + `base`.
    base_us: i64,
    newest: Option<AutopilotTime>,
    newest_boot_us: i64,
    unix_minus_boot_us: Option<i64>,
    suspect: Option<(i64, u32)>,
    event: Option<ClockEvent>,
    reboots: u32,
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

    /// A stamp of microseconds tells how often those of milliseconds have wrapped before they were first heard.
    fn count_wraps(&mut self, us: i64) {
        let wraps = (us - self.newest_boot_us + WRAP_US / 2).div_euclid(WRAP_US);
        if self.newest.is_some() && wraps > 0 && self.near(us - wraps * WRAP_US) {
            self.newest_boot_us += wraps * WRAP_US;
            self.base_us -= wraps * WRAP_US;
            self.unix_minus_boot_us = self.unix_minus_boot_us.map(|offset| offset - wraps * WRAP_US);
        }
    }

    /// A stamp of microseconds: since boot, since 1970, or (ArduPilot's OPTICAL_FLOW) in truth milliseconds since boot.
    ///
    /// # Errors
    /// As [`Self::boot_ms`]; also for a stamp since 1970 before SYSTEM_TIME has told what that means.
    pub fn usec(&mut self, us: u64) -> Result<AutopilotTime, Cause> {
        let us = i64::try_from(us).map_err(|_| Cause::Absurd)?;
        if us >= UNIX_EPOCH_US {
            let offset = self.unix_minus_boot_us.ok_or(Cause::Stale)?;
            return self.accept(us - offset);
        }
        if let Some(us) = self.in_truth_ms(us) {
            return self.accept(us);
        }
        self.count_wraps(us);
        self.accept(us)
    }

    /// A stamp of microseconds that another component has put on this clock: since boot or since 1970. It is believed where it is near
    /// the newest time, and never moves the clock.
    ///
    /// # Errors
    /// [`Cause::Stale`] when it is on another clock, or too old.
    pub fn foreign_usec(&self, us: u64) -> Result<AutopilotTime, Cause> {
        let us = i64::try_from(us).map_err(|_| Cause::Absurd)?;
        let offset = if us >= UNIX_EPOCH_US { self.unix_minus_boot_us.ok_or(Cause::Stale)? } else { 0 };
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
    pub fn system_time(&mut self, unix_us: u64, boot_ms: u32) {
        if let Ok(unix) = i64::try_from(unix_us)
            && unix >= UNIX_EPOCH_US
        {
            self.unix_minus_boot_us = Some(unix - self.unwrapped(boot_ms) * 1000);
        }
    }

    /// Seconds since 1970 of an axis time, if SYSTEM_TIME has told it.
    pub fn unix_seconds(&self, time: AutopilotTime) -> Option<f64> {
        self.unix_minus_boot_us.map(|o| self.boot_micros(time).saturating_add(o) as f64 * 1e-6)
    }

    fn near(&self, boot_us: i64) -> bool {
        let off = Span::from_micros(boot_us - self.newest_boot_us);
        -LATE.micros() <= off.micros() && off <= AHEAD
    }

    fn accept(&mut self, boot_us: i64) -> Result<AutopilotTime, Cause> {
        if !(0..=LONGEST_UPTIME_US).contains(&boot_us) {
            return Err(Cause::Absurd);
        }
        let time = AutopilotTime::from_micros(boot_us.saturating_add(self.base_us));
        let Some(newest) = self.newest else {
            self.newest = Some(time);
            self.newest_boot_us = boot_us;
            return Ok(time);
        };
        if self.near(boot_us) {
            self.suspect = None;
            if time > newest {
                self.newest = Some(time);
                self.newest_boot_us = boot_us;
            }
            return Ok(time);
        }
        let agreed = match self.suspect {
            Some((at, n)) if (boot_us - at).abs() <= AGREE.micros() => n + 1,
            _ => 1,
        };
        self.suspect = Some((boot_us, agreed));
        if agreed < CONFIRM {
            return Err(if boot_us < self.newest_boot_us { Cause::OutOfOrder } else { Cause::Stale });
        }
        self.suspect = None;
        if boot_us < self.newest_boot_us {
            let after = newest + REBOOT_GAP;
            self.base_us = after.micros().saturating_sub(boot_us);
            self.unix_minus_boot_us = None;
            self.reboots += 1;
            self.event = Some(ClockEvent::Reboot { before: newest, after });
        } else {
            self.event = Some(ClockEvent::Gap(Span::from_micros(boot_us - self.newest_boot_us)));
        }
        let time = AutopilotTime::from_micros(boot_us.saturating_add(self.base_us));
        self.newest = Some(time);
        self.newest_boot_us = boot_us;
        Ok(time)
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
        clock.system_time(1_790_000_021_885_000, 21_885);
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
        clock.system_time(1_790_000_021_885_000, 21_885);
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
        for ms in [1000, 1010, 1020, 1030, 1040] {
            after = clock.boot_ms(ms).ok().or(after);
        }
        assert!(after.unwrap() > before);
        assert!(matches!(clock.take_event(), Some(ClockEvent::Reboot { .. })));
        assert_eq!(clock.reboots(), 1);
        assert_eq!(clock.boot_micros(after.unwrap()), 1_040_000);
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
        clock.system_time(1_790_000_000_000_000, 10_000);
        assert_eq!(clock.unix_seconds(a), Some(1_790_000_000.0));
        assert_eq!(clock.usec(1_790_000_000_000_000), Ok(a));
        assert_eq!((clock.reboots(), clock.take_event()), (0, None));
    }

    #[test]
    fn wraps_before_the_first_stamp_are_found_out() {
        let mut clock = AutopilotClock::new();
        let a = clock.boot_ms(10_000).unwrap();
        let b = clock.usec(u64::try_from(3 * WRAP_US).unwrap() + 10_020_000).unwrap();
        assert_eq!(b - a, Span::from_millis(20));
        assert_eq!(clock.boot_ms(10_040).map(|c| c - b), Ok(Span::from_millis(20)));
        assert_eq!(clock.boot_micros(b), 3 * WRAP_US + 10_020_000);
        assert_eq!((clock.reboots(), clock.take_event()), (0, None));
    }

    #[test]
    fn a_year_that_cannot_be_is_no_overflow() {
        let mut clock = AutopilotClock::new();
        let a = clock.boot_ms(100_000).unwrap();
        clock.system_time(i64::MAX as u64, 0);
        assert!(clock.unix_seconds(a).is_some_and(f64::is_finite));
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
