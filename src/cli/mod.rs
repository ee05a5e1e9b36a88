//! The command line: one file a subcommand, and the exit codes.

#[macro_use]
mod output;

mod autopilot;
mod check;
mod conversation;
mod evaluate;
mod export;
mod flight;
mod init;
mod inspect;
mod jobs;
mod key;
mod logs;
mod markers;
mod preflight;
mod progress;
mod reload;
mod replay;
mod report;
mod run;
mod service;
mod shipped;
mod simulate;
mod stress;
mod table;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};

use crate::config::{ConfigError, Loaded, LogSettings, LogTo, Origin, Settings, Sources};
use crate::daemon::lines;
use crate::log::LogError;
use crate::time::Span;
use crate::wire::companion_clock::CompanionClock;

/// Keeps a drone navigating when GNSS drops.
#[derive(Debug, Parser)]
#[command(name = "holdover", version, about, after_help = EXIT_CODES)]
struct Cli {
    /// What to do.
    #[command(subcommand)]
    command: Command,
    /// How much to say.
    #[command(flatten)]
    verbosity: Verbosity,
}

/// How much to say beside the result. What goes wrong is told all the same.
#[derive(Clone, Copy, Debug, Default, Args)]
struct Verbosity {
    /// No progress and no hints; of the daemon, warnings and errors alone
    #[arg(long, short, global = true, conflicts_with = "verbose")]
    quiet: bool,
    /// Say more on standard error: which settings are in force, which logs are read; of the daemon, what it logs at debug. Twice: everything
    #[arg(long, short, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
}

impl Verbosity {
    /// What the log is to hold, where that is said here.
    fn directives(self) -> Option<&'static str> {
        match (self.quiet, self.verbose) {
            (true, _) => Some("warn"),
            (false, 0) => None,
            (false, 1) => Some("holdover=debug,warn"),
            (false, _) => Some("trace"),
        }
    }
}

/// How long the last lines of a command's log may take.
const LAST_LINES: Span = Span::from_millis(500);

const EXIT_CODES: &str = "Exit codes: 0 done, 1 failed, 2 wrong command line or configuration, \
3 a log cannot be read, 4 a log lacks what is needed, 5 a link cannot be opened, 6 the vehicle is not ready";

/// The subcommands.
#[derive(Debug, Subcommand)]
enum Command {
    /// Navigate: listen to the autopilot, and tell it where it is when GNSS drops
    Run(run::RunArgs),
    /// Listen to a link, say what is there, and write a configuration for it
    Init(init::InitArgs),
    /// Check over the link that the autopilot is set up for what will be sent to it
    Preflight(preflight::PreflightArgs),
    /// Fly a log again: what Holdover would have done
    Replay(replay::ReplayArgs),
    /// Fly a log again and show it: one page with plots of everything
    Report(report::ReportArgs),
    /// Fly a log again and write it down for other programs: MCAP (Foxglove), CSV, Parquet
    Export(export::ExportArgs),
    /// Slide outages over logs and tabulate the drift
    Evaluate(evaluate::EvaluateArgs),
    /// Put faults of every sensor into logs and tabulate what became of it
    Stress(stress::StressArgs),
    /// What is in a log, and what Holdover can do with it
    Inspect(inspect::InspectArgs),
    /// Write the log of a simulated flight, with the truth in it, or be an autopilot in flight
    Simulate(Box<simulate::SimulateArgs>),
    /// Check the configuration and show what is in force
    Check(check::CheckArgs),
    /// Make, import and hand over the key of signed links
    Key(key::KeyArgs),
    /// Print what a shell needs to complete this command's words
    Completions(shipped::CompletionsArgs),
    /// Write the manual's pages
    Man(shipped::ManArgs),
}

/// Where the settings come from.
#[derive(Clone, Debug, Default, Args)]
struct ConfigArgs {
    /// Configuration file (TOML); may be given several times, later ones override
    #[arg(long, short, value_name = "FILE")]
    config: Vec<PathBuf>,
    /// Override one key, as in --set outbound.rate_hz=50; may be given several times
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
}

impl ConfigArgs {
    /// Loads the settings from files, environment and overrides; what is odd is told on standard error.
    ///
    /// # Errors
    /// [`Failure::Config`].
    fn load(&self) -> Result<Settings, Failure> {
        let loaded = self.read()?;
        warn(&loaded);
        for key in loaded.in_force.iter().filter(|key| key.origin != Origin::Default) {
            tracing::info!("{} = {}, by {}", key.path(), key.value_toml(), key.origin);
        }
        Ok(loaded.settings)
    }

