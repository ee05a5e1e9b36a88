//! `holdover export`: fly a log again and write it down for other programs.

use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;

use crate::config::Settings;
use crate::export::{FlightExport, McapFile, SOLUTION_COLUMNS, SOURCE_COLUMNS, TableFile, TableFormat};
use crate::files::named;
use crate::log::{Log, logs_in};
use crate::replay::runner::Runner;

use super::inspect::lacking;
use super::replay::{parse_interval, progress_bar};
use super::{ConfigArgs, Failure};

/// Arguments of `export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// The log, or - for standard input
    #[arg(value_name = "LOG")]
    pub log: PathBuf,
    /// Write a file for Foxglove
    #[arg(long, value_name = "FILE")]
    pub mcap: Option<PathBuf>,
    /// Write solution.csv and sources.csv into this folder
    #[arg(long, value_name = "DIR")]
    pub csv: Option<PathBuf>,
    /// Write solution.parquet and sources.parquet into this folder
    #[arg(long, value_name = "DIR", conflicts_with = "csv")]
    pub parquet: Option<PathBuf>,
    /// Withhold GNSS from A to B, seconds since the first sample, as in 600..1200; may be given several times
    #[arg(long, value_name = "A..B", value_parser = parse_interval)]
    pub outage: Vec<(f64, f64)>,
    /// What navigates: shipped, nlo, nlo_printed, xkf, ekf15 or inertial
    #[arg(long)]
    pub estimator: Option<String>,
    /// Overwrite files that are there
    #[arg(long)]
    pub force: bool,
    /// Settings
    #[command(flatten)]
    pub settings: ConfigArgs,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &ExportArgs) -> Result<(), Failure> {
    let settings = match &args.estimator {
        Some(name) => args.settings.with_estimator(name).load()?,
        None => args.settings.load()?,
    };
    let files = logs_in(std::slice::from_ref(&args.log), false)?;
    let [file] = &files[..] else {
        return Err(Failure::Usage(format!("{}: one log at a time", args.log.display())));
    };
    let log = Log::of(file.clone(), settings.system)?;
    let mut export = outputs(args)?;
    fly(&log, &settings, args, &mut export)?;
    Ok(export.finish()?)
}

/// The files that were asked for.
fn outputs(args: &ExportArgs) -> Result<FlightExport, Failure> {
    let mut export = FlightExport::default();
    if let Some(path) = &args.mcap {
        export.mcap = Some(McapFile::create(path, args.force)?);
    }
    let tables = [(&args.csv, TableFormat::Csv), (&args.parquet, TableFormat::Parquet)];
    for (folder, format) in tables.into_iter().filter_map(|(folder, f)| Some((folder.as_deref()?, f))) {
        fs::create_dir_all(folder).map_err(|e| named(folder, &e))?;
        let table = |name: &str, columns| {
            let path: PathBuf = Path::new(folder).join(name).with_extension(format.extension());
            TableFile::create(&path, format, columns, args.force)
        };
        export.solution = Some(table("solution", SOLUTION_COLUMNS)?);
        export.sources = Some(table("sources", SOURCE_COLUMNS)?);
    }
    if export.mcap.is_none() && export.solution.is_none() {
        return Err(Failure::Usage("nothing to write: give --mcap FILE, --csv DIR or --parquet DIR".into()));
    }
    Ok(export)
}

fn fly(log: &Log, settings: &Settings, args: &ExportArgs, export: &mut FlightExport) -> Result<(), Failure> {
    let mut runner = Runner::new(&settings.pipeline, &args.outage);
    runner.pipeline.follow(log.vehicle());
    let bar = progress_bar(log.bytes(), false);
    log.play(
        |_, position| bar.set_position(position),
        |clock, item| {
            runner.take(clock, item);
            export.note(&runner, clock, item);
        },
    )?;
    bar.finish_and_clear();
    let outcome = runner.outcome();
    match lacking(&outcome.heard, &outcome.imu) {
        Some(why) => Err(Failure::Lacking(format!("{}: {why}", log.path().display()))),
        None => Ok(()),
    }
}
