//! What an autopilot sends: samples, truth and its own announcements as MAVLink. The inverse of [`super::decode`], for logs of
//! simulated flights.
//!
//! Stamps are microseconds or milliseconds since boot. A sample that holds a number which is not finite, or lies before the boot, has no
//! message.

use mavlink::dialects::ardupilotmega as apm;
use mavlink::dialects::ardupilotmega::MavMessage;
use nalgebra::Vector3;

use crate::geo::{Body, BodyToNed, Euler, Geodetic, Ned, STANDARD_GRAVITY_MPS2};
use crate::sample::{
    Airframe, FlowRotation, FlowSample, GnssFix, GnssSample, ImuSample, LandmarkSample, MagSample,
    PressureSample, RangeDirection, RangeSample, Sample, Sighting, VehicleStatus,
};
use crate::time::AutopilotTime;

use super::encode::{float, triple};
use super::session::identity::AutopilotKind;

const GAUSS_PER_TESLA: f64 = 1e4;
/// "Not known" in fields of 16 bits.
const UNKNOWN: u16 = u16::MAX;

/// The true state of a simulated vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VehicleTruth {
    /// When.
    pub time: AutopilotTime,
    /// Attitude.
    pub attitude: BodyToNed,
    /// Place.
    pub position: Geodetic,
    /// Velocity, m/s.
    pub velocity: Ned<Vector3<f64>>,
    /// Angular rate, rad/s.
    pub angular_rate: Body<Vector3<f64>>,
    /// Specific force, m/s².
    pub specific_force: Body<Vector3<f64>>,
}

/// Appends the messages of samples that arrive together. A magnetometer sample goes into the HIGHRES_IMU before it, if they have one
/// time; alone it has no message. Of a flow without rotation (`Removed`) the sensor's gyro reads zero.
pub fn samples<'a>(samples: impl IntoIterator<Item = &'a Sample>, out: &mut Vec<MavMessage>) {
    for sample in samples {
        let message = match sample {
            Sample::Imu(s) => highres_imu(s),
            Sample::Mag(s) => {
                if let Some(MavMessage::HIGHRES_IMU(imu)) = out.last_mut() {
                    add_field(imu, s);
                }
                None
            }
            Sample::Gnss(s) => gps_raw_int(s),
            Sample::Pressure(s) => scaled_pressure(s),
            Sample::Flow(s) if s.rotation == FlowRotation::InOwnUnit => optical_flow_pixels(s),
            Sample::Flow(s) => optical_flow_rad(s),
            Sample::Range(s) => distance_sensor(s),
            Sample::Airspeed(s) => vfr_hud(s.airspeed_mps),
            Sample::Landmark(s) => landing_target(s),
        };
        out.extend(message);
    }
}

/// The autopilot's HEARTBEAT.
pub fn heartbeat(autopilot: AutopilotKind, status: &VehicleStatus) -> MavMessage {
    let armed = status.armed == Some(true);
    let flying = apm::MavModeFlag::MAV_MODE_FLAG_AUTO_ENABLED;
    MavMessage::HEARTBEAT(apm::HEARTBEAT_DATA {
        custom_mode: 0,
        mavtype: match status.airframe {
            Some(Airframe::FixedWing) => apm::MavType::MAV_TYPE_FIXED_WING,
            Some(Airframe::Multirotor) => apm::MavType::MAV_TYPE_QUADROTOR,
            Some(Airframe::Surface) => apm::MavType::MAV_TYPE_GROUND_ROVER,
            None => apm::MavType::MAV_TYPE_GENERIC,
        },
        autopilot: match autopilot {
            AutopilotKind::Px4 => apm::MavAutopilot::MAV_AUTOPILOT_PX4,
            AutopilotKind::ArduPilot => apm::MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
            AutopilotKind::Other(_) => apm::MavAutopilot::MAV_AUTOPILOT_GENERIC,
        },
        base_mode: if armed { flying | apm::MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED } else { flying },
        system_status: if armed { apm::MavState::MAV_STATE_ACTIVE } else { apm::MavState::MAV_STATE_STANDBY },
        mavlink_version: 3,
    })
}

