//! What an autopilot tells of its own estimator: EKF_STATUS_REPORT of ArduPilot, ESTIMATOR_STATUS of PX4, SYS_STATUS and STATUSTEXT of both.
//!
//! The flags have the same names and other meanings. ArduPilot (NavEKF3 `updateFilterStatus`): POS_HORIZ_ABS while absolute aiding is active and has not timed
//! out, whatever aids; CONST_POS_MODE while nothing does; which source set is in force is not told but by STATUSTEXT, when the RC switch changes it. PX4
//! (EKF2 `get_ekf_soln_status`): PRED_POS_HORIZ_ABS while GNSS position is fused, PRED_POS_HORIZ_REL while anything horizontal is (GNSS, external
//! vision, flow), POS_HORIZ_ABS while the position is valid; CONST_POS_MODE is set on the ground, too.

use mavlink::MessageData;
use mavlink::dialects::ardupilotmega as apm;
use mavlink::dialects::ardupilotmega::{
    EkfStatusFlags, EstimatorStatusFlags, MavMessage, MavSysStatusSensor,
};

use crate::wire::frame::Frame;

/// What aids the horizontal position.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum HorizontalAiding {
    /// Something that tells the position; which, is not said.
    Absolute,
    /// GNSS.
    Gnss,
    /// Something that is not GNSS.
    Other,
    /// Nothing does.
    Nothing,
}

/// One piece of news of the estimator.
#[derive(Clone, PartialEq, Debug)]
pub enum EstimatorReport {
    /// Its flags and how well measurements fit.
    State {
        /// What aids the horizontal position.
        aiding: HorizontalAiding,
        /// Horizontal position's test ratio: above 1 the innovation lies outside of the gate, and the measurement is not used.
        test_ratio: f64,
    },
    /// Whether its external navigation is set up, and whether messages come to it.
    ExternalNavigation {
        /// It is set up (ArduPilot: VISO_TYPE).
        present: bool,
        /// Messages came within the last 300 ms.
        healthy: bool,
    },
    /// The pilot's switch has chosen this source set (1 to 3).
    SourceSet(u8),
    /// HorizontalAiding began: with GNSS.
    StartedOnGnss,
    /// HorizontalAiding began: with external navigation.
    StartedOnExternal,
    /// Something about external navigation that is for people.
    Said(String),
}

impl EstimatorReport {
    /// What `frame` of the autopilot tells of its estimator.
    pub fn read(frame: &Frame<'_>) -> Option<Self> {
        let id = frame.message_id();
        let known = [
            apm::EKF_STATUS_REPORT_DATA::ID,
            apm::ESTIMATOR_STATUS_DATA::ID,
            apm::SYS_STATUS_DATA::ID,
            apm::STATUSTEXT_DATA::ID,
        ];
        if !known.contains(&id) {
            return None;
        }
        match frame.parse().ok()? {
            MavMessage::EKF_STATUS_REPORT(m) => Some(Self::of_ardupilot(&m)),
            MavMessage::ESTIMATOR_STATUS(m) => Some(Self::of_px4(&m)),
            MavMessage::SYS_STATUS(m) => {
                let sensor = MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_VISION_POSITION;
                Some(Self::ExternalNavigation {
                    present: m.onboard_control_sensors_present.contains(sensor),
                    healthy: m.onboard_control_sensors_health.contains(sensor),
                })
            }
            MavMessage::STATUSTEXT(m) => Self::of_text(m.text.to_str().ok()?),
            _ => None,
        }
    }

    fn of_ardupilot(m: &apm::EKF_STATUS_REPORT_DATA) -> Self {
        let absolute = m.flags.contains(EkfStatusFlags::EKF_POS_HORIZ_ABS)
            && !m.flags.contains(EkfStatusFlags::EKF_CONST_POS_MODE);
        let aiding = if absolute { HorizontalAiding::Absolute } else { HorizontalAiding::Nothing };
        Self::State { aiding, test_ratio: f64::from(m.pos_horiz_variance) }
    }

    fn of_px4(m: &apm::ESTIMATOR_STATUS_DATA) -> Self {
        let aiding = if m.flags.contains(EstimatorStatusFlags::ESTIMATOR_PRED_POS_HORIZ_ABS) {
            HorizontalAiding::Gnss
        } else if m.flags.contains(EstimatorStatusFlags::ESTIMATOR_PRED_POS_HORIZ_REL) {
            HorizontalAiding::Other
        } else {
            HorizontalAiding::Nothing
        };
        Self::State { aiding, test_ratio: f64::from(m.pos_horiz_ratio) }
    }

    /// ArduPilot's words (RC_Channel, NavEKF3, AP_Arming).
    fn of_text(text: &str) -> Option<Self> {
        if let Some(set) = text.strip_prefix("Using EKF Source Set ") {
            let set = set.trim().parse().ok()?;
            return (1..=3).contains(&set).then_some(Self::SourceSet(set));
        }
        if text.starts_with("EKF3 IMU") && text.ends_with("is using GPS") {
            return Some(Self::StartedOnGnss);
        }
        if text.starts_with("EKF3 IMU") && text.contains("is using external nav") {
            return Some(Self::StartedOnExternal);
        }
        let told = ["VisOdom", "stopped aiding", "EKF variance", "EKF Failsafe"];
        told.iter().any(|words| text.contains(words)).then(|| Self::Said(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ardupilot(flags: u16) -> EstimatorReport {
        let flags = EkfStatusFlags::from_bits_retain(flags);
        EstimatorReport::of_ardupilot(&apm::EKF_STATUS_REPORT_DATA { flags, ..Default::default() })
    }

    fn px4(flags: u16) -> EstimatorReport {
        let flags = EstimatorStatusFlags::from_bits_retain(flags);
        EstimatorReport::of_px4(&apm::ESTIMATOR_STATUS_DATA { flags, ..Default::default() })
    }

    fn state(aiding: HorizontalAiding) -> EstimatorReport {
        EstimatorReport::State { aiding, test_ratio: 0.0 }
    }

    #[test]
    fn the_flags_of_each_autopilot_are_read_as_it_means_them() {
        // What SITL sends: flying on GNSS, and holding a constant position.
        assert_eq!(ardupilot(831), state(HorizontalAiding::Absolute));
        assert_eq!(ardupilot(0b1010_0111), state(HorizontalAiding::Nothing));
        assert_eq!(ardupilot(16 | 128), state(HorizontalAiding::Nothing));
        assert_eq!(px4(16 | 256 | 512), state(HorizontalAiding::Gnss));
        assert_eq!(px4(16 | 256), state(HorizontalAiding::Other));
        assert_eq!(
            px4(16 | 8),
            state(HorizontalAiding::Nothing),
            "valid for a few seconds yet, and aided by nothing"
        );
    }

    #[test]
    fn ardupilots_words_are_understood() {
        let read = |text: &str| EstimatorReport::of_text(text);
        assert_eq!(read("Using EKF Source Set 2"), Some(EstimatorReport::SourceSet(2)));
        assert_eq!(read("Using EKF Source Set 9"), None);
        assert_eq!(read("EKF3 IMU1 is using GPS"), Some(EstimatorReport::StartedOnGnss));
        assert_eq!(read("EKF3 IMU0 is using external nav data"), Some(EstimatorReport::StartedOnExternal));
        let said = EstimatorReport::Said("PreArm: VisOdom: not healthy".into());
        assert_eq!(read("PreArm: VisOdom: not healthy"), Some(said));
        assert_eq!(read("PreArm: Compass not calibrated"), None);
    }
}
