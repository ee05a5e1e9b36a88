//! The shadows: while GNSS is trusted, dead reckonings that begin at the running filter's state and go on without GNSS, so that this flight's own
//! drift is measured before it matters, and what is claimed in an outage is proven.
//!
//! ```text
//! filter, just corrected by a fix -> run (a copy; IMU, magnetometer, height, and what carries) -> 10, 30, 60, 120 s later: a fix less the run
//!        -> factor: how many times its claimed growth that is -> drift, by what carried -> growth of an outage's covariance, times its factor
//! ```
//!
//! Two run at a time: one with whatever carries, for 10 s and in turns for up to 120 s, and one that goes on without it, since what carries may end,
//! too: on inertia alone for 10 s, and in turns, where flow carries, without flow for 10 and 30 s, on the air or on whatever is left. The filter of an outage is left as it is: its gains weigh one source against another, and were they changed with
//! the factors, a magnetometer or a height that is wrong would gain weight. It is what is published that is multiplied.

mod drift;
mod factor;
mod growth;
mod run;

use nalgebra::{Matrix2, Vector2};

use crate::filter::error_state::JumpWindow;
use crate::sample::ImuSample;
use crate::time::AutopilotTime;

use super::context::SourceFacts;
use super::environment::LocalEnvironment;
use super::estimator::{ErrorStateStage, StepInput};
use super::memory::DriftMemory;
use super::observation::Observation;
use super::solution::{Mode, VelocitySource};
use super::sources::{airspeed, drag};
use super::timeline::Timeline;
use crate::navigator::tuning::shadow::{FIX_NOISE_FIXES, FLIES_M, FLIES_MPS, HORIZONS_S, WANDER_S};
pub(super) use drift::ProvenDrift;
pub use drift::{DriftComparison, MeasuredDrift};
use factor::DriftError;
pub(super) use growth::Growth;
use run::{Goes, Present, Run};

/// What fixes are off by for themselves: the mean square of their innovations an axis, m².
#[derive(Clone, Copy, Debug, Default)]
struct FixNoise {
    fixes: f64,
    square: f64,
}

impl FixNoise {
    fn add(&mut self, error: &Vector2<f64>) {
        self.fixes = (self.fixes + 1.0).min(FIX_NOISE_FIXES);
        self.square += (0.5 * error.norm_squared() - self.square) / self.fixes;
    }
}

/// A place for runs, one after the other; its memory is kept.
#[derive(Clone, Debug)]
struct Slot {
    run: Option<Box<Run>>,
    /// The run goes on, to this horizon.
    going: Option<usize>,
    /// With what the runs go and how far, in turns, and whose turn it is.
    turns: &'static [(Goes, usize)],
    turn: usize,
    /// What its runs were compared with fixes last.
    newest: Option<DriftComparison>,
}

impl Slot {
    fn new(turns: &'static [(Goes, usize)]) -> Self {
        Self { run: None, going: None, turns, turn: 0, newest: None }
    }

    fn going(&mut self) -> Option<&mut Run> {
        self.run.as_deref_mut().filter(|_| self.going.is_some())
    }

    /// Begins the next run at the filter, if none goes on.
    fn restart(&mut self, now: AutopilotTime, filter: &ErrorStateStage, present: &Present) {
        if self.going.is_some() {
            return;
        }
        let (goes, horizon) = match self.turns[self.turn % self.turns.len()] {
            // Where flow does not carry that is the other place's.
            (Goes::WithoutFlow, _) if present.carrier != VelocitySource::Flow => (Goes::Coasting, 0),
            turn => turn,
        };
        let run = Run::start(now, filter, goes);
        match &mut self.run {
            Some(place) => **place = run,
            None => self.run = Some(Box::new(run)),
        }
        self.going = Some(horizon);
    }

    /// The run has reached this horizon.
    fn reached(&mut self, horizon: usize) {
        if self.going == Some(horizon) {
            self.going = None;
            self.turn = (self.turn + 1) % self.turns.len();
        }
    }
}

