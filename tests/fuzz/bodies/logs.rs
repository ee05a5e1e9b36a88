//! Logs of PX4 and ArduPilot.

use holdover::log::{Log, LogFile};

/// What follows the magic of a `ULog`.
pub fn ulog(bytes: &[u8]) -> u64 {
    played(&[&[0x55, 0x4C, 0x6F, 0x67, 0x01, 0x12, 0x35], bytes].concat())
}

/// A `DataFlash` log, from its first description of a message.
pub fn dataflash(bytes: &[u8]) -> u64 {
    played(&[&[0xA3, 0x95, 0x80], bytes].concat())
}

/// Plays a log to its end, if it is one: its messages.
fn played(bytes: &[u8]) -> u64 {
    let Ok(log) = LogFile::of("fuzzed", bytes).and_then(|file| Log::of(file, None)) else { return 1 };
    let mut messages = 0;
    let summary = log.play(|_, _| messages += 1, |_, input| assert!(!format!("{input:?}").contains("NaN")));
    assert!(summary.is_ok());
    1 + messages
}
