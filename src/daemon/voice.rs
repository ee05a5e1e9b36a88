//! What Holdover says to the pilot (STATUSTEXT) and to whoever reads the log. The log gets everything; the radio link a few
//! words at a time.

use mavlink::dialects::ardupilotmega::{MavMessage, MavSeverity};

use crate::navigator::event::What;
use crate::navigator::solution::{Carrier, Mode};
use crate::time::{Companion, Stamp};
use crate::wire::protocol::statustext::StatusTextWriter;

/// How much a word matters.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(super) enum Weight {
    Info,
    Notice,
    Warning,
    Critical,
}

impl Weight {
    fn severity(self) -> MavSeverity {
        match self {
            Weight::Info => MavSeverity::MAV_SEVERITY_INFO,
            Weight::Notice => MavSeverity::MAV_SEVERITY_NOTICE,
            Weight::Warning => MavSeverity::MAV_SEVERITY_WARNING,
            Weight::Critical => MavSeverity::MAV_SEVERITY_CRITICAL,
        }
    }

    /// How much an event of the navigator matters.
    pub(super) fn of(what: &What) -> Self {
        match what {
            What::Mode { to: Mode::Lost, .. } => Weight::Critical,
            What::Mode { to: Mode::Holdover, .. } => Weight::Warning,
            What::Mode { from: Mode::Aided | Mode::Holdover, to: Mode::Aligning, .. } => Weight::Warning,
            What::Mode { .. } => Weight::Notice,
            What::Reset(_)
            | What::WalkedBack(_)
            | What::FlowDistrusted(..)
            | What::HeightFault { .. }
            | What::InertialHeight(_)
            | What::HeightReset(_)
            | What::LandmarkContradicts(_)
            | What::LandmarksContradict { .. }
            | What::LandmarksApart(_) => Weight::Warning,
            What::Carried(Carrier::Inertial) => Weight::Warning,
            _ => Weight::Info,
        }
    }
}

/// Words that may be said in a row.
const BURST: f64 = 8.0;
/// Words a second afterwards.
const REFILL_HZ: f64 = 0.5;

/// Makes STATUSTEXT, throttled.
#[derive(Clone, Debug)]
pub(super) struct Voice {
    writer: StatusTextWriter,
    enabled: bool,
    allowance: f64,
    refilled: Option<Stamp<Companion>>,
    withheld: u64,
}

impl Voice {
    pub(super) fn new(enabled: bool) -> Self {
        Self { writer: StatusTextWriter::new(), enabled, allowance: BURST, refilled: None, withheld: 0 }
    }

    /// Words that were not sent because there were too many.
    pub(super) fn withheld(&self) -> u64 {
        self.withheld
    }

    /// Logs `text` and returns the messages to send. What is critical is never withheld.
    pub(super) fn say(&mut self, now: Stamp<Companion>, weight: Weight, text: &str) -> Vec<MavMessage> {
        match weight {
            Weight::Critical => tracing::error!("{text}"),
            Weight::Warning => tracing::warn!("{text}"),
            Weight::Notice | Weight::Info => tracing::info!("{text}"),
        }
        if !self.enabled {
            return Vec::new();
        }
        let elapsed = self.refilled.replace(now).map_or(0.0, |then| now.seconds_since(then).max(0.0));
        self.allowance = (self.allowance + elapsed * REFILL_HZ).min(BURST);
        if self.allowance < 1.0 && weight < Weight::Critical {
            self.withheld += 1;
            return Vec::new();
        }
        self.allowance = (self.allowance - 1.0).max(0.0);
        self.writer.write(weight.severity(), &format!("Holdover: {text}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(s: i64) -> Stamp<Companion> {
        Stamp::from_micros(s * 1_000_000)
    }

    #[test]
    fn a_flood_is_withheld_but_what_is_critical_is_said() {
        let mut voice = Voice::new(true);
        let said = (0..100).filter(|_| !voice.say(at(0), Weight::Warning, "x").is_empty()).count();
        assert_eq!((said, voice.withheld()), (8, 92));
        assert!(!voice.say(at(0), Weight::Critical, "lost").is_empty());
        assert_eq!(voice.say(at(3), Weight::Info, "x").len(), 1);
    }

    #[test]
    fn a_disabled_voice_is_silent() {
        assert!(Voice::new(false).say(at(0), Weight::Critical, "x").is_empty());
    }

    #[test]
    fn the_word_names_who_speaks() {
        let mut voice = Voice::new(true);
        let words = voice.say(at(0), Weight::Warning, "Aided -> Holdover: GNSS masked");
        let Some(MavMessage::STATUSTEXT(word)) = words.first() else { panic!("nothing said") };
        assert_eq!(word.text.to_str().unwrap(), "Holdover: Aided -> Holdover: GNSS masked");
    }
}