/// With all that carries: most of the runs are short, so that there are many; up to horizon i of [`HORIZONS_S`].
const CARRIED: [(Goes, usize); 7] = [
    (Goes::Carried, 0),
    (Goes::Carried, 0),
    (Goes::Carried, 1),
    (Goes::Carried, 0),
    (Goes::Carried, 2),
    (Goes::Carried, 0),
    (Goes::Carried, 3),
];
/// With what is left when that ends.
const LEFT: [(Goes, usize); 4] =
    [(Goes::Coasting, 0), (Goes::WithoutFlow, 0), (Goes::Coasting, 0), (Goes::WithoutFlow, 1)];

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(super) struct Shadows {
    slots: [Slot; 2],
    drift: ProvenDrift,
    fix_noise: FixNoise,
    present: Present,
    /// Which of airspeed and drag was there last.
    air: VelocitySource,
    /// GNSS is.
    trusted: bool,
    beside: TimeBeside,
}

/// What the time beside trusted GNSS was spent with, s: dead reckonings are compared in flight alone.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TimeBeside {
    /// All of it.
    pub trusted_s: f64,
    /// In flight.
    pub flown_s: f64,
    /// Slow, and at a height above the ground that is not known: a hover, or none.
    pub unseen_s: f64,
}

/// What carries the velocity without GNSS, as things are at present.
pub(super) fn carrier(facts: &SourceFacts, now: AutopilotTime) -> VelocitySource {
    if facts.flow_trusted && super::estimator::has_flow(facts, now) {
        VelocitySource::Flow
    } else if facts.resting {
        VelocitySource::Standstill
    } else {
        by_air(facts, now).unwrap_or(VelocitySource::Inertial)
    }
}

/// Airspeed or drag, whichever can carry.
fn by_air(facts: &SourceFacts, now: AutopilotTime) -> Option<VelocitySource> {
    if airspeed::carries(facts, now) {
        Some(VelocitySource::Airspeed)
    } else if drag::carries(facts, now) {
        Some(VelocitySource::Drag)
    } else {
        None
    }
}

/// A fix, and how far it lies from the filter.
#[derive(Clone, Copy, Debug)]
struct FixSeen {
    measured: AutopilotTime,
    /// NE, m.
    error: Vector2<f64>,
    /// As claimed, an axis, m.
    sigma_m: f64,
}

impl Shadows {
    pub(super) fn new() -> Self {
        Self {
            slots: [Slot::new(&CARRIED), Slot::new(&LEFT)],
            drift: ProvenDrift::new(),
            fix_noise: FixNoise::default(),
            present: Present { carrier: VelocitySource::Inertial, air: None, flies: false },
            air: VelocitySource::Drag,
            trusted: false,
            beside: TimeBeside::default(),
        }
    }

    /// What was learned.
    pub(super) fn drift(&self) -> &ProvenDrift {
        &self.drift
    }

    /// What the time was spent with.
    pub(super) fn beside(&self) -> TimeBeside {
        self.beside
    }

    /// It was learned before.
    pub(super) fn recall(&mut self, memory: &DriftMemory) {
        self.drift.recall(memory);
    }

    /// What was measured, whatever would carry an outage that began now first.
    pub(super) fn measured(&self) -> Vec<MeasuredDrift> {
        self.drift.measured(self.present.carrier, self.air)
    }

    /// What each place's runs were compared with fixes last.
    pub(super) fn comparisons(&self) -> [Option<DriftComparison>; 2] {
        self.slots.each_ref().map(|slot| slot.newest)
    }

    /// What innovations without GNSS show of jumps of the IMU's axes, while a shadow with all that carries goes on.
    pub(super) fn jump_windows(&self) -> &[JumpWindow] {
        let carried = &self.slots[0];
        carried.run.as_deref().filter(|_| carried.going.is_some()).map_or(&[], Run::jump_windows)
    }

    /// Whatever sets the filter's state anew makes the comparison void.
    pub(super) fn abort(&mut self) {
        self.slots.iter_mut().for_each(|s| s.going = None);
    }

