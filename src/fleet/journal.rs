//! What was done so far, a line a log: results that are on their way, and that a kill does not cost.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, BufRead, BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::os::unix::fs::{FileExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use rustix::fs::OFlags;
use serde::{Deserialize, Serialize};

use crate::files::named;

use super::{FleetError, LogOutcome, Provenance, exact};

/// The longest line: some thousand outages.
const MOST_LINE: u64 = 16 << 20;

/// Where a log's line is, and what it is of.
#[derive(Clone, Debug)]
struct JournalLine {
    at: u64,
    bytes: usize,
    index: u64,
    identity: String,
    any_row: bool,
}

/// The first line.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct JournalHead {
    key: String,
    program: String,
}

/// Outcomes in a file, found by the name of their log. In memory are only their places.
#[derive(Debug)]
pub struct OutcomeJournal {
    file: File,
    path: Option<PathBuf>,
    end: u64,
    lines: BTreeMap<String, JournalLine>,
}

impl OutcomeJournal {
    /// One without a name, which is gone when the program is.
    ///
    /// # Errors
    /// The system's word.
    pub fn unnamed() -> Result<Self, FleetError> {
        Ok(Self { file: tempfile::tempfile()?, path: None, end: 0, lines: BTreeMap::new() })
    }

    /// The one at `path`, with what it holds of this batch; what another program or configuration left, and a line that a kill cut, are dropped.
    ///
    /// # Errors
    /// The system's word; [`FleetError::Busy`] where another process has it.
    pub fn open(path: &Path, batch: &Provenance) -> Result<Self, FleetError> {
        let io_error = |e: io::Error| FleetError::Io(named(path, &e));
        let options = OFlags::NOFOLLOW.bits().cast_signed();
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .custom_flags(options)
            .open(path)
            .map_err(io_error)?;
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => return Err(FleetError::Busy { path: path.to_owned() }),
            // A file system without locks: who starts a shard twice does its work twice.
            Err(TryLockError::Error(e)) if e.kind() == ErrorKind::Unsupported => {}
            Err(TryLockError::Error(e)) => return Err(io_error(e)),
            Ok(()) => {}
        }
        let mut journal = Self { file, path: Some(path.to_owned()), end: 0, lines: BTreeMap::new() };
        journal.recall(batch).map_err(io_error)?;
        Ok(journal)
    }

    fn recall(&mut self, batch: &Provenance) -> io::Result<()> {
        let head = JournalHead { key: batch.key.clone(), program: batch.program.clone() };
        let mut reader = BufReader::new(&self.file);
        let (mut line, mut end, mut found) = (Vec::new(), 0, BTreeMap::new());
        let ours = next_line(&mut reader, &mut line)?
            && exact::from_slice::<JournalHead>(&line).is_ok_and(|told| told == head);
        if ours {
            end = line.len() as u64;
            while next_line(&mut reader, &mut line)? {
                // A damaged line costs itself: the log is done again.
                if let Ok(outcome) = exact::from_slice::<LogOutcome>(&line) {
                    found.insert(outcome.log.clone(), place(&outcome, end, line.len()));
                }
                end += line.len() as u64;
            }
        }
        (self.end, self.lines) = (end, found);
        self.file.set_len(end)?;
        self.file.seek(SeekFrom::Start(end))?;
        if !ours {
            self.write(&head)?;
        }
        Ok(())
    }

    /// Writes a line, and returns where it began and how long it is.
    fn write(&mut self, what: &impl Serialize) -> io::Result<(u64, usize)> {
        let mut line = exact::to_vec(what)?;
        line.push(b'\n');
        self.file.write_all_at(&line, self.end)?;
        let at = self.end;
        self.end += line.len() as u64;
        Ok((at, line.len()))
    }

    /// Adds an outcome, in place of what there was of the same log.
    ///
    /// # Errors
    /// The system's word.
    pub fn add(&mut self, outcome: &LogOutcome) -> Result<(), FleetError> {
        let (at, bytes) = self.write(outcome).map_err(|e| match &self.path {
            Some(path) => named(path, &e),
            None => e,
        })?;
        self.lines.insert(outcome.log.clone(), place(outcome, at, bytes));
        Ok(())
    }

    /// The logs that it holds, with what told them from others then.
    pub fn identities(&self) -> impl Iterator<Item = (&str, &str)> {
        self.lines.iter().map(|(name, line)| (name.as_str(), line.identity.as_str()))
    }

    /// Whether it holds what came of a log.
    pub fn holds(&self, log: &str) -> bool {
        self.lines.contains_key(log)
    }

    /// Whether that has rows of outages or losses.
    pub fn has_rows(&self, log: &str) -> bool {
        self.lines.get(log).is_some_and(|line| line.any_row)
    }

    /// What came of a log; `None` if it is not here.
    ///
    /// # Errors
    /// The system's word.
    pub fn outcome(&self, log: &str) -> Result<Option<LogOutcome>, FleetError> {
        let Some(line) = self.lines.get(log) else { return Ok(None) };
        let mut bytes = vec![0; line.bytes];
        self.file.read_exact_at(&mut bytes, line.at)?;
        Ok(Some(exact::from_slice(&bytes).map_err(io::Error::from)?))
    }

    /// Names of the logs, with their places in the list, in the list's order.
    pub fn in_order(&self) -> Vec<(u64, &str)> {
        let mut all: Vec<_> = self.lines.iter().map(|(name, line)| (line.index, name.as_str())).collect();
        all.sort_unstable();
        all
    }

    /// Takes its file away.
    ///
    /// # Errors
    /// The system's word.
    pub fn remove(self) -> Result<(), FleetError> {
        match &self.path {
            Some(path) => Ok(std::fs::remove_file(path).map_err(|e| named(path, &e))?),
            None => Ok(()),
        }
    }
}

