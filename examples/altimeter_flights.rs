//! The published height of recorded flights against the simulator's truth, every altimeter on the same flights.
//!
//! `cargo run --release --example altimeter_flights -- LOG… [--filters default,okf,rkf,rkf_joseph,selector] [--outage A..B]`
//!
//! The whole navigator flies the log with `navigator.altimeter` set to one after the other. Where a log has no truth, the barometer stands in (`baro`
//! in the table): the first one heard, counted from where the height was in the first five seconds after alignment. That is a reference
//! where the barometer is the healthy source, and no more than a hint elsewhere.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Parser;
use holdover::altimeter::Fault;
use holdover::log::Log;
use serde::Serialize;

#[path = "../tests/support/args.rs"]
mod args;
#[path = "../tests/support/heights.rs"]
mod heights;
use args::{SettingsArgs, interval};
use heights::{Heights, Told};

const FILTERS: [&str; 5] = ["default", "okf", "rkf", "rkf_joseph", "selector"];

#[derive(Parser)]
#[command(about = "The height of recorded flights, every altimeter on the same flights")]
struct Args {
    /// Telemetry logs (.tlog)
    #[arg(required = true)]
    logs: Vec<PathBuf>,
    /// Which altimeters
    #[arg(long, value_delimiter = ',', default_values = ["default", "okf"], value_parser = FILTERS)]
    filters: Vec<String>,
    /// Withhold GNSS from A to B, seconds since the first sample; may be given several times
    #[arg(long, value_name = "A..B", value_parser = interval)]
    outage: Vec<(f64, f64)>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Write a CSV per flight and altimeter into this folder
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Settings
    #[command(flatten)]
    settings: SettingsArgs,
}

#[derive(Serialize)]
struct Row {
    log: String,
    filter: String,
    outages: Vec<(f64, f64)>,
    reference: Option<&'static str>,
    altitude_rmse_m: Option<f64>,
    altitude_max_m: Option<f64>,
    largest_step_m: f64,
    largest_step_s: f64,
    within_2_sigma_percent: Option<f64>,
    resets: usize,
    faults: Vec<FaultRow>,
}

#[derive(Serialize)]
struct FaultRow {
    channel: &'static str,
    kind: &'static str,
    since_s: f64,
    told_s: f64,
    until_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    size_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    variance_factor: Option<f64>,
}

impl FaultRow {
    fn new(told: &Told) -> Self {
        let (kind, size_m, variance_factor) = match told.fault {
            Fault::Bias { size_m, .. } => ("bias", Some(size_m), None),
            Fault::Drift { size_m } => ("drift", Some(size_m), None),
            Fault::Noise { variance_factor } => ("noise", None, Some(variance_factor)),
        };
        Self {
            channel: told.channel.label(),
            kind,
            since_s: told.since_s,
            told_s: told.at_s,
            until_s: told.until_s,
            size_m,
            variance_factor,
        }
    }

    fn line(&self) -> String {
        let what = match (self.size_m, self.variance_factor) {
            (Some(m), _) => format!("off by {m:+.1} m"),
            (None, factor) => format!("noise x{:.1}", factor.unwrap_or(1.0).sqrt()),
        };
        let until = self.until_s.map_or("the end".to_owned(), |t| format!("{t:.1} s"));
        format!("{} {what}, {:.1} s to {until}, told at {:.1} s", self.channel, self.since_s, self.told_s)
    }
}

fn name(log: &Path) -> String {
    log.file_stem().unwrap_or(log.as_os_str()).to_string_lossy().into_owned()
}

fn fly(args: &Args, path: &Path, filter: &str) -> Result<Row> {
    let settings = args.settings.load(&[format!("navigator.altimeter={filter}")])?;
    let log = Log::open(path, settings.system)?;
    let flown = heights::fly(&log, &settings.pipeline, &args.outage, |_, item, heard| heard.push(item))?;
    let h = flown.finish();
    if let Some(dir) = &args.out {
        write_csv(dir, &format!("{}-{filter}.csv", name(path)), &h)
            .with_context(|| dir.display().to_string())?;
    }
    Ok(Row {
        log: name(path),
        filter: filter.to_owned(),
        outages: args.outage.clone(),
        reference: (!h.compared.is_empty()).then_some(if h.truth { "truth" } else { "baro" }),
        altitude_rmse_m: h.rmse_m(),
        altitude_max_m: h.max_m(),
        largest_step_m: h.largest_step.1.abs(),
        largest_step_s: h.largest_step.0,
        within_2_sigma_percent: h.within_2_sigma_percent(),
        resets: h.resets.len(),
        faults: h.faults.iter().map(FaultRow::new).collect(),
    })
}

fn write_csv(dir: &Path, name: &str, heights: &Heights) -> csv::Result<()> {
    fs::create_dir_all(dir)?;
    let mut file = csv::Writer::from_path(dir.join(name))?;
    file.write_record(["t_s", "published_m", "sigma_m", "reference_m"])?;
    for c in &heights.compared {
        file.write_record([c.t_s, c.published_m, c.sigma_m, c.reference_m].map(|v| format!("{v:.3}")))?;
    }
    Ok(file.flush()?)
}

fn print(args: &Args, rows: &[Row]) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    if args.json {
        return writeln!(out, "{}", serde_json::json!({ "rows": rows }));
    }
    let width = rows.iter().map(|r| r.log.len()).max().unwrap_or(0);
    writeln!(
        out,
        "Height as published; a step is what it moves by from one solution to the next beyond its own climb rate"
    )?;
    writeln!(
        out,
        "  {:width$}  {:10}  {:9} {:>7} {:>7} {:>7} {:>8} {:>11} {:>7}",
        "log", "filter", "reference", "RMSE m", "max m", "step m", "at s", "in 2 sigma", "resets"
    )?;
    let number = |v: Option<f64>, decimals: usize| v.map_or("-".to_owned(), |v| format!("{v:.decimals$}"));
    for r in rows {
        writeln!(
            out,
            "  {:width$}  {:10}  {:9} {:>7} {:>7} {:>7.3} {:>8.1} {:>9} % {:>7}",
            r.log,
            r.filter,
            r.reference.unwrap_or("-"),
            number(r.altitude_rmse_m, 2),
            number(r.altitude_max_m, 2),
            r.largest_step_m,
            r.largest_step_s,
            number(r.within_2_sigma_percent, 0),
            r.resets
        )?;
    }
    for r in rows.iter().filter(|r| !r.faults.is_empty()) {
        writeln!(out, "{}, {}", r.log, r.filter)?;
        r.faults.iter().try_for_each(|f| writeln!(out, "  {}", f.line()))?;
    }
    Ok(())
}

fn run(args: &Args) -> Result<()> {
    let mut rows = Vec::new();
    for path in &args.logs {
        for filter in &args.filters {
            rows.push(fly(args, path, filter)?);
        }
    }
    Ok(print(args, &rows)?)
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            let _ = writeln!(std::io::stderr(), "altimeter_flights: {failure:#}");
            ExitCode::FAILURE
        }
    }
}
