//! `holdover inspect`: what is in a log, which rates and gaps, and what Holdover can do with it.

mod abilities;
mod lag;
mod outlook;
mod samples;
mod sensors;
mod vibration;

use std::collections::BTreeMap;

use clap::Args;
use serde::Serialize;

use crate::config::Settings;
use crate::log::stretches::Stretches;
use crate::log::{Entry, Log, LogFile, LogSummary};
use crate::navigator::solution::Mode;
use crate::replay::airborne::ToldFlights;
use crate::replay::runner::Runner;
use crate::sample::{Airframe, Input, Reference, SampleKind};
use crate::time::{AutopilotTime, ClockEvent};

use abilities::{FlowUse, SeenInFlight, abilities};
use outlook::OutlookReport;
use samples::{KindReport, Streams};
use sensors::{SensorReport, Sensors};
use vibration::{LoggedImu, VibrationReport};

use super::logs::LogArgs;
use super::progress::{ProgressUnit, bar};
use super::table::Table;
use super::{ConfigArgs, Failure};

/// Arguments of `inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// Logs
    #[command(flatten)]
    pub logs: LogArgs,
    /// Print one JSON object a log, each on its line, and nothing else
    #[arg(long)]
    pub json: bool,
    /// Settings
    #[command(flatten)]
    pub settings: ConfigArgs,
}

/// IMU streams slower than this cannot be integrated, Hz.
const LEAST_IMU_HZ: f64 = 20.0;
/// Where this message is, the log's IMU is a mean of fast samples.
const MEANS_OF: &str = "GYR";
/// Of many flights, so many are printed.
const PERIODS_SHOWN: usize = 8;

#[derive(Debug, Serialize)]
struct InspectReport {
    log: String,
    format: &'static str,
    duration_s: f64,
    autopilot: String,
    system: u8,
    frames: u64,
    skipped_bytes: u64,
    bad_crc: u64,
    truncated: bool,
    reboots: u32,
    /// Messages that carry a signature, which is not looked at.
    signed: u64,
    samples: Vec<KindReport>,
    imu_holes: Vec<PeriodReport>,
    /// By the vehicle's own word.
    armed: Vec<PeriodReport>,
    in_air: Vec<PeriodReport>,
    truth: bool,
    /// What is to be said of each sensor.
    sensors: Vec<SensorReport>,
    /// What shakes the inertial units.
    vibration: VibrationReport,
    /// What became of it when it was flown again, and how far off it would be without GNSS.
    outlook: Option<OutlookReport>,
    can: Vec<String>,
    lacks: Option<String>,
    parameters: Vec<ParameterReport>,
    messages: Vec<MessageReport>,
}

#[derive(Debug, Serialize)]
struct ParameterReport {
    name: &'static str,
    value: f32,
    what: &'static str,
}

#[derive(Debug, Serialize)]
struct PeriodReport {
    from_s: f64,
    to_s: f64,
}

#[derive(Debug, Serialize)]
struct MessageReport {
    system: u8,
    component: u8,
    message: String,
    count: u64,
}

/// What is missing for any navigation, in words; `None` if nothing is. Of GNSS receivers fixes are counted, whatever else they tell.
pub fn lacking(heard: &[u64; SampleKind::ALL.len()], imu: &Stretches) -> Option<String> {
    let names = |wanted: bool| -> Vec<&str> {
        SampleKind::ALL.iter().filter(|k| (heard[**k as usize] > 0) == wanted).map(|k| k.label()).collect()
    };
    let heard_names = match names(true) {
        n if n.is_empty() => "no sensor at all".to_owned(),
        n => n.join(", "),
    };
    let rate = imu.rate_hz().unwrap_or(0.0);
    if imu.count() == 0 {
        return Some(format!(
            "no IMU: it holds {heard_names}. Holdover needs an IMU at {LEAST_IMU_HZ} Hz or more (of MAVLink HIGHRES_IMU, SCALED_IMU or ArduPilot's RAW_IMU)"
        ));
    }
    if rate < LEAST_IMU_HZ {
        return Some(format!(
            "the IMU comes at {rate:.1} Hz, too slow to integrate: Holdover needs {LEAST_IMU_HZ} Hz or more; it holds {heard_names}"
        ));
    }
    if heard[SampleKind::Gnss as usize] == 0 && heard[SampleKind::Flow as usize] == 0 {
        return Some(format!(
            "no GNSS fix to start from, and no optical flow to do without; it holds {heard_names}"
        ));
    }
    None
}

