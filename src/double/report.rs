//! What a flight of the double comes to: when GNSS was lost and back, how far its own estimate led it astray meanwhile, and how it ended.

use nalgebra::Vector3;
use serde::Serialize;

use crate::sim::autopilot::external::{ExternalCounts, ExternalFate};
use crate::sim::autopilot::{FlightMode, SimulatedAutopilot, VehicleNews};

/// The report of one flight. Distances are horizontal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct DoubleReport {
    /// When GNSS was lost, s.
    pub lost_s: Option<f64>,
    /// When it was back, s.
    pub back_s: Option<f64>,
    /// How far the vehicle's estimate moved from the truth since the loss, and so the vehicle from where it was to be: when GNSS came
    /// back, and at most, m.
    pub drift_end_m: f64,
    /// At most, m.
    pub drift_max_m: f64,
    /// When the failsafe acted, s.
    pub failsafe_s: Option<f64>,
    /// When it landed and disarmed, s.
    pub landed_s: Option<f64>,
    /// Messages of external navigation that came, …
    pub external: u64,
    /// … that were fused or jumped to, …
    pub fused: u64,
    /// … and that the gate refused.
    pub gated: u64,
}

/// Keeps the report as the flight goes on.
#[derive(Clone, Debug, Default)]
pub(super) struct FlightRecord {
    report: DoubleReport,
    error_at_loss: Option<Vector3<f64>>,
    was_armed: bool,
    news: Vec<(f64, VehicleNews)>,
}

impl FlightRecord {
    /// Looks at the vehicle after a step.
    pub(super) fn look(&mut self, vehicle: &SimulatedAutopilot) {
        let (now_s, report) = (vehicle.now_s(), &mut self.report);
        if let (true, Some(error)) = (vehicle.gnss_is_lost() && vehicle.armed(), vehicle.estimate_error()) {
            report.lost_s.get_or_insert(now_s);
            let drift_m = (error - *self.error_at_loss.get_or_insert(error)).xy().norm();
            report.drift_end_m = drift_m;
            report.drift_max_m = report.drift_max_m.max(drift_m);
        } else if report.lost_s.is_some() && !vehicle.gnss_is_lost() {
            report.back_s.get_or_insert(now_s);
        }
        if vehicle.mode() == FlightMode::FailsafeLanding {
            report.failsafe_s.get_or_insert(now_s);
        }
        if self.was_armed && !vehicle.armed() {
            report.landed_s = Some(now_s);
        }
        self.was_armed = vehicle.armed();
    }

    /// Keeps a piece of news.
    pub(super) fn keep(&mut self, now_s: f64, news: VehicleNews) {
        self.news.push((now_s, news));
    }

    /// The news since it was asked last.
    pub(super) fn take_news(&mut self) -> Vec<(f64, VehicleNews)> {
        std::mem::take(&mut self.news)
    }

    /// The report so far.
    pub(super) fn report(&self, counts: &ExternalCounts) -> DoubleReport {
        DoubleReport {
            external: counts.total(),
            fused: counts.of(ExternalFate::Fused) + counts.of(ExternalFate::Jumped),
            gated: counts.of(ExternalFate::Gated),
            ..self.report
        }
    }
}
