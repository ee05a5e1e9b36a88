//! What the double tells of its sensors and of itself, message by message, in the ways of its autopilot.

use mavlink::MessageData;
use mavlink::dialects::ardupilotmega as apm;
use nalgebra::Vector3;

use super::estimate;
use super::manners::{Manner, Manners};
use crate::geo::{Body, BodyToNed, Ned};
use crate::sample::{Airframe, FlowRotation, FlowSample, Sample, VehicleStatus};
use crate::sim::autopilot::{FlightMode, OwnAiding, SimulatedAutopilot};
use crate::wire::encode_vehicle::{self, VehicleTruth};
use crate::wire::messages::Message;
use crate::wire::session::identity::AutopilotKind;

/// The first of January 2026, µs since 1970: the date for which the simulated magnetic field holds.
const UNIX_US: u64 = 1_767_225_600_000_000;
/// OPTICAL_FLOW's quality in ArduPilot's simulator, always.
const FLOW_QUALITY: u8 = 51;
/// How much larger ArduPilot's HIGHRES_IMU tells the magnetic field.
const FIELD_FACTOR: f32 = 1e6;
/// ArduPilot's versions of those manners, and PX4's: 4.7.0-dev and 1.17.0.
const ARDUPILOT_VERSION: u32 = 0x0407_0000;
const PX4_VERSION: u32 = 0x0111_00FF;

/// Modes of ArduCopter: STABILIZE, GUIDED, LAND.
const COPTER_MODES: [u32; 3] = [0, 4, 9];
/// Modes of PX4: AUTO.LOITER, OFFBOARD, AUTO.LAND.
const PX4_MODES: [u32; 3] = [0x0304_0000, 0x0006_0000, 0x0604_0000];

/// What is known when a message is made.
#[derive(Debug)]
pub(super) struct Telemetry<'a> {
    pub(super) kind: AutopilotKind,
    pub(super) vehicle: &'a SimulatedAutopilot,
    pub(super) manners: &'a Manners,
    /// Whether flow and distance are the autopilot's own, and not a companion camera's.
    pub(super) sees: bool,
}

