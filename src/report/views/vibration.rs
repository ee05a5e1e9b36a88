//! How the IMU shakes, and how often it is heard.

use super::super::chart::{Chart, Stroke};
use super::super::flight::FlightSheet;
use super::super::palette::Role;
use super::super::scale::RangeFit;
use super::{drawn, over_time};

/// Above this ArduPilot's documentation calls it a problem, m/s².
const TOO_MUCH_MPS2: f64 = 30.0;

/// The plots.
pub(in super::super) fn view(sheet: &FlightSheet) -> String {
    let record = &sheet.recorder.vibration;
    let title = "Vibration of the accelerometers";
    let explained = "The part of the specific force above 5 Hz, root mean square, along body x, y and z. A stream slower than 10 Hz shows none of it, one of 50 Hz only the slower part.";
    let chart =
        Chart::new(title, sheet.time_s(), ["s", "m/s²"], RangeFit::FromZero(1.0)).explained(explained);
    let mut chart = over_time(sheet, chart);
    let axes = [("z", Role::AxisZ, 2), ("y", Role::AxisY, 1), ("x", Role::AxisX, 0)];
    for (name, role, axis) in axes {
        chart.trace(name, role, Stroke::Plain, &record.axes[axis]);
    }
    chart.guide(TOO_MUCH_MPS2, "too much from here");
    let shaking = drawn(&chart, title, "No IMU was heard.");
    let title = "IMU samples a second";
    let chart = Chart::new(title, sheet.time_s(), ["s", "Hz"], RangeFit::FromZero(10.0));
    let mut chart = over_time(sheet, chart);
    chart.trace("IMU", Role::Inertia, Stroke::Plain, &record.rate_hz);
    shaking + &drawn(&chart, title, "No IMU was heard for longer than a second.")
}
