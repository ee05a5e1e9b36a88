//! What the daemon costs: plays a flight to it, in holdover, and prints its share of a core and its memory.
//!
//! ```text
//! cargo build --release && cargo run --release --example daemon_cost -- --seconds 40
//! ```
//! The recorded 100 Hz of IMU are played twice as fast: 200 Hz. Linux only (`/proc`).

use std::fs;
use std::io::{BufRead, BufReader};
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Parser;
use holdover::time::Stamp;
use holdover::wire::companion_clock::CompanionClock;
use holdover::wire::tlog::TlogReader;

mod process;

use process::{cpu_s, resident_mb};

/// Measures what the daemon costs.
#[derive(Parser)]
struct Args {
    /// How long to measure, s
    #[arg(long, default_value_t = 40.0)]
    seconds: f64,
    /// How much faster than real time the flight is played
    #[arg(long, default_value_t = 2.0)]
    speed: f64,
    /// The flight
    #[arg(long, default_value = "sitl-logs/ardupilot-copter-gps-loss.tlog")]
    log: PathBuf,
    /// The daemon; by default the one that was built with this example
    #[arg(long)]
    holdover: Option<PathBuf>,
}

/// Kills the daemon, whatever happens.
struct Daemon(Child);

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn main() -> Result<()> {
    let args = Args::parse();
    let exe = match &args.holdover {
        Some(path) => path.clone(),
        // target/release/examples/daemon_cost
        None => std::env::current_exe()?
            .parent()
            .and_then(Path::parent)
            .context("where is the build?")?
            .join("holdover"),
    };
    let child = Command::new(&exe)
        .args(["run", "--endpoint", "udpin:127.0.0.1:0", "--deny-gnss", "20..100000"])
        // Lost after a while, the daemon would send nothing: this is about what it costs to send.
        .args(["--set", "holdover.max_sigma_m=100000", "--set", "holdover.max_coast_s=3600"])
        .stderr(Stdio::piped())
        .spawn()
        .with_context(|| format!("{} (run cargo build --release first)", exe.display()))?;
    let mut daemon = Daemon(child);
    let stderr = daemon.0.stderr.take().context("no log")?;
    let mut lines = BufReader::new(stderr).lines();
    let address = loop {
        let line = lines.next().context("the daemon has ended")??;
        if let Some((_, address)) = line.split_once("listens at ") {
            break address.to_owned();
        }
    };
    std::thread::spawn(move || lines.map_while(Result::ok).for_each(|line| eprintln!("{line}")));
    let socket = UdpSocket::bind("127.0.0.1:0")?;
    socket.connect(&address)?;
    socket.set_nonblocking(true)?;
    measure(&args, &daemon, &socket)
}

fn measure(args: &Args, daemon: &Daemon, socket: &UdpSocket) -> Result<()> {
    let mut reader = TlogReader::new(fs::File::open(&args.log).context(args.log.display().to_string())?);
    let clock = CompanionClock::new();
    let mut first_us = None;
    let (mut frames, mut imu, mut received) = (0u64, 0u64, 0u64);
    // A few seconds to start and align are not counted.
    let settle_s = 15.0;
    let mut begun = None;
    let mut buffer = [0; 2000];
    while let Some(record) = reader.next_record()? {
        let us = record.written_us - *first_us.get_or_insert(record.written_us);
        let due = Stamp::from_micros((us as f64 / args.speed) as i64);
        let ahead = (due - clock.now()).seconds();
        if ahead > 0.0 {
            sleep(Duration::from_secs_f64(ahead));
        }
        let now = clock.now().micros() as f64 * 1e-6;
        if begun.is_none() && now > settle_s {
            begun = Some((now, cpu_s(daemon.0.id())?));
            (frames, imu, received) = (0, 0, 0);
        }
        if begun.is_some_and(|(then, _)| now - then >= args.seconds) {
            break;
        }
        socket.send(record.frame.bytes())?;
        frames += 1;
        imu += u64::from(record.frame.message_id() == 105);
        while socket.recv(&mut buffer).is_ok() {
            received += 1;
        }
    }
    let Some((then, cpu_before)) = begun else { bail!("the flight is too short") };
    let elapsed = clock.now().micros() as f64 * 1e-6 - then;
    let cpu = cpu_s(daemon.0.id())? - cpu_before;
    println!("measured for {elapsed:.1} s, one datagram a frame");
    println!("in:      {:.0} frames/s, {:.0} of them IMU", frames as f64 / elapsed, imu as f64 / elapsed);
    println!("out:     {:.0} frames/s", received as f64 / elapsed);
    println!("CPU:     {:.2} % of a core", 100.0 * cpu / elapsed);
    println!("memory:  {:.1} MB resident", resident_mb(daemon.0.id())?);
    Ok(())
}
