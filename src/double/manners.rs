//! What real autopilots do on a link that no specification says: each is a switch, on by default where it was seen.

use strum::{Display, EnumIter, EnumString, IntoEnumIterator};

use crate::wire::session::identity::AutopilotKind;

/// One manner. The names are those of the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, EnumIter, EnumString, Display)]
#[strum(serialize_all = "kebab-case", parse_err_ty = String, parse_err_fn = unknown_manner)]
pub enum Manner {
    /// More than 0.8 of SCHED_LOOP_RATE is DENIED, with a STATUSTEXT (ArduPilot 4.7: 200 Hz of a plane's 50).
    RateLimit,
    /// A message that it does not have is DENIED with a STATUSTEXT each time (ArduPilot 4.7: 106), or FAILED (PX4).
    NoSuchMessage,
    /// OPTICAL_FLOW comes at the stream's rate, the same reading up to five times, each time with a new stamp (ArduPilot 4.7).
    RepeatedFlow,
    /// GPS_RAW_INT comes at the stream's rate, a fix twice, with its stamp (ArduPilot 4.7).
    RepeatedGnss,
    /// GPS_RAW_INT without a stamp, as while the receiver tells no UTC (PX4 main of March 2026).
    ZeroGnssStamp,
    /// HIGHRES_IMU's magnetic field is a million times too large (ArduPilot 4.7-dev of October 2025).
    FieldTimesMillion,
    /// TIMESYNC is asked at 10 Hz; 500 quick answers make it believe the companion's stamps (PX4).
    AsksTimesync,
    /// TIMESYNC questions are answered (both).
    AnswersTimesync,
    /// OPTICAL_FLOW_RAD of a companion is sent out again as the autopilot's own (PX4).
    EchoesFlow,
    /// A ground station sets all streams to 4 Hz half a minute after boot, and every two minutes after (seen with both).
    StationRates,
}

fn unknown_manner(name: &str) -> String {
    let all: Vec<String> = Manner::iter().map(|m| m.to_string()).collect();
    format!("\"{name}\" is no manner; there are {}", all.join(", "))
}

impl Manner {
    /// Whether this autopilot was seen to do it always.
    fn is_usual(self, kind: AutopilotKind) -> bool {
        let ardupilot = kind == AutopilotKind::ArduPilot;
        match self {
            Self::RateLimit | Self::RepeatedFlow | Self::RepeatedGnss | Self::FieldTimesMillion => ardupilot,
            Self::ZeroGnssStamp | Self::AsksTimesync | Self::EchoesFlow => !ardupilot,
            Self::NoSuchMessage | Self::AnswersTimesync => true,
            Self::StationRates => false,
        }
    }
}

/// Which manners a double has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Manners(Vec<Manner>);

impl Manners {
    /// Those that the autopilot was seen with.
    pub fn usual(kind: AutopilotKind) -> Self {
        Self(Manner::iter().filter(|m| m.is_usual(kind)).collect())
    }

    /// With one more.
    pub fn with(mut self, manner: Manner) -> Self {
        if !self.has(manner) {
            self.0.push(manner);
        }
        self
    }

    /// Without one.
    pub fn without(mut self, manner: Manner) -> Self {
        self.0.retain(|m| *m != manner);
        self
    }

    /// Whether it has this one.
    pub fn has(&self, manner: Manner) -> bool {
        self.0.contains(&manner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn manners_are_named_and_switched() {
        let px4 = Manners::usual(AutopilotKind::Px4);
        let manner: Manner = "zero-gnss-stamp".parse().unwrap();
        assert!(px4.has(manner) && !px4.clone().without(manner).has(manner));
        assert!(!Manners::usual(AutopilotKind::ArduPilot).has(manner));
        assert!(px4.with(Manner::StationRates).has(Manner::StationRates));
        assert!("zero".parse::<Manner>().unwrap_err().contains("repeated-flow"));
    }
}
