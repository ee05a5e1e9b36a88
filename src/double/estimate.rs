//! What the double tells of its own estimate: its position and attitude, and how well they are aided.

use mavlink::MessageData;
use mavlink::dialects::ardupilotmega as apm;

use super::telemetry::floats;
use crate::geo::so3::Euler;
use crate::geo::{BodyToNed, Geodetic};
use crate::sim::autopilot::{OwnAiding, SimulatedAutopilot};
use crate::wire::messages::Message;

/// The message of the estimate with this id; `None` for another, and for a position where there is no origin.
pub(super) fn message(id: u32, vehicle: &SimulatedAutopilot) -> Option<Message> {
    match id {
        apm::LOCAL_POSITION_NED_DATA::ID => local_position(vehicle),
        apm::GLOBAL_POSITION_INT_DATA::ID => global_position(vehicle),
        apm::ATTITUDE_DATA::ID => Some(attitude(vehicle)),
        apm::ATTITUDE_QUATERNION_DATA::ID => Some(attitude_quaternion(vehicle)),
        apm::VFR_HUD_DATA::ID => Some(hud(vehicle)),
        apm::EKF_STATUS_REPORT_DATA::ID => Some(ekf_status_report(vehicle)),
        apm::ESTIMATOR_STATUS_DATA::ID => Some(estimator_status(vehicle)),
        _ => None,
    }
}

fn boot_ms(vehicle: &SimulatedAutopilot) -> u32 {
    (vehicle.boot_time().micros() / 1000) as u32
}

fn local_position(vehicle: &SimulatedAutopilot) -> Option<Message> {
    let filter = vehicle.filter();
    let known = vehicle.origin().is_some() && vehicle.aiding().has_position(vehicle.now_s());
    let ([x, y, z], [vx, vy, vz]) = (floats(&filter.position()), floats(&filter.velocity()));
    let time_boot_ms = boot_ms(vehicle);
    let message = apm::LOCAL_POSITION_NED_DATA { time_boot_ms, x, y, z, vx, vy, vz };
    known.then_some(Message::LOCAL_POSITION_NED(message))
}

/// Where the estimate lies on the globe.
fn place(vehicle: &SimulatedAutopilot) -> Option<Geodetic> {
    let origin = vehicle.origin()?;
    Some(crate::geo::LocalNed::new(origin).to_geodetic(&vehicle.filter().position()))
}

fn global_position(vehicle: &SimulatedAutopilot) -> Option<Message> {
    let place = place(vehicle)?;
    let e7 = |radians: f64| (radians.to_degrees() * 1e7).round() as i32;
    let cm = |v: f64| (v * 100.0).round().clamp(-32_767.0, 32_767.0) as i16;
    let (position, velocity) = (vehicle.filter().position(), vehicle.filter().velocity());
    let yaw = Euler::from_rotation(vehicle.filter().r_body_to_ned()).yaw_rad;
    Some(Message::GLOBAL_POSITION_INT(apm::GLOBAL_POSITION_INT_DATA {
        time_boot_ms: boot_ms(vehicle),
        lat: e7(place.latitude_rad),
        lon: e7(place.longitude_rad),
        alt: (place.height_m * 1000.0).round() as i32,
        relative_alt: (-position.z * 1000.0).round() as i32,
        vx: cm(velocity.x),
        vy: cm(velocity.y),
        vz: cm(velocity.z),
        hdg: (yaw.to_degrees().rem_euclid(360.0) * 100.0) as u16,
    }))
}

fn rates(vehicle: &SimulatedAutopilot) -> [f32; 3] {
    vehicle.newest().imu.map_or([0.0; 3], |imu| floats(&imu.angular_rate.raw()))
}

fn attitude(vehicle: &SimulatedAutopilot) -> Message {
    let euler = Euler::from_rotation(vehicle.filter().r_body_to_ned());
    let [rollspeed, pitchspeed, yawspeed] = rates(vehicle);
    Message::ATTITUDE(apm::ATTITUDE_DATA {
        time_boot_ms: boot_ms(vehicle),
        roll: euler.roll_rad as f32,
        pitch: euler.pitch_rad as f32,
        yaw: euler.yaw_rad as f32,
        rollspeed,
        pitchspeed,
        yawspeed,
    })
}

