//! The messages that Holdover knows: what each is decoded into, which are asked for and how often, which are sent. Their ids are the
//! dialect's own constants; no other place names a message by its number, but for the one that the dialect has not.

use mavlink::MessageData;
use mavlink::dialects::ardupilotmega as apm;

use super::gnss_integrity;
use super::session::identity::AutopilotKind;

/// A MAVLink message, as the other rooms carry it from one part of this one to another.
pub use mavlink::dialects::ardupilotmega::MavMessage as Message;

/// What a message that is heard is taken for.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Meaning {
    /// Kind and state of the vehicle: [`crate::sample::VehicleStatus`], and the sensors it has.
    Vehicle,
    /// [`crate::sample::ImuSample`], with the magnetometer and, in one message, the barometer.
    Inertial,
    /// [`crate::sample::GnssSample`].
    Gnss,
    /// The origin of the autopilot's local frame.
    Origin,
    /// [`crate::sample::PressureSample`].
    Pressure,
    /// [`crate::sample::FlowSample`].
    Flow,
    /// [`crate::sample::RangeSample`].
    Range,
    /// [`crate::sample::AirspeedSample`].
    Airspeed,
    /// [`crate::sample::LandmarkSample`].
    Landmark,
    /// How fast rotors turn: no input of the core, but what explains a vibration.
    Rotors,
    /// What 1970 is on the autopilot's clock.
    Date,
    /// [`crate::sample::Reference`]: truth, or the autopilot's own estimate.
    Reference,
    /// Answers and questions of the conversation ([`super::session`]), and what the autopilot tells of its estimator: no input of the core.
    Conversation,
}

/// Which configured rate a message is asked for with ([`super::session::requests::StreamSettings`]).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Rate {
    /// The IMU.
    Imu,
    /// The IMU of autopilots that have no HIGHRES_IMU.
    FallbackImu,
    /// GNSS receivers.
    Gnss,
    /// Barometer.
    Pressure,
    /// Optical flow.
    Flow,
    /// Rangefinder.
    Range,
    /// Airspeed.
    Airspeed,
    /// The autopilot's local position.
    LocalPosition,
    /// What the autopilot tells of its estimator.
    Estimator,
    /// What hardly changes.
    Slow,
}

/// One row of the table.
#[derive(Clone, Copy, Debug)]
pub struct MessageUse {
    /// Id in the dialect.
    pub id: u32,
    /// Name in the dialect.
    pub name: &'static str,
    /// What it is taken for when it is heard.
    pub heard: Option<Meaning>,
    /// At which rate it is asked for.
    pub asked: Option<Rate>,
    /// The only autopilot that has it, and is asked for it.
    pub only: Option<AutopilotKind>,
    /// Whether Holdover sends it.
    pub sent: bool,
}

impl MessageUse {
    const fn heard<D: MessageData>(meaning: Meaning) -> Self {
        Self { id: D::ID, name: D::NAME, heard: Some(meaning), asked: None, only: None, sent: false }
    }

    const fn sent<D: MessageData>() -> Self {
        Self { id: D::ID, name: D::NAME, heard: None, asked: None, only: None, sent: true }
    }

    const fn and_asked(self, rate: Rate) -> Self {
        Self { asked: Some(rate), ..self }
    }

    const fn of(self, only: AutopilotKind) -> Self {
        Self { only: Some(only), ..self }
    }

    const fn and_sent(self) -> Self {
        Self { sent: true, ..self }
    }
}

