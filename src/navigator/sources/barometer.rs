//! Barometers: the first that is heard leads, another one votes.

use crate::altimeter::Channel;
use crate::geo::atmosphere::pressure_altitude_m;
use crate::sample::PressureSample;
use crate::time::AutopilotTime;

use super::super::context::Context;
use super::super::height::HeightReading;
use super::super::reset::Reset;
use super::super::verdict::Reason;
use super::status::SourceHealth;
use crate::navigator::tuning::barometer::{
    KNOWN_S, LATE_S, SILENCE_S, STUCK_CLIMB_M, STUCK_S, UNUSUAL, UNUSUAL_S,
};

/// The channels of the two that are listened to.
const CHANNELS: [Channel; 2] = [Channel::Baro, Channel::SecondBaro];

/// The same pressure, told again and again.
#[derive(Clone, Copy, Debug)]
struct SamePressure {
    since: AutopilotTime,
    pressure_pa: f64,
    /// Where the height was then, m, if it was known and has only been climbed from since.
    height_m: Option<f64>,
}

/// One that is listened to.
#[derive(Clone, Copy, Debug)]
struct KnownBarometer {
    sensor: u8,
    heard: AutopilotTime,
    same: SamePressure,
    stuck: bool,
    /// When it was first heard, and for how long it has told the same at most while it was sound, s: noise and resolution make that short.
    first: AutopilotTime,
    longest_s: f64,
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct BarometerSource {
    barometers: [Option<KnownBarometer>; 2],
}

/// A pressure as a height.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct BarometerHeight {
    pub(in super::super) reading: HeightReading,
    /// The channel was another barometer's.
    pub(in super::super) another: bool,
    /// It can be used.
    pub(in super::super) usable: Result<(), Reason>,
}

impl BarometerSource {
    pub(in super::super) fn observe(
        &mut self,
        s: &PressureSample,
        context: &Context<'_>,
    ) -> Result<BarometerHeight, Reason> {
        let height_m = pressure_altitude_m(s.pressure_pa).ok_or(Reason::NotFinite)?;
        let now = context.now().ok_or(Reason::NoReferenceYet)?;
        let index = self.place(s).ok_or(Reason::Redundant)?;
        let known = self.barometers[index].filter(|b| b.sensor == s.sensor);
        if known.is_some_and(|b| s.time <= b.heard) {
            return Err(Reason::OutOfOrder);
        }
        if context.is_late(s.time, LATE_S) {
            return Err(Reason::Late);
        }
        let another = known.is_none() && self.barometers[index].is_some();
        let estimated = context.core.height.height_m();
        let barometer = known.map_or_else(|| KnownBarometer::new(s, estimated), |b| b.told(s, estimated));
        self.barometers[index] = Some(barometer);
        let usable = if barometer.stuck {
            Err(Reason::Stuck)
        } else if context.core.surroundings.environment().is_none() {
            // Before there is a place, a height has no zero.
            Err(Reason::NoReferenceYet)
        } else {
            Ok(())
        };
        let age_s = now.seconds_since(s.time);
        let reading = HeightReading { channel: CHANNELS[index], height_m, sigma_m: None, age_s };
        Ok(BarometerHeight { reading, another, usable })
    }

    /// Which of the two barometers a sample is of.
    fn place(&self, s: &PressureSample) -> Option<usize> {
        let has = |i: usize| self.barometers[i].is_some_and(|b| b.sensor == s.sensor);
        let free = |i: usize| self.barometers[i].is_none_or(|b| s.time.seconds_since(b.heard) > SILENCE_S);
        (0..2).find(|i| has(*i)).or_else(|| (0..2).find(|i| free(*i)))
    }

    /// The channel of a barometer, and whether it is stuck.
    pub(super) fn channel(&self, sensor: u8) -> Option<(Channel, SourceHealth)> {
        let index = self.barometers.iter().position(|b| b.is_some_and(|b| b.sensor == sensor))?;
        let stuck = self.barometers[index].is_some_and(|b| b.stuck);
        Some((CHANNELS[index], if stuck { SourceHealth::Faulty } else { SourceHealth::Healthy }))
    }

    /// The numbers of the two.
    pub(in super::super) fn sensors(&self) -> [Option<u8>; 2] {
        self.barometers.map(|b| b.map(|b| b.sensor))
    }

    /// They have had their places until `heard`.
    pub(in super::super) fn recall(&mut self, sensors: [Option<u8>; 2], heard: AutopilotTime) {
        self.barometers = sensors.map(|sensor| {
            let same = SamePressure { since: heard, pressure_pa: 0.0, height_m: None };
            sensor.map(|sensor| KnownBarometer {
                sensor,
                heard,
                same,
                stuck: false,
                first: heard,
                longest_s: 0.0,
            })
        });
    }

    /// The height has moved without a climb.
    pub(in super::super) fn height_moved(&mut self) {
        for barometer in self.barometers.iter_mut().flatten() {
            barometer.same.height_m = None;
        }
    }

    pub(super) fn reset(&mut self, reset: &Reset) {
        match reset {
            Reset::OriginMoved(_) => self.height_moved(),
            Reset::Reboot | Reset::ClockSetBack => *self = Self::default(),
            Reset::Relocated | Reset::Bridged | Reset::StreamBroken => {}
        }
    }
}

impl KnownBarometer {
    fn new(s: &PressureSample, height_m: Option<f64>) -> Self {
        let same = SamePressure { since: s.time, pressure_pa: s.pressure_pa, height_m };
        Self { sensor: s.sensor, heard: s.time, same, stuck: false, first: s.time, longest_s: 0.0 }
    }

    /// With a sample that was just heard. It is stuck when it goes on telling the same while the vehicle climbs, or for much longer than it ever
    /// has; and no more with the first sample that is another.
    fn told(self, s: &PressureSample, height_m: Option<f64>) -> Self {
        let SamePressure { since, pressure_pa, height_m: then_m } = self.same;
        if pressure_pa != s.pressure_pa {
            let lasted_s = if self.stuck { 0.0 } else { self.heard.seconds_since(since) };
            let longest_s = self.longest_s.max(lasted_s);
            return Self { first: self.first, longest_s, ..Self::new(s, height_m) };
        }
        let lasts_s = s.time.seconds_since(since);
        let climbed = height_m.zip(then_m).is_some_and(|(now, then)| (now - then).abs() > STUCK_CLIMB_M);
        let known = since.seconds_since(self.first) > KNOWN_S;
        let unusual = known && lasts_s > UNUSUAL_S.max(UNUSUAL * self.longest_s);
        let stuck = self.stuck || unusual || (climbed && lasts_s > STUCK_S);
        let same = SamePressure { height_m: then_m.or(height_m), ..self.same };
        Self { heard: s.time, same, stuck, ..self }
    }
}
