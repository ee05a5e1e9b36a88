//! A flight of a day in some minutes: does anything grow, and is anything refused, when the autopilot's clock passes 49.7 days?
//!
//! ```sh
//! cargo run --release --example long_flight -- --hours 24
//! ```
//!
//! The bytes of a simulated vehicle's telemetry go the way that they go in the daemon, without sockets. Half way the clock since boot passes 2³² ms. GNSS is
//! withheld for a minute in every hour. A line for every hour tells what the process holds in memory, how far the position is from the truth, and how
//! uncertain it is; the exit code is 1 if anything was refused, was not finite, or changed that should not. Linux only (`/proc`).

#[path = "../tests/support/long_flight.rs"]
mod long_flight;
mod process;

use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Parser;
use holdover::navigator::solution::Mode;
use holdover::wire::companion_clock::CompanionClock;

use long_flight::{LongFlight, LongFlightPlan, WRAP_S};
use process::{cpu_s, resident_mb};

/// Flies for long.
#[derive(Parser)]
struct Args {
    /// How long, h of the flight
    #[arg(long, default_value_t = 24.0)]
    hours: f64,
    /// Errors are drawn from this
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

const HOUR_S: f64 = 3600.0;
const OUTAGE_S: f64 = 60.0;

fn main() -> Result<ExitCode> {
    let args = Args::parse();
    let duration_s = args.hours * HOUR_S;
    let plan = LongFlightPlan {
        duration_s,
        boot_s: WRAP_S - duration_s / 2.0,
        outage_every_s: HOUR_S,
        outage_s: OUTAGE_S,
        seed: args.seed,
    };
    let mut flight = LongFlight::new(&plan).context("the settings are wrong")?;
    let (clock, pid) = (CompanionClock::new(), std::process::id());
    let begun = clock.now();
    println!("  hours  memory MB  error m  sigma m  mode      frames      refused");
    let (mut flown_s, mut next_s, mut memory_mb) = (0.0, 0.0, Vec::new());
    while let Some(t_s) = flight.step() {
        flown_s = t_s;
        // Not in an outage, which begins with the hour; the first minutes are the beginning.
        if t_s >= next_s + HOUR_S / 4.0 || next_s == 0.0 && t_s >= OUTAGE_S {
            next_s = if next_s == 0.0 { OUTAGE_S } else { next_s + HOUR_S };
            memory_mb.push(resident_mb(pid)?);
            line(t_s, memory_mb.last(), &flight);
        }
    }
    memory_mb.push(resident_mb(pid)?);
    line(flown_s, memory_mb.last(), &flight);
    let took_s = clock.now().seconds_since(begun);
    let grown_mb =
        memory_mb.last().copied().unwrap_or_default() - memory_mb.get(1).copied().unwrap_or_default();
    println!(
        "{:.1} h in {took_s:.0} s ({:.0} times real time), {:.0} s of a core; memory since the first hour {grown_mb:+.2} MB",
        flown_s / HOUR_S,
        flown_s / took_s,
        cpu_s(pid)?
    );
    Ok(if tell(&flight, &plan) { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn line(t_s: f64, memory_mb: Option<&f64>, flight: &LongFlight) {
    let Some(s) = &flight.solution else { return };
    println!(
        "{:7.2}  {:9.2}  {:7.2}  {:7.2}  {:8}  {:10}  {:7}",
        t_s / HOUR_S,
        memory_mb.copied().unwrap_or(f64::NAN),
        flight.error_m().unwrap_or(f64::NAN),
        s.horizontal_sigma_m(),
        s.mode.label(),
        flight.counts.frames,
        refused(flight)
    );
}

fn refused(flight: &LongFlight) -> u64 {
    flight.refused().seen().map(|(_, n)| n).sum()
}

/// Tells what came of it; whether it is as it should be.
fn tell(flight: &LongFlight, plan: &LongFlightPlan) -> bool {
    let counts = &flight.counts;
    let passed_s = plan.boot_s + plan.duration_s - WRAP_S;
    println!("clock:     2^32 ms since boot were passed {passed_s:.0} s before the end");
    println!(
        "read:      {} frames, {:.0} MB; no frame: {}",
        counts.frames,
        counts.bytes as f64 * 1e-6,
        counts.no_frame
    );
    let samples: Vec<String> = counts.samples.iter().map(|(kind, n)| format!("{kind} {n}")).collect();
    println!("decoded:   {}", samples.join(", "));
    let causes: Vec<String> =
        flight.refused().seen().map(|(cause, n)| format!("{n} {}", cause.label())).collect();
    println!("refused:   {}", if causes.is_empty() { "nothing".to_owned() } else { causes.join(", ") });
    for s in flight.sources() {
        let rejected: Vec<String> = s.rejected.iter().map(|(reason, n)| format!("{n} {reason}")).collect();
        println!(
            "           {} {}: {} used, {} fused, {} gated; {}",
            s.kind.label(),
            s.id,
            s.used,
            s.fused,
            s.gated,
            rejected.join(", ")
        );
    }
    println!("sent:      {}, not to be sent {}", counts.sent, counts.not_sent);
    println!(
        "solutions: {} not finite or no covariance, {} out of time; sigma at most {:.1} m",
        counts.unsound, counts.backwards, counts.most_sigma_m
    );
    let times = |mode| counts.modes.iter().filter(|(_, m)| *m == mode).count();
    println!(
        "modes:     {} aided, {} holdover, {} rejoining, {} lost",
        times(Mode::Aided),
        times(Mode::Holdover),
        times(Mode::Rejoining),
        times(Mode::Lost)
    );
    if let Some((offset, round_trip)) = flight.timesync() {
        println!("timesync:  {:.3} s, round trip {:.1} ms", offset.seconds(), 1e3 * round_trip.seconds());
    }
    for (t_s, event) in &counts.told {
        println!("told:      {t_s:.1} s: {event}");
    }
    refused(flight) + counts.no_frame + counts.not_sent + counts.unsound + counts.backwards == 0
        && counts.most_sigma_m.is_finite()
        && times(Mode::Lost) == 0
        && counts.told.len() == 1
}
