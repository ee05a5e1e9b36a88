//! The autopilot's clock as its messages show it: whether another address goes on with it.
//!
//! A clock that runs since the autopilot's start is what a new peer cannot guess: who goes on with it within what has passed since has
//! heard the autopilot, or is it.

use mavlink::MessageData;
use mavlink::dialects::ardupilotmega as apm;

use crate::time::{Companion, Span, Stamp};
use crate::wire::frame::Frame;

/// Where a message has its stamp.
#[derive(Clone, Copy)]
enum Field {
    /// Microseconds, the first eight bytes.
    Micros,
    /// Milliseconds, four bytes from here on; they begin again every 49.7 days.
    Millis(usize),
}

/// Messages whose stamp is the time since the autopilot's start.
const STAMPED: [(u32, Field); 7] = [
    (apm::HIGHRES_IMU_DATA::ID, Field::Micros),
    (apm::RAW_IMU_DATA::ID, Field::Micros),
    (apm::SCALED_IMU_DATA::ID, Field::Millis(0)),
    (apm::SCALED_IMU2_DATA::ID, Field::Millis(0)),
    (apm::SCALED_IMU3_DATA::ID, Field::Millis(0)),
    (apm::ATTITUDE_DATA::ID, Field::Millis(0)),
    (apm::SYSTEM_TIME_DATA::ID, Field::Millis(8)),
];

/// How far a stamp may be from where the clock should be: delays of two ways through routers.
const TOLERANCE: Span = Span::from_millis(500);

/// The newest stamp of each kind of message, and when it came. Messages are compared with their like only: some autopilots stamp some of
/// them by another clock.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BootClock {
    newest: [Option<(u64, Stamp<Companion>)>; STAMPED.len()],
}

fn read(frame: &Frame<'_>) -> Option<(usize, u64)> {
    let kind = STAMPED.iter().position(|(id, _)| *id == frame.message_id())?;
    // MAVLink 2 cuts trailing zeros.
    let bytes = |from: usize, n: usize| {
        let sent = frame.payload().iter().skip(from).take(n);
        sent.enumerate().fold(0, |value, (i, &byte)| value | u64::from(byte) << (8 * i))
    };
    let stamp = match STAMPED.get(kind)?.1 {
        Field::Micros => bytes(0, 8),
        Field::Millis(from) => bytes(from, 4),
    };
    Some((kind, stamp))
}

impl BootClock {
    /// Takes note of a frame's stamp.
    pub(super) fn note(&mut self, frame: &Frame<'_>, at: Stamp<Companion>) {
        if let Some((kind, stamp)) = read(frame) {
            self.newest[kind] = Some((stamp, at));
        }
    }

    /// Whether a frame of somebody else goes on with this clock; `None` where that cannot be said.
    pub(super) fn goes_on(&self, frame: &Frame<'_>, at: Stamp<Companion>) -> Option<bool> {
        let (kind, stamp) = read(frame)?;
        let (before, heard) = self.newest[kind]?;
        let passed = match STAMPED.get(kind)?.1 {
            Field::Micros => stamp.wrapping_sub(before).cast_signed(),
            Field::Millis(_) => i64::from((stamp as u32).wrapping_sub(before as u32).cast_signed()) * 1000,
        };
        let off = passed.saturating_sub((at - heard).micros());
        Some(off.unsigned_abs() <= TOLERANCE.micros().unsigned_abs())
    }
}

#[cfg(test)]
mod tests {
    use mavlink::dialects::ardupilotmega::{MavMessage, RAW_IMU_DATA, SCALED_IMU_DATA, SYSTEM_TIME_DATA};

    use super::*;
    use crate::wire::frame_bytes::FrameBytes;
    use crate::wire::session::heartbeat_fields::testing::frame_of;

    fn at(ms: i64) -> Stamp<Companion> {
        Stamp::from_micros(ms * 1000)
    }

    fn raw(us: u64) -> FrameBytes {
        frame_of(1, 1, &MavMessage::RAW_IMU(RAW_IMU_DATA { time_usec: us, ..Default::default() }))
    }

    fn scaled(ms: u32) -> FrameBytes {
        frame_of(1, 1, &MavMessage::SCALED_IMU(SCALED_IMU_DATA { time_boot_ms: ms, ..Default::default() }))
    }

    #[test]
    fn the_same_clock_goes_on_and_another_does_not() {
        let mut clock = BootClock::default();
        let goes_on =
            |clock: &BootClock, bytes: FrameBytes, ms| clock.goes_on(&bytes.frame().unwrap(), at(ms));
        assert_eq!(goes_on(&clock, raw(5_000_000), 0), None);
        clock.note(&raw(5_000_000).frame().unwrap(), at(0));
        assert_eq!(goes_on(&clock, raw(5_700_000), 700), Some(true));
        assert_eq!(goes_on(&clock, raw(15_400_000), 10_000), Some(true));
        assert_eq!(goes_on(&clock, raw(5_100_000), 700), Some(false), "a repetition of what was heard");
        assert_eq!(goes_on(&clock, raw(1_000_000), 700), Some(false), "a reboot");
        assert_eq!(goes_on(&clock, raw(u64::MAX), 700), Some(false));
        assert_eq!(goes_on(&clock, scaled(5_700), 700), None, "another message");
    }

    #[test]
    fn milliseconds_may_begin_again() {
        let mut clock = BootClock::default();
        clock.note(&scaled(u32::MAX - 100).frame().unwrap(), at(0));
        assert_eq!(clock.goes_on(&scaled(899).frame().unwrap(), at(1000)), Some(true));
        assert_eq!(clock.goes_on(&scaled(5000).frame().unwrap(), at(1000)), Some(false));
    }

    #[test]
    fn the_stamp_behind_the_date_is_read() {
        let time = |ms| {
            frame_of(
                1,
                1,
                &MavMessage::SYSTEM_TIME(SYSTEM_TIME_DATA { time_unix_usec: 77, time_boot_ms: ms }),
            )
        };
        let mut clock = BootClock::default();
        clock.note(&time(1000).frame().unwrap(), at(0));
        assert_eq!(clock.goes_on(&time(3000).frame().unwrap(), at(2000)), Some(true));
        assert_eq!(clock.goes_on(&time(9000).frame().unwrap(), at(2000)), Some(false));
    }
}
