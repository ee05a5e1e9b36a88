//! What was learned of the drift, by what carries, and what follows from it for an outage.

use std::fmt;

use serde::Serialize;

use super::super::memory::DriftMemory;
use super::super::solution::VelocitySource;
use super::factor::{DriftError, DriftFactor};
use crate::navigator::tuning::shadow::{HORIZONS_S, PRIOR_LOG2, PRIOR_LOG2_FLOW, TOLD_S};
use crate::time::AutopilotTime;

/// One of each that is learned.
pub(super) const SOURCES: [VelocitySource; 3] =
    [VelocitySource::Flow, VelocitySource::Airspeed, VelocitySource::Inertial];

/// Factors on standard deviations. Airspeed and drag are learned as one: no vehicle has both.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct ProvenDrift {
    flow: DriftFactor,
    air: DriftFactor,
    inertial: DriftFactor,
}

/// What shadows have measured at one age of a dead reckoning.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MeasuredDrift {
    /// What carried.
    pub source: VelocitySource,
    /// Time without GNSS, s.
    pub after_s: f64,
    /// Root mean square of the errors, m; `None` where none was measured.
    pub error_m: Option<f64>,
    /// Comparisons on this flight.
    pub times: u32,
    /// By what the claimed standard deviation of the drift is multiplied.
    pub factor: f64,
}

/// One dead reckoning beside GNSS, compared with a fix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriftComparison {
    /// When.
    pub time: AutopilotTime,
    /// What carried.
    pub source: VelocitySource,
    /// Time without GNSS, s.
    pub age_s: f64,
    /// Length of the horizontal error, m.
    pub error_m: f64,
    /// Its standard deviation as it was claimed before this comparison, √trace, m: the grown covariance times the factor in force then,
    /// and what the comparison itself is wrong by.
    pub sigma_m: f64,
}

impl DriftComparison {
    /// What the factor said of an error before it learned of it.
    pub(super) fn foretold(
        time: AutopilotTime,
        source: VelocitySource,
        age_s: f64,
        drift: &DriftError,
        factor: &DriftFactor,
    ) -> Self {
        let variance = drift.growth.trace() * factor.at(age_s).powi(2) + drift.rest.trace();
        Self { time, source, age_s, error_m: drift.error.norm(), sigma_m: variance.max(0.0).sqrt() }
    }
}

impl MeasuredDrift {
    /// Which of them to tell in a line: of what would carry now the longest that was measured, up to a minute, or that none was.
    pub fn to_tell(all: &[MeasuredDrift]) -> Option<MeasuredDrift> {
        let first = all.first()?;
        let mut told = all.iter().filter(|m| m.source == first.source && m.after_s <= TOLD_S).rev();
        let longest = told.next()?;
        let measured = std::iter::once(longest).chain(told).find(|m| m.times > 0);
        Some(*measured.unwrap_or(longest))
    }
}

impl fmt::Display for MeasuredDrift {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { source, after_s, error_m, times, .. } = self;
        write!(f, "after {after_s:.0} s without GNSS, on {}, ", source.label())?;
        match error_m {
            Some(error_m) => write!(f, "{error_m:.1} m off, measured {times} times on this flight"),
            None => write!(f, "not measured yet"),
        }
    }
}

impl ProvenDrift {
    pub(super) fn new() -> Self {
        Self {
            flow: DriftFactor::new(PRIOR_LOG2_FLOW),
            air: DriftFactor::new(PRIOR_LOG2),
            inertial: DriftFactor::new(PRIOR_LOG2),
        }
    }

    fn of(&self, source: VelocitySource) -> Option<&DriftFactor> {
        match source {
            VelocitySource::Flow => Some(&self.flow),
            VelocitySource::Airspeed | VelocitySource::Drag => Some(&self.air),
            VelocitySource::Inertial => Some(&self.inertial),
            VelocitySource::Gnss | VelocitySource::Landmarks | VelocitySource::Standstill => None,
        }
    }

    pub(super) fn of_mut(&mut self, source: VelocitySource) -> Option<&mut DriftFactor> {
        match source {
            VelocitySource::Flow => Some(&mut self.flow),
            VelocitySource::Airspeed | VelocitySource::Drag => Some(&mut self.air),
            VelocitySource::Inertial => Some(&mut self.inertial),
            VelocitySource::Gnss | VelocitySource::Landmarks | VelocitySource::Standstill => None,
        }
    }

    /// What was learned, to be kept.
    pub(in super::super) fn memory(&self) -> DriftMemory {
        let Self { flow, air, inertial } = self;
        DriftMemory { flow: flow.memory(), air: air.memory(), inertial: inertial.memory() }
    }

    /// It was learned before.
    pub(super) fn recall(&mut self, memory: &DriftMemory) {
        self.flow.recall(&memory.flow);
        self.air.recall(&memory.air);
        self.inertial.recall(&memory.inertial);
    }

    /// By what the claimed standard deviation is to be multiplied, `age_s` after GNSS was lost.
    pub(in super::super) fn factor(&self, source: VelocitySource, age_s: f64) -> f64 {
        self.of(source).map_or(1.0, |factor| factor.at(age_s))
    }

    /// What was measured, by age; of `first` also the ages at which nothing was, and it comes first. `air` is which of airspeed and drag
    /// the vehicle has.
    pub(in super::super) fn measured(
        &self,
        first: VelocitySource,
        air: VelocitySource,
    ) -> Vec<MeasuredDrift> {
        let all = [VelocitySource::Flow, air, VelocitySource::Inertial];
        let others = all.into_iter().filter(|s| *s != first);
        let all = std::iter::once(first).chain(others).flat_map(|source| {
            let factor = self.of(source);
            HORIZONS_S.iter().enumerate().filter_map(move |(horizon, &after_s)| {
                let (times, error_m) = factor?.measured(horizon);
                Some(MeasuredDrift { source, after_s, error_m, times, factor: factor?.at(after_s) })
            })
        });
        all.filter(|m| m.times > 0 || m.source == first).collect()
    }
}
