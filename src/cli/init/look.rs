//! Looks where an autopilot may be, and chooses: what alone speaks MAVLink, or what somebody says.

use std::collections::BTreeSet;
use std::fmt;
use std::net::{IpAddr, Ipv4Addr};
use std::path::Path;
use std::time::Duration;

use futures_util::future::join_all;
use tokio::net::UdpSocket;
use tokio::time::{Instant, timeout_at};
use tokio_util::sync::CancellationToken;

use crate::daemon::CODE_NO_AUTOPILOT;
use crate::init::survey::LinkSurvey;
use crate::wire::companion_clock::CompanionClock;
use crate::wire::counters::Cause;
use crate::wire::endpoint::Endpoint;
use crate::wire::frame::{Scan, SystemId, scan};
use crate::wire::link::{LinkConfig, LinkStats, Links, OpenError};
use crate::wire::session::heartbeat::{SystemStatus, heartbeat};
use crate::wire::session::transmitter::Transmitter;

use super::places::{USUAL_BAUD_RATES, USUAL_UDP_PORTS, serial_devices};
use super::{Failure, InitArgs, InitEndpoint, ask, holders};

/// A UDP port is listened to for so long: heartbeats come once a second.
const UDP_LOOK: Duration = Duration::from_millis(2500);
/// A baud rate is tried for so long; once a frame has come, the line is listened to for this long, too.
const TRIAL: Duration = Duration::from_millis(1500);
/// The longest datagram that is looked into.
const DATAGRAM: usize = 4096;
/// A port may take so long to be closed.
const CLOSING: Duration = Duration::from_secs(1);

/// The links that are listened to.
#[derive(Clone, Debug, Default)]
pub(super) struct Chosen {
    /// To the autopilot.
    pub(super) endpoints: Vec<Endpoint>,
    /// Of sensors of their own.
    pub(super) sensor_endpoints: Vec<Endpoint>,
    /// Why these.
    pub(super) why: String,
    /// What came of the places that were looked at.
    pub(super) looked_at: Vec<LookedAt>,
}

/// What was found at a place.
#[derive(Clone, Debug)]
pub(super) enum LookOutcome {
    /// MAVLink: by whom.
    Speaks(Endpoint, Box<LinkSurvey>),
    /// Nothing of use, in words.
    Nothing(String),
}

/// A place, and what was found there.
#[derive(Clone, Debug)]
pub(super) struct LookedAt {
    pub(super) place: String,
    pub(super) outcome: LookOutcome,
}

impl fmt::Display for LookedAt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.outcome {
            LookOutcome::Speaks(endpoint, survey) => {
                let words: Vec<String> = survey.words().iter().map(ToString::to_string).collect();
                let who = if words.is_empty() { "MAVLink".to_owned() } else { words.join(", ") };
                write!(f, "{endpoint}: {who}")
            }
            LookOutcome::Nothing(why) => write!(f, "{}: {why}", self.place),
        }
    }
}

/// The links that were named, or one that is found.
///
/// # Errors
/// [`Failure::Link`] where nothing speaks, [`Failure::Usage`] where several do and nobody says which.
pub(super) async fn choose(args: &InitArgs, quiet: bool) -> Result<Chosen, Failure> {
    if !args.endpoint.is_empty() {
        return named(&args.endpoint).await;
    }
    let anything = args.port.is_empty() && args.device.is_empty();
    let (ports, devices) = if anything {
        (USUAL_UDP_PORTS.to_vec(), serial_devices())
    } else {
        (args.port.clone(), args.device.clone())
    };
    if !quiet {
        errln!("holdover: looking at {} serial ports and {} UDP ports", devices.len(), ports.len());
    }
    let (udp, serial) = tokio::join!(
        join_all(ports.iter().map(|port| udp_port(*port))),
        join_all(devices.iter().map(|device| serial_device(device)))
    );
    let looked_at: Vec<LookedAt> = serial.into_iter().chain(udp).collect();
    one_of(looked_at, args.json)
}

