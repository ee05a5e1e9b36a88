//! Measurements that other components of the vehicle send themselves: a companion's camera, a flow sensor or a rangefinder on the same
//! network, or on a link of their own (`link.sensor_endpoints`).
//!
//! Their stamps are read where they are on the autopilot's clock, and never move it. A component may stamp with its own time since it
//! was switched on; then its word is taken to be as old as its message. An autopilot that is told of a flow sends it out again as its own
//! (PX4 does), so while it tells of a sensor, no other component's word of the sensor of that number is taken.

use crate::time::{AutopilotTime, Span};

use super::super::frame::ComponentId;
use super::super::messages::Meaning;
use super::{Cause, Decoder, Repair};

/// The autopilot tells of a sensor no more when it has been silent on it for so long.
const SILENCE: Span = Span::from_millis(1000);

/// Sensors that the autopilot tells of itself, and when it did last.
#[derive(Clone, Debug, Default)]
pub(super) struct OwnSensors(Vec<(Meaning, u8, AutopilotTime)>);

impl Decoder {
    /// Whether a frame is the autopilot's own.
    pub(super) fn is_own(&self, from: ComponentId) -> bool {
        !self.apart && self.vehicle.is_some_and(|(_, component)| component == from)
    }

    /// A stamp of microseconds, of the autopilot or of another component.
    pub(super) fn stamped_usec(&mut self, us: u64, from: ComponentId) -> Result<AutopilotTime, Cause> {
        if self.is_own(from) { self.clock.usec(us) } else { self.or_arrival(self.clock.foreign_usec(us)) }
    }

    /// A stamp of milliseconds since boot, of the autopilot or of another component.
    pub(super) fn stamped_ms(&mut self, ms: u32, from: ComponentId) -> Result<AutopilotTime, Cause> {
        if self.is_own(from) { self.clock.boot_ms(ms) } else { self.or_arrival(self.clock.foreign_ms(ms)) }
    }

    fn or_arrival(&mut self, stamp: Result<AutopilotTime, Cause>) -> Result<AutopilotTime, Cause> {
        stamp.or_else(|_| {
            self.repairs.count(Repair::ForeignByArrival);
            self.now()
        })
    }

    /// Whether a component's word of a sensor is taken.
    pub(super) fn prefers(
        &mut self,
        what: Meaning,
        sensor: u8,
        from: ComponentId,
        time: AutopilotTime,
    ) -> bool {
        let own = self.is_own(from);
        let told = self.own_sensors.0.iter_mut().find(|(w, s, _)| (*w, *s) == (what, sensor));
        match told {
            Some((_, _, last)) if own => *last = time,
            Some((_, _, last)) => return time - *last > SILENCE,
            None if own => self.own_sensors.0.push((what, sensor, time)),
            None => {}
        }
        true
    }
}
