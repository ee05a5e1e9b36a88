//! Optical flow, rangefinders, airspeed and landmarks of a ULog.

use crate::sample::{FlowRotation, FlowSample, RangeDirection, RangeSample};
use crate::time::Span;
use crate::wire::counters::Cause;
use crate::wire::decode::limits;

use super::super::intake::possible;
use super::{Logged, Px4, Topic};

/// Integration over less or more is none of a flow sensor's, s.
const FLOW_INTERVAL_S: std::ops::RangeInclusive<f64> = 1e-4..=1.0;
/// `MAV_SENSOR_ROTATION_PITCH_270`: the beam points along body +z.
const FACING_DOWN: u8 = 25;
/// Ranks of optical flow: the vehicle's, turned and scaled, before the sensor's.
const VEHICLE_FLOW: usize = 0;
const SENSOR_FLOW: usize = 1;

pub(super) const TOPICS: &[Topic] = &[
    Topic {
        name: "vehicle_optical_flow",
        fields: &[
            "timestamp_sample",
            "pixel_flow[0]",
            "pixel_flow[1]",
            "delta_angle[0]",
            "delta_angle[1]",
            "distance_m",
            "integration_timespan_us",
            "quality",
        ],
        decode: vehicle_optical_flow,
    },
    Topic {
        name: "sensor_optical_flow",
        fields: &[
            "timestamp_sample",
            "pixel_flow[0]",
            "pixel_flow[1]",
            "delta_angle[0]",
            "delta_angle[1]",
            "delta_angle_available",
            "distance_m",
            "distance_available",
            "integration_timespan_us",
            "quality",
        ],
        decode: sensor_optical_flow,
    },
    Topic {
        name: "optical_flow",
        fields: &[
            "pixel_flow_x_integral",
            "pixel_flow_y_integral",
            "gyro_x_rate_integral",
            "gyro_y_rate_integral",
            "ground_distance_m",
            "integration_timespan",
            "quality",
        ],
        decode: optical_flow,
    },
    Topic {
        name: "distance_sensor",
        fields: &["current_distance", "min_distance", "max_distance", "signal_quality", "orientation"],
        decode: distance_sensor,
    },
    Topic {
        name: "airspeed_validated",
        fields: &["calibrated_airspeed_m_s", "airspeed_source", "selected_airspeed_index"],
        decode: airspeed_validated,
    },
    Topic { name: "airspeed", fields: &["timestamp_sample", "indicated_airspeed_m_s"], decode: airspeed },
    Topic { name: "irlock_report", fields: &["signature", "pos_x", "pos_y"], decode: irlock_report },
];

/// What all three messages of optical flow tell: angles over an interval.
struct Integrated {
    flow_xy: [f64; 2],
    gyro_xy: Option<[f64; 2]>,
    interval_us: f64,
    quality: f64,
    distance_m: Option<f64>,
}

/// A flow is what MAVLink's OPTICAL_FLOW_RAD is filled with: the same signs.
fn integrated(px4: &mut Px4, m: &Logged<'_>, rank: usize, told: &Integrated) -> Result<(), Cause> {
    let dt = possible(told.interval_us * 1e-6, FLOW_INTERVAL_S)?;
    let gyro = told.gyro_xy.map(|g| g.map(|g| g / dt));
    let rotation = match gyro {
        Some(gyro) if gyro.iter().all(|g| g.is_finite() && g.abs() <= limits::FLOW_RADPS) => {
            FlowRotation::SensorGyro(gyro)
        }
        _ => FlowRotation::Contained,
    };
    let time = m.measured();
    if !px4.flows.take(rank, time) {
        return Ok(());
    }
    px4.intake.flow(FlowSample {
        time,
        sensor: 0,
        interval: Span::from_micros(told.interval_us as i64),
        rate_xy: told.flow_xy.map(|f| f / dt),
        rotation,
        quality: (told.quality / 255.0).clamp(0.0, 1.0),
        distance_m: told.distance_m.filter(|d| d.is_finite() && *d > 0.0),
    })
}

/// `vehicle_optical_flow`: in the body's axes, scaled, with a gyro over the same interval.
fn vehicle_optical_flow(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    let told = Integrated {
        flow_xy: m.row.all(["pixel_flow[0]", "pixel_flow[1]"]).ok_or(Cause::BadPayload)?,
        gyro_xy: m.row.all(["delta_angle[0]", "delta_angle[1]"]),
        interval_us: m.row.get("integration_timespan_us").ok_or(Cause::BadPayload)?,
        quality: m.row.get("quality").ok_or(Cause::BadPayload)?,
        distance_m: m.row.get("distance_m"),
    };
    integrated(px4, m, VEHICLE_FLOW, &told)
}

