//! Going on from what a process before has kept, in flight and where that flight is flown again.

use crate::navigator::Navigator;
use crate::navigator::memory::ResumeError;
use crate::outbound::Outbound;
use crate::time::AutopilotTime;
use crate::wire::clock::AutopilotClock;

use super::kept::{Boot, KeptState};

/// When a state is looked at, by every clock.
#[derive(Clone, Copy, Debug)]
pub struct Moment<'a> {
    /// The autopilot's.
    pub clock: &'a AutopilotClock,
    /// The time of day, µs since 1970.
    pub unix_us: i64,
}

impl Moment<'_> {
    /// The boot of which `time` is.
    pub fn boot(&self, time: AutopilotTime) -> Boot {
        Boot { since_us: self.clock.boot_micros(time), unix_us: self.unix_us }
    }

    /// What the clock calls the autopilot's 0.
    fn boot_zero(&self) -> AutopilotTime {
        AutopilotTime::from_micros(-self.clock.boot_micros(AutopilotTime::from_micros(0)))
    }
}

/// The first IMU sample, of `first`, is about to be taken. A sentence where the state is not gone on from; the navigator tells of itself where
/// it is.
pub fn go_on(
    kept: &KeptState,
    (navigator, outbound): (&mut Navigator, &mut Outbound),
    moment: &Moment<'_>,
    first: AutopilotTime,
) -> Option<String> {
    let snapshot = match kept.snapshot_on(&moment.boot(first), moment.boot_zero()) {
        Ok(snapshot) => snapshot,
        // It may be another vehicle with the same number: not even its sensors need be the same.
        Err(e) => return Some(format!("state not used: {e}")),
    };
    match navigator.resume(&snapshot, first) {
        Ok(()) => {
            outbound.recall(&kept.alignment);
            None
        }
        Err(e @ ResumeError::TooOld(_)) => {
            let learned = navigator.recall(&snapshot.sensors);
            let and = if learned.is_ok() { "; calibrations are" } else { "" };
            Some(format!("state not used: {e}{and}"))
        }
        Err(e) => Some(format!("state not used: {e}")),
    }
}