/// SYS_STATUS: which sensors there are. ArduPilot's VFR_HUD shows an estimate where there is no differential pressure.
pub fn sensors_present(has_airspeed: bool) -> MavMessage {
    use apm::MavSysStatusSensor as Sensor;
    let always = Sensor::MAV_SYS_STATUS_SENSOR_3D_GYRO
        | Sensor::MAV_SYS_STATUS_SENSOR_3D_ACCEL
        | Sensor::MAV_SYS_STATUS_SENSOR_GPS;
    let pitot = Sensor::MAV_SYS_STATUS_SENSOR_DIFFERENTIAL_PRESSURE;
    let sensors = if has_airspeed { always | pitot } else { always };
    MavMessage::SYS_STATUS(apm::SYS_STATUS_DATA {
        onboard_control_sensors_present: sensors,
        onboard_control_sensors_enabled: sensors,
        onboard_control_sensors_health: sensors,
        load: 0,
        voltage_battery: UNKNOWN,
        current_battery: -1,
        drop_rate_comm: 0,
        errors_comm: 0,
        errors_count1: 0,
        errors_count2: 0,
        errors_count3: 0,
        errors_count4: 0,
        battery_remaining: -1,
        onboard_control_sensors_present_extended: apm::MavSysStatusSensorExtended::empty(),
        onboard_control_sensors_enabled_extended: apm::MavSysStatusSensorExtended::empty(),
        onboard_control_sensors_health_extended: apm::MavSysStatusSensorExtended::empty(),
    })
}

/// SYSTEM_TIME: what microseconds since 1970 a time is.
pub fn system_time(time: AutopilotTime, unix_us: u64) -> Option<MavMessage> {
    let time_boot_ms = boot_ms(time)?;
    Some(MavMessage::SYSTEM_TIME(apm::SYSTEM_TIME_DATA { time_unix_usec: unix_us, time_boot_ms }))
}

/// GPS_GLOBAL_ORIGIN: where the autopilot's local frame lies.
pub fn origin(time: AutopilotTime, origin: &Geodetic) -> Option<MavMessage> {
    let [latitude, longitude] = degrees_e7(origin)?;
    Some(MavMessage::GPS_GLOBAL_ORIGIN(apm::GPS_GLOBAL_ORIGIN_DATA {
        latitude,
        longitude,
        altitude: millimetres(origin.height_m)?,
        time_usec: boot_usec(time)?,
    }))
}

/// The truth in the message that this autopilot's simulation sends: HIL_STATE_QUATERNION (PX4) or SIM_STATE, which carries no time
/// and holds for the newest stamp of the stream.
pub fn truth(autopilot: AutopilotKind, t: &VehicleTruth) -> Option<MavMessage> {
    if autopilot == AutopilotKind::Px4 { hil_state(t) } else { sim_state(t) }
}

/// The attitude as a quaternion, w first.
fn quaternion(t: &VehicleTruth) -> Option<[f32; 4]> {
    let q = t.attitude.quaternion();
    Some([float(q.w)?, float(q.i)?, float(q.j)?, float(q.k)?])
}

fn hil_state(t: &VehicleTruth) -> Option<MavMessage> {
    let [lat, lon] = degrees_e7(&t.position)?;
    let [rollspeed, pitchspeed, yawspeed] = triple(&t.angular_rate.raw())?;
    let [vx, vy, vz] = shorts(&(t.velocity.raw() * 100.0))?;
    let [xacc, yacc, zacc] = shorts(&(t.specific_force.raw() * (1000.0 / STANDARD_GRAVITY_MPS2)))?;
    Some(MavMessage::HIL_STATE_QUATERNION(apm::HIL_STATE_QUATERNION_DATA {
        time_usec: boot_usec(t.time)?,
        attitude_quaternion: quaternion(t)?,
        rollspeed,
        pitchspeed,
        yawspeed,
        lat,
        lon,
        alt: millimetres(t.position.height_m)?,
        vx,
        vy,
        vz,
        ind_airspeed: UNKNOWN,
        true_airspeed: UNKNOWN,
        xacc,
        yacc,
        zacc,
    }))
}

