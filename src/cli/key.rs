//! `holdover key`: the keys of MAVLink 2 signing, and handing one to an autopilot.

use std::io::{IsTerminal, Read};
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{Args, Subcommand};
use tokio::time::{MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;
use zeroize::Zeroizing;

use crate::files::Overwrite;
use crate::wire::companion_clock::CompanionClock;
use crate::wire::endpoint::Endpoint;
use crate::wire::frame::{ComponentId, Frame, SystemId};
use crate::wire::link::{LinkConfig, Links};
use crate::wire::session::heartbeat::{HeartbeatSender, SystemStatus};
use crate::wire::session::heartbeat_fields::HeartbeatFields;
use crate::wire::session::transmitter::Transmitter;
use crate::wire::signing::{
    SigningGate, SigningKey, SigningSettings, is_signed_with, read_key, setup_signing, write_key,
};

use super::Failure;

/// Arguments of `key`.
#[derive(Debug, Args)]
pub struct KeyArgs {
    #[command(subcommand)]
    what: KeyCommand,
}

/// What is done with a key.
#[derive(Debug, Subcommand)]
enum KeyCommand {
    /// Make a new key of the system's random bytes
    New {
        /// The file to write, mode 0600
        file: PathBuf,
        /// Overwrite a key that is there
        #[arg(long)]
        force: bool,
    },
    /// Write the key that standard input holds: 64 hexadecimal digits, or else a passphrase, of which it takes the SHA-256 as MAVProxy,
    /// QGroundControl and Mission Planner do
    Import {
        /// The file to write, mode 0600
        file: PathBuf,
        /// Take 64 hexadecimal digits for a passphrase, too
        #[arg(long)]
        passphrase: bool,
        /// Overwrite a key that is there
        #[arg(long)]
        force: bool,
    },
    /// Print by what a key can be told from another
    ShowId {
        /// The key file
        file: PathBuf,
    },
    /// Hand the key to the autopilot on one link (SETUP_SIGNING). It goes in clear: use a cable
    Setup(SetupArgs),
}

/// Arguments of `key setup`.
#[derive(Debug, Args)]
struct SetupArgs {
    /// Where the autopilot is, and nobody else: udpin:HOST:PORT, udpout:…, tcpin:…, tcpout:…, serial:DEVICE:BAUD
    #[arg(long, value_name = "ENDPOINT")]
    link: Endpoint,
    /// The key to hand over
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
    /// The key that it signs with at present
    #[arg(long, value_name = "FILE")]
    present_key: Option<PathBuf>,
    /// Its system id; without it there has to be one autopilot only
    #[arg(long, value_name = "ID")]
    system: Option<u8>,
    /// How long it may take to be heard, and to sign, s
    #[arg(long, value_name = "S", default_value_t = 10, value_parser = clap::value_parser!(u16).range(1..=600))]
    wait: u16,
}

/// Standard input is not read beyond this.
const MOST_INPUT: u64 = 4096;
/// A shorter passphrase is guessed from one recorded frame.
const SHORT_PASSPHRASE: usize = 16;
/// Timers are looked at this often.
const TICK: Duration = Duration::from_millis(100);
/// Ticks between two times of handing it over: a frame may be lost.
const AGAIN: u32 = 10;

/// Runs the command.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &KeyArgs) -> Result<(), Failure> {
    match &args.what {
        KeyCommand::New { file, force } => {
            let key = SigningKey::random().map_err(|e| Failure::Other(e.to_string()))?;
            written(file, &key, *force, "a new key")
        }
        KeyCommand::Import { file, passphrase, force } => {
            let (key, from) = imported(*passphrase)?;
            written(file, &key, *force, &from)
        }
        KeyCommand::ShowId { file } => {
            outln!("{}", read(file)?.id());
            Ok(())
        }
        KeyCommand::Setup(args) => setup(args),
    }
}

fn read(file: &Path) -> Result<SigningKey, Failure> {
    read_key(file).map_err(|e| Failure::Usage(e.to_string()))
}

fn written(file: &Path, key: &SigningKey, force: bool, from: &str) -> Result<(), Failure> {
    write_key(file, key, Overwrite::forced(force))?;
    outln!("{}: {from}, id {}", file.display(), key.id());
    Ok(())
}

