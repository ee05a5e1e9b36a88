//! The Monte Carlo of Contreras and Hajiyev's fault-tolerant altimeter, every filter on the same runs.
//!
//! `cargo run --release --example paper_altimeter -- --seed 1 --runs 200 [--bias 20 --variance 100] [--json]`
//!
//! The parameters are those of the paper's Table 1, the truth is drawn from the model itself, the error is that of the estimated error of
//! the inertial altitude, over all steps of all runs. Cases 0 to 5 are the paper's scenarios (600 steps of 0.5 s, faults on iterations 200
//! to 400); the others are described at `holdover::sim::altimeter::FaultCase`. Filters and schemes: `holdover::altimeter::{AltimeterMethod, AltimeterScheme}`.
//! The oracle is a joint filter that is told which channel is faulty and how, from when to when: a noisy one has its true variance, the
//! bias of a biased one is an unknown constant. It and the project's own altimeter, `default`, use both channels in one filter: their `ibi` and
//! `iig` are the same filter with the other channel missing.

use std::io::Write;
use std::process::ExitCode;

use clap::Parser;
use holdover::sim::altimeter::{FaultCase, FaultSize};
use serde::Serialize;

#[path = "../tests/support/altimeter/mod.rs"]
mod altimeter;
#[path = "../tests/support/jobs.rs"]
mod jobs;
use altimeter::{Filter, MonteCarlo, Outcome, SCHEMES};

const DEFINITIONS: &str = "\
Faults are on iterations 200 to 400 of 600, but: permanent (and permanent_gps) from 200 to the end of 1500; staggered on 150 to 300 \
(barometer) and 250 to 400 (GNSS); ramps grow by 0.05 m/s to 5 m and are gone then; outages take both channels away for 200, 800 and \
3200 iterations, 400 follow.

locked_percent: the share of runs in which, over the 20 steps that begin 50 steps after the last fault or outage has cleared (the last 20 \
of the run where none clears), a healthy channel has a mean weight below 0.5, or the mean size of the error exceeds 5 m.

Of filters that name faulty channels: false_alarm_percent, runs with an alarm before any fault; detection_delay_steps, mean from onset to \
alarm; isolation_right_percent, runs in which every faulty channel has its alarm and no other; isolation_wrong_percent, runs in which a \
channel that is never faulty has one after the onset.";

