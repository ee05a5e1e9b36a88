//! Fuzzing for hours on the stable toolchain: a seeded mutator over the corpus, the targets of `tests/fuzz`.
//!
//! ```sh
//! cargo run --release --example fuzz -- --hours 1                          # all targets in turn
//! cargo run --release --example fuzz -- --target pipeline --executions 1000000 --seed 7
//! ```
//!
//! What a target does not stand is written to `target/fuzz/` and told, and the exit code is 1.

#[path = "../tests/fuzz/bodies/mod.rs"]
mod bodies;
#[path = "../tests/fuzz/mutate.rs"]
mod mutate;

use std::fs;
use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Parser;
use holdover::wire::companion_clock::CompanionClock;

use bodies::{FuzzTarget, TARGETS};
use mutate::{Dice, corpus, mutated, tried};

/// Fuzzes.
#[derive(Parser)]
struct FuzzArgs {
    /// How long, h; all targets share it
    #[arg(long)]
    hours: Option<f64>,
    /// How many inputs of each target
    #[arg(long)]
    executions: Option<u64>,
    /// Only this target; may be given several times
    #[arg(long)]
    target: Vec<String>,
    /// The same seed gives the same inputs
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Inputs between two looks at the clock.
const AT_ONCE: u64 = 64;
/// Findings of one target, after which it is left alone.
const MOST_FINDINGS: u64 = 20;
/// Seconds between two lines about a target.
const TOLD_EVERY_S: f64 = 60.0;

fn main() -> Result<ExitCode> {
    let args = FuzzArgs::parse();
    // What panics is told once, as a finding.
    std::panic::set_hook(Box::new(|_| {}));
    let chosen: Vec<&FuzzTarget> = TARGETS
        .iter()
        .filter(|t| args.target.is_empty() || args.target.iter().any(|n| n == t.name))
        .collect();
    anyhow::ensure!(!chosen.is_empty(), "no such target");
    let mut findings = 0;
    for target in &chosen {
        let share_s = args.hours.map(|h| h * 3600.0 / chosen.len() as f64);
        // Without a limit of its own each target gets a minute.
        let limit_s = share_s.or_else(|| args.executions.is_none().then_some(60.0));
        findings += campaign(target, limit_s, args.executions, args.seed)?;
    }
    Ok(if findings == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Fuzzes one target, up to a time and a number of inputs; its findings.
fn campaign(target: &FuzzTarget, limit_s: Option<f64>, executions: Option<u64>, seed: u64) -> Result<u64> {
    let inputs = corpus(target.name);
    let clock = CompanionClock::new();
    let begun = clock.now();
    let mut dice = Dice(seed);
    let (mut tries, mut got_through, mut findings, mut told_s) = (0u64, 0u64, 0u64, 0.0);
    let line = |tries: u64, got_through: u64, findings: u64, s: f64| {
        println!(
            "{:10} {tries:>12} inputs {got_through:>14} frames {findings:>3} findings {s:>8.0} s",
            target.name
        );
    };
    loop {
        let elapsed_s = clock.now().seconds_since(begun);
        let over = limit_s.is_some_and(|limit| elapsed_s >= limit) || executions.is_some_and(|n| tries >= n);
        if over || findings >= MOST_FINDINGS {
            line(tries, got_through, findings, elapsed_s);
            return Ok(findings);
        }
        if elapsed_s - told_s >= TOLD_EVERY_S {
            told_s = elapsed_s;
            line(tries, got_through, findings, elapsed_s);
        }
        for _ in 0..AT_ONCE {
            let bytes = mutated(&mut dice, &inputs);
            tries += 1;
            match tried(target.run, &bytes) {
                Ok(n) => got_through += n,
                Err(why) => {
                    findings += 1;
                    keep(target.name, seed, tries, &bytes)?;
                    println!("{:10} input {tries} of seed {seed}: {why}", target.name);
                }
            }
        }
    }
}

/// Keeps an input that was not survived.
fn keep(target: &str, seed: u64, tries: u64, bytes: &[u8]) -> Result<()> {
    let folder = Path::new("target/fuzz").join(target);
    let path = folder.join(format!("seed-{seed}-input-{tries}"));
    fs::create_dir_all(&folder).and_then(|()| fs::write(&path, bytes)).context(path.display().to_string())
}
