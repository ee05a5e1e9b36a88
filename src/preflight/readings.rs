//! What was heard of a vehicle.

use std::collections::BTreeMap;

use crate::sample::{Airframe, SampleKind};
use crate::time::Span;
use crate::wire::session::identity::Vehicle;

/// What was heard of a vehicle.
#[derive(Clone, Debug)]
pub struct Readings {
    /// Who it is.
    pub vehicle: Vehicle,
    /// What it can be expected to do, where it says so.
    pub airframe: Option<Airframe>,
    /// Whether its autopilot speaks MAVLink 1, which has no ODOMETRY.
    pub mavlink1: bool,
    /// Rate of each kind of sample, Hz, by `SampleKind as usize`; 0 where none comes.
    pub rates_hz: [f64; SampleKind::ALL.len()],
    /// Whether the newest GNSS message held a position.
    pub gnss_fix: bool,
    /// The shortest round trip of TIMESYNC, where any answer came.
    pub round_trip: Option<Span>,
    /// The parameters that were told.
    pub parameters: BTreeMap<String, f64>,
    /// Those that were asked for and not told.
    pub untold: Vec<String>,
}

impl Readings {
    /// Rate of a kind of sample, Hz.
    pub fn rate_hz(&self, kind: SampleKind) -> f64 {
        self.rates_hz[kind as usize]
    }

    /// Whether samples of a kind come.
    pub fn has(&self, kind: SampleKind) -> bool {
        self.rate_hz(kind) > 0.0
    }

    /// A parameter, where it was told.
    pub fn parameter(&self, name: &str) -> Option<f64> {
        self.parameters.get(name).copied()
    }

    /// Half of the round trip, ms: how late a message arrives.
    pub fn one_way_ms(&self) -> Option<f64> {
        self.round_trip.map(|r| r.seconds() * 500.0)
    }
}
