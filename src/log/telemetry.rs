//! MAVLink logs, with or without stamps.

use std::collections::BTreeMap;
use std::io::{self, Read};

use crate::time::{Companion, Stamp};
use crate::wire::decode::Decoder;
use crate::wire::frame::SystemId;
use crate::wire::messages;
use crate::wire::session::identity::{Identity, IdentityConfig, Vehicle};
use crate::wire::tlog::TlogReader;

use super::{Entry, Listener, LogFormat, LogSummary};

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
    while let Some(record) = reader.next_record()? {
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
    let mut names: BTreeMap<u32, Option<&'static str>> = BTreeMap::new();
    let mut items = Vec::with_capacity(8);
    let mut signed = 0;
    while let Some(record) = reader.next_record()? {
        let (frame, id) = (&record.frame, record.frame.message_id());
        let name = *names.entry(id).or_insert_with(|| messages::name_of(id));
        signed += u64::from(frame.is_signed());
        (to.entry)(&Entry { name, id, system: frame.system().0, component: frame.component().0 });
        decoder.decode(frame, written(record.written_us), &mut items);
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
        counters,
        ..LogSummary::default()
    })
}
