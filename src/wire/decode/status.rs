//! What the vehicle is, whether it is armed and has landed, and whether it has a pitot tube.

use mavlink::dialects::ardupilotmega as apm;

use crate::sample::{Airframe, Input, VehicleStatus};

use super::super::session::heartbeat_fields::HeartbeatFields;
use super::super::session::identity::NatureWord;
use super::{Cause, Decoder, Out};

/// A differential pressure beyond this is one, hPa: 4 m/s.
const SOME_PRESSURE_HPA: f32 = 0.1;

impl Decoder {
    /// HEARTBEAT of the autopilot.
    pub(super) fn heartbeat(&mut self, m: &apm::HEARTBEAT_DATA, out: Out<'_>) -> Result<(), Cause> {
        let now_us = self.clock.newest().map_or(0, |t| t.micros());
        let told = HeartbeatFields {
            custom_mode: m.custom_mode,
            vehicle_type: m.mavtype as u8,
            autopilot: m.autopilot as u8,
            base_mode: m.base_mode.bits(),
            system_status: m.system_status as u8,
            mavlink_version: m.mavlink_version,
        };
        let NatureWord::Believed(is) = self.nature.hear(now_us, told) else { return Err(Cause::Unconfirmed) };
        let landed = self.status.and_then(|before| before.landed);
        self.tell(
            VehicleStatus { airframe: airframe(is.vehicle_type), armed: Some(is.armed()), landed },
            out,
        );
        Ok(())
    }

    /// EXTENDED_SYS_STATE of the autopilot.
    pub(super) fn extended_sys_state(
        &mut self,
        m: &apm::EXTENDED_SYS_STATE_DATA,
        out: Out<'_>,
    ) -> Result<(), Cause> {
        use apm::MavLandedState as State;
        let landed = match m.landed_state {
            State::MAV_LANDED_STATE_UNDEFINED => return Ok(()),
            State::MAV_LANDED_STATE_ON_GROUND => true,
            State::MAV_LANDED_STATE_IN_AIR
            | State::MAV_LANDED_STATE_TAKEOFF
            | State::MAV_LANDED_STATE_LANDING => false,
        };
        self.tell(VehicleStatus { landed: Some(landed), ..self.status.unwrap_or_default() }, out);
        Ok(())
    }

    fn tell(&mut self, status: VehicleStatus, out: Out<'_>) {
        if self.status != Some(status) {
            self.status = Some(status);
            out.push(Input::Status(status));
        }
    }

    /// SYS_STATUS tells whether a differential pressure sensor is enabled.
    pub(super) fn sys_status(&mut self, m: &apm::SYS_STATUS_DATA) -> Result<(), Cause> {
        let sensor = apm::MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_DIFFERENTIAL_PRESSURE;
        self.pitot = Some(m.onboard_control_sensors_enabled.contains(sensor));
        Ok(())
    }

    /// SCALED_PRESSURE shows a differential pressure where SYS_STATUS is not sent.
    pub(super) fn differential_pressure(&mut self, hpa: f32) {
        if self.pitot.is_none() && hpa.is_finite() && hpa.abs() > SOME_PRESSURE_HPA {
            self.pitot = Some(true);
        }
    }
}

/// What a `MAV_TYPE` can be expected to do.
pub fn airframe(mav_type: u8) -> Option<Airframe> {
    match mav_type {
        1 | 19..=25 => Some(Airframe::FixedWing),
        2..=4 | 13..=15 | 29 | 35 => Some(Airframe::Multirotor),
        10..=12 => Some(Airframe::Surface),
        _ => None,
    }
}
