//! MAVLink 1 and 2 frames in a buffer of bytes: finds them, checks them, and says what is wrong with what is no frame.
//!
//! The mavlink crate's readers skip damaged frames without a word; Holdover counts them, so the search for a frame is done
//! here, on the crate's message parsers. A damaged frame costs that frame only: the search goes on at its second
//! byte.

use mavlink::dialects::ardupilotmega::MavMessage;
use mavlink::error::ParserError;
use mavlink::{MavlinkVersion, Message};

use super::counters::Cause;
use super::gnss_integrity;
use super::running_crc::{RunningCrc, checksum, digest};

/// A MAVLink system id (a vehicle or a ground station).
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct SystemId(pub u8);

/// A MAVLink component id (a part of a system; 1 is the autopilot).
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct ComponentId(pub u8);

impl ComponentId {
    /// `MAV_COMP_ID_AUTOPILOT1`.
    pub const AUTOPILOT: ComponentId = ComponentId(1);
    /// `MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY`, the component that Holdover speaks as.
    pub const ODOMETRY_SOURCE: ComponentId = ComponentId(197);
}

/// The longest frame there is: MAVLink 2, full payload, signed.
pub const MAX_FRAME_LEN: usize = 280;

const STX_V1: u8 = 0xFE;
const STX_V2: u8 = 0xFD;
const FLAG_SIGNED: u8 = 0x01;

/// A frame with a valid checksum, or one of a message id that the dialect does not know (whose checksum cannot be tested).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame<'a> {
    bytes: &'a [u8],
    version: MavlinkVersion,
}

/// What stands at the start of a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scan<'a> {
    /// A frame; it is [`Frame::len`] bytes long.
    Frame(Frame<'a>),
    /// A frame of a message that is not in the dialect: its checksum cannot be tested.
    Unknown(Frame<'a>),
    /// The first `skip` bytes are no frame, for this cause.
    Skip {
        /// Bytes to leave behind; at least 1.
        skip: usize,
        /// [`Cause::BadChecksum`] (one damaged frame) or [`Cause::Garbage`].
        cause: Cause,
    },
    /// The buffer may begin with a frame but ends before it does.
    Incomplete,
}

/// Looks at the start of `bytes`. With `at_end` no more bytes will come, so a frame need not be followed by anything.
pub fn scan(bytes: &[u8], at_end: bool) -> Scan<'_> {
    scan_by(bytes, at_end, Frame::carries_its_checksum)
}

/// [`scan`], with `fits` to say whether a frame's checksum is right. It is asked once, of a frame that is whole and whose message is known,
/// with the message's `CRC_EXTRA`.
pub(super) fn scan_by<'a>(
    bytes: &'a [u8],
    at_end: bool,
    fits: impl FnOnce(&Frame<'a>, u8) -> bool,
) -> Scan<'a> {
    let Some(start) = bytes.iter().position(|&b| b == STX_V1 || b == STX_V2) else {
        return if bytes.is_empty() {
            Scan::Incomplete
        } else {
            Scan::Skip { skip: bytes.len(), cause: Cause::Garbage }
        };
    };
    if start > 0 {
        return Scan::Skip { skip: start, cause: Cause::Garbage };
    }
    match candidate(bytes) {
        Candidate::Short => Scan::Incomplete,
        Candidate::NoFrame => Scan::Skip { skip: 1, cause: Cause::Garbage },
        Candidate::Frame(frame) => classify(frame, bytes.get(frame.len()), at_end, fits),
    }
}

/// The frame that `bytes` must be, whole and nothing else than followed by other data: for containers that say where a frame
/// starts (a tlog record, a datagram).
pub(super) enum Candidate<'a> {
    Short,
    NoFrame,
    Frame(Frame<'a>),
}

pub(super) fn candidate(bytes: &[u8]) -> Candidate<'_> {
    let Some((&stx, rest)) = bytes.split_first() else { return Candidate::Short };
    let (version, len) = match stx {
        STX_V1 => match rest.first() {
            Some(&n) => (MavlinkVersion::V1, 8 + usize::from(n)),
            None => return Candidate::Short,
        },
        STX_V2 => match (rest.first(), rest.get(1)) {
            (Some(_), Some(&flags)) if flags & !FLAG_SIGNED != 0 => return Candidate::NoFrame,
            (Some(&n), Some(&flags)) => {
                let signature = if flags & FLAG_SIGNED != 0 { 13 } else { 0 };
                (MavlinkVersion::V2, 12 + usize::from(n) + signature)
            }
            _ => return Candidate::Short,
        },
        _ => return Candidate::NoFrame,
    };
    match bytes.get(..len) {
        Some(whole) => Candidate::Frame(Frame { bytes: whole, version }),
        None => Candidate::Short,
    }
}

fn classify<'a>(
    frame: Frame<'a>,
    next: Option<&u8>,
    at_end: bool,
    fits: impl FnOnce(&Frame<'a>, u8) -> bool,
) -> Scan<'a> {
    if let Some(extra) = extra_crc(frame.message_id()) {
        return if fits(&frame, extra) {
            Scan::Frame(frame)
        } else {
            Scan::Skip { skip: 1, cause: Cause::BadChecksum }
        };
    }
    // An unknown id may be a newer message or garbage that happens to hold a start byte. What follows tells them apart.
    match next {
        Some(&b) if b == STX_V1 || b == STX_V2 => Scan::Unknown(frame),
        Some(_) => Scan::Skip { skip: 1, cause: Cause::Garbage },
        None if at_end => Scan::Unknown(frame),
        None => Scan::Incomplete,
    }
}

