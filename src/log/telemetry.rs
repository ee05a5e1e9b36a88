//! MAVLink logs, with or without stamps.

use std::collections::BTreeMap;
use std::io::{self, Read};

use crate::time::{Companion, Stamp};
use crate::wire::decode::{Decoder, RotorWord};
use crate::wire::frame::{Frame, SystemId};
use crate::wire::messages;
use crate::wire::recording::{HeardAs, Mark, is_of_ours};
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
            if recording.ends_with(&mark) {
                break;
            }
            recording.mark(&mark, &mut decoder);
            (to.aside)(&Aside::Mark(mark));
            continue;
        }
        if recording.parts > 0 {
            (to.aside)(&Aside::At(record.written_us));
            if is_of_ours(frame) && !std::mem::take(&mut recording.of_ours) {
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
    /// The next frame was heard, whatever component it names.
    of_ours: bool,
    lost: u64,
    /// Another recording stands behind it.
    ended: bool,
}

impl Recorded {
    /// Whether another recording begins: that is another flight.
    fn ends_with(&mut self, mark: &Mark) -> bool {
        self.ended = self.parts > 0 && matches!(mark, Mark::Part { run, .. } if *run != self.run);
        self.ended
    }

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
            Mark::Lost(frames) => {
                self.lost += u64::from(*frames);
                self.of_ours = false;
            }
            Mark::HeardOfOurs => self.of_ours = true,
            Mark::Stands(_) | Mark::Drill { .. } | Mark::Kept { .. } => {}
        }
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.parts > 0 {
            let of = if self.parts == 1 { String::new() } else { format!(", {} files of it", self.parts) };
            notes.push(format!("recording {} of Holdover{of}", self.run));
        }
        if self.ended {
            notes.push("what stands behind it is another recording, and left out".to_owned());
        }
        if self.lost > 0 {
            notes
                .push(format!("{} frames are missing in the recording: the disk did not keep up", self.lost));
        }
        notes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::frame::ComponentId;
    use crate::wire::recording::MarkWriter;
    use crate::wire::session::Address;
    use crate::wire::session::heartbeat::{SystemStatus, heartbeat};
    use crate::wire::session::identity::AutopilotKind;
    use crate::wire::session::outgoing::FrameWriter;

    const VEHICLE: Vehicle = Vehicle {
        system: SystemId(3),
        component: ComponentId::AUTOPILOT,
        autopilot: AutopilotKind::Px4,
        vehicle_type: 2,
        armed: false,
        version: None,
    };

    /// The notes, what was told beside the inputs, and how many frames were read and taken for what was sent. A heartbeat of our component
    /// stands behind each mark.
    fn read(marks: &[Mark]) -> (Vec<String>, Vec<Mark>, [u64; 2]) {
        let (mut writer, mut bytes) = (MarkWriter::new(), Vec::new());
        let mut beats =
            FrameWriter::new(Address { system: SystemId(3), component: ComponentId::ODOMETRY_SOURCE });
        for (i, mark) in (1_000_000_u64..).zip(marks) {
            for frame in [writer.write(mark), beats.write(&heartbeat(SystemStatus::Active, 0))] {
                bytes.extend(i.to_be_bytes());
                bytes.extend_from_slice(&frame.unwrap());
            }
        }
        let (mut told, mut sent) = (Vec::new(), 0);
        let mut aside = |aside: &Aside<'_>| match aside {
            Aside::Mark(mark) => told.push(mark.clone()),
            Aside::Sent(_) => sent += 1,
            Aside::At(_) => {}
        };
        let mut to = Listener { entry: &mut |_| {}, item: &mut |_, _| {}, aside: &mut aside };
        let summary = play(&bytes[..], LogFormat::Tlog, &VEHICLE, &mut to).unwrap();
        (summary.notes, told, [summary.frames, sent])
    }

    #[test]
    fn the_files_of_a_recording_are_one_and_another_recording_is_another_flight() {
        let part = |run, part| Mark::Part { run, part };
        let follows = Mark::Follows { vehicle: VEHICLE, anew: false };
        let (notes, told, _) =
            read(&[part(4, 1), follows.clone(), part(4, 2), follows.clone(), Mark::Lost(7)]);
        assert_eq!(told.len(), 5);
        assert_eq!(notes.len(), 2);
        assert!(notes[0].contains("recording 4 of Holdover, 2 files"), "{notes:?}");
        assert!(notes[1].starts_with("7 frames are missing"), "{notes:?}");
        let (notes, told, frames) = read(&[part(4, 1), follows.clone(), part(5, 1), follows]);
        assert_eq!((told.len(), frames), (2, [5, 2]));
        assert!(notes[1].contains("another recording"), "{notes:?}");
    }

    #[test]
    fn what_was_heard_of_our_component_is_not_what_was_sent() {
        let part = Mark::Part { run: 1, part: 1 };
        assert_eq!(read(&[part.clone(), Mark::HeardOfOurs, Mark::Heard(HeardAs::Listened)]).2, [6, 2]);
    }

    #[test]
    fn another_log_is_no_recording() {
        assert_eq!(read(&[]).0, Vec::<String>::new());
    }
}
