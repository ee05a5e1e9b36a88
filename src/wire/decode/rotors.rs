//! How fast rotors turn, as speed controllers tell through the autopilot.

use mavlink::dialects::ardupilotmega::MavMessage;

use super::super::frame::Frame;
use super::super::messages::{Meaning, meaning_of};

/// Speeds of four rotors that follow each other, turns a minute.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RotorWord {
    /// Which the first of them is of.
    pub first: u8,
    /// 0 where there is none.
    pub rpm: [f64; 4],
}

impl RotorWord {
    /// What a frame tells of them; `None` if it is of something else, or damaged.
    pub fn of(frame: &Frame<'_>) -> Option<Self> {
        if meaning_of(frame.message_id()) != Some(Meaning::Rotors) {
            return None;
        }
        let of = |first, rpm: [u16; 4]| Some(Self { first, rpm: rpm.map(f64::from) });
        match frame.parse().ok()? {
            MavMessage::ESC_STATUS(m) => Some(Self { first: m.index, rpm: m.rpm.map(f64::from) }),
            MavMessage::ESC_TELEMETRY_1_TO_4(m) => of(0, m.rpm),
            MavMessage::ESC_TELEMETRY_5_TO_8(m) => of(4, m.rpm),
            MavMessage::ESC_TELEMETRY_9_TO_12(m) => of(8, m.rpm),
            _ => None,
        }
    }
}
