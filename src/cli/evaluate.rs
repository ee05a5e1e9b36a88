//! `holdover evaluate`: outages slid over the airborne, moving part of logs, in one table.

use std::fmt;
use std::path::Path;

use clap::Args;
use serde::Serialize;

use crate::config::Settings;
use crate::log::{Log, LogError, LogFile};
use crate::navigator::settings::Estimator;
use crate::replay::losses::{LEAST_S, LossRow, losses};
use crate::replay::runner::ReferenceKind;
use crate::replay::sweep::{SETTLE_S, SweepRow, survey, sweep};

use super::inspect::lacking;
use super::logs::LogArgs;
use super::table::{Table, median, number};
use super::{ConfigArgs, Failure, jobs, warn};

/// Arguments of `evaluate`.
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// Logs
    #[command(flatten)]
    pub logs: LogArgs,
    /// Lengths of the outages, s
    #[arg(long, value_delimiter = ',', default_value = "60,120,300")]
    pub lengths: Vec<f64>,
    /// Starts an outage length, spread evenly over the flight
    #[arg(long, default_value_t = 8)]
    pub starts: usize,
    /// Estimators to compare
    #[arg(long, value_delimiter = ',', default_value = "shipped,inertial")]
    pub estimator: Vec<String>,
    /// Logs and estimators worked on at the same time; 0 is one a core
    #[arg(long, default_value_t = 0)]
    pub jobs: usize,
    /// Print one JSON object and nothing else
    #[arg(long)]
    pub json: bool,
    /// Settings
    #[command(flatten)]
    pub settings: ConfigArgs,
}

/// One line of `--json`.
#[derive(Clone, Debug, Serialize)]
struct OutageRow {
    log: String,
    estimator: &'static str,
    #[serde(flatten)]
    row: SweepRow,
}

/// A loss of GNSS that a log holds.
#[derive(Clone, Debug, Serialize)]
struct NaturalLoss {
    log: String,
    estimator: &'static str,
    #[serde(flatten)]
    row: LossRow,
}

/// A log without rows, and why.
#[derive(Clone, Debug, Serialize)]
struct WithoutRows {
    log: String,
    why: String,
}

#[derive(Default, Serialize)]
struct Evaluation {
    rows: Vec<OutageRow>,
    losses: Vec<NaturalLoss>,
    without_rows: Vec<WithoutRows>,
}

/// One log with one estimator.
struct Job {
    log: LogFile,
    settings: Settings,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &EvaluateArgs) -> Result<(), Failure> {
    if let Some(wrong) = args.lengths.iter().find(|l| !(l.is_finite() && **l > 0.0)) {
        return Err(Failure::Usage(format!("--lengths: {wrong} is not a length in seconds")));
    }
    if args.starts == 0 {
        return Err(Failure::Usage("--starts: at least one".into()));
    }
    let logs = args.logs.find()?;
    let mut jobs = Vec::new();
    for (i, log) in logs.iter().enumerate() {
        for (j, name) in args.estimator.iter().enumerate() {
            // How far it drifts is the question: an estimate that is called lost is scored as well.
            let loaded = args.settings.with_estimator(name).read()?;
            if (i, j) == (0, 0) {
                warn(&loaded);
            }
            jobs.push(Job { log: log.clone(), settings: loaded.settings });
        }
    }
    let done = jobs::in_parallel(&jobs, args.jobs, args.json, |job| Ok::<_, Failure>(one(job, args)))?;
    let all = together(&jobs, done)?;
    if all.rows.is_empty() && all.losses.is_empty() {
        let why = all.without_rows.iter().map(|w| format!("{}: {}", w.log, w.why)).collect::<Vec<_>>();
        return Err(Failure::Lacking(why.join("\n")));
    }
    if args.json {
        outln!("{}", serde_json::to_string(&all).map_err(|e| Failure::Other(e.to_string()))?);
    } else {
        print_table(&all.rows, &logs, args);
        print_losses(&all.losses);
    }
    for without in &all.without_rows {
        errln!("holdover: {}: {}", without.log, without.why);
    }
    Ok(())
}

/// What came of all jobs. One that cannot be read costs itself, among others.
fn together(jobs: &[Job], done: Vec<Result<Evaluation, LogError>>) -> Result<Evaluation, Failure> {
    let mut all = Evaluation::default();
    let (mut failed, mut read) = (None, 0);
    for (job, done) in jobs.iter().zip(done) {
        match done {
            Ok(one) => {
                read += 1;
                all.rows.extend(one.rows);
                all.losses.extend(one.losses);
                all.without_rows.extend(one.without_rows);
            }
            Err(error) => all
                .without_rows
                .push(WithoutRows { log: name(&job.log), why: failed.insert(error).to_string() }),
        }
    }
    all.without_rows.dedup_by(|a, b| a.log == b.log);
    if let Some(error) = failed.filter(|_| read == 0) {
        return Err(Failure::Log(error));
    }
    Ok(all)
}

