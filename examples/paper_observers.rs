//! Grip's observer as in its paper and tuned, on the paper's flight; and how fast attitudes are found from any start.
//!
//! `cargo run --release --example paper_observers -- [--seeds 1..10] [--starts 60] [--json]`
//!
//! The flight is that of Grip, Section V: take-off, climb and two steep turns of a Cessna 172, IMU at 100 Hz, GNSS at 5 Hz, white noise on
//! everything, a gyro bias of 1.41 °/s and a start that is 160° wrong in yaw. Progress goes to standard error, the tables to standard output.

#![allow(clippy::print_stdout, reason = "the tables are what it is for")]

#[path = "../tests/support/flight.rs"]
mod flight;
#[path = "../tests/support/jobs.rs"]
mod jobs;
#[path = "../tests/support/observing.rs"]
mod observing;

use clap::Parser;
use flight::white;
use holdover::observer::{FusiniParams, GripParams, Scheme, TranslationGains};
use holdover::sim::models::ImuModel;
use holdover::sim::{Scenario, Trajectory};
use jobs::all;
use observing::{FAST_S, Observer, Run, cessna, measure, run, wrong_by, wrong_yaw};
use serde::Serialize;

/// An attitude has been found when its error is below this, °.
const FOUND_DEG: f64 = 5.0;
/// Start-up runs last this long, s.
const START_S: f64 = 120.0;

/// Grip's observer on the flight of its paper, and start-up from any attitude
#[derive(Parser)]
struct Args {
    /// Seeds of the sensors' noise, first and last
    #[arg(long, default_value = "1..10")]
    seeds: String,
    /// Random first attitudes for each row of the start-up table
    #[arg(long, default_value_t = 60)]
    starts: u64,
    /// Prints the rows as JSON
    #[arg(long)]
    json: bool,
}

/// A row of Grip's table: medians over the seeds, and the worst.
#[derive(Serialize)]
struct SteadyRow {
    variant: &'static str,
    seeds: usize,
    roll_deg: f64,
    pitch_deg: f64,
    yaw_deg: f64,
    position_m: f64,
    velocity_mps: f64,
    /// When the bias has converged, s; `None` when it does not.
    bias_s: Option<f64>,
    worst: Worst,
}

#[derive(Serialize)]
struct Worst {
    roll_deg: f64,
    pitch_deg: f64,
    yaw_deg: f64,
    position_m: f64,
    velocity_mps: f64,
    bias_s: Option<f64>,
}

/// A row of the start-up table.
#[derive(Serialize)]
struct StartRow {
    observer: &'static str,
    gated: bool,
    from_deg: [f64; 2],
    starts: usize,
    /// Below 5° within the run.
    found: usize,
    median_s: Option<f64>,
    worst_s: Option<f64>,
}

#[derive(Serialize)]
struct Report {
    rows: Vec<SteadyRow>,
    start_up: Vec<StartRow>,
}

fn main() -> std::process::ExitCode {
    let args = Args::parse();
    let Some(seeds) = range(&args.seeds) else {
        eprintln!("--seeds {}: expected FIRST..LAST", args.seeds);
        return std::process::ExitCode::from(2);
    };
    let report = Report { rows: steady(&seeds), start_up: start_up(args.starts.max(1)) };
    if args.json {
        match serde_json::to_string(&report) {
            Ok(text) => println!("{text}"),
            Err(e) => eprintln!("{e}"),
        }
    } else {
        print(&report);
    }
    std::process::ExitCode::SUCCESS
}

/// "1..10": both ends included.
fn range(text: &str) -> Option<Vec<u64>> {
    let (first, last) = text.split_once("..")?;
    let (first, last) =
        (first.trim().parse::<u64>().ok()?, last.trim_start_matches('=').trim().parse().ok()?);
    (first <= last).then(|| (first..=last).collect())
}

/// A way to run the observer on the paper's flight.
struct Variant {
    name: &'static str,
    scheme: Scheme,
    velocity: bool,
    /// Start-up parameters for the first 30 s, if any.
    start: Option<GripParams>,
    params: GripParams,
}

