//! `holdover replay`: fly a log again.

use std::cell::RefCell;
use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;

use crate::altimeter::Health;
use crate::config::Settings;
use crate::fault::InjectedFault;
use crate::files::{OutputFile, Overwrite, READABLE, named};
use crate::geo::so3::Euler;
use crate::log::{Log, LogFile, LogSummary};
use crate::metrics::AidedReport;
use crate::metrics::outage::OutageReport;
use crate::navigator::Navigator;
use crate::navigator::event::Event;
use crate::navigator::settings::Estimator;
use crate::navigator::shadow::MeasuredDrift;
use crate::navigator::solution::Solution;
use crate::navigator::sources::status::{Measured, SourceReport};
use crate::replay::runner::{ModeChange, Outcome, ReferenceKind, Runner};
use crate::report::{FlightRecorder, FlightSheet};
use crate::sample::{Input, SampleKind};
use crate::time::Span;
use crate::wire::companion_clock::CompanionClock;
use crate::wire::decode::Repair;
use crate::wire::recording::SentReport;

use super::Failure;
use super::flight::FlightArgs;
use super::inspect::lacking;
use super::logs::LogArgs;
use super::report::{PageFile, sheet};
use super::table::{Table, number};

/// Arguments of `replay`.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// Logs
    #[command(flatten)]
    pub logs: LogArgs,
    /// The flight
    #[command(flatten)]
    pub flight: FlightArgs,
    /// Print one JSON object a log, each on its line, and nothing else
    #[arg(long)]
    pub json: bool,
    /// Write solution.csv into this folder; of several logs each into a folder of its own there
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write a page with plots of everything, as the command report does
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Overwrite a solution.csv or a page that is there
    #[arg(long)]
    pub force: bool,
}

/// The JSON of `replay --json`.
#[derive(Debug, Serialize)]
pub struct ReplayReport {
    /// The file.
    pub log: String,
    /// Duration from the first to the last sample, s.
    pub duration_s: f64,
    /// Frames with a good checksum.
    pub frames: u64,
    /// Bytes that belong to no frame.
    pub skipped_bytes: u64,
    /// Damaged frames.
    pub bad_crc: u64,
    /// What was compared with.
    pub reference: ReferenceKind,
    /// What navigated.
    pub estimator: &'static str,
    /// Errors with GNSS.
    pub aided: AidedReport,
    /// Faults that were put in.
    pub faults: Vec<String>,
    /// Outages.
    pub outages: Vec<OutageReport>,
    /// Modes.
    pub modes: Vec<ModeChange>,
    /// What was told.
    pub events: Vec<ToldEvent>,
    /// What was put right in the vehicle's messages, or left out because it was told before.
    pub repairs: Vec<RepairCount>,
    /// What became of every source, at the end.
    pub sources: Vec<SourceReport>,
    /// What an outage would come to, as dead reckonings beside GNSS have measured it.
    pub drift: Vec<MeasuredDrift>,
    /// How what is sent compares with what was sent: of a recording that is flown as it was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sent_again: Option<SentReport>,
    /// Log time over computing time, reading included.
    pub realtime_factor: f64,
}

/// An event.
#[derive(Debug, Serialize)]
pub struct ToldEvent {
    /// Seconds since the first sample.
    pub t_s: f64,
    /// A word that stays the same.
    pub code: &'static str,
    /// The sentence with its values.
    pub text: String,
    /// How often it was so, since it was told before: see [`Event::times`].
    pub times: u32,
}

/// How often something was put right.
#[derive(Debug, Serialize)]
pub struct RepairCount {
    /// A name that stays the same.
    pub code: &'static str,
    /// What was done.
    pub what: String,
    /// How often.
    pub count: u64,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &ReplayArgs, quiet: bool) -> Result<(), Failure> {
    let settings = args.flight.load()?;
    let sheets = RefCell::new(Vec::new());
    let page = args.report.as_deref().map(|page| PageFile::create(page, args.force)).transpose()?;
    let each = args.logs.each(args.json, |file, several| {
        let name = file.path().file_name().filter(|_| several).unwrap_or_default();
        let out = args.out.as_ref().map(|out| out.join(name));
        sheets.borrow_mut().extend(one(args, file, out.as_deref(), &settings, quiet)?);
        Ok(())
    });
    if let Some(page) = page {
        page.write(&sheets.into_inner())?;
    }
    each
}

