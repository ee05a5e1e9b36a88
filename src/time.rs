//! Integer microsecond stamps on named clocks, and the past of what is stamped with them ([`Past`]).
//!
//! A [`Stamp`] belongs to one clock, and only `wire` knows how two clocks relate. Seconds as `f64` appear only as differences
//! ([`Stamp::seconds_since`]), so a day of flight loses no resolution.

mod past;

use std::fmt;
use std::marker::PhantomData;
use std::ops::{Add, Sub};

pub use past::{Past, Stamped};

/// A clock that stamps can be read on.
pub trait Clock: Copy + Eq + Ord + fmt::Debug {
    /// Name shown in messages.
    const NAME: &'static str;
}

/// The autopilot's clock, unwrapped: microseconds that never run backwards, across reboots of the autopilot too
/// (see `wire::clock`). Every sample and every solution is stamped on it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Hash)]
pub struct Autopilot;

/// The companion computer's monotonic clock. Only `wire` and `daemon` use it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Hash)]
pub struct Companion;

impl Clock for Autopilot {
    const NAME: &'static str = "autopilot";
}
impl Clock for Companion {
    const NAME: &'static str = "companion";
}

/// A point in time: microseconds on clock `C`.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Stamp<C: Clock> {
    us: i64,
    clock: PhantomData<C>,
}

/// A duration in microseconds; may be negative.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Hash, Default)]
pub struct Span(i64);

/// A stamp on the autopilot's clock.
pub type AutopilotTime = Stamp<Autopilot>;

/// What happened to the autopilot's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockEvent {
    /// The autopilot has rebooted: its stamps start anew. The axis of [`AutopilotTime`] goes on.
    Reboot {
        /// The last time before.
        before: AutopilotTime,
        /// The first time after.
        after: AutopilotTime,
        /// Whether the time between is known, by the arrival of both; else it is a second.
        known: bool,
    },
    /// The stream had a hole of this length.
    Gap(Span),
}

impl<C: Clock> Stamp<C> {
    /// The stamp `us` microseconds after the clock's zero.
    pub const fn from_micros(us: i64) -> Self {
        Self { us, clock: PhantomData }
    }

    /// Microseconds since the clock's zero.
    pub const fn micros(self) -> i64 {
        self.us
    }

    /// Seconds from `earlier` to `self`; negative when `self` is the earlier one.
    pub fn seconds_since(self, earlier: Self) -> f64 {
        (self - earlier).seconds()
    }
}

impl Span {
    /// No time at all.
    pub const ZERO: Span = Span(0);

    /// A span of whole microseconds.
    pub const fn from_micros(us: i64) -> Self {
        Span(us)
    }

    /// A span of whole milliseconds.
    pub const fn from_millis(ms: i64) -> Self {
        Span(ms.saturating_mul(1000))
    }

    /// The nearest microsecond to `s` seconds. A value that is not finite gives zero.
    pub fn from_seconds(s: f64) -> Self {
        Span((s * 1e6).round() as i64)
    }

    /// Whole microseconds.
    pub const fn micros(self) -> i64 {
        self.0
    }

    /// Seconds.
    pub fn seconds(self) -> f64 {
        self.0 as f64 * 1e-6
    }
}

impl<C: Clock> Sub for Stamp<C> {
    type Output = Span;
    fn sub(self, earlier: Self) -> Span {
        Span(self.us.saturating_sub(earlier.us))
    }
}

impl<C: Clock> Add<Span> for Stamp<C> {
    type Output = Self;
    fn add(self, span: Span) -> Self {
        Self::from_micros(self.us.saturating_add(span.0))
    }
}

impl<C: Clock> Sub<Span> for Stamp<C> {
    type Output = Self;
    fn sub(self, span: Span) -> Self {
        Self::from_micros(self.us.saturating_sub(span.0))
    }
}

impl<C: Clock> fmt::Debug for Stamp<C> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}us", C::NAME, self.us)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_keep_microseconds_after_a_year() {
        let year = Span::from_seconds(365.25 * 86400.0);
        let a = AutopilotTime::from_micros(7) + year;
        assert_eq!((a + Span::from_micros(1)) - a, Span::from_micros(1));
        assert!((a.seconds_since(AutopilotTime::from_micros(0)) - 31_557_600.000_007).abs() < 1e-6);
    }

    #[test]
    fn arithmetic_saturates_instead_of_wrapping() {
        let end = AutopilotTime::from_micros(i64::MAX);
        assert_eq!(end + Span::from_seconds(1.0), end);
        assert_eq!(
            AutopilotTime::from_micros(i64::MIN) - Span::from_micros(5),
            AutopilotTime::from_micros(i64::MIN)
        );
    }

    #[test]
    fn a_span_that_is_not_finite_is_zero() {
        assert_eq!(Span::from_seconds(f64::NAN), Span::ZERO);
    }
}
