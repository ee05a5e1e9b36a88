//! `holdover report`: fly logs again and show them on one page.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;

use crate::config::Settings;
use crate::fault::InjectedFault;
use crate::files::{OutputFile, Overwrite, READABLE};
use crate::log::{Log, LogFile, LogSummary};
use crate::navigator::settings::Estimator;
use crate::replay::runner::Runner;
use crate::report::{FaultShown, FlightRecorder, FlightSheet, flights_page};

use super::Failure;
use super::flight::FlightArgs;
use super::inspect::lacking;
use super::logs::LogArgs;

/// Arguments of `report`.
#[derive(Debug, Args)]
pub struct ReportArgs {
    /// Logs
    #[command(flatten)]
    pub logs: LogArgs,
    /// Where the page goes
    #[arg(long, value_name = "FILE", default_value = "report.html")]
    pub out: PathBuf,
    /// The flight
    #[command(flatten)]
    pub flight: FlightArgs,
    /// Overwrite a page that is there
    #[arg(long)]
    pub force: bool,
}

/// A page that is being made: that its place can be written is known before hours of logs are read.
pub(super) struct PageFile(OutputFile);

impl PageFile {
    /// # Errors
    /// What is in its place, or the system's word.
    pub(super) fn create(path: &Path, force: bool) -> Result<Self, Failure> {
        Ok(Self(OutputFile::create(path, Overwrite::forced(force), READABLE)?))
    }

    /// Writes the page of these flights; nothing where there are none.
    ///
    /// # Errors
    /// The system's word.
    pub(super) fn write(self, flights: &[FlightSheet]) -> Result<(), Failure> {
        if flights.is_empty() {
            return Ok(());
        }
        self.text(&flights_page(flights))
    }

    /// Writes a page that is made.
    ///
    /// # Errors
    /// The system's word.
    pub(super) fn text(self, page: &str) -> Result<(), Failure> {
        let Self(mut file) = self;
        file.write_all(page.as_bytes())?;
        Ok(file.finish()?)
    }
}

/// Runs the command.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &ReportArgs, quiet: bool) -> Result<(), Failure> {
    let settings = args.flight.load()?;
    let page = PageFile::create(&args.out, args.force)?;
    let (mut flights, mut failed) = (Vec::new(), None);
    for file in args.logs.find()? {
        match one(args, &file, &settings, quiet) {
            Ok(flight) => flights.push(flight),
            Err(failure) => {
                if let Some(before) = failed.replace(failure) {
                    errln!("holdover: {before}");
                }
            }
        }
    }
    for flight in &flights {
        if let Some(lacking) = &flight.lacking {
            errln!("holdover: {}: {lacking}", flight.name);
        }
    }
    let written = !flights.is_empty();
    page.write(&flights)?;
    if written {
        outln!("{}", args.out.display());
    }
    failed.map_or(Ok(()), Err)
}

/// Plays one log.
fn one(args: &ReportArgs, file: &LogFile, settings: &Settings, quiet: bool) -> Result<FlightSheet, Failure> {
    let log = Log::of(file.clone(), settings.system)?;
    let mut recorder = FlightRecorder::new();
    let (runner, summary) =
        args.flight.fly(&log, settings, quiet, |runner, _, item| recorder.note(runner, item))?;
    Ok(sheet(&log, &runner, &summary, recorder, &args.flight.fault, settings.pipeline.navigator.estimator))
}

/// What a report shows of a flight that was played.
pub(super) fn sheet(
    log: &Log,
    runner: &Runner,
    summary: &LogSummary,
    mut recorder: FlightRecorder,
    faults: &[InjectedFault],
    estimator: Estimator,
) -> FlightSheet {
    recorder.finish();
    let (outcome, vehicle) = (runner.outcome(), log.vehicle());
    let name = log.path().file_name().unwrap_or(log.path().as_os_str());
    FlightSheet {
        name: name.to_string_lossy().into_owned(),
        about: format!(
            "{} (system {}), estimator {}",
            vehicle.autopilot,
            vehicle.system.0,
            estimator.label()
        ),
        recorder,
        lacking: lacking(&outcome.heard, &outcome.imu),
        outcome,
        sources: runner.pipeline.navigator.source_reports(),
        drift: runner.pipeline.navigator.measured_drift(),
        faults: faults
            .iter()
            .map(|f| FaultShown { text: f.to_string(), from_s: f.from_s, to_s: f.to_s })
            .collect(),
        remarks: summary.remarks(),
    }
}