impl<'a> Frame<'a> {
    /// The whole frame, from the start byte to the checksum or signature.
    pub fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Length of the whole frame in bytes.
    #[allow(clippy::len_without_is_empty)]
    pub fn len(&self) -> usize {
        self.bytes.len()
    }

    /// MAVLink 1 or 2.
    pub fn version(&self) -> MavlinkVersion {
        self.version
    }

    /// Whether it is MAVLink 1, which has no ids above 255.
    pub fn is_mavlink1(&self) -> bool {
        self.version == MavlinkVersion::V1
    }

    /// Whether a signature stands behind the checksum.
    pub fn is_signed(&self) -> bool {
        !self.is_mavlink1() && self.bytes[2] & FLAG_SIGNED != 0
    }

    fn header_len(&self) -> usize {
        match self.version {
            MavlinkVersion::V1 => 6,
            MavlinkVersion::V2 => 10,
        }
    }

    /// The payload as sent (MAVLink 2 cuts trailing zeros).
    pub fn payload(&self) -> &'a [u8] {
        let n = usize::from(self.bytes[1]);
        &self.bytes[self.header_len()..self.header_len() + n]
    }

    /// The sender's system id.
    pub fn system(&self) -> SystemId {
        SystemId(match self.version {
            MavlinkVersion::V1 => self.bytes[3],
            MavlinkVersion::V2 => self.bytes[5],
        })
    }

    /// The sender's component id.
    pub fn component(&self) -> ComponentId {
        ComponentId(match self.version {
            MavlinkVersion::V1 => self.bytes[4],
            MavlinkVersion::V2 => self.bytes[6],
        })
    }

    /// The sender's sequence number.
    pub fn sequence(&self) -> u8 {
        match self.version {
            MavlinkVersion::V1 => self.bytes[2],
            MavlinkVersion::V2 => self.bytes[4],
        }
    }

    /// Number of the message.
    pub fn message_id(&self) -> u32 {
        match self.version {
            MavlinkVersion::V1 => u32::from(self.bytes[5]),
            MavlinkVersion::V2 => u32::from_le_bytes([self.bytes[7], self.bytes[8], self.bytes[9], 0]),
        }
    }

    /// Whether the message is in the dialect, or one that is read without it.
    pub fn known(&self) -> bool {
        extra_crc(self.message_id()).is_some()
    }

    /// Whether the checksum is right, taking the dialect's `CRC_EXTRA`. Always false for an unknown message.
    pub fn checksum_fits(&self) -> bool {
        extra_crc(self.message_id()).is_some_and(|extra| self.carries_its_checksum(extra))
    }

    fn carries_its_checksum(&self, extra: u8) -> bool {
        self.carries(checksum(&self.bytes[1..self.checksum_at()]), extra)
    }

    /// Whether the checksum is right by those of a run of bytes, for a frame that stands `ahead` bytes behind the start of `window`, at
    /// position `at` of the run. Always false for an unknown message.
    pub(super) fn fits_in(&self, crc: &mut RunningCrc, window: &[u8], at: u64, ahead: usize) -> bool {
        extra_crc(self.message_id()).is_some_and(|extra| self.agrees_with(crc, extra, window, at, ahead))
    }

    /// The same for a message whose `CRC_EXTRA` is known already.
    pub(super) fn agrees_with(
        &self,
        crc: &mut RunningCrc,
        extra: u8,
        window: &[u8],
        at: u64,
        ahead: usize,
    ) -> bool {
        let digested = crc.of(window, at, ahead + 1, self.checksum_at() - 1);
        digested.is_some_and(|crc| self.carries(crc, extra))
    }

    fn checksum_at(&self) -> usize {
        self.header_len() + usize::from(self.bytes[1])
    }

    /// Whether the frame's checksum is this one of its header and payload, with the message's `CRC_EXTRA`.
    fn carries(&self, crc: u16, extra: u8) -> bool {
        let at = self.checksum_at();
        let sent = u16::from_le_bytes([self.bytes[at], self.bytes[at + 1]]);
        digest(crc, extra) == sent
    }

    /// The typed message.
    ///
    /// # Errors
    /// An id that the dialect does not know, an enumerated field with an unknown value, or a payload that is too long.
    pub fn parse(&self) -> Result<MavMessage, ParserError> {
        MavMessage::parse(self.version, self.message_id(), self.payload())
    }
}

/// `CRC_EXTRA` of a message that is known.
pub(super) fn extra_crc(id: u32) -> Option<u8> {
    if id == gnss_integrity::ID {
        return Some(gnss_integrity::CRC_EXTRA);
    }
    match MavMessage::extra_crc(id) {
        // The dialect says 0 of what it does not know; a message may have 0 as well.
        0 => MavMessage::default_message_from_id(id).map(|_| 0),
        extra => Some(extra),
    }
}

/// The [`Cause`] under which a failed [`Frame::parse`] is counted.
pub fn cause_of(error: &ParserError) -> Cause {
    match error {
        ParserError::InvalidEnum { .. } => Cause::UnknownEnum,
        ParserError::UnknownMessage { .. } => Cause::UnknownId,
        _ => Cause::BadPayload,
    }
}
