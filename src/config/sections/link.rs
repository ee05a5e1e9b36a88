//! `[link]` and `[tuning.link]`: where the autopilot is, and how patient its links are.

use crate::config::LinkSettings;
use crate::config::key::section;

section! {
    /// The links to the autopilot.
    "link" struct LinkKeys {
        /// Where the autopilot is: udpin:HOST:PORT, udpout:HOST:PORT, tcpin:HOST:PORT, tcpout:HOST:PORT, serial:DEVICE:BAUD; several are allowed.
        endpoints: Vec<String> = ["udpin:127.0.0.1:14550"];
        /// Where sensors of their own are, a camera's computer or a rangefinder that speaks MAVLink: in the same forms. Optical flow, distances and landmarks are taken there from any system; nothing else is.
        sensor_endpoints: Vec<String> = [];
        /// A UDP peer that is silent for this long may be replaced by another autopilot.
        peer_timeout_s: f64 = 5.0 in 0.5 ..= 600.0;
    }
}

section! {
    /// Reconnecting and queues.
    "tuning.link" struct LinkTuning {
        /// Pause before the first attempt to reconnect.
        reconnect_min_ms: u64 = 100 in 10.0 ..= 60_000.0 was "link.reconnect_min_ms";
        /// The longest pause between attempts to reconnect.
        reconnect_max_ms: u64 = 5000 in 10.0 ..= 600_000.0 was "link.reconnect_max_ms";
        /// Frames that may wait between a link and the navigator; more are dropped and counted.
        queue_frames: usize = 1024 in 16.0 ..= 65_536.0 unit "" was "link.queue_frames";
        /// A message that waited this long for a slow link is dropped: late is worse than never.
        stale_output_ms: u64 = 200 in 20.0 ..= 10_000.0 was "link.stale_output_ms";
    }
}

impl LinkKeys {
    pub(super) fn settings(&self, tuning: &LinkTuning) -> LinkSettings {
        LinkSettings {
            peer_timeout_s: self.peer_timeout_s,
            reconnect_min_ms: tuning.reconnect_min_ms,
            reconnect_max_ms: tuning.reconnect_max_ms,
            queue_frames: tuning.queue_frames,
            stale_output_ms: tuning.stale_output_ms,
        }
    }
}