    /// Loads the settings with where they came from, and tells nothing.
    fn read(&self) -> Result<Loaded, Failure> {
        let sources =
            Sources { files: self.config.clone(), environment: environment(), overrides: self.set.clone() };
        Loaded::load(&sources).map_err(Failure::Config)
    }

    /// The same with another estimator.
    fn with_estimator(&self, name: &str) -> Self {
        let mut other = self.clone();
        other.set.push(format!("navigator.estimator={name}"));
        other
    }
}

/// Tells what is odd about the settings.
fn warn(loaded: &Loaded) {
    for warning in &loaded.warnings {
        errln!("holdover: {warning}");
    }
}

/// Variables that are text; others cannot be ours.
fn environment() -> Vec<(String, String)> {
    std::env::vars_os().filter_map(|(k, v)| Some((k.into_string().ok()?, v.into_string().ok()?))).collect()
}

/// Why a command ended early; each kind has its exit code.
#[derive(Debug, thiserror::Error)]
enum Failure {
    /// The configuration is wrong.
    #[error("{0}")]
    Config(ConfigError),
    /// An argument is wrong.
    #[error("{0}")]
    Usage(String),
    /// A log cannot be read.
    #[error("{0}")]
    Log(#[from] LogError),
    /// None of several logs, or none of what was made of them, can be read.
    #[error("{0}")]
    Unreadable(String),
    /// A log (or vehicle) lacks what is needed.
    #[error("{0}")]
    Lacking(String),
    /// A link cannot be opened, or leads to no autopilot.
    #[error("{0}")]
    Link(String),
    /// The vehicle is not ready.
    #[error("{0}")]
    Faults(String),
    /// Anything else.
    #[error("{0}")]
    Other(String),
}

impl Failure {
    /// The process's exit code.
    fn exit_code(&self) -> u8 {
        match self {
            Failure::Other(_) => 1,
            Failure::Config(_) | Failure::Usage(_) => 2,
            Failure::Log(_) | Failure::Unreadable(_) => 3,
            Failure::Lacking(_) => 4,
            Failure::Link(_) => 5,
            Failure::Faults(_) => 6,
        }
    }
}

impl From<std::io::Error> for Failure {
    fn from(e: std::io::Error) -> Self {
        // What is in an output's place is for the command line to say.
        match e.kind() {
            std::io::ErrorKind::AlreadyExists => Failure::Usage(e.to_string()),
            _ => Failure::Other(e.to_string()),
        }
    }
}

impl From<csv::Error> for Failure {
    fn from(e: csv::Error) -> Self {
        Failure::Other(e.to_string())
    }
}

/// Runs a command; what it prints goes to standard output.
///
/// # Errors
/// [`Failure`], which knows its exit code.
fn run(cli: Cli) -> Result<(), Failure> {
    let quiet = cli.verbosity.quiet;
    match cli.command {
        Command::Run(args) => run::run(&args, cli.verbosity.directives()),
        Command::Init(args) => init::run(&args, quiet),
        Command::Preflight(args) => preflight::run(&args),
        Command::Replay(args) => replay::run(&args, quiet),
        Command::Report(args) => report::run(&args, quiet),
        Command::Export(args) => export::run(&args, quiet),
        Command::Evaluate(args) => evaluate::run(&args, quiet),
        Command::Stress(args) => stress::run(&args, quiet),
        Command::Inspect(args) => inspect::run(&args, quiet),
        Command::Simulate(args) => simulate::run(&args, quiet),
        Command::Check(args) => check::run(&args),
        Command::Key(args) => key::run(&args),
        Command::Completions(args) => {
            shipped::completions(&args);
            Ok(())
        }
        Command::Man(args) => shipped::man(&args),
    }
}

/// The log of a command that is to say more. The daemon has one of its own.
fn told(cli: &Cli) -> Option<lines::LogHandle> {
    let directives = cli.verbosity.directives()?;
    if cli.verbosity.verbose == 0 || matches!(cli.command, Command::Run(_)) {
        return None;
    }
    let settings = LogSettings { level: "warn".to_owned(), to: LogTo::Stderr, lines_per_event_per_min: 0 };
    lines::start(&settings, Some(directives), &CompanionClock::new()).ok()
}

/// The `holdover` command: reads the command line, does what it says, and tells failures to standard error.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let log = told(&cli);
    let done = run(cli);
    if let Some(log) = log {
        log.drain(LAST_LINES);
    }
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            output::last_words(&format!("holdover: {failure}\n"));
            ExitCode::from(failure.exit_code())
        }
    }
}