impl Telemetry<'_> {
    /// HEARTBEAT.
    pub(super) fn heartbeat(&self) -> Message {
        let (airframe, armed) = (Some(Airframe::Multirotor), Some(self.vehicle.armed()));
        let status = VehicleStatus { airframe, armed, landed: None };
        let mut message = encode_vehicle::heartbeat(self.kind, &status);
        if let Message::HEARTBEAT(beat) = &mut message {
            let modes = if self.kind == AutopilotKind::Px4 { PX4_MODES } else { COPTER_MODES };
            let mode = match self.vehicle.mode() {
                FlightMode::Script => usize::from(self.vehicle.armed()),
                FlightMode::Landing | FlightMode::FailsafeLanding => 2,
            };
            beat.custom_mode = modes[mode];
            beat.base_mode |= apm::MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED;
            if self.vehicle.mode() == FlightMode::FailsafeLanding && self.vehicle.armed() {
                beat.system_status = apm::MavState::MAV_STATE_CRITICAL;
            }
        }
        message
    }

    /// The message with this id, as it is now; `None` where there is nothing to tell.
    pub(super) fn message(&self, id: u32) -> Option<Message> {
        let vehicle = self.vehicle;
        let newest = vehicle.newest();
        match id {
            apm::HIGHRES_IMU_DATA::ID => self.highres_imu(),
            apm::RAW_IMU_DATA::ID | apm::SCALED_IMU2_DATA::ID => self.milli_imu(id),
            apm::GPS_RAW_INT_DATA::ID => self.gps_raw_int(),
            apm::SCALED_PRESSURE_DATA::ID => encoded(newest.pressure.map(Sample::Pressure)),
            apm::OPTICAL_FLOW_DATA::ID => self.own_flow().and_then(|flow| self.optical_flow(&flow)),
            apm::OPTICAL_FLOW_RAD_DATA::ID => encoded(self.own_flow().map(Sample::Flow)),
            apm::DISTANCE_SENSOR_DATA::ID => encoded(newest.range.filter(|_| self.sees).map(Sample::Range)),
            apm::SYS_STATUS_DATA::ID => Some(self.sys_status()),
            apm::SYSTEM_TIME_DATA::ID => {
                let now = vehicle.boot_time();
                encode_vehicle::system_time(now, UNIX_US + (vehicle.now_s() * 1e6) as u64)
            }
            apm::GPS_GLOBAL_ORIGIN_DATA::ID => {
                encode_vehicle::origin(vehicle.boot_time(), &vehicle.origin()?)
            }
            apm::SIM_STATE_DATA::ID | apm::HIL_STATE_QUATERNION_DATA::ID => self.truth(),
            apm::AUTOPILOT_VERSION_DATA::ID => Some(self.version()),
            _ => estimate::message(id, vehicle),
        }
    }

    /// SYS_STATUS; ArduPilot tells of external navigation whether it is set up, and whether it is heard.
    fn sys_status(&self) -> Message {
        let mut message = encode_vehicle::sensors_present(false);
        if let (Message::SYS_STATUS(m), OwnAiding::Ekf3(ekf)) = (&mut message, self.vehicle.aiding())
            && ekf.external_is_set_up()
        {
            let vision = apm::MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_VISION_POSITION;
            m.onboard_control_sensors_present |= vision;
            m.onboard_control_sensors_enabled |= vision;
            if ekf.external_is_healthy(self.vehicle.now_s()) {
                m.onboard_control_sensors_health |= vision;
            }
        }
        message
    }

    fn own_flow(&self) -> Option<FlowSample> {
        self.vehicle.newest().flow.filter(|_| self.sees)
    }

    fn highres_imu(&self) -> Option<Message> {
        let newest = self.vehicle.newest();
        let imu = newest.imu?;
        // The field of the message is the newest, at the message's time.
        let mag = newest.mag.map(|m| Sample::Mag(crate::sample::MagSample { time: imu.time, ..m }));
        let mut out = Vec::with_capacity(1);
        encode_vehicle::samples([Some(Sample::Imu(imu)), mag].iter().flatten(), &mut out);
        let mut message = out.pop()?;
        if let (Message::HIGHRES_IMU(m), true) = (&mut message, self.manners.has(Manner::FieldTimesMillion)) {
            (m.xmag, m.ymag, m.zmag) = (m.xmag * FIELD_FACTOR, m.ymag * FIELD_FACTOR, m.zmag * FIELD_FACTOR);
        }
        Some(message)
    }

    /// RAW_IMU and SCALED_IMU2, whose fields are milli units and right.
    fn milli_imu(&self, id: u32) -> Option<Message> {
        let Some(Message::HIGHRES_IMU(m)) =
            Telemetry { manners: &self.manners.clone().without(Manner::FieldTimesMillion), ..*self }
                .highres_imu()
        else {
            return None;
        };
        let milli = |v: f32| (v * 1000.0).round().clamp(-32_767.0, 32_767.0) as i16;
        let g = |v: f32| milli(v / crate::geo::STANDARD_GRAVITY_MPS2 as f32);
        let [xacc, yacc, zacc] = [m.xacc, m.yacc, m.zacc].map(g);
        let [xgyro, ygyro, zgyro] = [m.xgyro, m.ygyro, m.zgyro].map(milli);
        let [xmag, ymag, zmag] = [m.xmag, m.ymag, m.zmag].map(milli);
        let (time_usec, temperature) = (m.time_usec, 4500);
        Some(if id == apm::RAW_IMU_DATA::ID {
            let id = 0;
            Message::RAW_IMU(apm::RAW_IMU_DATA {
                time_usec,
                xacc,
                yacc,
                zacc,
                xgyro,
                ygyro,
                zgyro,
                xmag,
                ymag,
                zmag,
                id,
                temperature,
            })
        } else {
            let time_boot_ms = (time_usec / 1000) as u32;
            Message::SCALED_IMU2(apm::SCALED_IMU2_DATA {
                time_boot_ms,
                xacc,
                yacc,
                zacc,
                xgyro,
                ygyro,
                zgyro,
                xmag,
                ymag,
                zmag,
                temperature,
            })
        })
    }

    fn gps_raw_int(&self) -> Option<Message> {
        let mut message = encoded(self.vehicle.newest().gnss.map(Sample::Gnss))?;
        if let (Message::GPS_RAW_INT(m), true) = (&mut message, self.manners.has(Manner::ZeroGnssStamp)) {
            m.time_usec = 0;
        }
        Some(message)
    }

    /// ArduPilot's: the stamp is that of the message, in milliseconds, and the compensated flow is an angular rate.
    fn optical_flow(&self, flow: &FlowSample) -> Option<Message> {
        let gyro = match flow.rotation {
            FlowRotation::SensorGyro(gyro) => gyro,
            FlowRotation::Removed | FlowRotation::Contained | FlowRotation::InOwnUnit => [0.0; 2],
        };
        let [x, y] = flow.rate_xy;
        let counts = |rate: f64| (rate * 100.0).clamp(-32_767.0, 32_767.0) as i16;
        Some(Message::OPTICAL_FLOW(apm::OPTICAL_FLOW_DATA {
            time_usec: u64::try_from(self.vehicle.boot_time().micros() / 1000).ok()?,
            flow_comp_m_x: (x - gyro[0]) as f32,
            flow_comp_m_y: (y - gyro[1]) as f32,
            ground_distance: (-self.vehicle.filter().position().z) as f32,
            flow_x: counts(x),
            flow_y: counts(y),
            sensor_id: flow.sensor,
            quality: FLOW_QUALITY,
            flow_rate_x: x as f32,
            flow_rate_y: y as f32,
        }))
    }

    fn truth(&self) -> Option<Message> {
        let truth = self.vehicle.truth();
        let felt = self.vehicle.environment().imu_at(truth);
        let truth = VehicleTruth {
            time: self.vehicle.boot_time(),
            attitude: BodyToNed::from_matrix(&truth.r_body_to_ned),
            position: self.vehicle.frame().to_geodetic(&truth.position_ned),
            velocity: Ned::new(truth.velocity_ned),
            angular_rate: Body::new(felt.angular_rate),
            specific_force: Body::new(felt.specific_force),
        };
        encode_vehicle::truth(self.kind, &truth)
    }

    fn version(&self) -> Message {
        let px4 = self.kind == AutopilotKind::Px4;
        Message::AUTOPILOT_VERSION(apm::AUTOPILOT_VERSION_DATA {
            capabilities: apm::MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2
                | apm::MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_COMMAND_INT,
            uid: 1,
            flight_sw_version: if px4 { PX4_VERSION } else { ARDUPILOT_VERSION },
            middleware_sw_version: 0,
            os_sw_version: 0,
            board_version: 0,
            vendor_id: 0,
            product_id: 0,
            flight_custom_version: [0; 8],
            middleware_custom_version: [0; 8],
            os_custom_version: [0; 8],
            uid2: [0; 18],
        })
    }
}

fn encoded(sample: Option<Sample>) -> Option<Message> {
    let mut out = Vec::with_capacity(1);
    encode_vehicle::samples(sample.iter(), &mut out);
    out.pop()
}

/// Three 32-bit floats.
pub(super) fn floats(v: &Vector3<f64>) -> [f32; 3] {
    [v.x as f32, v.y as f32, v.z as f32]
}
