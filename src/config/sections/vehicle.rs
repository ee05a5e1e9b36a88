//! `[vehicle]`: the autopilot that is followed.

use crate::config::key::section;

section! {
    /// The autopilot to follow.
    "vehicle" struct VehicleKeys {
        /// System id of the autopilot to follow; 0 follows the first that proves to be one: by its heartbeats' rhythm, and by its sensors where there are several.
        system_id: u8 = 0 in 0.0 ..= 255.0 unit "";
        /// Component id of the autopilot; 0 takes 1 (MAV_COMP_ID_AUTOPILOT1), or another that sends an IMU's messages by itself.
        component_id: u8 = 0 in 0.0 ..= 255.0 unit "";
        /// How the autopilot wants to be told: "auto" takes it from its heartbeat.
        profile: String = "auto" of "auto" | "ardupilot" | "px4";
        /// Speed over ground that the vehicle cannot exceed, whatever the wind: what is estimated beyond it is somebody's fault, and Lost. 0 takes it from the kind of vehicle in the heartbeat.
        max_speed_mps: f64 = 0.0 in 0.0 ..= 1000.0;
    }
}
