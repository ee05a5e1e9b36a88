//! What the autopilot is asked to send: the streams, another IMU message where HIGHRES_IMU never comes, and the origin.

use mavlink::MessageData;
use mavlink::dialects::ardupilotmega::{GPS_GLOBAL_ORIGIN_DATA, HIGHRES_IMU_DATA, MavMessage};

use super::identity::{AutopilotKind, Vehicle};
use super::streams::{GaveUp, MessageStreams, StreamReport, StreamVerdict, StreamsConfig, WantedStream};
use super::{Address, request_message};
use crate::time::{Companion, Span, Stamp};
use crate::wire::messages::{MessageUse, Rate, TABLE, name_of};

/// Message rates to ask for, Hz; 0 does not ask.
#[derive(Clone, Copy, Debug)]
pub struct StreamSettings {
    /// Ask at all.
    pub request: bool,
    /// IMU.
    pub imu_hz: f64,
    /// GNSS.
    pub gnss_hz: f64,
    /// Barometer.
    pub pressure_hz: f64,
    /// Optical flow.
    pub flow_hz: f64,
    /// Rangefinder.
    pub range_hz: f64,
    /// The autopilot's local position.
    pub local_position_hz: f64,
    /// What the autopilot tells of its estimator.
    pub estimator_hz: f64,
    /// Time and origin.
    pub slow_hz: f64,
    /// VFR_HUD, which holds the airspeed, Hz.
    pub airspeed_hz: f64,
    /// How often a message that does not come is asked for again.
    pub retries: u8,
}

impl StreamSettings {
    fn of(&self, rate: Rate) -> f64 {
        match rate {
            Rate::Imu | Rate::FallbackImu => self.imu_hz,
            Rate::Gnss => self.gnss_hz,
            Rate::Pressure => self.pressure_hz,
            Rate::Flow => self.flow_hz,
            Rate::Range => self.range_hz,
            Rate::Airspeed => self.airspeed_hz,
            Rate::LocalPosition => self.local_position_hz,
            Rate::Estimator => self.estimator_hz,
            Rate::Slow => self.slow_hz,
        }
    }

    /// The streams of the table that an autopilot of this kind has, and whose rate is one that `wanted` takes.
    fn streams(&self, kind: AutopilotKind, wanted: impl Fn(Rate) -> bool) -> Vec<WantedStream> {
        let asked = |row: &MessageUse| row.asked.filter(|&r| wanted(r)).map(|r| (row.id, r));
        TABLE
            .iter()
            .filter(|row| row.only.is_none_or(|only| only == kind))
            .filter_map(asked)
            .map(|(message_id, rate)| WantedStream { message_id, rate_hz: self.of(rate) })
            .collect()
    }
}

/// Requests for HIGHRES_IMU in vain after which an older message is asked for.
const HIGHRES_TRIES: u8 = 2;
/// The first ArduPilot that has HIGHRES_IMU.
const HIGHRES_SINCE: (u8, u8) = (4, 6);
/// First pause between two requests for the origin; grows by itself each time.
const ORIGIN_PAUSE: Span = Span::from_millis(2000);

/// Asks one autopilot for its streams.
#[derive(Clone, Debug)]
pub struct StreamRequests {
    settings: StreamSettings,
    autopilot: Address,
    kind: AutopilotKind,
    streams: MessageStreams,
    told: Vec<u32>,
    origin_known: bool,
    origin_asked: u8,
    origin_due: Option<Stamp<Companion>>,
    fallen_back: bool,
}

/// A stream that is no longer asked for, as text for the log.
pub type Refusal = String;

impl StreamRequests {
    /// Will ask `vehicle`'s autopilot, from the first [`StreamRequests::poll`] on.
    pub fn new(settings: StreamSettings, vehicle: &Vehicle) -> Self {
        let config =
            StreamsConfig { attempts: settings.retries.saturating_add(1), ..StreamsConfig::default() };
        let mut wanted = Vec::new();
        if settings.request {
            wanted = settings.streams(vehicle.autopilot, |rate| rate != Rate::FallbackImu);
        }
        Self {
            settings,
            autopilot: vehicle.address(),
            kind: vehicle.autopilot,
            streams: MessageStreams::new(config, vehicle.address(), &wanted),
            told: Vec::new(),
            origin_known: false,
            origin_asked: 0,
            origin_due: None,
            fallen_back: false,
        }
    }

    /// For the autopilot's acknowledgements and rates.
    pub fn streams(&mut self) -> &mut MessageStreams {
        &mut self.streams
    }

    /// The origin came.
    pub fn origin_heard(&mut self) {
        self.origin_known = true;
    }

    /// The link began anew, or another client's requests may stand: everything is asked for again but what was refused.
    pub fn restart(&mut self) {
        self.streams.restart();
        self.ask_for_origin();
    }

    /// The autopilot rebooted: requests and refusals are forgotten.
    pub fn reboot(&mut self) {
        self.streams.reboot();
        self.told.clear();
        self.ask_for_origin();
    }

    fn ask_for_origin(&mut self) {
        self.origin_known = false;
        self.origin_asked = 0;
        self.origin_due = None;
    }

