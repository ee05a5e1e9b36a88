//! What is kept, and whose it is.

use std::io;

use serde::{Deserialize, Serialize};

use crate::navigator::memory::Snapshot;
use crate::outbound::alignment::AlignmentMemory;
use crate::time::AutopilotTime;
use crate::wire::session::identity::Vehicle;

/// Of the format. A file of another is refused.
const VERSION: u32 = 1;
/// How far two readings of one boot's time may lie apart, s, and by what part of the time between them: two clocks, and messages that wait.
const SAME_BOOT_S: f64 = 1.0;
const SAME_BOOT_PART: f64 = 0.05;

/// Why a state is not gone on from.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// There is none.
    #[error("none was kept")]
    None,
    /// It cannot be read.
    #[error("it cannot be read: {0}")]
    Read(#[from] io::Error),
    /// It is a link, a folder or a device.
    #[error("it is no file")]
    NotAFile,
    /// It is larger than any state.
    #[error("it is too large")]
    TooLarge,
    /// It is no state, or a damaged one.
    #[error("it is damaged: {0}")]
    Damaged(#[from] serde_json::Error),
    /// Another version has written it.
    #[error("it has version {0}")]
    Version(u32),
    /// It is another vehicle's.
    #[error("it is another vehicle's")]
    OtherVehicle,
    /// The autopilot has rebooted since.
    #[error("the autopilot has rebooted since")]
    OtherBoot,
}

/// When an autopilot booted, by a clock that goes on without it and without this process: what tells one boot from another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Boot {
    /// Time since the boot, µs, by the autopilot …
    pub since_us: i64,
    /// … when this computer's clock said so, µs since 1970.
    pub unix_us: i64,
}

impl Boot {
    /// Whether `later` is of the same boot.
    pub fn goes_on_as(&self, later: &Boot) -> bool {
        let seconds = |from: i64, to: i64| to.saturating_sub(from) as f64 * 1e-6;
        let by_autopilot = seconds(self.since_us, later.since_us);
        let by_us = seconds(self.unix_us, later.unix_us);
        by_autopilot > 0.0 && (by_us - by_autopilot).abs() <= SAME_BOOT_S + SAME_BOOT_PART * by_autopilot
    }
}

/// The vehicle that a state is of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Owner {
    system: u8,
    autopilot: String,
    vehicle_type: u8,
}

impl Owner {
    fn of(vehicle: &Vehicle) -> Self {
        Self {
            system: vehicle.system.0,
            autopilot: vehicle.autopilot.to_string(),
            vehicle_type: vehicle.vehicle_type,
        }
    }
}

/// A state with what it takes to know whether it may be gone on from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeptState {
    version: u32,
    owner: Owner,
    /// At the snapshot's time.
    boot: Boot,
    /// How our frame lies in the autopilot's.
    pub alignment: AlignmentMemory,
    /// The navigation.
    pub snapshot: Snapshot,
}

/// What stands first, to be read whatever else has changed.
#[derive(Deserialize)]
struct Head {
    version: u32,
}

impl KeptState {
    /// What is known of a vehicle; `boot` at the snapshot's time.
    pub fn new(vehicle: &Vehicle, boot: Boot, alignment: AlignmentMemory, snapshot: Snapshot) -> Self {
        Self { version: VERSION, owner: Owner::of(vehicle), boot, alignment, snapshot }
    }

    /// When it was kept, µs since 1970.
    pub fn kept_us(&self) -> i64 {
        self.boot.unix_us
    }

    /// As it is written.
    ///
    /// # Errors
    /// A value that is not finite.
    pub fn encode(&self) -> Result<Vec<u8>, serde_json::Error> {
        serde_json::to_vec(self)
    }

    /// From what was written, or anything else.
    ///
    /// # Errors
    /// [`StateError::Damaged`] and [`StateError::Version`].
    pub fn decode(bytes: &[u8]) -> Result<Self, StateError> {
        let Head { version } = serde_json::from_slice(bytes)?;
        if version != VERSION {
            return Err(StateError::Version(version));
        }
        Ok(serde_json::from_slice(bytes)?)
    }

    /// Whether it is of this vehicle.
    ///
    /// # Errors
    /// [`StateError::OtherVehicle`].
    pub fn is_of(&self, vehicle: &Vehicle) -> Result<(), StateError> {
        if self.owner == Owner::of(vehicle) { Ok(()) } else { Err(StateError::OtherVehicle) }
    }

    /// The snapshot as one of the boot that `now` is of, on a clock that calls `boot_zero` what the autopilot calls 0.
    ///
    /// # Errors
    /// [`StateError::OtherBoot`].
    pub fn snapshot_on(&self, now: &Boot, boot_zero: AutopilotTime) -> Result<Snapshot, StateError> {
        if !self.boot.goes_on_as(now) {
            return Err(StateError::OtherBoot);
        }
        let time_us = boot_zero.micros().saturating_add(self.boot.since_us);
        Ok(Snapshot { time_us, ..self.snapshot.clone() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn boot(since_s: f64, unix_s: f64) -> Boot {
        Boot { since_us: (since_s * 1e6) as i64, unix_us: (unix_s * 1e6) as i64 }
    }

    #[test]
    fn one_boot_is_told_from_another_by_two_clocks() {
        let then = boot(100.0, 1_790_000_000.0);
        assert!(then.goes_on_as(&boot(103.0, 1_790_000_003.0)));
        assert!(then.goes_on_as(&boot(103.0, 1_790_000_003.9)), "a message may wait");
        assert!(then.goes_on_as(&boot(150.0, 1_790_000_052.0)), "a simulator may be slow");
        assert!(!then.goes_on_as(&boot(99.0, 1_790_000_010.0)), "it began anew");
        assert!(!then.goes_on_as(&boot(105.0, 1_790_000_300.0)), "it began anew, and has got beyond");
        assert!(!then.goes_on_as(&boot(400.0, 1_790_000_010.0)), "another autopilot, up for longer");
        assert!(!then.goes_on_as(&boot(100.0, 1_790_000_000.0)), "the same moment");
        let hostile = Boot { since_us: i64::MIN, unix_us: i64::MAX };
        assert!(!hostile.goes_on_as(&then) && !then.goes_on_as(&hostile));
    }
}