/// Plays one log and tells what came of it. The sheet of its report, where there is to be one.
fn one(
    args: &ReplayArgs,
    file: &LogFile,
    out: Option<&Path>,
    settings: &Settings,
    quiet: bool,
) -> Result<Option<FlightSheet>, Failure> {
    let log = Log::of(file.clone(), settings.system)?;
    let mut csv = out.map(|dir| SolutionCsv::create(dir, Overwrite::forced(args.force))).transpose()?;
    let mut recorder = args.report.as_ref().map(|_| FlightRecorder::new());
    let clock = CompanionClock::new();
    let begun = clock.now();
    let (runner, summary) = args.flight.fly(&log, settings, quiet || args.json, |runner, _, item| {
        if let Some(csv) = &mut csv {
            csv.note(runner, item);
        }
        if let Some(recorder) = &mut recorder {
            recorder.note(runner, item);
        }
    })?;
    let computing_s = clock.now().seconds_since(begun).max(1e-6);
    if let Some(csv) = csv {
        csv.finish()?;
    }
    let outcome = runner.outcome();
    if let Some(reason) = lacking(&outcome.heard, &outcome.imu) {
        return Err(Failure::Lacking(format!("{}: {reason}", log.path().display())));
    }
    let estimator = settings.pipeline.navigator.estimator;
    let played = Played { runner: &runner, outcome: &outcome, summary: &summary };
    let report = numbers(args, &log, &played, estimator, computing_s);
    if args.json {
        let text = serde_json::to_string(&report).map_err(|e| Failure::Other(e.to_string()))?;
        outln!("{text}");
    } else {
        print_report(&report, &log, &played, estimator);
    }
    Ok(recorder.map(|recorder| sheet(&log, &runner, &summary, recorder, &args.flight.fault, estimator)))
}

/// What a log was played to.
#[derive(Clone, Copy)]
struct Played<'a> {
    runner: &'a Runner,
    outcome: &'a Outcome,
    summary: &'a LogSummary,
}

/// All of it as numbers.
fn numbers(
    args: &ReplayArgs,
    log: &Log,
    played: &Played<'_>,
    estimator: Estimator,
    computing_s: f64,
) -> ReplayReport {
    let Played { runner, outcome, summary } = *played;
    ReplayReport {
        log: log.path().display().to_string(),
        duration_s: outcome.duration_s,
        frames: summary.frames,
        skipped_bytes: summary.skipped_bytes(),
        bad_crc: summary.bad_crc(),
        reference: outcome.reference,
        estimator: estimator.label(),
        aided: outcome.aided,
        faults: args.flight.fault.iter().map(InjectedFault::to_string).collect(),
        outages: outcome.outages.clone(),
        modes: outcome.modes.clone(),
        events: outcome.events.iter().map(|(t, event)| told(*t, event)).collect(),
        repairs: summary.repairs.seen().map(repair_count).collect(),
        sources: runner.pipeline.navigator.source_reports(),
        drift: runner.pipeline.navigator.measured_drift(),
        sent_again: runner.sent_again(),
        realtime_factor: outcome.duration_s / computing_s,
    }
}

fn told(t_s: f64, event: &Event) -> ToldEvent {
    ToldEvent { t_s, code: event.kind.code(), text: event.kind.to_string(), times: event.times }
}

fn repair_count((repair, count): (Repair, u64)) -> RepairCount {
    RepairCount { code: repair.code(), what: repair.to_string(), count }
}

fn print_report(r: &ReplayReport, log: &Log, played: &Played<'_>, estimator: Estimator) {
    let Played { runner, outcome, summary } = *played;
    let vehicle = log.vehicle();
    outln!("{}: {:.1} s, {} (system {})", r.log, r.duration_s, vehicle.autopilot, vehicle.system.0);
    outln!(
        "  {} frames, {:.0} times real time, estimator {}",
        r.frames,
        r.realtime_factor,
        estimator.label()
    );
    for remark in summary.remarks() {
        outln!("  {remark}");
    }
    if let Some(sent) = &r.sent_again {
        outln!("  {}", compared(sent));
    }
    for fault in &r.faults {
        outln!("  fault put in: {fault}");
    }
    print_sources(&r.sources, &outcome.heard);

    outln!("\nWhat happened");
    for (t, event) in &outcome.events {
        outln!("  {t:8.1} s  {:18} {}", event.kind.code(), event);
    }
    print_learned(&runner.pipeline.navigator);
    print_innovations(&runner.pipeline.navigator);
    print_drift(&r.drift);
    print_errors(r);
}

