//! Logs of one vehicle, whoever wrote them: MAVLink telemetry logs, PX4's ULog, ArduPilot's DataFlash; packed or not.
//!
//! [`Log::open`] finds out by content what a file is, and [`Log::play`] turns it into the same [`Input`]s that a live link gives. Every
//! decoder streams: what a log takes of memory does not grow with it. Damage costs what it hits, and is counted. What each message
//! of each format becomes stands in `docs/src/logs.md`.

mod dataflash;
mod error;
pub mod fast_samples;
mod file;
mod folder;
mod format;
mod intake;
pub mod parameters;
mod remote;
pub mod rotors;
mod row;
mod source;
pub mod stretches;
mod telemetry;
mod ulog;
mod waiting;
mod zstd;

use std::io::{self, Read};
use std::path::Path;

pub use error::LogError;
use fast_samples::FastSensors;
pub use file::LogFile;
pub use folder::logs_in;
pub use format::LogFormat;
pub use parameters::Parameters;
pub use remote::RemoteLog;
use rotors::RotorSpeeds;

use crate::sample::Input;
use crate::wire::clock::AutopilotClock;
use crate::wire::counters::{Cause, Counters};
use crate::wire::decode::Repairs;
use crate::wire::frame::{Frame, SystemId};
use crate::wire::recording::Mark;
use crate::wire::session::identity::Vehicle;

/// An opened log whose vehicle is known.
#[derive(Clone, Debug)]
pub struct Log {
    file: LogFile,
    bytes: u64,
    format: LogFormat,
    vehicle: Vehicle,
}

/// One message of a log, whatever became of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry<'a> {
    /// What it is called; `None` for a MAVLink message that is not in the dialect.
    pub name: Option<&'a str>,
    /// The format's number of it.
    pub id: u32,
    /// The system that sent it.
    pub system: u8,
    /// The component that sent it, or which of several sensors it is of.
    pub component: u8,
}

/// What was read.
#[derive(Clone, Debug, Default)]
pub struct LogSummary {
    /// Messages that were read whole.
    pub frames: u64,
    /// Rejects of the reader and of the decoder.
    pub counters: Counters,
    /// The log ended in the middle of a message.
    pub truncated: bool,
    /// Messages that carry a signature. It is not looked at: the key may be another by now.
    pub signed: u64,
    /// Reboots of the autopilot.
    pub reboots: u32,
    /// What was put right in its messages.
    pub repairs: Repairs,
    /// The autopilot's parameters that matter here.
    pub parameters: Parameters,
    /// How fast the rotors turn.
    pub rotors: RotorSpeeds,
    /// What batches of fast samples show.
    pub fast: FastSensors,
    /// What else is to be said, a sentence each.
    pub notes: Vec<String>,
}

/// Where messages and inputs go, in the order in which they come.
struct Listener<'a> {
    /// Every message.
    entry: &'a mut dyn FnMut(&Entry<'_>),
    /// Every input.
    item: &'a mut dyn FnMut(&AutopilotClock, &Input),
    /// What a recording says beside them.
    aside: &'a mut dyn FnMut(&Aside<'_>),
}

/// What a recording of Holdover's holds beside what was heard: [`crate::wire::recording`].
#[derive(Clone, Debug)]
pub enum Aside<'a> {
    /// What comes next was recorded at this time, µs since 1970.
    At(u64),
    /// What holds from here on.
    Mark(Mark),
    /// A frame that Holdover sent.
    Sent(Frame<'a>),
}

impl Log {
    /// Opens a log and looks for the autopilot to follow: the given system, or the first.
    ///
    /// # Errors
    /// [`LogError`].
    pub fn open(path: &Path, system: Option<SystemId>) -> Result<Self, LogError> {
        Self::of(LogFile::at(path)?, system)
    }

    /// The same of a log whose bytes are at hand.
    ///
    /// # Errors
    /// [`LogError`].
    pub fn of(file: LogFile, system: Option<SystemId>) -> Result<Self, LogError> {
        let file = file.brought()?;
        let path = file.path();
        let io_error = |source| LogError::Io { path: path.to_owned(), source };
        let len = file.len()?;
        if len == 0 {
            return Err(LogError::Empty { path: path.to_owned() });
        }
        let (format, packed_badly) = recognised(&file).map_err(io_error)?;
        let format = format.map_err(|hint| LogError::NotALog {
            path: path.to_owned(),
            hint: packed_badly.map_or(hint, |why| format!("it cannot be unpacked: {why}")),
        })?;
        let no_message = || LogError::NotALog {
            path: path.to_owned(),
            hint: format!("{} by its first bytes, and not a message in it that can be read", format.label()),
        };
        let (bytes, _) = source::open(&file).map_err(io_error)?;
        let vehicle = match format {
            LogFormat::Tlog | LogFormat::RawMavlink => telemetry::vehicle(bytes, format, system)
                .map_err(io_error)?
                .map_err(|silent| LogError::NoVehicle {
                    path: path.to_owned(),
                    frames: silent.frames,
                    wanted: silent.wanted,
                    heard: silent.heard,
                })?,
            LogFormat::Ulog => ulog::vehicle(bytes).map_err(io_error)?.ok_or_else(no_message)?,
            LogFormat::DataFlash => dataflash::vehicle(bytes).map_err(io_error)?.ok_or_else(no_message)?,
        };
        let (path, label) = (path.display(), format.label());
        tracing::info!("{path}: {label}, {len} bytes, {} of system {}", vehicle.autopilot, vehicle.system.0);
        Ok(Self { bytes: len, format, vehicle, file })
    }

