//! `holdover evaluate`: outages slid over the airborne, moving part of logs, in one table, or, of a fleet, in Parquet.

mod json;
mod peers;
mod shards;
mod tables;
mod work;

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use clap::Args;

use crate::fleet::{self, LogFailure, LogOutcome, Recipe, Unusable};
use crate::log::LogFile;
use crate::report::FleetSheet;

use super::logs;
use super::report::PageFile;
use super::{ConfigArgs, Failure, jobs, warn};

use json::JsonPrinter;
use peers::PeerResults;
use tables::Tables;
use work::Question;

/// Arguments of `evaluate`.
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// Logs, folders of logs, addresses (s3://, gs://, az://, http(s)://), or - for standard input
    #[arg(value_name = "LOG", required_unless_present_any = ["list", "merge"])]
    pub logs: Vec<PathBuf>,
    /// Look for logs in the folders below as well
    #[arg(long)]
    pub recursive: bool,
    /// Logs, folders and addresses from a file, one a line; - for standard input
    #[arg(long, value_name = "FILE")]
    pub list: Option<PathBuf>,
    /// Lengths of the outages, s
    #[arg(long, value_delimiter = ',', default_value = "60,120,300")]
    pub lengths: Vec<f64>,
    /// Starts an outage length, spread evenly over the flight
    #[arg(long, default_value_t = 8)]
    pub starts: usize,
    /// Estimators to compare
    #[arg(long, value_delimiter = ',', default_value = "shipped,inertial")]
    pub estimator: Vec<String>,
    /// Logs worked on at the same time; 0 is one a core
    #[arg(long, default_value_t = 0)]
    pub jobs: usize,
    /// Print one JSON object and nothing else
    #[arg(long)]
    pub json: bool,
    /// Write a page of all flights together: a row each, distributions, the worst
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Overwrite a page that is there
    #[arg(long, requires = "report")]
    pub force: bool,
    /// A CSV of somebody else's results on the same outages, to be shown beside ours; may be given several times
    #[arg(long, value_name = "FILE")]
    pub peer: Vec<PathBuf>,
    /// A fleet
    #[command(flatten)]
    pub fleet: FleetArgs,
    /// Settings
    #[command(flatten)]
    pub settings: ConfigArgs,
}

/// What is for many logs.
#[derive(Debug, Args)]
pub struct FleetArgs {
    /// Write the results to a file of Parquet in this folder, and go on where an earlier run was ended
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Work on shard I of N (from 0), or the one that an array of jobs says: auto, or auto/N
    #[arg(long, value_name = "I/N", requires = "out")]
    pub shard: Option<String>,
    /// Show what all shards in a folder say together, and work on nothing
    #[arg(long, value_name = "DIR", conflicts_with_all = ["out", "logs", "list"])]
    pub merge: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &EvaluateArgs, quiet: bool) -> Result<(), Failure> {
    let peers = PeerResults::read(&args.peer)?;
    if let Some(folder) = &args.fleet.merge {
        return shards::merge(folder, args, &peers);
    }
    if let Some(wrong) = args.lengths.iter().find(|l| !(l.is_finite() && **l > 0.0)) {
        return Err(Failure::Usage(format!("--lengths: {wrong} is not a length in seconds")));
    }
    if args.starts == 0 {
        return Err(Failure::Usage("--starts: at least one".into()));
    }
    let (question, recipe) = question(args)?;
    let logs = logs(args)?;
    if args.fleet.out.is_some() && args.report.is_some() {
        return Err(Failure::Usage("--report: a shard is no fleet; give it with --merge".into()));
    }
    if let Some(folder) = &args.fleet.out {
        return shards::work(folder, args, quiet, (&question, &recipe), &logs);
    }
    let mut report = Report::new(args, &args.lengths, &peers)?;
    let mut waiting = BTreeMap::new();
    let mut next = 0;
    let inner = threads_a_log(args.jobs, logs.len());
    let places: Vec<usize> = (0..logs.len()).collect();
    jobs::as_done(
        &places,
        args.jobs,
        quiet | args.json,
        |&i| question.ask(i as u64, &logs[i], String::new(), inner),
        |i, outcome| {
            waiting.insert(i, outcome);
            while let Some(outcome) = waiting.remove(&next) {
                report.add(&outcome)?;
                next += 1;
            }
            Ok(())
        },
    )?;
    report.finish()
}

