//! What the daemon does while it is attacked: plays a flight to it, floods its port, and prints what still comes out, and when.
//!
//! ```text
//! cargo build --release --bins --examples
//! target/release/examples/hostile_link --flood-mbps 10 --from stranger --bytes fe --seconds 30
//! target/release/examples/hostile_link --stderr blocked
//! target/release/examples/hostile_link --pause-s 2
//! ```
//! The start of the flight is played ten times as fast; then it is played at `--speed`, and measured. The recorded 100 Hz of IMU are 200 Hz
//! when they are played twice as fast. The latency is that of an ODOMETRY: from the sending of the IMU sample that it stands on to its
//! arrival. Frames that are lost are counted by questions for the time, which the daemon answers. Linux only (`/proc`).

use std::collections::HashMap;
use std::fs;
use std::io::{BufRead, BufReader, PipeReader, Write};
use std::net::{SocketAddr, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::{Parser, ValueEnum};
use holdover::time::Stamp;
use holdover::wire::companion_clock::CompanionClock;
use holdover::wire::frame::{ComponentId, Scan, SystemId, scan};
use holdover::wire::session::Address;
use holdover::wire::session::outgoing::FrameWriter;
use holdover::wire::tlog::TlogReader;
use mavlink::dialects::ardupilotmega::{MavMessage, TIMESYNC_DATA};

mod process;

use process::{cpu_s, resident_mb};

/// Measures the daemon under attack.
#[derive(Parser, Clone)]
struct Args {
    /// How long to measure, s
    #[arg(long, default_value_t = 30.0)]
    seconds: f64,
    /// How much faster than real time the flight is played
    #[arg(long, default_value_t = 2.0)]
    speed: f64,
    /// The flight
    #[arg(long, default_value = "sitl-logs/ardupilot-copter-gps-loss.tlog")]
    log: PathBuf,
    /// Hostile bytes per second, MB/s
    #[arg(long, default_value_t = 0.0)]
    flood_mbps: f64,
    /// Whose address they come from
    #[arg(long, value_enum, default_value_t = Whose::Stranger)]
    from: Whose,
    /// What they are
    #[arg(long, value_enum, default_value_t = Bytes::Fe)]
    bytes: Bytes,
    /// Bytes in a hostile datagram
    #[arg(long, default_value_t = 65_000)]
    datagram: usize,
    /// Hostile sockets, each with a port of its own
    #[arg(long, default_value_t = 4)]
    strangers: usize,
    /// What becomes of the daemon's log
    #[arg(long, value_enum, default_value_t = Log::Shown)]
    stderr: Log,
    /// Stops the daemon (SIGSTOP) for so long half way, s
    #[arg(long, default_value_t = 0.0)]
    pause_s: f64,
    /// The daemon; by default the one that was built with this example
    #[arg(long)]
    holdover: Option<PathBuf>,
    /// Settings of the daemon, KEY=VALUE; may be given several times
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Whose {
    /// Others than the autopilot
    Stranger,
    /// The autopilot's own
    Peer,
}

#[derive(Clone, Copy, ValueEnum)]
enum Bytes {
    /// Starts of MAVLink 1 frames, nothing else
    Fe,
    /// Starts of MAVLink 2 frames, nothing else
    Fd,
    /// Heads of long MAVLink 2 frames of a known message, one after the other, whose checksums are wrong
    Heads,
    /// Anything, of a fixed seed
    Random,
    /// Whole frames of the flight, of another system
    Frames,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Log {
    /// It is read and shown
    Shown,
    /// Nobody reads the pipe, and it is full from the beginning
    Blocked,
    /// The disk is full
    Full,
}

/// IMU samples and TIMESYNC questions by their numbers, with when they were sent, µs.
#[derive(Default)]
struct Sent {
    imu: HashMap<u64, i64>,
    questions: HashMap<i64, i64>,
}

/// What came back in the time that counts.
#[derive(Default)]
struct Back {
    /// From the IMU sample to its ODOMETRY, ms.
    odometry_ms: Vec<f64>,
    /// From the question to its answer, ms.
    answers_ms: Vec<f64>,
    unknown: u64,
}

#[derive(Clone, Default)]
struct Shared {
    sent: Arc<Mutex<Sent>>,
    back: Arc<Mutex<Back>>,
    counts: Arc<AtomicBool>,
    floods: Arc<AtomicBool>,
    flooded: Arc<AtomicU64>,
    over: Arc<AtomicBool>,
}

/// The daemon, killed whatever happens, and the end of its log that nobody reads.
struct Daemon {
    process: Child,
    _unread: Option<PipeReader>,
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Played quickly up to here, s; GNSS is withheld from [`DENIED_S`] on.
const WARM_UP_S: f64 = 95.0;
const WARM_UP_SPEED: f64 = 10.0;
const DENIED_S: f64 = 80.0;
/// What a pipe of Linux holds.
const PIPE_BYTES: usize = 65_536;
/// Time between two questions for the time, µs.
const ASK_EVERY_US: i64 = 5000;
/// What comes later than this after the end is lost.
const GRACE: Duration = Duration::from_millis(500);

fn main() -> Result<()> {
    let args = Args::parse();
    let to = free_port()?;
    let mut daemon = start(&args, to)?;
    sleep(Duration::from_millis(500));
    let socket = UdpSocket::bind("127.0.0.1:0")?;
    socket.connect(to)?;
    let clock = CompanionClock::new();
    let shared = Shared::default();
    listen(socket.try_clone()?, clock.clone(), shared.clone());
    flood(&args, to, &socket, &clock, &shared)?;
    let measured = play(&args, &daemon, &socket, &clock, &shared)?;
    shared.floods.store(false, Ordering::Release);
    sleep(GRACE);
    print(&args, &measured, &shared);
    let took = stop(&mut daemon, &clock)?;
    println!("SIGTERM:   ended after {:.0} ms", 1e3 * took);
    shared.over.store(true, Ordering::Release);
    Ok(())
}

fn free_port() -> Result<SocketAddr> {
    Ok(UdpSocket::bind("127.0.0.1:0")?.local_addr()?)
}

fn start(args: &Args, to: SocketAddr) -> Result<Daemon> {
    let exe = match &args.holdover {
        Some(path) => path.clone(),
        // target/release/examples/hostile_link
        None => std::env::current_exe()?
            .parent()
            .and_then(Path::parent)
            .context("where is the build?")?
            .join("holdover"),
    };
    let mut unread = None;
    let stderr = match args.stderr {
        Log::Full => fs::OpenOptions::new().write(true).open("/dev/full")?.into(),
        Log::Shown => Stdio::piped(),
        Log::Blocked => {
            let (reader, mut writer) = std::io::pipe()?;
            writer.write_all(&[b'\n'; PIPE_BYTES])?;
            unread = Some(reader);
            writer.into()
        }
    };
    let mut command = Command::new(&exe);
    command.args([
        "run",
        "--endpoint",
        &format!("udpin:{to}"),
        "--deny-gnss",
        &format!("{DENIED_S}..100000"),
    ]);
    // Lost after a while, the daemon would send nothing: this is about what it sends.
    command.args(["--set", "holdover.max_sigma_m=100000", "--set", "holdover.max_coast_s=3600"]);
    command.args(["--set", "state.dir=\"\"", "--set", "outbound.coasting=always"]);
    for set in &args.set {
        command.args(["--set", set]);
    }
    let child = command.stderr(stderr).spawn();
    let process = child.with_context(|| format!("{} (was it built?)", exe.display()))?;
    let mut daemon = Daemon { process, _unread: unread };
    if args.stderr == Log::Shown {
        let lines = BufReader::new(daemon.process.stderr.take().context("no log")?).lines();
        std::thread::spawn(move || lines.map_while(Result::ok).for_each(|line| eprintln!("{line}")));
    }
    Ok(daemon)
}

/// Keeps what comes back.
fn listen(socket: UdpSocket, clock: CompanionClock, shared: Shared) {
    std::thread::spawn(move || {
        let mut buffer = [0; 2000];
        while !shared.over.load(Ordering::Acquire) {
            // The system says so where nobody listens yet.
            let Ok(n) = socket.recv(&mut buffer) else { continue };
            let now = clock.now().micros();
            let mut rest = &buffer[..n];
            while let Scan::Frame(frame) = scan(rest, true) {
                if let Ok(message) = frame.parse()
                    && shared.counts.load(Ordering::Acquire)
                {
                    came_back(&message, now, &shared);
                }
                rest = &rest[frame.len()..];
            }
        }
    });
}

fn came_back(message: &MavMessage, now: i64, shared: &Shared) {
    let (Ok(mut sent), Ok(mut back)) = (shared.sent.lock(), shared.back.lock()) else { return };
    match message {
        MavMessage::ODOMETRY(m) => match sent.imu.get(&m.time_usec) {
            Some(then) => back.odometry_ms.push((now - then) as f64 * 1e-3),
            None => back.unknown += 1,
        },
        MavMessage::TIMESYNC(m) => {
            if let Some(then) = sent.questions.remove(&m.ts1) {
                back.answers_ms.push((now - then) as f64 * 1e-3);
            }
        }
        _ => {}
    }
}

/// Starts the hostile senders; they wait for the measurement to begin.
fn flood(
    args: &Args,
    to: SocketAddr,
    peer: &UdpSocket,
    clock: &CompanionClock,
    shared: &Shared,
) -> Result<()> {
    if args.flood_mbps <= 0.0 {
        return Ok(());
    }
    let datagram = hostile(args)?;
    let senders = if args.from == Whose::Peer { 1 } else { args.strangers.max(1) };
    let every_us = (datagram.len() * senders) as f64 / args.flood_mbps;
    for _ in 0..senders {
        let socket = match args.from {
            Whose::Peer => peer.try_clone()?,
            Whose::Stranger => {
                let socket = UdpSocket::bind("127.0.0.1:0")?;
                socket.connect(to)?;
                socket
            }
        };
        let (clock, shared, datagram) = (clock.clone(), shared.clone(), datagram.clone());
        std::thread::spawn(move || {
            let mut due = None;
            while !shared.over.load(Ordering::Acquire) {
                if !shared.floods.load(Ordering::Acquire) {
                    sleep(Duration::from_millis(5));
                    continue;
                }
                let now = clock.now().micros() as f64;
                let next = due.get_or_insert(now);
                if now < *next {
                    sleep(Duration::from_micros((*next - now) as u64));
                    continue;
                }
                // A sender that did not come to its turn does not make up for more than 20 ms.
                *next = next.max(now - 20_000.0) + every_us;
                if socket.send(&datagram).is_ok() {
                    shared.flooded.fetch_add(datagram.len() as u64, Ordering::Relaxed);
                }
            }
        });
    }
    Ok(())
}

fn hostile(args: &Args) -> Result<Vec<u8>> {
    let n = args.datagram.clamp(1, 65_507);
    Ok(match args.bytes {
        Bytes::Fe => vec![0xFE; n],
        Bytes::Fd => vec![0xFD; n],
        // ATTITUDE, claiming to be as long as it can be; every head is one more checksum for a reader that is not careful.
        Bytes::Heads => [0xFD, 255, 0, 0, 0, 1, 1, 30, 0, 0].into_iter().cycle().take(n).collect(),
        Bytes::Random => {
            let mut state = 0x2545_F491_4F6C_DD1D_u64;
            let mut next = || {
                state ^= state << 13;
                state ^= state >> 7;
                state ^= state << 17;
                (state >> 24) as u8
            };
            (0..n).map(|_| next()).collect()
        }
        Bytes::Frames => {
            let mut reader = TlogReader::new(fs::File::open(&args.log)?);
            let mut writer = FrameWriter::new(Address { system: SystemId(77), component: ComponentId(1) });
            let mut bytes = Vec::with_capacity(n);
            while let Some(record) = reader.next_record()? {
                let Some(frame) = record.frame.parse().ok().and_then(|m| writer.write(&m)) else { continue };
                if bytes.len() + frame.len() > n {
                    break;
                }
                bytes.extend_from_slice(&frame);
            }
            bytes
        }
    })
}

/// The time that counts, by the daemon's own figures.
struct Measured {
    elapsed_s: f64,
    frames: u64,
    imu: u64,
    asked: u64,
    cpu_s: f64,
    resident_mb: [f64; 2],
}

/// Plays the flight; what comes after the start counts.
fn play(
    args: &Args,
    daemon: &Daemon,
    socket: &UdpSocket,
    clock: &CompanionClock,
    shared: &Shared,
) -> Result<Measured> {
    let pid = daemon.process.id();
    let mut reader = TlogReader::new(fs::File::open(&args.log).context(args.log.display().to_string())?);
    let begun = clock.now().micros();
    let warm_up_us = (WARM_UP_S / WARM_UP_SPEED * 1e6) as i64;
    let (mut first_us, mut counting, mut paused) = (None, None, args.pause_s <= 0.0);
    let (mut frames, mut imu, mut asked, mut next_ask) = (0, 0, 0, 0);
    while let Some(record) = reader.next_record()? {
        let flight_us = (record.written_us - *first_us.get_or_insert(record.written_us)) as f64;
        let due_us = begun
            + if flight_us < WARM_UP_S * 1e6 {
                (flight_us / WARM_UP_SPEED) as i64
            } else {
                warm_up_us + ((flight_us - WARM_UP_S * 1e6) / args.speed) as i64
            };
        wait_until(due_us, clock);
        let now = clock.now().micros();
        if counting.is_none() && flight_us >= WARM_UP_S * 1e6 {
            counting = Some((now, cpu_s(pid)?, resident_mb(pid)?));
            (frames, imu, next_ask) = (0, 0, now);
            shared.counts.store(true, Ordering::Release);
            shared.floods.store(true, Ordering::Release);
        }
        if let Some((then, cpu, resident)) = counting {
            let elapsed_s = (now - then) as f64 * 1e-6;
            if elapsed_s >= args.seconds {
                let cpu_s = cpu_s(pid)? - cpu;
                let resident_mb = [resident, resident_mb(pid)?];
                return Ok(Measured { elapsed_s, frames, imu, asked, cpu_s, resident_mb });
            }
            if !paused && elapsed_s > args.seconds / 2.0 {
                paused = true;
                pause(pid, args.pause_s)?;
            }
            // Those that are behind are asked all the same, a few at a time.
            while next_ask <= now && asked < u64::try_from(now - then)? {
                next_ask += ASK_EVERY_US;
                asked += 1;
                ask(asked, socket, clock, shared)?;
            }
        }
        frames += 1;
        if let Some(stamp) = imu_stamp(record.frame.message_id(), record.frame.payload()) {
            imu += 1;
            shared
                .sent
                .lock()
                .map_err(|_| anyhow::anyhow!("poisoned"))?
                .imu
                .insert(stamp, clock.now().micros());
        }
        // Refused while nobody listens yet.
        let _ = socket.send(record.frame.bytes());
    }
    bail!("the flight is too short")
}

fn wait_until(due_us: i64, clock: &CompanionClock) {
    let ahead = (Stamp::from_micros(due_us) - clock.now()).seconds();
    if ahead > 0.0 {
        sleep(Duration::from_secs_f64(ahead));
    }
}

/// `time_usec` of a HIGHRES_IMU.
fn imu_stamp(id: u32, payload: &[u8]) -> Option<u64> {
    let stamp = payload.get(..8)?.try_into().ok()?;
    (id == 105).then_some(u64::from_le_bytes(stamp))
}

fn ask(number: u64, socket: &UdpSocket, clock: &CompanionClock, shared: &Shared) -> Result<()> {
    let ts1 = i64::try_from(number)? + 4_000_000_000;
    let from = Address { system: SystemId(1), component: ComponentId(1) };
    let question = TIMESYNC_DATA { tc1: 0, ts1, target_system: 0, target_component: 0 };
    let frame = FrameWriter::new(from).write(&MavMessage::TIMESYNC(question)).context("too long")?;
    shared.sent.lock().map_err(|_| anyhow::anyhow!("poisoned"))?.questions.insert(ts1, clock.now().micros());
    let _ = socket.send(&frame);
    Ok(())
}

/// Stops the daemon's process for a while, on a thread of its own: the flight goes on.
fn pause(pid: u32, seconds: f64) -> Result<()> {
    signal(pid, "-STOP")?;
    std::thread::spawn(move || {
        sleep(Duration::from_secs_f64(seconds));
        signal(pid, "-CONT")
    });
    Ok(())
}

fn signal(pid: u32, name: &str) -> Result<()> {
    let status = Command::new("kill").args([name, &pid.to_string()]).status()?;
    if status.success() { Ok(()) } else { bail!("kill {name} {pid}: {status}") }
}

/// Asks the daemon to end; how long that took, s.
fn stop(daemon: &mut Daemon, clock: &CompanionClock) -> Result<f64> {
    let begun = clock.now();
    signal(daemon.process.id(), "-TERM")?;
    while daemon.process.try_wait()?.is_none() {
        if (clock.now() - begun).seconds() > 10.0 {
            bail!("SIGTERM is ignored");
        }
        sleep(Duration::from_millis(1));
    }
    Ok((clock.now() - begun).seconds())
}

fn print(args: &Args, m: &Measured, shared: &Shared) {
    let Ok(mut back) = shared.back.lock() else { return };
    let s = m.elapsed_s;
    let flooded = shared.flooded.load(Ordering::Relaxed) as f64;
    println!("measured for {s:.1} s, flight played {} times as fast", args.speed);
    println!("hostile:   {:.1} MB/s", flooded / s * 1e-6);
    println!("in:        {:.0} frames/s, {:.0} of them IMU", m.frames as f64 / s, m.imu as f64 / s);
    let odometry = back.odometry_ms.len();
    println!("ODOMETRY:  {:.1} a second of the flight", odometry as f64 / s / args.speed);
    let stale = back.odometry_ms.iter().filter(|&&ms| ms > 200.0).count();
    println!("latency:   {} ms; {stale} older than 200 ms", percentiles(&mut back.odometry_ms));
    let lost = 100.0 * (1.0 - back.answers_ms.len() as f64 / (m.asked as f64).max(1.0));
    println!("TIMESYNC:  {} asked, {lost:.2} % lost, {} ms", m.asked, percentiles(&mut back.answers_ms));
    println!("CPU:       {:.2} % of a core", 100.0 * m.cpu_s / s);
    println!(
        "memory:    {:.1} MB resident, {:+.1} MB since",
        m.resident_mb[1],
        m.resident_mb[1] - m.resident_mb[0]
    );
    if back.unknown > 0 {
        println!("           {} ODOMETRY of no IMU sample", back.unknown);
    }
}

fn percentiles(values: &mut [f64]) -> String {
    values.sort_by(f64::total_cmp);
    let at =
        |p: f64| values.get(((values.len() as f64 - 1.0) * p).round() as usize).copied().unwrap_or(f64::NAN);
    format!("p50 {:.2}, p99 {:.2}, most {:.2}", at(0.5), at(0.99), at(1.0))
}
