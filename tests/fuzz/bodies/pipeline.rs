//! The whole way from bytes to what the autopilot is told, in the middle of a flight.
//!
//! An autopilot's double has flown with GNSS, lost it, and got it back. From one of these moments its frames go on, and the bytes say what
//! happens to them on the way: six bytes a disturbance, of which the first says after how many frames, the second what, the others where and how.

use std::sync::OnceLock;

use holdover::config::{Settings, Sources};
use holdover::double::{AutopilotDouble, DoubleSettings};
use holdover::navigator::solution::{Mode, Solution};
use holdover::outbound::message::OutboundMessage;
use holdover::pipeline::Pipeline;
use holdover::sample::{Input, Sample};
use holdover::sim::autopilot::script::{FlightScript, ScriptLeg};
use holdover::sim::models::OutageKind;
use holdover::time::{AutopilotTime, Stamp};
use holdover::wire::decode::Decoder;
use holdover::wire::encode::encode;
use holdover::wire::frame_bytes::FrameBytes;
use holdover::wire::session::identity::{AutopilotKind, Identity, IdentityConfig};

use super::decode::put_right;

#[path = "../../support/sound.rs"]
mod sound;

/// Bytes of a disturbance.
const DISTURBANCE: usize = 6;
/// Frames after the last of them.
const AFTERWARDS: usize = 40;
/// No run has more.
const MOST_FRAMES: usize = 3000;
/// A pose is of an IMU sample, of which the newest may be so much ahead: a hole that is bridged, and a sample that waits for its order.
const FRESH_S: f64 = 1.0;

/// A moment of the flight.
struct Moment {
    run: Run,
    /// The number of the frame that comes next.
    next: usize,
}

struct Flight {
    frames: Vec<FrameBytes>,
    moments: Vec<Moment>,
}

/// Where frames go.
#[derive(Clone)]
struct Run {
    decoder: Decoder,
    pipeline: Pipeline,
    newest_imu: Option<AutopilotTime>,
    sent: u64,
}

impl Run {
    /// A frame arrives; everything that comes of it is as it has to be.
    fn take(&mut self, bytes: &[u8]) {
        let Some(bytes) = FrameBytes::new(bytes) else { return };
        let Some(frame) = bytes.frame().filter(|f| f.checksum_fits()) else { return };
        let (mut inputs, mut messages) = (Vec::new(), Vec::new());
        self.decoder.decode(&frame, None, &mut inputs);
        for input in &inputs {
            let solution = self.pipeline.take(self.decoder.clock(), input, &mut messages);
            match input {
                Input::Sample(Sample::Imu(s)) => {
                    self.newest_imu = Some(self.newest_imu.map_or(s.time, |t| t.max(s.time)))
                }
                Input::Clock(_) => self.newest_imu = None,
                _ => assert!(messages.is_empty() && solution.is_none(), "a pose of no IMU sample"),
            }
            if let Some(solution) = solution {
                self.check(&solution);
            }
            for message in messages.drain(..) {
                self.sent += 1;
                self.check_sent(&message);
            }
        }
        drop(self.pipeline.navigator.drain_events());
    }

    fn check(&self, solution: &Solution) {
        sound::check_form(solution, "fuzzed");
        // The less it knows, the less it claims to.
        let quality = self.pipeline.outbound.quality(solution);
        let mut worse = *solution;
        worse.position_covariance = worse.position_covariance * 4.0;
        assert!(self.pipeline.outbound.quality(&worse) <= quality);
        assert_eq!(
            quality == -1,
            solution.mode == Mode::Lost || solution.attitude_variance.xy().max() > 0.16
        );
    }

    fn check_sent(&self, message: &OutboundMessage) {
        if let Some(newest) = self.newest_imu {
            let age_s = newest.seconds_since(message.time());
            assert!((0.0..FRESH_S).contains(&age_s), "a pose {age_s} s old");
        }
        assert!(encode(message, self.decoder.clock()).is_some(), "what is sent is finite: {message:?}");
    }
}

fn flight() -> &'static Flight {
    static FLIGHT: OnceLock<Flight> = OnceLock::new();
    FLIGHT.get_or_init(|| Flight::fly().expect("the flight has a vehicle"))
}

