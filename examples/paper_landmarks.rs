//! Pose from known landmarks: the paper's three cases, and a drone over a field of markers against a gated extended Kalman filter.
//!
//! `cargo run --release --example paper_landmarks -- [--seed N] [--seeds 24] [--json]`
//!
//! The paper's part is Aguiar, Section V: a circle, four points, an inertial system at 10 Hz and a camera every 0.4 s that is 0.05 s late. The
//! drone's part: 40 s, dead reckoning at 50 Hz, a camera at 10 Hz of 0.015 rad, 10 markers, a start that is wrong by 3 m an axis and by any
//! attitude. "Converged" is within 0.5 m and 5° from 24 s at the latest to the end; errors are those of the runs that converged, from 24 s.
//! The extended Kalman filter has the same rows, noise and gate as the refining filter, and is linearised about itself.

#![allow(clippy::print_stdout, reason = "the tables are what it is for")]
#![allow(clippy::expect_used, reason = "the support of tests, which may fail")]

#[path = "../tests/support/jobs.rs"]
mod jobs;
#[path = "../tests/support/marker_flight.rs"]
mod marker_flight;
#[path = "../tests/support/paper_vision.rs"]
mod paper_vision;

use clap::Parser;
use holdover::landmark::Discount;
use holdover::sim::{MarkerCamera, MarkerField, MotionNoise, Wander};
use jobs::all;
use marker_flight::{Case, Error, converged_at, ekf_errors, errors, rms};
use paper_vision::{PaperRun, Point, least_gamma};
use serde::Serialize;

const DURATION_S: f64 = 40.0;
/// A run has converged when it is within the limits from here on.
const BY_S: f64 = 24.0;
/// Errors are looked at every so many steps.
const EVERY: usize = 5;

/// The H-infinity filter on the paper's example, and a drone's pose from markers
#[derive(Parser)]
struct Args {
    /// Seed of everything; the drone's flights use this one and those after it
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Flights for each row
    #[arg(long, default_value_t = 24)]
    seeds: u64,
    /// Prints the rows as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct PaperRow {
    case: &'static str,
    position_error_m: f64,
    attitude_error_deg: f64,
}

#[derive(Serialize)]
struct Row {
    delay_ms: f64,
    dropout: f64,
    wrong_ids: f64,
    attitude_deg: Option<f64>,
    filter: &'static str,
    converged: usize,
    of: usize,
    t50_s: Option<f64>,
    t90_s: Option<f64>,
    position_rmse_m: Option<f64>,
    attitude_rmse_deg: Option<f64>,
}

#[derive(Serialize)]
struct Report {
    paper: Vec<PaperRow>,
    rows: Vec<Row>,
}

/// What is flown over.
#[derive(Clone, Copy, PartialEq)]
enum Place {
    Field,
    Coplanar,
    Hover,
    HoverCoplanar,
}

/// A row of the table: conditions.
#[derive(Clone, Copy)]
struct Conditions {
    place: Place,
    delay_ms: f64,
    dropout: f64,
    wrong_ids: f64,
    attitude_deg: Option<f64>,
}

const FILTERS: [&str; 3] = ["hinf", "refined", "ekf"];

