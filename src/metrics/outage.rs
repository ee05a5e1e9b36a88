//! One outage of GNSS, scored.

use nalgebra::Vector3;
use serde::Serialize;

use super::{ErrorSample, ReferenceState, Rms};
use crate::navigator::solution::{Mode, Solution};

/// What happened in an outage so far.
#[derive(Clone, Debug)]
pub struct OutageScore {
    start_s: f64,
    end_s: f64,
    distance_m: f64,
    last: Option<Vector3<f64>>,
    start_error_m: Option<f64>,
    end_error_m: Option<f64>,
    max_error_m: Option<f64>,
    sigma_end_m: Option<f64>,
    worst_sigmas: Option<f64>,
    lost_at_s: Option<f64>,
    altitude: Rms,
    /// Position messages that were sent.
    pub sent_messages: u64,
}

/// The same, as numbers to print.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct OutageReport {
    /// Start, s since the first sample.
    pub start_s: f64,
    /// End, s since the first sample.
    pub end_s: f64,
    /// Distance travelled by the reference, m.
    pub distance_m: Option<f64>,
    /// Horizontal error at the end, m.
    pub horizontal_error_end_m: Option<f64>,
    /// Largest horizontal error, m.
    pub horizontal_error_max_m: Option<f64>,
    /// Horizontal error at the end over distance, %.
    pub drift_percent: Option<f64>,
    /// Altitude error, root mean square, m.
    pub altitude_rmse_m: Option<f64>,
    /// Standard deviation of the horizontal error that the navigator claimed at the end, m.
    pub sigma_end_m: Option<f64>,
    /// Largest horizontal error over the standard deviation claimed for it then, while one was claimed: until Lost.
    pub worst_sigmas: Option<f64>,
    /// When it was called lost, s since the first sample.
    pub lost_at_s: Option<f64>,
    /// Position messages that were sent to the autopilot.
    pub sent_messages: u64,
}

/// A vehicle that moved less than this has no drift in percent, m.
const LEAST_DISTANCE_M: f64 = 1.0;
/// References further apart than this are not the same motion (a hole in the log), m.
const LARGEST_STEP_M: f64 = 1000.0;

impl OutageScore {
    /// An outage from `start_s` to `end_s`.
    pub fn new(start_s: f64, end_s: f64) -> Self {
        Self {
            start_s,
            end_s,
            distance_m: 0.0,
            last: None,
            start_error_m: None,
            end_error_m: None,
            max_error_m: None,
            sigma_end_m: None,
            worst_sigmas: None,
            lost_at_s: None,
            altitude: Rms::default(),
            sent_messages: 0,
        }
    }

    /// Whether `t_s` lies in it.
    pub fn contains(&self, t_s: f64) -> bool {
        self.start_s <= t_s && t_s < self.end_s
    }

    /// Start, s.
    pub fn start_s(&self) -> f64 {
        self.start_s
    }

    /// End, s.
    pub fn end_s(&self) -> f64 {
        self.end_s
    }

    /// Horizontal error when it began, m.
    pub fn start_error_m(&self) -> Option<f64> {
        self.start_error_m
    }

    /// Adds a comparison within the outage, `t_s` s since the first sample.
    pub fn add(&mut self, t_s: f64, solution: &Solution, reference: &ReferenceState) {
        let e = ErrorSample::between(solution, reference);
        if let Some(last) = self.last {
            let step = (reference.position_ned - last).norm();
            if step < LARGEST_STEP_M {
                self.distance_m += step;
            }
        }
        self.last = Some(reference.position_ned);
        self.start_error_m.get_or_insert(e.horizontal_m);
        self.end_error_m = Some(e.horizontal_m);
        self.max_error_m = Some(self.max_error_m.map_or(e.horizontal_m, |m| m.max(e.horizontal_m)));
        let sigma_m = solution.horizontal_sigma_m();
        self.sigma_end_m = Some(sigma_m);
        if solution.mode == Mode::Lost {
            self.lost_at_s.get_or_insert(t_s);
        } else if self.lost_at_s.is_none() && sigma_m > 0.0 {
            self.worst_sigmas = Some(self.worst_sigmas.unwrap_or(0.0).max(e.horizontal_m / sigma_m));
        }
        self.altitude.add(e.altitude_m);
    }

    /// As numbers.
    pub fn report(&self) -> OutageReport {
        let compared = self.last.is_some();
        let drift = self
            .end_error_m
            .filter(|_| self.distance_m > LEAST_DISTANCE_M)
            .map(|e| 100.0 * e / self.distance_m);
        OutageReport {
            start_s: self.start_s,
            end_s: self.end_s,
            distance_m: compared.then_some(self.distance_m),
            horizontal_error_end_m: self.end_error_m,
            horizontal_error_max_m: self.max_error_m,
            drift_percent: drift,
            altitude_rmse_m: self.altitude.value(),
            sigma_end_m: self.sigma_end_m,
            worst_sigmas: self.worst_sigmas,
            lost_at_s: self.lost_at_s,
            sent_messages: self.sent_messages,
        }
    }
}
