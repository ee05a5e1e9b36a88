//! A log through the pipeline, scored.

use std::cell::RefCell;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::fault::{InjectedFault, Injector};
use crate::metrics::outage::{OutageReport, OutageScore};
use crate::metrics::{AidedErrors, AidedReport, ErrorSample, ReferenceState};
use crate::navigator::event::{Event, EventKind};
use crate::navigator::solution::{Mode, Solution};
use crate::outbound::message::OutboundMessage;
use crate::pipeline::{GnssMask, Pipeline, PipelineSettings};
use crate::sample::{GnssSample, Input, Reference, Sample, SampleKind};
use crate::time::{AutopilotTime, Span};
use crate::wire::clock::AutopilotClock;

use crate::log::stretches::Stretches;
use crate::log::{Aside, Log, LogError, LogSummary};
use crate::wire::recording::SentReport;

use super::as_flown::AsFlown;

/// What the solution is compared with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ReferenceKind {
    /// The simulator's truth.
    Truth,
    /// GNSS, masked or not.
    Gnss,
}

impl ReferenceKind {
    /// What it is called in files.
    pub const fn label(self) -> &'static str {
        match self {
            ReferenceKind::Truth => "truth",
            ReferenceKind::Gnss => "gnss",
        }
    }

    /// The one of that name.
    pub fn of(label: &str) -> Option<Self> {
        [ReferenceKind::Truth, ReferenceKind::Gnss].into_iter().find(|r| r.label() == label)
    }
}

/// A mode change.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ModeChange {
    /// Seconds since the first sample.
    pub t_s: f64,
    /// The new mode.
    pub mode: Mode,
}

/// Scores against one kind of reference.
#[derive(Clone, Debug)]
struct Score {
    aided: AidedErrors,
    outages: Vec<OutageScore>,
    compared: u64,
}

/// A pipeline that is fed from a log, with outages made by masking GNSS.
#[derive(Clone, Debug)]
pub struct Runner {
    /// What is run.
    pub pipeline: Pipeline,
    mask: GnssMask,
    faults: Injector,
    end: Option<AutopilotTime>,
    truth: Score,
    gnss: Score,
    modes: Vec<ModeChange>,
    events: Vec<(f64, Event)>,
    heard: [u64; SampleKind::ALL.len()],
    imu: Stretches,
    sent: Vec<OutboundMessage>,
    given: Option<Input>,
    solution: Option<Solution>,
    as_flown: Option<AsFlown>,
}

/// What came of a replay.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Duration from the first to the last sample, s.
    pub duration_s: f64,
    /// What was compared with.
    pub reference: ReferenceKind,
    /// Errors with GNSS.
    pub aided: AidedReport,
    /// Outages.
    pub outages: Vec<OutageReport>,
    /// Horizontal error at each outage's start, m.
    pub start_errors_m: Vec<Option<f64>>,
    /// Modes.
    pub modes: Vec<ModeChange>,
    /// Events with their time, s.
    pub events: Vec<(f64, Event)>,
    /// Samples heard by kind; of GNSS receivers, fixes.
    pub heard: [u64; SampleKind::ALL.len()],
    /// The IMU's rate and holes.
    pub imu: Stretches,
}

impl Runner {
    /// A runner with outages (start, end) in seconds since the first sample.
    pub fn new(settings: &PipelineSettings, outages: &[(f64, f64)]) -> Self {
        let mask = GnssMask::new(outages);
        let outages = outages.iter().map(|&(a, b)| OutageScore::new(a, b)).collect();
        let score = Score { aided: AidedErrors::default(), outages, compared: 0 };
        Self {
            pipeline: Pipeline::new(settings),
            mask,
            faults: Injector::default(),
            end: None,
            truth: score.clone(),
            gnss: score,
            modes: Vec::new(),
            events: Vec::new(),
            heard: [0; SampleKind::ALL.len()],
            imu: Stretches::default(),
            sent: Vec::with_capacity(4),
            given: None,
            solution: None,
            as_flown: None,
        }
    }

    /// A recording is flown again as it was flown.
    pub fn fly_as_flown(&mut self) {
        self.as_flown = Some(AsFlown::default());
    }

