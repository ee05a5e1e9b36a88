//! `[record]` and `[tuning.record]`: recordings of what was heard and sent.

use std::path::PathBuf;

use crate::config::key::section;
use crate::record::RecordSettings;
use crate::time::Span;

section! {
    /// Recordings of all that is heard and sent, as telemetry logs that fly again as they were flown: holdover replay.
    "record" struct RecordKeys {
        /// The folder, made where it is missing. "" records nothing.
        dir: String = "";
        /// The recordings there take so much at most; the oldest are removed.
        max_bytes: u64 = 4_000_000_000 in 1_000_000.0 ..= 1e15 unit "bytes";
        /// So much of the disk is left free: before it is not, the oldest recordings are removed, and then nothing is recorded.
        min_free_bytes: u64 = 500_000_000 in 0.0 ..= 1e15 unit "bytes";
    }
}

section! {
    /// The files of a recording.
    "tuning.record" struct RecordTuning {
        /// A file of this size is followed by another.
        max_file_bytes: u64 = 100_000_000 in 10_000.0 ..= 1e12 unit "bytes";
        /// A file of this age is.
        max_file_age_s: f64 = 3600.0 in 1.0 ..= 1e6;
    }
}

impl RecordKeys {
    pub(super) fn settings(&self, tuning: &RecordTuning) -> Option<RecordSettings> {
        (!self.dir.is_empty()).then(|| RecordSettings {
            folder: PathBuf::from(&self.dir),
            max_bytes: self.max_bytes,
            min_free_bytes: self.min_free_bytes,
            max_file_bytes: tuning.max_file_bytes,
            max_file_age: Span::from_seconds(tuning.max_file_age_s),
        })
    }
}
