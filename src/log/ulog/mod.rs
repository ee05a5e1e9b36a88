//! PX4's ULog: the framing in `reader`, the formats in `layout`, and here what the messages become.

mod aiding;
mod inertial;
mod layout;
mod position;
mod reader;

use std::collections::BTreeMap;
use std::io::{self, Read};

use crate::sample::{Airframe, VehicleStatus};
use crate::time::{AutopilotTime, Span};
use crate::wire::counters::Cause;
use crate::wire::decode::airframe;
use crate::wire::frame::{ComponentId, SystemId};
use crate::wire::session::identity::{AutopilotKind, FirmwareVersion, Vehicle};

use super::intake::Intake;
use super::parameters::Parameters;
use super::rotors::RotorSpeeds;
use super::row::{Columns, LogRow};
use super::waiting::{WaitingMessage, WaitingMessages, may_wait};
use super::{Entry, Listener, LogSummary};

use inertial::Units;
use layout::Formats;
use position::{GroundTruth, Receivers};
use reader::UlogReader;

/// What was published before logging began, more than this, is told again by the logger as if it were new.
const STALE: Span = Span::from_millis(500);
/// Stamps beyond this (2001-09-09) are counted from 1970, as a simulator without a boot does.
const SINCE_1970_US: u64 = 1_000_000_000_000_000;
/// Subscriptions beyond this are none of a log's, nor of several that were appended to each other.
const MOST_SUBSCRIPTIONS: usize = 4096;

/// Whoever else writes ULogs (`MAV_AUTOPILOT_GENERIC`).
const ANOTHER: AutopilotKind = AutopilotKind::Other(0);
/// Topics that are named to whoever reads of a log in which none is known.
const NAMED: usize = 3;

/// What a topic becomes, from the fields that it needs; those of every version that has other ones.
struct Topic {
    name: &'static str,
    fields: &'static [&'static str],
    decode: fn(&mut Px4, &Logged<'_>) -> Result<(), Cause>,
}

/// One logged message of a topic.
#[derive(Clone, Copy)]
struct Logged<'a> {
    /// Its stamp, the same since boot, and on the autopilot's clock.
    us: u64,
    boot_us: u64,
    time: AutopilotTime,
    /// Which of several of the kind.
    instance: u8,
    row: LogRow<'a>,
}

impl Logged<'_> {
    /// When it was measured: topics have the stamp of the measurement beside that of the publication.
    fn measured(&self) -> AutopilotTime {
        Intake::measured(self.time, self.us, self.row.micros("timestamp_sample").filter(|s| *s > 0))
    }
}

/// A topic that the log holds.
struct Subscription {
    name: String,
    instance: u8,
    topic: Option<(&'static Topic, Columns)>,
}

/// What is known of the vehicle so far.
#[derive(Default)]
struct Px4 {
    intake: Intake,
    units: Units,
    receivers: Receivers,
    truth: GroundTruth,
    flows: super::intake::Ranked,
    parameters: Parameters,
    rotors: RotorSpeeds,
}

/// Topics that say what is so, whenever it was published.
const STATES: &[Topic] = &[
    Topic {
        name: "vehicle_status",
        fields: &["arming_state", "system_type", "vehicle_type", "is_rotary_wing"],
        decode: status,
    },
    Topic { name: "vehicle_land_detected", fields: &["landed"], decode: land_detected },
    Topic { name: "sensor_selection", fields: &["accel_device_id"], decode: inertial::selection },
];

fn topic(name: &str) -> Option<&'static Topic> {
    let all = [STATES, inertial::TOPICS, position::TOPICS, aiding::TOPICS];
    all.into_iter().flatten().find(|t| t.name == name)
}