/// How what is sent now compares with what was sent in flight.
fn compared(r: &SentReport) -> String {
    let missing = r.sent - r.same - r.different;
    let mut text =
        format!("of {} positions that were sent, {} are sent again with the same bytes", r.sent, r.same);
    if r.different > 0 {
        text += &format!(", {} with others, up to {:.2} m away", r.different, r.apart_m);
    }
    if missing > 0 {
        text += &format!(", {missing} are not sent");
    }
    text
}

/// What was learned of sensors: calibrations, latencies, heights.
fn print_learned(navigator: &Navigator) {
    for ((id, calibration, trust), (_, latency, sigma)) in
        navigator.flow_sensors().zip(navigator.flow_latencies_s())
    {
        let x = calibration.estimate();
        outln!(
            "  flow {id}: bias {:+.4} {:+.4} rad/s, scale {:+.1} %, turned {:+.1} deg, {:.0} +- {:.0} ms late: {}",
            x[0],
            x[1],
            100.0 * x[2],
            x[3].to_degrees(),
            1e3 * latency,
            1e3 * sigma,
            trust.map_or_else(|why| why.reason(), |()| "trusted")
        );
    }
    let (latency, sigma) = navigator.gnss_latency_s();
    outln!("  GNSS latency {:.0} +- {:.0} ms", 1e3 * latency, 1e3 * sigma);
    if let Some((latency, sigma)) = navigator.magnetometer_latency_s() {
        outln!("  magnetometer latency {:.0} +- {:.0} ms", 1e3 * latency, 1e3 * sigma);
    }

    for (channel, health) in navigator.height_health() {
        if health != Health::Unheard {
            let standing = navigator.height_standing(channel);
            let (offset_m, quiet_s) = standing.unwrap_or_default();
            outln!(
                "  {}: {health}, {offset_m:+.1} m to the height, heard {quiet_s:.1} s ago",
                channel.label()
            );
        }
    }
}

/// What an outage would come to.
fn print_drift(drift: &[MeasuredDrift]) {
    if drift.iter().all(|m| m.times == 0) {
        outln!("\nWithout GNSS: nothing was measured yet of what it would come to");
        return;
    }
    outln!("\nWithout GNSS, measured beside it on this flight");
    let mut table = Table::new(&["carried by", "after s", "error m, rms", "times", "sigma times"]);
    for m in drift {
        table.row(vec![
            m.source.label().into(),
            number(Some(m.after_s), 0),
            number(m.error_m, 1),
            m.times.to_string(),
            number(Some(m.factor), 2),
        ]);
    }
    table.print();
}

/// How wrong the solution was.
fn print_errors(r: &ReplayReport) {
    let against = match r.reference {
        ReferenceKind::Truth => "the simulator's truth",
        ReferenceKind::Gnss => "GNSS",
    };
    outln!("\nWith GNSS, root mean square against {against}");
    let a = &r.aided;
    outln!(
        "  position {} m, velocity {} m/s, altitude {} m, roll/pitch/yaw {}/{}/{} deg",
        number(a.position_rmse_m, 2),
        number(a.velocity_rmse_mps, 2),
        number(a.altitude_rmse_m, 2),
        number(a.roll_rmse_deg, 2),
        number(a.pitch_rmse_deg, 2),
        number(a.yaw_rmse_deg, 2)
    );
    if !r.outages.is_empty() {
        outln!("\nOutages, against {against}");
        let mut table = Table::new(&[
            "from..to s",
            "distance m",
            "error m",
            "max m",
            "drift %",
            "sigma m",
            "altitude m",
            "sent",
        ]);
        for o in &r.outages {
            table.row(vec![
                format!("{}..{}", o.start_s, o.end_s),
                number(o.distance_m, 0),
                number(o.horizontal_error_end_m, 1),
                number(o.horizontal_error_max_m, 1),
                number(o.drift_percent, 2),
                number(o.sigma_end_m, 1),
                number(o.altitude_rmse_m, 2),
                o.sent_messages.to_string(),
            ]);
        }
        table.print();
    }
}

