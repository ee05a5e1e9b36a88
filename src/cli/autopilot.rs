//! `holdover simulate --autopilot`: an autopilot's double on a real link, in real time or faster, for a companion to try itself on.

use std::time::Duration;

use clap::Args;
use nalgebra::Vector3;
use tokio::time::{MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;

use crate::double::manners::{Manner, Manners};
use crate::double::{AutopilotDouble, DoublePort, DoubleReport, DoubleSettings};
use crate::sim::autopilot::link::LinkFaults;
use crate::sim::autopilot::script::FlightScript;
use crate::sim::models::OutageKind;
use crate::time::{Companion, Stamp};
use crate::wire::companion_clock::CompanionClock;
use crate::wire::endpoint::Endpoint;
use crate::wire::link::{LinkConfig, LinkId, Links};
use crate::wire::session::identity::AutopilotKind;

use super::Failure;
use super::flight::parse_interval;
use super::simulate::{Dialect, SimulateArgs};

/// Arguments of `simulate --autopilot`.
#[derive(Debug, Args)]
pub struct AutopilotArgs {
    /// Write no log, but be this autopilot in a quadrotor that flies by its own estimate: arm, take off, fly a square, lose GNSS, hover, fly
    /// a square, have GNSS back, land
    #[arg(long, value_enum, value_name = "KIND", conflicts_with_all = ["scenario", "out", "range", "airspeed"], requires = "endpoint")]
    pub autopilot: Option<Dialect>,
    /// Where the companion is: udpout:HOST:PORT, tcpin:…, tcpout:…, serial:DEVICE:BAUD
    #[arg(long, value_name = "ENDPOINT", requires = "autopilot")]
    pub endpoint: Option<Endpoint>,
    /// A companion camera tells of flow and distance instead of the autopilot, as component 100, on the same link or on one of its own
    #[arg(long, value_name = "ENDPOINT", num_args = 0..=1, requires = "autopilot")]
    pub camera: Option<Option<Endpoint>>,
    /// How much faster than real time; 0.99 is a clock that is 1 % slow
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, requires = "autopilot")]
    pub speed: f64,
    /// Hover for so long without GNSS, s
    #[arg(long, value_name = "S", default_value_t = 60.0, requires = "autopilot")]
    pub hold: f64,
    /// The pilot selects source set 2 three seconds after the loss, and set 1 when GNSS is back (ArduPilot)
    #[arg(long, requires = "autopilot")]
    pub pilot_switches: bool,
    /// A parameter, as in VISO_DELAY_MS=20; may be given several times
    #[arg(long, value_name = "NAME=VALUE", requires = "autopilot")]
    pub param: Vec<String>,
    /// With this manner of real autopilots, too (see the documentation); may be given several times
    #[arg(long, value_name = "MANNER", requires = "autopilot")]
    pub with: Vec<Manner>,
    /// Without this one; may be given several times
    #[arg(long, value_name = "MANNER", requires = "autopilot")]
    pub without: Vec<Manner>,
    /// The link loses this part of the messages, both ways
    #[arg(long, value_name = "PART", default_value_t = 0.0, requires = "autopilot")]
    pub link_loss: f64,
    /// The link delays messages by this, each way, ms
    #[arg(long, value_name = "MS", default_value_t = 0.0, requires = "autopilot")]
    pub link_delay: f64,
    /// The link is silent from A to B, s
    #[arg(long, value_name = "A..B", value_parser = parse_interval, requires = "autopilot")]
    pub link_silent: Option<(f64, f64)>,
    /// Print one JSON object at the end and nothing else
    #[arg(long, requires = "autopilot")]
    pub json: bool,
}