/// `arming_state` 2 is armed in every version; `system_type` is a `MAV_TYPE`.
fn status(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    let by_kind = match (m.row.byte("vehicle_type"), m.row.byte("is_rotary_wing")) {
        (Some(1), _) | (None, Some(1)) => Some(Airframe::Multirotor),
        (Some(2), _) | (None, Some(0)) => Some(Airframe::FixedWing),
        (Some(3), _) => Some(Airframe::Surface),
        _ => None,
    };
    let airframe = m.row.byte("system_type").and_then(airframe).or(by_kind);
    let armed = m.row.byte("arming_state").map(|s| s == 2);
    px4.intake.status(VehicleStatus { airframe, armed, landed: None });
    Ok(())
}

/// `vehicle_land_detected`.
fn land_detected(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    let landed = m.row.byte("landed").ok_or(Cause::BadPayload)? != 0;
    px4.intake.status(VehicleStatus { landed: Some(landed), ..VehicleStatus::default() });
    Ok(())
}

/// What a log tells of its vehicle before its data.
#[derive(Default)]
struct Introduction {
    system: Option<u8>,
    version: Option<FirmwareVersion>,
    /// It declares formats, and whether one of them is of a topic that is known.
    declared: bool,
    known: bool,
}

/// The vehicle that wrote a log; `None` if there is not a message in it.
pub(super) fn vehicle(bytes: impl Read) -> io::Result<Option<Vehicle>> {
    let (mut reader, _) = UlogReader::new(bytes)?;
    let (mut told, mut any) = (Introduction::default(), false);
    while let Some(message) = reader.next_message()? {
        any = true;
        match message.kind {
            b'D' | b'A' => break,
            b'F' => {
                let name = message.payload.split(|b| *b == b':').next();
                let name = name.and_then(|name| std::str::from_utf8(name).ok()).unwrap_or_default();
                told.declared = true;
                told.known |= topic(name).is_some();
            }
            b'P' => {
                if let Some(("MAV_SYS_ID", id)) = parameter(message.payload) {
                    told.system = Some(id as u8);
                }
            }
            b'I' => {
                if let Some((key, value)) = keyed(message.payload)
                    && key == "uint32_t ver_sw_release"
                {
                    told.version = value
                        .first_chunk()
                        .and_then(|b| FirmwareVersion::from_packed(u32::from_le_bytes(*b)));
                }
            }
            _ => {}
        }
    }
    Ok(any.then_some(Vehicle {
        system: SystemId(told.system.unwrap_or(1)),
        component: ComponentId::AUTOPILOT,
        autopilot: if told.known || !told.declared { AutopilotKind::Px4 } else { ANOTHER },
        vehicle_type: 0,
        armed: false,
        version: told.version,
    }))
}

/// A key and what follows it: of informations and parameters.
fn keyed(payload: &[u8]) -> Option<(&str, &[u8])> {
    let (&len, rest) = payload.split_first()?;
    let (key, value) = rest.split_at_checked(usize::from(len))?;
    Some((std::str::from_utf8(key).ok()?, value))
}

/// A parameter's name and value.
fn parameter(payload: &[u8]) -> Option<(&str, f64)> {
    let (key, value) = keyed(payload)?;
    let bytes = *value.first_chunk()?;
    match key.split_once(' ')? {
        ("int32_t", name) => Some((name, f64::from(i32::from_le_bytes(bytes)))),
        ("float", name) => Some((name, f64::from(f32::from_le_bytes(bytes)))),
        _ => None,
    }
}

/// A log while it is read.
struct UlogPlay {
    px4: Px4,
    formats: Formats,
    subscriptions: BTreeMap<u16, Subscription>,
    subscribed: usize,
    began_us: u64,
    system: u8,
    frames: u64,
    dropouts: u64,
    dropped_ms: u64,
    waiting: WaitingMessages,
}

