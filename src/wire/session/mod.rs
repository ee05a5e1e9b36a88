//! The conversations Holdover holds with an autopilot, as state machines without input or output of their own.
//!
//! Each is told what was heard and what time it is, and returns the messages to send. None of them reads a clock or knows a
//! link, so a test plays an hour of flight in a millisecond, and the same messages at the same times give the same answers.

pub mod autopilot;
mod clock_line;
pub mod estimator_report;
pub mod fusion;
pub mod hand_over;
pub mod heartbeat;
pub mod heartbeat_fields;
pub mod identity;
#[allow(deprecated, reason = "its successor is a command that the autopilots in use do not know")]
mod origin_offer;
pub mod outgoing;
pub mod parameter_value;
pub mod parameters;
mod rate_meter;
pub mod requests;
pub mod source_switch;
pub mod standing_watch;
pub mod status_text;
pub mod status_text_sender;
pub mod streams;
pub mod timesync;
pub mod transmitter;

use mavlink::dialects::ardupilotmega::{COMMAND_LONG_DATA, MavCmd, MavMessage};

use super::frame::{ComponentId, SystemId};

/// Who speaks, or who is spoken to.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Address {
    /// The vehicle or ground station.
    pub system: SystemId,
    /// The part of it.
    pub component: ComponentId,
}

impl Address {
    /// Whether a message with these target fields is for this address. Zero is everyone.
    pub fn is_meant_by(self, target_system: u8, target_component: u8) -> bool {
        (target_system == 0 || target_system == self.system.0)
            && (target_component == 0 || target_component == self.component.0)
    }
}

/// A `COMMAND_LONG` of two parameters; the others are 0.
fn command_long(to: Address, command: MavCmd, param1: f32, param2: f32) -> MavMessage {
    MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
        param1,
        param2,
        param3: 0.0,
        param4: 0.0,
        param5: 0.0,
        param6: 0.0,
        param7: 0.0,
        command,
        target_system: to.system.0,
        target_component: to.component.0,
        confirmation: 0,
    })
}

/// Asks for one copy of a message (`MAV_CMD_REQUEST_MESSAGE`).
pub fn request_message(to: Address, message_id: u32) -> MavMessage {
    command_long(to, MavCmd::MAV_CMD_REQUEST_MESSAGE, message_id as f32, 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_target_of_zero_is_everyone() {
        let us = Address { system: SystemId(1), component: ComponentId(197) };
        assert!(us.is_meant_by(0, 0) && us.is_meant_by(1, 0) && us.is_meant_by(1, 197));
        assert!(!us.is_meant_by(2, 0) && !us.is_meant_by(1, 1) && !us.is_meant_by(0, 1));
    }
}
