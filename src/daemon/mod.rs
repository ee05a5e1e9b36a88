//! The live daemon: frames in, position messages out, and the conversation with the autopilot around them.
//!
//! One task, one thread. It is handed links that are open, a clock and a token that stops it, so that a test needs neither fixed
//! ports nor signals. Nothing is sent but on a new IMU sample: when the stream stops, so does the output.

mod contact;
mod speaker;
mod summary;
mod voice;
mod watch;
mod wishes;

use std::time::Duration;

use tokio::time::{MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;

use crate::altimeter::{Channel, Health as HeightHealth};
use crate::config::{Settings, StreamSettings};
use crate::navigator::solution::{Mode, Solution};
use crate::outbound::message::OutboundMessage;
use crate::pipeline::{GnssMask, Pipeline};
use crate::sample::{Input, Sample, SampleKind};
use crate::time::{ApTime, ClockEvent, Companion, Span, Stamp};
use crate::wire::companion_clock::CompanionClock;
use crate::wire::counters::Cause;
use crate::wire::decode::{Decoder, LANDING_TARGET};
use crate::wire::encode::encode;
use crate::wire::frame::{Frame, SystemId};
use crate::wire::link::{LinkConfig, LinkEvent, LinkEventKind, Links, ReceivedFrame};
use crate::wire::protocol::heartbeat::{Health, HeartbeatSender, heartbeat};
use crate::wire::protocol::identity::{Identity, IdentityConfig, Sender};

use contact::Contact;
use speaker::Speaker;
pub use summary::Summary;
use voice::{Voice, Weight};
use watch::{ImuNews, ImuWatch};

/// Timers are looked at this often.
const TICK: Duration = Duration::from_millis(50);
/// Time between two summaries in the log.
const SUMMARY_PERIOD: Span = Span::from_millis(30_000);
/// Frames taken in a row before timers and signals are looked at.
const IN_A_ROW: usize = 64;
/// How long the last heartbeat has to leave.
const LAST_WORDS: Duration = Duration::from_millis(50);

/// `custom_mode` of our heartbeat before an autopilot was heard.
pub const CODE_NO_AUTOPILOT: u32 = 0;
/// `custom_mode` of our heartbeat while the autopilot or its IMU is silent.
pub const CODE_SILENT: u32 = 6;

/// `custom_mode` of our heartbeat in each mode; see also [`CODE_NO_AUTOPILOT`] and [`CODE_SILENT`].
pub const fn mode_code(mode: Mode) -> u32 {
    match mode {
        Mode::Aligning => 1,
        Mode::Aided => 2,
        Mode::Holdover => 3,
        Mode::Rejoining => 4,
        Mode::Lost => 5,
    }
}

/// Settings of the links, as configured.
pub fn link_config(settings: &Settings) -> LinkConfig {
    let l = &settings.link;
    LinkConfig {
        inbound_capacity: l.queue_frames,
        // Far fewer frames go out than come in.
        outbound_capacity: (l.queue_frames / 16).max(16),
        max_queue_age: Duration::from_millis(l.stale_output_ms),
        peer_silence: Duration::try_from_secs_f64(l.peer_timeout_s).unwrap_or(Duration::from_secs(5)),
        backoff_first: Duration::from_millis(l.reconnect_min_ms),
        backoff_cap: Duration::from_millis(l.reconnect_max_ms),
        system: settings.system,
        ..LinkConfig::default()
    }
}

/// What the daemon counts itself.
#[derive(Clone, Debug, Default)]
struct Counts {
    sent: u64,
    not_finite: u64,
    late: u64,
    duplicates: u64,
    heard: [u64; SampleKind::ALL.len()],
}

/// The daemon. See the module's documentation.
#[derive(Debug)]
pub struct Daemon {
    clock: CompanionClock,
    stale_after: Span,
    streams: StreamSettings,
    links: Option<Links>,
    speaker: Speaker,
    identity: Identity,
    decoder: Decoder,
    pipeline: Pipeline,
    mask: GnssMask,
    contact: Option<Contact>,
    voice: Voice,
    watch: ImuWatch,
    beat: HeartbeatSender,
    solution: Option<Solution>,
    /// The newest time of the autopilot's, and when it came.
    newest: Option<(ApTime, Stamp<Companion>)>,
    items: Vec<Input>,
    messages: Vec<OutboundMessage>,
    counts: Counts,
    summed: Option<(Stamp<Companion>, [u64; SampleKind::ALL.len()])>,
    retry_told: Vec<bool>,
    stranger_told: bool,
}

impl Daemon {
    /// A daemon that has heard nothing. GNSS is withheld from the navigator in the intervals `deny_gnss`, in seconds since the
    /// first sample.
    pub fn new(settings: &Settings, deny_gnss: &[(f64, f64)], links: Links, clock: CompanionClock) -> Self {
        let system = settings.system.unwrap_or(SystemId(1));
        let count = links.handles.ids().count();
        Self {
            stale_after: Span::from_millis(i64::try_from(settings.link.stale_output_ms).unwrap_or(i64::MAX)),
            streams: settings.streams,
            speaker: Speaker::new(links.handles.clone(), system),
            links: Some(links),
            identity: Identity::new(IdentityConfig { system: settings.system, ..IdentityConfig::default() }),
            decoder: Decoder::new(),
            pipeline: Pipeline::new(&settings.pipeline),
            mask: GnssMask::new(deny_gnss),
            contact: None,
            voice: Voice::new(settings.statustext),
            watch: ImuWatch::new(Span::from_seconds(settings.pipeline.navigator.imu_max_gap_s)),
            beat: HeartbeatSender::default(),
            solution: None,
            newest: None,
            items: Vec::with_capacity(16),
            messages: Vec::with_capacity(4),
            counts: Counts::default(),
            summed: None,
            retry_told: vec![false; count],
            stranger_told: false,
            clock,
        }
    }

    /// Runs until `cancel` is cancelled, or all links have ended. Says good-bye, and returns what was counted.
    pub async fn run(mut self, cancel: CancellationToken) -> Summary {
        let Some(mut links) = self.links.take() else { return self.summary(self.clock.now()) };
        self.summed = Some((self.clock.now(), self.counts.heard));
        let mut tick = interval(TICK);
        tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                biased;
                () = cancel.cancelled() => break,
                _ = tick.tick() => self.tick(),
                Some(event) = links.events.recv() => self.link_event(&event),
                frame = links.inbound.recv() => {
                    let Some(frame) = frame else { break };
                    self.frame(&frame);
                    for _ in 0..IN_A_ROW {
                        let Ok(frame) = links.inbound.try_recv() else { break };
                        self.frame(&frame);
                    }
                }
            }
        }
        let code = self.state().1;
        self.speaker.broadcast(&heartbeat(Health::PowerOff, code));
        tokio::time::sleep(LAST_WORDS).await;
        self.summary(self.clock.now())
    }

    /// What our heartbeat says.
    fn state(&self) -> (Health, u32) {
        if self.identity.vehicle().is_none() {
            return (Health::Boot, CODE_NO_AUTOPILOT);
        }
        if self.watch.silent() || !self.identity.is_heard() {
            return (Health::Critical, CODE_SILENT);
        }
        let mode = self.pipeline.navigator.mode();
        let health = match mode {
            Mode::Aligning if self.solution.is_none() => Health::Boot,
            Mode::Aligning => Health::Standby,
            Mode::Aided | Mode::Holdover | Mode::Rejoining => Health::Active,
            Mode::Lost => Health::Critical,
        };
        (health, mode_code(mode))
    }

    fn frame(&mut self, received: &ReceivedFrame) {
        let Some(frame) = received.frame() else { return };
        if !received.known {
            return;
        }
        let at = received.received;
        let ours = self
            .identity
            .vehicle()
            .is_some_and(|v| (v.system, v.component) == (frame.system(), frame.component()));
        if ours && !self.listens(received, at) {
            return;
        }
        let (sender, event) = self.identity.hear(at, &frame);
        if let Some(event) = event {
            if !ours {
                self.listens(received, at);
            }
            self.identity_event(event);
        }
        match sender {
            Sender::Autopilot => self.conversation(&frame, at),
            // A camera on the vehicle that sees landmarks.
            Sender::SameSystem if frame.message_id() == LANDING_TARGET => {}
            Sender::WrongSystem => return self.stranger(&frame),
            _ => return,
        }
        let mut items = std::mem::take(&mut self.items);
        self.decoder.decode(&frame, &mut items);
        let newest = self.decoder.clock().newest();
        if newest != self.newest.map(|(time, _)| time) {
            self.newest = newest.map(|time| (time, at));
        }
        for item in items.drain(..) {
            self.item(&item, at);
        }
        self.items = items;
    }

    /// Whether the autopilot is listened to on this frame's link. What comes on others is counted and not used.
    fn listens(&mut self, received: &ReceivedFrame, at: Stamp<Companion>) -> bool {
        let (listened, moved) = self.speaker.listens(received.link, at);
        if !listened {
            self.counts.duplicates += 1;
        }
        if moved {
            let text = format!("the autopilot is heard on {} now", received.link);
            self.say(Weight::Notice, &text);
            self.begin_anew();
        }
        listened
    }

    fn stranger(&mut self, frame: &Frame<'_>) {
        if !std::mem::replace(&mut self.stranger_told, true) {
            tracing::warn!("system {} is heard, too, and ignored", frame.system().0);
        }
    }

    fn item(&mut self, item: &Input, at: Stamp<Companion>) {
        if let Input::Sample(sample) = item {
            self.counts.heard[sample.kind() as usize] += 1;
        }
        if let Some(time) = self.mask.withholds(item) {
            self.pipeline.navigator.mask_gnss(time);
            return;
        }
        match item {
            Input::Sample(Sample::Imu(_)) => {
                if let Some(news) = self.watch.heard(at) {
                    self.imu_news(news);
                }
            }
            Input::Origin(_) => {
                if let Some(contact) = &mut self.contact {
                    contact.wishes.origin_heard();
                }
            }
            Input::Clock(ClockEvent::Reboot { .. }) => {
                self.say(Weight::Warning, "the autopilot rebooted");
                self.begin_anew();
            }
            Input::Clock(ClockEvent::Gap(span)) => {
                tracing::warn!("the autopilot's stamps have a gap of {:.1} s", span.seconds());
            }
            _ => {}
        }
        let mut messages = std::mem::take(&mut self.messages);
        if let Some(solution) = self.pipeline.take(self.decoder.clock(), item, &mut messages) {
            self.solution = Some(solution);
        }
        for message in messages.drain(..) {
            self.send_position(&message, at);
        }
        self.messages = messages;
        if self.pipeline.navigator.has_events() {
            self.tell_events();
        }
    }

    fn send_position(&mut self, message: &OutboundMessage, at: Stamp<Companion>) {
        if self.clock.now() - at > self.stale_after {
            self.counts.late += 1;
            return;
        }
        match encode(message, self.decoder.clock()) {
            Some(message) => self.counts.sent += u64::from(self.speaker.answer(&message)),
            None => self.counts.not_finite += 1,
        }
    }

    fn tell_events(&mut self) {
        let events: Vec<_> = self.pipeline.navigator.drain_events().collect();
        for event in events {
            self.say(Weight::of(&event.what), &event.what.to_string());
        }
    }

    fn say(&mut self, weight: Weight, text: &str) {
        for message in self.voice.say(self.clock.now(), weight, text) {
            self.speaker.answer(&message);
        }
    }

    fn imu_news(&mut self, news: ImuNews) {
        match news {
            ImuNews::NeverCame => {
                self.say(Weight::Critical, "no IMU message comes: nothing to navigate with")
            }
            ImuNews::Silent(span) => {
                self.say(Weight::Critical, &format!("IMU silent for {:.1} s", span.seconds()));
            }
            ImuNews::Back(span) => {
                self.say(Weight::Notice, &format!("IMU is back after {:.1} s", span.seconds()));
            }
        }
    }

    fn tick(&mut self) {
        let now = self.clock.now();
        let (health, code) = self.state();
        if let Some(beat) = self.beat.poll(now, health, code) {
            self.speaker.broadcast(&beat);
        }
        let poll = self.identity.poll(now);
        if let Some(message) = poll.send {
            self.speaker.answer(&message);
        }
        if let Some(event) = poll.event {
            self.identity_event(event);
        }
        if let Some(news) = self.watch.poll(now) {
            self.imu_news(news);
        }
        self.ask(now);
        if self.summed.is_none_or(|(then, _)| now - then >= SUMMARY_PERIOD) {
            let summary = self.summary(now);
            tracing::info!("{summary}");
            self.summed = Some((now, self.counts.heard));
        }
    }

    fn link_event(&mut self, event: &LinkEvent) {
        let (link, kind) = (event.link, &event.kind);
        let told = self.retry_told.get_mut(link.0);
        match kind {
            LinkEventKind::Up { .. } | LinkEventKind::PeerPinned { .. } => {
                tracing::info!("{link}: {kind}");
                if let Some(told) = told {
                    *told = false;
                }
                if self.speaker.route().link() == Some(link) {
                    self.say(Weight::Notice, "the link is up again");
                    self.begin_anew();
                }
            }
            LinkEventKind::Retry { .. } => {
                if told.is_some_and(|told| !std::mem::replace(told, true)) {
                    tracing::warn!("{link}: {kind}");
                } else {
                    tracing::debug!("{link}: {kind}");
                }
            }
            _ => tracing::warn!("{link}: {kind}"),
        }
    }

    fn faulty_heights(&self) -> Vec<(Channel, HeightHealth)> {
        let mut health = Vec::from(self.pipeline.navigator.height_health());
        health.retain(|(_, health)| health.is_faulty());
        health
    }

    fn summary(&self, now: Stamp<Companion>) -> Summary {
        let mut rejects = self.decoder.counters().clone();
        rejects.add(Cause::WrongSystem, self.identity.wrong_system());
        let (mut inbound_dropped, mut unsent) = (0, 0);
        for stats in self.speaker.handles().stats() {
            rejects.merge(&stats.rejects);
            inbound_dropped += stats.inbound_dropped;
            unsent += stats.unsent_full + stats.unsent_stale;
        }
        let mut rates_hz = [0.0; SampleKind::ALL.len()];
        if let Some((then, before)) = self.summed {
            let elapsed = now.seconds_since(then).max(1e-3);
            for ((rate, n), b) in rates_hz.iter_mut().zip(self.counts.heard).zip(before) {
                *rate = (n - b) as f64 / elapsed;
            }
        }
        Summary {
            mode: self.pipeline.navigator.mode(),
            sigma_m: self.solution.as_ref().map(Solution::horizontal_sigma_m),
            faulty_heights: self.faulty_heights(),
            rates_hz,
            sent: self.counts.sent,
            not_finite: self.counts.not_finite,
            late: self.counts.late,
            rejects,
            duplicates: self.counts.duplicates,
            inbound_dropped,
            unsent,
            timesync: self.contact.as_ref().and_then(Contact::timesync),
            answered: self.contact.as_ref().map_or(0, Contact::answered),
            words_withheld: self.voice.withheld(),
            reboots: self.decoder.clock().reboots(),
        }
    }
}