/// Every message that is used. Those that are asked for are asked for in this order: first what navigation stands on.
pub const TABLE: &[MessageUse] = &[
    MessageUse::heard::<apm::HIGHRES_IMU_DATA>(Meaning::Inertial).and_asked(Rate::Imu),
    MessageUse::heard::<apm::RAW_IMU_DATA>(Meaning::Inertial).and_asked(Rate::FallbackImu),
    MessageUse::heard::<apm::SCALED_IMU2_DATA>(Meaning::Inertial).and_asked(Rate::FallbackImu),
    MessageUse::heard::<apm::SCALED_IMU_DATA>(Meaning::Inertial),
    MessageUse::heard::<apm::SCALED_IMU3_DATA>(Meaning::Inertial),
    MessageUse::heard::<apm::GPS_RAW_INT_DATA>(Meaning::Gnss).and_asked(Rate::Gnss),
    MessageUse::heard::<apm::GPS2_RAW_DATA>(Meaning::Gnss).and_asked(Rate::Gnss),
    MessageUse {
        id: gnss_integrity::ID,
        name: gnss_integrity::NAME,
        heard: Some(Meaning::Gnss),
        asked: Some(Rate::Slow),
        only: None,
        sent: false,
    },
    MessageUse::heard::<apm::SCALED_PRESSURE_DATA>(Meaning::Pressure).and_asked(Rate::Pressure),
    MessageUse::heard::<apm::SCALED_PRESSURE2_DATA>(Meaning::Pressure),
    MessageUse::heard::<apm::SCALED_PRESSURE3_DATA>(Meaning::Pressure),
    MessageUse::heard::<apm::OPTICAL_FLOW_DATA>(Meaning::Flow).and_asked(Rate::Flow),
    MessageUse::heard::<apm::OPTICAL_FLOW_RAD_DATA>(Meaning::Flow).and_asked(Rate::Flow),
    MessageUse::heard::<apm::DISTANCE_SENSOR_DATA>(Meaning::Range).and_asked(Rate::Range),
    MessageUse::heard::<apm::RANGEFINDER_DATA>(Meaning::Range),
    MessageUse::heard::<apm::LANDING_TARGET_DATA>(Meaning::Landmark),
    MessageUse::heard::<apm::LOCAL_POSITION_NED_DATA>(Meaning::Reference).and_asked(Rate::LocalPosition),
    MessageUse::heard::<apm::VFR_HUD_DATA>(Meaning::Airspeed).and_asked(Rate::Airspeed),
    MessageUse::heard::<apm::SYS_STATUS_DATA>(Meaning::Vehicle).and_asked(Rate::Slow),
    MessageUse::heard::<apm::EXTENDED_SYS_STATE_DATA>(Meaning::Vehicle),
    MessageUse::heard::<apm::SYSTEM_TIME_DATA>(Meaning::Date).and_asked(Rate::Slow),
    MessageUse::heard::<apm::GPS_GLOBAL_ORIGIN_DATA>(Meaning::Origin).and_asked(Rate::Slow),
    MessageUse::heard::<apm::HEARTBEAT_DATA>(Meaning::Vehicle).and_sent(),
    MessageUse::heard::<apm::ATTITUDE_DATA>(Meaning::Reference).and_asked(Rate::LocalPosition),
    MessageUse::heard::<apm::ATTITUDE_QUATERNION_DATA>(Meaning::Reference),
    MessageUse::heard::<apm::GLOBAL_POSITION_INT_DATA>(Meaning::Reference),
    MessageUse::heard::<apm::SIM_STATE_DATA>(Meaning::Reference),
    MessageUse::heard::<apm::SIMSTATE_DATA>(Meaning::Reference),
    MessageUse::heard::<apm::HIL_STATE_QUATERNION_DATA>(Meaning::Reference),
    MessageUse::heard::<apm::ESC_STATUS_DATA>(Meaning::Rotors),
    MessageUse::heard::<apm::ESC_TELEMETRY_1_TO_4_DATA>(Meaning::Rotors),
    MessageUse::heard::<apm::ESC_TELEMETRY_5_TO_8_DATA>(Meaning::Rotors),
    MessageUse::heard::<apm::ESC_TELEMETRY_9_TO_12_DATA>(Meaning::Rotors),
    MessageUse::heard::<apm::EKF_STATUS_REPORT_DATA>(Meaning::Conversation)
        .and_asked(Rate::Estimator)
        .of(AutopilotKind::ArduPilot),
    MessageUse::heard::<apm::ESTIMATOR_STATUS_DATA>(Meaning::Conversation)
        .and_asked(Rate::Estimator)
        .of(AutopilotKind::Px4),
    MessageUse::heard::<apm::TIMESYNC_DATA>(Meaning::Conversation).and_sent(),
    MessageUse::heard::<apm::COMMAND_ACK_DATA>(Meaning::Conversation),
    MessageUse::heard::<apm::AUTOPILOT_VERSION_DATA>(Meaning::Conversation),
    MessageUse::heard::<apm::PARAM_VALUE_DATA>(Meaning::Conversation),
    MessageUse::heard::<apm::PARAM_ERROR_DATA>(Meaning::Conversation),
    MessageUse::sent::<apm::COMMAND_LONG_DATA>(),
    MessageUse::sent::<apm::PARAM_REQUEST_READ_DATA>(),
    MessageUse::sent::<apm::PARAM_SET_DATA>(),
    MessageUse::heard::<apm::STATUSTEXT_DATA>(Meaning::Conversation).and_sent(),
    MessageUse::sent::<apm::ODOMETRY_DATA>(),
    MessageUse::sent::<apm::VISION_POSITION_ESTIMATE_DATA>(),
    MessageUse::sent::<apm::VISION_SPEED_ESTIMATE_DATA>(),
    #[allow(deprecated, reason = "its successor is a command that the autopilots in use do not know")]
    MessageUse::sent::<apm::SET_GPS_GLOBAL_ORIGIN_DATA>(),
];