async fn named(endpoints: &[InitEndpoint]) -> Result<Chosen, Failure> {
    let mut chosen = Chosen { why: "Where it was said to be.".to_owned(), ..Chosen::default() };
    for endpoint in endpoints {
        let device = match endpoint {
            InitEndpoint::Known(endpoint) => {
                chosen.endpoints.push(endpoint.clone());
                continue;
            }
            InitEndpoint::AnyBaud(device) => device,
        };
        let looked = serial_device(device).await;
        let LookOutcome::Speaks(endpoint, _) = &looked.outcome else {
            return Err(Failure::Link(looked.to_string()));
        };
        chosen.endpoints.push(endpoint.clone());
        chosen.why = "Where it was said to be, at the baud rate at which MAVLink is heard.".to_owned();
        chosen.looked_at.push(looked);
    }
    Ok(chosen)
}

/// The only place where an autopilot speaks, or the one that is chosen.
fn one_of(looked_at: Vec<LookedAt>, json: bool) -> Result<Chosen, Failure> {
    let speaks = |autopilot: bool| -> Vec<(Endpoint, String)> {
        let found = looked_at.iter().filter_map(|l| match &l.outcome {
            LookOutcome::Speaks(endpoint, survey) => {
                let fits = if autopilot { !survey.vehicles().is_empty() } else { survey.only_measures() };
                fits.then(|| (endpoint.clone(), l.to_string()))
            }
            LookOutcome::Nothing(_) => None,
        });
        found.collect()
    };
    let vehicles: BTreeSet<u8> = looked_at
        .iter()
        .filter_map(|l| match &l.outcome {
            LookOutcome::Speaks(_, survey) => Some(survey.vehicles()),
            LookOutcome::Nothing(_) => None,
        })
        .flatten()
        .collect();
    let (autopilots, sensors) = (speaks(true), speaks(false));
    let lines = |all: &[String]| all.iter().map(|l| format!("\n  {l}")).collect::<String>();
    let named: Vec<String> = autopilots.iter().map(|(_, text)| text.clone()).collect();
    let place = match named.len() {
        0 => {
            let all: Vec<String> = looked_at.iter().map(ToString::to_string).collect();
            return Err(Failure::Link(format!(
                "no autopilot is heard. Tried:{}\nIs it on, does it send here, and with MAVLink (SERIALn_PROTOCOL = 2, MAV_n_CONFIG)? If it is elsewhere, \
                 say where: --endpoint {}",
                lines(&all),
                "udpin:0.0.0.0:PORT, tcpout:HOST:PORT, serial:DEVICE:auto"
            )));
        }
        1 => 0,
        _ if ask::somebody_is_there(json) => ask::which("Autopilots are heard. Which link?", &named)?,
        _ => {
            let what = if vehicles.len() == 1 {
                "an autopilot is heard at several places: say which is to be used (--endpoint …), best one that no ground station uses"
            } else {
                "autopilots are heard at several places: say which is meant (--endpoint …)"
            };
            return Err(Failure::Usage(format!("{what}{}", lines(&named))));
        }
    };
    let why = match (named.get(place), autopilots.len()) {
        (Some(text), 1) => format!("The only place where an autopilot was heard. {text}."),
        (Some(text), _) => format!("Chosen of several. {text}."),
        (None, _) => String::new(),
    };
    let endpoints = autopilots.into_iter().nth(place).map(|(endpoint, _)| endpoint).into_iter().collect();
    let sensor_endpoints = sensors.into_iter().map(|(endpoint, _)| endpoint).collect();
    Ok(Chosen { endpoints, sensor_endpoints, why, looked_at })
}

/// Listens at a UDP port, and says nothing there.
async fn udp_port(port: u16) -> LookedAt {
    let place = format!("UDP port {port}");
    let outcome = match UdpSocket::bind((Ipv4Addr::UNSPECIFIED, port)).await {
        Ok(socket) => heard_at(&socket, port).await,
        Err(error) if error.kind() == std::io::ErrorKind::AddrInUse => {
            LookOutcome::Nothing(held_by(holders::of_udp_port(port)))
        }
        Err(error) => LookOutcome::Nothing(error.to_string()),
    };
    LookedAt { place, outcome }
}