/// Fastest that is sensible: beyond it the companion gets seconds at once.
const FASTEST: f64 = 100.0;
/// The vehicle stands so long before it is armed, s: a companion aligns meanwhile.
const GROUND_S: f64 = 30.0;
/// Frames that may wait for the link.
const QUEUE_FRAMES: usize = 16_384;
/// The simulation is looked at this often.
const TICK: Duration = Duration::from_millis(1);
/// A simulation that is further behind its time than this lets go of it, as SITL does, s.
const MOST_BEHIND_S: f64 = 0.5;
/// The companion hears the end of the flight for so long, s.
const AFTER_S: f64 = 2.0;

/// Runs the command until the flight is over, or SIGINT.
///
/// # Errors
/// [`Failure::Usage`], and [`Failure::Link`] when a link cannot be opened.
pub(super) fn run(args: &SimulateArgs, dialect: Dialect) -> Result<(), Failure> {
    let settings = settings(args, dialect)?;
    let double = &args.double;
    if !(double.speed > 0.0 && double.speed <= FASTEST) {
        return Err(Failure::Usage(format!("a speed of {}: expected --speed up to {FASTEST}", double.speed)));
    }
    let endpoints: Vec<Endpoint> =
        double.endpoint.iter().chain(double.camera.iter().flatten()).cloned().collect();
    if endpoints.iter().any(|e| matches!(e, Endpoint::UdpIn(_))) {
        return Err(Failure::Usage("the autopilot speaks first: udpout, not udpin".into()));
    }
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let report = runtime.block_on(fly(AutopilotDouble::new(settings), &endpoints, args))?;
    tell(&report, double.json)
}

fn settings(args: &SimulateArgs, dialect: Dialect) -> Result<DoubleSettings, Failure> {
    let double = &args.double;
    let kind = match dialect {
        Dialect::Ardupilot => AutopilotKind::ArduPilot,
        Dialect::Px4 => AutopilotKind::Px4,
    };
    let loss = args.lose_gnss.is_none().then_some(OutageKind::NoFix);
    let script = FlightScript::outage(GROUND_S, double.hold, loss, double.pilot_switches);
    let mut settings = DoubleSettings::documented(kind, script);
    for text in &double.param {
        let wrong = || Failure::Usage(format!("\"{text}\" is no parameter: expected NAME=VALUE"));
        let (name, value) = text.split_once('=').ok_or_else(wrong)?;
        let value: f64 = value.trim().parse().map_err(|_| wrong())?;
        settings.parameters.set(name.trim(), value).map_err(|e| Failure::Usage(e.to_string()))?;
    }
    let manners = double.with.iter().fold(Manners::usual(kind), |all, m| all.with(*m));
    settings.manners = double.without.iter().fold(manners, |all, m| all.without(*m));
    if !(0.0..1.0).contains(&double.link_loss) || !(0.0..=60_000.0).contains(&double.link_delay) {
        return Err(Failure::Usage("--link-loss is below 1, --link-delay up to 60000".into()));
    }
    settings.faults = LinkFaults {
        loss: double.link_loss,
        delay_s: double.link_delay * 1e-3,
        silent_s: double.link_silent,
    };
    settings.imu = args.imu.model();
    settings.wind_ned = args.wind.map_or_else(Vector3::zeros, |(n, e)| Vector3::new(n, e, 0.0));
    settings.sees = !args.no_flow;
    settings.camera =
        double.camera.as_ref().map(|own| if own.is_some() { DoublePort::Camera } else { DoublePort::Main });
    settings.seed = args.seed;
    Ok(settings)
}

