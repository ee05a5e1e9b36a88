//! What 1970 means on the autopilot's clock, by SYSTEM_TIME.

use crate::wire::counters::Cause;

/// Microsecond stamps beyond this (2001-09-09) are counted from 1970.
pub(super) const UNIX_EPOCH_US: i64 = 1_000_000_000_000_000;
/// 2100-01-01: no autopilot flies later.
const LAST_US: i64 = 4_102_444_800_000_000;
/// A clock that is disciplined is shifted by less at a time, µs.
const SHIFT_US: i64 = 1_000_000;
/// Messages that have to agree on another time, and what they have to come over by the time since boot, µs.
const CONFIRM: u32 = 3;
const OVER_US: i64 = 1_500_000;

/// µs since 1970 less µs since boot.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Date {
    offset_us: Option<i64>,
    /// Another offset that was told, how often, and since when.
    suspect: Option<(i64, u32, i64)>,
}

impl Date {
    /// µs since 1970 less µs since boot, once it was told.
    pub(super) fn offset_us(&self) -> Option<i64> {
        self.offset_us
    }

    /// The clock has been running for so much longer, µs.
    pub(super) fn shift(&mut self, by_us: i64) {
        self.offset_us = self.offset_us.map(|offset| offset.saturating_sub(by_us));
        self.suspect = None;
    }

    /// SYSTEM_TIME. The first is believed, for nothing else is known; another only if several agree on it, and none on the one before.
    /// A time before 2001 is that of a clock which nobody has set, and tells nothing.
    pub(super) fn hear(&mut self, unix_us: u64, boot_us: i64) -> Result<(), Cause> {
        let unix = i64::try_from(unix_us).ok().filter(|us| *us < LAST_US).ok_or(Cause::Absurd)?;
        if unix < UNIX_EPOCH_US {
            return Ok(());
        }
        let told = unix.saturating_sub(boot_us);
        let near = |other: i64| (told.saturating_sub(other)).abs() <= SHIFT_US;
        if self.offset_us.is_none_or(near) {
            (self.offset_us, self.suspect) = (Some(told), None);
            return Ok(());
        }
        let (since, n) = match self.suspect {
            Some((offset, n, since)) if near(offset) => (since, n + 1),
            _ => (boot_us, 1),
        };
        self.suspect = Some((told, n, since));
        if n < CONFIRM || boot_us.saturating_sub(since) < OVER_US {
            return Err(Cause::Unconfirmed);
        }
        (self.offset_us, self.suspect) = (Some(told), None);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: u64 = 1_790_000_000_000_000;
    const SECOND: i64 = 1_000_000;

    fn told(date: &mut Date, hours_off: u64, at_s: i64) -> Result<(), Cause> {
        date.hear(NOW + hours_off * 3_600_000_000 + (at_s * SECOND) as u64, at_s * SECOND)
    }

    #[test]
    fn another_time_is_believed_when_several_messages_agree_on_it() {
        let mut date = Date::default();
        assert_eq!((told(&mut date, 0, 1), date.offset_us()), (Ok(()), Some(NOW as i64)));
        // One that is off, or several beside the right ones, change nothing.
        for s in 2..20 {
            assert_eq!(told(&mut date, 0, s), Ok(()));
            assert_eq!(told(&mut date, 7, s), Err(Cause::Unconfirmed));
            assert_eq!(told(&mut date, 7, s), Err(Cause::Unconfirmed));
        }
        assert_eq!(date.offset_us(), Some(NOW as i64));
        // A receiver's first fix sets the clock.
        let set: Vec<bool> = (20..24).map(|s| told(&mut date, 3, s).is_ok()).collect();
        assert_eq!(set, [false, false, true, true]);
        assert_eq!(date.offset_us(), Some(NOW as i64 + 3 * 3_600_000_000));
    }

    #[test]
    fn what_no_clock_shows_is_counted_and_one_that_was_never_set_tells_nothing() {
        let mut date = Date::default();
        for absurd in [u64::MAX, i64::MAX as u64, 5_000_000_000_000_000] {
            assert_eq!(date.hear(absurd, 0), Err(Cause::Absurd));
        }
        for unset in [0, 1, 900_000_000_000_000] {
            assert_eq!(date.hear(unset, 0), Ok(()));
        }
        assert_eq!(date.offset_us(), None);
    }
}
