//! `[vehicle]`: the autopilot that is followed.

use crate::config::key::section;

section! {
    /// The autopilot to follow.
    "vehicle" struct VehicleKeys {
        /// System id of the autopilot to follow; 0 follows the first autopilot that is heard.
        system_id: u8 = 0 in 0.0 ..= 255.0 unit "";
        /// How the autopilot wants to be told: "auto" takes it from its heartbeat.
        profile: String = "auto" of "auto" | "ardupilot" | "px4";
    }
}