fn main() -> std::process::ExitCode {
    let args = Args::parse();
    let paper = paper_cases(args.seed);
    let usual = Conditions {
        place: Place::Field,
        delay_ms: 100.0,
        dropout: 0.4,
        wrong_ids: 0.03,
        attitude_deg: None,
    };
    let mut grid = Vec::new();
    for delay_ms in [0.0, 100.0, 300.0] {
        for dropout in [0.0, 0.4, 0.8] {
            grid.extend([0.0, 0.03, 0.1, 0.2].map(|wrong_ids| Conditions {
                delay_ms,
                dropout,
                wrong_ids,
                ..usual
            }));
        }
    }
    grid.extend([10.0, 45.0, 90.0, 135.0, 180.0].map(|a| Conditions { attitude_deg: Some(a), ..usual }));
    let shown = grid.len();
    if !args.json {
        for place in [Place::Coplanar, Place::Hover, Place::HoverCoplanar] {
            grid.extend([Some(10.0), None].map(|attitude_deg| Conditions { place, attitude_deg, ..usual }));
        }
    }
    let seeds = args.seed..args.seed.saturating_add(args.seeds.max(1));
    let rows = drone(&grid, &seeds.collect::<Vec<u64>>());
    if args.json {
        let paper = paper.into_iter().map(|(row, _)| row).collect();
        match serde_json::to_string(&Report { paper, rows }) {
            Ok(text) => println!("{text}"),
            Err(e) => eprintln!("{e}"),
        }
        return std::process::ExitCode::SUCCESS;
    }
    print_paper(&paper);
    print_gammas();
    print_rows(&grid, &rows, shown);
    std::process::ExitCode::SUCCESS
}

/// The three cases with their errors over time: no noise, 5 % noise, 5 % noise with the camera alone.
fn paper_cases(seed: u64) -> Vec<(PaperRow, Vec<Point>)> {
    let discount = Discount { gamma: 100.0, lambda: 0.3 };
    [("a", 0.0, false), ("b", 0.05, false), ("c", 0.05, true)]
        .map(|(case, noise, camera_only)| {
            let what = PaperRun { discount, noise, camera_only, duration_s: DURATION_S, seed };
            let (points, _) = paper_vision::run(&what);
            let [position_error_m, attitude] = rms(&points, 20.0);
            (PaperRow { case, position_error_m, attitude_error_deg: attitude.to_degrees() }, points)
        })
        .into()
}

/// Flies every seed of every row on every core.
fn drone(grid: &[Conditions], seeds: &[u64]) -> Vec<Row> {
    let jobs: Vec<(Conditions, u64)> =
        grid.iter().flat_map(|c| seeds.iter().map(move |s| (*c, *s))).collect();
    let results = all("flights", &jobs, |(conditions, seed)| fly(conditions, *seed));
    let mut rows = Vec::new();
    for (c, runs) in grid.iter().zip(results.chunks(seeds.len())) {
        for (i, filter) in FILTERS.into_iter().enumerate() {
            let found: Vec<(f64, Error)> = runs.iter().filter_map(|r| r[i]).collect();
            let mut times: Vec<f64> = found.iter().map(|f| f.0).collect();
            times.sort_by(f64::total_cmp);
            // Of all runs, those that never converge being the last.
            let at = |part: f64| times.get((part * runs.len() as f64).ceil() as usize - 1).copied();
            let rmse = |k: usize| {
                let mean = found.iter().map(|f| f.1[k].powi(2)).sum::<f64>() / found.len() as f64;
                (!found.is_empty()).then(|| mean.sqrt())
            };
            rows.push(Row {
                delay_ms: c.delay_ms,
                dropout: c.dropout,
                wrong_ids: c.wrong_ids,
                attitude_deg: c.attitude_deg,
                filter,
                converged: found.len(),
                of: runs.len(),
                t50_s: at(0.5),
                t90_s: at(0.9),
                position_rmse_m: rmse(0),
                attitude_rmse_deg: rmse(1).map(f64::to_degrees),
            });
        }
    }
    rows
}

