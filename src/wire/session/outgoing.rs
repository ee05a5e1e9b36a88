//! Turns messages into MAVLink 2 frames.

use mavlink::dialects::ardupilotmega::MavMessage;
use mavlink::{MAVLinkV2MessageRaw, MavHeader};

use super::Address;
use crate::wire::frame_bytes::FrameBytes;

/// Serialises messages of one sender on one link, and numbers them.
///
/// The receiver estimates losses from the numbers, so each link has a writer of its own.
#[derive(Clone, Debug)]
pub struct FrameWriter {
    from: Address,
    sequence: u8,
}

impl FrameWriter {
    /// A writer that speaks as `from` and begins at number 0.
    pub fn new(from: Address) -> Self {
        Self { from, sequence: 0 }
    }

    /// Who speaks.
    pub fn from(&self) -> Address {
        self.from
    }

    /// The frame of `message`, with the next sequence number. `None` only for a message longer than a frame, which no
    /// message of the dialect is.
    pub fn write(&mut self, message: &MavMessage) -> Option<FrameBytes> {
        let header = MavHeader {
            system_id: u32::from(self.from.system.0),
            component_id: self.from.component.0,
            sequence: self.sequence,
        };
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message(header, message);
        let bytes = FrameBytes::new(raw.raw_bytes())?;
        self.sequence = self.sequence.wrapping_add(1);
        Some(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::super::heartbeat::{SystemStatus, heartbeat};
    use super::*;
    use crate::wire::frame::{ComponentId, Scan, SystemId, scan};

    #[test]
    fn frames_are_valid_and_numbered_from_0_to_255_and_again() {
        let from = Address { system: SystemId(9), component: ComponentId::ODOMETRY_SOURCE };
        let mut writer = FrameWriter::new(from);
        let message = heartbeat(SystemStatus::Active, 42);
        for i in 0..300u32 {
            let bytes = writer.write(&message).unwrap();
            let Scan::Frame(frame) = scan(&bytes, true) else { panic!("frame {i} is not valid") };
            assert_eq!(u32::from(frame.sequence()), i % 256);
            assert_eq!((frame.system(), frame.component()), (from.system, from.component));
            assert_eq!(frame.parse().unwrap(), message);
            assert_eq!(frame.len(), bytes.len());
        }
    }
}
