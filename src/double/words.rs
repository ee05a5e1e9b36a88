//! STATUSTEXT as each autopilot words it.

use mavlink::dialects::ardupilotmega as apm;

use crate::sim::autopilot::VehicleNews;
use crate::wire::messages::Message;
use crate::wire::session::identity::AutopilotKind;

/// Characters of one message.
const CHUNK: usize = 50;

/// Numbers the texts that need more than one message.
#[derive(Clone, Debug, Default)]
pub struct Words {
    long: u16,
}

impl Words {
    /// The messages of a text.
    pub fn say(&mut self, severity: apm::MavSeverity, text: &str) -> Vec<Message> {
        let is_long = text.len() > CHUNK;
        self.long = if is_long { self.long.wrapping_add(1).max(1) } else { self.long };
        let id = if is_long { self.long } else { 0 };
        let chunks = text.as_bytes().chunks(CHUNK).enumerate();
        let message = |(i, chunk): (usize, &[u8])| {
            let mut bytes = [0; CHUNK];
            bytes[..chunk.len()].copy_from_slice(chunk);
            let text = bytes.into();
            Message::STATUSTEXT(apm::STATUSTEXT_DATA { severity, text, id, chunk_seq: i as u8 })
        };
        chunks.map(message).collect()
    }

    /// What the autopilot says of its news.
    pub fn news(&mut self, kind: AutopilotKind, news: VehicleNews) -> Vec<Message> {
        let text = if kind == AutopilotKind::Px4 { px4(news) } else { ardupilot(news) };
        let severity = match news {
            VehicleNews::ExternalNotHealthy | VehicleNews::NoPosition | VehicleNews::Failsafe => {
                apm::MavSeverity::MAV_SEVERITY_CRITICAL
            }
            _ => apm::MavSeverity::MAV_SEVERITY_INFO,
        };
        text.map(|text| self.say(severity, text)).unwrap_or_default()
    }

    /// ArduPilot refuses a rate.
    pub fn too_fast(&mut self, id: u32) -> Vec<Message> {
        let text = format!("Requested rate for message ID {id} too fast. Increase SCHED_LOOP_RATE");
        self.say(apm::MavSeverity::MAV_SEVERITY_INFO, &text)
    }

    /// ArduPilot does not have a message.
    pub fn no_such_message(&mut self, id: u32) -> Vec<Message> {
        self.say(apm::MavSeverity::MAV_SEVERITY_INFO, &format!("No ap_message for mavlink id ({id})"))
    }
}

/// ArduPilot's words; no text tells of a source set.
fn ardupilot(news: VehicleNews) -> Option<&'static str> {
    match news {
        VehicleNews::Armed => Some("Arming motors"),
        VehicleNews::Disarmed => Some("Disarming motors"),
        VehicleNews::ExternalNotHealthy => Some("PreArm: VisOdom: not healthy"),
        VehicleNews::NoPosition => Some("PreArm: Need Position Estimate"),
        VehicleNews::OriginSet => Some("EKF3 IMU0 origin set"),
        VehicleNews::Failsafe => Some("EKF Failsafe: changed to LAND Mode"),
        VehicleNews::SetSelected(_) => None,
    }
}

/// PX4's words; it has events for the rest.
fn px4(news: VehicleNews) -> Option<&'static str> {
    match news {
        VehicleNews::Armed => Some("Armed by external command"),
        VehicleNews::Disarmed => Some("Disarmed by landing"),
        VehicleNews::NoPosition => Some("Arming denied: no valid position"),
        VehicleNews::Failsafe => Some("Failsafe activated"),
        VehicleNews::ExternalNotHealthy | VehicleNews::OriginSet | VehicleNews::SetSelected(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_text_comes_in_chunks_of_fifty() {
        let mut words = Words::default();
        let chunks: Vec<(u16, u8, String)> = words
            .too_fast(105)
            .into_iter()
            .map(|m| match m {
                Message::STATUSTEXT(s) => (s.id, s.chunk_seq, s.text.to_str().unwrap_or_default().to_owned()),
                other => panic!("{other:?}"),
            })
            .collect();
        assert_eq!(chunks[0], (1, 0, "Requested rate for message ID 105 too fast. Increa".into()));
        assert_eq!(chunks[1], (1, 1, "se SCHED_LOOP_RATE".into()));
        assert_eq!(words.news(AutopilotKind::ArduPilot, VehicleNews::SetSelected(2)), []);
        assert_eq!(words.no_such_message(106).len(), 1);
    }
}
