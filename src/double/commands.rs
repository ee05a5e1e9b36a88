//! Commands and requests that the double obeys, and how it answers.

use mavlink::MessageData;
use mavlink::dialects::ardupilotmega as apm;

use super::manners::Manner;
use super::{AutopilotDouble, DoublePort};
use crate::geo::Geodetic;
use crate::wire::messages::Message;
use crate::wire::session::Address;
use crate::wire::session::identity::AutopilotKind;

/// Largest part of SCHED_LOOP_RATE at which ArduPilot sends a message.
const MOST_OF_LOOP: f64 = 0.8;

/// A command, of either message.
#[derive(Clone, Copy, Debug)]
struct Order {
    command: apm::MavCmd,
    param: [f64; 4],
    /// COMMAND_INT's place.
    place: Option<[i32; 2]>,
}

/// A message for the double alone: a command, a parameter, a question. False for what is none of these.
pub(super) fn converse(double: &mut AutopilotDouble, from: Address, message: &Message) -> bool {
    let us = double.address();
    let meant = |system, component| us.is_meant_by(system, component);
    match message {
        Message::COMMAND_LONG(m) if meant(m.target_system, m.target_component) => {
            let param = [m.param1, m.param2, m.param3, m.param4].map(f64::from);
            order(double, from, Order { command: m.command, param, place: None });
        }
        Message::COMMAND_INT(m) if meant(m.target_system, m.target_component) => {
            let param = [m.param1, m.param2, m.param3, m.param4].map(f64::from);
            order(double, from, Order { command: m.command, param, place: Some([m.x, m.y]) });
        }
        Message::PARAM_REQUEST_READ(m) if meant(m.target_system, m.target_component) => {
            let name = m.param_id.to_str().unwrap_or_default();
            let asked = double.parameters.asked(m.param_index, name);
            double.to_tell.extend(asked);
        }
        Message::PARAM_REQUEST_LIST(m) if meant(m.target_system, m.target_component) => {
            double.to_tell.extend(0..double.parameters.count());
        }
        Message::PARAM_SET(m) if meant(m.target_system, m.target_component) => {
            parameter_set(double, m.param_id.to_str().unwrap_or_default(), m.param_value);
        }
        _ => return false,
    }
    true
}

fn parameter_set(double: &mut AutopilotDouble, name: &str, value: f32) {
    let Some(value) = double.parameters.decoded(name, value) else { return };
    if double.parameters.set(name, value).is_ok() {
        double.vehicle.set_rules(double.parameters.rules());
        let told = double.parameters.asked(-1, name);
        double.to_tell.extend(told);
    }
}

fn order(double: &mut AutopilotDouble, from: Address, order: Order) {
    let result = about_streams(double, &order).unwrap_or_else(|| about_the_vehicle(double, &order));
    double.say(Message::COMMAND_ACK(apm::COMMAND_ACK_DATA {
        command: order.command,
        result,
        progress: 0,
        result_param2: 0,
        target_system: from.system.0,
        target_component: from.component.0,
    }));
    let reboots = order.command == apm::MavCmd::MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN;
    if reboots && result == apm::MavResult::MAV_RESULT_ACCEPTED {
        double.rebooted();
    }
}

fn about_streams(double: &mut AutopilotDouble, order: &Order) -> Option<apm::MavResult> {
    let [first, second, ..] = order.param;
    match order.command {
        apm::MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL => Some(set_interval(double, first as u32, second as i64)),
        apm::MavCmd::MAV_CMD_REQUEST_MESSAGE if first as u32 == apm::MESSAGE_INTERVAL_DATA::ID => {
            Some(tell_interval(double, second as u32))
        }
        apm::MavCmd::MAV_CMD_REQUEST_MESSAGE => Some(request(double, first as u32)),
        _ => None,
    }
}

