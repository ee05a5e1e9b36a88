//! What the autopilot is asked to send: the streams, another IMU message where HIGHRES_IMU never comes, and the origin.

use mavlink::dialects::ardupilotmega::MavMessage;

use crate::config::StreamSettings;
use crate::time::{Companion, Span, Stamp};
use crate::wire::protocol::identity::{AutopilotKind, Vehicle};
use crate::wire::protocol::streams::{StreamVerdict, Streams, StreamsConfig, WantedStream};
use crate::wire::protocol::{Address, request_message};

const HIGHRES_IMU: u32 = 105;
const RAW_IMU: u32 = 27;
const SCALED_IMU2: u32 = 116;
const GPS_GLOBAL_ORIGIN: u32 = 49;

/// Requests for HIGHRES_IMU in vain after which an older message is asked for.
const HIGHRES_TRIES: u8 = 2;
/// The first ArduPilot that has HIGHRES_IMU.
const HIGHRES_SINCE: (u8, u8) = (4, 6);
/// First pause between two requests for the origin; grows by itself each time.
const ORIGIN_PAUSE: Span = Span::from_millis(2000);

/// Asks one autopilot.
#[derive(Clone, Debug)]
pub(super) struct Wishes {
    settings: StreamSettings,
    autopilot: Address,
    kind: AutopilotKind,
    streams: Streams,
    told: Vec<u32>,
    origin_known: bool,
    origin_asked: u8,
    origin_due: Option<Stamp<Companion>>,
    fallen_back: bool,
}

/// A stream that is no longer asked for, as text for the log.
pub(super) type Refusal = String;

impl Wishes {
    pub(super) fn new(settings: StreamSettings, vehicle: &Vehicle) -> Self {
        let config =
            StreamsConfig { attempts: settings.retries.saturating_add(1), ..StreamsConfig::default() };
        let wanted = if settings.request { wanted(&settings) } else { Vec::new() };
        Self {
            settings,
            autopilot: vehicle.address(),
            kind: vehicle.autopilot,
            streams: Streams::new(config, vehicle.address(), &wanted),
            told: Vec::new(),
            origin_known: false,
            origin_asked: 0,
            origin_due: None,
            fallen_back: false,
        }
    }

    /// For the autopilot's acknowledgements and rates.
    pub(super) fn streams(&mut self) -> &mut Streams {
        &mut self.streams
    }

    /// The origin came.
    pub(super) fn origin_heard(&mut self) {
        self.origin_known = true;
    }

    /// The autopilot or the link began anew: requests are forgotten by then.
    pub(super) fn restart(&mut self) {
        self.streams.restart();
        self.told.clear();
        self.origin_known = false;
        self.origin_asked = 0;
        self.origin_due = None;
    }

    /// The request to send now, if one is due, and what was given up.
    pub(super) fn poll(
        &mut self,
        now: Stamp<Companion>,
        vehicle: &Vehicle,
    ) -> (Option<MavMessage>, Vec<Refusal>) {
        if !self.settings.request {
            return (None, Vec::new());
        }
        let mut refusals = Vec::new();
        let mut highres_in_vain = self.too_old_for_highres(vehicle);
        for report in self.streams.reports(now) {
            let id = report.wanted.message_id;
            let gave_up = match report.verdict {
                StreamVerdict::GivenUp(reason) => Some(reason),
                StreamVerdict::Pending | StreamVerdict::Met => None,
            };
            let never = report.rate_hz == Some(0.0) && report.asked >= HIGHRES_TRIES;
            highres_in_vain |=
                id == HIGHRES_IMU && (never || (gave_up.is_some() && report.rate_hz.unwrap_or(0.0) < 1.0));
            if let Some(reason) = gave_up
                && !self.told.contains(&id)
            {
                self.told.push(id);
                let (want, got) = (report.wanted.rate_hz, report.rate_hz.unwrap_or(0.0));
                refusals.push(format!("message {id}: {want:.0} Hz asked for, {got:.1} Hz come ({reason:?})"));
            }
        }
        if highres_in_vain && !self.fallen_back && self.kind != AutopilotKind::Px4 {
            self.fallen_back = true;
            refusals.push("no HIGHRES_IMU: asking for RAW_IMU and SCALED_IMU2".to_owned());
            for message_id in [RAW_IMU, SCALED_IMU2] {
                self.streams.want(WantedStream { message_id, rate_hz: self.settings.imu_hz });
            }
        }
        (self.origin(now).or_else(|| self.streams.poll(now)), refusals)
    }