fn sim_state(t: &VehicleTruth) -> Option<MavMessage> {
    let [q1, q2, q3, q4] = quaternion(t)?;
    let [lat_int, lon_int] = degrees_e7(&t.position)?;
    let [xgyro, ygyro, zgyro] = triple(&t.angular_rate.raw())?;
    let euler = Euler::from_rotation(t.attitude.matrix());
    let [roll, pitch, yaw] = [float(euler.roll_rad)?, float(euler.pitch_rad)?, float(euler.yaw_rad)?];
    let [vn, ve, vd] = triple(&t.velocity.raw())?;
    let [xacc, yacc, zacc] = triple(&t.specific_force.raw())?;
    Some(MavMessage::SIM_STATE(apm::SIM_STATE_DATA {
        q1,
        q2,
        q3,
        q4,
        roll,
        pitch,
        yaw,
        xacc,
        yacc,
        zacc,
        xgyro,
        ygyro,
        zgyro,
        lat: float(t.position.latitude_rad.to_degrees())?,
        lon: float(t.position.longitude_rad.to_degrees())?,
        alt: float(t.position.height_m)?,
        std_dev_horz: 0.0,
        std_dev_vert: 0.0,
        vn,
        ve,
        vd,
        lat_int,
        lon_int,
    }))
}

fn highres_imu(s: &ImuSample) -> Option<MavMessage> {
    let [xgyro, ygyro, zgyro] = triple(&s.angular_rate.raw())?;
    let [xacc, yacc, zacc] = triple(&s.specific_force.raw())?;
    use apm::HighresImuUpdatedFlags as Flag;
    Some(MavMessage::HIGHRES_IMU(apm::HIGHRES_IMU_DATA {
        time_usec: boot_usec(s.time)?,
        xacc,
        yacc,
        zacc,
        xgyro,
        ygyro,
        zgyro,
        xmag: 0.0,
        ymag: 0.0,
        zmag: 0.0,
        abs_pressure: 0.0,
        diff_pressure: 0.0,
        pressure_alt: 0.0,
        temperature: 0.0,
        fields_updated: Flag::HIGHRES_IMU_UPDATED_XACC
            | Flag::HIGHRES_IMU_UPDATED_YACC
            | Flag::HIGHRES_IMU_UPDATED_ZACC
            | Flag::HIGHRES_IMU_UPDATED_XGYRO
            | Flag::HIGHRES_IMU_UPDATED_YGYRO
            | Flag::HIGHRES_IMU_UPDATED_ZGYRO,
        id: 0,
    }))
}

fn add_field(imu: &mut apm::HIGHRES_IMU_DATA, s: &MagSample) {
    let (Some([x, y, z]), Some(time)) = (triple(&(s.field.raw() * GAUSS_PER_TESLA)), boot_usec(s.time))
    else {
        return;
    };
    if time != imu.time_usec {
        return;
    }
    use apm::HighresImuUpdatedFlags as Flag;
    (imu.xmag, imu.ymag, imu.zmag) = (x, y, z);
    imu.fields_updated |=
        Flag::HIGHRES_IMU_UPDATED_XMAG | Flag::HIGHRES_IMU_UPDATED_YMAG | Flag::HIGHRES_IMU_UPDATED_ZMAG;
}

