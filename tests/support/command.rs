//! What tests of the command share: running it as a stranger would, and logs cut out of the ones in `sitl-logs`.
#![allow(dead_code, reason = "no test file uses all of it")]

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use holdover::wire::frame::Frame;
use holdover::wire::tlog::TlogReader;
use mavlink::Message;
use mavlink::dialects::ardupilotmega::MavMessage;
use serde_json::Value;

pub const COPTER: &str = "ardupilot-copter-gps-loss";
pub const PX4: &str = "px4-quad-gps-loss";

/// What a run of the command left behind.
#[derive(Debug)]
pub struct Ran {
    pub code: Option<i32>,
    pub out: String,
    pub err: String,
}

impl Ran {
    /// Standard output as one JSON object and nothing else.
    pub fn json(&self) -> Value {
        assert_eq!(self.code, Some(0), "{self:?}");
        assert_eq!(self.out.trim_end().lines().count(), 1, "{}", self.out);
        let value: Value = serde_json::from_str(&self.out).expect("standard output is not one JSON value");
        assert!(value.is_object());
        value
    }

    /// Fails unless the command ended with `code` and every one of `words` on standard error.
    pub fn fails(&self, code: i32, words: &[&str]) {
        assert_eq!(self.code, Some(code), "{self:?}");
        for word in words {
            assert!(self.err.contains(word), "no \"{word}\" in: {}", self.err);
        }
        assert!(self.out.is_empty(), "{}", self.out);
    }
}

/// Runs `holdover` without any of its variables in the environment. No run may panic.
pub fn holdover<S: AsRef<OsStr>>(arguments: &[S]) -> Ran {
    holdover_with(arguments, &[])
}

pub fn holdover_with<S: AsRef<OsStr>>(arguments: &[S], variables: &[(&str, &str)]) -> Ran {
    let mut command = Command::new(env!("CARGO_BIN_EXE_holdover"));
    for (name, _) in std::env::vars_os().filter(|(n, _)| n.to_string_lossy().starts_with("HOLDOVER_")) {
        command.env_remove(name);
    }
    let Output { status, stdout, stderr } =
        command.envs(variables.iter().copied()).args(arguments).output().expect("holdover does not start");
    let ran = Ran {
        code: status.code(),
        out: String::from_utf8(stdout).expect("not UTF-8"),
        err: String::from_utf8_lossy(&stderr).into_owned(),
    };
    assert!(!ran.err.contains("panicked"), "{}", ran.err);
    ran
}

pub fn sitl_log(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("sitl-logs").join(format!("{name}.tlog"))
}

/// One record of a log, owned.
#[derive(Clone, Debug)]
pub struct Record {
    pub written_us: u64,
    pub frame: Vec<u8>,
}

impl Record {
    pub fn id(&self) -> u32 {
        match self.frame[0] {
            0xFE => u32::from(self.frame[5]),
            _ => u32::from_le_bytes([self.frame[7], self.frame[8], self.frame[9], 0]),
        }
    }

    /// Where the payload begins and ends.
    pub fn payload(&self) -> std::ops::Range<usize> {
        let from = if self.frame[0] == 0xFE { 6 } else { 10 };
        from..from + usize::from(self.frame[1])
    }

    /// Another system's.
    pub fn set_system(&mut self, system: u8) {
        let at = if self.frame[0] == 0xFE { 3 } else { 5 };
        self.frame[at] = system;
        self.seal();
    }

    /// Makes the checksum right again.
    pub fn seal(&mut self) {
        let end = self.payload().end;
        let crc = mavlink::calculate_crc(&self.frame[1..end], MavMessage::extra_crc(self.id()));
        self.frame[end..end + 2].copy_from_slice(&crc.to_le_bytes());
    }
}

/// The records of a log whose stamps lie between two times after its first, s.
pub fn records(name: &str, from_s: f64, to_s: f64) -> Vec<Record> {
    let mut reader = TlogReader::new(fs::File::open(sitl_log(name)).expect("sitl-logs"));
    let mut out = Vec::new();
    let mut first = None;
    while let Some(r) = reader.next_record().expect("readable") {
        let t = (r.written_us - *first.get_or_insert(r.written_us)) as f64 * 1e-6;
        if t >= to_s {
            break;
        }
        if t >= from_s {
            let frame: Frame<'_> = r.frame;
            out.push(Record { written_us: r.written_us, frame: frame.bytes().to_vec() });
        }
    }
    assert!(out.len() > 100, "{} records", out.len());
    out
}

pub fn bytes_of(records: &[Record]) -> Vec<u8> {
    records
        .iter()
        .flat_map(|r| r.written_us.to_be_bytes().into_iter().chain(r.frame.iter().copied()))
        .collect()
}

/// Writes a log into `folder`.
pub fn write_log(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    fs::write(&path, bytes).expect("writable");
    path
}
