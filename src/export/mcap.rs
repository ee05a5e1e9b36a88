//! MCAP with Foxglove's schemas, as JSON: places, poses, events, and a series for every number of the tables.
//!
//! Times are Unix times where the log tells the date before the first message is written, else since the first sample; the file's
//! metadata says which. Frames: `local` is east, north, up from the origin, as Foxglove draws it, `base_link` forward, left, up.

use std::collections::BTreeMap;
use std::fmt;
use std::io;
use std::path::Path;

use mcap::records::{MessageHeader, Metadata};
use mcap::write::{NoSeek, WriteOptions, Writer};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use serde_json::{Map, Value, json};

use super::rows::{Column, ColumnKind, RowValue};
use crate::files::{OutputFile, Overwrite, READABLE};
use crate::geo::{Geodetic, LocalNed};
use crate::navigator::event::{Event, EventKind};
use crate::navigator::solution::{Mode, Solution};
use crate::sample::GnssSample;
use crate::time::AutopilotTime;
use crate::wire::clock::AutopilotClock;

const POSE: &str = include_str!("schemas/pose.json");
const LOCATION: &str = include_str!("schemas/location.json");
const LOG: &str = include_str!("schemas/log.json");

/// Foxglove's levels.
const INFO: u8 = 2;
const WARNING: u8 = 3;
/// Foxglove's kinds of covariances.
const UNKNOWN: u8 = 0;
const DIAGONAL: u8 = 2;
const KNOWN: u8 = 3;

/// A file for Foxglove that is being written.
pub struct McapFile {
    writer: Writer<NoSeek<OutputFile>>,
    schemas: BTreeMap<String, u16>,
    channels: BTreeMap<String, u16>,
    /// What is added to the time since the first sample, s: the date, once it is settled.
    start_unix_s: Option<f64>,
    sequence: u32,
}

impl fmt::Debug for McapFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("McapFile").field("messages", &self.sequence).finish_non_exhaustive()
    }
}

fn failed(e: mcap::McapError) -> io::Error {
    match e {
        mcap::McapError::Io(e) => e,
        e => io::Error::other(e.to_string()),
    }
}

impl McapFile {
    /// Begins a file at `path`.
    ///
    /// # Errors
    /// What is in its place, or the system's word.
    pub fn create(path: &Path, force: bool) -> io::Result<Self> {
        let file = OutputFile::create(path, Overwrite::forced(force), READABLE)?;
        let options = WriteOptions::new()
            .compression(None)
            .library(concat!("holdover ", env!("CARGO_PKG_VERSION")))
            .disable_seeking(true);
        let writer = options.create(NoSeek::new(file)).map_err(failed)?;
        Ok(Self {
            writer,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            start_unix_s: None,
            sequence: 0,
        })
    }

    /// The date, if the log knows it by now and no message was written yet.
    pub(super) fn stamps(&mut self, clock: &AutopilotClock, time: AutopilotTime, t_s: f64) {
        if self.start_unix_s.is_none() && self.sequence == 0 {
            self.start_unix_s = clock.unix_seconds(time).map(|unix| unix - t_s).filter(|start| *start > 0.0);
        }
    }

    fn nanos(&self, t_s: f64) -> u64 {
        ((self.start_unix_s.unwrap_or(0.0) + t_s).max(0.0) * 1e9).round() as u64
    }

    fn stamp(&self, t_s: f64) -> Value {
        let nanos = self.nanos(t_s);
        json!({"sec": nanos / 1_000_000_000, "nsec": nanos % 1_000_000_000})
    }

    fn channel(&mut self, topic: &str, schema: &str, text: impl FnOnce() -> String) -> io::Result<u16> {
        if let Some(channel) = self.channels.get(topic) {
            return Ok(*channel);
        }
        let id = match self.schemas.get(schema) {
            Some(id) => *id,
            None => {
                let id = self.writer.add_schema(schema, "jsonschema", text().as_bytes()).map_err(failed)?;
                self.schemas.insert(schema.to_owned(), id);
                id
            }
        };
        let channel = self.writer.add_channel(id, topic, "json", &BTreeMap::new()).map_err(failed)?;
        self.channels.insert(topic.to_owned(), channel);
        Ok(channel)
    }

    fn message(&mut self, channel_id: u16, t_s: f64, value: &Value) -> io::Result<()> {
        let log_time = self.nanos(t_s);
        let header = MessageHeader { channel_id, sequence: self.sequence, log_time, publish_time: log_time };
        self.sequence = self.sequence.wrapping_add(1);
        self.writer.write_to_known_channel(&header, &serde_json::to_vec(value)?).map_err(failed)
    }

    /// Something was told.
    pub(super) fn event(&mut self, t_s: f64, event: &Event) -> io::Result<()> {
        let channel = self.channel("/events", "foxglove.Log", || LOG.to_owned())?;
        let calm = matches!(event.kind, EventKind::Mode { to: Mode::Aided | Mode::Rejoining, .. })
            || ["origin", "placed", "carried-by", "flow-trusted", "source-acquitted", "height-healed"]
                .contains(&event.kind.code());
        let value = json!({
            "timestamp": self.stamp(t_s),
            "level": if calm { INFO } else { WARNING },
            "message": event.to_string(),
            "name": event.kind.code(),
            "file": "",
            "line": 0,
        });
        self.message(channel, t_s, &value)
    }