fn gps_raw_int(s: &GnssSample) -> Option<MavMessage> {
    let (lat, lon, alt) = match &s.position {
        Some(p) => {
            let [lat, lon] = degrees_e7(p)?;
            (lat, lon, millimetres(p.height_m)?)
        }
        None => (0, 0, 0),
    };
    let (vel, cog) = match s.ground_velocity {
        // The course wraps before it is rounded up to a full turn.
        Some(v) => (
            unsigned(v.speed_mps * 100.0)?,
            unsigned(v.course_rad.to_degrees().rem_euclid(360.0) * 100.0)? % 36_000,
        ),
        None => (UNKNOWN, UNKNOWN),
    };
    let accuracy = |a: Option<f64>| a.map_or(0, |a| (a * 1000.0).round().clamp(0.0, 4e9) as u32);
    Some(MavMessage::GPS_RAW_INT(apm::GPS_RAW_INT_DATA {
        time_usec: boot_usec(s.time)?,
        lat,
        lon,
        alt,
        eph: UNKNOWN,
        epv: UNKNOWN,
        vel,
        cog,
        fix_type: match s.fix {
            GnssFix::None => apm::GpsFixType::GPS_FIX_TYPE_NO_FIX,
            GnssFix::TwoD => apm::GpsFixType::GPS_FIX_TYPE_2D_FIX,
            GnssFix::ThreeD => apm::GpsFixType::GPS_FIX_TYPE_3D_FIX,
            GnssFix::Corrected => apm::GpsFixType::GPS_FIX_TYPE_DGPS,
        },
        satellites_visible: s.satellites.unwrap_or(u8::MAX),
        alt_ellipsoid: 0,
        h_acc: accuracy(s.horizontal_accuracy_m),
        v_acc: accuracy(s.vertical_accuracy_m),
        vel_acc: accuracy(s.speed_accuracy_mps),
        hdg_acc: 0,
        yaw: 0,
    }))
}

fn scaled_pressure(s: &PressureSample) -> Option<MavMessage> {
    Some(MavMessage::SCALED_PRESSURE(apm::SCALED_PRESSURE_DATA {
        time_boot_ms: boot_ms(s.time)?,
        press_abs: float(s.pressure_pa * 0.01)?,
        press_diff: 0.0,
        temperature: 1500,
        temperature_press_diff: 0,
    }))
}

fn optical_flow_rad(s: &FlowSample) -> Option<MavMessage> {
    let dt = s.interval.seconds();
    let [x, y] = s.rate_xy.map(|r| float(r * dt));
    let gyro = match s.rotation {
        FlowRotation::SensorGyro(g) => g.map(|r| (r * dt) as f32),
        FlowRotation::Removed => [0.0; 2],
        // The message's way to say that the sensor has no gyro.
        FlowRotation::Contained | FlowRotation::InOwnUnit => [f32::NAN; 2],
    };
    Some(MavMessage::OPTICAL_FLOW_RAD(apm::OPTICAL_FLOW_RAD_DATA {
        time_usec: boot_usec(s.time)?,
        integration_time_us: u32::try_from(s.interval.micros()).ok().filter(|&us| us > 0)?,
        integrated_x: x?,
        integrated_y: y?,
        integrated_xgyro: gyro[0],
        integrated_ygyro: gyro[1],
        integrated_zgyro: f32::NAN,
        time_delta_distance_us: 0,
        // Negative is "not known".
        distance: s.distance_m.map_or(Some(-1.0), float)?,
        temperature: 1500,
        sensor_id: s.sensor,
        quality: (s.quality * 255.0).round().clamp(0.0, 255.0) as u8,
    }))
}

/// Pixels only: tenths of them, along the image's axes.
fn optical_flow_pixels(s: &FlowSample) -> Option<MavMessage> {
    let tenths = |rate: f64| {
        let n = rate * s.interval.seconds() * 10.0;
        n.is_finite().then(|| n.round().clamp(f64::from(i16::MIN), f64::from(i16::MAX)) as i16)
    };
    Some(MavMessage::OPTICAL_FLOW(apm::OPTICAL_FLOW_DATA {
        time_usec: boot_usec(s.time)?,
        sensor_id: s.sensor,
        flow_x: tenths(-s.rate_xy[1])?,
        flow_y: tenths(s.rate_xy[0])?,
        flow_comp_m_x: 0.0,
        flow_comp_m_y: 0.0,
        quality: (s.quality * 255.0).round().clamp(0.0, 255.0) as u8,
        ground_distance: -1.0,
        flow_rate_x: 0.0,
        flow_rate_y: 0.0,
    }))
}

