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
    DOUBTFUL, DOUBTFUL_S, KNOWN_S, LATE_S, SILENCE_S, STUCK_CLIMB_M, STUCK_S, UNUSUAL, UNUSUAL_S,
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
    measured: Option<MeasuredClimb>,
}

/// The climb rate less what the acceleration had added up to: heights alone change it, unless that began anew.
#[derive(Clone, Copy, Debug)]
struct MeasuredClimb {
    mps: f64,
    epoch: u32,
}

/// What is estimated when a pressure is heard.
#[derive(Clone, Copy, Debug)]
struct EstimatedClimb {
    height_m: Option<f64>,
    measured: Option<MeasuredClimb>,
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
    /// It begins to repeat itself: by how much heights have changed the climb rate since, m/s, and for how long that was, s.
    pub(in super::super) led: Option<(f64, f64)>,
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
        let (height, timeline) = (&context.core.height, &context.core.timeline);
        let felt_mps = timeline.impulse(now).map(|impulse_ned| -impulse_ned.z);
        let measured = felt_mps
            .map(|felt_mps| MeasuredClimb { mps: height.climb_mps() - felt_mps, epoch: timeline.epoch() });
        let estimated = EstimatedClimb { height_m: height.height_m(), measured };
        let barometer = known.map_or_else(|| KnownBarometer::new(s, &estimated), |b| b.told(s, &estimated));
        self.barometers[index] = Some(barometer);
        let repeated = known.is_some_and(|b| b.is_doubted());
        let led = barometer.led(&estimated).filter(|_| barometer.is_doubted() && !repeated);
        let usable = if barometer.stuck {
            Err(Reason::Stuck)
        } else if barometer.is_doubted() {
            Err(Reason::Duplicate)
        } else if context.core.surroundings.environment().is_none() {
            // Before there is a place, a height has no zero.
            Err(Reason::NoReferenceYet)
        } else {
            Ok(())
        };
        let age_s = now.seconds_since(s.time);
        let reading = HeightReading { channel: CHANNELS[index], height_m, sigma_m: None, age_s };
        Ok(BarometerHeight { reading, another, usable, led })
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
            let same = SamePressure { since: heard, pressure_pa: 0.0, height_m: None, measured: None };
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
            (barometer.same.height_m, barometer.same.measured) = (None, None);
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
    fn new(s: &PressureSample, estimated: &EstimatedClimb) -> Self {
        let EstimatedClimb { height_m, measured } = *estimated;
        let same = SamePressure { since: s.time, pressure_pa: s.pressure_pa, height_m, measured };
        Self { sensor: s.sensor, heard: s.time, same, stuck: false, first: s.time, longest_s: 0.0 }
    }

    /// Whether it is stuck, or may be about to be: it has told the same for longer than it does as a rule.
    fn is_doubted(&self) -> bool {
        let repeats = self.is_known() && self.lasts_s() > DOUBTFUL_S.max(DOUBTFUL * self.longest_s);
        self.stuck || repeats
    }

    /// For how long it has told the same, s.
    fn lasts_s(&self) -> f64 {
        self.heard.seconds_since(self.same.since)
    }

    /// By how much heights have changed the climb rate since then, m/s, and for how long that was, s.
    fn led(&self, estimated: &EstimatedClimb) -> Option<(f64, f64)> {
        let (now, then) = (estimated.measured?, self.same.measured?);
        (now.epoch == then.epoch).then(|| (now.mps - then.mps, self.lasts_s()))
    }

    /// Whether it is known for how long it tells the same as a rule.
    fn is_known(&self) -> bool {
        self.same.since.seconds_since(self.first) > KNOWN_S
    }

    /// With a sample that was just heard. It is stuck when it goes on telling the same while the vehicle climbs, or for much longer than it ever
    /// has; and no more with the first sample that is another.
    fn told(self, s: &PressureSample, estimated: &EstimatedClimb) -> Self {
        let SamePressure { since, pressure_pa, height_m: then_m, .. } = self.same;
        let height_m = estimated.height_m;
        if pressure_pa != s.pressure_pa {
            let lasted_s = if self.stuck { 0.0 } else { self.heard.seconds_since(since) };
            let longest_s = self.longest_s.max(lasted_s);
            return Self { first: self.first, longest_s, ..Self::new(s, estimated) };
        }
        let lasts_s = s.time.seconds_since(since);
        let climbed = height_m.zip(then_m).is_some_and(|(now, then)| (now - then).abs() > STUCK_CLIMB_M);
        let unusual = self.is_known() && lasts_s > UNUSUAL_S.max(UNUSUAL * self.longest_s);
        let stuck = self.stuck || unusual || (climbed && lasts_s > STUCK_S);
        let same = SamePressure { height_m: then_m.or(height_m), ..self.same };
        Self { heard: s.time, same, stuck, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A barometer that has told another pressure ten times a second for a minute, and then the same for `s` seconds, while heights have changed the climb
    /// rate by 2 m/s a second, in motion that was remembered anew after `anew_s`.
    fn repeats(s: f64, anew_s: f64) -> (KnownBarometer, Option<(f64, f64)>) {
        let sample = |k: u32, pressure_pa: f64| PressureSample {
            time: AutopilotTime::from_micros(i64::from(k) * 100_000),
            sensor: 0,
            pressure_pa,
        };
        let estimated = |since_s: f64| EstimatedClimb {
            height_m: Some(10.0),
            measured: Some(MeasuredClimb { mps: 2.0 * since_s, epoch: u32::from(since_s > anew_s) }),
        };
        let mut barometer = KnownBarometer::new(&sample(0, 1e5), &estimated(0.0));
        for k in 1..600 {
            barometer = barometer.told(&sample(k, 1e5 + f64::from(k % 7)), &estimated(0.0));
        }
        let last = 1e5 + f64::from(599 % 7);
        for k in 0..(s * 10.0).round() as u32 {
            barometer = barometer.told(&sample(600 + k, last), &estimated(0.1 * f64::from(k + 1)));
        }
        let led = barometer.led(&estimated(s));
        (barometer, led)
    }

    #[test]
    fn what_repeats_itself_is_doubted_before_it_is_stuck() {
        let doubted = |s| repeats(s, f64::INFINITY).0.is_doubted();
        assert!(!doubted(0.3) && doubted(0.5));
        assert!(!repeats(2.5, f64::INFINITY).0.stuck && repeats(3.5, f64::INFINITY).0.stuck);
    }

    #[test]
    fn by_how_much_heights_have_changed_the_climb_rate_is_known_unless_motion_began_anew() {
        let (_, led) = repeats(0.5, f64::INFINITY);
        assert!(led.is_some_and(|(mps, s)| (mps - 1.0).abs() < 1e-9 && (s - 0.5).abs() < 1e-9), "{led:?}");
        assert_eq!(repeats(0.5, 0.2).1, None);
    }
}
