//! A day's flight of a simulated ArduPilot vehicle, as bytes of its telemetry, through everything that the daemon does with them but the
//! sockets: frames are found, the vehicle is chosen and conversed with, messages are decoded, navigated on and answered. Its clock since boot
//! passes 2³² ms on the way, after which every stamp of milliseconds begins anew.

use std::collections::BTreeMap;

use holdover::config::{Settings, Sources};
use holdover::navigator::solution::{Mode, Solution};
use holdover::navigator::sources::status::SourceReport;
use holdover::outbound::message::OutboundMessage;
use holdover::pipeline::{GnssMask, Pipeline};
use holdover::sample::{FlowRotation, FlowSample, Input, Sample};
use holdover::sim::models::{AirspeedModel, ImuModel};
use holdover::sim::{Scenario, SensorSuite, Simulation};
use holdover::time::{AutopilotTime, Companion, Span, Stamp};
use holdover::wire::counters::Counters;
use holdover::wire::decode::Decoder;
use holdover::wire::encode::encode;
use holdover::wire::encode_vehicle;
use holdover::wire::frame::{ComponentId, Frame, SystemId};
use holdover::wire::link::{Deframer, Found};
use holdover::wire::messages::Message;
use holdover::wire::session::Address;
use holdover::wire::session::autopilot::AutopilotSession;
use holdover::wire::session::hand_over::Situation;
use holdover::wire::session::identity::{AutopilotKind, IdentityEvent, Sender};
use holdover::wire::session::outgoing::FrameWriter;
use mavlink::dialects::ardupilotmega as apm;

#[path = "sound.rs"]
mod sound;

/// The milliseconds of 32 bits begin anew after so many, s.
pub const WRAP_S: f64 = 4_294_967.296;
/// The simulation's clock since boot when its flight begins, s.
const SIMULATED_BOOT_S: f64 = 10.0;
const VEHICLE: Address = Address { system: SystemId(1), component: ComponentId::AUTOPILOT };
const US: Address = Address { system: SystemId(1), component: ComponentId(197) };
/// 2026-01-01, µs since 1970: the date for which the simulated magnetic field holds.
const UNIX_US: u64 = 1_767_225_600_000_000;
/// From the sending of a message to its arrival.
const ON_THE_WAY: Span = Span::from_millis(2);
/// Steps of the IMU between two heartbeats, and between two looks at the timers.
const BEAT_EVERY: u64 = 100;
const TICK_EVERY: u64 = 5;

/// How long, from when on, and without GNSS when.
#[derive(Clone, Copy, Debug)]
pub struct LongFlightPlan {
    pub duration_s: f64,
    /// The autopilot's clock since boot when the flight begins, s.
    pub boot_s: f64,
    /// GNSS is withheld this often, for so long, s.
    pub outage_every_s: f64,
    pub outage_s: f64,
    pub seed: u64,
}

/// The autopilot's end: what it sends, one step of its IMU after the other.
struct Vehicle {
    simulation: Simulation,
    /// The autopilot's clock less the simulation's.
    ahead: Span,
    writer: FrameWriter,
    steps: u64,
    messages: Vec<Message>,
    /// Answers to questions of the other end, which go out with the next step.
    answers: Vec<Message>,
}

impl Vehicle {
    fn new(plan: &LongFlightPlan) -> Self {
        let scenario = Scenario::circles().lasting(plan.duration_s);
        let airspeed = Some(AirspeedModel::pitot());
        let suite = SensorSuite { airspeed, ..SensorSuite::of(&scenario, ImuModel::mems()) };
        Self {
            simulation: Simulation::new(scenario, suite, plan.seed),
            ahead: Span::from_seconds(plan.boot_s - SIMULATED_BOOT_S),
            writer: FrameWriter::new(VEHICLE),
            steps: 0,
            messages: Vec::with_capacity(16),
            answers: Vec::with_capacity(4),
        }
    }