/// Estimators that are worked on at the same time in one log, where there are fewer logs than cores.
fn threads_a_log(jobs: usize, logs: usize) -> usize {
    (jobs::threads(jobs, usize::MAX) / jobs::threads(jobs, logs)).max(1)
}

fn question(args: &EvaluateArgs) -> Result<(Question, Recipe), Failure> {
    let (mut settings, mut in_force) = (Vec::new(), String::new());
    for (i, name) in args.estimator.iter().enumerate() {
        // How far it drifts is the question: an estimate that is called lost is scored as well.
        let loaded = args.settings.with_estimator(name).read()?;
        if i == 0 {
            warn(&loaded);
        }
        for key in &loaded.in_force {
            in_force.push_str(&format!("{} = {}\n", key.path(), key.value_toml()));
        }
        settings.push(loaded.settings);
    }
    let recipe = Recipe {
        lengths_s: args.lengths.clone(),
        starts: args.starts,
        estimators: args.estimator.clone(),
        settings: in_force,
    };
    Ok((Question { settings, lengths_s: args.lengths.clone(), starts: args.starts }, recipe))
}

/// The logs, each once.
fn logs(args: &EvaluateArgs) -> Result<Vec<LogFile>, Failure> {
    let mut names = args.logs.clone();
    if let Some(list) = &args.list {
        names.extend(fleet::listed(list).map_err(|e| Failure::Usage(format!("--list: {e}")))?);
    }
    let mut logs = logs::find(&names, args.recursive)?;
    let mut seen = BTreeSet::new();
    logs.retain(|log| seen.insert(log.path().to_owned()));
    Ok(logs)
}

/// Where outcomes go, in the order of the logs.
enum Printer<'a> {
    Tables(Tables<'a>),
    Json(JsonPrinter<'a>),
}

/// What is shown of all logs together, however they were worked on.
struct Report<'a> {
    printer: Printer<'a>,
    rows: u64,
    readable: u64,
    failures: Vec<(String, LogFailure)>,
    page: Option<(PageFile, FleetSheet)>,
}

impl<'a> Report<'a> {
    fn new(args: &EvaluateArgs, lengths_s: &[f64], peers: &'a PeerResults) -> Result<Self, Failure> {
        let page = args.report.as_deref().map(|path| PageFile::create(path, args.force)).transpose()?;
        let page = page.map(|page| (page, FleetSheet::default()));
        let printer = if args.json {
            Printer::Json(JsonPrinter::new(peers))
        } else {
            Printer::Tables(Tables::new(lengths_s, peers))
        };
        Ok(Self { printer, rows: 0, readable: 0, failures: Vec::new(), page })
    }

    fn add(&mut self, outcome: &LogOutcome) -> Result<(), Failure> {
        self.rows += (outcome.rows.len() + outcome.losses.len()) as u64;
        let unreadable = outcome.failure.as_ref().is_some_and(|f| f.kind == Unusable::Unreadable);
        self.readable += u64::from(!unreadable);
        self.failures.extend(outcome.failure.clone().map(|f| (outcome.log.clone(), f)));
        if let Some((_, sheet)) = &mut self.page {
            sheet.add(outcome);
        }
        match &mut self.printer {
            Printer::Tables(tables) => tables.add(outcome),
            Printer::Json(json) => json.add(outcome)?,
        }
        Ok(())
    }

    /// Prints what there is; where there is nothing, it fails as the logs did.
    fn finish(self) -> Result<(), Failure> {
        let line = |(log, failure): &(String, LogFailure)| match failure.kind {
            // The reason names the log.
            Unusable::Unreadable => failure.why.clone(),
            Unusable::Lacking => format!("{log}: {}", failure.why),
        };
        if self.rows == 0 {
            let why = self.failures.iter().map(line).collect::<Vec<_>>().join("\n");
            return Err(if self.readable == 0 { Failure::Unreadable(why) } else { Failure::Lacking(why) });
        }
        if let Some((page, sheet)) = self.page {
            page.text(&sheet.page())?;
        }
        match self.printer {
            Printer::Tables(tables) => tables.print(),
            Printer::Json(json) => json.finish()?,
        }
        for failure in &self.failures {
            errln!("holdover: {}", line(failure));
        }
        Ok(())
    }
}
