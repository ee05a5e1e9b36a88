//! `holdover run`: the daemon.

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use clap::Args;
use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;
use tracing_subscriber::EnvFilter;

use crate::config::{LOG_VARIABLE, Origin, Settings};
use crate::daemon::{Daemon, endpoints, link_config};
use crate::wire::companion_clock::CompanionClock;
use crate::wire::endpoint::Endpoint;
use crate::wire::link::{LinkConfig, Links};
use crate::wire::signing::Signing;

use super::replay::parse_interval;
use super::{ConfigArgs, Failure, check, warn};

/// How long the links may take to close.
const CLOSING: Duration = Duration::from_secs(1);

/// Arguments of `run`.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// Where the autopilot is, instead of link.endpoints: udpin:HOST:PORT, udpout:…, tcpin:…, tcpout:…, serial:DEVICE:BAUD;
    /// may be given several times
    #[arg(long, short, value_name = "ENDPOINT")]
    pub endpoint: Vec<Endpoint>,
    /// A drill: withhold GNSS from the navigator from A to B, seconds since the first sample, as in 60..120; may be given
    /// several times. The autopilot keeps its own GNSS, so holdover can be watched, in SITL or in the air, without touching it
    #[arg(long, value_name = "A..B", value_parser = parse_interval)]
    pub deny_gnss: Vec<(f64, f64)>,
    /// Check the configuration, show what is in force, and open nothing
    #[arg(long)]
    pub dry_run: bool,
    /// Settings
    #[command(flatten)]
    pub settings: ConfigArgs,
}

/// Runs the command until SIGINT or SIGTERM.
///
/// # Errors
/// [`Failure::Config`], [`Failure::Usage`], and [`Failure::Link`] when a link cannot be opened.
pub fn run(args: &RunArgs) -> Result<(), Failure> {
    let mut loaded = args.settings.read()?;
    warn(&loaded);
    if !args.endpoint.is_empty() {
        loaded.set_endpoints(&args.endpoint, Origin::Argument("--endpoint".into()));
    }
    if args.dry_run {
        return check::show(&loaded, false);
    }
    let settings = loaded.settings;
    if settings.endpoints.is_empty() {
        return Err(Failure::Usage("link.endpoints is empty: there is nothing to listen to".into()));
    }
    let sink = start_log(&settings.log_level)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let served = runtime.block_on(serve(&settings, &args.deny_gnss));
    let lost = sink.lost.load(Ordering::Relaxed);
    if lost > 0 {
        tracing::warn!("{lost} lines of the log could not be written");
    }
    served
}

/// Writes the log to standard error, and goes on where that cannot be written: a full disk, a closed terminal or a `tee` that died is no
/// reason to stop navigating. Lines that were lost are counted.
#[derive(Clone, Debug, Default)]
struct LogSink {
    lost: Arc<AtomicU64>,
}

impl Write for LogSink {
    fn write(&mut self, line: &[u8]) -> std::io::Result<usize> {
        if std::io::stderr().write_all(line).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

fn start_log(level: &str) -> Result<LogSink, Failure> {
    let directives = std::env::var(LOG_VARIABLE).ok().filter(|v| !v.is_empty());
    let filter = EnvFilter::try_new(directives.as_deref().unwrap_or(level))
        .map_err(|e| Failure::Usage(format!("{LOG_VARIABLE}: {e}")))?;
    let sink = LogSink::default();
    let writer = sink.clone();
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(move || writer.clone())
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        .try_init()
        .map_err(|e| Failure::Other(e.to_string()))?;
    Ok(sink)
}

/// Where the state is kept, and says so. Without such a place it navigates all the same.
fn state_folder(settings: &Settings) -> Option<PathBuf> {
    match settings.state.make(|name| std::env::var(name).ok()) {
        Ok(Some(folder)) => {
            tracing::info!("the state is kept in {}", folder.display());
            Some(folder)
        }
        Ok(None) => None,
        Err(why) => {
            tracing::warn!("no state is kept, a restart begins anew: {why}");
            None
        }
    }
}

/// Signing as it is configured, and says so. Without the key, or a place for its stamps, nothing is begun.
fn signing(settings: &Settings, states: Option<&Path>) -> Result<Signing, Failure> {
    let signing = Signing::open(&settings.signing, states).map_err(|e| Failure::Usage(e.to_string()))?;
    if let Some(policy) = signing.gate.policy() {
        tracing::info!("{policy}");
    }
    if let Some(told) = &signing.told {
        tracing::warn!("the stamps of signatures begin anew: {told}");
    }
    Ok(signing)
}

async fn serve(settings: &Settings, deny_gnss: &[(f64, f64)]) -> Result<(), Failure> {
    let (stop, close) = (CancellationToken::new(), CancellationToken::new());
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    let clock = CompanionClock::new();
    let folder = state_folder(settings);
    let mut signing = signing(settings, folder.as_deref())?;
    let config = LinkConfig { signing: Arc::clone(&signing.gate), ..link_config(settings) };
    let links = Links::open(&endpoints(settings), config, clock.clone(), close.clone())
        .await
        .map_err(|e| Failure::Link(e.to_string()))?;
    let handles = links.handles.clone();
    tracing::info!("holdover {} is running", env!("CARGO_PKG_VERSION"));
    for stats in handles.stats() {
        match stats.local {
            Some(local) => tracing::info!("{}: {} listens at {local}", stats.link, stats.endpoint),
            None => tracing::info!("{}: {}", stats.link, stats.endpoint),
        }
    }
    for (a, b) in deny_gnss {
        tracing::warn!("a drill: GNSS is withheld from {a} to {b} s after the first sample");
    }
    let daemon = Daemon::new(settings, deny_gnss, links, clock).keeping_state_in(folder).run(stop.clone());
    tokio::pin!(daemon);
    let summary = tokio::select! {
        summary = &mut daemon => summary,
        name = async {
            tokio::select! {
                _ = interrupt.recv() => "SIGINT",
                _ = terminate.recv() => "SIGTERM",
            }
        } => {
            tracing::info!("{name}: ends");
            stop.cancel();
            daemon.await
        }
    };
    close.cancel();
    if tokio::time::timeout(CLOSING, handles.closed()).await.is_err() {
        tracing::warn!("a link does not close");
    }
    signing.close();
    tracing::info!("in the end: {summary}");
    Ok(())
}