    /// The request to send now, if one is due, and what was given up.
    pub fn poll(&mut self, now: Stamp<Companion>, vehicle: &Vehicle) -> (Option<MavMessage>, Vec<Refusal>) {
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
            highres_in_vain |= id == HIGHRES_IMU_DATA::ID
                && (never || (gave_up.is_some() && report.rate_hz.unwrap_or(0.0) < 1.0));
            if let Some(text) = told_of(&report, gave_up)
                && !self.told.contains(&id)
            {
                self.told.push(id);
                refusals.push(text);
            }
        }
        if highres_in_vain && !self.fallen_back && self.kind != AutopilotKind::Px4 {
            self.fallen_back = true;
            refusals.push("no HIGHRES_IMU: asking for RAW_IMU and SCALED_IMU2".to_owned());
            for wanted in self.settings.streams(self.kind, |rate| rate == Rate::FallbackImu) {
                self.streams.want(wanted);
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
        Some(request_message(self.autopilot, GPS_GLOBAL_ORIGIN_DATA::ID))
    }
}

/// What the user is to know of a stream, and what to change; `None` while there is nothing.
fn told_of(report: &StreamReport, gave_up: Option<GaveUp>) -> Option<Refusal> {
    let id = report.wanted.message_id;
    let (name, want) = (name_of(id).unwrap_or("message"), report.wanted.rate_hz);
    match (gave_up, report.reduced) {
        (Some(GaveUp::Refused(_)), _) => {
            Some(format!("{name} ({id}): the autopilot refuses it, and is asked again after a minute"))
        }
        (Some(reason), _) => {
            let got = report.rate_hz.unwrap_or(0.0);
            Some(format!("{name} ({id}): {want:.0} Hz asked for, {got:.1} Hz come ({reason:?})"))
        }
        (None, Some((rate_hz, true))) => Some(format!(
            "{name} ({id}): the autopilot refuses {want:.0} Hz and grants {rate_hz:.0}; for more, raise SCHED_LOOP_RATE (it sends 0.8 \
             of that at most) and the SRx_ rates of this link"
        )),
        (None, _) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Settings, Sources};
    use crate::wire::frame::{ComponentId, SystemId};
    use crate::wire::session::identity::FirmwareVersion;
    use mavlink::dialects::ardupilotmega as apm;

    const HIGHRES_IMU: u32 = HIGHRES_IMU_DATA::ID;
    const RAW_IMU: u32 = apm::RAW_IMU_DATA::ID;
    const ORIGIN: u32 = GPS_GLOBAL_ORIGIN_DATA::ID;
    const SET_MESSAGE_INTERVAL: u32 = 511;
    const REQUEST_MESSAGE: u32 = 512;

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
        let mut requests = StreamRequests::new(Settings::load(&Sources::default()).unwrap().streams, vehicle);
        let mut out = Vec::new();
        for ms in (0..seconds * 1000).step_by(5) {
            let now = Stamp::from_micros(ms * 1000);
            for &id in heard {
                requests.streams().hear(now, id);
            }
            if let (Some(MavMessage::COMMAND_LONG(c)), _) = requests.poll(now, vehicle) {
                out.push((c.command as u32, c.param1 as u32));
            }
        }
        out
    }

    #[test]
    fn the_imu_is_asked_for_first_and_the_origin_by_request() {
        let asked = asked(&vehicle(AutopilotKind::Px4, 0), 90, &[]);
        assert_eq!(asked[0], (REQUEST_MESSAGE, ORIGIN));
        let first = asked.iter().find(|a| a.0 == SET_MESSAGE_INTERVAL);
        assert_eq!(first, Some(&(SET_MESSAGE_INTERVAL, HIGHRES_IMU)));
        for id in [24, 29, 100, 106, 132, 32, 74, 1, 2, 49] {
            assert!(asked.contains(&(SET_MESSAGE_INTERVAL, id)), "{id}");
        }
        assert!(!asked.contains(&(SET_MESSAGE_INTERVAL, RAW_IMU)), "RAW_IMU of PX4 is in counts");
    }

    #[test]
    fn an_old_ardupilot_is_asked_for_raw_imu_at_once_and_a_silent_one_soon() {
        let raw = (SET_MESSAGE_INTERVAL, RAW_IMU);
        let old = vehicle(AutopilotKind::ArduPilot, 0x0405_07FF);
        assert!(asked(&old, 90, &[]).contains(&raw));
        let silent = vehicle(AutopilotKind::ArduPilot, 0x0407_00FF);
        assert!(asked(&silent, 90, &[]).contains(&raw));
        assert!(!asked(&silent, 60, &[HIGHRES_IMU]).contains(&raw));
    }

    #[test]
    fn each_autopilot_is_asked_for_its_own_word_on_its_estimator() {
        let (ekf, estimator) = (apm::EKF_STATUS_REPORT_DATA::ID, apm::ESTIMATOR_STATUS_DATA::ID);
        let of = |kind| asked(&vehicle(kind, 0), 90, &[HIGHRES_IMU]);
        let (ardupilot, px4) = (of(AutopilotKind::ArduPilot), of(AutopilotKind::Px4));
        let has = |asked: &[(u32, u32)], id| asked.contains(&(SET_MESSAGE_INTERVAL, id));
        assert!(has(&ardupilot, ekf) && !has(&ardupilot, estimator));
        assert!(has(&px4, estimator) && !has(&px4, ekf));
    }

    #[test]
    fn requests_have_a_limit() {
        let asked = asked(&vehicle(AutopilotKind::ArduPilot, 0), 1200, &[HIGHRES_IMU]);
        let count = |of: (u32, u32)| asked.iter().filter(|&&a| a == of).count();
        let gnss = count((SET_MESSAGE_INTERVAL, apm::GPS_RAW_INT_DATA::ID));
        assert_eq!((count((REQUEST_MESSAGE, ORIGIN)), gnss), (6, 6));
        assert_eq!(count((SET_MESSAGE_INTERVAL, HIGHRES_IMU)), 1);
    }
}