/// When each filter has converged, and its error then.
fn fly(c: &Conditions, seed: u64) -> [Option<(f64, Error)>; 3] {
    let phase = (seed as f64 * 0.618_034).fract();
    let moving = matches!(c.place, Place::Field | Place::Coplanar);
    let trajectory = if moving { Wander::over_field(phase) } else { Wander::hover(phase) };
    let height = if matches!(c.place, Place::Field | Place::Hover) { 1.3 } else { 0.0 };
    let field = MarkerField::scattered(seed, 10, 4.0, height);
    let case = Case {
        trajectory: &trajectory,
        field: &field,
        camera: MarkerCamera {
            delay_s: c.delay_ms * 1e-3,
            dropout: c.dropout,
            wrong_ids: c.wrong_ids,
            ..MarkerCamera::downward()
        },
        noise: MotionNoise::mems(),
        settings: Default::default(),
        attitude_rad: c.attitude_deg.map(f64::to_radians),
        tells_attitude: false,
        duration_s: DURATION_S,
        seed,
    };
    let (hinf, refined) = errors(&case, EVERY);
    let limits = [0.5, 5f64.to_radians()];
    [hinf, refined, ekf_errors(&case, EVERY)]
        .map(|e| converged_at(&e, limits, BY_S).map(|t| (t, rms(&e, BY_S))))
}

fn print_paper(cases: &[(PaperRow, Vec<Point>)]) {
    println!("The paper's example, gamma 100, lambda 0.3: position error m / attitude error deg");
    println!("  {:8} {:>20} {:>20} {:>20}", "t s", "a: no noise", "b: 5 % noise", "c: camera alone");
    for t in [0.0, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0] {
        let at = |points: &[Point]| {
            let found = points.iter().rev().find(|(s, _)| *s <= t + 1e-6);
            found.map_or("-".into(), |(_, [p, a])| format!("{p:.2e} / {:.2e}", a.to_degrees()))
        };
        let row: Vec<String> = cases.iter().map(|(_, points)| format!("{:>20}", at(points))).collect();
        println!("  {t:<8} {}", row.join(" "));
    }
    let rms = |r: &PaperRow| format!("{:.2e} / {:.2e}", r.position_error_m, r.attitude_error_deg);
    let row: Vec<String> = cases.iter().map(|(r, _)| format!("{:>20}", rms(r))).collect();
    println!("  {:8} {}", "RMS 20-", row.join(" "));
    println!();
}

fn print_gammas() {
    println!("Smallest gamma that keeps P definite over 40 s");
    println!("  {:8} {:>16} {:>16}", "lambda", "IMU and camera", "camera alone");
    for lambda in [0.0, 0.1, 0.3, 0.5, 1.0] {
        println!("  {lambda:<8} {:>16.1} {:>16.1}", least_gamma(lambda, false), least_gamma(lambda, true));
    }
    println!();
}

fn print_rows(grid: &[Conditions], rows: &[Row], shown: usize) {
    println!(
        "A drone over 10 markers: runs converged, median and 90 % of the time it takes, errors afterwards"
    );
    println!(
        "  {:12} {:>5} {:>5} {:>5} {:>8}   {:8} {:>6} {:>10} {:>15}",
        "", "ms", "lost", "wrong", "att deg", "", "", "t50/t90 s", "RMSE m/deg"
    );
    for (i, (c, rows)) in grid.iter().zip(rows.chunks(FILTERS.len())).enumerate() {
        if i == shown {
            println!("  where the geometry is poor:");
        }
        let name = match c.place {
            Place::Field => "moving",
            Place::Coplanar => "coplanar",
            Place::Hover => "hover",
            Place::HoverCoplanar => "both",
        };
        let attitude = c.attitude_deg.map_or("any".into(), |a| format!("{a}"));
        let seconds = |t: Option<f64>| t.map_or("-".into(), |t| format!("{t:.1}"));
        for r in rows {
            let error = match (r.position_rmse_m, r.attitude_rmse_deg) {
                (Some(p), Some(a)) => format!("{p:.3}/{a:.2}"),
                _ => "-".into(),
            };
            println!(
                "  {name:12} {:>5} {:>5} {:>5} {attitude:>8}   {:8} {:>6} {:>10} {error:>15}",
                c.delay_ms,
                c.dropout,
                c.wrong_ids,
                r.filter,
                format!("{}/{}", r.converged, r.of),
                format!("{}/{}", seconds(r.t50_s), seconds(r.t90_s)),
            );
        }
    }
}
