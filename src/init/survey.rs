//! Who speaks on a link, and what of.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use serde::Serialize;

use crate::preflight::conversation::sensor_unit;
use crate::preflight::recent_rate::RecentRate;
use crate::sample::{Input, Sample, SampleKind};
use crate::time::{Companion, Stamp};
use crate::wire::frame::Frame;
use crate::wire::messages::from_any_component;
use crate::wire::session::heartbeat_fields::HeartbeatFields;
use crate::wire::session::identity::AutopilotKind;

/// Speakers that are told apart: whoever invents more is not followed.
const MOST_SPEAKERS: usize = 64;
/// The component that Holdover speaks as.
const HOLDOVER: u8 = 197;

/// Somebody who speaks on the link.
#[derive(Clone, Debug, Default)]
pub struct LinkSpeaker {
    /// Its newest heartbeat, where it sends some.
    pub beat: Option<HeartbeatFields>,
    /// Frames of its.
    pub frames: u64,
    /// Whether it tells of flow, distance or landmarks.
    pub measures: bool,
}

/// A sensor that was heard of.
#[derive(Clone, Debug)]
pub struct HeardSensor {
    /// What it told last.
    pub newest: Sample,
    /// In which message: its number.
    pub message: u32,
    /// System and component that sent it.
    pub from: (u8, u8),
    /// The best quality that it told, 0 to 1, where it tells one.
    pub best_quality: Option<f64>,
    rate: RecentRate,
}

impl HeardSensor {
    /// How often it is heard, Hz.
    pub fn rate_hz(&self, now: Stamp<Companion>) -> f64 {
        self.rate.hz(now)
    }
}

/// See the module's documentation.
#[derive(Clone, Debug, Default)]
pub struct LinkSurvey {
    /// By system and component.
    pub speakers: BTreeMap<(u8, u8), LinkSpeaker>,
    /// By kind and number.
    pub sensors: BTreeMap<(SampleKind, u8), HeardSensor>,
    /// Frames whose checksum was right.
    pub frames: u64,
    /// Those of them that are signed.
    pub signed: u64,
    /// Those of them that are MAVLink 1.
    pub mavlink1: u64,
    /// When the newest came.
    pub newest: Option<Stamp<Companion>>,
}

/// A speaker, as it is told of.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct SpeakerWord {
    /// Its system.
    pub system: u8,
    /// Its component.
    pub component: u8,
    /// What it says that it is.
    pub what: String,
}

impl fmt::Display for SpeakerWord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} (system {}", self.what, self.system)?;
        if self.component == 1 { f.write_str(")") } else { write!(f, ", component {})", self.component) }
    }
}

impl LinkSurvey {
    /// Takes note of a frame whose checksum was tested, that came at `at` and told `inputs` of the vehicle's sensors.
    pub fn hear(&mut self, frame: &Frame<'_>, at: Stamp<Companion>, inputs: &[Input]) {
        self.frames += 1;
        self.signed += u64::from(frame.is_signed());
        self.mavlink1 += u64::from(frame.is_mavlink1());
        self.newest = Some(at);
        let from = (frame.system().0, frame.component().0);
        if self.speakers.len() < MOST_SPEAKERS || self.speakers.contains_key(&from) {
            let speaker = self.speakers.entry(from).or_default();
            speaker.frames += 1;
            speaker.beat = HeartbeatFields::read(frame).or(speaker.beat);
            speaker.measures |= from_any_component(frame.message_id());
        }
        for input in inputs {
            if let Input::Sample(sample) = input {
                self.sample(sample, frame.message_id(), from, at);
            }
        }
    }

    fn sample(&mut self, sample: &Sample, message: u32, from: (u8, u8), at: Stamp<Companion>) {
        let Some(unit) = sensor_unit(sample) else { return };
        let quality = match sample {
            Sample::Flow(flow) => Some(flow.quality),
            _ => None,
        };
        let first = || HeardSensor {
            newest: *sample,
            message,
            from,
            best_quality: None,
            rate: RecentRate::default(),
        };
        let heard = self.sensors.entry((sample.kind(), unit)).or_insert_with(first);
        (heard.newest, heard.message, heard.from) = (*sample, message, from);
        heard.best_quality = match (heard.best_quality, quality) {
            (Some(best), Some(now)) => Some(best.max(now)),
            (best, now) => best.or(now),
        };
        heard.rate.note(at);
    }

    /// The systems that say that they have an autopilot.
    pub fn vehicles(&self) -> BTreeSet<u8> {
        self.autopilots().map(|(system, _)| system).filter(|s| *s != 0).collect()
    }

    /// System and component of whatever says that it is an autopilot.
    pub fn autopilots(&self) -> impl Iterator<Item = (u8, u8)> + '_ {
        let flies = |s: &LinkSpeaker| s.beat.is_some_and(|b| b.is_autopilot());
        self.speakers.iter().filter(move |(_, s)| flies(s)).map(|(address, _)| *address)
    }

    /// Whether somebody tells of flow, distance or landmarks, and nobody is an autopilot: a sensor of its own.
    pub fn only_measures(&self) -> bool {
        self.vehicles().is_empty() && self.speakers.values().any(|s| s.measures)
    }

    /// Who speaks: whoever sends heartbeats or measurements.
    pub fn words(&self) -> Vec<SpeakerWord> {
        let told = self.speakers.iter().filter(|(_, s)| s.beat.is_some() || s.measures);
        told.map(|(&(system, component), s)| SpeakerWord {
            system,
            component,
            what: what_it_is(component, s),
        })
        .collect()
    }
}

/// A `MAV_TYPE` of a vehicle in a word.
pub fn vehicle_word(vehicle_type: u8) -> &'static str {
    match vehicle_type {
        1 => "fixed wing",
        2 => "quadrotor",
        3 => "coaxial helicopter",
        4 => "helicopter",
        7 | 8 => "balloon",
        10 => "rover",
        11 => "boat",
        12 => "submarine",
        13 => "hexarotor",
        14 => "octorotor",
        15 => "tricopter",
        19..=25 => "VTOL",
        29 => "dodecarotor",
        35 => "decarotor",
        _ => "vehicle",
    }
}

fn what_it_is(component: u8, speaker: &LinkSpeaker) -> String {
    let Some(beat) = speaker.beat else { return "a sensor".to_owned() };
    if beat.is_autopilot() {
        let kind = AutopilotKind::from_wire(beat.autopilot);
        return format!("{kind} {}", vehicle_word(beat.vehicle_type));
    }
    match (component, beat.vehicle_type) {
        (HOLDOVER, _) => "visual odometry, or another Holdover",
        (_, 6) => "ground station",
        (100..=105, _) | (_, 30) => "camera",
        (_, 26) => "gimbal",
        (_, 27 | 36) => "traffic receiver",
        (_, 34) => "remote identification",
        (_, 33) => "parachute",
        (_, 18) | (191..=194, _) => "companion computer",
        _ if speaker.measures => "a sensor",
        _ => "a component",
    }
    .to_owned()
}
