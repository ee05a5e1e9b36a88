//! PARAM_VALUE as it stands on the wire, and what its number means.
//!
//! A parameter's value travels in a 32-bit float field whatever its type. ArduPilot puts the value there as a float (`C_CAST`), PX4 the
//! bytes of the integer (`BYTEWISE`): 6 as an integer then reads as 8.4e-45. Which it is stands in AUTOPILOT_VERSION's capabilities. The
//! payload is read as bytes: a float that is no number keeps its bits, and a type that the dialect does not know is no reason to fail.

use std::fmt;

use mavlink::MessageData;
use mavlink::dialects::ardupilotmega::{AUTOPILOT_VERSION_DATA, MavParamType, PARAM_VALUE_DATA};

use super::identity::AutopilotKind;
use crate::wire::frame::Frame;

/// `MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE`.
const CAPABILITY_BYTEWISE: u64 = 16;

/// A parameter's name: 1 to 16 of `A-Z`, `a-z`, `0-9` and `_`.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ParameterName([u8; 16]);

impl ParameterName {
    /// The name; `None` if it can be none.
    pub fn new(text: &str) -> Option<Self> {
        let mut bytes = [0; 16];
        bytes.get_mut(..text.len())?.copy_from_slice(text.as_bytes());
        Self::from_wire(bytes)
    }

    /// The name in a `param_id`, which ends at its first zero.
    pub fn from_wire(mut bytes: [u8; 16]) -> Option<Self> {
        let end = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
        bytes[end..].fill(0);
        let legal = bytes[..end].iter().all(|b| b.is_ascii_alphanumeric() || *b == b'_');
        (end > 0 && legal).then_some(Self(bytes))
    }

    /// As a `param_id`, zeros at its end.
    pub fn bytes(&self) -> [u8; 16] {
        self.0
    }

    /// As text.
    pub fn as_str(&self) -> &str {
        let end = self.0.iter().position(|&b| b == 0).unwrap_or(self.0.len());
        // Only ASCII gets in.
        std::str::from_utf8(&self.0[..end]).unwrap_or_default()
    }
}

impl fmt::Display for ParameterName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl fmt::Debug for ParameterName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// A PARAM_VALUE: whose, the four bytes of the value, and their type.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ParameterValue {
    /// Whose value.
    pub name: ParameterName,
    /// `param_value`, little endian.
    pub bits: [u8; 4],
    /// `MAV_PARAM_TYPE`.
    pub kind: u8,
}

impl ParameterValue {
    /// Reads it from a frame whose checksum was tested; `None` if it is no PARAM_VALUE, or its name can be none.
    pub fn read(frame: &Frame<'_>) -> Option<Self> {
        if frame.message_id() != PARAM_VALUE_DATA::ID {
            return None;
        }
        // MAVLink 2 cuts trailing zeros.
        let mut bytes = [0u8; PARAM_VALUE_DATA::ENCODED_LEN];
        for (field, sent) in bytes.iter_mut().zip(frame.payload()) {
            *field = *sent;
        }
        let [b0, b1, b2, b3, _, _, _, _, id @ .., kind] = bytes;
        Some(Self { name: ParameterName::from_wire(id)?, bits: [b0, b1, b2, b3], kind })
    }

    /// The number; `None` for one that is not finite, and for types that do not fit into the field.
    pub fn number(&self, encoding: ParameterEncoding) -> Option<f64> {
        encoding.decode(self.bits, self.kind)
    }

    /// The same parameter with another number; `None` if its type cannot hold that.
    pub fn with(&self, encoding: ParameterEncoding, number: f64) -> Option<Self> {
        let bits = encoding.encode(number, self.kind)?;
        Some(Self { bits, ..*self })
    }

    /// The type, where the dialect knows it.
    pub(super) fn wire_type(&self) -> Option<MavParamType> {
        Some(match self.kind {
            1 => MavParamType::MAV_PARAM_TYPE_UINT8,
            2 => MavParamType::MAV_PARAM_TYPE_INT8,
            3 => MavParamType::MAV_PARAM_TYPE_UINT16,
            4 => MavParamType::MAV_PARAM_TYPE_INT16,
            5 => MavParamType::MAV_PARAM_TYPE_UINT32,
            6 => MavParamType::MAV_PARAM_TYPE_INT32,
            9 => MavParamType::MAV_PARAM_TYPE_REAL32,
            _ => return None,
        })
    }
}

