//! The folder in which the results of all shards are.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::files::{OutputFile, Overwrite, READABLE, named};

use super::{FleetError, LogOutcome, OutcomeJournal, Provenance, ResultsReader, ResultsWriter, Shard};

/// Where a shard's results are.
fn results_path(folder: &Path, shard: Shard) -> PathBuf {
    folder.join(format!("shard-{:04}-of-{:04}.parquet", shard.index(), shard.of()))
}

/// A shard while it is worked on.
#[derive(Debug)]
pub struct ShardWork {
    results: PathBuf,
    shard: Shard,
    batch: Provenance,
    journal: OutcomeJournal,
    /// The results are there already, and nothing was done since.
    whole: bool,
}

impl ShardWork {
    /// Begins, or goes on, in `folder`, which is made if it is not there: what was done before of the same batch, whole or not, is known.
    ///
    /// # Errors
    /// The system's word; [`FleetError::Busy`].
    pub fn begin(folder: &Path, shard: Shard, batch: Provenance) -> Result<Self, FleetError> {
        fs::create_dir_all(folder).map_err(|e| named(folder, &e))?;
        let results = results_path(folder, shard);
        let name = results.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let mut journal = OutcomeJournal::open(&folder.join(format!(".{name}.journal")), &batch)?;
        let mut whole = false;
        // Results that cannot be read are made again.
        if let Ok(before) = ResultsReader::open(&results)
            && before.batch.key == batch.key
            && before.batch.program == batch.program
        {
            let begun = !journal.in_order().is_empty();
            let read = before.each(|outcome| {
                // What the journal has is newer.
                if journal.holds(&outcome.log) {
                    return Ok(());
                }
                journal.add(&outcome)
            });
            whole = read.is_ok() && !begun && before.batch == batch;
        }
        Ok(Self { results, shard, batch, journal, whole })
    }

    /// What was done before: the identities that logs had then, by name.
    pub fn known(&self) -> BTreeMap<String, String> {
        self.journal.identities().map(|(log, identity)| (log.to_owned(), identity.to_owned())).collect()
    }

    /// Keeps what came of a log.
    ///
    /// # Errors
    /// The system's word.
    pub fn keep(&mut self, outcome: &LogOutcome) -> Result<(), FleetError> {
        self.whole = false;
        self.journal.add(outcome)
    }

    /// Writes the results of these logs, in this order: places in the whole list, and names. Returns where they are,
    /// and how many of the logs have no rows.
    ///
    /// # Errors
    /// The system's word.
    pub fn finish<'a>(
        self,
        logs: impl Iterator<Item = (u64, &'a str)>,
    ) -> Result<(PathBuf, usize), FleetError> {
        let logs: Vec<(u64, &str)> = logs.collect();
        let without_rows = logs.iter().filter(|(_, log)| !self.journal.has_rows(log)).count();
        if !self.whole {
            let to = OutputFile::create(&self.results, Overwrite::Always, READABLE)?;
            let mut writer = ResultsWriter::new(to, &self.batch, self.shard)?;
            for (index, log) in logs {
                if let Some(outcome) = self.journal.outcome(log)? {
                    writer.add(&LogOutcome { index, ..outcome })?;
                }
            }
            writer.finish()?.finish()?;
        }
        self.journal.remove()?;
        Ok((self.results, without_rows))
    }
}

/// The results of all shards in one.
#[derive(Debug)]
pub struct MergedResults {
    /// What they belong to.
    pub batch: Provenance,
    /// Shards that are not there (yet).
    pub missing: Vec<u32>,
    outcomes: OutcomeJournal,
}

impl MergedResults {
    /// Every outcome, in the order of the list.
    ///
    /// # Errors
    /// What reading says; what `to` says.
    pub fn each<E: From<FleetError>>(
        &self,
        mut to: impl FnMut(LogOutcome) -> Result<(), E>,
    ) -> Result<(), E> {
        for (_, name) in self.outcomes.in_order() {
            if let Some(outcome) = self.outcomes.outcome(name)? {
                to(outcome)?;
            }
        }
        Ok(())
    }
}

