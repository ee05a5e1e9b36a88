//! A replayed flight as data for other programs: MCAP for Foxglove, and tables (CSV, Parquet).
//!
//! Two tables tell it: the solution at 20 Hz, and what became of every source at 1 Hz. [`FlightExport`] is fed like a report's recorder, and writes
//! as it goes: what it takes of memory does not grow with the flight.

mod mcap;
mod rows;
mod table;

use std::io;

use crate::navigator::solution::Mode;
use crate::replay::runner::Runner;
use crate::sample::{Input, Reference, Sample};
use crate::time::{AutopilotTime, Span};
use crate::wire::clock::AutopilotClock;

pub use mcap::McapFile;
pub use table::{TableFile, TableFormat};

/// The solution is written this often.
const SOLUTION_PERIOD: Span = Span::from_millis(50);
/// The sources are.
const SOURCES_PERIOD: Span = Span::from_millis(1000);

/// What a flight is written to.
#[derive(Debug, Default)]
pub struct FlightExport {
    /// For Foxglove.
    pub mcap: Option<McapFile>,
    /// Table of the solution.
    pub solution: Option<TableFile>,
    /// Table of the sources.
    pub sources: Option<TableFile>,
    solution_due: Option<AutopilotTime>,
    sources_due: Option<AutopilotTime>,
    told: usize,
    failed: Option<io::Error>,
}

/// Columns of the tables.
pub const SOLUTION_COLUMNS: &[rows::Column] = rows::SOLUTION;
/// See there.
pub const SOURCE_COLUMNS: &[rows::Column] = rows::SOURCES;

impl FlightExport {
    /// Takes note of an item that the runner has taken. What fails is told by [`FlightExport::finish`].
    pub fn note(&mut self, runner: &Runner, clock: &AutopilotClock, item: &Input) {
        if self.failed.is_none() {
            self.failed = self.write(runner, clock, item).err();
        }
    }

    fn write(&mut self, runner: &Runner, clock: &AutopilotClock, item: &Input) -> io::Result<()> {
        if let Some(mcap) = &mut self.mcap {
            if let Input::Sample(sample) = item {
                mcap.stamps(clock, sample.time(), runner.seconds(sample.time()));
            }
            let events = runner.events();
            for (t_s, event) in events.get(self.told..).unwrap_or_default() {
                mcap.event(*t_s, event)?;
            }
            self.told = events.len();
            match item {
                Input::Sample(Sample::Gnss(fix)) => mcap.fix(runner.seconds(fix.time), fix)?,
                Input::Reference(Reference::Truth(truth)) => {
                    if let Some(position) = truth.position {
                        mcap.place("/truth/location", runner.seconds(truth.time), &position)?;
                    }
                }
                Input::Reference(Reference::Global { time, position, .. }) => {
                    mcap.place("/autopilot/location", runner.seconds(*time), position)?;
                }
                _ => {}
            }
        }
        if matches!(item, Input::Sample(Sample::Imu(_))) { self.solved(runner) } else { Ok(()) }
    }

    fn solved(&mut self, runner: &Runner) -> io::Result<()> {
        let Some(solution) = runner.solution() else { return Ok(()) };
        let (navigator, t_s) = (&runner.pipeline.navigator, runner.seconds(solution.time));
        if self.solution_due.is_none_or(|due| solution.time >= due) {
            self.solution_due = Some(solution.time + SOLUTION_PERIOD);
            let row = rows::solution(t_s, solution);
            if let Some(table) = &mut self.solution {
                table.row(&row)?;
            }
            if let Some(mcap) = &mut self.mcap {
                mcap.series("/solution", "holdover.Solution", rows::SOLUTION, t_s, &row)?;
                if solution.mode != Mode::Aligning {
                    mcap.solution(t_s, solution, navigator.placed_frame())?;
                }
            }
        }
        if self.sources_due.is_none_or(|due| solution.time >= due) {
            self.sources_due = Some(solution.time + SOURCES_PERIOD);
            for report in navigator.source_reports() {
                let row = rows::source(t_s, &report);
                if let Some(table) = &mut self.sources {
                    table.row(&row)?;
                }
                if let Some(mcap) = &mut self.mcap {
                    let topic = format!("/sources/{}_{}", report.kind.label().replace(' ', "_"), report.id);
                    mcap.series(&topic, "holdover.Source", rows::SOURCES, t_s, &row)?;
                }
            }
        }
        Ok(())
    }

    /// Ends the files: from here on they have their names.
    ///
    /// # Errors
    /// What writing said, then or now.
    pub fn finish(self) -> io::Result<()> {
        if let Some(failed) = self.failed {
            return Err(failed);
        }
        self.mcap.map_or(Ok(()), McapFile::finish)?;
        self.solution.map_or(Ok(()), TableFile::finish)?;
        self.sources.map_or(Ok(()), TableFile::finish)
    }
}