fn attitude_quaternion(vehicle: &SimulatedAutopilot) -> Message {
    let q = BodyToNed::from_matrix(vehicle.filter().r_body_to_ned()).quaternion();
    let [rollspeed, pitchspeed, yawspeed] = rates(vehicle);
    Message::ATTITUDE_QUATERNION(apm::ATTITUDE_QUATERNION_DATA {
        time_boot_ms: boot_ms(vehicle),
        q1: q.w as f32,
        q2: q.i as f32,
        q3: q.j as f32,
        q4: q.k as f32,
        rollspeed,
        pitchspeed,
        yawspeed,
        repr_offset_q: [0.0; 4],
    })
}

/// A multirotor without a pitot tube: ArduPilot fills in an estimate for the airspeed, PX4 no number.
fn hud(vehicle: &SimulatedAutopilot) -> Message {
    let velocity = vehicle.filter().velocity();
    let speed = velocity.xy().norm() as f32;
    let yaw = Euler::from_rotation(vehicle.filter().r_body_to_ned()).yaw_rad;
    Message::VFR_HUD(apm::VFR_HUD_DATA {
        airspeed: if matches!(vehicle.aiding(), OwnAiding::Ekf2(_)) { f32::NAN } else { speed },
        groundspeed: speed,
        alt: place(vehicle).map_or(0.0, |p| p.height_m as f32),
        climb: -velocity.z as f32,
        heading: yaw.to_degrees().rem_euclid(360.0) as i16,
        throttle: if vehicle.in_air() { 40 } else { 0 },
    })
}

/// EKF_STATUS_REPORT: with aiding all of the position, without it the constant position mode.
fn ekf_status_report(vehicle: &SimulatedAutopilot) -> Message {
    use apm::EkfStatusFlags as Flag;
    let always = Flag::EKF_ATTITUDE | Flag::EKF_VELOCITY_VERT | Flag::EKF_POS_VERT_ABS;
    let horizontal = Flag::EKF_VELOCITY_HORIZ
        | Flag::EKF_POS_HORIZ_REL
        | Flag::EKF_POS_HORIZ_ABS
        | Flag::EKF_PRED_POS_HORIZ_REL
        | Flag::EKF_PRED_POS_HORIZ_ABS;
    let aided = vehicle.aiding().has_position(vehicle.now_s());
    let [velocity_variance, pos_horiz_variance] = vehicle.aiding().ratios().map(|r| r.sqrt() as f32);
    Message::EKF_STATUS_REPORT(apm::EKF_STATUS_REPORT_DATA {
        velocity_variance,
        pos_horiz_variance,
        pos_vert_variance: 0.05,
        compass_variance: 0.05,
        terrain_alt_variance: 0.0,
        flags: if aided { always | horizontal } else { always | Flag::EKF_CONST_POS_MODE },
        airspeed_variance: 0.0,
    })
}

/// ESTIMATOR_STATUS: the absolute prediction is told with GNSS only.
fn estimator_status(vehicle: &SimulatedAutopilot) -> Message {
    use apm::EstimatorStatusFlags as Flag;
    let mut flags = Flag::ESTIMATOR_ATTITUDE
        | Flag::ESTIMATOR_VELOCITY_VERT
        | Flag::ESTIMATOR_POS_VERT_ABS
        | Flag::ESTIMATOR_POS_VERT_AGL;
    if vehicle.aiding().has_position(vehicle.now_s()) {
        flags |= Flag::ESTIMATOR_VELOCITY_HORIZ
            | Flag::ESTIMATOR_POS_HORIZ_REL
            | Flag::ESTIMATOR_POS_HORIZ_ABS
            | Flag::ESTIMATOR_PRED_POS_HORIZ_REL;
    }
    if matches!(vehicle.aiding(), OwnAiding::Ekf2(ekf) if ekf.uses_gnss()) {
        flags |= Flag::ESTIMATOR_PRED_POS_HORIZ_ABS;
    }
    let [vel_ratio, pos_horiz_ratio] = vehicle.aiding().ratios().map(|r| r as f32);
    Message::ESTIMATOR_STATUS(apm::ESTIMATOR_STATUS_DATA {
        time_usec: vehicle.boot_time().micros().unsigned_abs(),
        vel_ratio,
        pos_horiz_ratio,
        pos_vert_ratio: 0.05,
        mag_ratio: 0.05,
        hagl_ratio: 0.05,
        tas_ratio: 0.0,
        pos_horiz_accuracy: vehicle.filter().horizontal_sigma_m() as f32,
        pos_vert_accuracy: 0.5,
        flags,
    })
}