/// How an autopilot puts integers into the float field.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ParameterEncoding {
    /// As the float of the same value (ArduPilot).
    Cast,
    /// As their own bytes (PX4).
    Bytewise,
}

impl ParameterEncoding {
    /// By the capabilities in AUTOPILOT_VERSION; without them by what this kind of autopilot does.
    pub fn of(capabilities: Option<u64>, autopilot: AutopilotKind) -> Self {
        let bytewise = match capabilities {
            Some(bits) => bits & CAPABILITY_BYTEWISE != 0,
            None => autopilot == AutopilotKind::Px4,
        };
        if bytewise { Self::Bytewise } else { Self::Cast }
    }

    fn decode(self, bits: [u8; 4], kind: u8) -> Option<f64> {
        let float = f64::from(f32::from_le_bytes(bits));
        let [b0, b1, _, _] = bits;
        let number = match (self, kind) {
            (_, 9) | (Self::Cast, 1..=6) => float,
            (Self::Bytewise, 1) => f64::from(b0),
            (Self::Bytewise, 2) => f64::from(i8::from_le_bytes([b0])),
            (Self::Bytewise, 3) => f64::from(u16::from_le_bytes([b0, b1])),
            (Self::Bytewise, 4) => f64::from(i16::from_le_bytes([b0, b1])),
            (Self::Bytewise, 5) => f64::from(u32::from_le_bytes(bits)),
            (Self::Bytewise, 6) => f64::from(i32::from_le_bytes(bits)),
            _ => return None,
        };
        number.is_finite().then_some(number)
    }

    fn encode(self, number: f64, kind: u8) -> Option<[u8; 4]> {
        if kind == 9 {
            return number.is_finite().then(|| (number as f32).to_le_bytes());
        }
        let (low, high) = range(kind)?;
        let fits = number.fract() == 0.0 && (low..=high).contains(&number);
        fits.then(|| match self {
            // The low bytes of a longer integer are those of the shorter one.
            Self::Bytewise => (number as i64 as u32).to_le_bytes(),
            Self::Cast => (number as f32).to_le_bytes(),
        })
    }
}

/// What an integer of this `MAV_PARAM_TYPE` can hold.
fn range(kind: u8) -> Option<(f64, f64)> {
    let (low, high) = match kind {
        1 => (0, i64::from(u8::MAX)),
        2 => (i64::from(i8::MIN), i64::from(i8::MAX)),
        3 => (0, i64::from(u16::MAX)),
        4 => (i64::from(i16::MIN), i64::from(i16::MAX)),
        5 => (0, i64::from(u32::MAX)),
        6 => (i64::from(i32::MIN), i64::from(i32::MAX)),
        _ => return None,
    };
    Some((low as f64, high as f64))
}

/// The capabilities that an AUTOPILOT_VERSION tells; `None` if the frame is none.
pub fn capabilities(frame: &Frame<'_>) -> Option<u64> {
    if frame.message_id() != AUTOPILOT_VERSION_DATA::ID {
        return None;
    }
    let mut bytes = [0u8; 8];
    for (field, sent) in bytes.iter_mut().zip(frame.payload()) {
        *field = *sent;
    }
    Some(u64::from_le_bytes(bytes))
}

#[cfg(test)]
mod tests {
    use mavlink::dialects::ardupilotmega::MavMessage;
    use proptest::prelude::*;

    use super::super::heartbeat_fields::testing::frame_of;
    use super::*;
    use crate::wire::frame_bytes::FrameBytes;

