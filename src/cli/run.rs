//! `holdover run`: the daemon. This thread has the links, the timers of the links, and the signals; navigation has one of its own, and so has
//! the log. Neither waits for another.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use sd_notify::NotifyState;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::{Notify, mpsc, oneshot};
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

use crate::config::{LOG_VARIABLE, Loaded, Origin, Settings};
use crate::daemon::lines::{self, LinesError, LogHandle};
use crate::daemon::{AliveSign, Daemon, Summary, endpoints, link_config};
use crate::record::LinkRecorder;
use crate::status::{StatusFeed, StatusServer};
use crate::time::Span;
use crate::wire::companion_clock::CompanionClock;
use crate::wire::endpoint::Endpoint;
use crate::wire::link::{LinkConfig, Links};
use crate::wire::signing::Signing;

use super::flight::parse_interval;
use super::reload::Reload;
use super::{ConfigArgs, Failure, check, service, warn};

/// How long the navigation may take to say good-bye …
const NAVIGATION_ENDS: Duration = Duration::from_millis(130);
/// … the links to close …
const CLOSING: Duration = Duration::from_millis(30);
/// … and the last lines of the log to be written. It sums up to what a process is given that is told to end.
const LAST_LINES: Span = Span::from_millis(100);

/// Arguments of `run`.
#[derive(Clone, Debug, Args)]
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

/// Runs the command until SIGINT or SIGTERM. `told` is what its log is to hold, where the command line says so: before the environment, and
/// before the configuration.
///
/// # Errors
/// [`Failure::Config`], [`Failure::Usage`], and [`Failure::Link`] when a link cannot be opened.
pub fn run(args: &RunArgs, told: Option<&str>) -> Result<(), Failure> {
    let loaded = read(args)?;
    warn(&loaded);
    if args.dry_run {
        return check::show(&loaded, false);
    }
    if loaded.settings.endpoints.is_empty() {
        return Err(Failure::Usage("link.endpoints is empty: there is nothing to listen to".into()));
    }
    let clock = CompanionClock::new();
    let directives = std::env::var(LOG_VARIABLE).ok().filter(|v| !v.is_empty());
    let directives = told.map(str::to_owned).or(directives);
    let log = lines::start(&loaded.settings.log, directives.as_deref(), &clock).map_err(|e| match e {
        LinesError::Directives(e) => Failure::Usage(format!("{LOG_VARIABLE}: {e}")),
        e => Failure::Other(e.to_string()),
    })?;
    let reload = Reload::new(&loaded, directives.is_some());
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let served = runtime.block_on(serve(args, &loaded, clock, &log, reload));
    // A name that is still being resolved is not waited for.
    runtime.shutdown_background();
    log.drain(LAST_LINES);
    served
}

/// The settings, with the endpoints of the command line.
fn read(args: &RunArgs) -> Result<Loaded, Failure> {
    let mut loaded = args.settings.read()?;
    if !args.endpoint.is_empty() {
        loaded.set_endpoints(&args.endpoint, Origin::Argument("--endpoint".into()));
    }
    Ok(loaded)
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

/// Serves the page where it is configured, and says where. Where it cannot be, nothing is begun.
fn status(settings: &Settings, clock: &CompanionClock) -> Result<Option<StatusFeed>, Failure> {
    let opened =
        StatusServer::open(&settings.status, clock.now()).map_err(|e| Failure::Link(e.to_string()))?;
    let Some((server, feed)) = opened else { return Ok(None) };
    let local = server.local();
    tracing::info!("the page is at http://{local}/");
    if !local.ip().is_loopback() {
        tracing::warn!("whoever reaches {local} can read the page: where the vehicle is, before all");
    }
    server.start()?;
    Ok(Some(feed))
}

/// Records where it is configured. What cannot be recorded does not keep it from flying.
fn recorder(loaded: &Loaded, clock: &CompanionClock) -> Option<LinkRecorder> {
    let settings = loaded.settings.record.clone()?;
    match LinkRecorder::start(settings, loaded.differing_toml(), clock.clone()) {
        Ok(recorder) => Some(recorder),
        Err(e) => {
            tracing::warn!("nothing is recorded: {e}");
            None
        }
    }
}

/// The signals that mean something, and those that must not kill.
struct Signals {
    interrupt: Signal,
    terminate: Signal,
    hang_up: Signal,
    user: [Signal; 2],
}

/// What is to be done.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum SignalOrder {
    /// End, for the signal of this name.
    End(&'static str),
    /// Read the configuration again.
    Reload,
    /// Tell how it fares.
    Summary,
    /// Nothing: SIGUSR2 has no meaning.
    Nothing,
}

impl Signals {
    fn new() -> std::io::Result<Self> {
        let (one, two) = (SignalKind::user_defined1(), SignalKind::user_defined2());
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
            hang_up: signal(SignalKind::hangup())?,
            user: [signal(one)?, signal(two)?],
        })
    }

    async fn next(&mut self) -> SignalOrder {
        let [one, two] = &mut self.user;
        tokio::select! {
            biased;
            _ = self.terminate.recv() => SignalOrder::End("SIGTERM"),
            _ = self.interrupt.recv() => SignalOrder::End("SIGINT"),
            _ = self.hang_up.recv() => SignalOrder::Reload,
            _ = one.recv() => SignalOrder::Summary,
            _ = two.recv() => SignalOrder::Nothing,
        }
    }

    /// The order to end; others are not obeyed yet.
    async fn end(&mut self) -> &'static str {
        loop {
            if let SignalOrder::End(name) = self.next().await {
                return name;
            }
        }
    }
}

