//! A picture of a flight through its outages, as an SVG on standard output: the way as Holdover navigated it beside the truth, and the horizontal
//! error beside what Holdover claims it to be.
//!
//! `cargo run --release --example outage_picture -- sitl-logs/ardupilot-copter-gps-loss.tlog [--outage A..B]… > picture.svg`
//!
//! The log has to hold the simulator's truth.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Result, bail};
use clap::Parser;
use holdover::log::Log;
use holdover::navigator::solution::Mode;
use holdover::replay::runner::{self, Runner};
use holdover::sample::{Input, Reference, TruthState};

#[path = "../tests/support/args.rs"]
mod args;
use args::{SettingsArgs, interval};

/// Seconds between two points of a line.
const PERIOD_S: f64 = 0.5;
const TRUTH: &str = "#8a8f98";
const AIDED: &str = "#1f6fb2";
const OUT: &str = "#d1481f";

#[derive(Parser)]
#[command(about = "A picture of a flight through its outages, as an SVG on standard output")]
struct Args {
    /// Telemetry log (.tlog) with the simulator's truth
    log: PathBuf,
    /// Withhold GNSS from A to B, seconds since the first sample; may be given several times
    #[arg(long, value_name = "A..B", value_parser = interval)]
    outage: Vec<(f64, f64)>,
    /// Settings
    #[command(flatten)]
    settings: SettingsArgs,
}

/// Where the vehicle was, and where Holdover had it: north and east, m.
#[derive(Clone, Copy)]
struct Point {
    t_s: f64,
    truth: (f64, f64),
    navigated: (f64, f64),
    sigma_m: f64,
    /// Without GNSS.
    out: bool,
}

impl Point {
    fn error_m(&self) -> f64 {
        (self.navigated.0 - self.truth.0).hypot(self.navigated.1 - self.truth.1)
    }
}

fn point(runner: &Runner, truth: &TruthState) -> Option<Point> {
    let solution = runner.solution().filter(|s| s.mode != Mode::Aligning)?;
    let true_ned = runner.pipeline.navigator.frame()?.to_ned(&truth.position?);
    let dt = truth.time.seconds_since(solution.time);
    let ned = (solution.position + solution.velocity * dt).raw();
    Some(Point {
        t_s: runner.seconds(truth.time),
        truth: (true_ned.x, true_ned.y),
        navigated: (ned.x, ned.y),
        sigma_m: solution.horizontal_sigma_m(),
        out: solution.mode == Mode::Holdover,
    })
}

fn fly(args: &Args) -> Result<Vec<Point>> {
    let settings = args.settings.load(&[])?;
    let log = Log::open(&args.log, settings.system)?;
    let mut points: Vec<Point> = Vec::new();
    runner::run(
        &log,
        &settings.pipeline,
        &args.outage,
        &[],
        |_| (),
        |runner, _, item, _| {
            if let Input::Reference(Reference::Truth(truth)) = item
                && let Some(p) = point(runner, truth)
                && points.last().is_none_or(|last| p.t_s - last.t_s > PERIOD_S)
            {
                points.push(p);
            }
        },
    )?;
    Ok(points)
}

/// A drawing area, and how metres or seconds become its units.
struct Panel {
    left: f64,
    bottom: f64,
    origin: (f64, f64),
    scale: (f64, f64),
}

impl Panel {
    fn place(&self, x: f64, y: f64) -> (f64, f64) {
        (self.left + (x - self.origin.0) * self.scale.0, self.bottom - (y - self.origin.1) * self.scale.1)
    }

    fn path(&self, points: impl Iterator<Item = (f64, f64)>) -> String {
        let mut d = String::new();
        for (i, (x, y)) in points.enumerate() {
            let (x, y) = self.place(x, y);
            let _ = write!(d, "{}{x:.1} {y:.1}", if i == 0 { "M" } else { "L" });
        }
        d
    }
}

fn line(svg: &mut String, d: &str, colour: &str, width: f64, more: &str) {
    let _ =
        writeln!(svg, "<path d=\"{d}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\" {more}/>");
}

fn label(svg: &mut String, x: f64, y: f64, text: &str, more: &str) {
    let _ = writeln!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\" {more}>{text}</text>");
}

/// Stretches of points with and without GNSS, each with one point of the next so that the line has no gaps.
fn stretches(points: &[Point]) -> Vec<&[Point]> {
    let mut out = Vec::new();
    let mut from = 0;
    for i in 1..=points.len() {
        if i == points.len() || points[i].out != points[from].out {
            out.push(&points[from..(i + 1).min(points.len())]);
            from = i;
        }
    }
    out
}

fn colour(stretch: &[Point]) -> &'static str {
    if stretch[0].out { OUT } else { AIDED }
}

