//! HEARTBEAT as it stands on the wire.
//!
//! The typed message is refused when an enumerated field has a value that the dialect does not know, and newer firmware brings
//! new vehicle types. A heartbeat decides which autopilot Holdover serves, so its nine bytes are read here as plain numbers.

use mavlink::MessageData;
use mavlink::dialects::ardupilotmega::HEARTBEAT_DATA;

use super::super::frame::Frame;

const AUTOPILOT_INVALID: u8 = 8;
const FLAG_SAFETY_ARMED: u8 = 0x80;

/// `MAV_TYPE`s of things that are not vehicles: antenna tracker, ground station, onboard controller, gimbal, ADSB, camera,
/// charging station, FLARM, servo, remote id, battery, parachute, log, OSD, IMU, GPS, winch, illuminator, gripper, radio.
const NOT_VEHICLES: [u8; 20] = [5, 6, 18, 26, 27, 30, 31, 32, 33, 34, 36, 37, 38, 39, 40, 41, 42, 44, 48, 49];

/// The fields of a HEARTBEAT.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct HeartbeatFields {
    /// The autopilot's own flight mode number.
    pub custom_mode: u32,
    /// `MAV_TYPE`.
    pub vehicle_type: u8,
    /// `MAV_AUTOPILOT`.
    pub autopilot: u8,
    /// `MAV_MODE_FLAG` bits.
    pub base_mode: u8,
    /// `MAV_STATE`.
    pub system_status: u8,
    /// Minor version of the protocol.
    pub mavlink_version: u8,
}

impl HeartbeatFields {
    /// Reads them from a frame whose checksum was tested; `None` if it is not a HEARTBEAT.
    pub fn read(frame: &Frame<'_>) -> Option<Self> {
        if frame.message_id() != HEARTBEAT_DATA::ID {
            return None;
        }
        // MAVLink 2 cuts trailing zeros, and a newer definition may append fields.
        let mut bytes = [0u8; 9];
        for (field, sent) in bytes.iter_mut().zip(frame.payload()) {
            *field = *sent;
        }
        let [m0, m1, m2, m3, vehicle_type, autopilot, base_mode, system_status, mavlink_version] = bytes;
        Some(Self {
            custom_mode: u32::from_le_bytes([m0, m1, m2, m3]),
            vehicle_type,
            autopilot,
            base_mode,
            system_status,
            mavlink_version,
        })
    }

    /// Whether an autopilot that flies or drives something sent it, and not a ground station, a camera or a companion.
    pub fn is_autopilot(&self) -> bool {
        self.autopilot != AUTOPILOT_INVALID && !NOT_VEHICLES.contains(&self.vehicle_type)
    }

    /// Whether the vehicle is armed.
    pub fn armed(&self) -> bool {
        self.base_mode & FLAG_SAFETY_ARMED != 0
    }
}

#[cfg(test)]
pub(crate) mod testing {
    use mavlink::dialects::ardupilotmega::MavMessage;
    use mavlink::{MAVLinkV2MessageRaw, Message};

    use crate::wire::frame_bytes::FrameBytes;

    /// A MAVLink 2 HEARTBEAT frame with the raw values given, which need not be in the dialect.
    pub(crate) fn heartbeat_frame(
        system: u8,
        component: u8,
        vehicle_type: u8,
        autopilot: u8,
        base_mode: u8,
    ) -> FrameBytes {
        let mut bytes = vec![0xFD, 9, 0, 0, 0, system, component, 0, 0, 0];
        bytes.extend([4, 3, 2, 1, vehicle_type, autopilot, base_mode, 4, 3]);
        let crc = mavlink::calculate_crc(&bytes[1..], MavMessage::extra_crc(0));
        bytes.extend(crc.to_le_bytes());
        FrameBytes::new(&bytes).unwrap()
    }

    /// A frame of `message` from `system` and `component`.
    pub(crate) fn frame_of(system: u8, component: u8, message: &MavMessage) -> FrameBytes {
        let header =
            mavlink::MavHeader { system_id: u32::from(system), component_id: component, sequence: 0 };
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message(header, message);
        FrameBytes::new(raw.raw_bytes()).unwrap()
    }
}

#[cfg(test)]
mod tests {
    use super::testing::heartbeat_frame;
    use super::*;
    use crate::wire::frame::{Scan, scan};

    #[test]
    fn fields_stand_where_the_wire_has_them() {
        let bytes = heartbeat_frame(1, 1, 2, 3, 0x81);
        let Scan::Frame(frame) = scan(&bytes, true) else { panic!("no frame") };
        let fields = HeartbeatFields::read(&frame).unwrap();
        assert_eq!(fields.custom_mode, 0x0102_0304);
        assert_eq!((fields.vehicle_type, fields.autopilot, fields.base_mode), (2, 3, 0x81));
        assert_eq!((fields.system_status, fields.mavlink_version), (4, 3));
        assert!(fields.armed() && fields.is_autopilot());
    }

    #[test]
    fn unknown_vehicle_types_are_still_autopilots() {
        let bytes = heartbeat_frame(1, 1, 250, 12, 0);
        let Scan::Frame(frame) = scan(&bytes, true) else { panic!("no frame") };
        assert!(frame.parse().is_err(), "the dialect now knows type 250: choose another");
        assert!(HeartbeatFields::read(&frame).unwrap().is_autopilot());
    }

    #[test]
    fn ground_stations_cameras_and_companions_are_not() {
        for (vehicle_type, autopilot) in [(6, 3), (18, 3), (26, 3), (30, 12), (2, 8)] {
            let bytes = heartbeat_frame(1, 1, vehicle_type, autopilot, 0);
            let fields = HeartbeatFields::read(&bytes.frame().unwrap()).unwrap();
            assert!(!fields.is_autopilot(), "type {vehicle_type}, autopilot {autopilot}");
        }
    }
}
