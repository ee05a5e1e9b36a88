//! `holdover stress`: faults of every sensor put into logs, in one table.

use std::str::FromStr;

use clap::Args;
use serde::Serialize;

use crate::config::Settings;
use crate::fault::{FaultError, InjectedFault};
use crate::log::{Log, LogError, LogFile};
use crate::replay::matrix::{StressCase, matrix};
use crate::replay::stress::{StressReport, StressRow, stress};
use crate::replay::sweep::survey;

use super::logs::LogArgs;
use super::table::{Table, median, number};
use super::{ConfigArgs, Failure, jobs, warn};

/// Arguments of `stress`.
#[derive(Debug, Args)]
pub struct StressArgs {
    /// Logs
    #[command(flatten)]
    pub logs: LogArgs,
    /// Length of the interval that is scored, s
    #[arg(long, default_value_t = 60.0)]
    pub length: f64,
    /// Starts, spread evenly over the flight
    #[arg(long, default_value_t = 4)]
    pub starts: usize,
    /// Instead of the whole matrix this fault, seconds since the interval's start, as in flow:zero@10..60, or several at once with spaces between them; may be
    /// given several times, a row each
    #[arg(long, value_name = "FAULT")]
    pub fault: Vec<FaultsTogether>,
    /// With --fault: GNSS is there
    #[arg(long, requires = "fault")]
    pub with_gnss: bool,
    /// Logs worked on at the same time; 0 is one a core
    #[arg(long, default_value_t = 0)]
    pub jobs: usize,
    /// Print one JSON object and nothing else
    #[arg(long)]
    pub json: bool,
    /// Settings
    #[command(flatten)]
    pub settings: ConfigArgs,
}

/// Faults that are put in at once: a row of the table.
#[derive(Clone, Debug)]
pub struct FaultsTogether(Vec<InjectedFault>);

impl FromStr for FaultsTogether {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        let faults = text.split_whitespace().map(str::parse).collect::<Result<Vec<_>, _>>()?;
        if faults.is_empty() { Err(FaultError::Form(text.to_owned())) } else { Ok(Self(faults)) }
    }
}

/// The JSON of `--json`.
#[derive(Debug, Serialize)]
struct StressJson<'a> {
    /// A row a fault, over all logs.
    table: &'a [FaultSummary],
    /// Everything that was flown.
    logs: Vec<LogJson<'a>>,
}

#[derive(Debug, Serialize)]
struct LogJson<'a> {
    log: String,
    rows: &'a [StressRow],
    false_alarms: &'a [(String, f64)],
    not_heard: &'a [String],
}

/// One fault over all logs and starts.
#[derive(Debug, Serialize)]
struct FaultSummary {
    fault: String,
    n: usize,
    error_median_m: Option<f64>,
    error_worst_m: Option<f64>,
    sigma_median_m: Option<f64>,
    worst_sigmas: Option<f64>,
    within_2_sigma: Option<f64>,
    within_4_sigma: Option<f64>,
    told: usize,
    told_median_s: Option<f64>,
    told_worst_s: Option<f64>,
    lost: usize,
    blamed_others: usize,
    without_fault_median_m: Option<f64>,
    without_sensor_median_m: Option<f64>,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &StressArgs, quiet: bool) -> Result<(), Failure> {
    if !(args.length.is_finite() && args.length > 0.0) {
        return Err(Failure::Usage(format!("--length: {} is not a length in seconds", args.length)));
    }
    if args.starts == 0 {
        return Err(Failure::Usage("--starts: at least one".into()));
    }
    let cases = cases(args)?;
    let logs = args.logs.find()?;
    let loaded = args.settings.read()?;
    warn(&loaded);
    let reports = jobs::in_parallel(&logs, args.jobs, quiet || args.json, |log| {
        one(log, &loaded.settings, &cases, args)
    })?;
    let rows: Vec<&StressRow> = reports.iter().flat_map(|r| &r.rows).collect();
    let table: Vec<FaultSummary> = cases.iter().filter_map(|case| summary(&case.name, &rows)).collect();
    if args.json {
        let logs = logs.iter().zip(&reports).map(|(log, r)| LogJson {
            log: log.path().display().to_string(),
            rows: &r.rows,
            false_alarms: &r.false_alarms,
            not_heard: &r.not_heard,
        });
        let json = StressJson { table: &table, logs: logs.collect() };
        outln!("{}", serde_json::to_string(&json).map_err(|e| Failure::Other(e.to_string()))?);
    } else {
        print(args, &logs, &table, &reports);
    }
    Ok(())
}