impl Flight {
    /// Flies, and keeps the moments at 45 s with GNSS, at 70 s without and at 95 s with it again.
    fn fly() -> Option<Self> {
        let to = |north_m, east_m| ScriptLeg::FlyTo { north_m, east_m, heading_rad: 0.6 };
        let mut legs = vec![ScriptLeg::Wait(15.0), ScriptLeg::Arm, ScriptLeg::TakeOff(10.0)];
        legs.extend([
            to(12.0, 0.0),
            to(12.0, 12.0),
            to(0.0, 12.0),
            to(0.0, 0.0),
            to(12.0, 0.0),
            to(0.0, 0.0),
        ]);
        legs.push(ScriptLeg::Wait(100.0));
        let mut double = AutopilotDouble::new(DoubleSettings::documented(
            AutopilotKind::ArduPilot,
            FlightScript::new(legs),
        ));
        let sources = Sources { overrides: vec!["outbound.publish=always".into()], ..Sources::default() };
        let settings = Settings::load(&sources).ok()?;
        let mut run = Run {
            decoder: Decoder::new(),
            pipeline: Pipeline::new(&settings.pipeline),
            newest_imu: None,
            sent: 0,
        };
        let mut identity = Identity::new(IdentityConfig::default());
        let (mut frames, mut moments, mut out) = (Vec::new(), Vec::new(), Vec::new());
        let mut due = [45.0, 70.0, 95.0].into_iter().peekable();
        while double.vehicle().now_s() < 115.0 {
            let now_s = double.vehicle().now_s();
            let lost = (60.0..85.0).contains(&now_s);
            if lost != double.vehicle().gnss_is_lost() {
                double.vehicle_mut().lose_gnss(lost.then_some(OutageKind::NoFix));
            }
            double.step(&mut out);
            if due.next_if(|due| now_s >= *due).is_some() {
                moments.push(Moment { run: run.clone(), next: frames.len() });
            }
            for (_, bytes) in out.drain(..) {
                if identity.vehicle().is_none()
                    && let Some(frame) = bytes.frame()
                {
                    identity.hear(Stamp::from_micros((now_s * 1e6) as i64), &frame);
                    if let Some(vehicle) = identity.vehicle() {
                        run.decoder.follow(vehicle);
                        run.pipeline.follow(vehicle);
                    }
                }
                run.take(&bytes);
                frames.push(bytes);
            }
        }
        assert!(run.sent > 300, "nothing was sent: {}", run.sent);
        Some(Self { frames, moments })
    }
}

/// Disturbs the flight; how many frames were taken.
pub fn pipeline(input: &[u8]) -> u64 {
    let Some((&which, script)) = input.split_first() else { return 1 };
    let flight = flight();
    let moment = &flight.moments[usize::from(which) % flight.moments.len()];
    let mut run = moment.run.clone();
    let mut coming = flight.frames[moment.next..].iter().take(MOST_FRAMES);
    let mut held: Vec<Vec<u8>> = Vec::new();
    let mut taken = 0;
    for disturbance in script.chunks_exact(DISTURBANCE) {
        for frame in coming.by_ref().take(usize::from(disturbance[0])) {
            run.take(frame);
            taken += 1;
        }
        let Some(frame) = coming.next() else { break };
        taken += disturb(&mut run, frame, disturbance, &mut held);
    }
    for frame in held {
        run.take(&frame);
    }
    for frame in coming.take(AFTERWARDS) {
        run.take(frame);
        taken += 1;
    }
    taken
}

/// One frame, as it arrives in the end.
fn disturb(run: &mut Run, frame: &FrameBytes, how: &[u8], held: &mut Vec<Vec<u8>>) -> u64 {
    let mut bytes = frame.to_vec();
    let payload = usize::from(bytes[1]);
    let header = if bytes[0] == 0xFE { 6 } else { 10 };
    let at = header + usize::from(how[2]) % payload.max(1);
    match how[1] % 10 {
        // Lost; late; twice; what was late comes now.
        0 => return 1,
        1 => held.push(bytes.clone()),
        2 => run.take(&bytes),
        3 => held.drain(..).for_each(|late| run.take(&late)),
        // A byte, a bit, a field of four bytes; no number; the largest.
        4 => bytes[at] = how[3],
        5 => bytes[at] ^= 1 << (how[3] % 8),
        6 => write(&mut bytes, at, header + payload, &[how[3], how[4], how[5], how[2]]),
        7 => write(&mut bytes, at / 4 * 4 + header % 4, header + payload, &f32::NAN.to_le_bytes()),
        8 => write(&mut bytes, at, header + payload, &[0xFF; 8]),
        // A field becomes another number of its own kind.
        _ => {
            let field = header + usize::from(how[2] % 64) * 4;
            if let Some(old) = bytes.get(field..field + 4).and_then(|b| <[u8; 4]>::try_from(b).ok()) {
                let factor = f32::from(how[3] as i8) * 10f32.powi(i32::from(how[4] as i8 % 8));
                write(&mut bytes, field, header + payload, &(f32::from_le_bytes(old) * factor).to_le_bytes());
            }
        }
    }
    put_right(&mut bytes);
    if how[1] % 10 != 1 {
        run.take(&bytes);
    }
    1
}

/// Writes as much as the payload has room for.
fn write(bytes: &mut [u8], at: usize, end: usize, value: &[u8]) {
    let to = end.min(at + value.len());
    if let Some(field) = bytes.get_mut(at..to) {
        field.copy_from_slice(&value[..to - at]);
    }
}
