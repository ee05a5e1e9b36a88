//! Ten minutes of dead reckoning, every estimator on the same simulated flights: the table of Fusini, Fossen and Johansen's comparison.
//!
//! `cargo run --release --example paper_dead_reckoning -- --seeds 1..10 [--json]`
//!
//! A fixed wing flies twelve minutes with GNSS and ten without: in circles, along survey legs, straight on; with a tactical and with a
//! MEMS IMU. All estimators run in the navigator itself, on the same samples, with noise settings that match the simulated sensors. The
//! published ones (`nlo_printed`, `nlo`, `xkf`) and the baseline (`ekf15`) have no magnetometer, as in the paper; with `--magnetometer` they do.

use std::io::Write;
use std::process::ExitCode;

use clap::Parser;
use holdover::config::{Settings, Sources};
use holdover::metrics::nees::NeesCount;
use holdover::navigator::Navigator;
use holdover::navigator::settings::Estimator;
use holdover::navigator::solution::Mode;
use holdover::sample::{Airframe, Sample, VehicleStatus};
use holdover::sim::{Scenario, SensorSuite, Simulation, Truth};
use serde::Serialize;

#[path = "../tests/support/data_sheet.rs"]
mod data_sheet;
#[path = "../tests/support/jobs.rs"]
mod jobs;
use data_sheet::data_sheet;

/// The order of the table.
const VARIANTS: [Estimator; 6] = [
    Estimator::Inertial,
    Estimator::NloPrinted,
    Estimator::Nlo,
    Estimator::Xkf,
    Estimator::Ekf15,
    Estimator::Shipped,
];
const IMUS: [&str; 2] = ["tactical", "mems"];
const PATHS: [&str; 3] = ["circles", "legs", "straight"];
/// Errors are compared with their covariance this often, s, and with GNSS from here on, s.
const NEES_EVERY_S: f64 = 1.0;
const SETTLED_S: f64 = 120.0;

#[derive(Parser)]
#[command(about = "Drift of every estimator after ten minutes without GNSS, in simulation")]
struct Args {
    /// Seeds, first..last, both flown
    #[arg(long, default_value = "1..10", value_parser = seeds)]
    seeds: (u64, u64),
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Give every estimator the magnetometer, not the shipped one alone
    #[arg(long)]
    magnetometer: bool,
    /// More settings for all estimators, key=value
    #[arg(long)]
    set: Vec<String>,
    /// Only this IMU
    #[arg(long, value_parser = IMUS)]
    imu: Option<String>,
    /// Only this path
    #[arg(long, value_parser = PATHS)]
    path: Option<String>,
}

fn seeds(text: &str) -> Result<(u64, u64), String> {
    let wrong = || format!("{text}: seeds are first..last, such as 1..10");
    let (first, last) = text.split_once("..").ok_or_else(wrong)?;
    let (first, last) = (first.parse().map_err(|_| wrong())?, last.parse().map_err(|_| wrong())?);
    if first <= last { Ok((first, last)) } else { Err(wrong()) }
}

/// One estimator on one flight.
#[derive(Clone, Copy)]
struct Flown {
    drift_percent: f64,
    holdover: NeesCount,
    aided: NeesCount,
    velocity: NeesCount,
}

#[derive(Serialize)]
struct Row {
    imu: &'static str,
    path: &'static str,
    variant: &'static str,
    seeds: usize,
    median_percent: Option<f64>,
    max_percent: Option<f64>,
    nees_in_bounds: Option<f64>,
    #[serde(skip)]
    means: [Option<f64>; 3],
}

/// One navigator in flight.
struct Pilot {
    navigator: Navigator,
    holdover: NeesCount,
    aided: NeesCount,
    velocity: NeesCount,
}

impl Pilot {
    fn compare(&mut self, truth: &Truth, out: bool) {
        let Some(s) = self.navigator.solution().filter(|s| s.mode != Mode::Aligning) else { return };
        let e_p = (s.position.raw() - truth.position_ned).xy();
        let e_v = (s.velocity.raw() - truth.velocity_ned).xy();
        let p = s.position_covariance.raw().fixed_view::<2, 2>(0, 0).into_owned();
        let v = s.velocity_covariance.raw().fixed_view::<2, 2>(0, 0).into_owned();
        if out {
            self.holdover.add(&e_p, &p);
            self.velocity.add(&e_v, &v);
        } else {
            self.aided.add(&e_p, &p);
        }
    }
}

fn navigator(args: &Args, imu: &str, estimator: Estimator) -> Result<Navigator, String> {
    let mut overrides = data_sheet(imu == "mems");
    overrides.push(format!("navigator.estimator={}", estimator.label()));
    // The published forms of b_v; the filters have it among their states.
    let flow_bias = if estimator == Estimator::NloPrinted { "as_printed" } else { "body" };
    overrides.push(format!("tuning.observer.flow_bias={flow_bias}"));
    if !args.magnetometer && !matches!(estimator, Estimator::Shipped | Estimator::Inertial) {
        overrides.push("magnetometer.use=false".to_owned());
    }
    overrides.extend(args.set.iter().cloned());
    let sources = Sources { overrides, ..Sources::default() };
    let settings = Settings::load(&sources).map_err(|e| e.to_string())?;
    Ok(Navigator::new(settings.pipeline.navigator))
}

