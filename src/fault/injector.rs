//! Samples on their way to the navigator, altered.

use std::collections::VecDeque;
use std::f64::consts::PI;

use nalgebra::{Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::sample::{Input, Sample};
use crate::time::Span;

use super::target::Sensor;
use super::{FaultKind, InjectedFault, alter, gnss};

/// Width of a gust and time from one to the next, s.
const GUST_S: [f64; 2] = [2.0, 10.0];
/// Samples that a late sensor may hold back.
const HELD: usize = 4096;
/// Who tells nothing for so long, s, is not only late.
const HOLE_S: f64 = 2.0;

/// A fault with what it has to remember.
#[derive(Clone, Debug)]
struct Running {
    fault: InjectedFault,
    chance: ChaCha8Rng,
    /// The newest sample of each sensor before the fault, or its first.
    held: Vec<Sample>,
    /// Samples that are told later, a line each sensor.
    late: Vec<Late>,
}

/// Samples of one sensor that are told later.
#[derive(Clone, Debug)]
struct Late {
    newest: Sample,
    waiting: VecDeque<Sample>,
    told: Option<Sample>,
}

/// Alters samples by faults, in the order in which those are given.
#[derive(Clone, Debug, Default)]
pub struct Injector {
    faults: Vec<Running>,
}

impl Injector {
    /// Faults whose noise is drawn from `seed`.
    pub fn new(faults: Vec<InjectedFault>, seed: u64) -> Self {
        let running = faults.into_iter().enumerate().map(|(i, fault)| {
            let mut chance = ChaCha8Rng::seed_from_u64(seed);
            chance.set_stream(i as u64);
            Running { fault, chance, held: Vec::new(), late: Vec::new() }
        });
        Self { faults: running.collect() }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.faults.is_empty()
    }

    /// What is heard of an input at `t_s`, s since the first sample: `None` when nothing is.
    pub fn alter(&mut self, t_s: f64, input: &Input) -> Option<Input> {
        let Input::Sample(sample) = input else { return Some(*input) };
        let mut told = *sample;
        for running in &mut self.faults {
            told = running.alter(t_s, told)?;
        }
        Some(Input::Sample(told))
    }
}

impl Running {
    fn alter(&mut self, t_s: f64, sample: Sample) -> Option<Sample> {
        if !self.fault.target.is_of(&sample) {
            return Some(sample);
        }
        if let FaultKind::Delay(delay_s) = self.fault.kind {
            return self.delayed(t_s, delay_s, sample);
        }
        let acts = (self.fault.from_s..self.fault.to_s).contains(&t_s);
        if self.fault.kind == FaultKind::Freeze {
            return Some(self.frozen(acts, sample));
        }
        if acts { self.told(t_s - self.fault.from_s, sample) } else { Some(sample) }
    }

    fn told(&mut self, since_s: f64, mut sample: Sample) -> Option<Sample> {
        let InjectedFault { target, kind, .. } = self.fault;
        if let Sample::Gnss(fix) = &mut sample
            && target.sensor == Sensor::Gnss
            && !matches!(kind, FaultKind::Drop(_))
        {
            *fix = gnss::altered(fix, &kind, since_s, || StandardNormal.sample(&mut self.chance));
            return Some(sample);
        }
        match kind {
            FaultKind::Drop(part) => return (self.chance.random::<f64>() >= part).then_some(sample),
            FaultKind::Swap => alter::whole(&target, &mut sample, |v| Vector3::new(v.y, v.x, v.z)),
            FaultKind::Turn(by) => {
                let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), by);
                alter::whole(&target, &mut sample, |v| turn * v);
            }
            _ => {
                let chance = &mut self.chance;
                alter::numbers(&target, &mut sample, &mut |_, x| number(&kind, since_s, x, chance));
            }
        }
        Some(sample)
    }

    /// The newest before it acts is told for as long as it does.
    fn frozen(&mut self, acts: bool, sample: Sample) -> Sample {
        let same = |held: &Sample| same_sensor(held, &sample);
        match self.held.iter_mut().find(|h| same(h)) {
            Some(held) if acts => alter::told_again(&self.fault.target, held, &sample),
            Some(held) => {
                *held = sample;
                sample
            }
            None => {
                self.held.push(sample);
                sample
            }
        }
    }

    /// What was `delay_s` ago, at the newest stamp; what was told last until the next is due.
    fn delayed(&mut self, t_s: f64, delay_s: f64, sample: Sample) -> Option<Sample> {
        let acts = (self.fault.from_s..self.fault.to_s).contains(&t_s);
        let at = self.late.iter().position(|line| same_sensor(&line.newest, &sample));
        let line = match at {
            Some(at) => &mut self.late[at],
            None => {
                self.late.push(Late { newest: sample, waiting: VecDeque::new(), told: None });
                self.late.last_mut()?
            }
        };
        line.newest = sample;
        line.waiting.push_back(sample);
        let due = sample.time() - Span::from_seconds(delay_s);
        while line.waiting.len() > HELD || line.waiting.front().is_some_and(|s| s.time() <= due) {
            line.told = line.waiting.pop_front();
        }
        if acts {
            // What was due in a hole was not heard.
            let old = line.told.filter(|old| due.seconds_since(old.time()) < HOLE_S);
            old.map(|old| alter::told_again(&self.fault.target, &old, &sample))
        } else {
            Some(sample)
        }
    }
}

/// What becomes of one number.
fn number(kind: &FaultKind, since_s: f64, x: f64, chance: &mut ChaCha8Rng) -> f64 {
    match *kind {
        FaultKind::StuckAt(v) => v,
        FaultKind::Bias(v) => x + v,
        FaultKind::Ramp(v) => x + v * since_s,
        FaultKind::Scale(v) => x * v,
        FaultKind::Noise(sigma) => {
            let n: f64 = StandardNormal.sample(chance);
            x + sigma * n
        }
        FaultKind::Gust(v) => {
            let [width_s, every_s] = GUST_S;
            let t = since_s % every_s;
            x + if t < width_s { v * (PI * t / width_s).sin() } else { 0.0 }
        }
        FaultKind::Flip => -x,
        FaultKind::NotANumber => f64::NAN,
        _ => x,
    }
}

fn same_sensor(a: &Sample, b: &Sample) -> bool {
    match (a, b) {
        (Sample::Imu(_), Sample::Imu(_)) | (Sample::Airspeed(_), Sample::Airspeed(_)) => true,
        (Sample::Mag(a), Sample::Mag(b)) => a.sensor == b.sensor,
        (Sample::Gnss(a), Sample::Gnss(b)) => a.receiver == b.receiver,
        (Sample::Pressure(a), Sample::Pressure(b)) => a.sensor == b.sensor,
        (Sample::Flow(a), Sample::Flow(b)) => a.sensor == b.sensor,
        (Sample::Range(a), Sample::Range(b)) => a.sensor == b.sensor,
        (Sample::Landmark(a), Sample::Landmark(b)) => a.camera == b.camera && a.id == b.id,
        _ => false,
    }
}
