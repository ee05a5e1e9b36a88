//! The conversation of `preflight` and `init` with an autopilot, over links that are open for it alone.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::{MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;

use crate::config::Settings;
use crate::daemon::{CODE_NO_AUTOPILOT, endpoints, link_config};
use crate::preflight::Needs;
use crate::preflight::conversation::{Preflight, PreflightEnd};
use crate::sample::Input;
use crate::time::{Companion, Span, Stamp};
use crate::wire::companion_clock::CompanionClock;
use crate::wire::frame::{Frame, SystemId};
use crate::wire::link::{LinkConfig, LinkEvent, LinkStats, Links, OpenError, ReceivedFrame};
use crate::wire::session::heartbeat::{HeartbeatSender, SystemStatus};
use crate::wire::session::transmitter::Transmitter;
use crate::wire::signing::{Signing, SigningWatch};

use super::Failure;

/// Timers are looked at this often.
const TICK: Duration = Duration::from_millis(50);
/// How long the links may take to close.
const CLOSING: Duration = Duration::from_secs(1);
/// Events of the links that are kept.
const MOST_EVENTS: usize = 100;

/// What is to be talked about, and for how long.
#[derive(Clone, Copy, Debug)]
pub(super) struct Conversation<'a> {
    /// Where, and as whom.
    pub(super) settings: &'a Settings,
    /// What the autopilot has to be set up for.
    pub(super) needs: &'a Needs,
    /// Set what mends the faults.
    pub(super) write: bool,
    /// How long to wait for an autopilot, s.
    pub(super) wait_s: u16,
    /// How long to listen at least, s; `None` is as long as rates take to be measured.
    pub(super) listen_s: Option<u16>,
}

/// How it went.
#[derive(Clone, Debug)]
pub(super) struct Conversed {
    /// What it ended with.
    pub(super) end: PreflightEnd,
    /// What the links counted.
    pub(super) links: Vec<LinkStats>,
    /// What befell them.
    pub(super) events: Vec<LinkEvent>,
}

/// Why there was no conversation.
#[derive(Debug, thiserror::Error)]
pub(super) enum ConverseError {
    /// A link cannot be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The key of signed links cannot be used.
    #[error("{0}")]
    Key(String),
}

impl From<ConverseError> for Failure {
    fn from(e: ConverseError) -> Self {
        match e {
            ConverseError::Open(e) => Failure::Link(e.to_string()),
            ConverseError::Key(e) => Failure::Usage(e),
        }
    }
}

/// Who listens: to every frame whose checksum was tested, when it came, and what it told of the vehicle's sensors.
pub(super) type Listener<'a> = dyn FnMut(&Frame<'_>, Stamp<Companion>, &[Input]) + 'a;

/// Holds the conversation over the links, until it has an end.
///
/// # Errors
/// [`ConverseError`].
pub(super) async fn converse(
    plan: &Conversation<'_>,
    listener: &mut Listener<'_>,
) -> Result<Conversed, ConverseError> {
    let settings = plan.settings;
    let (clock, close) = (CompanionClock::new(), CancellationToken::new());
    let states = settings.state.make(|name| std::env::var(name).ok()).ok().flatten();
    let signing = Signing::beside(&settings.signing, states.as_deref(), endpoints(settings).len())
        .map_err(|e| ConverseError::Key(e.to_string()))?;
    if let Some(told) = &signing.told {
        errln!("holdover: {told}");
    }
    let config = LinkConfig { signing: Arc::clone(&signing.gate), ..link_config(settings) };
    let mut links = Links::open(&settings.endpoints, config, clock.clone(), close.clone()).await?;
    let handles = links.handles.clone();
    let mut transmitter = Transmitter::new(handles.clone(), settings.system.unwrap_or(SystemId(1)));
    let wait = Span::from_millis(i64::from(plan.wait_s) * 1000);
    let mut preflight = Preflight::new(settings, plan.needs.clone(), plan.write, clock.now(), wait);
    if let Some(seconds) = plan.listen_s {
        preflight = preflight.listening_for(Span::from_millis(i64::from(seconds) * 1000));
    }
    let mut beat = HeartbeatSender::default();
    let mut events = Vec::new();
    let mut tick = interval(TICK);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let end = loop {
        tokio::select! {
            biased;
            _ = tick.tick() => {
                let now = clock.now();
                if let Some(beat) = beat.poll(now, SystemStatus::Boot, CODE_NO_AUTOPILOT) {
                    transmitter.broadcast(&beat);
                }
                for message in preflight.poll(now).messages {
                    transmitter.answer(&message);
                }
                if let Some(end) = preflight.end() {
                    break end.clone();
                }
            }
            Some(event) = links.events.recv() => {
                preflight.link_event(&event);
                if events.len() < MOST_EVENTS {
                    events.push(event);
                }
            }
            frame = links.inbound.recv() => {
                let Some(frame) = frame else { break PreflightEnd::FellSilent };
                hear(&mut preflight, &mut transmitter, &frame, &clock, listener);
            }
        }
    };
    close.cancel();
    if let Some(refused) = SigningWatch::default().poll(clock.now(), &handles.signing()) {
        errln!("holdover: {refused}");
    }
    // A link that does not close has no say in what was found.
    let _ = tokio::time::timeout(CLOSING, handles.closed()).await;
    Ok(Conversed { end, links: handles.stats(), events })
}

fn hear(
    preflight: &mut Preflight,
    transmitter: &mut Transmitter,
    received: &ReceivedFrame,
    clock: &CompanionClock,
    listener: &mut Listener<'_>,
) {
    let Some(frame) = received.frame().filter(|_| received.known) else { return };
    let at = received.received;
    let ours = preflight.sent_by_autopilot(&frame);
    if ours && !transmitter.listens(received.link, at).0 {
        return;
    }
    let reply = preflight.hear(&frame, at, clock.now());
    listener(&frame, at, preflight.newest_inputs());
    if !ours && let Some(vehicle) = preflight.vehicle().filter(|_| preflight.sent_by_autopilot(&frame)) {
        transmitter.belong_to(vehicle.system);
        transmitter.listens(received.link, at);
    }
    if let Some(answer) = reply.answer {
        transmitter.answer(&answer);
    }
}