/// What became of every source.
fn print_sources(sources: &[SourceReport], heard: &[u64; SampleKind::ALL.len()]) {
    outln!("\nSources, at the end");
    let mut table = Table::new(&["", "used", "fused", "gated", "NIS", "test ratio", "health", "rejected"]);
    for s in sources {
        let why: Vec<String> = s.rejected.iter().map(|(reason, n)| format!("{n} {reason}")).collect();
        table.row(vec![
            format!("{} {}", s.kind.label(), s.id),
            s.used.to_string(),
            s.fused.to_string(),
            s.gated.to_string(),
            number(s.nis_mean, 2),
            number(s.test_ratio, 2),
            s.charge
                .map_or_else(|| s.health.label().into(), |c| format!("{}: {}", s.health.label(), c.label())),
            why.join(", "),
        ]);
    }
    table.print();
    let silent: Vec<&str> =
        SampleKind::ALL.iter().filter(|k| heard[**k as usize] == 0).map(|k| k.label()).collect();
    if !silent.is_empty() {
        outln!("  never heard: {}", silent.join(", "));
    }
}

/// How likely what the filter took was: 1 is honest.
fn print_innovations(navigator: &Navigator) {
    let mut table = Table::new(&["", "fused", "gated", "mean NIS"]);
    let mut any = false;
    for &kind in Measured::ALL {
        let count = navigator.statuses().nis(kind);
        if count.fused + count.gated > 0 {
            any = true;
            let mean = number(count.mean(), 2);
            table.row(vec![kind.label().into(), count.fused.to_string(), count.gated.to_string(), mean]);
        }
    }
    if any {
        outln!("\nInnovations of the filter (normalised squares: 1 is honest, more is over-confident)");
        table.print();
    }
}

/// The solution at 20 Hz as comma-separated values.
struct SolutionCsv {
    file: csv::Writer<OutputFile>,
    failed: Option<csv::Error>,
    due: Option<crate::time::AutopilotTime>,
}

const CSV_PERIOD: Span = Span::from_millis(50);
const CSV_HEADER: [&str; 15] = [
    "t_s",
    "mode",
    "carrier",
    "north_m",
    "east_m",
    "down_m",
    "velocity_north_mps",
    "velocity_east_mps",
    "velocity_down_mps",
    "roll_deg",
    "pitch_deg",
    "yaw_deg",
    "sigma_horizontal_m",
    "sigma_down_m",
    "reset_counter",
];

impl SolutionCsv {
    fn create(dir: &Path, overwrite: Overwrite) -> Result<Self, Failure> {
        fs::create_dir_all(dir).map_err(|e| named(dir, &e))?;
        let file = OutputFile::create(&dir.join("solution.csv"), overwrite, READABLE)?;
        let mut file = csv::Writer::from_writer(file);
        file.write_record(CSV_HEADER)?;
        Ok(Self { file, failed: None, due: None })
    }

    fn note(&mut self, runner: &Runner, item: &Input) {
        let (Input::Sample(crate::sample::Sample::Imu(_)), Some(s)) = (item, runner.solution()) else {
            return;
        };
        if self.failed.is_some() || self.due.is_some_and(|due| s.time < due) {
            return;
        }
        self.due = Some(s.time + CSV_PERIOD);
        self.failed = self.write(runner, s).err();
    }

    fn write(&mut self, runner: &Runner, s: &Solution) -> csv::Result<()> {
        let e = Euler::from_rotation(s.attitude.matrix());
        let angles = [e.roll_rad, e.pitch_rad, e.yaw_rad].map(f64::to_degrees);
        let (p, v) = (s.position.raw(), s.velocity.raw());
        let state = p.iter().chain(&v).chain(&angles).map(|v| format!("{v:.4}"));
        let sigmas = [s.horizontal_sigma_m(), s.position_covariance.raw()[(2, 2)].max(0.0).sqrt()];
        let what = [
            format!("{:.6}", runner.seconds(s.time)),
            s.mode.label().to_owned(),
            format!("{:?}", s.velocity_source),
        ];
        let sigmas = sigmas.iter().map(|v| format!("{v:.3}"));
        self.file
            .write_record(what.into_iter().chain(state).chain(sigmas).chain([s.reset_counter.to_string()]))
    }

    fn finish(self) -> Result<(), Failure> {
        match self.failed {
            Some(e) => Err(e.into()),
            None => Ok(self.file.into_inner().map_err(|e| e.into_error())?.finish()?),
        }
    }
}
