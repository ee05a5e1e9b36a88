//! `[outbound]` and `[log]`: what the autopilot is told, and what the operator.

use crate::config::key::section;
use crate::outbound::{Carriage, Publish};

section! {
    /// What is sent to the autopilot.
    "outbound" struct OutboundKeys {
        /// When to send: in holdover, always, or never.
        publish: Publish = "holdover" of "holdover" | "always" | "never";
        /// ODOMETRY, or VISION_POSITION_ESTIMATE.
        message: Carriage = "odometry" of "odometry" | "vision_position_estimate";
        /// How often.
        rate_hz: f64 = 30.0 in 4.0 ..= 50.0;
        /// For how long a lost navigator says so before it is silent.
        farewell_s: f64 = 1.0 in 0.0 ..= 60.0;
        /// Tell mode changes by STATUSTEXT.
        statustext: bool = true;
    }
}

section! {
    /// The daemon's log, on standard error.
    "log" struct LogKeys {
        /// How much to say.
        level: String = "info" of "error" | "warn" | "info" | "debug" | "trace";
    }
}
