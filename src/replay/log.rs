//! A telemetry log of one vehicle.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use crate::sample::Input;
use crate::time::Stamp;
use crate::wire::clock::AutopilotClock;
use crate::wire::counters::{Cause, Counters};
use crate::wire::decode::{Decoder, Repairs};
use crate::wire::frame::{Frame, SystemId};
use crate::wire::session::identity::{Identity, IdentityConfig, Vehicle};
use crate::wire::tlog::{TlogReader, describe_foreign};

/// Why a log cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// It cannot be opened or read.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// It is a directory.
    #[error("{path}: this is a directory, not a .tlog")]
    Directory {
        /// The file.
        path: PathBuf,
    },
    /// There is nothing in it.
    #[error("{path}: the file is empty")]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// It is something else.
    #[error("{path}: no MAVLink record found: {hint}")]
    NotATlog {
        /// The file.
        path: PathBuf,
        /// What it seems to be.
        hint: &'static str,
    },
    /// No autopilot speaks in it.
    #[error("{path}: {frames} frames, but no heartbeat of {wanted}; systems heard: {heard}")]
    NoVehicle {
        /// The file.
        path: PathBuf,
        /// Frames read.
        frames: u64,
        /// Which autopilot was wanted.
        wanted: String,
        /// Which systems there are.
        heard: String,
    },
}

/// An opened log whose vehicle is known.
#[derive(Clone, Debug)]
pub struct Log {
    path: PathBuf,
    bytes: u64,
    vehicle: Vehicle,
}

/// What was read.
#[derive(Clone, Debug)]
pub struct LogSummary {
    /// Frames with a good checksum.
    pub frames: u64,
    /// Rejects of the reader and of the decoder.
    pub counters: Counters,
    /// The log ended in the middle of a record.
    pub truncated: bool,
    /// Reboots of the autopilot.
    pub reboots: u32,
    /// What was put right in its messages.
    pub repairs: Repairs,
}

impl Log {
    /// Opens a log and looks for the autopilot to follow: the given system, or the first.
    ///
    /// # Errors
    /// [`LogError`].
    pub fn open(path: &Path, system: Option<SystemId>) -> Result<Self, LogError> {
        let io_error = |source| LogError::Io { path: path.to_owned(), source };
        let meta = std::fs::metadata(path).map_err(io_error)?;
        if meta.is_dir() {
            return Err(LogError::Directory { path: path.to_owned() });
        }
        if meta.len() == 0 {
            return Err(LogError::Empty { path: path.to_owned() });
        }
        let mut reader = TlogReader::new(File::open(path).map_err(io_error)?);
        let mut identity = Identity::new(IdentityConfig { system, ..IdentityConfig::default() });
        let mut heard: BTreeMap<SystemId, u64> = BTreeMap::new();
        while let Some(record) = reader.next_record().map_err(io_error)? {
            *heard.entry(record.frame.system()).or_default() += 1;
            identity.hear(Stamp::from_micros(0), &record.frame);
            if let Some(vehicle) = identity.vehicle() {
                return Ok(Self { path: path.to_owned(), bytes: meta.len(), vehicle: *vehicle });
            }
        }
        let frames = reader.counters().frames;
        if frames == 0 {
            let mut first = [0; 64];
            let n = File::open(path).and_then(|mut f| f.read(&mut first)).map_err(io_error)?;
            let hint =
                describe_foreign(&first[..n]).unwrap_or("not a telemetry log, or damaged beyond reading");
            return Err(LogError::NotATlog { path: path.to_owned(), hint });
        }
        let heard: Vec<String> =
            heard.iter().take(12).map(|(s, n)| format!("{} ({n} frames)", s.0)).collect();
        let wanted =
            system.map_or("any autopilot".to_owned(), |s| format!("an autopilot with system id {}", s.0));
        Err(LogError::NoVehicle { path: path.to_owned(), frames, wanted, heard: heard.join(", ") })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its size.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The vehicle that is followed.
    pub fn vehicle(&self) -> &Vehicle {
        &self.vehicle
    }

    /// Reads the log from its beginning. `frame` sees every frame with the bytes read so far, `item` everything decoded.
    ///
    /// # Errors
    /// [`LogError::Io`].
    pub fn play(
        &self,
        mut frame: impl FnMut(&Frame<'_>, u64),
        mut item: impl FnMut(&AutopilotClock, &Input),
    ) -> Result<LogSummary, LogError> {
        let io_error = |source| LogError::Io { path: self.path.clone(), source };
        let mut reader = TlogReader::new(File::open(&self.path).map_err(io_error)?);
        let mut decoder = Decoder::new();
        decoder.follow(&self.vehicle);
        let mut items = Vec::with_capacity(8);
        let mut position = 0;
        while let Some(record) = reader.next_record().map_err(io_error)? {
            position += (8 + record.frame.len()) as u64;
            frame(&record.frame, position);
            decoder.decode(&record.frame, &mut items);
            for i in items.drain(..) {
                item(decoder.clock(), &i);
            }
        }
        let mut counters = decoder.counters().clone();
        counters.frames = 0;
        counters.merge(reader.counters());
        Ok(LogSummary {
            frames: reader.counters().frames,
            truncated: reader.truncated(),
            reboots: decoder.clock().reboots(),
            repairs: decoder.repairs().clone(),
            counters,
        })
    }
}

impl LogSummary {
    /// Bytes that belong to no frame.
    pub fn skipped_bytes(&self) -> u64 {
        self.counters.of(Cause::Garbage)
    }

    /// What is to be said of the log, a line each: what was not used, what was put right, where it breaks off.
    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        let rejects: Vec<String> = self.counters.seen().map(|(c, n)| format!("{n} {}", c.label())).collect();
        if !rejects.is_empty() {
            remarks.push(format!("not used: {}", rejects.join(", ")));
        }
        remarks.extend(self.repairs.seen().map(|(repair, n)| format!("{n} {}", repair.label())));
        if self.truncated {
            remarks.push("the log ends in the middle of a record".to_owned());
        }
        if self.reboots > 0 {
            remarks.push(format!("the autopilot rebooted {} times", self.reboots));
        }
        remarks
    }

    /// Damaged frames.
    pub fn bad_crc(&self) -> u64 {
        self.counters.of(Cause::BadChecksum)
    }
}