/// What to use on this flight.
fn tuned() -> GripParams {
    GripParams { gains: TranslationGains::soft(), ..GripParams::km() }
}

fn variants() -> [Variant; 6] {
    let isp = Scheme::InterSample;
    let published = |params| GripParams { gate: None, min_magnetic_sine: 0.0, ..params };
    [
        Variant {
            name: "printed gains, Euler, held fixes",
            scheme: Scheme::Hold,
            velocity: true,
            start: None,
            params: GripParams::printed(),
        },
        Variant {
            name: "KM gains, exact steps, predictor",
            scheme: isp,
            velocity: true,
            start: None,
            params: published(GripParams::km()),
        },
        Variant {
            name: "the same, GNSS position only",
            scheme: isp,
            velocity: false,
            start: None,
            params: published(GripParams::km().position_only()),
        },
        Variant {
            name: "KM with a gated fast start of 30 s",
            scheme: isp,
            velocity: true,
            start: Some(GripParams::start_up()),
            params: GripParams::km(),
        },
        Variant {
            name: "tuned: soft position gains as well",
            scheme: isp,
            velocity: true,
            start: Some(GripParams { gains: tuned().gains, ..GripParams::start_up() }),
            params: tuned(),
        },
        Variant {
            name: "KM, fast start, GNSS position only",
            scheme: isp,
            velocity: false,
            start: Some(GripParams::start_up().position_only()),
            params: GripParams::km().position_only(),
        },
    ]
}

fn steady(seeds: &[u64]) -> Vec<SteadyRow> {
    let scenario = Scenario::cessna();
    let start = wrong_yaw(&scenario);
    let variants = variants();
    let jobs: Vec<(&Variant, u64)> =
        variants.iter().flat_map(|v| seeds.iter().map(move |s| (v, *s))).collect();
    let results = all("Cessna flight", &jobs, |(variant, seed)| {
        let what = Run {
            scheme: variant.scheme,
            with_gnss_velocity: variant.velocity,
            staged_s: if variant.start.is_some() { FAST_S } else { 0.0 },
            ..cessna(&scenario, *seed)
        };
        let then = Observer::Grip(variant.params);
        let first = Observer::Grip(variant.start.unwrap_or(variant.params));
        measure(&run(&what, &first, &then, start))
    });
    let row = |(variant, results): (&Variant, &[[f64; 6]])| {
        let column = |i: usize| -> Vec<f64> { results.iter().map(|r| r[i]).collect() };
        let mid = |i: usize| median(column(i));
        let worst = |i: usize| column(i).into_iter().fold(0.0, f64::max);
        let finite = |v: f64| v.is_finite().then_some(v);
        SteadyRow {
            variant: variant.name,
            seeds: results.len(),
            roll_deg: mid(0),
            pitch_deg: mid(1),
            yaw_deg: mid(2),
            position_m: mid(3),
            velocity_mps: mid(4),
            bias_s: finite(mid(5)),
            worst: Worst {
                roll_deg: worst(0),
                pitch_deg: worst(1),
                yaw_deg: worst(2),
                position_m: worst(3),
                velocity_mps: worst(4),
                bias_s: finite(worst(5)),
            },
        }
    };
    variants.iter().zip(results.chunks(seeds.len())).map(row).collect()
}