    /// What a recording says beside its inputs.
    pub fn aside(&mut self, aside: &Aside<'_>) {
        if let Some(as_flown) = &mut self.as_flown
            && let Some((from_s, to_s)) = as_flown.aside(aside, &mut self.pipeline)
        {
            self.add_outage(from_s, to_s);
        }
    }

    /// How what was sent compares with what a recording says was sent.
    pub fn sent_again(&self) -> Option<SentReport> {
        self.as_flown.as_ref().and_then(AsFlown::report)
    }

    /// Seconds since the first sample.
    pub fn seconds(&self, time: AutopilotTime) -> f64 {
        self.mask.seconds(time)
    }

    /// The newest solution.
    pub fn solution(&self) -> Option<&Solution> {
        self.solution.as_ref()
    }

    /// What the navigation was given of the last item: with the faults in it; `None` of what was withheld.
    pub fn given(&self) -> Option<&Input> {
        self.given.as_ref()
    }

    /// What was told so far, with its time in seconds since the first sample.
    pub fn events(&self) -> &[(f64, Event)] {
        &self.events
    }

    /// Adds an outage on the way (its start must lie ahead of what was taken).
    pub fn add_outage(&mut self, start_s: f64, end_s: f64) {
        self.mask.add(start_s, end_s);
        self.add_score(start_s, end_s);
    }

    /// Errors from `start_s` to `end_s` are scored as an outage's are, GNSS or not.
    pub fn add_score(&mut self, start_s: f64, end_s: f64) {
        let outage = OutageScore::new(start_s, end_s);
        self.truth.outages.push(outage.clone());
        self.gnss.outages.push(outage);
    }

    /// What is heard from now on is altered by these, and by nothing else; their noise is drawn from `seed`.
    pub fn set_faults(&mut self, faults: Vec<InjectedFault>, seed: u64) {
        self.faults = Injector::new(faults, seed);
    }

    /// Forgets everything but the state of the navigation, so that a copy costs little.
    pub fn fork(&self) -> Self {
        let mut fork = self.clone();
        fork.modes.clear();
        fork.events.clear();
        fork
    }

    /// Takes one item of the log. Returns what was sent because of it.
    pub fn take(&mut self, clock: &AutopilotClock, item: &Input) -> &[OutboundMessage] {
        self.sent.clear();
        self.given = None;
        let time = match item {
            Input::Sample(s) => s.time(),
            Input::Reference(r) => r.time(),
            Input::Origin(_) | Input::Status(_) | Input::Clock(_) => {
                let mut sent = std::mem::take(&mut self.sent);
                self.pipeline.take(clock, item, &mut sent);
                self.sent = sent;
                self.note_events();
                return &self.sent;
            }
        };
        let withheld = self.mask.withholds(item);
        self.end = self.end.max(Some(time));
        let t = self.seconds(time);
        if let Input::Sample(sample) = item {
            self.count(sample);
        }
        if let Input::Sample(Sample::Gnss(fix)) = item {
            // The withheld fix is compared with, and never used.
            self.compare_with_gnss(fix, t);
        }
        if let Some(time) = withheld {
            self.pipeline.navigator.mask_gnss(time);
            return &self.sent;
        }
        self.given = self.faults.alter(t, item);
        let Some(heard) = self.given else { return &self.sent };
        let mut sent = std::mem::take(&mut self.sent);
        let solution = match &mut self.as_flown {
            Some(as_flown) => as_flown.take(&mut self.pipeline, clock, &heard, &mut sent),
            None => self.pipeline.take(clock, &heard, &mut sent),
        };
        self.solution = solution.or(self.solution.take());
        self.sent = sent;
        if !self.sent.is_empty() {
            for outages in [&mut self.truth.outages, &mut self.gnss.outages] {
                for o in outages.iter_mut().filter(|o| o.contains(t)) {
                    o.sent_messages += self.sent.len() as u64;
                }
            }
        }
        if let Input::Reference(Reference::Truth(truth)) = item
            && let (Some(frame), Some(solution)) = (self.pipeline.navigator.frame(), &self.solution)
            && let Some(state) = ReferenceState::from_truth(truth, frame)
        {
            self.truth.add(solution, &state, t);
        }
        self.note_events();
        &self.sent
    }

    fn count(&mut self, sample: &Sample) {
        match sample {
            Sample::Gnss(fix) if fix.position.is_none() => return,
            Sample::Imu(imu) => self.imu.note(imu.time),
            _ => {}
        }
        self.heard[sample.kind() as usize] += 1;
    }