/// Ids below this are looked up; the few above are seldom heard.
const LOOKED_UP: usize = 512;

/// [`Meaning`] by id, made at compile time: frames are sorted before they are parsed, hundreds a second.
const MEANINGS: [Option<Meaning>; LOOKED_UP] = {
    let mut all = [None; LOOKED_UP];
    let mut i = 0;
    while i < TABLE.len() {
        if (TABLE[i].id as usize) < LOOKED_UP {
            all[TABLE[i].id as usize] = TABLE[i].heard;
        }
        i += 1;
    }
    all
};

/// What a message is taken for; `None` for those that tell nothing here.
pub fn meaning_of(id: u32) -> Option<Meaning> {
    match MEANINGS.get(usize::try_from(id).ok()?) {
        Some(meaning) => *meaning,
        None => TABLE.iter().find(|row| row.id == id)?.heard,
    }
}

/// Whether a message tells the core anything.
pub fn is_input(id: u32) -> bool {
    meaning_of(id).is_some_and(|m| !matches!(m, Meaning::Conversation | Meaning::Rotors))
}

/// Whether a message is taken from every component of the vehicle, and not from its autopilot alone: what cameras, flow sensors and
/// rangefinders send themselves. RANGEFINDER has neither a stamp nor the number of a sensor.
pub fn from_any_component(id: u32) -> bool {
    id != apm::RANGEFINDER_DATA::ID
        && matches!(meaning_of(id), Some(Meaning::Flow | Meaning::Range | Meaning::Landmark))
}

/// The dialect's name of a message, used here or not; `None` for one that it does not know.
pub fn name_of(id: u32) -> Option<&'static str> {
    use mavlink::Message as _;
    if id == gnss_integrity::ID {
        return Some(gnss_integrity::NAME);
    }
    Message::default_message_from_id(id).map(|m| m.message_name())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_message_stands_in_the_table_once_and_is_used() {
        for (i, row) in TABLE.iter().enumerate() {
            assert!(TABLE[..i].iter().all(|other| other.id != row.id), "{} twice", row.name);
            assert!(row.heard.is_some() || row.sent, "{} is of no use", row.name);
            let told = is_input(row.id) || row.asked == Some(Rate::Estimator);
            assert!(row.asked.is_none() || told, "{} is asked for in vain", row.name);
            assert_eq!(name_of(row.id), Some(row.name));
            assert_eq!(meaning_of(row.id), row.heard);
        }
        assert_eq!(meaning_of(u32::MAX), None);
    }
}