fn start_up(starts: u64) -> Vec<StartRow> {
    let ungated = |p: GripParams| GripParams { gate: None, ..p };
    let observers: [(&'static str, bool, Observer); 4] = [
        ("Grip, magnetometer", true, Observer::Grip(GripParams::start_up())),
        ("Grip, magnetometer", false, Observer::Grip(ungated(GripParams::km()))),
        ("Fusini, flow", true, Observer::Fusini(FusiniParams::start_up(), false, 1.0)),
        (
            "Fusini, flow",
            false,
            Observer::Fusini(FusiniParams { gate: None, ..FusiniParams::tuned() }, false, 1.0),
        ),
    ];
    let bands = [[0.0, 45.0], [45.0, 90.0], [90.0, 135.0], [135.0, 180.0], [180.0, 180.0]];
    let circle = Scenario::circle(300.0, 25.0, 40.0);
    let eight = Scenario::figure_eight();
    let mut jobs = Vec::new();
    for (_, _, observer) in &observers {
        for band in &bands {
            jobs.extend((0..starts).map(|k| (observer, *band, k)));
        }
    }
    let found = all("start-up", &jobs, |(observer, [low, high], k)| {
        let scenario = if k % 2 == 0 { &circle } else { &eight };
        let suite = white(if k / 2 % 2 == 0 { ImuModel::tactical() } else { ImuModel::mems() });
        let angle = low + (high - low) * (*k as f64 + 0.5) / starts as f64;
        let start = wrong_by(&scenario.at(0.0).r_body_to_ned, angle, *k);
        let points = run(&Run::new(scenario, suite, *k, START_S), observer, observer, start);
        points.iter().find(|p| p.angle < FOUND_DEG.to_radians()).map_or(f64::INFINITY, |p| p.t)
    });
    let rows = observers.iter().flat_map(|(name, gated, _)| bands.iter().map(move |b| (*name, *gated, *b)));
    rows.zip(found.chunks(starts as usize))
        .map(|((observer, gated, from_deg), times)| {
            let finite = |v: f64| v.is_finite().then_some(v);
            StartRow {
                observer,
                gated,
                from_deg,
                starts: times.len(),
                found: times.iter().filter(|t| t.is_finite()).count(),
                median_s: finite(median(times.to_vec())),
                worst_s: finite(times.iter().copied().fold(0.0, f64::max)),
            }
        })
        .collect()
}

fn median(mut v: Vec<f64>) -> f64 {
    v.sort_by(f64::total_cmp);
    v.get(v.len() / 2).copied().unwrap_or(f64::INFINITY)
}

fn seconds(s: Option<f64>) -> String {
    s.map_or("-".into(), |s| format!("{s:.1}"))
}

fn print(report: &Report) {
    println!(
        "Grip's observer on a Cessna 172's flight, 160 deg of initial yaw error, 1.41 deg/s of gyro bias"
    );
    println!("RMS from 120 s: median over the seeds / worst; the bias error stays below 0.1 deg/s from");
    println!(
        "  {:36} {:>11} {:>11} {:>11} {:>11} {:>11} {:>13}",
        "", "roll deg", "pitch deg", "yaw deg", "p m", "v m/s", "bias s"
    );
    for r in &report.rows {
        let pair = |a: f64, b: f64| format!("{a:.2}/{b:.2}");
        let w = &r.worst;
        println!(
            "  {:36} {:>11} {:>11} {:>11} {:>11} {:>11} {:>13}",
            r.variant,
            pair(r.roll_deg, w.roll_deg),
            pair(r.pitch_deg, w.pitch_deg),
            pair(r.yaw_deg, w.yaw_deg),
            pair(r.position_m, w.position_m),
            pair(r.velocity_mps, w.velocity_mps),
            format!("{}/{}", seconds(r.bias_s), seconds(w.bias_s)),
        );
    }
    println!();
    println!(
        "Time until the attitude error is below 5 deg, from an error about a random axis, over turning flights"
    );
    println!(
        "  {:20} {:>7} {:>12} {:>8} {:>10} {:>10}",
        "", "gated", "from deg", "found", "median s", "worst s"
    );
    for r in &report.start_up {
        println!(
            "  {:20} {:>7} {:>12} {:>8} {:>10} {:>10}",
            r.observer,
            if r.gated { "yes" } else { "no" },
            format!("{:.0}..{:.0}", r.from_deg[0], r.from_deg[1]),
            format!("{}/{}", r.found, r.starts),
            seconds(r.median_s),
            seconds(r.worst_s),
        );
    }
}