/// The key of standard input, and what it was made of.
fn imported(passphrase: bool) -> Result<(SigningKey, String), Failure> {
    let stdin = std::io::stdin();
    if stdin.is_terminal() {
        eprintln!(
            "holdover: 64 hexadecimal digits or a passphrase, then Enter and Ctrl-D (it is shown as you type):"
        );
    }
    let mut text = Zeroizing::new(Vec::with_capacity(MOST_INPUT as usize + 1));
    stdin.lock().take(MOST_INPUT + 1).read_to_end(&mut text)?;
    if text.len() as u64 > MOST_INPUT {
        return Err(Failure::Usage(format!(
            "standard input holds more than {MOST_INPUT} bytes: that is no key"
        )));
    }
    let line = text.strip_suffix(b"\n").unwrap_or(&text);
    let line = line.strip_suffix(b"\r").unwrap_or(line);
    if line.is_empty() {
        return Err(Failure::Usage("standard input holds no key".into()));
    }
    if !passphrase
        && line.len() == 64
        && let Ok(key) = SigningKey::parse(line)
    {
        return Ok((key, "the key of 64 hexadecimal digits".into()));
    }
    if line.contains(&b'\n') || std::str::from_utf8(line).is_err() {
        return Err(Failure::Usage(
            "standard input holds neither 64 hexadecimal digits nor a line of text".into(),
        ));
    }
    if line.len() < SHORT_PASSPHRASE {
        eprintln!(
            "holdover: a passphrase of {} characters can be guessed by whoever records one frame; `holdover key new` makes one that cannot",
            line.len()
        );
    }
    Ok((SigningKey::from_passphrase(line), "the SHA-256 of the passphrase".into()))
}

fn setup(args: &SetupArgs) -> Result<(), Failure> {
    let key = read(&args.key)?;
    let present = args.present_key.as_deref().map(read).transpose()?;
    eprintln!("holdover: the key goes over {} in clear: whoever hears that link has it", args.link);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let vehicle = runtime.block_on(hand_over(args, &key, present))?;
    outln!("system {} signs with key {} now", vehicle.0, key.id());
    Ok(())
}

/// What is known while a key is handed over.
#[derive(Default)]
struct HandingOver {
    vehicle: Option<SystemId>,
    others: bool,
    signs: bool,
}

impl HandingOver {
    fn hear(&mut self, frame: &Frame<'_>, wanted: Option<u8>, key: &SigningKey) {
        let from_autopilot = frame.component() == ComponentId::AUTOPILOT;
        if from_autopilot
            && wanted.is_none_or(|w| w == frame.system().0)
            && HeartbeatFields::read(frame).is_some_and(|h| h.is_autopilot())
        {
            self.others |= self.vehicle.is_some_and(|v| v != frame.system());
            self.vehicle.get_or_insert(frame.system());
        }
        self.signs |= from_autopilot && self.vehicle == Some(frame.system()) && is_signed_with(frame, key);
    }

    /// Who signs with the key, that was sent so many times, or why nobody does.
    fn outcome(&self, args: &SetupArgs, sent: u32) -> Result<SystemId, Failure> {
        match self.vehicle {
            _ if self.others => {
                Err(Failure::Usage("several autopilots are heard: say which is meant, --system ID".into()))
            }
            Some(vehicle) if self.signs && sent > 0 => Ok(vehicle),
            Some(vehicle) => Err(Failure::Other(format!(
                "system {} was sent the key {sent} times, and does not sign with it: is it armed, or does it sign with another (--present-key)?",
                vehicle.0
            ))),
            None => Err(Failure::Link(format!("no autopilot was heard at {} in {} s", args.link, args.wait))),
        }
    }
}

async fn hand_over(
    args: &SetupArgs,
    key: &SigningKey,
    present: Option<SigningKey>,
) -> Result<SystemId, Failure> {
    let (clock, close) = (CompanionClock::new(), CancellationToken::new());
    // What comes is looked at whatever signature it has; what goes is signed as it is asked for.
    let gate = SigningGate::new(present, &SigningSettings::default()).lenient();
    let config =
        LinkConfig { signing: gate.into(), system: args.system.map(SystemId), ..LinkConfig::default() };
    let mut links = Links::open(std::slice::from_ref(&args.link), config, clock.clone(), close.clone())
        .await
        .map_err(|e| Failure::Link(e.to_string()))?;
    let mut transmitter = Transmitter::new(links.handles.clone(), SystemId(args.system.unwrap_or(1)));
    let mut beat = HeartbeatSender::default();
    let mut tick = interval(TICK);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut state = HandingOver::default();
    let (mut ticks, mut sent) = (0u32, 0u32);
    let ends = clock.now() + crate::time::Span::from_millis(i64::from(args.wait) * 1000);
    while clock.now() < ends && !(state.signs && sent > 0) {
        tokio::select! {
            biased;
            _ = tick.tick() => {
                if let Some(beat) = beat.poll(clock.now(), SystemStatus::Boot, 0) {
                    transmitter.broadcast(&beat);
                }
                ticks += 1;
                // Two of its own are told apart only after a second of listening.
                if let Some(vehicle) = state.vehicle.filter(|_| ticks.is_multiple_of(AGAIN)) {
                    if state.others {
                        break;
                    }
                    transmitter.belong_to(vehicle);
                    transmitter.broadcast(&setup_signing((vehicle, ComponentId::AUTOPILOT), key, clock.unix_us()));
                    sent += 1;
                    state.signs = false;
                }
            }
            Some(_) = links.events.recv() => {}
            Some(received) = links.inbound.recv() => {
                if let Some(frame) = received.frame().filter(|_| received.known) {
                    state.hear(&frame, args.system, key);
                }
            }
        }
    }
    close.cancel();
    state.outcome(args, sent)
}