async fn heard_at(socket: &UdpSocket, port: u16) -> LookOutcome {
    let (clock, until) = (CompanionClock::new(), Instant::now() + UDP_LOOK);
    let (mut survey, mut peers, mut datagrams) = (LinkSurvey::default(), BTreeSet::new(), 0u64);
    let mut buffer = vec![0; DATAGRAM];
    while let Ok(received) = timeout_at(until, socket.recv_from(&mut buffer)).await {
        let Ok((n, from)) = received else { continue };
        datagrams += 1;
        let mut rest = buffer.get(..n).unwrap_or_default();
        while let Scan::Frame(frame) = scan(rest, true) {
            survey.hear(&frame, clock.now(), &[]);
            peers.insert(from.ip());
            rest = rest.get(frame.len()..).unwrap_or_default();
        }
    }
    if survey.frames == 0 {
        return LookOutcome::Nothing(match datagrams {
            0 => format!("nothing in {} s", UDP_LOOK.as_secs_f64()),
            n => format!("{n} datagrams, and no MAVLink"),
        });
    }
    // Who is on this computer needs no door to the network.
    let host = if peers.iter().all(IpAddr::is_loopback) { "127.0.0.1" } else { "0.0.0.0" };
    match format!("udpin:{host}:{port}").parse() {
        Ok(endpoint) => LookOutcome::Speaks(endpoint, Box::new(survey)),
        Err(_) => LookOutcome::Nothing("no port".to_owned()),
    }
}

/// Tries the usual baud rates until frames come whose checksum is right.
async fn serial_device(device: &str) -> LookedAt {
    if !Path::new(device).exists() {
        return LookedAt {
            place: device.to_owned(),
            outcome: LookOutcome::Nothing("there is no such device".to_owned()),
        };
    }
    let mut heard_bytes = 0;
    for baud in USUAL_BAUD_RATES {
        let Ok(endpoint) = format!("serial:{device}:{baud}").parse::<Endpoint>() else { continue };
        match trial(&endpoint).await {
            Ok((survey, _)) if survey.frames > 0 => {
                return LookedAt {
                    place: device.to_owned(),
                    outcome: LookOutcome::Speaks(endpoint, Box::new(survey)),
                };
            }
            Ok((_, bytes)) => heard_bytes += bytes,
            Err(error) => {
                return LookedAt { place: device.to_owned(), outcome: LookOutcome::Nothing(refusal(&error)) };
            }
        }
    }
    let rates: Vec<String> = USUAL_BAUD_RATES.iter().map(u32::to_string).collect();
    let also = holders::of_device(device).map(|h| format!("; {h} has it open, too")).unwrap_or_default();
    let why = match heard_bytes {
        0 => format!(
            "not a byte at {} baud: is the autopilot on, does its TX lead to this RX, and has its port MAVLink (SERIALn_PROTOCOL = 2, MAV_n_CONFIG)?",
            rates.join(", ")
        ),
        n => format!(
            "{n} bytes, and no frame of MAVLink at {} baud: another rate, another protocol, or a console at the port?",
            rates.join(", ")
        ),
    };
    LookedAt { place: device.to_owned(), outcome: LookOutcome::Nothing(why + &also) }
}

/// Listens to a serial port, and says who is there, as a port of USB may want. What was heard, and how many bytes came.
async fn trial(endpoint: &Endpoint) -> Result<(LinkSurvey, u64), OpenError> {
    let (clock, close) = (CompanionClock::new(), CancellationToken::new());
    let config = LinkConfig::default();
    let mut links = Links::open(std::slice::from_ref(endpoint), config, clock.clone(), close.clone()).await?;
    let mut transmitter = Transmitter::new(links.handles.clone(), SystemId(1));
    transmitter.broadcast(&heartbeat(SystemStatus::Boot, CODE_NO_AUTOPILOT));
    let (mut survey, mut until) = (LinkSurvey::default(), Instant::now() + TRIAL);
    while let Ok(Some(received)) = timeout_at(until, links.inbound.recv()).await {
        let Some(frame) = received.frame().filter(|_| received.known) else { continue };
        if survey.frames == 0 {
            // Whoever else is there says so within a second.
            until = Instant::now() + TRIAL;
        }
        survey.hear(&frame, received.received, &[]);
    }
    close.cancel();
    let bytes = links.handles.stats().iter().map(|s| s.bytes_in).sum();
    let _ = tokio::time::timeout(CLOSING, links.handles.closed()).await;
    Ok((survey, bytes))
}

fn held_by(holder: Option<holders::Holder>) -> String {
    match holder {
        Some(holder) => format!("{holder} listens there already"),
        None => "another program, of another user, listens there already".to_owned(),
    }
}