/// Reads a log to its end.
pub(super) fn play(bytes: impl Read, vehicle: &Vehicle, to: &mut Listener<'_>) -> io::Result<LogSummary> {
    let (mut reader, began_us) = UlogReader::new(bytes)?;
    let mut reading = UlogPlay {
        px4: Px4::default(),
        formats: Formats::default(),
        subscriptions: BTreeMap::new(),
        subscribed: 0,
        began_us,
        system: vehicle.system.0,
        frames: 0,
        dropouts: 0,
        dropped_ms: 0,
        waiting: WaitingMessages::default(),
    };
    while let Some(message) = reader.next_message()? {
        reading.frames += 1;
        match message.kind {
            b'D' => reading.data(message.payload, to),
            b'A' => {
                if let Some((id, shortest, longest)) = reading.subscribe(message.payload) {
                    reader.expect(id, shortest, longest);
                }
            }
            b'B' => {
                let offsets: Vec<u64> = offsets(message.payload).collect();
                offsets.into_iter().for_each(|offset| reader.appended_at(offset));
            }
            _ => reading.other(message.kind, message.payload),
        }
    }
    reading.release(false);
    reading.pass_on(to);
    let mut counters = reading.px4.intake.counters.clone();
    counters.add(Cause::Garbage, reader.garbage);
    let mut notes = Vec::new();
    if reading.dropouts > 0 {
        let seconds = reading.dropped_ms as f64 * 1e-3;
        notes.push(format!("the logger dropped data {} times, {seconds:.1} s in all", reading.dropouts));
    }
    notes.extend(reading.of_another());
    Ok(LogSummary {
        frames: reading.frames,
        truncated: reader.truncated,
        reboots: reading.px4.intake.clock.reboots(),
        counters,
        parameters: reading.px4.parameters,
        rotors: reading.px4.rotors,
        notes,
        ..LogSummary::default()
    })
}

/// Where data was appended to the file, of its flags.
fn offsets(flags: &[u8]) -> impl Iterator<Item = u64> + '_ {
    const COMPATIBLE_AND_NOT: usize = 16;
    let all = flags.get(COMPATIBLE_AND_NOT..).unwrap_or_default().as_chunks::<8>().0;
    all.iter().take(3).map(|b| u64::from_le_bytes(*b)).filter(|offset| *offset > 0)
}

impl UlogPlay {
    /// What is to be said of a log that holds topics, and none that is known.
    fn of_another(&self) -> Option<String> {
        let mut names: Vec<&str> = self.subscriptions.values().map(|s| s.name.as_str()).collect();
        if names.is_empty() || self.subscriptions.values().any(|s| s.topic.is_some()) {
            return None;
        }
        names.sort_unstable();
        names.dedup();
        let more = match names.len().saturating_sub(NAMED) {
            0 => String::new(),
            n => format!(" and {n} more"),
        };
        names.truncate(NAMED);
        let names = names.join(", ");
        Some(format!(
            "none of its messages is known ({names}{more}): it is not of PX4, or holds nothing of use"
        ))
    }

    /// A message that is no data.
    fn other(&mut self, kind: u8, payload: &[u8]) {
        match kind {
            b'F' => {
                let declared = std::str::from_utf8(payload).is_ok_and(|text| self.formats.declare(text));
                if !declared {
                    self.px4.intake.counters.count(Cause::BadPayload);
                }
            }
            b'P' => {
                if let Some((name, value)) = parameter(payload) {
                    self.px4.parameters.set(name, value);
                }
            }
            b'O' => {
                self.dropouts += 1;
                self.dropped_ms += payload.first_chunk().map_or(0, |b| u64::from(u16::from_le_bytes(*b)));
            }
            _ => {}
        }
    }

    /// From now on data messages of this number are of that topic. The number, and the shortest and longest of them.
    fn subscribe(&mut self, payload: &[u8]) -> Option<(u16, u16, u16)> {
        let (&[instance, low, high], name) = payload.split_first_chunk::<3>()?;
        let id = u16::from_le_bytes([low, high]);
        let name = std::str::from_utf8(name).ok()?;
        self.subscribed += 1;
        if self.subscribed > MOST_SUBSCRIPTIONS {
            return None;
        }
        let Some((shortest, longest)) = self.formats.lengths(name) else {
            self.px4.intake.counters.count(Cause::BadPayload);
            return None;
        };
        let topic = topic(name)
            .map(|topic| (topic, Columns::of(topic.fields, |field| self.formats.slot(name, field))));
        self.subscriptions.insert(id, Subscription { name: name.to_owned(), instance, topic });
        let with_id = |n: usize| u16::try_from(n + 2).ok();
        Some((id, with_id(shortest)?, with_id(longest)?))
    }

