//! `[link]` and `[tuning.link]`: where the autopilot is, and how patient its links are.

use crate::config::LinkSettings;
use crate::config::key::section;
use crate::wire::link::LinkLimits;

section! {
    /// The links to the autopilot.
    "link" struct LinkKeys {
        /// Where the autopilot is: udpin:HOST:PORT, udpout:HOST:PORT, tcpin:HOST:PORT, tcpout:HOST:PORT, serial:DEVICE:BAUD; several are allowed.
        endpoints: Vec<String> = ["udpin:127.0.0.1:14550"];
        /// Where sensors of their own are, a camera's computer or a rangefinder that speaks MAVLink: in the same forms. Optical flow, distances and landmarks are taken there from any system; nothing else is.
        sensor_endpoints: Vec<String> = [];
        /// A UDP peer, or a TCP client, that is silent for this long, or sends no IMU messages, may be replaced by another autopilot.
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
        /// A message that waited this long for a slow link is dropped, and so is a position that stands on an IMU sample which arrived this long ago, or this much later than the link explains: late is worse than never.
        stale_output_ms: u64 = 200 in 20.0 ..= 10_000.0 was "link.stale_output_ms";
        /// An autopilot's heartbeats must come from a UDP address for this long before it is answered; with IMU messages for a quarter of it.
        peer_confirm_ms: u64 = 2000 in 20.0 ..= 60_000.0;
        /// Frames of one sender that are passed on in a second; more are dropped and counted.
        max_frames_hz: f64 = 10_000.0 in 100.0 ..= 1_000_000.0;
        /// Bytes that are searched for frames in a second where no frame stands at once; streams (TCP, serial) are read no faster.
        max_search_kb_per_s: f64 = 4000.0 in 100.0 ..= 1_000_000.0 unit "kB/s";
        /// Datagrams of strangers that are taken note of in a second while the pinned UDP peer is heard; the kernel drops the others.
        max_strangers_hz: f64 = 200.0 in 10.0 ..= 100_000.0;
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
            peer_confirm_ms: tuning.peer_confirm_ms,
            limits: LinkLimits {
                frames_per_s: tuning.max_frames_hz,
                search_bytes_per_s: 1e3 * tuning.max_search_kb_per_s,
                strangers_per_s: tuning.max_strangers_hz,
            },
        }
    }
}
