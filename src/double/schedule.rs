//! When each message is sent: the intervals that were asked for, and the autopilot's own.

use mavlink::MessageData;
use mavlink::dialects::ardupilotmega as apm;

use crate::wire::session::identity::AutopilotKind;

/// Half of the shortest step: a message is not a step late for a rounding error, µs.
const SLACK_US: i64 = 300;
/// What a ground station sets all streams to (ArduPilot's default of SRn), µs.
pub const STATION_INTERVAL_US: i64 = 250_000;

/// One message's row.
#[derive(Clone, Copy, Debug)]
struct Row {
    id: u32,
    /// What it was before anybody asked, µs.
    usual_us: Option<i64>,
    interval_us: Option<i64>,
    sent_us: Option<i64>,
}

/// The messages that an autopilot has, and when each is due.
#[derive(Clone, Debug)]
pub struct MessageSchedule(Vec<Row>);

/// ArduPilot's streams: whatever is not asked for comes at 4 Hz, the truth of the simulator at 25 Hz.
const ARDUPILOT: &[(u32, Option<i64>)] = &[
    (apm::HIGHRES_IMU_DATA::ID, None),
    (apm::RAW_IMU_DATA::ID, Some(STATION_INTERVAL_US)),
    (apm::SCALED_IMU2_DATA::ID, Some(STATION_INTERVAL_US)),
    (apm::GPS_RAW_INT_DATA::ID, Some(STATION_INTERVAL_US)),
    (apm::SCALED_PRESSURE_DATA::ID, Some(STATION_INTERVAL_US)),
    (apm::OPTICAL_FLOW_DATA::ID, Some(STATION_INTERVAL_US)),
    (apm::DISTANCE_SENSOR_DATA::ID, Some(STATION_INTERVAL_US)),
    (apm::LOCAL_POSITION_NED_DATA::ID, Some(STATION_INTERVAL_US)),
    (apm::GLOBAL_POSITION_INT_DATA::ID, Some(STATION_INTERVAL_US)),
    (apm::ATTITUDE_DATA::ID, Some(STATION_INTERVAL_US)),
    (apm::VFR_HUD_DATA::ID, Some(STATION_INTERVAL_US)),
    (apm::SYS_STATUS_DATA::ID, Some(STATION_INTERVAL_US)),
    (apm::SYSTEM_TIME_DATA::ID, Some(STATION_INTERVAL_US)),
    (apm::EKF_STATUS_REPORT_DATA::ID, Some(STATION_INTERVAL_US)),
    (apm::SIM_STATE_DATA::ID, Some(40_000)),
    (apm::GPS_GLOBAL_ORIGIN_DATA::ID, None),
    (apm::AUTOPILOT_VERSION_DATA::ID, None),
];

/// PX4's streams of `-m onboard`.
const PX4: &[(u32, Option<i64>)] = &[
    (apm::HIGHRES_IMU_DATA::ID, Some(20_000)),
    (apm::GPS_RAW_INT_DATA::ID, Some(100_000)),
    (apm::SCALED_PRESSURE_DATA::ID, None),
    (apm::OPTICAL_FLOW_RAD_DATA::ID, Some(100_000)),
    (apm::DISTANCE_SENSOR_DATA::ID, Some(100_000)),
    (apm::LOCAL_POSITION_NED_DATA::ID, Some(33_000)),
    (apm::GLOBAL_POSITION_INT_DATA::ID, Some(20_000)),
    (apm::ATTITUDE_DATA::ID, Some(10_000)),
    (apm::ATTITUDE_QUATERNION_DATA::ID, Some(20_000)),
    (apm::VFR_HUD_DATA::ID, Some(100_000)),
    (apm::SYS_STATUS_DATA::ID, Some(200_000)),
    (apm::SYSTEM_TIME_DATA::ID, Some(1_000_000)),
    (apm::ESTIMATOR_STATUS_DATA::ID, Some(1_000_000)),
    (apm::HIL_STATE_QUATERNION_DATA::ID, Some(40_000)),
    (apm::GPS_GLOBAL_ORIGIN_DATA::ID, Some(1_000_000)),
    (apm::AUTOPILOT_VERSION_DATA::ID, None),
];

impl MessageSchedule {
    /// As the autopilot boots.
    pub fn usual(kind: AutopilotKind) -> Self {
        let rows = if kind == AutopilotKind::Px4 { PX4 } else { ARDUPILOT };
        let row = |&(id, usual_us)| Row { id, usual_us, interval_us: usual_us, sent_us: None };
        Self(rows.iter().map(row).collect())
    }

    /// Whether the autopilot has this message.
    pub fn has(&self, id: u32) -> bool {
        self.0.iter().any(|row| row.id == id)
    }

    /// The interval of a message, µs; `None` while it is off.
    pub fn interval_us(&self, id: u32) -> Option<i64> {
        self.0.iter().find(|row| row.id == id).and_then(|row| row.interval_us)
    }

    /// Sets an interval as `MAV_CMD_SET_MESSAGE_INTERVAL` has it: µs, 0 for the usual, negative for off.
    pub fn set(&mut self, id: u32, interval_us: i64) {
        if let Some(row) = self.0.iter_mut().find(|row| row.id == id) {
            row.interval_us = match interval_us {
                0 => row.usual_us,
                us if us < 0 => None,
                us => Some(us),
            };
        }
    }

    /// A ground station sets everything that comes.
    pub fn set_all(&mut self, interval_us: i64) {
        for row in self.0.iter_mut().filter(|row| row.interval_us.is_some()) {
            row.interval_us = Some(interval_us);
        }
    }

    /// The messages that are due; each is asked for once.
    pub fn due(&mut self, now_us: i64) -> impl Iterator<Item = u32> + '_ {
        self.0.iter_mut().filter_map(move |row| {
            let interval_us = row.interval_us?;
            if row.sent_us.is_some_and(|sent| now_us - sent < interval_us - SLACK_US) {
                return None;
            }
            row.sent_us = Some(now_us);
            Some(row.id)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sent(schedule: &mut MessageSchedule, id: u32, step_us: i64, seconds: i64) -> usize {
        (0..seconds * 1_000_000 / step_us)
            .map(|k| schedule.due(k * step_us).filter(|&i| i == id).count())
            .sum()
    }

    #[test]
    fn two_hundred_of_two_hundred_and_fifty_are_a_hundred_and_twenty_five() {
        let imu = apm::HIGHRES_IMU_DATA::ID;
        let mut px4 = MessageSchedule::usual(AutopilotKind::Px4);
        px4.set(imu, 5000);
        assert_eq!(sent(&mut px4, imu, 4000, 4), 500);
        let mut ardupilot = MessageSchedule::usual(AutopilotKind::ArduPilot);
        assert_eq!(sent(&mut ardupilot, imu, 2500, 4), 0, "it has to be asked for");
        ardupilot.set(imu, 5000);
        assert_eq!(sent(&mut ardupilot, imu, 2500, 4), 800);
        ardupilot.set_all(STATION_INTERVAL_US);
        assert_eq!(ardupilot.interval_us(imu), Some(STATION_INTERVAL_US));
        ardupilot.set(imu, 0);
        assert_eq!(ardupilot.interval_us(imu), None);
        assert!(!ardupilot.has(apm::OPTICAL_FLOW_RAD_DATA::ID));
    }
}
