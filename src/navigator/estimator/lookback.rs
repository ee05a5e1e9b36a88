//! What the filter was some seconds ago, and what the IMU has felt since: a measurement that was believed and should not have been is
//! undone by going back to before it and coming forward on inertia alone, with the covariance that belongs to that.

use std::collections::VecDeque;

use nalgebra::Vector3;

use crate::filter::error_state::Eskf;
use crate::sample::ImuSample;
use crate::time::AutopilotTime;

use super::super::environment::LocalEnvironment;
use crate::navigator::tuning::lookback::{FELT, SNAPSHOTS, SPACING_S};

/// An IMU sample over the interval before it.
#[derive(Clone, Copy, Debug)]
struct Felt {
    time: AutopilotTime,
    dt: f64,
    rate: Vector3<f64>,
    force: Vector3<f64>,
}

/// See the module's documentation. Nothing is allocated after construction.
#[derive(Clone, Debug)]
pub(super) struct Lookback {
    /// Oldest first, each after the sample of its time.
    snapshots: VecDeque<(AutopilotTime, Eskf)>,
    felt: VecDeque<Felt>,
}

impl Lookback {
    pub(super) fn new() -> Self {
        Self { snapshots: VecDeque::with_capacity(SNAPSHOTS), felt: VecDeque::with_capacity(FELT) }
    }

    /// The filter was set anew: what it was before is no past of it.
    pub(super) fn forget(&mut self) {
        self.snapshots.clear();
        self.felt.clear();
    }

    /// The filter has taken a sample over `dt` s.
    pub(super) fn note(&mut self, s: &ImuSample, dt: f64, filter: &Eskf) {
        if self.felt.len() == FELT {
            self.felt.pop_front();
        }
        self.felt.push_back(Felt {
            time: s.time,
            dt,
            rate: s.angular_rate.raw(),
            force: s.specific_force.raw(),
        });
        if self.snapshots.back().is_none_or(|(t, _)| s.time.seconds_since(*t) >= SPACING_S) {
            if self.snapshots.len() == SNAPSHOTS {
                self.snapshots.pop_front();
            }
            self.snapshots.push_back((s.time, filter.clone()));
        }
    }

    /// The filter as it would be had nothing but the IMU been heard since `then`, or since the oldest instant that is remembered. `None` when
    /// nothing is.
    pub(super) fn since(&mut self, then: AutopilotTime, environment: &LocalEnvironment) -> Option<Eskf> {
        let begun = self.felt.front()?.time;
        let usable = |(t, _): &&(AutopilotTime, Eskf)| *t >= begun;
        let before = self.snapshots.iter().filter(usable).rev().find(|(t, _)| *t <= then);
        let (from, mut filter) = before.or_else(|| self.snapshots.iter().find(usable)).cloned()?;
        let LocalEnvironment { gravity_ned, earth_rate_ned, .. } = environment;
        for felt in self.felt.iter().filter(|f| f.time > from) {
            filter.predict(felt.dt, &felt.rate, &felt.force, gravity_ned, earth_rate_ned);
        }
        // What was filtered since is no past of what is now.
        self.snapshots.retain(|(t, _)| *t <= from);
        filter.is_finite().then_some(filter)
    }
}
