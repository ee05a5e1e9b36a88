//! `holdover export`: fly a log again and write it down for other programs.

use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;

use crate::export::{FlightExport, McapFile, SOLUTION_COLUMNS, SOURCE_COLUMNS, TableFile, TableFormat};
use crate::files::named;
use crate::log::{Log, logs_in};

use super::Failure;
use super::flight::FlightArgs;
use super::inspect::lacking;

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
    /// The flight
    #[command(flatten)]
    pub flight: FlightArgs,
    /// Overwrite files that are there
    #[arg(long)]
    pub force: bool,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &ExportArgs, quiet: bool) -> Result<(), Failure> {
    let settings = args.flight.load()?;
    let files = logs_in(std::slice::from_ref(&args.log), false)?;
    let [file] = &files[..] else {
        return Err(Failure::Usage(format!("{}: one log at a time", args.log.display())));
    };
    let log = Log::of(file.clone(), settings.system)?;
    let mut export = outputs(args)?;
    let (runner, _) =
        args.flight.fly(&log, &settings, quiet, |runner, clock, item| export.note(runner, clock, item))?;
    let outcome = runner.outcome();
    if let Some(why) = lacking(&outcome.heard, &outcome.imu) {
        return Err(Failure::Lacking(format!("{}: {why}", log.path().display())));
    }
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