fn distance_sensor(s: &RangeSample) -> Option<MavMessage> {
    let [least, greatest] = s.limits_m.unwrap_or_default();
    Some(MavMessage::DISTANCE_SENSOR(apm::DISTANCE_SENSOR_DATA {
        time_boot_ms: boot_ms(s.time)?,
        min_distance: unsigned(least * 100.0)?,
        max_distance: unsigned(greatest * 100.0)?,
        current_distance: unsigned(s.distance_m * 100.0)?,
        mavtype: apm::MavDistanceSensor::MAV_DISTANCE_SENSOR_LASER,
        id: s.sensor,
        orientation: match s.direction {
            RangeDirection::Down => apm::MavSensorOrientation::MAV_SENSOR_ROTATION_PITCH_270,
            RangeDirection::Other(_) => return None,
        },
        covariance: u8::MAX,
        horizontal_fov: 0.0,
        vertical_fov: 0.0,
        quaternion: [0.0; 4],
        signal_quality: 0,
    }))
}

/// Only the airspeed of it: the rest is the autopilot's estimate, which a simulated vehicle does not have.
fn vfr_hud(airspeed_mps: f64) -> Option<MavMessage> {
    Some(MavMessage::VFR_HUD(apm::VFR_HUD_DATA {
        airspeed: float(airspeed_mps)?,
        groundspeed: 0.0,
        alt: 0.0,
        climb: 0.0,
        heading: 0,
        throttle: 0,
    }))
}

/// A landmark in a camera's view. Which camera it is, is told by the component that sends it.
fn landing_target(s: &LandmarkSample) -> Option<MavMessage> {
    let (angles, distance, position) = match s.sighting {
        Sighting::Bearing { angle_xy, distance_m } => (angle_xy, distance_m.unwrap_or_default(), None),
        Sighting::Body(p) => ([0.0; 2], p.raw().norm(), Some(p.raw())),
    };
    let [x, y, z] = triple(&position.unwrap_or_default())?;
    Some(MavMessage::LANDING_TARGET(apm::LANDING_TARGET_DATA {
        time_usec: boot_usec(s.time)?,
        angle_x: float(angles[0])?,
        angle_y: float(angles[1])?,
        distance: float(distance)?,
        size_x: 0.0,
        size_y: 0.0,
        target_num: s.id,
        frame: apm::MavFrame::MAV_FRAME_BODY_FRD,
        x,
        y,
        z,
        q: [1.0, 0.0, 0.0, 0.0],
        mavtype: apm::LandingTargetType::LANDING_TARGET_TYPE_VISION_FIDUCIAL,
        position_valid: if position.is_some() {
            apm::MavBool::MAV_BOOL_TRUE
        } else {
            apm::MavBool::MAV_BOOL_FALSE
        },
    }))
}

fn boot_usec(time: AutopilotTime) -> Option<u64> {
    u64::try_from(time.micros()).ok()
}

/// Wraps after 49.7 days, as the field does.
fn boot_ms(time: AutopilotTime) -> Option<u32> {
    Some(((boot_usec(time)? + 500) / 1000) as u32)
}

fn shorts(v: &Vector3<f64>) -> Option<[i16; 3]> {
    let short = |x: f64| x.is_finite().then(|| x.round().clamp(-32_767.0, 32_767.0) as i16);
    Some([short(v.x)?, short(v.y)?, short(v.z)?])
}

/// Rounded; 65 535 is "not known" and never comes of a number.
fn unsigned(v: f64) -> Option<u16> {
    v.is_finite().then(|| v.round().clamp(0.0, 65_534.0) as u16)
}

