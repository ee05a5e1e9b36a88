//! What a recording of a flight says beside the frames that were heard and sent.
//!
//! A telemetry log holds frames and times. To fly one again exactly as it was flown takes more: from when on which autopilot was followed,
//! which frames came on a link that was not listened to, what the autopilot was known to stand on. That is said by [`Mark`]s: frames of
//! V2_EXTENSION, the message that MAVLink keeps for what only one program understands, of a component of their own
//! (`MAV_COMP_ID_LOG`). Ground stations and pymavlink pass over them. What is heard on a link and looks like a mark is not recorded.

mod sent;

use std::io::{self, Write};

use mavlink::MessageData;
use mavlink::dialects::ardupilotmega::{MavMessage, SETUP_SIGNING_DATA, V2_EXTENSION_DATA};

use super::frame::{ComponentId, Frame, SystemId};
use super::frame_bytes::FrameBytes;
use super::session::Address;
use super::session::identity::{AutopilotKind, Vehicle};
use super::session::outgoing::FrameWriter;
use crate::outbound::handover::StandsOn;

pub use sent::{SentAgain, SentReport};

/// `MAV_COMP_ID_LOG`.
const COMPONENT: ComponentId = ComponentId(155);
/// Of the numbers that V2_EXTENSION leaves to everybody.
const MESSAGE_TYPE: u16 = 0xB01D;
/// Bytes of one piece of a kept state.
const PIECE: usize = 240;

/// How a frame was taken that was heard.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum HeardAs {
    /// On the link that the autopilot is listened to.
    #[default]
    Listened,
    /// On a link for sensors.
    Sensor,
    /// On another link, and not used.
    Beside,
}

/// What a recording says beside frames.
#[derive(Clone, PartialEq, Debug)]
pub enum Mark {
    /// A file begins: part `part` of the recording `run`.
    Part {
        /// Number of the recording in its folder.
        run: u32,
        /// Number of the file in the recording, from 1.
        part: u32,
    },
    /// This vehicle is followed from here on.
    Follows {
        /// The vehicle; its version is not told.
        vehicle: Vehicle,
        /// Instead of another, of which nothing holds any more.
        anew: bool,
    },
    /// The frames from here on were heard so.
    Heard(HeardAs),
    /// What the autopilot stands on from here on.
    Stands(StandsOn),
    /// GNSS was withheld in this interval, s since the first sample.
    Drill {
        /// From.
        from_s: f64,
        /// To.
        to_s: f64,
    },
    /// A piece of what a process before had kept, and what this one may go on from at its first IMU sample.
    Kept {
        /// Number of the piece, from 0.
        index: u16,
        /// How many there are.
        of: u16,
        /// Its bytes.
        bytes: Vec<u8>,
    },
    /// So many frames are missing here: the disk did not keep up.
    Lost(u32),
    /// The next frame was heard, though the component that it names is ours.
    HeardOfOurs,
}

impl Mark {
    /// The pieces of a kept state.
    pub fn kept(state: &[u8]) -> Vec<Self> {
        let of = u16::try_from(state.len().div_ceil(PIECE)).unwrap_or(u16::MAX);
        let pieces = (0..of).zip(state.chunks(PIECE));
        pieces.map(|(index, bytes)| Self::Kept { index, of, bytes: bytes.to_vec() }).collect()
    }

    /// The mark in a frame, if it is one.
    pub fn of(frame: &Frame<'_>) -> Option<Self> {
        if !may_be_mark(frame) || frame.component() != COMPONENT {
            return None;
        }
        let Ok(MavMessage::V2_EXTENSION(m)) = frame.parse() else { return None };
        (m.message_type == MESSAGE_TYPE).then(|| read(&mut &m.payload[..])).flatten()
    }
}

/// Whether a frame names the component that Holdover speaks as. In a recording those are what it sent, but for what a mark says was heard.
pub fn is_of_ours(frame: &Frame<'_>) -> bool {
    frame.component() == ComponentId::ODOMETRY_SOURCE
}

/// Whether a frame that is heard must not be recorded: it could be taken for a mark, or holds a key.
pub fn is_withheld(frame: &Frame<'_>) -> bool {
    may_be_mark(frame) || frame.message_id() == SETUP_SIGNING_DATA::ID
}

fn may_be_mark(frame: &Frame<'_>) -> bool {
    frame.message_id() == V2_EXTENSION_DATA::ID
}

/// Writes marks as frames.
#[derive(Debug)]
pub struct MarkWriter {
    frames: FrameWriter,
}

impl MarkWriter {
    /// Of a system that is not known yet.
    pub fn new() -> Self {
        Self::of(SystemId(1))
    }

    fn of(system: SystemId) -> Self {
        Self { frames: FrameWriter::new(Address { system, component: COMPONENT }) }
    }

