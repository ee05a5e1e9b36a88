//! The published height of a flight against a reference, and what was told about the sources of heights. Shared by the tests and the
//! `altimeter_flights` example.
#![allow(dead_code, reason = "the tests and the example each use their part")]

use holdover::altimeter::{Channel, Fault};
use holdover::geo::atmosphere::pressure_altitude_m;
use holdover::log::{Log, LogError};
use holdover::navigator::event::EventKind;
use holdover::navigator::solution::{Mode, Solution};
use holdover::pipeline::PipelineSettings;
use holdover::replay::runner::Runner;
use holdover::sample::{Input, PressureSample, Reference, Sample};
use holdover::time::AutopilotTime;
use holdover::wire::clock::AutopilotClock;

/// The barometer's zero is the mean of this long after alignment, s.
const ZEROED_S: f64 = 5.0;
/// A solution older than this is not compared, s.
const STALE_S: f64 = 1.0;

/// A published height beside the reference, both above mean sea level.
#[derive(Clone, Copy, Debug)]
pub struct Compared {
    /// Seconds since the first sample.
    pub t_s: f64,
    pub published_m: f64,
    pub sigma_m: f64,
    pub reference_m: f64,
}

impl Compared {
    pub fn error_m(&self) -> f64 {
        self.published_m - self.reference_m
    }
}

/// A fault that was told.
#[derive(Clone, Copy, Debug)]
pub struct Told {
    pub channel: Channel,
    pub fault: Fault,
    /// When it was told, and when it is said to have begun, s since the first sample.
    pub at_s: f64,
    pub since_s: f64,
    /// When it was said to be over, s.
    pub until_s: Option<f64>,
}

/// How the height moved by itself at the worst: s since the first sample, m.
pub type Step = (f64, f64);

/// What became of the height in a flight.
#[derive(Clone, Debug, Default)]
pub struct Heights {
    /// The simulator's truth told what is compared with; else it is the barometer.
    pub truth: bool,
    pub compared: Vec<Compared>,
    pub faults: Vec<Told>,
    /// Times and sizes of the jumps that were told, s and m.
    pub resets: Vec<Step>,
    /// The largest step that was not told.
    pub largest_step: Step,
}

impl Heights {
    /// Root mean square, m; `None` when nothing was compared.
    pub fn rmse_m(&self) -> Option<f64> {
        self.rmse_between_m(f64::NEG_INFINITY, f64::INFINITY)
    }

    /// The same of a part of the flight, from and to in s since the first sample.
    pub fn rmse_between_m(&self, from_s: f64, to_s: f64) -> Option<f64> {
        let errors =
            || self.compared.iter().filter(|c| (from_s..to_s).contains(&c.t_s)).map(Compared::error_m);
        let n = errors().count();
        (n > 0).then(|| (errors().map(|e| e * e).sum::<f64>() / n as f64).sqrt())
    }

    /// The largest error, m.
    pub fn max_m(&self) -> Option<f64> {
        self.compared.iter().map(|c| c.error_m().abs()).reduce(f64::max)
    }

    /// The share of errors within two of the standard deviations that were claimed, %.
    pub fn within_2_sigma_percent(&self) -> Option<f64> {
        let within = self.compared.iter().filter(|c| c.error_m().abs() <= 2.0 * c.sigma_m).count();
        (!self.compared.is_empty()).then(|| 100.0 * within as f64 / self.compared.len() as f64)
    }
}

/// A flight on its way through the pipeline.
pub struct Watch {
    runner: Runner,
    heights: Heights,
    /// The published height, its climb rate and its time at the last IMU sample: m, m/s.
    last: Option<(AutopilotTime, f64, f64)>,
    /// The barometer that is the reference, and since when.
    baro: Option<(u8, AutopilotTime)>,
    /// Height less pressure altitude: sum and number.
    zero: (f64, u32),
    baro_compared: Vec<Compared>,
    /// Events and jumps that were noted.
    events: usize,
    jumps: usize,
}

impl Watch {
    pub fn new(log: &Log, settings: &PipelineSettings, outages: &[(f64, f64)]) -> Self {
        let mut runner = Runner::new(settings, outages);
        runner.pipeline.follow(log.vehicle());
        Self {
            runner,
            heights: Heights::default(),
            last: None,
            baro: None,
            zero: (0.0, 0),
            baro_compared: Vec::new(),
            events: 0,
            jumps: 0,
        }
    }

    pub fn runner(&self) -> &Runner {
        &self.runner
    }

