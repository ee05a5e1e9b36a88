//! A satellite navigation receiver.

use crate::sim::noise::{GaussMarkov, SensorRng, Stream};
use crate::sim::trajectory::Trajectory;
use nalgebra::Vector3;

/// Errors of a receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GnssModel {
    /// Time between fixes, s.
    pub period_s: f64,
    /// How old a fix is when it arrives; its stamp is the time of arrival, s.
    pub latency_s: f64,
    /// White noise of the position an axis of NED, m.
    pub position_m: Vector3<f64>,
    /// Correlated error of the horizontal position an axis, m.
    pub wander_m: GaussMarkov,
    /// How much worse the wander of the height is.
    pub vertical_factor: f64,
    /// White noise of the velocity an axis of NED, m/s.
    pub velocity_mps: Vector3<f64>,
    /// Horizontal and vertical accuracy, m, and speed accuracy, m/s, as the receiver claims them.
    pub claims: [f64; 3],
    /// When it has no fix.
    pub outage: Option<GnssOutage>,
}

/// A time without a fix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GnssOutage {
    /// Begins, s.
    pub from_s: f64,
    /// Ends, s.
    pub to_s: f64,
    /// What the receiver says meanwhile.
    pub kind: OutageKind,
}

/// What a receiver says when it has no fix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutageKind {
    /// Nothing at all.
    Silent,
    /// That there is no fix.
    NoFix,
}

impl GnssModel {
    /// No errors, no latency, 5 Hz.
    pub fn ideal() -> Self {
        Self {
            period_s: 0.2,
            latency_s: 0.0,
            position_m: Vector3::zeros(),
            wander_m: GaussMarkov { sigma: 0.0, correlation: 60.0 },
            vertical_factor: 1.0,
            velocity_mps: Vector3::zeros(),
            claims: [1.0, 1.0, 0.1],
            outage: None,
        }
    }

    /// A single-frequency receiver: 0.3 m of noise on 1 m of wander (60 s), 0.1 m/s, 0.2 s late.
    pub fn single() -> Self {
        Self {
            latency_s: 0.2,
            position_m: Vector3::new(0.3, 0.3, 0.5),
            wander_m: GaussMarkov { sigma: 1.0, correlation: 60.0 },
            vertical_factor: 1.7,
            velocity_mps: Vector3::new(0.1, 0.1, 0.15),
            // Honest: the roots of the summed variances.
            claims: [1.5, 1.8, 0.15],
            ..Self::ideal()
        }
    }
}

/// What the receiver said.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GnssReading {
    /// When the fix held, s: the latency before it arrived.
    pub measured_s: f64,
    /// Whether there was a fix; else the numbers are what a fix would have said.
    pub has_fix: bool,
    /// Whether anything was sent.
    pub is_sent: bool,
    /// Position in NED, m.
    pub position_ned: Vector3<f64>,
    /// Velocity in NED, m/s.
    pub velocity_ned: Vector3<f64>,
    /// As [`GnssModel::claims`].
    pub claims: [f64; 3],
}

/// A receiver in flight.
#[derive(Clone, Debug)]
pub(in crate::sim) struct Gnss {
    model: GnssModel,
    rng: SensorRng,
    wander: Vector3<f64>,
}

impl Gnss {
    pub(in crate::sim) fn new(model: GnssModel, seed: u64) -> Self {
        let mut rng = SensorRng::new(seed, Stream::Gnss);
        let wander = rng.normals() * model.wander_m.sigma;
        Self { model, rng, wander }
    }

    /// The fix that arrives at `now_s`; `None` before the first can.
    pub(in crate::sim) fn sample(&mut self, trajectory: &dyn Trajectory, now_s: f64) -> Option<GnssReading> {
        let m = self.model;
        self.wander = m.wander_m.next3(&self.wander, m.period_s, &self.rng.normals());
        let (position_noise, velocity_noise) = (self.rng.normals(), self.rng.normals());
        let measured_s = now_s - m.latency_s;
        // A nanosecond before the beginning is rounding.
        if measured_s < -1e-9 {
            return None;
        }
        let truth = trajectory.at(measured_s);
        let wander = self.wander.component_mul(&Vector3::new(1.0, 1.0, m.vertical_factor));
        let lost = m.outage.filter(|o| (o.from_s..o.to_s).contains(&now_s)).map(|o| o.kind);
        Some(GnssReading {
            measured_s,
            has_fix: lost.is_none(),
            is_sent: lost != Some(OutageKind::Silent),
            position_ned: truth.position_ned + wander + position_noise.component_mul(&m.position_m),
            velocity_ned: truth.velocity_ned + velocity_noise.component_mul(&m.velocity_mps),
            claims: m.claims,
        })
    }
}