/// The results in a folder, in the order of the list, however many they are: they are put into a file without a name, and only their places
/// are in memory.
///
/// # Errors
/// A folder without results, or with some of other lists, configurations or numbers of shards.
pub fn merged(folder: &Path) -> Result<MergedResults, FleetError> {
    let entries = fs::read_dir(folder).map_err(|e| named(folder, &e))?;
    let mut paths: Vec<PathBuf> = entries.map(|e| e.map(|e| e.path())).collect::<Result<_, _>>()?;
    paths.retain(|p| {
        let name = p.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with("shard-") && name.ends_with(".parquet")
    });
    paths.sort();
    let mut outcomes = OutcomeJournal::unnamed()?;
    let mut first: Option<(Provenance, u32, PathBuf)> = None;
    let mut there: BTreeMap<u32, PathBuf> = BTreeMap::new();
    for path in paths {
        let file = ResultsReader::open(&path)?;
        let (batch, of, like) =
            first.get_or_insert_with(|| (file.batch.clone(), file.shard.of(), path.clone()));
        let other = if file.shard.of() != *of {
            Some("another number of shards")
        } else if (file.batch.logs, &file.batch.list) != (batch.logs, &batch.list) {
            Some("another list of logs")
        } else if file.batch.key != batch.key {
            Some("another configuration, other outages or another version")
        } else {
            None
        };
        if let Some(what) = other {
            let (a, b) = (like.display(), path.display());
            return Err(FleetError::Mixed(format!("{b} is of {what} than {a}: take away what is old")));
        }
        if let Some(twin) = there.insert(file.shard.index(), path.clone()) {
            let (a, b) = (twin.display(), path.display());
            return Err(FleetError::Mixed(format!("{a} and {b} are of the same shard")));
        }
        file.each(|outcome| outcomes.add(&outcome))?;
    }
    let (batch, of, _) = first.ok_or_else(|| {
        FleetError::Mixed(format!("{}: no results (shard-*.parquet) in it", folder.display()))
    })?;
    let missing = (0..of).filter(|i| !there.contains_key(i)).collect();
    Ok(MergedResults { batch, missing, outcomes })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet::{LogFailure, NaturalLoss, OutageRow, Recipe, Unusable};
    use crate::replay::losses::LossRow;
    use crate::replay::runner::ReferenceKind;
    use crate::replay::sweep::SweepRow;
    use proptest::prelude::*;

    const LOGS: [&str; 5] = ["a.ulg", "b.ulg", "c.bin", "s3://fleet/d.tlog", "e"];

    fn batch(starts: usize) -> Provenance {
        let recipe = Recipe {
            lengths_s: vec![60.0, 0.1],
            starts,
            estimators: vec!["shipped".into()],
            settings: String::new(),
        };
        Provenance::of(&recipe, LOGS.into_iter())
    }

    fn row(start_s: f64, error: Option<f64>) -> SweepRow {
        SweepRow {
            length_s: 0.1,
            start_s,
            distance_m: Some(1.0 / 3.0),
            start_error_m: None,
            horizontal_error_end_m: error,
            horizontal_error_max_m: Some(1e-300),
            drift_percent: error,
            altitude_rmse_m: Some(-0.0),
            sigma_end_m: Some(0.1 + 0.2),
        }
    }

    fn outcome(index: u64, identity: &str) -> LogOutcome {
        let log = LOGS[index as usize].to_owned();
        let estimator = "shipped".to_owned();
        let loss = LossRow {
            start_s: 1.5,
            length_s: 6.0,
            reference: ReferenceKind::Truth,
            error_m: Some(3.25),
            sigma_m: None,
            own_error_m: Some(7.5),
        };
        let row = |start_s, error| OutageRow {
            log: log.clone(),
            estimator: estimator.clone(),
            row: row(start_s, error),
        };
        LogOutcome {
            index,
            identity: identity.into(),
            format: Some("ULog".into()),
            autopilot: None,
            duration_s: Some(123.456),
            failure: (index == 2)
                .then(|| LogFailure { kind: Unusable::Lacking, why: "no IMU, \"says\" ünï".into() }),
            rows: if index == 2 { Vec::new() } else { vec![row(1.0, Some(2.5)), row(2.0, None)] },
            losses: vec![NaturalLoss { log: log.clone(), estimator: estimator.clone(), row: loss }],
            log,
        }
    }

    fn shard_of(folder: &Path, index: u32, of: u32, batch: &Provenance) -> PathBuf {
        let shard = Shard::new(index, of).unwrap();
        let mut work = ShardWork::begin(folder, shard, batch.clone()).unwrap();
        let mine: Vec<u64> = (0..LOGS.len()).filter(|i| shard.holds(*i)).map(|i| i as u64).collect();
        // As they are done, not as they are listed.
        for &i in mine.iter().rev() {
            work.keep(&outcome(i, "1")).unwrap();
        }
        work.finish(mine.iter().map(|&i| (i, LOGS[i as usize]))).unwrap().0
    }

    fn all(folder: &Path) -> Vec<LogOutcome> {
        let mut out = Vec::new();
        merged(folder)
            .unwrap()
            .each(|o| {
                out.push(o);
                Ok::<_, FleetError>(())
            })
            .unwrap();
        out
    }

    #[test]
    fn what_shards_keep_comes_together_in_the_order_of_the_list() {
        for of in [1, 2, 3, 7] {
            let folder = tempfile::tempdir().unwrap();
            (0..of).for_each(|i| drop(shard_of(folder.path(), i, of, &batch(1))));
            let told: Vec<LogOutcome> = (0..LOGS.len() as u64).map(|i| outcome(i, "1")).collect();
            assert_eq!(all(folder.path()), told);
            // Nothing but the results is left.
            assert_eq!(fs::read_dir(folder.path()).unwrap().count(), of as usize);
        }
    }

    #[test]
    fn what_is_done_is_known_and_what_has_changed_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = shard_of(folder.path(), 0, 2, &batch(1));
        let bytes = fs::read(&path).unwrap();
        let shard = Shard::new(0, 2).unwrap();
        let again = |batch| ShardWork::begin(folder.path(), shard, batch).unwrap();
        let logs = || [0, 2, 4].into_iter().map(|i| (i, LOGS[i as usize]));
        let work = again(batch(1));
        let known = |of: &[(&str, &str)]| -> BTreeMap<String, String> {
            of.iter().map(|(log, identity)| ((*log).to_owned(), (*identity).to_owned())).collect()
        };
        assert_eq!(work.known(), known(&[("a.ulg", "1"), ("c.bin", "1"), ("e", "1")]));
        let written = fs::metadata(&path).unwrap().modified().unwrap();
        work.finish(logs()).unwrap();
        assert_eq!(fs::metadata(&path).unwrap().modified().unwrap(), written);
        // Killed after one log was done again.
        let mut work = again(batch(1));
        work.keep(&outcome(0, "2")).unwrap();
        drop(work);
        assert_eq!(fs::read(&path).unwrap(), bytes);
        let work = again(batch(1));
        assert_eq!(work.known(), known(&[("a.ulg", "2"), ("c.bin", "1"), ("e", "1")]));
        work.finish(logs()).unwrap();
        let identities: Vec<String> = all(folder.path()).into_iter().map(|o| o.identity).collect();
        assert_eq!(identities, ["2", "1", "1"]);
        // Other outages, or another program: nothing is done.
        assert!(again(batch(2)).known().is_empty());
        assert!(again(Provenance { program: "another".into(), ..batch(1) }).known().is_empty());
    }

    #[test]
    fn what_does_not_belong_together_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let error = |folder: &Path| merged(folder).unwrap_err().to_string();
        assert!(error(folder.path()).contains("no results"));
        assert!(error(&folder.path().join("none")).contains("none"));
        shard_of(folder.path(), 0, 3, &batch(1));
        assert_eq!(merged(folder.path()).unwrap().missing, [1, 2]);
        let other = shard_of(folder.path(), 1, 3, &batch(2));
        assert!(error(folder.path()).contains("another configuration"));
        fs::remove_file(other).unwrap();
        let other = shard_of(folder.path(), 1, 2, &batch(1));
        assert!(error(folder.path()).contains("another number of shards"));
        fs::write(&other, b"PAR1 and no more").unwrap();
        assert!(error(folder.path()).contains("no results of holdover evaluate"));
    }

    thread_local! {
        static BATCH: Provenance = batch(1);
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]
        #[test]
        fn damaged_results_are_read_or_refused(
            hits in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8), cut in any::<Option<prop::sample::Index>>()
        ) {
            let folder = tempfile::tempdir().unwrap();
            // To digest this program takes longer than all else: once.
            let batch = BATCH.with(Clone::clone);
            let path = shard_of(folder.path(), 0, 1, &batch);
            let mut bytes = fs::read(&path).unwrap();
            for (at, byte) in hits {
                let at = at.index(bytes.len());
                bytes[at] = byte;
            }
            if let Some(cut) = cut {
                bytes.truncate(cut.index(bytes.len()));
            }
            fs::write(&path, &bytes).unwrap();
            let _ = merged(folder.path()).map(|m| m.each(|_| Ok::<_, FleetError>(())));
            // What cannot be read is done again.
            let work = ShardWork::begin(folder.path(), Shard::WHOLE, batch).unwrap();
            prop_assert!(work.finish([].into_iter()).is_ok());
        }
    }
}
