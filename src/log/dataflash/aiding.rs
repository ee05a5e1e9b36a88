//! Optical flow, rangefinders and airspeed of a DataFlash log.

use crate::sample::{FlowRotation, FlowSample, RangeDirection, RangeSample};
use crate::time::Span;
use crate::wire::counters::Cause;

use super::super::parameters::Parameters;
use super::{ArduPilot, MessageMeaning, Told};

/// `ROTATION_PITCH_270`: the beam points along body +z.
const FACING_DOWN: u8 = 25;
/// `RangeFinder::Status::Good`.
const GOOD: u8 = 4;

pub(super) const MEANINGS: &[MessageMeaning] = &[
    MessageMeaning {
        names: &["OF"],
        fields: &["TimeUS", "TimeMS", "Qual", "flowX", "flowY", "bodyX", "bodyY"],
        decode: flow,
    },
    MessageMeaning {
        names: &["RFND"],
        fields: &[
            "TimeUS", "Instance", "Dist", "Stat", "Orient", "Dist1", "Stat1", "Orient1", "Dist2", "Stat2",
            "Orient2",
        ],
        decode: range,
    },
    MessageMeaning {
        names: &["ARSP", "ASP2"],
        fields: &["TimeUS", "TimeMS", "I", "Airspeed", "H", "Health"],
        decode: airspeed,
    },
];

/// `OF`: the sensor's rates, turned and scaled as its parameters say, and the vehicle's over the same interval, rad/s.
fn flow(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    let rate_xy = m.row.all(["flowX", "flowY"]).ok_or(Cause::BadPayload)?;
    let body = m.row.all(["bodyX", "bodyY"]).filter(|b| b.iter().all(|r| r.is_finite()));
    vehicle.intake.flow(FlowSample {
        time: m.time,
        sensor: 0,
        interval: Span::ZERO,
        rate_xy,
        rotation: body.map_or(FlowRotation::Contained, FlowRotation::SensorGyro),
        quality: m.row.get("Qual").map_or(0.0, |q| (q / 255.0).clamp(0.0, 1.0)),
        distance_m: None,
    })
}

/// `RFND`: one message a sensor, or (to 4.0) one for two of them.
fn range(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    beam(vehicle, m, m.instance, ["Dist", "Stat", "Orient"])?;
    beam(vehicle, m, 0, ["Dist1", "Stat1", "Orient1"])?;
    beam(vehicle, m, 1, ["Dist2", "Stat2", "Orient2"])
}

fn beam(
    vehicle: &mut ArduPilot,
    m: &Told<'_>,
    sensor: u8,
    [distance, status, orientation]: [&str; 3],
) -> Result<(), Cause> {
    let Some(distance_m) = m.row.get(distance) else { return Ok(()) };
    if m.row.byte(status).is_some_and(|s| s != GOOD) {
        return Ok(());
    }
    let direction = match m.row.byte(orientation) {
        Some(FACING_DOWN) => RangeDirection::Down,
        other => RangeDirection::Other(other.unwrap_or(u8::MAX)),
    };
    let limits_m = if sensor == 0 { limits(&vehicle.parameters) } else { None };
    vehicle.intake.range(RangeSample { time: m.time, sensor, direction, distance_m, limits_m })
}

/// What the first rangefinder can measure, m, as its parameters tell.
fn limits(parameters: &Parameters) -> Option<[f64; 2]> {
    let of = |metres: &str, centimetres: &str| {
        parameters.get(metres).or(parameters.get(centimetres).map(|cm| cm * 0.01))
    };
    let limits = [of("RNGFND1_MIN", "RNGFND1_MIN_CM")?, of("RNGFND1_MAX", "RNGFND1_MAX_CM")?];
    (limits[1] > limits[0]).then_some(limits)
}

/// `ARSP`.
fn airspeed(vehicle: &mut ArduPilot, m: &Told<'_>) -> Result<(), Cause> {
    if m.row.byte("H").or(m.row.byte("Health")) == Some(0) {
        return Ok(());
    }
    let airspeed = m.row.get("Airspeed").ok_or(Cause::BadPayload)?;
    vehicle.intake.airspeed(usize::from(m.instance), m.time, airspeed)
}