/// The way from above, north up.
fn draw_map(svg: &mut String, points: &[Point]) {
    let all = || points.iter().flat_map(|p| [p.truth, p.navigated]);
    let bounds = |of: fn((f64, f64)) -> f64| {
        all().map(of).fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
    };
    let (north, east) = (bounds(|p| p.0), bounds(|p| p.1));
    let span = (north.1 - north.0).max(east.1 - east.0).max(1.0);
    let scale = 330.0 / span;
    let panel = Panel {
        left: 30.0,
        bottom: 400.0,
        origin: (0.5 * (east.0 + east.1) - 0.5 * span, 0.5 * (north.0 + north.1) - 0.5 * span),
        scale: (scale, scale),
    };
    label(svg, 30.0, 44.0, "From above, north up", "class=\"head\"");
    line(
        svg,
        &panel.path(points.iter().map(|p| (p.truth.1, p.truth.0))),
        TRUTH,
        4.0,
        "stroke-opacity=\"0.6\"",
    );
    for stretch in stretches(points) {
        let d = panel.path(stretch.iter().map(|p| (p.navigated.1, p.navigated.0)));
        line(svg, &d, colour(stretch), 1.4, "");
    }
    let bar = 10.0 * (span / 50.0).ceil();
    let _ = writeln!(svg, "<path d=\"M30 424h{:.1}\" stroke=\"#333\" stroke-width=\"2\"/>", bar * scale);
    label(svg, 36.0 + bar * scale, 428.0, &format!("{bar:.0} m"), "");
    for (i, (colour, width, text)) in [
        (TRUTH, 4, "the simulator's truth"),
        (AIDED, 2, "Holdover, with GNSS"),
        (OUT, 2, "Holdover, without GNSS"),
    ]
    .iter()
    .enumerate()
    {
        let x = 120.0 + 175.0 * i as f64;
        let _ = writeln!(svg, "<path d=\"M{x} 458h24\" stroke=\"{colour}\" stroke-width=\"{width}\"/>");
        label(svg, x + 30.0, 462.0, text, "");
    }
}

/// Horizontal error, and two of the standard deviations that are claimed, over time.
fn draw_errors(svg: &mut String, points: &[Point]) {
    let end = points.last().map_or(1.0, |p| p.t_s);
    let top = points.iter().map(|p| p.error_m().max(2.0 * p.sigma_m)).fold(1.0, f64::max).ceil();
    let panel = Panel { left: 430.0, bottom: 400.0, origin: (0.0, 0.0), scale: (440.0 / end, 330.0 / top) };
    label(svg, 430.0, 44.0, "Horizontal error, m (shaded: two sigmas as claimed)", "class=\"head\"");
    let metres = (top / 4.0).ceil();
    for i in 0..=(top / metres) as usize {
        let (x, y) = panel.place(0.0, metres * i as f64);
        line(svg, &format!("M{x:.1} {y:.1}h440"), "#ddd", 1.0, "");
        label(svg, x - 8.0, y + 4.0, &format!("{:.0}", metres * i as f64), "text-anchor=\"end\"");
    }
    for minute in 0..=(end / 60.0) as usize {
        let (x, y) = panel.place(60.0 * minute as f64, 0.0);
        label(svg, x, y + 18.0, &format!("{minute}"), "text-anchor=\"middle\"");
    }
    label(svg, 870.0, 434.0, "minutes of flight", "text-anchor=\"end\"");
    for stretch in stretches(points) {
        let (first, last) = (stretch[0].t_s, stretch[stretch.len() - 1].t_s);
        let band = stretch.iter().map(|p| (p.t_s, 2.0 * p.sigma_m)).chain([(last, 0.0), (first, 0.0)]);
        let d = panel.path(band);
        let _ = writeln!(svg, "<path d=\"{d}Z\" fill=\"{}\" fill-opacity=\"0.16\"/>", colour(stretch));
        if stretch[0].out {
            let (x, y) = panel.place(0.5 * (first + last), top);
            label(svg, x, y - 4.0, "no GNSS", &format!("text-anchor=\"middle\" fill=\"{OUT}\""));
        }
    }
    for stretch in stretches(points) {
        line(svg, &panel.path(stretch.iter().map(|p| (p.t_s, p.error_m()))), colour(stretch), 1.4, "");
    }
}

fn drawn(args: &Args, points: &[Point]) -> String {
    let name = args.log.file_name().unwrap_or_default().to_string_lossy();
    let mut svg = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 900 480\" font-family=\"sans-serif\" font-size=\"12\" fill=\"#333\">\n\
         <style>.head{font-size:14px;font-weight:bold}</style>\n<rect width=\"900\" height=\"480\" fill=\"#fff\"/>\n",
    );
    label(
        &mut svg,
        870.0,
        20.0,
        &format!("{name}, replayed by Holdover"),
        "text-anchor=\"end\" fill=\"#777\"",
    );
    draw_map(&mut svg, points);
    draw_errors(&mut svg, points);
    svg.push_str("</svg>\n");
    svg
}

fn run(args: &Args) -> Result<()> {
    let points = fly(args)?;
    if points.is_empty() {
        bail!("{}: no truth beside a solution", args.log.display());
    }
    Ok(std::io::stdout().lock().write_all(drawn(args, &points).as_bytes())?)
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            let _ = writeln!(std::io::stderr(), "outage_picture: {failure:#}");
            ExitCode::FAILURE
        }
    }
}