/// All estimators on one flight.
fn fly(args: &Args, imu: &str, path: &str, seed: u64) -> Result<Vec<Flown>, String> {
    let scenario = Scenario::by_name(path).ok_or_else(|| format!("no scenario {path}"))?;
    let (from, _) = scenario.outage_s.ok_or("the scenario has no outage")?;
    let suite = if imu == "mems" { SensorSuite::mems() } else { SensorSuite::tactical() };
    let simulation = Simulation::new(scenario, suite, seed);
    let origin = simulation.frame().origin();
    let mut pilots = VARIANTS
        .iter()
        .map(|&estimator| {
            let mut navigator = navigator(args, imu, estimator)?;
            navigator.set_status(VehicleStatus {
                airframe: Some(Airframe::FixedWing),
                armed: Some(true),
                landed: None,
            });
            let count = NeesCount::default();
            Ok(Pilot { navigator, holdover: count, aided: count, velocity: count })
        })
        .collect::<Result<Vec<_>, String>>()?;
    let (mut due, mut distance, mut last, mut end) = (SETTLED_S, 0.0, None::<Truth>, None::<Truth>);
    for (k, reading) in simulation.enumerate() {
        let out = reading.t_s >= from;
        for pilot in &mut pilots {
            if k == 0 {
                pilot.navigator.set_origin(reading.time, origin);
            }
            for sample in reading.samples.iter() {
                match sample {
                    Sample::Gnss(fix) if out => pilot.navigator.mask_gnss(fix.time),
                    other => {
                        pilot.navigator.ingest(other);
                    }
                }
            }
            pilot.navigator.drain_events().for_each(drop);
        }
        if out {
            distance += last.map_or(0.0, |l| (reading.truth.position_ned - l.position_ned).xy().norm());
            last = Some(reading.truth);
        }
        if reading.t_s >= due {
            due += NEES_EVERY_S;
            pilots.iter_mut().for_each(|p| p.compare(&reading.truth, out));
        }
        end = Some(reading.truth);
    }
    let end = end.ok_or("an empty flight")?;
    Ok(pilots
        .iter()
        .map(|p| {
            let error = p
                .navigator
                .solution()
                .map_or(f64::NAN, |s| (s.position.raw() - end.position_ned).xy().norm());
            Flown {
                drift_percent: 100.0 * error / distance,
                holdover: p.holdover,
                aided: p.aided,
                velocity: p.velocity,
            }
        })
        .collect())
}

fn summarise(imu: &'static str, path: &'static str, variant: usize, flights: &[Vec<Flown>]) -> Row {
    let mut drifts: Vec<f64> = flights.iter().map(|f| f[variant].drift_percent).collect();
    drifts.sort_by(f64::total_cmp);
    let n = drifts.len();
    let median = (n > 0).then(|| 0.5 * (drifts[(n - 1) / 2] + drifts[n / 2]));
    let sum = |of: fn(&Flown) -> NeesCount| {
        flights.iter().map(|f| of(&f[variant])).fold(NeesCount::default(), NeesCount::merged)
    };
    let holdover = sum(|f| f.holdover);
    Row {
        imu,
        path,
        variant: VARIANTS[variant].label(),
        seeds: n,
        median_percent: median.filter(|m| m.is_finite()),
        max_percent: drifts.last().copied().filter(|m| m.is_finite()),
        nees_in_bounds: holdover.in_bounds(),
        means: [holdover.mean(), sum(|f| f.velocity).mean(), sum(|f| f.aided).mean()],
    }
}

fn run(args: &Args) -> Result<Vec<Row>, String> {
    let wanted = |choice: &Option<String>, name: &str| choice.as_deref().is_none_or(|c| c == name);
    let cases: Vec<(&'static str, &'static str)> = IMUS
        .into_iter()
        .filter(|i| wanted(&args.imu, i))
        .flat_map(|i| PATHS.into_iter().filter(|p| wanted(&args.path, p)).map(move |p| (i, p)))
        .collect();
    let seeds: Vec<u64> = (args.seeds.0..=args.seeds.1).collect();
    let jobs: Vec<_> = cases.iter().flat_map(|case| seeds.iter().map(move |seed| (*case, *seed))).collect();
    let flown = jobs::all("flights", &jobs, |((imu, path), seed)| fly(args, imu, path, *seed));
    let flights = flown.into_iter().collect::<Result<Vec<_>, String>>()?;
    Ok(cases
        .iter()
        .zip(flights.chunks(seeds.len()))
        .flat_map(|(&(imu, path), flights)| {
            (0..VARIANTS.len()).map(move |v| summarise(imu, path, v, flights))
        })
        .collect())
}

fn print(rows: &[Row], json: bool) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    if json {
        return writeln!(out, "{}", serde_json::json!({ "rows": rows }));
    }
    let number = |v: Option<f64>, digits: usize| v.map_or("-".to_owned(), |v| format!("{v:.digits$}"));
    writeln!(
        out,
        "Horizontal error after 600 s without GNSS, % of the distance; mean NEES of two axes (2 is honest)"
    )?;
    writeln!(
        out,
        "  {:9} {:9} {:12} {:>5} {:>8} {:>8} {:>10} {:>9} {:>9} {:>9}",
        "imu", "path", "variant", "seeds", "median", "max", "in bounds", "position", "velocity", "with GNSS"
    )?;
    for r in rows {
        writeln!(
            out,
            "  {:9} {:9} {:12} {:>5} {:>8} {:>8} {:>10} {:>9} {:>9} {:>9}",
            r.imu,
            r.path,
            r.variant,
            r.seeds,
            number(r.median_percent, 3),
            number(r.max_percent, 3),
            number(r.nees_in_bounds, 2),
            number(r.means[0], 1),
            number(r.means[1], 1),
            number(r.means[2], 1)
        )?;
    }
    Ok(())
}

fn main() -> ExitCode {
    let args = Args::parse();
    let done = run(&args).and_then(|rows| print(&rows, args.json).map_err(|e| e.to_string()));
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            let _ = writeln!(std::io::stderr(), "paper_dead_reckoning: {message}");
            ExitCode::FAILURE
        }
    }
}