    /// One IMU sample; `speed_mps` is the filter's.
    pub(super) fn step(
        &mut self,
        s: &ImuSample,
        dt: f64,
        input: &StepInput<'_>,
        facts: &SourceFacts,
        speed_mps: f64,
    ) {
        self.trusted = matches!(input.mode, Mode::Aided | Mode::Rejoining);
        if !self.trusted {
            self.abort();
            return;
        }
        let above_m = input.height_m.zip(facts.ground).map(|(h, ground)| h - ground.height_m);
        let flies = !facts.resting && (speed_mps > FLIES_MPS || above_m.is_some_and(|h| h > FLIES_M));
        self.beside.trusted_s += dt;
        match flies {
            true => self.beside.flown_s += dt,
            false if !facts.resting && above_m.is_none() => self.beside.unseen_s += dt,
            false => {}
        }
        let air = by_air(facts, s.time);
        self.air = air.unwrap_or(self.air);
        self.present = Present { carrier: carrier(facts, s.time), air, flies };
        for slot in &mut self.slots {
            if let Some(run) = slot.going()
                && !run.step(s, dt, input.environment, input.height_m, &self.present)
            {
                slot.going = None;
            }
        }
    }

    /// What the filter is about to take.
    pub(super) fn observe(
        &mut self,
        now: AutopilotTime,
        observation: &Observation,
        filter: &ErrorStateStage,
        timeline: &Timeline,
        environment: &LocalEnvironment,
    ) {
        if let Observation::Fix { measured, position_error, sigma, .. } = observation {
            let fix = FixSeen { measured: *measured, error: *position_error, sigma_m: sigma[0] };
            self.compare(now, &fix, filter, environment);
            self.fix_noise.add(position_error);
            return;
        }
        for slot in &mut self.slots {
            if let Some(run) = slot.going() {
                run.observe(now, observation, filter, (timeline, environment), &self.present);
            }
        }
    }

    fn compare(
        &mut self,
        now: AutopilotTime,
        fix: &FixSeen,
        filter: &ErrorStateStage,
        environment: &LocalEnvironment,
    ) {
        for slot in &mut self.slots {
            let Some(run) = slot.going() else { continue };
            let age_s = run.age_s(fix.measured);
            let horizon = run.horizon;
            if age_s < HORIZONS_S[horizon] {
                continue;
            }
            run.horizon += 1;
            // Where nothing carries both coast, and the same is not counted twice.
            let twice = |s: &VelocitySource| {
                *s == VelocitySource::Inertial && run.goes == Goes::Carried && horizon == 0
            };
            let carrier = run.carrier().filter(|s| !twice(s));
            let factor = carrier.and_then(|s| Some((s, self.drift.of_mut(s)?)));
            if let Some((source, factor)) = factor {
                let drifted = run.drifted(now, fix.measured, &fix.error, filter, environment);
                // The receiver's error of the start is the shadow's, too; what it has changed by since is not: 2 σ² (1 − e^(−t/τ)) of a Markov process.
                let wander = 2.0 * fix.sigma_m.powi(2) * (1.0 - (-age_s / WANDER_S).exp());
                let noise = Matrix2::identity() * (self.fix_noise.square + wander);
                let growth = drifted.claimed - drifted.start;
                let source = if source == VelocitySource::Airspeed { self.air } else { source };
                let drift = DriftError { error: drifted.error, growth, rest: drifted.start + noise };
                slot.newest = Some(DriftComparison::foretold(now, source, age_s, &drift, factor));
                factor.learn(horizon, &drift);
            }
            slot.reached(horizon);
        }
    }

    /// The filter has taken a fix: what has ended begins again from there.
    pub(super) fn restart(&mut self, now: AutopilotTime, filter: &ErrorStateStage) {
        if !self.trusted {
            return;
        }
        let present = self.present;
        self.slots.iter_mut().for_each(|slot| slot.restart(now, filter, &present));
    }
}