    /// A message of a topic. Every topic begins with its stamp.
    fn data(&mut self, payload: &[u8], to: &mut Listener<'_>) {
        let Some((id, data)) = payload.split_first_chunk::<2>() else { return };
        let id = u16::from_le_bytes(*id);
        let Some(subscription) = self.subscriptions.get(&id) else {
            return self.px4.intake.counters.count(Cause::UnknownId);
        };
        let name = Some(subscription.name.as_str());
        let instance = subscription.instance;
        (to.entry)(&Entry { name, id: u32::from(id), system: self.system, component: instance });
        if subscription.topic.is_some() {
            self.take(id, data);
        }
        self.pass_on(to);
    }

    fn pass_on(&mut self, to: &mut Listener<'_>) {
        for input in self.px4.intake.out.drain(..) {
            (to.item)(&self.px4.intake.clock, &input);
        }
    }

    /// One message: read at once where its stamp can be believed, else when it is known whether the clock has jumped there.
    fn take(&mut self, id: u16, data: &[u8]) {
        let Some(us) = data.first_chunk().map(|b| u64::from_le_bytes(*b)) else { return };
        // Published before logging began.
        if us.saturating_add(STALE.micros() as u64) < self.began_us {
            return match self.is_state(id) {
                true => self.read(id, data, self.px4.intake.now()),
                false => self.px4.intake.counters.count(Cause::Stale),
            };
        }
        match self.px4.intake.time(self.since_boot(us)) {
            Ok(time) => {
                let jumped = self.px4.intake.take_jumped();
                self.release(jumped);
                self.read(id, data, time);
            }
            Err(cause) if may_wait(cause) => {
                let us = Some(self.since_boot(us));
                let message = WaitingMessage { id, us, cause, payload: data.to_vec() };
                if let Some(oldest) = self.waiting.hold(message) {
                    self.read_late(&oldest, false);
                }
            }
            Err(cause) => self.px4.intake.counters.count(cause),
        }
    }

    /// What has waited is read, now that the clock has jumped, or has not.
    fn release(&mut self, jumped: bool) {
        while let Some(message) = self.waiting.next() {
            self.read_late(&message, jumped);
        }
    }

    fn read_late(&mut self, message: &WaitingMessage, jumped: bool) {
        match self.px4.intake.waited(message, jumped, self.is_state(message.id)) {
            Ok(time) => self.read(message.id, &message.payload, time),
            Err(cause) => self.px4.intake.counters.count(cause),
        }
    }

    /// A message whose time is known.
    fn read(&mut self, id: u16, data: &[u8], time: AutopilotTime) {
        let Some(Subscription { instance, topic: Some((topic, columns)), .. }) = self.subscriptions.get(&id)
        else {
            return;
        };
        let us = data.first_chunk().map_or(0, |b| u64::from_le_bytes(*b));
        let boot_us = self.since_boot(us);
        let told = Logged { us, boot_us, time, instance: *instance, row: columns.row(data) };
        if let Err(cause) = (topic.decode)(&mut self.px4, &told) {
            self.px4.intake.counters.count(cause);
        }
    }

    /// A stamp since boot.
    fn since_boot(&self, us: u64) -> u64 {
        if self.began_us < SINCE_1970_US { us } else { us.saturating_sub(self.began_us) }
    }

    /// Whether messages of this number say what is so.
    fn is_state(&self, id: u16) -> bool {
        let topic = self.subscriptions.get(&id).and_then(|s| s.topic.as_ref());
        topic.is_some_and(|(topic, _)| STATES.iter().any(|t| t.name == topic.name))
    }
}