    /// What it is called.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Its size.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// What kind of log it is.
    pub fn format(&self) -> LogFormat {
        self.format
    }

    /// The vehicle that is followed.
    pub fn vehicle(&self) -> &Vehicle {
        &self.vehicle
    }

    /// Reads the log from its beginning. `entry` sees every message with the bytes of the file read so far, `item` everything decoded.
    ///
    /// # Errors
    /// [`LogError::Io`].
    pub fn play(
        &self,
        entry: impl FnMut(&Entry<'_>, u64),
        item: impl FnMut(&AutopilotClock, &Input),
    ) -> Result<LogSummary, LogError> {
        self.play_recording(entry, item, |_| {})
    }

    /// The same, and `aside` sees what a recording says beside.
    ///
    /// # Errors
    /// [`LogError::Io`].
    pub fn play_recording(
        &self,
        mut entry: impl FnMut(&Entry<'_>, u64),
        mut item: impl FnMut(&AutopilotClock, &Input),
        mut aside: impl FnMut(&Aside<'_>),
    ) -> Result<LogSummary, LogError> {
        let io_error = |source| LogError::Io { path: self.path().to_owned(), source };
        let (bytes, progress) = source::open(&self.file).map_err(io_error)?;
        let mut entry = |e: &Entry<'_>| entry(e, progress.read());
        let mut to = Listener { entry: &mut entry, item: &mut item, aside: &mut aside };
        let mut summary = match self.format {
            LogFormat::Tlog | LogFormat::RawMavlink => {
                telemetry::play(bytes, self.format, &self.vehicle, &mut to)
            }
            LogFormat::Ulog => ulog::play(bytes, &self.vehicle, &mut to),
            LogFormat::DataFlash => dataflash::play(bytes, &self.vehicle, &mut to),
        }
        .map_err(io_error)?;
        if let Some(why) = progress.ended() {
            summary.truncated = true;
            summary.notes.push(format!("unpacking it ended early: {why}"));
        }
        Ok(summary)
    }
}

/// What the beginning of a file says that it is, and why it could not be unpacked.
fn recognised(file: &LogFile) -> io::Result<(Result<LogFormat, String>, Option<String>)> {
    let (bytes, progress) = source::open(file)?;
    let mut first = Vec::new();
    bytes.take(format::LOOKED_AT as u64).read_to_end(&mut first)?;
    Ok((format::recognise(&first), progress.ended()))
}

/// What a cause is about, where its name does not say it of a log.
fn explained(cause: Cause) -> &'static str {
    match cause {
        Cause::Unconfirmed => " (a time of day, or a kind of vehicle, other than was told before)",
        _ => "",
    }
}

impl LogSummary {
    /// Bytes that belong to no message.
    pub fn skipped_bytes(&self) -> u64 {
        self.counters.of(Cause::Garbage)
    }

    /// What is to be said of the log, a line each: what was not used, what was put right, where it breaks off.
    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        let rejects: Vec<String> =
            self.counters.seen().map(|(c, n)| format!("{n} {}{}", c.label(), explained(c))).collect();
        if !rejects.is_empty() {
            remarks.push(format!("not used: {}", rejects.join(", ")));
        }
        remarks.extend(self.repairs.seen().map(|(repair, n)| format!("{n} {}", repair.label())));
        if self.truncated {
            remarks.push("the log ends in the middle of a record".to_owned());
        }
        if self.signed > 0 {
            remarks.push(format!("{} messages are signed; in logs that is not verified", self.signed));
        }
        if self.reboots > 0 {
            remarks.push(format!("the autopilot rebooted {} times", self.reboots));
        }
        if self.fast.broken > 0 {
            remarks.push(format!("{} batches of fast samples are not whole", self.fast.broken));
        }
        remarks.extend(self.notes.iter().cloned());
        remarks
    }

    /// Damaged frames.
    pub fn bad_crc(&self) -> u64 {
        self.counters.of(Cause::BadChecksum)
    }
}
