//! Holdover's own HEARTBEAT: once a second, so that autopilot and ground station know who is there and how it fares.

use mavlink::dialects::ardupilotmega::{
    HEARTBEAT_DATA, MavAutopilot, MavMessage, MavModeFlag, MavState, MavType,
};

use crate::time::{Companion, Span, Stamp};

/// What Holdover tells the world of itself, in `system_status`.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SystemStatus {
    /// Starting: no autopilot yet, or no solution yet.
    Boot,
    /// Finding attitude and place.
    Standby,
    /// Navigating: with GNSS, or without.
    Active,
    /// The solution is worse than the configuration allows, or its inputs are stale.
    Critical,
    /// Ends by request.
    PowerOff,
}

impl SystemStatus {
    fn mav_state(self) -> MavState {
        match self {
            SystemStatus::Boot => MavState::MAV_STATE_BOOT,
            SystemStatus::Standby => MavState::MAV_STATE_STANDBY,
            SystemStatus::Active => MavState::MAV_STATE_ACTIVE,
            SystemStatus::Critical => MavState::MAV_STATE_CRITICAL,
            SystemStatus::PowerOff => MavState::MAV_STATE_POWEROFF,
        }
    }
}

/// Sends a HEARTBEAT every period.
#[derive(Clone, Debug)]
pub struct HeartbeatSender {
    period: Span,
    due: Option<Stamp<Companion>>,
}

impl HeartbeatSender {
    /// The period that autopilots expect.
    pub const PERIOD: Span = Span::from_millis(1000);

    /// A sender whose first heartbeat is due at once.
    pub fn new(period: Span) -> Self {
        Self { period, due: None }
    }

    /// The heartbeat to send now, if one is due. `code` goes out as `custom_mode`.
    pub fn poll(&mut self, now: Stamp<Companion>, health: SystemStatus, code: u32) -> Option<MavMessage> {
        if self.due.is_some_and(|due| now < due) {
            return None;
        }
        // After a stall the rhythm starts anew: beats that were missed are not made up for.
        self.due = match self.due {
            Some(due) if now - due < self.period => Some(due + self.period),
            _ => Some(now + self.period),
        };
        Some(heartbeat(health, code))
    }
}

impl Default for HeartbeatSender {
    fn default() -> Self {
        Self::new(Self::PERIOD)
    }
}

/// A HEARTBEAT of an onboard controller that is no autopilot and is never armed.
pub fn heartbeat(health: SystemStatus, code: u32) -> MavMessage {
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: code,
        mavtype: MavType::MAV_TYPE_ONBOARD_CONTROLLER,
        autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
        base_mode: MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED,
        system_status: health.mav_state(),
        mavlink_version: 3,
    })
}

#[cfg(test)]
mod tests {
    use super::super::heartbeat_fields::HeartbeatFields;
    use super::super::heartbeat_fields::testing::frame_of;
    use super::*;

    fn at(ms: i64) -> Stamp<Companion> {
        Stamp::from_micros(ms * 1000)
    }

    #[test]
    fn beats_once_a_second_whenever_it_is_polled() {
        let mut sender = HeartbeatSender::default();
        let beats = (0..10_000).step_by(7).filter(|&ms| sender.poll(at(ms), SystemStatus::Boot, 0).is_some());
        assert_eq!(beats.count(), 10);
    }

    #[test]
    fn missed_beats_are_not_made_up_for() {
        let mut sender = HeartbeatSender::default();
        assert!(sender.poll(at(0), SystemStatus::Active, 0).is_some());
        assert!(sender.poll(at(60_000), SystemStatus::Active, 0).is_some());
        assert!(sender.poll(at(60_001), SystemStatus::Active, 0).is_none());
    }

    #[test]
    fn never_says_armed_and_is_never_taken_for_an_autopilot() {
        let frame = frame_of(1, 197, &heartbeat(SystemStatus::Active, 7));
        let fields = HeartbeatFields::read(&frame.frame().unwrap()).unwrap();
        assert!(!fields.armed() && !fields.is_autopilot());
        assert_eq!((fields.custom_mode, fields.vehicle_type, fields.autopilot), (7, 18, 8));
        assert_eq!((fields.base_mode, fields.system_status, fields.mavlink_version), (1, 4, 3));
    }
}