async fn serve(
    args: &RunArgs,
    loaded: &Loaded,
    clock: CompanionClock,
    log: &LogHandle,
    reload: Reload,
) -> Result<(), Failure> {
    let settings = &loaded.settings;
    let mut signals = Signals::new()?;
    let close = CancellationToken::new();
    let folder = state_folder(settings);
    let mut signing = signing(settings, folder.as_deref())?;
    let config = LinkConfig { signing: Arc::clone(&signing.gate), ..link_config(settings) };
    let endpoints = endpoints(settings);
    let links = tokio::select! {
        links = Links::open(&endpoints, config, clock.clone(), close.clone()) => {
            links.map_err(|e| Failure::Link(e.to_string()))?
        }
        name = signals.end() => {
            tracing::info!("{name}: ends before its links are open");
            return Ok(());
        }
    };
    let feed = status(settings, &clock)?;
    let handles = links.handles.clone();
    tracing::info!("holdover {} is running", env!("CARGO_PKG_VERSION"));
    for stats in handles.stats() {
        match stats.local {
            Some(local) => tracing::info!("{}: {} listens at {local}", stats.link, stats.endpoint),
            None => tracing::info!("{}: {}", stats.link, stats.endpoint),
        }
    }
    for (a, b) in &args.deny_gnss {
        tracing::warn!("a drill: GNSS is withheld from {a} to {b} s after the first sample");
    }
    let asked = Arc::new(Notify::new());
    let recorder = recorder(loaded, &clock);
    let daemon = Daemon::new(settings, &args.deny_gnss, links, clock)
        .recorded_by(recorder)
        .keeping_state_in(folder)
        .told_in(log.clone(), Arc::clone(&asked))
        .shown_by(feed);
    let navigation = navigate(watched(daemon))?;
    service::tell(NotifyState::Ready);
    let summary = attend(args, signals, navigation, &asked, (log, reload)).await?;
    service::tell(NotifyState::Stopping);
    close.cancel();
    if timeout(CLOSING, handles.closed()).await.is_err() {
        tracing::warn!("a link does not close");
    }
    // The stamps of signatures are written, where the disk is not slow.
    let kept = tokio::task::spawn_blocking(move || signing.close());
    if timeout(CLOSING, kept).await.is_err() {
        tracing::warn!("the stamps of signatures are as they were kept last");
    }
    if let Some(summary) = summary {
        tracing::info!("in the end: {summary}");
    }
    Ok(())
}

/// Under a service manager that asks for it the daemon says that it is alive.
fn watched(daemon: Daemon) -> Daemon {
    match sd_notify::watchdog_enabled() {
        Some(patience) => {
            let patience = Span::from_seconds(patience.as_secs_f64());
            daemon.alive_for(AliveSign::new(patience, || service::tell(NotifyState::Watchdog)))
        }
        None => daemon,
    }
}

/// The navigation on its own thread.
struct Navigation {
    stop: CancellationToken,
    summary: oneshot::Receiver<Summary>,
}

/// Starts the thread. It has nothing to wait for but the queues of the links and its own timers.
fn navigate(daemon: Daemon) -> std::io::Result<Navigation> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build()?;
    let (stop, (ended, summary)) = (CancellationToken::new(), oneshot::channel());
    let stopped = stop.clone();
    std::thread::Builder::new().name("navigation".to_owned()).spawn(move || {
        // Who no longer waits for the summary needs none.
        let _ = ended.send(runtime.block_on(daemon.run(stopped)));
    })?;
    Ok(Navigation { stop, summary })
}

/// Obeys signals until the navigation ends. `None` when it did not end in time.
async fn attend(
    args: &RunArgs,
    mut signals: Signals,
    mut navigation: Navigation,
    asked: &Notify,
    (log, mut reload): (&LogHandle, Reload),
) -> Result<Option<Summary>, Failure> {
    let (settings, (send, mut reread)) = (args.clone(), mpsc::channel(1));
    loop {
        tokio::select! {
            biased;
            order = signals.next() => match order {
                SignalOrder::End(name) => {
                    tracing::info!("{name}: ends");
                    break;
                }
                SignalOrder::Reload => {
                    // A slow disk holds up nothing but this.
                    let (settings, send) = (settings.clone(), send.clone());
                    drop(tokio::task::spawn_blocking(move || drop(send.try_send(read(&settings)))));
                }
                SignalOrder::Summary => asked.notify_one(),
                SignalOrder::Nothing => tracing::warn!("SIGUSR2 means nothing; SIGUSR1 asks for a summary"),
            },
            Some(loaded) = reread.recv() => match loaded {
                Ok(loaded) => reload.take(&loaded, log),
                Err(e) => tracing::warn!("the configuration is not read again, and stays as it was: {e}"),
            },
            summary = &mut navigation.summary => {
                let faulty = |_| Failure::Other("the navigation has ended by a fault of Holdover".into());
                return summary.map(Some).map_err(faulty);
            }
        }
    }
    navigation.stop.cancel();
    match timeout(NAVIGATION_ENDS, &mut navigation.summary).await {
        Ok(Ok(summary)) => Ok(Some(summary)),
        _ => {
            tracing::warn!("the navigation does not end, and is left behind");
            Ok(None)
        }
    }
}
