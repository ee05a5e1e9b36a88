//! `[handover]` and `[tuning.handover]`: how an ArduPilot is switched over to our position, and back.

use crate::config::key::section;
use crate::wire::session::source_switch::{SwitchSettings, SwitchedBy};
use crate::wire::session::standing_watch::SourceSets;

section! {
    /// The hand-over of an ArduPilot between its source sets (EK3_SRC1_*, EK3_SRC2_*). PX4 changes sources itself.
    "handover" struct HandoverKeys {
        /// Who switches the EKF's source set: Holdover (MAV_CMD_SET_EKF_SOURCE_SET), or the pilot, who is told when.
        switched_by: SwitchedBy = "holdover" of "holdover" | "pilot";
    }
}

section! {
    /// Between which source sets an ArduPilot is switched, and when.
    "tuning.handover" struct HandoverTuning {
        /// The source set that navigates by GNSS.
        gnss_set: u8 = 1 in 1.0 ..= 3.0 unit "";
        /// The source set that navigates by what Holdover sends.
        external_set: u8 = 2 in 1.0 ..= 3.0 unit "";
        /// The least quality of the output, of 100, at which the autopilot is switched over.
        min_quality: u8 = 10 in 1.0 ..= 100.0 unit "";
        /// For how long GNSS has to be good again before the autopilot is switched back.
        return_after_s: f64 = 3.0 in 0.0 ..= 600.0;
        /// How near the autopilot's position has to be to ours then; one that does not come near is switched back 30 s later.
        return_within_m: f64 = 3.0 in 0.1 ..= 100.0;
    }
}

impl HandoverKeys {
    pub(super) fn settings(
        &self,
        tuning: &HandoverTuning,
        complain: &mut impl FnMut(&str, String),
    ) -> SwitchSettings {
        if tuning.gnss_set == tuning.external_set {
            complain("tuning.handover.external_set", "is the same as tuning.handover.gnss_set".into());
        }
        SwitchSettings {
            by: self.switched_by,
            sets: SourceSets { gnss: tuning.gnss_set, external: tuning.external_set },
            min_quality: i8::try_from(tuning.min_quality).unwrap_or(100),
            return_after_s: tuning.return_after_s,
            return_within_m: tuning.return_within_m,
        }
    }
}
