//! `[streams]`: which messages the autopilot is asked for, and how often.

use crate::config::key::section;
use crate::wire::session::requests::StreamSettings;

section! {
    /// Messages that the autopilot is asked for.
    "streams" struct StreamsKeys {
        /// Ask the autopilot for the messages below (MAV_CMD_SET_MESSAGE_INTERVAL).
        request: bool = true;
        /// Rate of the IMU's messages (0 does not ask, here and below).
        imu_hz: f64 = 200.0 in 0.0 ..= 1000.0;
        /// GPS_RAW_INT and GPS2_RAW.
        gnss_hz: f64 = 10.0 in 0.0 ..= 1000.0;
        /// SCALED_PRESSURE.
        pressure_hz: f64 = 25.0 in 0.0 ..= 1000.0;
        /// OPTICAL_FLOW, OPTICAL_FLOW_RAD.
        flow_hz: f64 = 50.0 in 0.0 ..= 1000.0;
        /// DISTANCE_SENSOR.
        range_hz: f64 = 20.0 in 0.0 ..= 1000.0;
        /// LOCAL_POSITION_NED and ATTITUDE, to align our frame with the autopilot's.
        local_position_hz: f64 = 10.0 in 0.0 ..= 1000.0;
        /// EKF_STATUS_REPORT (ArduPilot) and ESTIMATOR_STATUS (PX4), which tell what the autopilot's position stands on.
        estimator_hz: f64 = 5.0 in 0.0 ..= 1000.0;
        /// VFR_HUD, which holds the airspeed.
        airspeed_hz: f64 = 10.0 in 0.0 ..= 1000.0;
        /// SYSTEM_TIME, GPS_GLOBAL_ORIGIN, SYS_STATUS (whether there is a pitot tube).
        slow_hz: f64 = 1.0 in 0.0 ..= 1000.0;
        /// Times that a message which does not come is asked for again.
        retries: u8 = 5 in 0.0 ..= 100.0 unit "";
    }
}

impl StreamsKeys {
    pub(super) fn settings(&self) -> StreamSettings {
        StreamSettings {
            request: self.request,
            imu_hz: self.imu_hz,
            gnss_hz: self.gnss_hz,
            pressure_hz: self.pressure_hz,
            flow_hz: self.flow_hz,
            range_hz: self.range_hz,
            local_position_hz: self.local_position_hz,
            estimator_hz: self.estimator_hz,
            slow_hz: self.slow_hz,
            airspeed_hz: self.airspeed_hz,
            retries: self.retries,
        }
    }
}
