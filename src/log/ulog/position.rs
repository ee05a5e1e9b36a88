//! GNSS receivers of a ULog, the autopilot's own estimate, and the simulator's truth.

use nalgebra::Vector3;

use crate::geo::{BodyToNed, Geodetic, Ned};
use crate::sample::{GnssFix, GnssSample, GnssWarning, GroundVelocity, Input, TruthState};
use crate::time::AutopilotTime;
use crate::wire::counters::Cause;

use super::super::intake::{attitude, position, vector};
use super::{Logged, Px4, Topic};

/// `…_STATE_DETECTED` of jamming and spoofing, `…_CRITICAL` before: found, and not mitigated.
const DETECTED: u8 = 3;
/// Attitude and velocity of the truth go with a position that is at most so much later, s.
const TOGETHER_S: f64 = 0.05;

const GPS: &[&str] = &[
    "timestamp_sample",
    "device_id",
    "fix_type",
    "latitude_deg",
    "longitude_deg",
    "altitude_msl_m",
    "lat",
    "lon",
    "alt",
    "eph",
    "epv",
    "s_variance_m_s",
    "vel_n_m_s",
    "vel_e_m_s",
    "vel_ned_valid",
    "satellites_used",
    "jamming_state",
    "spoofing_state",
    "time_utc_usec",
];
const LOCAL: &[&str] = &[
    "timestamp_sample",
    "xy_valid",
    "z_valid",
    "v_xy_valid",
    "x",
    "y",
    "z",
    "vx",
    "vy",
    "vz",
    "xy_global",
    "z_global",
    "ref_lat",
    "ref_lon",
    "ref_alt",
];
const GLOBAL: &[&str] = &["timestamp_sample", "lat", "lon", "alt", "lat_lon_valid"];
const QUATERNION: &[&str] = &["timestamp_sample", "q[0]", "q[1]", "q[2]", "q[3]"];

pub(super) const TOPICS: &[Topic] = &[
    Topic { name: "sensor_gps", fields: GPS, decode: sensor_gps },
    Topic { name: "vehicle_gps_position", fields: GPS, decode: vehicle_gps_position },
    Topic { name: "vehicle_local_position", fields: LOCAL, decode: local_position },
    Topic { name: "vehicle_global_position", fields: GLOBAL, decode: global_position },
    Topic { name: "vehicle_attitude", fields: QUATERNION, decode: vehicle_attitude },
    Topic { name: "vehicle_attitude_groundtruth", fields: QUATERNION, decode: true_attitude },
    Topic { name: "vehicle_local_position_groundtruth", fields: LOCAL, decode: true_velocity },
    Topic { name: "vehicle_global_position_groundtruth", fields: GLOBAL, decode: true_position },
];

/// Which receivers there are, and what the estimate that follows them told last.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Receivers {
    /// Device ids of the receivers by their number, as `sensor_gps` tells them.
    devices: [Option<u32>; 2],
    velocity_ned: Vector3<f64>,
    origin: Option<Geodetic>,
}

/// What the simulator told last.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct GroundTruth {
    attitude: Option<(AutopilotTime, BodyToNed)>,
    velocity: Option<(AutopilotTime, Vector3<f64>)>,
}

/// `sensor_gps`: every receiver.
fn sensor_gps(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    let device = px4.receivers.devices.get_mut(usize::from(m.instance)).ok_or(Cause::WrongSystem)?;
    *device = m.row.known("device_id").map(|id| id as u32);
    receiver(px4, m, m.instance)
}

/// `vehicle_gps_position`: the receiver that is selected, at a higher rate; in PX4 to 1.11 every receiver, one an instance.
fn vehicle_gps_position(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    let device = m.row.known("device_id").map(|id| id as u32);
    let known = px4.receivers.devices.iter().position(|d| d.is_some() && *d == device);
    receiver(px4, m, known.map_or(m.instance, |i| i as u8))
}