    /// What a receiver said.
    pub(super) fn fix(&mut self, t_s: f64, fix: &GnssSample) -> io::Result<()> {
        let Some(position) = fix.position else { return Ok(()) };
        let covariance = fix.horizontal_accuracy_m.map(|h| {
            let v = fix.vertical_accuracy_m.unwrap_or(h);
            Matrix3::from_diagonal(&nalgebra::Vector3::new(h * h, h * h, v * v))
        });
        let kind = if covariance.is_some() { DIAGONAL } else { UNKNOWN };
        let topic = format!("/gnss/{}/location", fix.receiver);
        self.location(&topic, t_s, &position, covariance.unwrap_or_default(), kind)
    }

    /// A place without a word on how well it is known.
    pub(super) fn place(&mut self, topic: &str, t_s: f64, position: &Geodetic) -> io::Result<()> {
        self.location(topic, t_s, position, Matrix3::zeros(), UNKNOWN)
    }

    /// `covariance` is east, north, up, m².
    fn location(
        &mut self,
        topic: &str,
        t_s: f64,
        position: &Geodetic,
        covariance: Matrix3<f64>,
        kind: u8,
    ) -> io::Result<()> {
        let channel = self.channel(topic, "foxglove.LocationFix", || LOCATION.to_owned())?;
        let value = json!({
            "timestamp": self.stamp(t_s),
            "frame_id": "earth",
            "latitude": position.latitude_rad.to_degrees(),
            "longitude": position.longitude_rad.to_degrees(),
            "altitude": position.height_m,
            "position_covariance": covariance.transpose().as_slice(),
            "position_covariance_type": kind,
        });
        self.message(channel, t_s, &value)
    }

    /// Pose and, where on Earth it lies is known, place of the solution.
    pub(super) fn solution(&mut self, t_s: f64, s: &Solution, frame: Option<&LocalNed>) -> io::Result<()> {
        // North, east, down and forward, right, down to east, north, up and forward, left, up.
        let to_enu = Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0);
        let from_flu = Matrix3::from_diagonal(&nalgebra::Vector3::new(1.0, -1.0, -1.0));
        let rotation = to_enu * s.attitude.matrix() * from_flu;
        let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        let p = to_enu * s.position.raw();
        let channel = self.channel("/solution/pose", "foxglove.PoseInFrame", || POSE.to_owned())?;
        let value = json!({
            "timestamp": self.stamp(t_s),
            "frame_id": "local",
            "pose": {
                "position": {"x": p.x, "y": p.y, "z": p.z},
                "orientation": {"x": q.i, "y": q.j, "z": q.k, "w": q.w},
            },
        });
        self.message(channel, t_s, &value)?;
        let Some(frame) = frame else { return Ok(()) };
        let place = frame.to_geodetic(&s.position.raw());
        let covariance = to_enu * s.position_covariance.raw() * to_enu.transpose();
        self.location("/solution/location", t_s, &place, covariance, KNOWN)
    }

    /// A row of a table, as an object with a number for each of its columns.
    pub(super) fn series(
        &mut self,
        topic: &str,
        schema: &str,
        columns: &'static [Column],
        t_s: f64,
        row: &[RowValue],
    ) -> io::Result<()> {
        let channel = self.channel(topic, schema, || of_columns(schema, columns))?;
        let mut object = Map::new();
        for ((name, _), value) in columns.iter().zip(row) {
            let value = match value {
                RowValue::Unknown => continue,
                RowValue::Number(v) => json!(v),
                RowValue::Count(v) => json!(v),
                RowValue::Words(v) => json!(v),
            };
            object.insert((*name).to_owned(), value);
        }
        self.message(channel, t_s, &Value::Object(object))
    }

    /// Ends the file, which has its name from here on.
    ///
    /// # Errors
    /// What writing says.
    pub fn finish(mut self) -> io::Result<()> {
        let times = if self.start_unix_s.is_some() { "unix" } else { "since the first sample" };
        let metadata = BTreeMap::from([("times".to_owned(), times.to_owned())]);
        let metadata = Metadata { name: "holdover".to_owned(), metadata };
        self.writer.write_metadata(&metadata).map_err(failed)?;
        self.writer.finish().map_err(failed)?;
        self.writer.into_inner().into_inner().finish()
    }
}

/// The JSON schema of a table's row.
fn of_columns(title: &str, columns: &[Column]) -> String {
    let properties: Map<String, Value> = columns
        .iter()
        .map(|(name, kind)| {
            let kind = match kind {
                ColumnKind::Number => "number",
                ColumnKind::Count => "integer",
                ColumnKind::Words => "string",
            };
            ((*name).to_owned(), json!({"type": kind}))
        })
        .collect();
    json!({"title": title, "type": "object", "properties": properties}).to_string()
}
