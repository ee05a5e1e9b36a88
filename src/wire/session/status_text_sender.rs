//! What Holdover says to the pilot by STATUSTEXT: a few words at a time, for a radio link has little room.

use mavlink::dialects::ardupilotmega::{MavMessage, MavSeverity};

use super::status_text::StatusTextWriter;
use crate::time::{Companion, Stamp};

/// How much a text matters (`MAV_SEVERITY`, of which Holdover uses these).
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Severity {
    /// Good to know.
    Info,
    /// Normal, but to be noticed.
    Notice,
    /// Navigation is worse than it was.
    Warning,
    /// Navigation is in danger.
    Critical,
}

impl Severity {
    fn on_the_wire(self) -> MavSeverity {
        match self {
            Severity::Info => MavSeverity::MAV_SEVERITY_INFO,
            Severity::Notice => MavSeverity::MAV_SEVERITY_NOTICE,
            Severity::Warning => MavSeverity::MAV_SEVERITY_WARNING,
            Severity::Critical => MavSeverity::MAV_SEVERITY_CRITICAL,
        }
    }
}

/// Texts that may be sent in a row.
const BURST: f64 = 8.0;
/// Texts a second afterwards.
const REFILL_HZ: f64 = 0.5;

/// Makes STATUSTEXT, throttled.
#[derive(Clone, Debug)]
pub struct StatusTextSender {
    writer: StatusTextWriter,
    enabled: bool,
    allowance: f64,
    refilled: Option<Stamp<Companion>>,
    withheld: u64,
}

impl StatusTextSender {
    /// A sender that has not spoken yet; one that is not `enabled` never will.
    pub fn new(enabled: bool) -> Self {
        Self { writer: StatusTextWriter::new(), enabled, allowance: BURST, refilled: None, withheld: 0 }
    }

    /// Texts that were not sent because there were too many.
    pub fn withheld(&self) -> u64 {
        self.withheld
    }

    /// The messages to send for `text`. What is critical is never withheld.
    pub fn say(&mut self, now: Stamp<Companion>, severity: Severity, text: &str) -> Vec<MavMessage> {
        if !self.enabled {
            return Vec::new();
        }
        let elapsed = self.refilled.replace(now).map_or(0.0, |then| now.seconds_since(then).max(0.0));
        self.allowance = (self.allowance + elapsed * REFILL_HZ).min(BURST);
        if self.allowance < 1.0 && severity < Severity::Critical {
            self.withheld += 1;
            return Vec::new();
        }
        self.allowance = (self.allowance - 1.0).max(0.0);
        self.writer.write(severity.on_the_wire(), &format!("Holdover: {text}"))
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
        let mut sender = StatusTextSender::new(true);
        let said = (0..100).filter(|_| !sender.say(at(0), Severity::Warning, "x").is_empty()).count();
        assert_eq!((said, sender.withheld()), (8, 92));
        assert!(!sender.say(at(0), Severity::Critical, "lost").is_empty());
        assert_eq!(sender.say(at(3), Severity::Info, "x").len(), 1);
    }

    #[test]
    fn a_disabled_sender_is_silent() {
        assert!(StatusTextSender::new(false).say(at(0), Severity::Critical, "x").is_empty());
    }

    #[test]
    fn the_text_names_who_speaks() {
        let mut sender = StatusTextSender::new(true);
        let texts = sender.say(at(0), Severity::Warning, "Aided -> Holdover: GNSS masked");
        let Some(MavMessage::STATUSTEXT(text)) = texts.first() else { panic!("nothing said") };
        assert_eq!(text.text.to_str().unwrap(), "Holdover: Aided -> Holdover: GNSS masked");
    }
}
