//! Which format a log has, by its first bytes: names lie.

use std::io::Read;

use crate::wire::counters::Cause;
use crate::wire::tlog::TlogReader;

/// Bytes that are looked at.
pub(super) const LOOKED_AT: usize = 1 << 17;

/// `ULog` and what follows it in every file, but for the version.
pub(super) const ULOG_MAGIC: &[u8] = &[0x55, 0x4C, 0x6F, 0x67, 0x01, 0x12, 0x35];
/// What PX4 puts in front of a log that it encrypts: the key, itself encrypted.
const ULOG_KEY: &[u8] = b"ULogKey";
/// Two bytes before every message of ArduPilot's logs, and the type of the message that describes messages.
pub(super) const DATAFLASH_HEAD: [u8; 2] = [0xA3, 0x95];
pub(super) const DATAFLASH_FMT: u8 = 128;

/// A kind of log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogFormat {
    /// MAVLink frames with the ground station's stamps (`.tlog`).
    Tlog,
    /// MAVLink frames as they came (`.tlog.raw` of MAVProxy).
    RawMavlink,
    /// PX4's own (`.ulg`).
    Ulog,
    /// ArduPilot's own (`.bin`).
    DataFlash,
}

impl LogFormat {
    /// What it is called.
    pub const fn label(self) -> &'static str {
        match self {
            LogFormat::Tlog => "MAVLink tlog",
            LogFormat::RawMavlink => "raw MAVLink",
            LogFormat::Ulog => "ULog",
            LogFormat::DataFlash => "DataFlash",
        }
    }
}

/// What the first bytes of a file say that it is.
///
/// # Errors
/// What it seems to be instead of a log.
pub(super) fn recognise(first: &[u8]) -> Result<LogFormat, String> {
    if first.starts_with(ULOG_MAGIC) {
        return Ok(LogFormat::Ulog);
    }
    if first.starts_with(ULOG_KEY) {
        return Err("an encrypted ULog: decrypt it with PX4's Tools/decrypt_ulog.py and its key".into());
    }
    if describes_messages(first) {
        return Ok(LogFormat::DataFlash);
    }
    if let Some(format) = telemetry(first) {
        return Ok(format);
    }
    Err(describe(first).into())
}

/// Whether a DataFlash message that describes messages stands among the first bytes, and nothing else makes them up: pages that were lost
/// in front of it cost those pages only.
fn describes_messages(first: &[u8]) -> bool {
    let [a, b] = DATAFLASH_HEAD;
    let heads = first.windows(3).filter(|w| w[..2] == [a, b]);
    let (mut all, mut formats) = (0, 0);
    for head in heads {
        all += 1;
        formats += u32::from(head[2] == DATAFLASH_FMT);
    }
    first.starts_with(&[a, b, DATAFLASH_FMT]) || (formats >= 3 && all >= 10)
}

/// With or without stamps: read the wrong way, stamps are garbage between the frames, and frames are taken for stamps.
fn telemetry(first: &[u8]) -> Option<LogFormat> {
    let stamped = rejected(TlogReader::new(first))?;
    let raw = rejected(TlogReader::without_stamps(first))?;
    let (format, (frames, _)) = if stamped.1 <= raw.1 && stamped.0 > 0 {
        (LogFormat::Tlog, stamped)
    } else {
        (LogFormat::RawMavlink, raw)
    };
    (frames > 0).then_some(format)
}

/// Frames with a checksum that fits, and bytes that belong to none.
fn rejected<R: Read>(mut reader: TlogReader<R>) -> Option<(u64, u64)> {
    let mut good = 0;
    while let Some(record) = reader.next_record().ok()? {
        good += u64::from(record.frame.checksum_fits());
    }
    Some((good, reader.counters().of(Cause::Garbage)))
}

/// What a file is that is no log, to tell its owner what to do.
fn describe(first: &[u8]) -> &'static str {
    if first.is_empty() {
        "nothing is in it"
    } else if first.starts_with(b"SQLite format 3") || first.starts_with(b"PK\x03\x04") {
        "this is an archive or a database"
    } else if first.iter().all(|b| b.is_ascii_graphic() || b.is_ascii_whitespace()) {
        "this is a text file"
    } else {
        "neither MAVLink nor ULog nor DataFlash, or damaged beyond reading"
    }
}