    /// Appends the bytes of one step to `bytes`. The time of the flight, s, and the autopilot's; `None` when it is over.
    fn step(&mut self, bytes: &mut Vec<u8>) -> Option<(f64, AutopilotTime)> {
        let reading = self.simulation.next()?;
        let now = reading.time + self.ahead;
        self.steps += 1;
        for sample in reading.samples.iter() {
            let sample = later(*sample, self.ahead);
            encode_vehicle::samples([&sample], &mut self.messages);
            // A camera's flow, and the same as ArduPilot's own sensor tells it.
            if let Sample::Flow(flow) = sample {
                self.messages.extend(optical_flow(&flow));
            }
        }
        if self.steps.is_multiple_of(BEAT_EVERY) {
            let status = self.simulation.scenario().status(reading.t_s);
            let unix_us = UNIX_US + (reading.t_s * 1e6) as u64;
            self.messages.push(encode_vehicle::heartbeat(AutopilotKind::ArduPilot, &status));
            self.messages.push(encode_vehicle::sensors_present(true));
            self.messages.extend(encode_vehicle::system_time(now, unix_us));
            self.messages.extend(encode_vehicle::origin(now, &self.simulation.scenario().origin));
        }
        self.messages.append(&mut self.answers);
        for message in self.messages.drain(..) {
            bytes.extend(self.writer.write(&message).iter().flat_map(|frame| frame.iter()));
        }
        Some((reading.t_s, now))
    }

    /// Takes what was sent to it.
    fn hear(&mut self, message: &Message, now: AutopilotTime) {
        if let Message::TIMESYNC(question) = message
            && question.tc1 == 0
        {
            let tc1 = now.micros().saturating_mul(1000);
            self.answers.push(Message::TIMESYNC(apm::TIMESYNC_DATA {
                tc1,
                ts1: question.ts1,
                target_system: US.system.0,
                target_component: US.component.0,
            }));
        }
    }
}

/// A sample as it is told by a clock that is `by` ahead.
fn later(mut sample: Sample, by: Span) -> Sample {
    match &mut sample {
        Sample::Imu(s) => s.time = s.time + by,
        Sample::Mag(s) => s.time = s.time + by,
        Sample::Gnss(s) => s.time = s.time + by,
        Sample::Pressure(s) => s.time = s.time + by,
        Sample::Flow(s) => s.time = s.time + by,
        Sample::Range(s) => s.time = s.time + by,
        Sample::Airspeed(s) => s.time = s.time + by,
        Sample::Landmark(s) => s.time = s.time + by,
    }
    sample
}

/// ArduPilot's OPTICAL_FLOW, whose `time_usec` holds 32 bits of milliseconds.
fn optical_flow(flow: &FlowSample) -> Option<Message> {
    let gyro = match flow.rotation {
        FlowRotation::SensorGyro(gyro) => gyro,
        _ => return None,
    };
    let [x, y] = flow.rate_xy;
    Some(Message::OPTICAL_FLOW(apm::OPTICAL_FLOW_DATA {
        time_usec: u64::from((u64::try_from(flow.time.micros()).ok()? / 1000) as u32),
        flow_comp_m_x: (x - gyro[0]) as f32,
        flow_comp_m_y: (y - gyro[1]) as f32,
        ground_distance: -1.0,
        flow_x: 0,
        flow_y: 0,
        sensor_id: flow.sensor + 1,
        quality: 200,
        flow_rate_x: x as f32,
        flow_rate_y: y as f32,
    }))
}

/// What came of it so far.
#[derive(Clone, Debug, Default)]
pub struct LongFlightCounts {
    pub frames: u64,
    pub bytes: u64,
    /// Samples decoded, by kind.
    pub samples: BTreeMap<&'static str, u64>,
    pub sent: u64,
    pub not_sent: u64,
    /// Bytes that are no frame, in frames' places.
    pub no_frame: u64,
    /// Solutions that hold a number that is none, or a covariance that is none.
    pub unsound: u64,
    /// The largest horizontal uncertainty, m.
    pub most_sigma_m: f64,
    /// Modes, and since when, s.
    pub modes: Vec<(f64, Mode)>,
    /// What the conversation has told, but for the beginning.
    pub told: Vec<(f64, String)>,
    /// Solutions that are older than the one before, or than the newest IMU sample by more than a second.
    pub backwards: u64,
}