    /// A frame of PARAM_VALUE with this payload.
    fn frame(payload: &[u8]) -> FrameBytes {
        let mut bytes = vec![0xFD, payload.len() as u8, 0, 0, 0, 1, 1, 22, 0, 0];
        bytes.extend(payload);
        let crc = mavlink::calculate_crc(
            &bytes[1..],
            <MavMessage as mavlink::Message>::extra_crc(PARAM_VALUE_DATA::ID),
        );
        bytes.extend(crc.to_le_bytes());
        FrameBytes::new(&bytes).unwrap()
    }

    fn value(bits: [u8; 4], kind: u8) -> ParameterValue {
        ParameterValue { name: ParameterName::new("EKF2_EV_CTRL").unwrap(), bits, kind }
    }

    #[test]
    fn both_manners_of_sending_an_integer_are_read() {
        let (cast, bytewise) = (ParameterEncoding::Cast, ParameterEncoding::Bytewise);
        assert_eq!(value(15f32.to_le_bytes(), 2).number(cast), Some(15.0));
        assert_eq!(value(15i32.to_le_bytes(), 6).number(bytewise), Some(15.0));
        // All bits set: no number as a float.
        assert_eq!(value((-1i32).to_le_bytes(), 6).number(bytewise), Some(-1.0));
        assert_eq!(value((-1i32).to_le_bytes(), 6).number(cast), None);
        assert_eq!(value(0.5f32.to_le_bytes(), 9).number(bytewise), Some(0.5));
        assert_eq!(value([1; 4], 10).number(bytewise), None);
    }

    #[test]
    fn the_capability_decides_and_the_kind_where_it_is_not_told() {
        let of = ParameterEncoding::of;
        assert_eq!(of(Some(0x12), AutopilotKind::ArduPilot), ParameterEncoding::Bytewise);
        assert_eq!(of(Some(0x02), AutopilotKind::Px4), ParameterEncoding::Cast);
        assert_eq!(of(None, AutopilotKind::Px4), ParameterEncoding::Bytewise);
        assert_eq!(of(None, AutopilotKind::ArduPilot), ParameterEncoding::Cast);
    }

    #[test]
    fn a_frame_is_read_as_it_was_written() {
        let data = PARAM_VALUE_DATA {
            param_value: f32::from_bits(7),
            param_count: 900,
            param_index: 3,
            param_id: "EKF2_EV_CTRL".into(),
            param_type: MavParamType::MAV_PARAM_TYPE_INT32,
        };
        let bytes = frame_of(1, 1, &MavMessage::PARAM_VALUE(data));
        assert_eq!(ParameterValue::read(&bytes.frame().unwrap()), Some(value(7u32.to_le_bytes(), 6)));
        assert_eq!(capabilities(&bytes.frame().unwrap()), None);
    }

    #[test]
    fn a_type_holds_what_it_can_hold() {
        for encoding in [ParameterEncoding::Cast, ParameterEncoding::Bytewise] {
            for (kind, bad) in [(1, 256.0), (2, -129.0), (3, -1.0), (4, 40_000.0), (6, 0.5), (9, f64::NAN)] {
                assert_eq!(value([0; 4], kind).with(encoding, bad), None, "{kind}");
            }
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_without_fault(payload in prop::collection::vec(any::<u8>(), 0..40)) {
            let bytes = frame(&payload);
            let Some(read) = ParameterValue::read(&bytes.frame().unwrap()) else { return Ok(()) };
            prop_assert!((1..=16).contains(&read.name.as_str().len()));
            prop_assert_eq!(ParameterName::new(read.name.as_str()), Some(read.name));
            for encoding in [ParameterEncoding::Cast, ParameterEncoding::Bytewise] {
                if let Some(number) = read.number(encoding) {
                    prop_assert!(number.is_finite());
                }
            }
        }

        #[test]
        fn what_a_type_can_hold_comes_back(kind in prop::sample::select(vec![1u8, 2, 3, 4, 6, 9]), number in -300i32..300) {
            let number = f64::from(number);
            for encoding in [ParameterEncoding::Cast, ParameterEncoding::Bytewise] {
                if let Some(set) = value([0; 4], kind).with(encoding, number) {
                    prop_assert_eq!(set.number(encoding), Some(number));
                }
            }
        }
    }
}