#[derive(Parser)]
#[command(about = "The published altimeters and an oracle in Monte Carlo runs with faults", after_long_help = DEFINITIONS)]
struct Args {
    /// Seed of the runs
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Runs a case
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    runs: u32,
    /// Bias of a biased channel, m
    #[arg(long, default_value_t = 20.0, value_parser = bias, allow_negative_numbers = true)]
    bias: f64,
    /// Factor on the variance of a noisy channel
    #[arg(long, default_value_t = 100.0, value_parser = factor, allow_negative_numbers = true)]
    variance: f64,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

fn bias(text: &str) -> Result<f64, String> {
    let metres = text.parse::<f64>().ok().filter(|b| b.abs() <= 1e5);
    metres.ok_or_else(|| "a bias is a number of metres, at most 1e5".into())
}

fn factor(text: &str) -> Result<f64, String> {
    let factor = text.parse::<f64>().ok().filter(|v| (1.0..=1e8).contains(v));
    factor.ok_or_else(|| "a variance factor is a number from 1 to 1e8".into())
}

#[derive(Serialize)]
struct Row {
    case: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    outage_steps: Option<usize>,
    bias_m: f64,
    variance_factor: f64,
    filter: &'static str,
    scheme: &'static str,
    mean_abs_m: f64,
    std_m: f64,
    rms_m: f64,
    max_m: f64,
    locked_percent: f64,
    #[serde(flatten)]
    alarms: Option<Alarms>,
}

/// Of the fused scheme of a filter that names faulty channels.
#[derive(Serialize)]
struct Alarms {
    false_alarm_percent: Option<f64>,
    detection_delay_steps: Option<f64>,
    isolation_right_percent: Option<f64>,
    isolation_wrong_percent: Option<f64>,
}

fn rows(size: FaultSize, case: FaultCase, filter: Filter, outcome: &Outcome) -> Vec<Row> {
    let of_scheme = |(i, (_, scheme)): (usize, &(_, &'static str))| {
        let score = &outcome.scores[i];
        let detection = outcome.detection.filter(|_| i + 1 == SCHEMES.len());
        Row {
            case: case.label(),
            outage_steps: if let FaultCase::Outage(steps) = case { Some(steps) } else { None },
            bias_m: size.bias_m,
            variance_factor: size.variance_factor,
            filter: filter.label(),
            scheme,
            mean_abs_m: score.mean_abs_m(),
            std_m: score.std_m(),
            rms_m: score.rms_m(),
            max_m: score.max_m(),
            locked_percent: score.locked_percent(),
            alarms: detection.map(|d| Alarms {
                false_alarm_percent: d.false_alarm_percent(),
                detection_delay_steps: d.delay_steps(),
                isolation_right_percent: d.right_percent(),
                isolation_wrong_percent: d.wrong_percent(),
            }),
        }
    };
    SCHEMES.iter().enumerate().map(of_scheme).collect()
}

/// Every filter on every case.
fn run(args: &Args) -> Vec<Row> {
    let size = FaultSize { bias_m: args.bias, variance_factor: args.variance };
    let monte_carlo = MonteCarlo { seed: args.seed, runs: args.runs, size };
    let jobs: Vec<(FaultCase, Filter)> =
        FaultCase::ALL.iter().flat_map(|&c| Filter::ALL.iter().map(move |&f| (c, f))).collect();
    let done = jobs::all("cases", &jobs, |&(c, f)| rows(size, c, f, &monte_carlo.outcome(c, f)));
    done.into_iter().flatten().collect()
}

fn print(args: &Args, rows: &[Row]) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    if args.json {
        return writeln!(out, "{}", serde_json::json!({ "rows": rows }));
    }
    writeln!(
        out,
        "Error of the altitude, m: {} runs of seed {}, bias {} m, variance x {}; --help defines the columns",
        args.runs, args.seed, args.bias, args.variance
    )?;
    writeln!(
        out,
        "  {:13} {:>6} {:10} {:6} {:>8} {:>8} {:>8} {:>8} {:>8} {:>8} {:>8} {:>8} {:>8}",
        "case",
        "steps",
        "filter",
        "scheme",
        "mean |e|",
        "std",
        "RMS",
        "max",
        "locked %",
        "false %",
        "delay",
        "right %",
        "wrong %"
    )?;
    let number = |v: Option<f64>| v.map_or("-".to_owned(), |v| format!("{v:.1}"));
    for r in rows {
        write!(
            out,
            "  {:13} {:>6} {:10} {:6} {:>8.2} {:>8.2} {:>8.2} {:>8.2} {:>8.1}",
            r.case,
            r.outage_steps.map_or(String::new(), |s| s.to_string()),
            r.filter,
            r.scheme,
            r.mean_abs_m,
            r.std_m,
            r.rms_m,
            r.max_m,
            r.locked_percent
        )?;
        if let Some(a) = &r.alarms {
            let columns = [
                a.false_alarm_percent,
                a.detection_delay_steps,
                a.isolation_right_percent,
                a.isolation_wrong_percent,
            ];
            columns.iter().try_for_each(|&v| write!(out, " {:>8}", number(v)))?;
        }
        writeln!(out)?;
    }
    Ok(())
}

fn main() -> ExitCode {
    let args = Args::parse();
    match print(&args, &run(&args)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            let _ = writeln!(std::io::stderr(), "paper_altimeter: {e}");
            ExitCode::FAILURE
        }
    }
}