/// What is put in: the matrix, or what the arguments name.
fn cases(args: &StressArgs) -> Result<Vec<StressCase>, Failure> {
    if args.fault.is_empty() {
        return matrix(args.length).map_err(|e| Failure::Other(e.to_string()));
    }
    let case = |together: &FaultsTogether| StressCase {
        name: together.0.iter().map(InjectedFault::to_string).collect::<Vec<_>>().join(" "),
        faults: together.0.clone(),
        outage: !args.with_gnss,
    };
    Ok(args.fault.iter().map(case).collect())
}

fn one(
    log: &LogFile,
    settings: &Settings,
    cases: &[StressCase],
    args: &StressArgs,
) -> Result<StressReport, LogError> {
    let log = Log::of(log.clone(), settings.system)?;
    let flights = survey(&log)?.flights;
    stress(&log, &settings.pipeline, &flights, cases, args.length, args.starts)
}

/// One fault over all rows that are its; `None` where there are none.
fn summary(fault: &str, rows: &[&StressRow]) -> Option<FaultSummary> {
    let rows: Vec<&StressRow> = rows.iter().filter(|r| r.fault == fault).copied().collect();
    if rows.is_empty() {
        return None;
    }
    let of = |f: fn(&StressRow) -> Option<f64>| -> Vec<f64> { rows.iter().filter_map(|r| f(r)).collect() };
    let sigmas = of(|r| r.worst_sigmas);
    let within = |bound: f64| {
        let inside = sigmas.iter().filter(|s| **s <= bound).count();
        (!sigmas.is_empty()).then(|| inside as f64 / sigmas.len() as f64)
    };
    let told = of(|r| r.told_after_s);
    Some(FaultSummary {
        fault: fault.to_owned(),
        n: rows.len(),
        error_median_m: median(of(|r| r.error_m)),
        error_worst_m: worst(&of(|r| r.error_m)),
        sigma_median_m: median(of(|r| r.sigma_m)),
        worst_sigmas: worst(&sigmas),
        within_2_sigma: within(2.0),
        within_4_sigma: within(4.0),
        told: told.len(),
        told_worst_s: worst(&told),
        told_median_s: median(told),
        lost: rows.iter().filter(|r| r.lost_after_s.is_some()).count(),
        blamed_others: rows.iter().filter(|r| !r.blamed.is_empty()).count(),
        without_fault_median_m: median(of(|r| r.error_without_fault_m)),
        without_sensor_median_m: median(of(|r| r.error_without_sensor_m)),
    })
}

fn worst(values: &[f64]) -> Option<f64> {
    values.iter().copied().reduce(f64::max)
}

fn print(args: &StressArgs, logs: &[LogFile], table: &[FaultSummary], reports: &[StressReport]) {
    outln!(
        "Faults in intervals of {} s, outages of GNSS unless it says otherwise; horizontal errors at the end, median / worst; \
         sigmas: the largest error over what was claimed then",
        args.length
    );
    let mut shown = Table::new(&[
        "fault",
        "n",
        "error m",
        "worst m",
        "sigma m",
        "sigmas",
        "<=2",
        "<=4",
        "told",
        "after s",
        "worst s",
        "lost",
        "blames",
        "no fault",
        "no sensor",
    ]);
    let percent = |part: Option<f64>| number(part.map(|p| 100.0 * p), 0);
    for s in table {
        shown.row(vec![
            s.fault.clone(),
            s.n.to_string(),
            number(s.error_median_m, 1),
            number(s.error_worst_m, 1),
            number(s.sigma_median_m, 1),
            number(s.worst_sigmas, 1),
            percent(s.within_2_sigma),
            percent(s.within_4_sigma),
            s.told.to_string(),
            number(s.told_median_s, 1),
            number(s.told_worst_s, 1),
            s.lost.to_string(),
            s.blamed_others.to_string(),
            number(s.without_fault_median_m, 1),
            number(s.without_sensor_median_m, 1),
        ]);
    }
    shown.print();
    for (log, report) in logs.iter().zip(reports) {
        let path = log.path();
        for (source, t_s) in &report.false_alarms {
            outln!("  {}: {source} called faulty at {t_s:.1} s, nothing put in", path.display());
        }
        if report.rows.is_empty() {
            outln!("  {}: no interval of {} s in flight fits", path.display(), args.length);
        } else if !report.not_heard.is_empty() {
            outln!("  {}: not in it: {}", path.display(), report.not_heard.join(", "));
        }
    }
}