    /// What came of the flight so far.
    pub fn finish(mut self) -> Heights {
        self.note_events();
        self.heights.truth = !self.heights.compared.is_empty();
        if !self.heights.truth {
            self.heights.compared = self.baro_compared;
        }
        self.heights
    }

    /// One item of the log, to the pipeline.
    pub fn take(&mut self, clock: &AutopilotClock, item: &Input) {
        self.runner.take(clock, item);
        self.note_events();
        match item {
            Input::Sample(Sample::Imu(_)) => self.follow(),
            Input::Sample(Sample::Pressure(s)) => self.compare_with_baro(s),
            Input::Reference(Reference::Truth(truth)) => {
                if let Some(position) = truth.position
                    && let Some(c) = self.compared(truth.time, position.height_m)
                {
                    self.heights.compared.push(c);
                }
            }
            _ => (),
        }
    }

    /// Height above mean sea level, its rate and its time; `None` before there is a mode that claims it.
    fn published(&self) -> Option<(&Solution, f64)> {
        let solution = self.runner.solution().filter(|s| s.mode != Mode::Aligning)?;
        let frame = self.runner.pipeline.navigator.frame()?;
        Some((solution, frame.to_geodetic(&solution.position.raw()).height_m))
    }

    /// How far the height moved by itself since the last IMU sample.
    fn follow(&mut self) {
        let told = std::mem::replace(&mut self.jumps, self.heights.resets.len()) < self.heights.resets.len();
        let Some((s, height)) = self.published() else {
            self.last = None;
            return;
        };
        let (time, climb) = (s.time, -s.velocity.raw().z);
        if let Some((then, before, climbed)) = self.last.replace((time, height, climb))
            && !told
        {
            let own = 0.5 * (climb + climbed) * time.seconds_since(then);
            let step = height - before - own;
            if step.abs() > self.heights.largest_step.1.abs() {
                self.heights.largest_step = (self.runner.seconds(time), step);
            }
        }
    }

    fn compared(&self, time: AutopilotTime, reference_m: f64) -> Option<Compared> {
        let (s, height) = self.published()?;
        let dt = time.seconds_since(s.time);
        (dt.abs() < STALE_S).then(|| Compared {
            t_s: self.runner.seconds(time),
            published_m: height - s.velocity.raw().z * dt,
            sigma_m: s.position_covariance.raw()[(2, 2)].max(0.0).sqrt(),
            reference_m,
        })
    }

    /// The first barometer that was heard, counted from where the height was when the vehicle was aligned.
    fn compare_with_baro(&mut self, s: &PressureSample) {
        let Some(altitude) = pressure_altitude_m(s.pressure_pa) else { return };
        let Some(mut c) = self.compared(s.time, altitude) else { return };
        let (sensor, since) = *self.baro.get_or_insert((s.sensor, s.time));
        if sensor != s.sensor {
            return;
        }
        if s.time.seconds_since(since) < ZEROED_S {
            self.zero = (self.zero.0 + c.published_m - altitude, self.zero.1 + 1);
        } else {
            c.reference_m += self.zero.0 / f64::from(self.zero.1);
            self.baro_compared.push(c);
        }
    }

    fn note_events(&mut self) {
        let events = self.runner.events();
        for (t, event) in events.get(self.events..).unwrap_or_default() {
            match event.kind {
                EventKind::HeightFault { channel, fault, for_s } => self.heights.faults.push(Told {
                    channel,
                    fault,
                    at_s: *t,
                    since_s: t - for_s,
                    until_s: None,
                }),
                EventKind::HeightHealed(channel) => {
                    let of_channel = self.heights.faults.iter_mut().filter(|f| f.channel == channel);
                    of_channel.for_each(|f| f.until_s = f.until_s.or(Some(*t)));
                }
                EventKind::HeightReset(m) => self.heights.resets.push((*t, m)),
                _ => (),
            }
        }
        self.events = events.len();
    }
}

/// Flies a whole log. `change` makes of every item what is heard.
///
/// # Errors
/// What reading it says.
pub fn fly(
    log: &Log,
    settings: &PipelineSettings,
    outages: &[(f64, f64)],
    mut change: impl FnMut(f64, Input, &mut Vec<Input>),
) -> Result<Watch, LogError> {
    let mut watch = Watch::new(log, settings, outages);
    let mut heard = Vec::new();
    log.play(
        |_, _| (),
        |clock, item| {
            let t = clock.newest().map_or(0.0, |t| watch.runner.seconds(t));
            change(t, *item, &mut heard);
            for item in heard.drain(..) {
                watch.take(clock, &item);
            }
        },
    )?;
    Ok(watch)
}
