//! The live daemon: frames in, position messages out, and the conversation with the autopilot around them.
//!
//! One task, one thread of its own: it takes what the links have put into their queue, and puts what it sends into theirs. It is handed links
//! that are open, a clock and a token that stops it, so that a test needs neither fixed ports nor signals. Nothing is sent but on a new IMU
//! sample: when the stream stops, so does the output.

mod alive;
mod codes;
mod counts;
mod hand_over;
mod imu_told;
mod keeping;
mod lateness;
pub mod lines;
mod opening;
mod recording;
mod reporting;
mod severity;
mod summary;
mod watch;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::Notify;
use tokio::time::{MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;

use crate::config::Settings;
use crate::navigator::solution::{Mode, Solution};
use crate::outbound::handover::Sending;
use crate::outbound::message::OutboundMessage;
use crate::pipeline::{GnssMask, Pipeline};
use crate::record::LinkRecorder;
use crate::sample::{Input, Sample, SampleKind};
use crate::state::Moment;
use crate::status::StatusFeed;
use crate::time::{AutopilotTime, ClockEvent, Companion, Span, Stamp};
use crate::wire::companion_clock::CompanionClock;
use crate::wire::decode::Decoder;
use crate::wire::encode::encode;
use crate::wire::frame::{Frame, SystemId};
use crate::wire::link::{LinkEvent, LinkEventKind, Links, ReceivedFrame};
use crate::wire::messages::from_any_component;
use crate::wire::recording::HeardAs;
use crate::wire::session::autopilot::AutopilotSession;
use crate::wire::session::heartbeat::{HeartbeatSender, SystemStatus, heartbeat};
use crate::wire::session::heartbeat_fields::HeartbeatFields;
use crate::wire::session::identity::{IdentityEvent, Sender, Vehicle};
use crate::wire::session::status_text_sender::{Severity, StatusTextSender};
use crate::wire::session::transmitter::Transmitter;
use crate::wire::signing::SigningWatch;

pub use alive::AliveSign;
pub use codes::{CODE_NO_AUTOPILOT, CODE_SILENT, mode_code};
use counts::Counts;
use keeping::Keeping;
use lateness::LateWatch;
use lines::LogHandle;
pub use opening::{endpoints, link_config};
use recording::Recording;
use severity::severity_of;
pub use summary::Summary;
use watch::ImuWatch;

/// Timers are looked at this often.
const TICK: Duration = Duration::from_millis(50);
/// Time between two summaries in the log.
const SUMMARY_PERIOD: Span = Span::from_millis(30_000);
/// Frames taken in a row before timers and signals are looked at.
const IN_A_ROW: usize = 64;
/// How long the last heartbeat has to leave.
const LAST_WORDS: Duration = Duration::from_millis(50);

/// The daemon. See the module's documentation.
#[derive(Debug)]
pub struct Daemon {
    clock: CompanionClock,
    stale_after: Span,
    sensors_from: usize,
    links: Option<Links>,
    transmitter: Transmitter,
    session: AutopilotSession,
    decoder: Decoder,
    pipeline: Pipeline,
    mask: GnssMask,
    status_texts: StatusTextSender,
    watch: ImuWatch,
    lateness: LateWatch,
    beat: HeartbeatSender,
    keeping: Keeping,
    signing: SigningWatch,
    /// The log, whose losses are told; and somebody who asks how it fares.
    log: Option<LogHandle>,
    asked: Arc<Notify>,
    /// Who is told that frames are handled, and whether some were of late.
    alive: Option<AliveSign>,
    handled: bool,
    solution: Option<Solution>,
    /// Age of the newest position when it comes to the autopilot, s, where that is known.
    age_s: Option<f64>,
    sending_told: Option<Sending>,
    /// Of one frame; kept for its memory.
    inputs: Vec<Input>,
    messages: Vec<OutboundMessage>,
    counts: Counts,
    summed: Option<(Stamp<Companion>, [u64; SampleKind::ALL.len()])>,
    retry_told: Vec<bool>,
    stranger_told: bool,
    /// Whoever looks.
    feed: Option<StatusFeed>,
    recording: Recording,
}

impl Daemon {
    /// A daemon that has heard nothing. GNSS is withheld from the navigator in the intervals `deny_gnss`, in seconds since the
    /// first sample.
    pub fn new(settings: &Settings, deny_gnss: &[(f64, f64)], links: Links, clock: CompanionClock) -> Self {
        let system = settings.system.unwrap_or(SystemId(1));
        let count = links.handles.ids().count();
        Self {
            stale_after: Span::from_millis(i64::try_from(settings.link.stale_output_ms).unwrap_or(i64::MAX)),
            sensors_from: settings.endpoints.len(),
            transmitter: Transmitter::new(links.handles.clone(), system),
            links: Some(links),
            session: AutopilotSession::new(settings.identity(), settings.streams, settings.source_switch),
            decoder: Decoder::new(),
            pipeline: Pipeline::new(&settings.pipeline),
            mask: GnssMask::new(deny_gnss),
            status_texts: StatusTextSender::new(settings.statustext),
            watch: ImuWatch::new(Span::from_seconds(settings.pipeline.navigator.imu.max_gap_s)),
            lateness: LateWatch::new(Span::from_millis(
                i64::try_from(settings.link.stale_output_ms).unwrap_or(i64::MAX),
            )),
            beat: HeartbeatSender::default(),
            keeping: Keeping::default(),
            signing: SigningWatch::default(),
            log: None,
            asked: Arc::default(),
            alive: None,
            handled: false,
            solution: None,
            age_s: None,
            sending_told: None,
            inputs: Vec::with_capacity(16),
            messages: Vec::with_capacity(4),
            counts: Counts::default(),
            summed: None,
            retry_told: vec![false; count],
            stranger_told: false,
            feed: None,
            recording: Recording::default(),
            clock,
        }
    }

    /// Keeps the navigation's state in this folder, and goes on from what it finds there.
    pub fn keeping_state_in(mut self, folder: Option<PathBuf>) -> Self {
        self.keeping = Keeping::new(folder);
        if let Some(system) = self.keeping.served_lately(self.clock.unix_us()) {
            self.session.expect(system);
        }
        self
    }

    /// Tells in its summaries what this log has lost, and writes one when `asked` is notified.
    pub fn told_in(mut self, log: LogHandle, asked: Arc<Notify>) -> Self {
        self.log = Some(log);
        self.asked = asked;
        self
    }

    /// Hands to `feed` how it fares.
    pub fn shown_by(mut self, feed: Option<StatusFeed>) -> Self {
        self.feed = feed;
        self
    }

    /// Hands over to `recorder` what is heard and sent.
    pub fn recorded_by(mut self, recorder: Option<LinkRecorder>) -> Self {
        self.recording = Recording::new(recorder, self.clock.now(), self.mask.intervals());
        if self.recording.is_on() {
            self.transmitter.remember();
        }
        self
    }

    /// Tells this watchdog while frames are handled.
    pub fn alive_for(mut self, alive: AliveSign) -> Self {
        self.alive = Some(alive);
        self
    }

    /// Runs until `cancel` is cancelled, or all links have ended. Says good-bye, and returns what was counted.
    pub async fn run(mut self, cancel: CancellationToken) -> Summary {
        let Some(mut links) = self.links.take() else { return self.summary(self.clock.now()) };
        self.summed = Some((self.clock.now(), self.counts.heard));
        let asked = Arc::clone(&self.asked);
        let mut tick = interval(TICK);
        tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                biased;
                () = cancel.cancelled() => break,
                _ = tick.tick() => {
                    self.tick();
                    let handled = std::mem::take(&mut self.handled) || links.inbound.is_empty();
                    if let Some(alive) = &mut self.alive {
                        alive.poll(self.clock.now(), handled);
                    }
                }
                () = asked.notified() => tracing::info!("{}", self.summary(self.clock.now())),
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
        self.pipeline.navigator.close();
        self.tell_events();
        let code = self.state().1;
        self.transmitter.broadcast(&heartbeat(SystemStatus::PowerOff, code));
        let now = self.clock.now();
        self.recording.sent(now, &mut self.transmitter);
        let moment = Moment { clock: self.decoder.clock(), unix_us: self.clock.unix_us() };
        self.keeping.end(now, &self.pipeline, self.session.vehicle(), &moment);
        tokio::time::sleep(LAST_WORDS).await;
        self.summary(self.clock.now())
    }

    /// What our heartbeat says.
    fn state(&self) -> (SystemStatus, u32) {
        if self.session.vehicle().is_none() {
            return (SystemStatus::Boot, CODE_NO_AUTOPILOT);
        }
        if self.watch.silent() || !self.session.is_heard() {
            return (SystemStatus::Critical, CODE_SILENT);
        }
        let mode = self.pipeline.navigator.mode();
        let health = match mode {
            Mode::Aligning if self.solution.is_none() => SystemStatus::Boot,
            Mode::Aligning => SystemStatus::Standby,
            Mode::Aided | Mode::Holdover | Mode::Rejoining => SystemStatus::Active,
            Mode::Lost => SystemStatus::Critical,
        };
        (health, mode_code(mode))
    }

    /// A frame came. It is recorded as it is taken, and what it caused to be sent after it.
    fn frame(&mut self, received: &ReceivedFrame) {
        self.handled = true;
        let Some(frame) = received.frame() else { return };
        let (how, inputs) = self.sort(&frame, received);
        let now = self.clock.now();
        self.recording.heard(now, how, &frame);
        if inputs {
            let at = received.received;
            let mut inputs = std::mem::take(&mut self.inputs);
            if how == HeardAs::Sensor {
                let taken = self.decoder.decode_sensor(&frame, &mut inputs);
                self.counts.sensor_frames[usize::from(!taken)] += 1;
            } else {
                // It had come by now; what waited in a pause may have come at any time of it.
                self.decoder.decode(&frame, Some(now), &mut inputs);
                self.session.stamped(self.decoder.clock().newest(), at);
            }
            self.take(inputs, at);
        }
        self.recording.sent(now, &mut self.transmitter);
    }

    /// On what link a frame came, who sent it, and whether it may hold inputs.
    fn sort(&mut self, frame: &Frame<'_>, received: &ReceivedFrame) -> (HeardAs, bool) {
        if received.link.0 >= self.sensors_from {
            return (HeardAs::Sensor, received.known);
        }
        if !received.known {
            return (HeardAs::Listened, false);
        }
        let at = received.received;
        let ours = self.session.sent_by_autopilot(frame);
        if ours && !self.listens(received, at) {
            return (HeardAs::Beside, false);
        }
        let (sender, event) = self.session.hear(at, frame);
        if let Some(event) = event {
            if !ours {
                self.listens(received, at);
            }
            self.identity_event(event);
        }
        let inputs = match sender {
            Sender::Autopilot => {
                self.converse(frame, at);
                true
            }
            // A camera on the vehicle that sees landmarks.
            Sender::SameSystem if from_any_component(frame.message_id()) => true,
            Sender::WrongSystem | Sender::SameSystem => {
                self.stranger(frame);
                false
            }
            _ => false,
        };
        (HeardAs::Listened, inputs)
    }

    /// What was decoded.
    fn take(&mut self, mut inputs: Vec<Input>, at: Stamp<Companion>) {
        if let Some(repair) = self.decoder.take_repair_news() {
            tracing::warn!("{repair}");
        }
        for input in inputs.drain(..) {
            self.input(&input, at);
        }
        self.inputs = inputs;
    }

    fn converse(&mut self, frame: &Frame<'_>, at: Stamp<Companion>) {
        let reply = self.session.converse(frame, at, self.clock.now(), self.decoder.clock());
        if let Some(answer) = reply.answer {
            self.transmitter.answer(&answer);
        }
        if let Some(step) = reply.clock_set {
            tracing::warn!("the autopilot's clock was set by {:.3} s", step.seconds());
        }
    }

    fn identity_event(&mut self, event: IdentityEvent) {
        match event {
            IdentityEvent::Found(vehicle) => {
                self.follow(&vehicle, false);
                let text = format!("following {}, system {}", vehicle.autopilot, vehicle.system.0);
                self.say(Severity::Info, &text);
            }
            IdentityEvent::Replaced { before, by } => {
                // Whatever was heard of the one before is not this one's.
                self.decoder = Decoder::new();
                self.pipeline.begin_anew();
                self.solution = None;
                self.keeping.begin_anew();
                self.follow(&by, true);
                let [old, new] = [before, by].map(|v| format!("{}/{}", v.system.0, v.component.0));
                self.say(Severity::Warning, &format!("following {new}: {old} had no sensors"));
            }
            IdentityEvent::Contradicted(times) => {
                tracing::warn!("heartbeats contradict each other, {times} times: autopilot, type or armed");
            }
            IdentityEvent::Lost { silent } => {
                self.say(Severity::Critical, &format!("autopilot silent for {:.1} s", silent.seconds()));
            }
            IdentityEvent::Back => {
                self.say(Severity::Notice, "the autopilot is back");
                self.session.restart();
            }
            IdentityEvent::NoHeartbeat(span) => {
                let text = format!("no heartbeat for {:.0} s, other messages come", span.seconds());
                self.say(Severity::Warning, &text);
            }
            IdentityEvent::Armed(armed) => tracing::info!("{}", if armed { "armed" } else { "disarmed" }),
            IdentityEvent::Version(version) => tracing::info!("firmware {version}"),
            IdentityEvent::VersionUnknown => tracing::info!("the firmware's version is not told"),
        }
    }

    /// This vehicle is served from now on; `anew` instead of another.
    fn follow(&mut self, vehicle: &Vehicle, anew: bool) {
        self.decoder.follow(vehicle);
        self.pipeline.follow(vehicle);
        let us = self.transmitter.belong_to(vehicle.system);
        self.session.begin(us);
        self.watch.expect(self.clock.now());
        if let Some(told) = self.keeping.found(vehicle) {
            self.say(Severity::Notice, &told);
        }
        self.recording.follows(self.clock.now(), vehicle, anew, self.keeping.waiting());
    }

    /// Whether the autopilot is listened to on this frame's link. What comes on others is counted and not used.
    fn listens(&mut self, received: &ReceivedFrame, at: Stamp<Companion>) -> bool {
        let (listened, moved) = self.transmitter.listens(received.link, at);
        if !listened {
            self.counts.duplicates += 1;
        }
        if moved {
            let text = format!("the autopilot is heard on {} now", received.link);
            self.say(Severity::Notice, &text);
            self.session.restart();
            self.lateness.restart();
        }
        listened
    }

    /// Somebody else is heard. A ground station on the same link is as it should be, a second autopilot is worth a word.
    fn stranger(&mut self, frame: &Frame<'_>) {
        let vehicle = HeartbeatFields::read(frame).is_some_and(|h| h.is_autopilot());
        if vehicle && !std::mem::replace(&mut self.stranger_told, true) {
            let (system, component) = (frame.system().0, frame.component().0);
            tracing::warn!(
                "an autopilot of system {system} is heard, too, and ignored (component {component})"
            );
        }
    }

    fn input(&mut self, input: &Input, at: Stamp<Companion>) {
        if let Input::Sample(sample) = input {
            self.counts.heard[sample.kind() as usize] += 1;
        }
        if let Input::Sample(Sample::Gnss(fix)) = input {
            self.receiver_spoke(fix, at);
        }
        if let Some(time) = self.mask.withholds(input) {
            self.pipeline.navigator.mask_gnss(time);
            return;
        }
        match input {
            Input::Sample(Sample::Imu(s)) => {
                let now = self.clock.now();
                if let Some(news) = self.watch.heard(now) {
                    self.imu_news(news);
                }
                self.look_for_lateness(s.time, at, now);
                if self.keeping.waiting().is_some() {
                    self.resume(s.time);
                }
            }
            Input::Origin(_) => self.session.origin_heard(),
            Input::Reference(reference) => self.show_reference(reference, at),
            Input::Clock(ClockEvent::Reboot { .. }) => {
                self.say(Severity::Warning, "the autopilot rebooted");
                self.session.reboot();
                self.lateness.restart();
            }
            Input::Clock(ClockEvent::Gap(span)) => {
                tracing::warn!("the autopilot's stamps have a gap of {:.1} s", span.seconds());
                self.lateness.restart();
            }
            _ => {}
        }
        let mut messages = std::mem::take(&mut self.messages);
        if let Some(solution) = self.pipeline.take(self.decoder.clock(), input, &mut messages) {
            self.solution = Some(solution);
            self.tell_sending();
        }
        for message in messages.drain(..) {
            self.send_position(&message, at);
        }
        self.messages = messages;
        if self.pipeline.navigator.has_events() {
            self.tell_events();
        }
    }

    /// The first IMU sample, of `first`, is about to be taken: a process before may have known more.
    fn resume(&mut self, first: AutopilotTime) {
        let moment = Moment { clock: self.decoder.clock(), unix_us: self.clock.unix_us() };
        if let Some(told) = self.keeping.resume(&mut self.pipeline, &moment, first) {
            self.say(Severity::Notice, &told);
        }
    }

    fn send_position(&mut self, message: &OutboundMessage, at: Stamp<Companion>) {
        let now = self.clock.now();
        // As old as it is for having come late.
        let at = at - self.lateness.excess();
        if now - at > self.stale_after {
            self.counts.late += 1;
            return;
        }
        match encode(message, self.decoder.clock()) {
            Some(encoded) if self.transmitter.answer_since(&encoded, at) => {
                self.counts.sent += 1;
                self.position_left(message.time(), now);
            }
            Some(_) => {}
            None => self.counts.not_finite += 1,
        }
    }

    fn tell_events(&mut self) {
        let events: Vec<_> = self.pipeline.navigator.drain_events().collect();
        for event in events {
            self.mode_news(&event.kind);
            self.say_as(Some(event.kind.code()), severity_of(&event.kind), &event.to_string());
        }
    }

    /// Tells the log, and the pilot as far as there is room.
    fn say(&mut self, severity: Severity, text: &str) {
        self.say_as(None, severity, text);
    }

    fn say_as(&mut self, code: Option<&'static str>, severity: Severity, text: &str) {
        self.show_event(code, severity, text);
        match severity {
            Severity::Critical => tracing::error!("{text}"),
            Severity::Warning => tracing::warn!("{text}"),
            Severity::Notice | Severity::Info => tracing::info!("{text}"),
        }
        for message in self.status_texts.say(self.clock.now(), severity, text) {
            self.transmitter.answer(&message);
        }
    }

    fn tick(&mut self) {
        let now = self.clock.now();
        let (health, code) = self.state();
        if let Some(beat) = self.beat.poll(now, health, code) {
            self.transmitter.broadcast(&beat);
        }
        self.follow_standing(now);
        let outage = matches!(self.pipeline.navigator.mode(), Mode::Holdover | Mode::Rejoining);
        self.transmitter.handles().hold(outage);
        let situation = self.situation();
        let due = self.session.poll(now, &situation);
        for message in &due.messages {
            self.transmitter.answer(message);
        }
        if let Some(event) = due.event {
            self.identity_event(event);
        }
        for refusal in due.refusals {
            tracing::warn!("{refusal}");
        }
        for news in due.hand_over {
            self.tell_hand_over(news);
        }
        if let Some(news) = self.watch.poll(now) {
            self.imu_news(news);
        }
        if let Some(text) = self.signing.poll(now, &self.transmitter.handles().signing()) {
            self.say(Severity::Warning, &text);
        }
        self.recording.sent(now, &mut self.transmitter);
        if let Some(news) = self.recording.poll(now) {
            let severity = if news.is_bad() { Severity::Warning } else { Severity::Info };
            self.say(severity, &news.to_string());
        }
        self.show(now);
        let moment = Moment { clock: self.decoder.clock(), unix_us: self.clock.unix_us() };
        self.keeping.keep(now, &self.pipeline, self.session.vehicle(), &moment);
        if self.summed.is_none_or(|(then, _)| now - then >= SUMMARY_PERIOD) {
            let summary = self.summary(now);
            tracing::info!("{summary}");
            self.summed = Some((now, self.counts.heard));
        }
    }

    fn link_event(&mut self, event: &LinkEvent) {
        let (link, kind) = (event.link, &event.kind);
        let told = self.retry_told.get_mut(link.0);
        if let LinkEventKind::PeerPinned { shown: Some(shown), .. } = kind
            && link.0 < self.sensors_from
        {
            self.session.heard_before(event.at, shown);
        }
        match kind {
            LinkEventKind::Up { .. }
            | LinkEventKind::PeerPinned { .. }
            | LinkEventKind::PeerFollowed { .. }
            | LinkEventKind::PeerReplaced { .. } => {
                if matches!(kind, LinkEventKind::PeerReplaced { .. }) {
                    tracing::warn!("{link}: {kind}");
                } else {
                    tracing::info!("{link}: {kind}");
                }
                if let Some(told) = told {
                    *told = false;
                }
                if self.transmitter.route().link() == Some(link) {
                    self.say(Severity::Notice, "the link is up again");
                    self.session.restart();
                    self.lateness.restart();
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
}