/// Names and numbers of messages, by system, component and id.
type MessageCounts = BTreeMap<(u8, u8, u32), (String, u64)>;

/// What a log holds for the navigator.
#[derive(Debug, Default)]
struct Contents {
    streams: Streams,
    truth: bool,
    airframe: Option<Airframe>,
    sensors: Sensors,
    told: ToldFlights,
    span: Option<(AutopilotTime, AutopilotTime)>,
}

impl Contents {
    fn note(&mut self, input: &Input) {
        self.sensors.note(input);
        let time = match input {
            Input::Sample(s) => {
                self.streams.note(s);
                s.time()
            }
            Input::Reference(r) => {
                self.truth |= matches!(r, Reference::Truth(t) if t.position.is_some());
                r.time()
            }
            Input::Status(status) => {
                self.airframe = status.airframe;
                self.told.note(self.duration_s(), status);
                return;
            }
            // Before the first sample no time has passed.
            Input::Clock(ClockEvent::Gap(gap)) if self.span.is_some() => {
                return self.told.fell_silent(self.duration_s(), gap.seconds());
            }
            Input::Origin(_) | Input::Clock(_) => return,
        };
        self.span = Some(self.span.map_or((time, time), |(a, b)| (a, b.max(time))));
    }

    /// From the first sample to the last so far, s.
    fn duration_s(&self) -> f64 {
        self.span.map_or(0.0, |(a, b)| b.seconds_since(a))
    }
}

fn message_reports(messages: MessageCounts) -> Vec<MessageReport> {
    let report =
        |((system, component, _), (message, count))| MessageReport { system, component, message, count };
    messages.into_iter().map(report).collect()
}

fn periods(all: Vec<(f64, f64)>) -> Vec<PeriodReport> {
    all.into_iter().map(|(from_s, to_s)| PeriodReport { from_s, to_s }).collect()
}

fn report(log: &Log, summary: &LogSummary, contents: &Contents, messages: MessageCounts) -> InspectReport {
    let duration_s = contents.duration_s();
    let heard = contents.streams.heard();
    let imu = contents.streams.of(SampleKind::Imu);
    let hole = |(ended, gap_s): (AutopilotTime, f64)| {
        let to_s = contents.span.map_or(0.0, |(from, _)| ended.seconds_since(from));
        PeriodReport { from_s: to_s - gap_s, to_s }
    };
    let logged = LoggedImu {
        rate_hz: imu.rate_hz(),
        single: messages.values().all(|(name, _)| name != MEANS_OF),
        duration_s,
    };
    InspectReport {
        log: log.path().display().to_string(),
        format: log.format().label(),
        duration_s,
        autopilot: log.vehicle().autopilot.to_string(),
        system: log.vehicle().system.0,
        frames: summary.frames,
        skipped_bytes: summary.skipped_bytes(),
        bad_crc: summary.bad_crc(),
        truncated: summary.truncated,
        reboots: summary.reboots,
        signed: summary.signed,
        samples: contents.streams.reports(),
        imu_holes: imu.shown().map(hole).collect(),
        armed: periods(contents.told.armed(duration_s)),
        in_air: periods(contents.told.in_air(duration_s)),
        truth: contents.truth,
        sensors: contents.sensors.report(),
        vibration: VibrationReport::of(summary, logged),
        outlook: None,
        messages: message_reports(messages),
        can: Vec::new(),
        lacks: lacking(&heard, imu),
        parameters: summary
            .parameters
            .all()
            .map(|(name, value, what)| ParameterReport { name, value: value as f32, what })
            .collect(),
    }
}

/// Runs the command.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &InspectArgs, quiet: bool) -> Result<(), Failure> {
    let settings = args.settings.load()?;
    let quiet = quiet || args.json;
    args.logs.each(args.json, |file, _| one(file, &settings, args.json, quiet))
}