    fn compare_with_gnss(&mut self, fix: &GnssSample, t: f64) {
        let (Some(position), Some(frame), Some(solution)) =
            (fix.position, self.pipeline.navigator.frame(), &self.solution)
        else {
            return;
        };
        let velocity_ned = fix.ground_velocity.map(|g| {
            let (north, east) = g.north_east();
            Vector3::new(north, east, f64::NAN)
        });
        let (latency, _) = self.pipeline.navigator.gnss_latency_s();
        let state = ReferenceState {
            time: fix.time - Span::from_seconds(latency),
            position_ned: frame.to_ned(&position),
            velocity_ned,
            r_body_to_ned: None,
        };
        self.gnss.add(solution, &state, t);
    }

    /// The log has ended: what was not told yet of what is in force is told.
    pub fn close(&mut self) {
        self.pipeline.navigator.close();
        self.note_events();
    }

    fn note_events(&mut self) {
        if !self.pipeline.navigator.has_events() {
            return;
        }
        for event in self.pipeline.navigator.drain_events() {
            let t_s = self.mask.seconds(event.time);
            if let EventKind::Mode { to, .. } = event.kind {
                self.modes.push(ModeChange { t_s, mode: to });
            }
            self.events.push((t_s, event));
        }
    }

    /// Scores so far.
    pub fn outcome(&self) -> Outcome {
        let (reference, score) = if self.truth.compared > 0 {
            (ReferenceKind::Truth, &self.truth)
        } else {
            (ReferenceKind::Gnss, &self.gnss)
        };
        Outcome {
            duration_s: self.end.map_or(0.0, |e| self.seconds(e)),
            reference,
            aided: score.aided.report(),
            outages: score.outages.iter().map(OutageScore::report).collect(),
            start_errors_m: score.outages.iter().map(OutageScore::start_error_m).collect(),
            modes: self.modes.clone(),
            events: self.events.clone(),
            heard: self.heard,
            imu: self.imu,
        }
    }
}

impl Score {
    fn add(&mut self, solution: &Solution, reference: &ReferenceState, t: f64) {
        // A solution is one as soon as there is a mode that claims it, and in a hole there is none: that of before claims nothing of now.
        let later_s = reference.time.seconds_since(solution.time);
        if solution.mode == Mode::Aligning || !(-LATEST_REFERENCE_S..OLDEST_SOLUTION_S).contains(&later_s) {
            return;
        }
        self.compared += 1;
        let mut out = false;
        for o in self.outages.iter_mut().filter(|o| o.contains(t)) {
            o.add(t, solution, reference);
            out = true;
        }
        if !out && solution.mode == Mode::Aided {
            self.aided.add(&ErrorSample::between(solution, reference));
        }
    }
}

/// A reference may be so much older than the solution, s, as receivers are late, and so much newer: some samples of a slow IMU.
const LATEST_REFERENCE_S: f64 = 1.0;
const OLDEST_SOLUTION_S: f64 = 0.2;

/// What a replay's faults draw their noise from.
const FAULT_SEED: u64 = 1;

/// Plays a whole log, with faults put in.
///
/// # Errors
/// What reading it says.
pub fn run(
    log: &Log,
    settings: &PipelineSettings,
    outages: &[(f64, f64)],
    faults: &[InjectedFault],
    mut progress: impl FnMut(u64),
    mut watch: impl FnMut(&Runner, &AutopilotClock, &Input, &[OutboundMessage]),
) -> Result<(Runner, LogSummary), LogError> {
    let mut runner = Runner::new(settings, outages);
    runner.set_faults(faults.to_vec(), FAULT_SEED);
    runner.pipeline.follow(log.vehicle());
    if outages.is_empty() && faults.is_empty() {
        runner.fly_as_flown();
    }
    let runner = RefCell::new(runner);
    let summary = log.play_recording(
        |_, position| progress(position),
        |clock, item| {
            let mut runner = runner.borrow_mut();
            let sent = runner.take(clock, item).to_vec();
            watch(&runner, clock, item, &sent);
        },
        |aside| runner.borrow_mut().aside(aside),
    )?;
    let mut runner = runner.into_inner();
    runner.close();
    Ok((runner, summary))
}