fn about_the_vehicle(double: &mut AutopilotDouble, order: &Order) -> apm::MavResult {
    use apm::{MavCmd, MavResult};
    let first = order.param[0];
    let accepted = |yes| if yes { MavResult::MAV_RESULT_ACCEPTED } else { MavResult::MAV_RESULT_DENIED };
    let ardupilot = double.kind() == AutopilotKind::ArduPilot;
    match order.command {
        MavCmd::MAV_CMD_COMPONENT_ARM_DISARM if first > 0.5 => {
            double.vehicle.arm().map_or(MavResult::MAV_RESULT_FAILED, |()| MavResult::MAV_RESULT_ACCEPTED)
        }
        MavCmd::MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN if first > 0.5 => accepted(double.vehicle.reboot()),
        MavCmd::MAV_CMD_SET_EKF_SOURCE_SET if ardupilot => accepted(double.vehicle.select_set(first as u8)),
        MavCmd::MAV_CMD_EXTERNAL_POSITION_ESTIMATE if ardupilot => external_position(double, order),
        _ => MavResult::MAV_RESULT_UNSUPPORTED,
    }
}

/// The answer to a message that the double does not have.
fn lacking(double: &mut AutopilotDouble, id: u32) -> apm::MavResult {
    if double.kind() == AutopilotKind::Px4 {
        return apm::MavResult::MAV_RESULT_FAILED;
    }
    if double.manners.has(Manner::NoSuchMessage) {
        let words = double.words.no_such_message(id);
        words.into_iter().for_each(|m| double.say(m));
    }
    apm::MavResult::MAV_RESULT_DENIED
}

fn set_interval(double: &mut AutopilotDouble, id: u32, interval_us: i64) -> apm::MavResult {
    if !double.schedule.has(id) {
        return lacking(double, id);
    }
    let most_hz = MOST_OF_LOOP * double.parameters.get("SCHED_LOOP_RATE");
    if double.manners.has(Manner::RateLimit) && interval_us > 0 && 1e6 / interval_us as f64 > most_hz {
        let words = double.words.too_fast(id);
        words.into_iter().for_each(|m| double.say(m));
        return apm::MavResult::MAV_RESULT_DENIED;
    }
    double.schedule.set(id, interval_us);
    apm::MavResult::MAV_RESULT_ACCEPTED
}

fn tell_interval(double: &mut AutopilotDouble, id: u32) -> apm::MavResult {
    if !double.schedule.has(id) {
        return lacking(double, id);
    }
    let interval_us = double.schedule.interval_us(id).map_or(-1, |us| us as i32);
    let message_id = id as u16;
    double.say(Message::MESSAGE_INTERVAL(apm::MESSAGE_INTERVAL_DATA { interval_us, message_id }));
    apm::MavResult::MAV_RESULT_ACCEPTED
}

fn request(double: &mut AutopilotDouble, id: u32) -> apm::MavResult {
    if !double.schedule.has(id) {
        return lacking(double, id);
    }
    match double.telemetry(id) {
        Some(message) => {
            double.send(DoublePort::Main, &message);
            apm::MavResult::MAV_RESULT_ACCEPTED
        }
        None => apm::MavResult::MAV_RESULT_FAILED,
    }
}

/// MAV_CMD_EXTERNAL_POSITION_ESTIMATE comes as COMMAND_INT: its place are whole numbers, and param 3 says how good it is.
fn external_position(double: &mut AutopilotDouble, order: &Order) -> apm::MavResult {
    let Some([latitude, longitude]) = order.place else { return apm::MavResult::MAV_RESULT_COMMAND_INT_ONLY };
    let height_m = double.vehicle.origin().map_or(0.0, |o| o.height_m);
    let place = Geodetic::from_degrees(f64::from(latitude) * 1e-7, f64::from(longitude) * 1e-7, height_m);
    if double.vehicle.place(&place, order.param[2].max(0.1)) {
        apm::MavResult::MAV_RESULT_ACCEPTED
    } else {
        apm::MavResult::MAV_RESULT_DENIED
    }
}
