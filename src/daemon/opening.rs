//! Which links are opened, and how.

use std::time::Duration;

use crate::config::Settings;
use crate::wire::endpoint::Endpoint;
use crate::wire::link::LinkConfig;

/// The endpoints in the order of their links: the autopilot's, then those of sensors.
pub fn endpoints(settings: &Settings) -> Vec<Endpoint> {
    settings.endpoints.iter().chain(&settings.sensor_endpoints).cloned().collect()
}

/// Settings of the links, as configured.
pub fn link_config(settings: &Settings) -> LinkConfig {
    let l = &settings.link;
    LinkConfig {
        inbound_capacity: l.queue_frames,
        // Far fewer frames go out than come in.
        outbound_capacity: (l.queue_frames / 16).max(16),
        max_queue_age: Duration::from_millis(l.stale_output_ms),
        limits: l.limits,
        peer_confirm: Duration::from_millis(l.peer_confirm_ms),
        peer_silence: Duration::try_from_secs_f64(l.peer_timeout_s).unwrap_or(Duration::from_secs(5)),
        backoff_first: Duration::from_millis(l.reconnect_min_ms),
        backoff_cap: Duration::from_millis(l.reconnect_max_ms),
        system: settings.system,
        component: settings.component,
        sensors_from: settings.endpoints.len(),
        ..LinkConfig::default()
    }
}
