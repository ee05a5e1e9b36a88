//! ArduPilot's DataFlash: the framing in `reader`, and here what the messages become.

mod aiding;
mod inertial;
mod position;
mod reader;
mod shaking;
mod status;

use std::io::{self, Read};

use crate::sample::VehicleStatus;
use crate::time::AutopilotTime;
use crate::wire::counters::Cause;
use crate::wire::frame::{ComponentId, SystemId};
use crate::wire::session::identity::{AutopilotKind, Vehicle};

use super::fast_samples::FastSensors;
use super::format::DATAFLASH_FMT;
use super::intake::Intake;
use super::parameters::Parameters;
use super::rotors::RotorSpeeds;
use super::row::{Columns, LogRow};
use super::waiting::{WaitingMessage, WaitingMessages, may_wait};
use super::{Entry, Listener, LogSummary};

use inertial::Batches;
use position::OwnEstimate;
use reader::{DataFlashReader, Described, described, text};
use shaking::OpenBatch;
use status::firmware;

/// Messages among which the vehicle introduces itself: descriptions and parameters come first.
const INTRODUCTION: u64 = 20_000;

/// What a message becomes, from the fields that it needs; those of every version that has other ones. ArduPilot to 4.0 had a name for
/// each of several sensors.
struct MessageMeaning {
    names: &'static [&'static str],
    fields: &'static [&'static str],
    decode: fn(&mut ArduPilot, &Told<'_>) -> Result<(), Cause>,
}

/// One message.
#[derive(Clone, Copy)]
struct Told<'a> {
    /// Its stamp, and the same on the autopilot's clock.
    us: u64,
    time: AutopilotTime,
    /// Which of several of the kind.
    instance: u8,
    row: LogRow<'a>,
}

impl Told<'_> {
    /// When it was measured, where the message tells that in milliseconds.
    fn measured(&self, millis: &str) -> AutopilotTime {
        Intake::measured(self.time, self.us, self.row.micros(millis).filter(|s| *s > 0).map(|s| s * 1000))
    }
}

/// What is known of the vehicle so far.
#[derive(Default)]
struct ArduPilot {
    intake: Intake,
    batches: Batches,
    estimate: OwnEstimate,
    parameters: Parameters,
    rotors: RotorSpeeds,
    fast: FastSensors,
    batch: Option<OpenBatch>,
    waiting: WaitingMessages,
}

fn meaning(name: &str) -> Option<(&'static MessageMeaning, u8)> {
    let all = [status::MEANINGS, inertial::MEANINGS, position::MEANINGS, aiding::MEANINGS, shaking::MEANINGS];
    all.into_iter().flatten().find_map(|m| {
        let instance = m.names.iter().position(|n| *n == name)?;
        Some((m, instance as u8))
    })
}

/// A parameter's name and value: 16 bytes of text, then a float, wherever the version at hand has them.
fn parameter<'a>(payload: &'a [u8], described: &Described) -> Option<(&'a str, f64)> {
    let value = described.slot("Value")?;
    let name = payload.get(value.at.checked_sub(16)?..value.at)?;
    let value = payload.get(value.at..)?.first_chunk()?;
    Some((text(name), f64::from(f32::from_le_bytes(*value))))
}

/// The text of MSG: 64 bytes at its end.
fn message(payload: &[u8]) -> Option<&str> {
    Some(text(payload.get(payload.len().checked_sub(64)?..)?))
}

/// A type of message that the log describes.
struct Kind {
    described: Described,
    instance: u8,
    meaning: Option<(&'static MessageMeaning, Columns)>,
    /// It tells of the vehicle itself.
    state: bool,
}

impl Kind {
    fn of(described: Described) -> Self {
        let meaning = meaning(&described.name);
        Self {
            instance: meaning.map_or(0, |(_, instance)| instance),
            state: status::MEANINGS.iter().any(|m| m.names.contains(&described.name.as_str())),
            meaning: meaning.map(|(m, _)| (m, Columns::of(m.fields, |label| described.slot(label)))),
            described,
        }
    }
}

/// The descriptions of a log, by type.
struct Kinds(Vec<Option<Kind>>);

impl Kinds {
    fn new() -> Self {
        Self((0..256).map(|_| None).collect())
    }