fn one(job: &Job, args: &EvaluateArgs) -> Result<Evaluation, LogError> {
    let log = Log::of(job.log.clone(), job.settings.system)?;
    let (pipeline, name) = (&job.settings.pipeline, name(&job.log));
    let survey = survey(&log)?;
    let estimator = pipeline.navigator.estimator.label();
    let without = |why: String| Evaluation {
        without_rows: vec![WithoutRows { log: name.clone(), why }],
        ..Evaluation::default()
    };
    if let Some(why) = lacking(&survey.heard, &survey.imu) {
        return Ok(without(why));
    }
    let Some((from, to)) = survey.airborne else {
        return Ok(without("the vehicle does not fly in it".to_owned()));
    };
    let mut found = Vec::new();
    if survey.longest_loss_s >= LEAST_S {
        found = losses(&log, pipeline, survey.airborne)?;
    }
    let rows = sweep(&log, pipeline, survey.airborne, &args.lengths, args.starts)?;
    let mut all = Evaluation::default();
    if rows.is_empty() {
        all = without(format!(
            "no outage of these lengths fits into its flight of {:.0} s, of which {SETTLE_S} s are to settle in",
            to - from
        ));
    }
    all.rows = rows.into_iter().map(|row| OutageRow { log: name.clone(), estimator, row }).collect();
    all.losses = found.into_iter().map(|row| NaturalLoss { log: name.clone(), estimator, row }).collect();
    Ok(all)
}

/// The losses that are in the logs, where the autopilot's own filter is a peer: in the outages above it had GNSS.
fn print_losses(losses: &[NaturalLoss]) {
    if losses.is_empty() {
        return;
    }
    outln!(
        "\nLosses of GNSS in the logs themselves; \"own\" is the autopilot's own estimate, which had no GNSS either"
    );
    let mut table =
        Table::new(&["log", "estimator", "at s", "length s", "error m", "sigma m", "own m", "against"]);
    for loss in losses {
        let short = Path::new(&loss.log).file_stem().map(|s| s.to_string_lossy().into_owned());
        table.row(vec![
            short.unwrap_or_default(),
            loss.estimator.into(),
            number(Some(loss.row.start_s), 1),
            number(Some(loss.row.length_s), 1),
            number(loss.row.error_m, 1),
            number(loss.row.sigma_m, 1),
            number(loss.row.own_error_m, 1),
            match loss.row.reference {
                ReferenceKind::Truth => "truth".into(),
                ReferenceKind::Gnss => "the first fix".into(),
            },
        ]);
    }
    table.print();
}

fn name(log: &LogFile) -> String {
    log.path().display().to_string()
}

fn print_table(rows: &[OutageRow], logs: &[LogFile], args: &EvaluateArgs) {
    outln!(
        "Horizontal error at the end of an outage: median / worst m, drift in % of distance (median), error over sigma (median)"
    );
    let mut table = Table::new(&[
        "log",
        "estimator",
        "length s",
        "n",
        "median m",
        "worst m",
        "drift %",
        "error/sigma",
        "altitude m",
    ]);
    for file in logs {
        let log = name(file);
        for estimator in Estimator::ALL {
            for &length in &args.lengths {
                let group: Vec<&SweepRow> = rows
                    .iter()
                    .filter(|r| r.log == log && r.estimator == estimator.label() && r.row.length_s == length)
                    .map(|r| &r.row)
                    .collect();
                if group.is_empty() {
                    continue;
                }
                let of = |f: fn(&SweepRow) -> Option<f64>| -> Vec<f64> {
                    group.iter().filter_map(|r| f(r)).collect()
                };
                let errors = of(|r| r.horizontal_error_end_m);
                let worst =
                    errors.iter().copied().fold(None, |m: Option<f64>, e| Some(m.map_or(e, |m| m.max(e))));
                let ratio = of(|r| Some(r.horizontal_error_end_m? / r.sigma_end_m.filter(|s| *s > 0.0)?));
                let short = file.path().file_stem().map_or(log.clone(), |s| s.to_string_lossy().into_owned());
                table.row(vec![
                    short,
                    estimator.label().into(),
                    format!("{length}"),
                    errors.len().to_string(),
                    number(median(errors), 1),
                    number(worst, 1),
                    number(median(of(|r| r.drift_percent)), 2),
                    number(median(ratio), 2),
                    number(median(of(|r| r.altitude_rmse_m)), 2),
                ]);
            }
        }
    }
    table.print();
    for estimator in Estimator::ALL {
        let all = rows.iter().filter(|r| r.estimator == estimator.label()).map(|r| &r.row);
        if let Some(honesty) = Honesty::of(all) {
            outln!("  {}: {honesty}", estimator.label());
        }
    }
}

/// Whether what was claimed was true, over many outages.
struct Honesty {
    outages: usize,
    /// Parts of the errors within two and within four of their sigmas.
    within: [f64; 2],
    /// Root mean square of sigma over that of the error.
    caution: f64,
}

impl Honesty {
    fn of<'a>(rows: impl Iterator<Item = &'a SweepRow>) -> Option<Self> {
        let pairs: Vec<(f64, f64)> = rows
            .filter_map(|r| Some((r.horizontal_error_end_m?, r.sigma_end_m.filter(|s| *s > 0.0)?)))
            .collect();
        let n = pairs.len();
        let part = |k: f64| pairs.iter().filter(|(e, s)| *e <= k * s).count() as f64 / n as f64;
        let squares = |f: fn(&(f64, f64)) -> f64| pairs.iter().map(|p| f(p).powi(2)).sum::<f64>();
        (n > 0).then(|| Self {
            outages: n,
            within: [part(2.0), part(4.0)],
            caution: (squares(|p| p.1) / squares(|p| p.0)).sqrt(),
        })
    }
}

impl fmt::Display for Honesty {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [two, four] = self.within.map(|part| 100.0 * part);
        write!(
            f,
            "{} outages, {two:.1} % of the errors within 2 sigma, {four:.1} % within 4, sigma {:.1} times the error (RMS)",
            self.outages, self.caution
        )
    }
}