    /// The frame. `None` for none that there is.
    pub fn write(&mut self, mark: &Mark) -> Option<FrameBytes> {
        if let Mark::Follows { vehicle, .. } = mark
            && vehicle.system != self.frames.from().system
        {
            *self = Self::of(vehicle.system);
        }
        let mut payload = [0; 249];
        say(mark, &mut &mut payload[..]).ok()?;
        self.frames.write(&MavMessage::V2_EXTENSION(V2_EXTENSION_DATA {
            message_type: MESSAGE_TYPE,
            payload,
            ..V2_EXTENSION_DATA::DEFAULT
        }))
    }
}

impl Default for MarkWriter {
    fn default() -> Self {
        Self::new()
    }
}

/// What each mark begins with.
mod kind {
    pub(super) const PART: u8 = 1;
    pub(super) const FOLLOWS: u8 = 2;
    pub(super) const HEARD: u8 = 3;
    pub(super) const STANDS: u8 = 4;
    pub(super) const DRILL: u8 = 5;
    pub(super) const KEPT: u8 = 6;
    pub(super) const LOST: u8 = 7;
    pub(super) const HEARD_OF_OURS: u8 = 8;
}

/// Numbers are little-endian, as everywhere in MAVLink.
fn say(mark: &Mark, to: &mut impl Write) -> io::Result<()> {
    let mut pieces = |pieces: &[&[u8]]| pieces.iter().try_for_each(|piece| to.write_all(piece));
    match mark {
        Mark::Part { run, part } => pieces(&[&[kind::PART], &run.to_le_bytes(), &part.to_le_bytes()]),
        Mark::Follows { vehicle: v, anew } => {
            let who = [v.system.0, v.component.0, v.autopilot.to_wire(), v.vehicle_type];
            pieces(&[&[kind::FOLLOWS], &who, &[u8::from(v.armed), u8::from(*anew)]])
        }
        Mark::Heard(how) => pieces(&[&[kind::HEARD, *how as u8]]),
        Mark::Stands(on) => pieces(&[&[kind::STANDS, *on as u8]]),
        Mark::Drill { from_s, to_s } => pieces(&[&[kind::DRILL], &from_s.to_le_bytes(), &to_s.to_le_bytes()]),
        Mark::Kept { index, of, bytes } => {
            let len = u8::try_from(bytes.len()).unwrap_or(u8::MAX);
            pieces(&[&[kind::KEPT], &index.to_le_bytes(), &of.to_le_bytes(), &[len], bytes])
        }
        Mark::Lost(frames) => pieces(&[&[kind::LOST], &frames.to_le_bytes()]),
        Mark::HeardOfOurs => pieces(&[&[kind::HEARD_OF_OURS]]),
    }
}

fn read(from: &mut &[u8]) -> Option<Mark> {
    match byte(from)? {
        kind::PART => Some(Mark::Part { run: number(from)?, part: number(from)? }),
        kind::FOLLOWS => take(from).map(follows),
        kind::HEARD => {
            let all = [HeardAs::Listened, HeardAs::Sensor, HeardAs::Beside];
            one_of(&all, from).map(Mark::Heard)
        }
        kind::STANDS => {
            let all = [StandsOn::Unknown, StandsOn::Gnss, StandsOn::Ours, StandsOn::Nothing];
            one_of(&all, from).map(Mark::Stands)
        }
        kind::DRILL => drill(from),
        kind::KEPT => kept(from),
        kind::LOST => number(from).map(Mark::Lost),
        kind::HEARD_OF_OURS => Some(Mark::HeardOfOurs),
        _ => None,
    }
}

fn follows([system, component, autopilot, vehicle_type, armed, anew]: [u8; 6]) -> Mark {
    let vehicle = Vehicle {
        system: SystemId(system),
        component: ComponentId(component),
        autopilot: AutopilotKind::from_wire(autopilot),
        vehicle_type,
        armed: armed == 1,
        version: None,
    };
    Mark::Follows { vehicle, anew: anew == 1 }
}

fn drill(from: &mut &[u8]) -> Option<Mark> {
    let (from_s, to_s) = (f64::from_le_bytes(take(from)?), f64::from_le_bytes(take(from)?));
    (from_s >= 0.0 && from_s < to_s).then_some(Mark::Drill { from_s, to_s })
}

fn kept(from: &mut &[u8]) -> Option<Mark> {
    let (index, of) = (u16::from_le_bytes(take(from)?), u16::from_le_bytes(take(from)?));
    let len = usize::from(byte(from)?);
    Some(Mark::Kept { index, of, bytes: from.get(..len)?.to_vec() })
}

fn one_of<T: Copy>(all: &[T], from: &mut &[u8]) -> Option<T> {
    all.get(usize::from(byte(from)?)).copied()
}