    fn get(&self, kind: u8) -> Option<&Kind> {
        self.0[usize::from(kind)].as_ref()
    }

    /// Takes a FMT message.
    fn describe<R: Read>(&mut self, payload: &[u8], reader: &mut DataFlashReader<R>) -> Result<(), Cause> {
        let (kind, described) = described(payload).ok_or(Cause::BadPayload)?;
        reader.expect(kind, &described);
        self.0[usize::from(kind)] = Some(Kind::of(described));
        Ok(())
    }
}

/// The vehicle that wrote a log; `None` if there is nothing but descriptions in it.
pub(super) fn vehicle(bytes: impl Read) -> io::Result<Option<Vehicle>> {
    let mut reader = DataFlashReader::new(bytes);
    let mut kinds = Kinds::new();
    let mut vehicle = Vehicle {
        system: SystemId(1),
        component: ComponentId::AUTOPILOT,
        autopilot: AutopilotKind::ArduPilot,
        vehicle_type: 0,
        armed: false,
        version: None,
    };
    let mut read = 0;
    while read < INTRODUCTION
        && let Some((kind, payload)) = reader.next_message()?
    {
        if kind == DATAFLASH_FMT {
            // The reader keeps what it gave until it is asked again.
            let payload = payload.to_vec();
            let _ = kinds.describe(&payload, &mut reader);
            continue;
        }
        let Some(kind) = kinds.get(kind) else { continue };
        read += 1;
        match kind.described.name.as_str() {
            "PARM" => {
                if let Some(("SYSID_THISMAV" | "MAV_SYSID", id)) = parameter(payload, &kind.described) {
                    vehicle.system = SystemId(id as u8);
                }
            }
            "MSG" => {
                if let Some((_, vehicle_type, version)) = message(payload).and_then(firmware) {
                    (vehicle.vehicle_type, vehicle.version) = (vehicle_type, version);
                    break;
                }
            }
            _ => {}
        }
    }
    Ok((read > 0).then_some(vehicle))
}

/// Reads a log to its end.
pub(super) fn play(bytes: impl Read, vehicle: &Vehicle, to: &mut Listener<'_>) -> io::Result<LogSummary> {
    let mut reader = DataFlashReader::new(bytes);
    let mut kinds = Kinds::new();
    let mut ardupilot = ArduPilot::default();
    let system = vehicle.system.0;
    let mut frames = 0;
    while let Some((id, payload)) = reader.next_message()? {
        frames += 1;
        if id == DATAFLASH_FMT {
            let payload = payload.to_vec();
            if let Err(cause) = kinds.describe(&payload, &mut reader) {
                ardupilot.intake.counters.count(cause);
            }
            continue;
        }
        let Some(kind) = kinds.get(id) else { continue };
        let name = Some(kind.described.name.as_str());
        let component = kind.meaning.as_ref().map_or(0, |(_, columns)| instance(kind, columns.row(payload)));
        (to.entry)(&Entry { name, id: u32::from(id), system, component });
        ardupilot.take(&kinds, id, payload);
        ardupilot.pass_on(to);
    }
    ardupilot.release(&kinds, false);
    ardupilot.flush();
    ardupilot.pass_on(to);
    let mut counters = ardupilot.intake.counters.clone();
    counters.add(Cause::Garbage, reader.garbage);
    Ok(LogSummary {
        frames,
        truncated: reader.truncated,
        reboots: ardupilot.intake.clock.reboots(),
        counters,
        parameters: ardupilot.parameters,
        rotors: ardupilot.rotors,
        fast: ardupilot.fast,
        ..LogSummary::default()
    })
}

/// Which of several sensors, or cores of the estimator, a message is of.
fn instance(kind: &Kind, row: LogRow<'_>) -> u8 {
    row.byte("I").or(row.byte("Instance")).or(row.byte("C")).unwrap_or(kind.instance)
}

/// A message's own stamp, µs since boot. GPS before 2014 had the time of week in TimeMS, and its own time in T.
fn stamp(row: LogRow<'_>) -> Option<u64> {
    let millis = || row.micros("T").or(row.micros("TimeMS")).map(|ms| ms * 1000);
    row.micros("TimeUS").or_else(millis)
}

impl ArduPilot {
    /// One message: read at once where its stamp can be believed, else when it is known whether the clock has jumped there.
    fn take(&mut self, kinds: &Kinds, id: u8, payload: &[u8]) {
        let Some(kind) = kinds.get(id) else { return };
        let Some((_, columns)) = &kind.meaning else { return self.texts(&kind.described, payload) };
        let us = stamp(columns.row(payload));
        let cause = match us.map(|us| self.intake.time(us)) {
            Some(Ok(time)) => {
                let jumped = self.intake.take_jumped();
                self.release(kinds, jumped);
                return self.read(kind, payload, us, time);
            }
            Some(Err(cause)) if may_wait(cause) || kind.state => cause,
            Some(Err(cause)) => return self.intake.counters.count(cause),
            None if !kind.state => return self.intake.counters.count(Cause::BadPayload),
            // It is of the time of what stands before it. Only who is armed goes on with the log, and that may have paused here.
            None if self.waiting.is_empty() && !status::arms(columns.row(payload)) => {
                return self.read(kind, payload, us, self.intake.now());
            }
            None => Cause::BadPayload,
        };
        let message = WaitingMessage { id: u16::from(id), us, cause, payload: payload.to_vec() };
        if let Some(oldest) = self.waiting.hold(message) {
            self.read_late(kinds, &oldest, false);
        }
    }

