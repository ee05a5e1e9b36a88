//! `[outbound]` and `[log]`: what the autopilot is told, and what the operator.

use crate::config::key::section;
use crate::config::{LogSettings, LogTo};
use crate::outbound::{Carriage, Coasting, Covariance, Publish};

section! {
    /// What is sent to the autopilot.
    "outbound" struct OutboundKeys {
        /// When to send: as the autopilot needs it (from the alignment on), from the loss until it is seen back on GNSS, always, or never.
        publish: Publish = "auto" of "auto" | "holdover" | "always" | "never";
        /// ODOMETRY, or VISION_POSITION_ESTIMATE.
        message: Carriage = "odometry" of "odometry" | "vision_position_estimate";
        /// How often.
        rate_hz: f64 = 30.0 in 4.0 ..= 50.0;
        /// For how long a lost navigator says so before it is silent.
        farewell_s: f64 = 0.25 in 0.0 ..= 60.0;
        /// Whether a position that nothing but inertia carries is sent in an outage: never, briefly (over gaps of a few seconds in what else carries), or always. An autopilot that is told nothing lands nearer to where it was.
        coasting: Coasting = "briefly" of "never" | "briefly" | "always";
        /// The covariance that is sent: "correlated" is inflated for errors that last and has short-term noise of the position, as a filter needs it that takes every message for independent; "absolute" is the navigator's own, for other readers.
        covariance: Covariance = "correlated" of "correlated" | "absolute";
        /// Tell mode changes and the hand-over by STATUSTEXT.
        statustext: bool = true;
    }
}

section! {
    /// The daemon's log.
    "log" struct LogKeys {
        /// How much to say.
        level: String = "info" of "error" | "warn" | "info" | "debug" | "trace";
        /// Where to: "auto" is the journal where systemd has connected standard error with it, and standard error elsewhere.
        to: LogTo = "auto" of "auto" | "stderr" | "journal";
        /// How often a line of one kind is told; what comes more often is counted, and the count is told when the minute is over. 0 is no limit.
        lines_per_event_per_min: u32 = 60 in 0.0 ..= 1_000_000.0 unit "1/min";
    }
}

impl LogKeys {
    pub(super) fn settings(&self) -> LogSettings {
        LogSettings {
            level: self.level.clone(),
            to: self.to,
            lines_per_event_per_min: self.lines_per_event_per_min,
        }
    }
}
