//! Tells an autopilot that has no origin where it is (SET_GPS_GLOBAL_ORIGIN), where nobody has GNSS and the place is configured.
//!
//! Without an origin ArduPilot and PX4 hold a local position by what they are sent, and refuse every mode that wants a place on Earth.

use mavlink::dialects::ardupilotmega::{MavMessage, SET_GPS_GLOBAL_ORIGIN_DATA};

use super::Address;
use crate::geo::Geodetic;
use crate::time::{Companion, Span, Stamp};

/// How often it is told, and how many times at most.
const EVERY: Span = Span::from_millis(5000);
const TIMES: u8 = 5;

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct OriginOffer {
    known: bool,
    told: u8,
    due: Option<Stamp<Companion>>,
}

impl OriginOffer {
    /// The autopilot has told an origin of its own.
    pub(super) fn known(&mut self) {
        self.known = true;
    }

    /// The message that is due; `place` is where the vehicle began, while nobody else knows.
    pub(super) fn poll(
        &mut self,
        now: Stamp<Companion>,
        autopilot: Address,
        place: Option<Geodetic>,
    ) -> Option<MavMessage> {
        let place = place.filter(|_| !self.known && self.told < TIMES)?;
        if self.due.is_some_and(|due| now < due) {
            return None;
        }
        self.due = Some(now + EVERY);
        self.told += 1;
        Some(MavMessage::SET_GPS_GLOBAL_ORIGIN(SET_GPS_GLOBAL_ORIGIN_DATA {
            latitude: (place.latitude_rad.to_degrees() * 1e7).round() as i32,
            longitude: (place.longitude_rad.to_degrees() * 1e7).round() as i32,
            altitude: (place.height_m * 1e3).round() as i32,
            // Nobody knows what time it was.
            time_usec: 0,
            target_system: autopilot.system.0,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::frame::{ComponentId, SystemId};

    #[test]
    fn it_is_told_a_few_times_until_the_autopilot_has_one() {
        let autopilot = Address { system: SystemId(3), component: ComponentId(1) };
        let place = Some(Geodetic::from_degrees(47.5, -8.25, 488.0));
        let at = |s: i64| Stamp::from_micros(s * 1_000_000);
        let mut offer = OriginOffer::default();
        assert_eq!(offer.poll(at(0), autopilot, None), None, "GNSS tells, or nobody knows");
        let Some(MavMessage::SET_GPS_GLOBAL_ORIGIN(m)) = offer.poll(at(1), autopilot, place) else {
            panic!()
        };
        let told = (m.latitude, m.longitude, m.altitude, m.target_system);
        assert_eq!(told, (475_000_000, -82_500_000, 488_000, 3));
        assert_eq!((2..6).filter(|s| offer.poll(at(*s), autopilot, place).is_some()).count(), 0);
        assert_eq!((6..600).filter(|s| offer.poll(at(*s), autopilot, place).is_some()).count(), 4);
        let mut offer = OriginOffer::default();
        offer.known();
        assert_eq!(offer.poll(at(0), autopilot, place), None);
    }
}