/// Why a link cannot be opened, and what to do.
pub(super) fn refusal(error: &OpenError) -> String {
    match error {
        OpenError::PermissionDenied { endpoint: Endpoint::Serial(port) } => format!(
            "{}: permission denied: sudo usermod -aG dialout $USER (or the group of ls -l {}), then log in again",
            port.device(),
            port.device()
        ),
        OpenError::DeviceInUse { device, .. } => match holders::of_device(device) {
            Some(holder) => format!("{device} is in use by {holder}"),
            None => format!("{device} is in use by another program: sudo fuser -v {device} tells which"),
        },
        OpenError::AddressInUse { endpoint } => {
            let port = match endpoint {
                Endpoint::UdpIn(address) => Some(address.port()),
                _ => None,
            };
            match port.and_then(holders::of_udp_port) {
                Some(holder) => format!("{endpoint}: {holder} listens there already"),
                None => error.to_string(),
            }
        }
        other => other.to_string(),
    }
}

/// Why no autopilot was heard at the links that were named, with what their counters tell.
pub(super) fn silence(told: &str, links: &[LinkStats]) -> String {
    let mut text = told.to_owned();
    for link in links {
        let damaged = link.rejects.of(Cause::BadChecksum);
        let serial = matches!(link.endpoint, Endpoint::Serial(_));
        let word = match (link.bytes_in, link.frames_in) {
            (0, _) if serial => {
                "not a byte came: does the autopilot's TX lead to this RX, and has its port MAVLink (SERIALn_PROTOCOL = 2, MAV_n_CONFIG)?".to_owned()
            }
            (0, _) => "nothing came: does the autopilot, or the router, send to this address and port?".to_owned(),
            (n, 0) if serial => format!("{n} bytes came, and no frame: is the baud rate right? serial:DEVICE:auto tries the usual ones"),
            (n, 0) => format!("{n} bytes came, of no autopilot that goes on"),
            (_, n) => format!("{n} frames came, {damaged} damaged"),
        };
        text.push_str(&format!("\n  {}: {word}", link.endpoint));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Stamp;
    use crate::wire::session::heartbeat_fields::testing::{frame_of, heartbeat_frame};

    fn place(port: u16, frame: &crate::wire::frame_bytes::FrameBytes) -> LookedAt {
        let mut survey = LinkSurvey::default();
        survey.hear(&frame.frame().unwrap(), Stamp::from_micros(0), &[]);
        let endpoint = format!("udpin:127.0.0.1:{port}").parse().unwrap();
        LookedAt { place: port.to_string(), outcome: LookOutcome::Speaks(endpoint, Box::new(survey)) }
    }

    fn autopilot(port: u16, system: u8) -> LookedAt {
        place(port, &heartbeat_frame(system, 1, 2, 3, 0))
    }

    fn texts(of: &[Endpoint]) -> Vec<String> {
        of.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn the_only_autopilot_is_taken_and_what_only_measures_is_a_sensor() {
        use mavlink::dialects::ardupilotmega::{DISTANCE_SENSOR_DATA, MavMessage};
        let range = frame_of(9, 140, &MavMessage::DISTANCE_SENSOR(DISTANCE_SENSOR_DATA::default()));
        let nothing = LookedAt { place: "x".into(), outcome: LookOutcome::Nothing("silent".into()) };
        let ground = place(3, &heartbeat_frame(255, 190, 6, 8, 0));
        let looked = vec![nothing.clone(), autopilot(1, 1), place(2, &range), ground.clone()];
        let chosen = one_of(looked, true).unwrap();
        assert_eq!(texts(&chosen.endpoints), ["udpin:127.0.0.1:1"]);
        assert_eq!(texts(&chosen.sensor_endpoints), ["udpin:127.0.0.1:2"]);
        assert!(chosen.why.contains("ArduPilot quadrotor (system 1)"), "{}", chosen.why);
        let told = one_of(vec![nothing, ground], true).unwrap_err();
        assert!(
            matches!(&told, Failure::Link(t) if t.contains("x: silent") && t.contains("ground station")),
            "{told}"
        );
    }

    #[test]
    fn of_several_autopilots_none_is_taken() {
        let of = |systems: [u8; 2]| one_of(vec![autopilot(1, systems[0]), autopilot(2, systems[1])], true);
        for (systems, word) in [([1, 1], "that no ground station uses"), ([1, 2], "which is meant")] {
            let told = of(systems).unwrap_err();
            assert!(
                matches!(&told, Failure::Usage(t) if t.contains(word) && t.contains("udpin:127.0.0.1:2")),
                "{told}"
            );
        }
    }
}
