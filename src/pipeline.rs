//! Inputs in, messages out: the part that live flight, replay and simulation share.

use crate::geo::magnetic::decimal_year_from_unix_us;
use crate::geo::{Geodetic, LocalNed, Ned};
use crate::navigator::Navigator;
use crate::navigator::settings::NavigatorSettings;
use crate::navigator::solution::Solution;
use crate::outbound::message::OutboundMessage;
use crate::outbound::origin_watch::{OriginWatch, OriginWord};
use crate::outbound::{Outbound, OutboundSettings, Profile};
use crate::sample::{Input, Reference, Sample};
use crate::time::{AutopilotTime, ClockEvent};
use crate::wire::clock::AutopilotClock;
use crate::wire::session::identity::{AutopilotKind, Vehicle};

/// Settings of one vehicle's navigation and output.
#[derive(Clone, Debug)]
pub struct PipelineSettings {
    /// Navigator.
    pub navigator: NavigatorSettings,
    /// Output; its profile is replaced by the autopilot's unless `profile` says otherwise.
    pub outbound: OutboundSettings,
    /// A configured profile.
    pub profile: Option<Profile>,
}

/// Navigator and output of one vehicle.
#[derive(Clone, Debug)]
pub struct Pipeline {
    /// The navigator.
    pub navigator: Navigator,
    /// The output.
    pub outbound: Outbound,
    origin: OriginWatch,
    profile: Option<Profile>,
    samples: u32,
}

/// IMU samples between two looks at the date.
const DATE_EVERY: u32 = 2000;

impl Pipeline {
    /// A pipeline that has heard nothing.
    pub fn new(settings: &PipelineSettings) -> Self {
        Self {
            navigator: Navigator::new(settings.navigator.clone()),
            outbound: Outbound::new(settings.outbound),
            origin: OriginWatch::new(),
            profile: settings.profile,
            samples: 0,
        }
    }

    /// Another vehicle is served: nothing of what was heard is of it.
    pub fn begin_anew(&mut self) {
        self.navigator = self.navigator.anew();
        self.origin = OriginWatch::new();
        self.outbound.restart();
    }

    /// The vehicle is known: who is to be told what.
    pub fn follow(&mut self, vehicle: &Vehicle) {
        self.outbound.set_profile(self.profile.unwrap_or(match vehicle.autopilot {
            AutopilotKind::Px4 => Profile::Px4,
            AutopilotKind::ArduPilot | AutopilotKind::Other(_) => Profile::Ardupilot,
        }));
    }

    /// What the watch over the origin says.
    fn heed(&mut self, clock: &AutopilotClock, word: Option<OriginWord>) {
        match (word, clock.newest()) {
            (Some(OriginWord::Take(origin)), _) => self.share_origin(clock, &origin),
            (Some(OriginWord::Contradicted(moved_m)), Some(now)) => {
                self.navigator.contradict_origin(now, moved_m);
            }
            _ => {}
        }
    }

    fn origin_told(&mut self, clock: &AutopilotClock, origin: &Geodetic) {
        let Some(now) = clock.newest() else { return };
        let sigma_m = self.navigator.solution().map_or(0.0, |s| s.horizontal_sigma_m());
        let word = self.origin.hear(now, origin, self.navigator.placed_frame(), sigma_m);
        self.heed(clock, word);
    }

    fn referred(&mut self, clock: &AutopilotClock, reference: &Reference) {
        let Some(solution) = self.navigator.solution() else { return };
        let word = self.origin.reference(reference, &solution, self.navigator.placed_frame());
        self.outbound.reference(reference, &solution);
        self.heed(clock, word);
    }

    /// The autopilot's origin is believed: the navigator's frame is put there, and the output knows by how much it moved.
    fn share_origin(&mut self, clock: &AutopilotClock, origin: &Geodetic) {
        let placed = !self.navigator.is_relative();
        let before = self.navigator.frame().filter(|_| placed).cloned();
        let Some(time) = clock.newest() else { return };
        if !self.navigator.set_origin(time, *origin) {
            return;
        }
        let after = self.navigator.frame().map(LocalNed::origin);
        let moved = before.zip(after).filter(|(before, after)| before.origin() != *after);
        self.outbound.origin_shared(moved.map(|(before, after)| Ned::new(before.to_ned(&after))));
    }

    /// Takes one input and appends what is to be sent. Returns the new solution after an IMU sample.
    pub fn take(
        &mut self,
        clock: &AutopilotClock,
        input: &Input,
        out: &mut Vec<OutboundMessage>,
    ) -> Option<Solution> {
        match input {
            Input::Sample(sample) => {
                self.navigator.ingest(sample);
                if !matches!(sample, Sample::Imu(_)) {
                    return None;
                }
                if self.samples.is_multiple_of(DATE_EVERY)
                    && let Some(unix) = clock.unix_seconds(sample.time())
                {
                    self.navigator.set_date(decimal_year_from_unix_us((unix * 1e6) as i64));
                }
                self.samples = self.samples.wrapping_add(1);
                let solution = self.navigator.solution()?;
                if self.navigator.is_relative() {
                    // The autopilot has no frame either: ours is the one.
                    self.outbound.origin_shared(None);
                }
                self.outbound.step(&solution, out);
                Some(solution)
            }
            Input::Reference(reference) => {
                self.referred(clock, reference);
                None
            }
            Input::Origin(origin) => {
                self.origin_told(clock, origin);
                None
            }
            Input::Status(status) => {
                self.navigator.set_status(*status);
                self.origin.set_disarmed(status.armed == Some(false));
                None
            }
            Input::Clock(ClockEvent::Reboot { before, after, known }) => {
                self.navigator.reboot(*after, known.then(|| after.seconds_since(*before)));
                self.outbound.restart();
                self.origin = OriginWatch::new();
                None
            }
            Input::Clock(ClockEvent::Gap(_)) => None,
        }
    }
}

/// Intervals in which GNSS is withheld, in seconds since the first sample or reference: outages made by an operator.
#[derive(Clone, Debug, Default)]
pub struct GnssMask {
    start: Option<AutopilotTime>,
    intervals: Vec<(f64, f64)>,
}

impl GnssMask {
    /// Withholds GNSS in each interval [start, end).
    pub fn new(intervals: &[(f64, f64)]) -> Self {
        Self { start: None, intervals: intervals.to_vec() }
    }

    /// Withholds GNSS in one more interval.
    pub fn add(&mut self, start_s: f64, end_s: f64) {
        self.intervals.push((start_s, end_s));
    }

    /// The intervals.
    pub fn intervals(&self) -> &[(f64, f64)] {
        &self.intervals
    }

    /// Seconds since the first sample; 0 before there was one.
    pub fn seconds(&self, time: AutopilotTime) -> f64 {
        self.start.map_or(0.0, |s| time.seconds_since(s))
    }

    /// Takes note of an input, the first of which is time 0. The time of a GNSS sample that is to be withheld
    /// ([`Navigator::mask_gnss`]); `None` for everything that is to be used.
    pub fn withholds(&mut self, input: &Input) -> Option<AutopilotTime> {
        let time = match input {
            Input::Sample(sample) => sample.time(),
            Input::Reference(reference) => reference.time(),
            Input::Origin(_) | Input::Status(_) | Input::Clock(_) => return None,
        };
        let t = time.seconds_since(*self.start.get_or_insert(time));
        let gnss = matches!(input, Input::Sample(Sample::Gnss(_)));
        (gnss && self.intervals.iter().any(|&(a, b)| a <= t && t < b)).then_some(time)
    }
}