fn receiver(px4: &mut Px4, m: &Logged<'_>, receiver: u8) -> Result<(), Cause> {
    if let Some(unix_us) = m.row.micros("time_utc_usec") {
        px4.intake.date(unix_us, m.boot_us);
    }
    let fix = match m.row.byte("fix_type").ok_or(Cause::BadPayload)? {
        0 | 1 => GnssFix::None,
        2 => GnssFix::TwoD,
        3 => GnssFix::ThreeD,
        _ => GnssFix::Corrected,
    };
    let degrees = m.row.all(["latitude_deg", "longitude_deg", "altitude_msl_m"]);
    let scaled = m.row.all(["lat", "lon", "alt"]).map(|[lat, lon, alt]| [lat * 1e-7, lon * 1e-7, alt * 1e-3]);
    let [lat, lon, alt] = degrees.or(scaled).ok_or(Cause::BadPayload)?;
    let position = (fix > GnssFix::None).then(|| position(lat, lon, alt)).transpose()?;
    let velocity = m.row.all(["vel_n_m_s", "vel_e_m_s"]).filter(|v| v.iter().all(|c| c.is_finite()));
    let has_velocity = m.row.get("vel_ned_valid").is_none_or(|v| v != 0.0);
    let ground_velocity = velocity
        .filter(|_| has_velocity)
        .map(|[north, east]| GroundVelocity { speed_mps: north.hypot(east), course_rad: east.atan2(north) });
    let said = |name: &str| m.row.byte(name) == Some(DETECTED);
    let jammed = said("jamming_state").then_some(GnssWarning::Jammed);
    let claimed = |name: &str| m.row.known(name).filter(|a| (0.0..1e6).contains(a));
    px4.intake.gnss(GnssSample {
        time: m.measured(),
        receiver,
        fix,
        position,
        ground_velocity: position.and(ground_velocity),
        horizontal_accuracy_m: claimed("eph"),
        vertical_accuracy_m: claimed("epv"),
        speed_accuracy_mps: claimed("s_variance_m_s"),
        satellites: m.row.byte("satellites_used"),
        warning: said("spoofing_state").then_some(GnssWarning::Spoofed).or(jammed),
    })
}

/// `vehicle_local_position`: what EKF2 believes, and the origin that it counts from.
fn local_position(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    let valid = |name: &str| m.row.get(name).is_none_or(|v| v != 0.0);
    let velocity = vector(m.row.all(["vx", "vy", "vz"]))?;
    px4.receivers.velocity_ned = velocity;
    if valid("xy_global")
        && valid("z_global")
        && let Some([lat, lon, alt]) = m.row.all(["ref_lat", "ref_lon", "ref_alt"])
        // Before 1.11 it was counted in 1e-7 degrees in one version or another: that is no latitude.
        && let Ok(origin) = position(lat, lon, alt)
        && px4.receivers.origin != Some(origin)
    {
        px4.receivers.origin = Some(origin);
        px4.intake.out.push(Input::Origin(origin));
    }
    if !(valid("xy_valid") && valid("z_valid") && valid("v_xy_valid")) {
        return Ok(());
    }
    px4.intake.local(m.measured(), vector(m.row.all(["x", "y", "z"]))?, velocity)
}

/// `vehicle_global_position`.
fn global_position(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    if m.row.get("lat_lon_valid") == Some(0.0) {
        return Ok(());
    }
    let [lat, lon, alt] = m.row.all(["lat", "lon", "alt"]).ok_or(Cause::BadPayload)?;
    let velocity = px4.receivers.velocity_ned;
    px4.intake.global(m.measured(), position(lat, lon, alt)?, velocity);
    Ok(())
}

/// `vehicle_attitude`.
fn vehicle_attitude(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    let attitude = attitude(m.row.all(["q[0]", "q[1]", "q[2]", "q[3]"]))?;
    px4.intake.attitude(m.measured(), attitude);
    Ok(())
}

/// `vehicle_attitude_groundtruth`.
fn true_attitude(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    px4.truth.attitude = Some((m.time, attitude(m.row.all(["q[0]", "q[1]", "q[2]", "q[3]"]))?));
    Ok(())
}

/// `vehicle_local_position_groundtruth`.
fn true_velocity(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    px4.truth.velocity = Some((m.time, vector(m.row.all(["vx", "vy", "vz"]))?));
    Ok(())
}

/// `vehicle_global_position_groundtruth`, with the attitude and the velocity of the same moment.
fn true_position(px4: &mut Px4, m: &Logged<'_>) -> Result<(), Cause> {
    let [lat, lon, alt] = m.row.all(["lat", "lon", "alt"]).ok_or(Cause::BadPayload)?;
    let now = |at: AutopilotTime| m.time.seconds_since(at).abs() <= TOGETHER_S;
    let truth = TruthState {
        time: m.time,
        attitude: px4.truth.attitude.filter(|(at, _)| now(*at)).map(|(_, a)| a),
        position: Some(position(lat, lon, alt)?),
        velocity: px4.truth.velocity.filter(|(at, _)| now(*at)).map(|(_, v)| Ned::new(v)),
    };
    px4.intake.truth(truth);
    Ok(())
}
