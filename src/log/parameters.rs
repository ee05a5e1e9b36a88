//! The autopilot's parameters that say how its sensors are mounted, scaled and delayed: read from the logs that hold them.

use std::collections::BTreeMap;

/// Parameters that are kept, and what each says.
pub const WANTED: &[(&str, &str)] = &[
    ("AHRS_ORIENTATION", "how the board is mounted; the log's IMU is turned already"),
    ("ARSPD_RATIO", "scale of the pitot tube's pressure, applied in the log"),
    ("ARSPD_TYPE", "kind of airspeed sensor, 0 none"),
    ("EK3_FLOW_DELAY", "delay of optical flow that EKF3 assumes, ms"),
    ("EKF2_AVEL_DELAY", "delay of auxiliary velocities that EKF2 assumes, ms"),
    ("EKF2_GPS_DELAY", "delay of GNSS that EKF2 assumes, ms; Holdover measures it"),
    ("EKF2_OF_DELAY", "delay of optical flow that EKF2 assumes, ms; Holdover measures it"),
    ("FLOW_FXSCALER", "scale of flow about x, 1/1000, applied in the log"),
    ("FLOW_FYSCALER", "scale of flow about y, 1/1000, applied in the log"),
    ("FLOW_ORIENT_YAW", "how the flow sensor is mounted, 1/100 deg, applied in the log"),
    ("FLOW_TYPE", "kind of flow sensor, 0 none"),
    ("GPS1_DELAY_MS", "delay of the first receiver that ArduPilot assumes, ms; Holdover measures it"),
    ("GPS2_DELAY_MS", "delay of the second receiver that ArduPilot assumes, ms; Holdover measures it"),
    ("GPS_DELAY_MS", "delay of the first receiver that ArduPilot assumes, ms; Holdover measures it"),
    ("GPS_DELAY_MS2", "delay of the second receiver that ArduPilot assumes, ms; Holdover measures it"),
    ("INS_ACCEL_FILTER", "corner of the filter that accelerometers have passed before they are logged, Hz"),
    ("INS_GYRO_FILTER", "corner of the filter that gyros have passed before they are logged, Hz"),
    (
        "INS_LOG_BAT_OPT",
        "what batches of fast samples hold: 0 what the filter is fed with; bit 1 what it lets through",
    ),
    ("LOG_BITMASK", "what ArduPilot logs: with IMU_FAST (bit 18) the IMU at the rate of the main loop"),
    ("RNGFND1_MAX", "farthest that the first rangefinder measures, m"),
    ("RNGFND1_MAX_CM", "farthest that the first rangefinder measures, cm"),
    ("RNGFND1_MIN", "nearest that the first rangefinder measures, m"),
    ("RNGFND1_MIN_CM", "nearest that the first rangefinder measures, cm"),
    ("SDLOG_PROFILE", "what PX4 logs: optical flow at its full rate takes bit 5 (sensor comparison) or 8"),
    ("SENS_BOARD_ROT", "how the board is mounted; the log's IMU is turned already"),
    ("SENS_FLOW_ROT", "how the flow sensor is mounted, 45 deg each; applied to sensor_optical_flow"),
    ("SENS_FLOW_SCALE", "scale of flow; applied to sensor_optical_flow"),
];

/// Values by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    values: BTreeMap<&'static str, f64>,
}

impl Parameters {
    /// Keeps a parameter if it is wanted, in place of what it was before.
    pub(super) fn set(&mut self, name: &str, value: f64) {
        if let Some((name, _)) = WANTED.iter().find(|(wanted, _)| *wanted == name) {
            self.values.insert(name, value);
        }
    }

    /// A value.
    pub fn get(&self, name: &str) -> Option<f64> {
        self.values.get(name).copied()
    }

    /// Name, value, and what it says.
    pub fn all(&self) -> impl Iterator<Item = (&'static str, f64, &'static str)> + '_ {
        WANTED.iter().filter_map(|(name, what)| Some((*name, self.get(name)?, *what)))
    }
}