/// Both ends.
pub struct LongFlight {
    vehicle: Vehicle,
    deframer: Deframer,
    session: AutopilotSession,
    decoder: Decoder,
    pipeline: Pipeline,
    mask: GnssMask,
    pub counts: LongFlightCounts,
    pub solution: Option<Solution>,
    boot_s: f64,
    newest_imu: Option<AutopilotTime>,
    bytes: Vec<u8>,
    inputs: Vec<Input>,
    messages: Vec<OutboundMessage>,
}

impl LongFlight {
    pub fn new(plan: &LongFlightPlan) -> Option<Self> {
        let sources = Sources { overrides: vec!["outbound.publish=always".into()], ..Sources::default() };
        let settings = Settings::load(&sources).ok()?;
        let outages: Vec<(f64, f64)> = (1..)
            .map(|k| f64::from(k) * plan.outage_every_s)
            .take_while(|from_s| from_s + plan.outage_s < plan.duration_s)
            .map(|from_s| (from_s, from_s + plan.outage_s))
            .collect();
        Some(Self {
            vehicle: Vehicle::new(plan),
            deframer: Deframer::new(),
            session: AutopilotSession::new(settings.identity(), settings.streams, settings.source_switch),
            decoder: Decoder::new(),
            pipeline: Pipeline::new(&settings.pipeline),
            mask: GnssMask::new(&outages),
            counts: LongFlightCounts::default(),
            solution: None,
            boot_s: plan.boot_s,
            newest_imu: None,
            bytes: Vec::with_capacity(4096),
            inputs: Vec::with_capacity(16),
            messages: Vec::with_capacity(4),
        })
    }

    /// Flies one step of the IMU; the time of the flight, s.
    pub fn step(&mut self) -> Option<f64> {
        let mut bytes = std::mem::take(&mut self.bytes);
        let (t_s, now) = self.vehicle.step(&mut bytes)?;
        // The companion was switched on with the flight, and its clock is as good.
        let at = Stamp::from_micros((t_s * 1e6) as i64) + ON_THE_WAY;
        self.read(&bytes, t_s, at);
        bytes.clear();
        self.bytes = bytes;
        if self.vehicle.steps.is_multiple_of(TICK_EVERY) {
            self.tick(t_s, now, at);
        }
        Some(t_s)
    }

    fn tick(&mut self, t_s: f64, now: AutopilotTime, at: Stamp<Companion>) {
        let due = self
            .session
            .poll(at, &Situation { mode: self.pipeline.navigator.mode(), ..Situation::LISTENING });
        for message in &due.messages {
            self.vehicle.hear(message, now);
        }
        if let Some(event) = due.event {
            self.note_told(t_s, event);
        }
    }

    /// What came over the wire.
    fn read(&mut self, mut bytes: &[u8], t_s: f64, at: Stamp<Companion>) {
        self.counts.bytes += bytes.len() as u64;
        let mut deframer = std::mem::take(&mut self.deframer);
        while !bytes.is_empty() {
            let space = deframer.space();
            let n = bytes.len().min(space.len());
            space[..n].copy_from_slice(&bytes[..n]);
            bytes = &bytes[n..];
            deframer.advance(n, |found| match found {
                Found::Frame(frame) => self.frame(&frame, t_s, at),
                _ => self.counts.no_frame += 1,
            });
        }
        self.deframer = deframer;
    }