fn one(file: &LogFile, settings: &Settings, json: bool, quiet: bool) -> Result<(), Failure> {
    let log = Log::of(file.clone(), settings.system)?;
    let mut contents = Contents::default();
    let mut messages = MessageCounts::new();
    let mut runner = Runner::new(&settings.pipeline, &[]);
    runner.pipeline.follow(log.vehicle());
    let bar = bar(ProgressUnit::Bytes, log.bytes(), quiet);
    let summary = log.play(
        |entry, position| {
            bar.set_position(position);
            let sender = (entry.system, entry.component, entry.id);
            messages.entry(sender).or_insert_with(|| (name_of(entry), 0)).1 += 1;
        },
        |clock, input| {
            contents.note(input);
            runner.take(clock, input);
            if let Some(solution) = runner.solution().filter(|s| s.mode != Mode::Aligning) {
                contents.sensors.note_attitude(solution.time, solution.attitude);
            }
        },
    )?;
    runner.close();
    bar.finish_and_clear();
    let mut report = report(&log, &summary, &contents, messages);
    if report.lacks.is_none() {
        let outlook = OutlookReport::of(&runner);
        let navigator = &runner.pipeline.navigator;
        let shown = SeenInFlight {
            flow: FlowUse::of(contents.streams.of(SampleKind::Flow), navigator, outlook.on_flow()),
            ranged: 2 * navigator.statuses().used(SampleKind::Range)
                > contents.streams.of(SampleKind::Range).count(),
            landmarks: settings.pipeline.navigator.landmarks.as_ref().map(|l| l.points.len()),
        };
        report.can = abilities(&contents, &shown);
        report.outlook = Some(outlook);
    }
    if json {
        let text = serde_json::to_string(&report).map_err(|e| Failure::Other(e.to_string()))?;
        outln!("{text}");
    } else {
        print_report(&report, &summary);
    }
    Ok(())
}

fn name_of(entry: &Entry<'_>) -> String {
    entry.name.map_or_else(|| format!("unknown ({})", entry.id), str::to_owned)
}

fn print_report(r: &InspectReport, summary: &LogSummary) {
    outln!("{}: {:.1} s, {} (system {}), {}", r.log, r.duration_s, r.autopilot, r.system, r.format);
    outln!("  {} messages", r.frames);
    for remark in summary.remarks() {
        outln!("  {remark}");
    }
    print_samples(r);
    print_sensors(&r.sensors);
    r.vibration.print();
    outln!("\nWhat Holdover can do with it");
    match &r.lacks {
        Some(reason) => outln!("  nothing: {reason}"),
        None => r.can.iter().for_each(|c| outln!("  {c}")),
    }
    if let Some(outlook) = &r.outlook {
        outlook.print();
    }
    if !r.parameters.is_empty() {
        outln!("\nParameters of the autopilot");
    }
    for p in &r.parameters {
        outln!("  {:<16} {:>10}  {}", p.name, p.value, p.what);
    }
    outln!("\nMessages");
    let mut table = Table::new(&["message", "system", "component", "count"]);
    for m in &r.messages {
        table.row(vec![
            m.message.clone(),
            m.system.to_string(),
            m.component.to_string(),
            m.count.to_string(),
        ]);
    }
    table.print();
}

fn print_sensors(sensors: &[SensorReport]) {
    if !sensors.is_empty() {
        outln!("\nSensors");
    }
    for sensor in sensors {
        for (i, remark) in sensor.remarks.iter().enumerate() {
            outln!("  {:<12}  {remark}", if i == 0 { sensor.sensor } else { "" });
        }
        if let Some(lag) = &sensor.lag {
            outln!("  {:<12}  {lag}", "");
        }
    }
}

fn print_samples(r: &InspectReport) {
    samples::print(&r.samples);
    for hole in &r.imu_holes {
        outln!("  no IMU from {:.1} to {:.1} s", hole.from_s, hole.to_s);
    }
    for (what, periods) in [("armed", &r.armed), ("in the air, as it says itself,", &r.in_air)] {
        for period in periods.iter().take(PERIODS_SHOWN) {
            outln!("  {what} from {:.1} to {:.1} s", period.from_s, period.to_s);
        }
        if periods.len() > PERIODS_SHOWN {
            outln!("  {what} {} times more", periods.len() - PERIODS_SHOWN);
        }
    }
}
