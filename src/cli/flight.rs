//! How a log is flown again: what the commands that do so have in common.

use clap::Args;

use crate::config::Settings;
use crate::fault::InjectedFault;
use crate::log::{Log, LogSummary};
use crate::replay::runner::{self, Runner};
use crate::sample::Input;
use crate::wire::clock::AutopilotClock;

use super::progress::{ProgressUnit, bar};
use super::{ConfigArgs, Failure};

/// A flight as it was, or with GNSS withheld and faults put in.
#[derive(Clone, Debug, Args)]
pub struct FlightArgs {
    /// Withhold GNSS from A to B, seconds since the first sample, as in 600..1200; may be given several times
    #[arg(long, value_name = "A..B", value_parser = parse_interval)]
    pub outage: Vec<(f64, f64)>,
    /// Put a fault into the flight: SENSOR[ID][.AXIS]:KIND[=VALUE]@A..B, as in flow:zero@100..160; may be given several times
    #[arg(long, value_name = "FAULT")]
    pub fault: Vec<InjectedFault>,
    /// What navigates: shipped, nlo, nlo_printed, xkf, ekf15 or inertial
    #[arg(long)]
    pub estimator: Option<String>,
    /// Settings
    #[command(flatten)]
    pub settings: ConfigArgs,
}

impl FlightArgs {
    /// The settings, with the estimator that was asked for.
    ///
    /// # Errors
    /// [`Failure::Config`].
    pub fn load(&self) -> Result<Settings, Failure> {
        match &self.estimator {
            Some(name) => self.settings.with_estimator(name).load(),
            None => self.settings.load(),
        }
    }

    /// Flies a log; `note` is called after each item. With a bar on a terminal, but for who wants it `quiet`.
    ///
    /// # Errors
    /// What reading the log says.
    pub fn fly(
        &self,
        log: &Log,
        settings: &Settings,
        quiet: bool,
        mut note: impl FnMut(&Runner, &AutopilotClock, &Input),
    ) -> Result<(Runner, LogSummary), Failure> {
        let bar = bar(ProgressUnit::Bytes, log.bytes(), quiet);
        let flown = runner::run(
            log,
            &settings.pipeline,
            &self.outage,
            &self.fault,
            |position| bar.set_position(position),
            |runner, clock, item, _| note(runner, clock, item),
        )?;
        bar.finish_and_clear();
        Ok(flown)
    }
}

/// `A..B` with 0 ≤ A < B.
///
/// # Errors
/// What is wrong with the text.
pub fn parse_interval(text: &str) -> Result<(f64, f64), String> {
    let wrong = || format!("\"{text}\" is not an interval: expected A..B in seconds with 0 <= A < B");
    let (a, b) = text.split_once("..").ok_or_else(wrong)?;
    let (a, b): (f64, f64) = (a.trim().parse().map_err(|_| wrong())?, b.trim().parse().map_err(|_| wrong())?);
    if a >= 0.0 && a < b && b.is_finite() { Ok((a, b)) } else { Err(wrong()) }
}