async fn fly(
    mut double: AutopilotDouble,
    endpoints: &[Endpoint],
    args: &SimulateArgs,
) -> Result<DoubleReport, Failure> {
    let (close, clock) = (CancellationToken::new(), CompanionClock::new());
    let config = LinkConfig {
        inbound_capacity: QUEUE_FRAMES,
        outbound_capacity: QUEUE_FRAMES,
        max_queue_age: Duration::from_secs(3),
        ..LinkConfig::default()
    };
    let mut links = Links::open(endpoints, config, clock.clone(), close.clone())
        .await
        .map_err(|e| Failure::Link(e.to_string()))?;
    let mut tick = interval(TICK);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut pace = Pace { began: clock.now(), speed: args.double.speed };
    let mut teller = Teller { quiet: args.double.json, ..Teller::default() };
    let mut out = Vec::new();
    let ends_s = args.duration.unwrap_or(f64::INFINITY);
    let mut done_s = None;
    loop {
        tokio::select! {
            _ = tick.tick() => {}
            _ = tokio::signal::ctrl_c() => break,
        }
        while let Ok(frame) = links.inbound.try_recv() {
            double.hear(frame.bytes);
        }
        let due_s = pace.due_s(clock.now(), double.vehicle().now_s());
        while double.vehicle().now_s() < due_s {
            lose_gnss(&mut double, args.lose_gnss);
            double.step(&mut out);
            for (port, bytes) in out.drain(..) {
                links.handles.send(LinkId(port as usize), bytes);
            }
        }
        teller.tell(&mut double);
        let now_s = double.vehicle().now_s();
        if double.vehicle().is_done() {
            done_s.get_or_insert(now_s);
        }
        if now_s >= ends_s || done_s.is_some_and(|t| now_s - t > AFTER_S) {
            break;
        }
    }
    close.cancel();
    Ok(double.report())
}

/// GNSS that is lost at a time instead of by the script.
fn lose_gnss(double: &mut AutopilotDouble, lost_s: Option<(f64, f64)>) {
    let Some((from, to)) = lost_s else { return };
    let lost = (from..to).contains(&double.vehicle().now_s());
    if lost != double.vehicle().gnss_is_lost() {
        double.vehicle_mut().lose_gnss(lost.then_some(OutageKind::NoFix));
    }
}

/// How the simulation's time goes with the clock's.
#[derive(Clone, Copy, Debug)]
struct Pace {
    began: Stamp<Companion>,
    speed: f64,
}

impl Pace {
    /// What time it should be in the simulation, where it is `now_s`.
    fn due_s(&mut self, now: Stamp<Companion>, now_s: f64) -> f64 {
        let due_s = now.seconds_since(self.began) * self.speed;
        let most_s = MOST_BEHIND_S * self.speed.max(1.0);
        if due_s - now_s > most_s {
            self.began = self.began + crate::time::Span::from_seconds((due_s - now_s - most_s) / self.speed);
            return now_s + most_s;
        }
        due_s
    }
}

/// Tells what happens as it does.
#[derive(Debug, Default)]
struct Teller {
    quiet: bool,
    lost: bool,
    back: bool,
}

impl Teller {
    fn tell(&mut self, double: &mut AutopilotDouble) {
        let news = double.take_news();
        if self.quiet {
            return;
        }
        for (t_s, news) in news {
            outln!("{t_s:8.1} s  {news}");
        }
        let report = double.report();
        if let (Some(t_s), false) = (report.lost_s, self.lost) {
            self.lost = true;
            outln!("{t_s:8.1} s  GNSS lost");
        }
        if let (Some(t_s), false) = (report.back_s, self.back) {
            self.back = true;
            outln!("{t_s:8.1} s  GNSS back, {:.1} m astray", report.drift_end_m);
        }
    }
}

fn tell(report: &DoubleReport, json: bool) -> Result<(), Failure> {
    if json {
        let text = serde_json::to_string(report).map_err(|e| Failure::Other(e.to_string()))?;
        outln!("{text}");
        return Ok(());
    }
    outln!("{}", if report.failsafe_s.is_some() { "ended by its own failsafe" } else { "no failsafe acted" });
    if report.lost_s.is_some() {
        outln!(
            "without GNSS: {:.2} m astray in the end, {:.2} m at most",
            report.drift_end_m,
            report.drift_max_m
        );
    }
    outln!(
        "external navigation: {} messages, {} fused, {} gated",
        report.external,
        report.fused,
        report.gated
    );
    Ok(())
}