fn number(from: &mut &[u8]) -> Option<u32> {
    take(from).map(u32::from_le_bytes)
}

fn take<const N: usize>(from: &mut &[u8]) -> Option<[u8; N]> {
    let (first, rest) = from.split_first_chunk()?;
    *from = rest;
    Some(*first)
}

fn byte(from: &mut &[u8]) -> Option<u8> {
    take::<1>(from).map(|[b]| b)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::wire::frame::{Scan, scan};
    use crate::wire::session::heartbeat::{SystemStatus, heartbeat};

    fn again(mark: &Mark) -> Option<Mark> {
        let bytes = MarkWriter::new().write(mark).unwrap();
        let Scan::Frame(frame) = scan(&bytes, true) else { panic!("not a valid frame") };
        Mark::of(&frame)
    }

    fn vehicle(system: u8, autopilot: u8, armed: bool) -> Vehicle {
        Vehicle {
            system: SystemId(system),
            component: ComponentId(1),
            autopilot: AutopilotKind::from_wire(autopilot),
            vehicle_type: 2,
            armed,
            version: None,
        }
    }

    #[test]
    fn what_is_written_is_read() {
        for system in [0, 1, 255] {
            for (autopilot, armed) in [(3, true), (12, false), (0, true)] {
                let vehicle = vehicle(system, autopilot, armed);
                let mark = Mark::Follows { vehicle, anew: armed };
                assert_eq!(again(&mark), Some(mark));
            }
        }
        for how in [HeardAs::Listened, HeardAs::Sensor, HeardAs::Beside] {
            assert_eq!(again(&Mark::Heard(how)), Some(Mark::Heard(how)));
        }
        assert_eq!(again(&Mark::HeardOfOurs), Some(Mark::HeardOfOurs));
        for on in [StandsOn::Unknown, StandsOn::Gnss, StandsOn::Ours, StandsOn::Nothing] {
            assert_eq!(again(&Mark::Stands(on)), Some(Mark::Stands(on)));
        }
        let state: Vec<u8> = (0..2000_u32).map(|i| (i % 7) as u8).collect();
        let mut joined = Vec::new();
        let pieces = Mark::kept(&state);
        for (i, piece) in pieces.iter().enumerate() {
            let Some(Mark::Kept { index, of, bytes }) = again(piece) else { panic!("{piece:?}") };
            assert_eq!((usize::from(index), usize::from(of)), (i, pieces.len()));
            joined.extend(bytes);
        }
        assert_eq!(joined, state);
    }

    #[test]
    fn keys_and_what_looks_like_a_mark_are_withheld() {
        let from = Address { system: SystemId(255), component: ComponentId(190) };
        let key = SETUP_SIGNING_DATA { secret_key: [7; 32], ..SETUP_SIGNING_DATA::DEFAULT };
        let key = FrameWriter::new(from).write(&MavMessage::SETUP_SIGNING(key)).unwrap();
        let mark = MarkWriter::new().write(&Mark::Lost(3)).unwrap();
        let beat = FrameWriter::new(from).write(&heartbeat(SystemStatus::Active, 0)).unwrap();
        let withheld = [key, mark, beat].map(|bytes| is_withheld(&bytes.frame().unwrap()));
        assert_eq!(withheld, [true, true, false]);
        // Of another component it is no mark.
        let V2_EXTENSION_DATA { payload, .. } = V2_EXTENSION_DATA::DEFAULT;
        let other = V2_EXTENSION_DATA { message_type: MESSAGE_TYPE, payload, ..V2_EXTENSION_DATA::DEFAULT };
        let other = FrameWriter::new(from).write(&MavMessage::V2_EXTENSION(other)).unwrap();
        assert_eq!(Mark::of(&other.frame().unwrap()), None);
    }

    #[test]
    fn an_interval_that_is_none_is_no_mark() {
        for (from_s, to_s) in [(5.0, 5.0), (-1.0, 3.0), (f64::NAN, 3.0), (3.0, f64::NAN)] {
            assert_eq!(again(&Mark::Drill { from_s, to_s }), None);
        }
    }

    proptest! {
        #[test]
        fn numbers_are_read_as_they_were_written(run: u32, part: u32, frames: u32, from in 0.0..1e6, len in 1e-3..1e6) {
            for mark in [Mark::Part { run, part }, Mark::Lost(frames), Mark::Drill { from_s: from, to_s: from + len }] {
                prop_assert_eq!(again(&mark), Some(mark));
            }
        }

        #[test]
        fn whatever_else_stands_there_does_no_harm(bytes: Vec<u8>) {
            if let Some(mark) = read(&mut &bytes[..]) {
                let mut said = Vec::new();
                say(&mark, &mut said).unwrap();
                prop_assert_eq!(read(&mut &said[..]), Some(mark));
            }
        }
    }
}