fn millimetres(height_m: f64) -> Option<i32> {
    height_m.is_finite().then(|| (height_m * 1000.0).round() as i32)
}

fn degrees_e7(p: &Geodetic) -> Option<[i32; 2]> {
    p.is_plausible().then(|| [p.latitude_rad, p.longitude_rad].map(|a| (a.to_degrees() * 1e7).round() as i32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::{AirspeedSample, GroundVelocity};
    use crate::time::Span;

    const TIME: AutopilotTime = AutopilotTime::from_micros(12_345_000);

    fn messages(all: &[Sample]) -> Vec<MavMessage> {
        let mut out = Vec::new();
        samples(all, &mut out);
        out
    }

    fn imu(time: AutopilotTime) -> Sample {
        Sample::Imu(ImuSample {
            time,
            angular_rate: Body::new(Vector3::new(0.1, -0.2, 0.3)),
            specific_force: Body::new(Vector3::new(0.5, 0.0, -9.8)),
        })
    }

    #[test]
    fn a_number_that_is_not_finite_has_no_message() {
        let flow = |rate: f64| {
            Sample::Flow(FlowSample {
                time: TIME,
                sensor: 0,
                interval: Span::from_millis(50),
                rate_xy: [rate, 0.0],
                rotation: FlowRotation::Contained,
                quality: 1.0,
                distance_m: None,
            })
        };
        let airspeed = |airspeed_mps| Sample::Airspeed(AirspeedSample { time: TIME, airspeed_mps });
        let pressure = |pressure_pa| Sample::Pressure(PressureSample { time: TIME, sensor: 0, pressure_pa });
        for value in [f64::NAN, f64::INFINITY, 1e300] {
            assert!(messages(&[flow(value), airspeed(value), pressure(value)]).is_empty(), "{value}");
        }
        assert_eq!(messages(&[flow(0.1), airspeed(20.0), pressure(1e5)]).len(), 3);
        assert!(messages(&[imu(AutopilotTime::from_micros(-1))]).is_empty());
    }

    #[test]
    fn a_field_goes_into_the_inertial_message_of_its_time_only() {
        let mag =
            Sample::Mag(MagSample { time: TIME, sensor: 0, field: Body::new(Vector3::new(2e-5, 0.0, 4e-5)) });
        let flags = |all: &[Sample]| {
            messages(all)
                .iter()
                .map(|m| {
                    let MavMessage::HIGHRES_IMU(m) = m else { panic!("{m:?}") };
                    (m.zmag, m.fields_updated.bits())
                })
                .collect::<Vec<_>>()
        };
        assert_eq!(flags(&[imu(TIME), mag]), [(0.4, 0x1FF)]);
        assert_eq!(flags(&[imu(TIME + Span::from_millis(10)), mag]), [(0.0, 0x3F)]);
        assert!(flags(&[mag]).is_empty());
    }

    #[test]
    fn a_course_just_below_north_is_north() {
        let gnss = GnssSample {
            time: TIME,
            receiver: 0,
            fix: GnssFix::ThreeD,
            position: Some(Geodetic::from_degrees(63.4, 10.4, 100.0)),
            ground_velocity: Some(GroundVelocity { speed_mps: 20.0, course_rad: -1e-6 }),
            horizontal_accuracy_m: Some(1.5),
            vertical_accuracy_m: None,
            speed_accuracy_mps: None,
            satellites: None,
            warning: None,
        };
        let all = messages(&[Sample::Gnss(gnss)]);
        let [MavMessage::GPS_RAW_INT(m)] = &all[..] else { panic!("{all:?}") };
        assert_eq!((m.cog, m.vel, m.h_acc, m.v_acc, m.satellites_visible), (0, 2000, 1500, 0, 255));
        assert_eq!((m.lat, m.lon, m.alt), (634_000_000, 104_000_000, 100_000));
    }
}
