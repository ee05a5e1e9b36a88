//! The hand-over as one conversation: what the autopilot stands on, what becomes of what is sent, and, with ArduPilot, the source switch.

use mavlink::dialects::ardupilotmega::{COMMAND_ACK_DATA, MavMessage};

use crate::geo::Geodetic;
use crate::navigator::solution::Mode;
use crate::outbound::Departure;
use crate::outbound::handover::StandsOn;
use crate::time::{Companion, Stamp};
use crate::wire::frame::Frame;

use super::Address;
use super::estimator_report::EstimatorReport;
use super::fusion::{Fusion, FusionInputs, FusionWatch};
use super::identity::{AutopilotKind, Vehicle};
use super::source_switch::{SourceSwitch, SwitchInputs, SwitchNews, SwitchSettings};
use super::standing_watch::StandingWatch;

/// What the hand-over is decided by.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Situation {
    /// The navigator's mode.
    pub mode: Mode,
    /// Quality of what is sent, 1 to 100; `None` while nothing is.
    pub quality: Option<i8>,
    /// Age of a message when it comes to the autopilot, s, where the clocks are synchronised.
    pub age_s: Option<f64>,
    /// How far the autopilot's position is from what it was sent.
    pub departure: Option<Departure>,
    /// Where the vehicle began without GNSS, where that is configured.
    pub place: Option<Geodetic>,
}

impl Situation {
    /// Of somebody who only listens: nothing is sent, and nothing decided.
    pub const LISTENING: Self =
        Self { mode: Mode::Aligning, quality: None, age_s: None, departure: None, place: None };
}

/// What is to be told.
#[derive(Clone, PartialEq, Debug)]
pub enum HandOverNews {
    /// What becomes of what is sent has changed.
    Fusion(Fusion),
    /// The source switch.
    Switch(SwitchNews),
    /// The autopilot's own words on external navigation.
    Autopilot(String),
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub struct HandOver {
    standing: StandingWatch,
    fusion: FusionWatch,
    /// ArduPilot's.
    switch: Option<SourceSwitch>,
    departure: Option<Departure>,
    /// What the autopilot said last, and is not told again.
    said: Option<String>,
    news: Vec<HandOverNews>,
}

impl HandOver {
    /// Begins with `vehicle`'s autopilot, spoken to as `us`.
    pub fn new(settings: SwitchSettings, us: Address, vehicle: &Vehicle) -> Self {
        let switch = SourceSwitch::new(settings, us, vehicle.address());
        Self {
            standing: StandingWatch::new(vehicle.autopilot, settings.sets),
            fusion: FusionWatch::new(vehicle.autopilot),
            switch: (vehicle.autopilot == AutopilotKind::ArduPilot).then_some(switch),
            departure: None,
            said: None,
            news: Vec::new(),
        }
    }

    /// The autopilot rebooted.
    pub fn restart(&mut self) {
        self.standing.restart();
        if let Some(switch) = &mut self.switch {
            switch.restart();
        }
        self.said = None;
    }

    /// What the autopilot's position stands on.
    pub fn standing(&self, now: Stamp<Companion>) -> StandsOn {
        self.standing.standing(now)
    }

    /// What becomes of what is sent, as it was last told.
    pub fn fusion(&self) -> Fusion {
        self.fusion.fusion()
    }

    /// A position message was sent.
    pub fn sent(&mut self, at: Stamp<Companion>) {
        self.standing.sent(at);
    }

    /// The autopilot's receiver has a fix.
    pub fn fix(&mut self, at: Stamp<Companion>) {
        self.standing.fix(at);
    }

    /// Takes note of a frame of the autopilot's.
    pub fn hear(&mut self, at: Stamp<Companion>, frame: &Frame<'_>) {
        let Some(report) = EstimatorReport::read(frame) else { return };
        self.standing.hear(at, &report);
        match report {
            EstimatorReport::ExternalNavigation { present, healthy } => {
                self.fusion.says(at, present, healthy);
            }
            EstimatorReport::Said(text) if self.said.as_ref() != Some(&text) => {
                self.news.push(HandOverNews::Autopilot(text.clone()));
                self.said = Some(text);
            }
            _ => {}
        }
    }

    /// The autopilot's answer to a command.
    pub fn acknowledge(&mut self, ack: &COMMAND_ACK_DATA) {
        if let Some(set) = self.switch.as_mut().and_then(|s| s.acknowledge(ack)) {
            self.standing.commanded(set);
            let apart_m = self.departure.map(|d| d.horizontal_m);
            self.news.push(HandOverNews::Switch(SwitchNews::Switched(set, apart_m)));
        }
    }

    /// What is due: a command, and what is to be told.
    pub fn poll(&mut self, now: Stamp<Companion>, s: &Situation) -> (Option<MavMessage>, Vec<HandOverNews>) {
        self.departure = s.departure;
        let standing = self.standing.standing(now);
        let mut command = None;
        if let Some(switch) = &mut self.switch {
            let inputs = SwitchInputs {
                mode: s.mode,
                quality: s.quality,
                received: self.fusion.receives(now),
                standing,
                set: self.standing.source_set(),
                departure: s.departure,
            };
            let polled = switch.poll(now, &inputs);
            command = polled.command;
            self.news.extend(polled.news.map(HandOverNews::Switch));
        }
        let fusion = self.fusion.poll(
            now,
            &FusionInputs {
                sends: s.quality.is_some(),
                mode: s.mode,
                standing,
                test_ratio: self.standing.test_ratio(now),
                age_s: s.age_s,
                departure: s.departure,
            },
        );
        self.news.extend(fusion.map(HandOverNews::Fusion));
        (command, std::mem::take(&mut self.news))
    }
}