    fn too_old_for_highres(&self, vehicle: &Vehicle) -> bool {
        self.kind == AutopilotKind::ArduPilot
            && vehicle.version.is_some_and(|v| (v.major, v.minor) < HIGHRES_SINCE)
    }

    fn origin(&mut self, now: Stamp<Companion>) -> Option<MavMessage> {
        let spent = self.origin_asked > self.settings.retries;
        if self.origin_known
            || spent
            || self.settings.slow_hz <= 0.0
            || self.origin_due.is_some_and(|due| now < due)
        {
            return None;
        }
        self.origin_asked += 1;
        self.origin_due = Some(now + Span::from_micros(ORIGIN_PAUSE.micros() * i64::from(self.origin_asked)));
        Some(request_message(self.autopilot, GPS_GLOBAL_ORIGIN))
    }
}

fn wanted(s: &StreamSettings) -> Vec<WantedStream> {
    let ids = [
        (HIGHRES_IMU, s.imu_hz),
        (24, s.gnss_hz),
        (124, s.gnss_hz),
        (29, s.pressure_hz),
        (100, s.flow_hz),
        (106, s.flow_hz),
        (132, s.range_hz),
        (32, s.local_position_hz),
        (74, s.airspeed_hz),
        (1, s.slow_hz),
        (2, s.slow_hz),
        (GPS_GLOBAL_ORIGIN, s.slow_hz),
    ];
    ids.map(|(message_id, rate_hz)| WantedStream { message_id, rate_hz }).to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Settings, Sources};
    use crate::wire::frame::{ComponentId, SystemId};
    use crate::wire::protocol::identity::FirmwareVersion;

    fn vehicle(autopilot: AutopilotKind, packed: u32) -> Vehicle {
        Vehicle {
            system: SystemId(1),
            component: ComponentId(1),
            autopilot,
            vehicle_type: 2,
            armed: false,
            version: FirmwareVersion::from_packed(packed),
        }
    }

    /// (command, message id) of everything asked for in `seconds`, with nothing coming but `heard`.
    fn asked(vehicle: &Vehicle, seconds: i64, heard: &[u32]) -> Vec<(u32, u32)> {
        let mut wishes = Wishes::new(Settings::load(&Sources::default()).unwrap().streams, vehicle);
        let mut out = Vec::new();
        for ms in (0..seconds * 1000).step_by(5) {
            let now = Stamp::from_micros(ms * 1000);
            for &id in heard {
                wishes.streams().hear(now, id);
            }
            if let (Some(MavMessage::COMMAND_LONG(c)), _) = wishes.poll(now, vehicle) {
                out.push((c.command as u32, c.param1 as u32));
            }
        }
        out
    }

    #[test]
    fn the_imu_is_asked_for_first_and_the_origin_by_request() {
        let asked = asked(&vehicle(AutopilotKind::Px4, 0), 90, &[]);
        assert_eq!(asked[0], (512, 49));
        assert_eq!(asked.iter().find(|a| a.0 == 511), Some(&(511, 105)));
        for id in [24, 29, 100, 106, 132, 32, 74, 1, 2, 49] {
            assert!(asked.contains(&(511, id)), "{id}");
        }
        assert!(!asked.contains(&(511, RAW_IMU)), "RAW_IMU of PX4 is in counts");
    }

    #[test]
    fn an_old_ardupilot_is_asked_for_raw_imu_at_once_and_a_silent_one_soon() {
        let old = vehicle(AutopilotKind::ArduPilot, 0x0405_07FF);
        assert!(asked(&old, 90, &[]).contains(&(511, RAW_IMU)));
        let silent = vehicle(AutopilotKind::ArduPilot, 0x0407_00FF);
        assert!(asked(&silent, 90, &[]).contains(&(511, RAW_IMU)));
        assert!(!asked(&silent, 60, &[HIGHRES_IMU]).contains(&(511, RAW_IMU)));
    }

    #[test]
    fn requests_have_a_limit() {
        let asked = asked(&vehicle(AutopilotKind::ArduPilot, 0), 1200, &[HIGHRES_IMU]);
        let count = |of: (u32, u32)| asked.iter().filter(|&&a| a == of).count();
        assert_eq!((count((512, 49)), count((511, 24)), count((511, 105))), (6, 6, 1));
    }
}
