//! Rangefinders that look down: the first that is heard measures the ground, another one is its spare.
//!
//! Each is judged by itself. The spare takes over when the first was found to be wrong, or has been silent, and the spare was not; when the
//! first is sound again it measures again.

use crate::sample::{RangeDirection, RangeSample};
use crate::time::AutopilotTime;

use super::super::context::Context;
use super::super::height::HeightReading;
use super::super::reset::Reset;
use super::super::verdict::Reason;
use super::rangefinder::RangefinderSource;
use super::status::SourceHealth;
use crate::navigator::tuning::rangefinders::SILENCE_S;

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct Rangefinders {
    /// By their number, in the order in which they were first heard.
    sensors: [Option<(u8, RangefinderSource)>; 2],
    /// Newest time of any of them.
    newest: Option<AutopilotTime>,
}

impl Rangefinders {
    /// Takes a distance of one of them. A height when one is due, of the one that measures.
    pub(in super::super) fn observe(
        &mut self,
        s: &RangeSample,
        context: &Context<'_>,
    ) -> Result<Option<HeightReading>, Reason> {
        if s.direction != RangeDirection::Down {
            return Err(Reason::NotUsed);
        }
        let place = self.sensors.iter().position(|of| of.is_none_or(|(id, _)| id == s.sensor));
        let place = place.ok_or(Reason::Redundant)?;
        let (_, sensor) = self.sensors[place].get_or_insert_with(|| (s.sensor, RangefinderSource::default()));
        let reading = sensor.observe(s, context)?;
        self.newest = self.newest.max(Some(s.time));
        Ok(reading.filter(|_| self.measuring() == place))
    }

    /// The place of the one that measures.
    fn measuring(&self) -> usize {
        let sound = |of: &Option<(u8, RangefinderSource)>| {
            of.as_ref().is_some_and(|(_, sensor)| {
                let heard = sensor.newest().zip(self.newest);
                let silent = heard.is_none_or(|((t, _), newest)| newest.seconds_since(t) > SILENCE_S);
                !silent && sensor.health() != SourceHealth::Faulty
            })
        };
        usize::from(!sound(&self.sensors[0]) && sound(&self.sensors[1]))
    }

    /// The one that measures, once one is heard.
    pub(super) fn in_use(&self) -> Option<&RangefinderSource> {
        self.sensors[self.measuring()].as_ref().map(|(_, sensor)| sensor)
    }

    /// The number of the one that measures, and where it has seen the ground, m above the origin.
    pub(in super::super) fn ground(&self) -> Option<(u8, f64)> {
        let (id, sensor) = self.sensors[self.measuring()].as_ref()?;
        sensor.ground_m().map(|ground_m| (*id, ground_m))
    }

    /// How far down the ground is, m, by the one that measures, if that was told at `time`.
    pub(in super::super) fn told(&self, time: AutopilotTime) -> Option<f64> {
        self.in_use()?.told().filter(|(t, _)| *t == time).map(|(_, above_m)| above_m)
    }

    /// The ground is where it was last seen, by the one that will measure.
    pub(in super::super) fn recall(&mut self, (id, ground_m): (u8, f64)) {
        self.sensors = [Some((id, RangefinderSource::recalling(ground_m))), None];
    }

    /// What is known against one of them, and whether it is the one that measures.
    pub(super) fn health(&self, id: u8) -> (SourceHealth, bool) {
        let place = self.sensors.iter().position(|of| of.is_some_and(|(sensor, _)| sensor == id));
        let health = place.and_then(|i| self.sensors[i]).map_or(SourceHealth::Suspect, |(_, s)| s.health());
        (health, place == Some(self.measuring()))
    }

    pub(super) fn reset(&mut self, reset: &Reset) {
        self.sensors.iter_mut().flatten().for_each(|(_, sensor)| sensor.reset(reset));
        if reset.reboots() {
            *self = Self::default();
        }
    }
}