    fn frame(&mut self, frame: &Frame<'_>, t_s: f64, at: Stamp<Companion>) {
        self.counts.frames += 1;
        let (sender, event) = self.session.hear(at, frame);
        if let Some(event) = event {
            self.note_told(t_s, event);
        }
        if sender != Sender::Autopilot {
            return;
        }
        let reply = self.session.converse(frame, at, at, self.decoder.clock());
        if let Some(step) = reply.clock_set {
            self.counts.told.push((t_s, format!("the clock was set by {} s", step.seconds())));
        }
        let mut inputs = std::mem::take(&mut self.inputs);
        self.decoder.decode(frame, Some(at), &mut inputs);
        self.session.stamped(self.decoder.clock().newest(), at);
        for input in inputs.drain(..) {
            self.input(&input, t_s);
        }
        self.inputs = inputs;
    }

    fn note_told(&mut self, t_s: f64, event: IdentityEvent) {
        if let IdentityEvent::Found(vehicle) = event {
            self.decoder.follow(&vehicle);
            self.pipeline.follow(&vehicle);
            self.session.begin(US);
        }
        // Armed as it flies; the version is not told, and that is told.
        if !matches!(event, IdentityEvent::Armed(_) | IdentityEvent::VersionUnknown) {
            self.counts.told.push((t_s, format!("{event:?}")));
        }
    }

    fn input(&mut self, input: &Input, t_s: f64) {
        if let Input::Sample(sample) = input {
            *self.counts.samples.entry(sample.kind().label()).or_default() += 1;
        }
        if let Input::Clock(event) = input {
            self.counts.told.push((t_s, format!("{event:?}")));
        }
        if let Some(time) = self.mask.withholds(input) {
            return self.pipeline.navigator.mask_gnss(time);
        }
        if let Input::Sample(Sample::Imu(imu)) = input {
            self.newest_imu = Some(imu.time);
        }
        let solution = self.pipeline.take(self.decoder.clock(), input, &mut self.messages);
        if let Some(solution) = solution {
            self.solved(&solution, t_s);
        }
        for message in self.messages.drain(..) {
            let boot_s = self.decoder.clock().boot_micros(message.time()) as f64 * 1e-6;
            // What is told the autopilot is stamped by its own clock, and of now.
            let stamped = (boot_s - self.boot_s - t_s).abs() < 1.0;
            let encoded = encode(&message, self.decoder.clock()).is_some();
            self.counts.sent += u64::from(encoded && stamped);
            self.counts.not_sent += u64::from(!encoded || !stamped);
        }
        drop(self.pipeline.navigator.drain_events());
    }

    fn solved(&mut self, solution: &Solution, t_s: f64) {
        let covariances = [solution.position_covariance.raw(), solution.velocity_covariance.raw()];
        let sound = sound::is_finite(solution) && covariances.iter().all(sound::is_covariance);
        self.counts.unsound += u64::from(!sound);
        if self.counts.modes.last().is_none_or(|(_, mode)| *mode != solution.mode) {
            self.counts.modes.push((t_s, solution.mode));
        }
        if solution.mode != Mode::Aligning {
            self.counts.most_sigma_m = self.counts.most_sigma_m.max(solution.horizontal_sigma_m());
        }
        let late = self.newest_imu.is_some_and(|newest| newest.seconds_since(solution.time) > 1.0);
        self.counts.backwards += u64::from(late || self.solution.is_some_and(|s| solution.time < s.time));
        self.solution = Some(*solution);
    }

    /// What was refused on the way, by cause.
    pub fn refused(&self) -> &Counters {
        self.decoder.counters()
    }

    /// Every source, as it fares.
    pub fn sources(&self) -> Vec<SourceReport> {
        self.pipeline.navigator.source_reports()
    }

    /// The autopilot's clock less ours, and the shortest round trip.
    pub fn timesync(&self) -> Option<(Span, Span)> {
        self.session.timesync()
    }

    /// How far the solution is from the truth, horizontally, m.
    pub fn error_m(&self) -> Option<f64> {
        let solution = self.solution?;
        let t_s = Simulation::seconds(solution.time - self.vehicle.ahead);
        let truth = self.vehicle.simulation.truth(t_s);
        let place = self.pipeline.navigator.frame()?.to_geodetic(&solution.position.raw());
        let here = self.vehicle.simulation.frame().to_ned(&place);
        Some((here - truth.position_ned).xy().norm())
    }
}
