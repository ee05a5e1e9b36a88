//! ArduPilot's DataFlash: the framing in `reader`, and here what the messages become.

mod aiding;
mod inertial;
mod position;
mod reader;
mod shaking;

use std::io::{self, Read};

use crate::sample::{Airframe, VehicleStatus};
use crate::time::AutopilotTime;
use crate::wire::counters::Cause;
use crate::wire::frame::{ComponentId, SystemId};
use crate::wire::session::identity::{AutopilotKind, FirmwareVersion, ReleaseType, Vehicle};

use super::fast_samples::FastSensors;
use super::format::DATAFLASH_FMT;
use super::intake::Intake;
use super::parameters::Parameters;
use super::rotors::RotorSpeeds;
use super::row::{Columns, LogRow};
use super::{Entry, Listener, LogSummary};

use inertial::Batches;
use position::OwnEstimate;
use reader::{DataFlashReader, Described, described, text};
use shaking::OpenBatch;

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
}

/// Whether it is armed, and whether it flies.
const STATUS: &[MessageMeaning] = &[
    MessageMeaning { names: &["ARM"], fields: &["TimeUS", "ArmState"], decode: arm },
    MessageMeaning { names: &["STAT"], fields: &["TimeUS", "Armed", "isFlying"], decode: stat },
    MessageMeaning { names: &["EV"], fields: &["TimeUS", "TimeMS", "Id"], decode: event },
];

fn meaning(name: &str) -> Option<(&'static MessageMeaning, u8)> {
    let all = [STATUS, inertial::MEANINGS, position::MEANINGS, aiding::MEANINGS, shaking::MEANINGS];
    all.into_iter().flatten().find_map(|m| {
        let instance = m.names.iter().position(|n| *n == name)?;
        Some((m, instance as u8))
    })
}

fn armed(vehicle: &mut ArduPilot, armed: bool) -> Result<(), Cause> {
    vehicle.intake.status(VehicleStatus { armed: Some(armed), ..VehicleStatus::default() });
    Ok(())
}

fn landed(vehicle: &mut ArduPilot, landed: bool) -> Result<(), Cause> {
    vehicle.intake.status(VehicleStatus { landed: Some(landed), ..VehicleStatus::default() });
    Ok(())
}

fn arm(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    armed(vehicle, m.row.byte("ArmState").ok_or(Cause::BadPayload)? != 0)
}

fn stat(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    armed(vehicle, m.row.byte("Armed").ok_or(Cause::BadPayload)? != 0)?;
    m.row.byte("isFlying").map_or(Ok(()), |flies| landed(vehicle, flies == 0))
}

/// Events of `AP_Logger.h`: `ARMED`, `DISARMED`, `LAND_COMPLETE`, `NOT_LANDED`.
fn event(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    match m.row.byte("Id") {
        Some(10) => armed(vehicle, true),
        Some(11) => armed(vehicle, false),
        Some(18) => landed(vehicle, true),
        Some(28) => landed(vehicle, false),
        _ => Ok(()),
    }
}

/// What the firmware's name, as MSG and VER hold it, tells.
fn firmware(name: &str) -> Option<(Airframe, u8, Option<FirmwareVersion>)> {
    let (airframe, vehicle_type, rest) = [
        ("ArduCopter", Airframe::Multirotor, 2),
        ("ArduPlane", Airframe::FixedWing, 1),
        ("ArduRover", Airframe::Surface, 10),
        ("APM:Copter", Airframe::Multirotor, 2),
        ("APM:Plane", Airframe::FixedWing, 1),
        ("APM:Rover", Airframe::Surface, 10),
    ]
    .into_iter()
    .find_map(|(prefix, airframe, kind)| Some((airframe, kind, name.strip_prefix(prefix)?)))?;
    Some((airframe, vehicle_type, version(rest)))
}

/// ` V4.5.7 (2a3dc4b7)` or ` V4.7.0-dev (…)`.
fn version(text: &str) -> Option<FirmwareVersion> {
    let word = text.trim_start().strip_prefix('V')?.split_whitespace().next()?;
    let (numbers, release) = word.split_once('-').map_or((word, None), |(n, r)| (n, Some(r)));
    let mut numbers = numbers.split('.').map(|n| n.parse().ok());
    let release = match release {
        None => ReleaseType::Official,
        Some(r) if r.starts_with("beta") => ReleaseType::Beta,
        Some(r) if r.starts_with("rc") => ReleaseType::Candidate,
        Some(_) => ReleaseType::Development,
    };
    Some(FirmwareVersion {
        major: numbers.next()??,
        minor: numbers.next()??,
        patch: numbers.next().flatten().unwrap_or(0),
        release,
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
}

impl Kind {
    fn of(described: Described) -> Self {
        let meaning = meaning(&described.name);
        Self {
            instance: meaning.map_or(0, |(_, instance)| instance),
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
        if let Err(cause) = ardupilot.take(kind, component, payload) {
            ardupilot.intake.counters.count(cause);
        }
        ardupilot.pass_on(to);
    }
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

impl ArduPilot {
    fn take(&mut self, kind: &Kind, instance: u8, payload: &[u8]) -> Result<(), Cause> {
        let Some((meaning, columns)) = &kind.meaning else {
            self.texts(&kind.described, payload);
            return Ok(());
        };
        let row = columns.row(payload);
        // GPS before 2014 had the time of week in TimeMS, and its own time in T.
        let millis = || row.micros("T").or(row.micros("TimeMS")).map(|ms| ms * 1000);
        let us = row.micros("TimeUS").or_else(millis).ok_or(Cause::BadPayload)?;
        let time = self.intake.time(us)?;
        self.flush_before(us);
        (meaning.decode)(self, &Told { us, time, instance, row })
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
