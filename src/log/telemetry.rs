//! MAVLink logs, with or without stamps.

use std::collections::BTreeMap;
use std::io::{self, Read};

use crate::time::{Companion, Stamp};
use crate::wire::decode::{Decoder, RotorWord};
use crate::wire::frame::{ComponentId, Frame, SystemId};
use crate::wire::messages;
use crate::wire::recording::{HeardAs, Mark};
use crate::wire::session::identity::{Identity, IdentityConfig, Vehicle};
use crate::wire::tlog::TlogReader;

use super::rotors::RotorSpeeds;
use super::{Aside, Entry, Listener, LogFormat, LogSummary};

/// A log in which the wanted autopilot does not speak.
pub(super) struct Silent {
    pub(super) frames: u64,
    pub(super) wanted: String,
    pub(super) heard: String,
}

fn reader<R: Read>(bytes: R, format: LogFormat) -> TlogReader<R> {
    if format == LogFormat::RawMavlink { TlogReader::without_stamps(bytes) } else { TlogReader::new(bytes) }
}

/// The autopilot to follow, of the given system, by the same rules as in flight; in a log that is too short for them, or that has no stamps,
/// whoever has shown most.
pub(super) fn vehicle(
    bytes: impl Read,
    format: LogFormat,
    system: Option<SystemId>,
) -> io::Result<Result<Vehicle, Silent>> {
    let mut reader = reader(bytes, format);
    let mut identity = Identity::new(IdentityConfig { system, ..IdentityConfig::default() });
    let mut heard: BTreeMap<SystemId, u64> = BTreeMap::new();
    let mut recording = false;
    while let Some(record) = reader.next_record()? {
        match Mark::of(&record.frame) {
            Some(Mark::Part { .. }) => recording = true,
            Some(Mark::Follows { vehicle, .. }) if system.is_none_or(|s| s == vehicle.system) => {
                return Ok(Ok(vehicle));
            }
            _ => {}
        }
        if recording {
            continue;
        }
        *heard.entry(record.frame.system()).or_default() += 1;
        let at = written(record.written_us).unwrap_or(Stamp::from_micros(0));
        identity.hear(at, &record.frame);
        if let Some(vehicle) = identity.vehicle() {
            return Ok(Ok(*vehicle));
        }
    }
    if let Some(vehicle) = identity.likeliest() {
        return Ok(Ok(vehicle));
    }
    let heard: Vec<String> = heard.iter().take(12).map(|(s, n)| format!("{} ({n} frames)", s.0)).collect();
    let wanted =
        system.map_or("any autopilot".to_owned(), |s| format!("an autopilot with system id {}", s.0));
    Ok(Err(Silent { frames: reader.counters().frames, wanted, heard: heard.join(", ") }))
}

/// When a record was written, where its log says so.
fn written(us: u64) -> Option<Stamp<Companion>> {
    i64::try_from(us).ok().filter(|us| *us > 0).map(Stamp::from_micros)
}

/// Reads such a log to its end.
pub(super) fn play(
    bytes: impl Read,
    format: LogFormat,
    vehicle: &Vehicle,
    to: &mut Listener<'_>,
) -> io::Result<LogSummary> {
    let mut reader = reader(bytes, format);
    let mut decoder = Decoder::new();
    decoder.follow(vehicle);
    let mut recording = Recorded::default();
    let mut names: BTreeMap<u32, Option<&'static str>> = BTreeMap::new();
    let mut items = Vec::with_capacity(8);
    let (mut signed, mut rotors) = (0, RotorSpeeds::default());
    while let Some(record) = reader.next_record()? {
        let (frame, id) = (&record.frame, record.frame.message_id());
        let name = *names.entry(id).or_insert_with(|| messages::name_of(id));
        signed += u64::from(frame.is_signed());
        (to.entry)(&Entry { name, id, system: frame.system().0, component: frame.component().0 });
        if let Some(mark) = Mark::of(frame) {
            recording.mark(&mark, &mut decoder);
            (to.aside)(&Aside::Mark(mark));
            continue;
        }
        if recording.parts > 0 {
            (to.aside)(&Aside::At(record.written_us));
            if frame.component() == ComponentId::ODOMETRY_SOURCE {
                (to.aside)(&Aside::Sent(*frame));
            }
        }
        if frame.system() == vehicle.system {
            note_rotors(frame, &mut rotors);
        }
        match recording.heard_as {
            HeardAs::Listened => decoder.decode(frame, written(record.written_us), &mut items),
            HeardAs::Sensor => drop(decoder.decode_sensor(frame, &mut items)),
            HeardAs::Beside => {}
        }
        for i in items.drain(..) {
            (to.item)(decoder.clock(), &i);
        }
    }
    let mut counters = decoder.counters().clone();
    counters.frames = 0;
    counters.merge(reader.counters());
    Ok(LogSummary {
        frames: reader.counters().frames,
        truncated: reader.truncated(),
        signed,
        reboots: decoder.clock().reboots(),
        repairs: decoder.repairs().clone(),
        rotors,
        counters,
        notes: recording.notes(),
        ..LogSummary::default()
    })
}

/// What speed controllers tell, if the frame is of them.
fn note_rotors(frame: &Frame<'_>, rotors: &mut RotorSpeeds) {
    if let Some(word) = RotorWord::of(frame) {
        for (controller, rpm) in (word.first..=u8::MAX).zip(word.rpm) {
            rotors.note(controller, rpm);
        }
    }
}

/// What a recording of Holdover's says of itself; nothing of another log.
#[derive(Debug, Default)]
struct Recorded {
    run: u32,
    parts: u32,
    heard_as: HeardAs,
    lost: u64,
}

impl Recorded {
    fn mark(&mut self, mark: &Mark, decoder: &mut Decoder) {
        match mark {
            Mark::Part { run, part } => {
                if self.parts == 0 && *part == 1 {
                    // Nobody is followed before it is said.
                    *decoder = Decoder::new();
                }
                self.parts += 1;
                self.run = *run;
                self.heard_as = HeardAs::Listened;
            }
            Mark::Follows { vehicle, anew } => {
                if *anew {
                    *decoder = Decoder::new();
                }
                if !decoder.follows(vehicle) {
                    decoder.follow(vehicle);
                }
            }
            Mark::Heard(how) => self.heard_as = *how,
            Mark::Lost(frames) => self.lost += u64::from(*frames),
            Mark::Stands(_) | Mark::Drill { .. } | Mark::Kept { .. } => {}
        }
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.parts > 0 {
            let of = if self.parts == 1 { String::new() } else { format!(", {} files of it", self.parts) };
            notes.push(format!("recording {} of Holdover{of}", self.run));
        }
        if self.lost > 0 {
            notes
                .push(format!("{} frames are missing in the recording: the disk did not keep up", self.lost));
        }
        notes
    }
}