fn place(outcome: &LogOutcome, at: u64, bytes: usize) -> JournalLine {
    let any_row = !(outcome.rows.is_empty() && outcome.losses.is_empty());
    JournalLine { at, bytes, index: outcome.index, identity: outcome.identity.clone(), any_row }
}

/// The next whole line, with its end; false where there is none.
fn next_line(reader: &mut impl BufRead, line: &mut Vec<u8>) -> io::Result<bool> {
    line.clear();
    reader.take(MOST_LINE).read_until(b'\n', line)?;
    Ok(line.last() == Some(&b'\n'))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet::Recipe;
    use proptest::prelude::*;

    fn batch(settings: &str) -> Provenance {
        let recipe = Recipe {
            lengths_s: vec![60.0],
            starts: 1,
            estimators: vec!["shipped".into()],
            settings: settings.into(),
        };
        Provenance::of(&recipe, [].into_iter())
    }

    fn outcome(log: &str, identity: &str) -> LogOutcome {
        LogOutcome { log: log.into(), identity: identity.into(), ..LogOutcome::default() }
    }

    #[test]
    fn what_was_done_is_known_after_a_kill() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("j");
        let mut journal = OutcomeJournal::open(&path, &batch("a")).unwrap();
        journal.add(&outcome("a.ulg", "1")).unwrap();
        journal.add(&outcome("b.ulg", "1")).unwrap();
        assert!(matches!(OutcomeJournal::open(&path, &batch("a")), Err(FleetError::Busy { .. })));
        drop(journal);
        // Killed within a line.
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, &whole[..whole.len() - 5]).unwrap();
        let mut journal = OutcomeJournal::open(&path, &batch("a")).unwrap();
        assert_eq!(journal.identities().collect::<Vec<_>>(), [("a.ulg", "1")]);
        journal.add(&outcome("b.ulg", "2")).unwrap();
        drop(journal);
        let journal = OutcomeJournal::open(&path, &batch("a")).unwrap();
        assert_eq!(journal.outcome("b.ulg").unwrap().unwrap(), outcome("b.ulg", "2"));
        drop(journal);
        // Another configuration begins anew.
        let journal = OutcomeJournal::open(&path, &batch("b")).unwrap();
        assert!(journal.in_order().is_empty());
        journal.remove().unwrap();
        assert!(!path.exists());
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]
        #[test]
        fn whatever_is_in_the_file_the_next_run_goes_on(
            garbage in proptest::collection::vec(any::<u8>(), 0..300), at in 0usize..400, keep in any::<bool>()
        ) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("j");
            let mut journal = OutcomeJournal::open(&path, &batch("a")).unwrap();
            journal.add(&outcome("a.ulg", "1")).unwrap();
            drop(journal);
            let mut bytes = std::fs::read(&path).unwrap();
            let at = at.min(bytes.len());
            if keep { bytes.splice(at..at, garbage); } else { bytes.truncate(at); bytes.extend(garbage); }
            std::fs::write(&path, &bytes).unwrap();
            let mut journal = OutcomeJournal::open(&path, &batch("a")).unwrap();
            journal.add(&outcome("c.ulg", "3")).unwrap();
            drop(journal);
            let journal = OutcomeJournal::open(&path, &batch("a")).unwrap();
            prop_assert!(journal.holds("c.ulg"));
            for (_, name) in journal.in_order() {
                prop_assert!(journal.outcome(name).unwrap().is_some());
            }
        }
    }
}