    /// What has waited is read, now that the clock has jumped, or has not.
    fn release(&mut self, kinds: &Kinds, jumped: bool) {
        while let Some(message) = self.waiting.next() {
            self.read_late(kinds, &message, jumped);
        }
    }

    fn read_late(&mut self, kinds: &Kinds, message: &WaitingMessage, jumped: bool) {
        let Some(kind) = u8::try_from(message.id).ok().and_then(|id| kinds.get(id)) else { return };
        match self.intake.waited(message, jumped, kind.state) {
            Ok(time) => self.read(kind, &message.payload, message.us, time),
            Err(cause) => self.intake.counters.count(cause),
        }
    }

    /// A message whose time is known.
    fn read(&mut self, kind: &Kind, payload: &[u8], us: Option<u64>, time: AutopilotTime) {
        let Some((meaning, columns)) = &kind.meaning else { return };
        let row = columns.row(payload);
        if let Some(us) = us {
            self.flush_before(us);
        }
        let told = Told { us: us.unwrap_or_default(), time, instance: instance(kind, row), row };
        if let Err(cause) = (meaning.decode)(self, &told) {
            self.intake.counters.count(cause);
        }
    }

    /// Parameters and messages to people.
    fn texts(&mut self, described: &Described, payload: &[u8]) {
        match described.name.as_str() {
            "PARM" => {
                if let Some((name, value)) = parameter(payload, described) {
                    self.parameters.set(name, value);
                }
            }
            "MSG" => {
                if let Some((airframe, _, _)) = message(payload).and_then(firmware) {
                    self.intake
                        .status(VehicleStatus { airframe: Some(airframe), ..VehicleStatus::default() });
                }
            }
            _ => {}
        }
    }

    fn pass_on(&mut self, to: &mut Listener<'_>) {
        for input in self.intake.out.drain(..) {
            (to.item)(&self.intake.clock, &input);
        }
    }
}