/// `sensor_optical_flow`: in the sensor's axes, which `SENS_FLOW_ROT` turns by 45° each into the body's, and not scaled.
fn sensor_optical_flow(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    let turns = px4.parameters.get("SENS_FLOW_ROT").filter(|r| (0.0..8.0).contains(r)).unwrap_or(0.0);
    let scale = px4.parameters.get("SENS_FLOW_SCALE").filter(|s| *s > 0.0).unwrap_or(1.0);
    let (sin, cos) = (turns * std::f64::consts::FRAC_PI_4).sin_cos();
    let turned = |[x, y]: [f64; 2]| [cos * x - sin * y, sin * x + cos * y];
    let flow = m.row.all(["pixel_flow[0]", "pixel_flow[1]"]).ok_or(Cause::BadPayload)?;
    let gyro = m.row.all(["delta_angle[0]", "delta_angle[1]"]);
    let told = Integrated {
        flow_xy: turned(flow).map(|f| f * scale),
        gyro_xy: gyro.filter(|_| m.row.byte("delta_angle_available") == Some(1)).map(turned),
        interval_us: m.row.get("integration_timespan_us").ok_or(Cause::BadPayload)?,
        quality: m.row.get("quality").ok_or(Cause::BadPayload)?,
        distance_m: m.row.get("distance_m").filter(|_| m.row.byte("distance_available") == Some(1)),
    };
    integrated(px4, m, SENSOR_FLOW + usize::from(m.instance), &told)
}

/// `optical_flow` (PX4 to 1.13): turned by the driver.
fn optical_flow(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    let told = Integrated {
        flow_xy: m.row.all(["pixel_flow_x_integral", "pixel_flow_y_integral"]).ok_or(Cause::BadPayload)?,
        gyro_xy: m.row.all(["gyro_x_rate_integral", "gyro_y_rate_integral"]),
        interval_us: m.row.get("integration_timespan").ok_or(Cause::BadPayload)?,
        quality: m.row.get("quality").ok_or(Cause::BadPayload)?,
        distance_m: m.row.get("ground_distance_m"),
    };
    integrated(px4, m, SENSOR_FLOW + usize::from(m.instance), &told)
}

/// `distance_sensor`. A signal quality of 0 is "invalid".
fn distance_sensor(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    if m.row.get("signal_quality") == Some(0.0) {
        return Ok(());
    }
    let distance_m = m.row.get("current_distance").ok_or(Cause::BadPayload)?;
    // On the ground, or with nothing in range, drivers tell nothing that can be.
    if distance_m <= 0.0 {
        return Ok(());
    }
    let limits_m = m.row.all(["min_distance", "max_distance"]).filter(|[low, high]| high > low);
    let direction = match m.row.byte("orientation") {
        Some(FACING_DOWN) => RangeDirection::Down,
        other => RangeDirection::Other(other.unwrap_or(u8::MAX)),
    };
    px4.intake.range(RangeSample { time: m.time, sensor: m.instance, direction, distance_m, limits_m })
}

/// `airspeed_validated`, where it comes from a sensor: ground speed less wind and a synthetic one are the autopilot's own estimate.
fn airspeed_validated(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    let source = m.row.get("airspeed_source").or(m.row.get("selected_airspeed_index"));
    if !source.is_some_and(|s| (1.0..=3.0).contains(&s)) {
        return Ok(());
    }
    match m.row.get("calibrated_airspeed_m_s") {
        Some(airspeed) if airspeed.is_finite() => px4.intake.airspeed(0, m.time, airspeed),
        _ => Ok(()),
    }
}

/// `airspeed`: the sensor's.
fn airspeed(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    let airspeed = m.row.get("indicated_airspeed_m_s").ok_or(Cause::BadPayload)?;
    px4.intake.airspeed(1 + usize::from(m.instance), m.measured(), airspeed)
}

/// `irlock_report`: tangents of the angles to a beacon.
fn irlock_report(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    let [x, y] = m.row.all(["pos_x", "pos_y"]).ok_or(Cause::BadPayload)?;
    px4.intake.landmark(m.row.byte("signature").unwrap_or(0), m.time, [x.atan(), y.atan()])
}
