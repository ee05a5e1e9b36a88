//! `evaluate --out` and `evaluate --merge`: a shard's part of a list, and all of them together.

use std::path::Path;

use serde::Serialize;

use crate::fleet::{
    self, FleetError, LogFailure, LogOutcome, Provenance, Recipe, Shard, ShardWork, Unusable,
};
use crate::log::LogFile;

use super::super::{Failure, jobs};
use super::peers::PeerResults;
use super::work::Question;
use super::{EvaluateArgs, Report, threads_a_log};

impl From<FleetError> for Failure {
    fn from(e: FleetError) -> Self {
        match e {
            FleetError::Io(e) => e.into(),
            FleetError::NotResults { .. } | FleetError::Mixed(_) => Failure::Unreadable(e.to_string()),
            FleetError::Busy { .. } => Failure::Other(e.to_string()),
        }
    }
}

/// What a shard tells at its end.
#[derive(Debug, Serialize)]
struct ShardReport {
    results: String,
    shard: String,
    logs: usize,
    done_before: usize,
    done_now: usize,
    without_rows: usize,
}

/// A log of this shard.
struct ShardJob<'a> {
    index: u64,
    file: &'a LogFile,
    name: String,
}

/// What became of it now.
enum Done {
    /// It was done before, as it is now.
    Before,
    Now(LogOutcome),
}

/// Works on a shard of the logs.
///
/// # Errors
/// What cannot be written. A log that cannot be read is none: its reason is in the results.
pub(super) fn work(
    folder: &Path,
    args: &EvaluateArgs,
    quiet: bool,
    (question, recipe): (&Question, &Recipe),
    logs: &[LogFile],
) -> Result<(), Failure> {
    let text = args.fleet.shard.as_deref();
    let shard = text.map(|text| Shard::parse(text, |name| std::env::var(name).ok())).transpose();
    let shard = shard.map_err(|e| Failure::Usage(format!("--shard: {e}")))?.unwrap_or(Shard::WHOLE);
    let names: Vec<String> = logs.iter().map(|log| log.path().display().to_string()).collect();
    let mut work = ShardWork::begin(folder, shard, Provenance::of(recipe, names.iter().map(String::as_str)))?;
    let mine: Vec<ShardJob<'_>> = (logs.iter().zip(names).enumerate())
        .filter(|(place, _)| shard.holds(*place))
        .map(|(place, (file, name))| ShardJob { index: place as u64, file, name })
        .collect();
    let (mut before, mut now) = (0, 0);
    let threads = threads_a_log(args.jobs, mine.len());
    let known = work.known();
    jobs::as_done(
        &mine,
        args.jobs,
        quiet | args.json,
        |job| match job.file.identity() {
            Ok(identity) if known.get(&job.name) == Some(&identity) => Done::Before,
            Ok(identity) => Done::Now(question.ask(job.index, job.file, identity, threads)),
            // It is tried again by the next run.
            Err(error) => Done::Now(LogOutcome {
                index: job.index,
                log: job.name.clone(),
                failure: Some(LogFailure { kind: Unusable::Unreadable, why: error.to_string() }),
                ..LogOutcome::default()
            }),
        },
        |_, done| {
            match done {
                Done::Before => before += 1,
                Done::Now(outcome) => {
                    now += 1;
                    work.keep(&outcome)?;
                }
            }
            Ok(())
        },
    )?;
    let (path, without_rows) = work.finish(mine.iter().map(|job| (job.index, job.name.as_str())))?;
    let report = ShardReport {
        results: path.display().to_string(),
        shard: shard.to_string(),
        logs: mine.len(),
        done_before: before,
        done_now: now,
        without_rows,
    };
    tell(&report, args.json)
}

fn tell(report: &ShardReport, json: bool) -> Result<(), Failure> {
    if json {
        outln!("{}", serde_json::to_string(report).map_err(|e| Failure::Other(e.to_string()))?);
        return Ok(());
    }
    let ShardReport { results, shard, logs, done_before, done_now, without_rows } = report;
    outln!(
        "{results}: shard {shard}, {logs} logs, {done_before} done before, {done_now} now, {without_rows} without rows"
    );
    Ok(())
}

/// Shows what all shards in a folder say together, as one run over the whole list would.
///
/// # Errors
/// [`Failure::Unreadable`]; [`Failure::Lacking`] after all is shown, where shards are missing.
pub(super) fn merge(folder: &Path, args: &EvaluateArgs, peers: &PeerResults) -> Result<(), Failure> {
    let merged = fleet::merged(folder)?;
    let mut report = Report::new(args, &merged.batch.lengths_s, peers)?;
    merged.each(|outcome| report.add(&outcome))?;
    let shown = report.finish();
    if merged.missing.is_empty() {
        return shown;
    }
    if let Err(failure) = shown {
        errln!("holdover: {failure}");
    }
    let missing: Vec<String> = merged.missing.iter().map(u32::to_string).collect();
    Err(Failure::Lacking(format!("{}: shards are missing: {}", folder.display(), missing.join(", "))))
}
