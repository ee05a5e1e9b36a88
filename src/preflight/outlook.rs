//! What a loss of GNSS would be carried by, told before the flight.
//!
//! Where nothing but inertia is there, the drift is that of the error budget's coasting: initial velocity ∝ t, tilt ∝ g·t²/2, gyro
//! bias ∝ g·t³/6 ([`crate::navigator::monitor::budget`]). An autopilot that lands at once drifts less, and is told so.

use nalgebra::{Matrix2, Matrix4};
use serde::Serialize;

use crate::navigator::monitor::budget::ErrorBudget;
use crate::sample::{Airframe, SampleKind};
use crate::wire::session::identity::AutopilotKind;

use super::finding::{Finding, FindingGrade, plain};
use super::readings::Readings;
use super::{Case, Needs, ardupilot};

/// The drift by inertia is told for this time, s.
const AFTER_S: f64 = 15.0;
/// Steps of the error budget, s.
const STEP_S: f64 = 0.1;

/// What a loss would be carried by.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Outlook {
    /// `flow`, `landmarks`, `airspeed`, `drag` or `inertia`.
    pub carried_by: &'static str,
    /// In words.
    pub text: String,
    /// How far the position drifts by inertia alone (1 sigma) in [`Outlook::after_s`], m; where nothing better is certain.
    pub inertial_drift_m: Option<f64>,
    /// See [`Outlook::inertial_drift_m`], s.
    pub after_s: f64,
    /// What follows from it.
    #[serde(skip)]
    pub(super) finding: Option<Finding>,
}

/// How far the position drifts by inertia alone in `seconds`, m, 1 sigma.
fn coasting_m(needs: &Needs, seconds: f64) -> f64 {
    let mut budget = ErrorBudget::new(needs.budget, Matrix2::zeros(), Matrix4::zeros());
    for _ in 0..(seconds / STEP_S).round() as u32 {
        budget.coasted(STEP_S);
    }
    budget.position(true).m11.sqrt()
}

/// What a loss would be carried by.
pub fn outlook(readings: &Readings, needs: &Needs) -> Outlook {
    let told = |carried_by, text: String| Outlook {
        carried_by,
        text,
        inertial_drift_m: None,
        after_s: AFTER_S,
        finding: None,
    };
    if needs.uses.flow && readings.has(SampleKind::Flow) {
        return told("flow", flow(readings, needs));
    }
    if needs.uses.landmarks {
        return told(
            "landmarks",
            "carried by landmarks while they are in view, by inertia between them".into(),
        );
    }
    let wing = readings.airframe == Some(Airframe::FixedWing);
    if wing && needs.uses.airspeed && readings.has(SampleKind::Airspeed) {
        return told(
            "airspeed",
            "carried by airspeed and the wind as GNSS showed it: fly turns before".into(),
        );
    }
    inertia(readings, needs)
}

fn flow(readings: &Readings, needs: &Needs) -> String {
    let height = if !readings.has(SampleKind::Range) {
        "its height from the altimeter".to_owned()
    } else {
        match ardupilot::greatest_range_m(&Case { readings, needs }) {
            Some(m) => format!("its height from the rangefinder, up to {} m", plain(m)),
            None => "its height from the rangefinder".to_owned(),
        }
    };
    format!("carried by optical flow, {height}; the flow is trusted once it was compared with GNSS in motion")
}

fn inertia(readings: &Readings, needs: &Needs) -> Outlook {
    let drift_m = coasting_m(needs, AFTER_S);
    let far = format!("about {drift_m:.0} m after {AFTER_S:.0} s, growing with the square of the time");
    let alone = match readings.vehicle.autopilot {
        AutopilotKind::Px4 => "PX4's own failsafe (Land 5 s after the loss) drifts less",
        _ if readings.airframe == Some(Airframe::FixedWing) => {
            "the autopilot's own dead reckoning and failsafe are no worse"
        }
        _ => "the autopilot's own failsafe (Land) drifts less",
    };
    let drag = needs.uses.drag && readings.airframe == Some(Airframe::Multirotor);
    let tail = format!("inertia alone: {far}; {alone}");
    let (carried_by, text) = if drag {
        let text = format!(
            "no optical flow: carried by rotor drag as far as that proves true in flight, else by {tail}"
        );
        ("drag", text)
    } else {
        ("inertia", format!("no optical flow and no airspeed: a loss would be carried by {tail}"))
    };
    let why = format!(
        "inertia alone carries a loss: Holdover would lead the vehicle away, for up to {} s, where it could land",
        plain(needs.max_coast_s)
    );
    let example = Some("holdover run --set outbound.publish=never".to_owned());
    let finding =
        Finding::stream(FindingGrade::Fault, ("optical flow or airspeed", 0.0), "to come", why, example);
    Outlook {
        carried_by,
        text,
        inertial_drift_m: Some(drift_m),
        after_s: AFTER_S,
        finding: (needs.sends() && !drag).then_some(finding),
    }
}
