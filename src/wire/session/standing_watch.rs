//! What the autopilot's own position stands on: GNSS, our position, or nothing.
//!
//! PX4 tells it. ArduPilot tells that something aids, and by STATUSTEXT which source set the pilot's switch has chosen; of a set that a
//! ground station commands it tells nobody else. The rest is concluded: what aids while nothing was sent is GNSS, and what aids long after its
//! receiver had the last fix is what we send.

use crate::outbound::handover::StandsOn;
use crate::time::{Companion, Span, Stamp};

use super::estimator_report::{EstimatorReport, HorizontalAiding};
use super::identity::AutopilotKind;

/// A report older than this tells nothing.
const REPORT_HOLDS: Span = Span::from_millis(3000);
/// ArduPilot gives up aiding 15 s after what it stands on has ended.
const AIDING_ENDS: Span = Span::from_millis(17_000);

/// The source sets of an ArduPilot, by number (1 to 3).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SourceSets {
    /// Navigates by GNSS.
    pub gnss: u8,
    /// Navigates by what we send.
    pub external: u8,
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub struct StandingWatch {
    kind: AutopilotKind,
    sets: SourceSets,
    /// The source set in force, as far as it is known.
    set: Option<u8>,
    report: Option<(Stamp<Companion>, HorizontalAiding, f64)>,
    /// When its first report came: before that somebody (we, before a restart) may have sent.
    begun: Option<Stamp<Companion>>,
    /// Since when we send without a pause, and the last message.
    sent: Option<(Stamp<Companion>, Stamp<Companion>)>,
    fix: Option<Stamp<Companion>>,
}

impl StandingWatch {
    /// Nothing was heard of this autopilot yet.
    pub fn new(kind: AutopilotKind, sets: SourceSets) -> Self {
        Self { kind, sets, set: None, report: None, begun: None, sent: None, fix: None }
    }

    /// The autopilot rebooted: nothing is known any more.
    pub fn restart(&mut self) {
        *self = Self { sent: self.sent, ..Self::new(self.kind, self.sets) };
    }

    /// Takes note of a report.
    pub fn hear(&mut self, at: Stamp<Companion>, report: &EstimatorReport) {
        match *report {
            EstimatorReport::State { aiding, test_ratio } => {
                self.report = Some((at, aiding, test_ratio));
                self.begun.get_or_insert(at);
                if aiding == HorizontalAiding::Absolute {
                    self.conclude(at);
                }
            }
            EstimatorReport::SourceSet(set) => self.set = Some(set),
            EstimatorReport::StartedOnGnss => self.set = Some(self.sets.gnss),
            EstimatorReport::StartedOnExternal => self.set = Some(self.sets.external),
            EstimatorReport::ExternalNavigation { .. } | EstimatorReport::Said(_) => {}
        }
    }

    /// The autopilot has accepted our command to take this source set.
    pub fn commanded(&mut self, set: u8) {
        self.set = Some(set);
    }

    /// A position message was sent.
    pub fn sent(&mut self, at: Stamp<Companion>) {
        let since = self.sent.filter(|(_, last)| at - *last <= REPORT_HOLDS).map_or(at, |(since, _)| since);
        self.sent = Some((since, at));
    }

    /// The autopilot's receiver has a fix.
    pub fn fix(&mut self, at: Stamp<Companion>) {
        self.fix = Some(at);
    }

    /// Something aids an ArduPilot: what can it be?
    fn conclude(&mut self, now: Stamp<Companion>) {
        let long_ago = |then: Option<Stamp<Companion>>| then.is_none_or(|t| now - t > AIDING_ENDS);
        let sending = self.sent.is_some_and(|(_, last)| now - last <= REPORT_HOLDS);
        let sends_for_long = sending && long_ago(self.sent.map(|(since, _)| since));
        if long_ago(self.begun.max(self.sent.map(|(_, last)| last))) {
            self.set.get_or_insert(self.sets.gnss);
        } else if sends_for_long && long_ago(self.fix) {
            self.set = Some(self.sets.external);
        }
    }

    /// The source set in force, as far as it is known.
    pub fn source_set(&self) -> Option<u8> {
        self.set
    }

    /// The horizontal position's test ratio, as it was told last; above 1 what comes is not used.
    pub fn test_ratio(&self, now: Stamp<Companion>) -> Option<f64> {
        self.report.filter(|(at, ..)| now - *at <= REPORT_HOLDS).map(|(.., ratio)| ratio)
    }

    /// What the autopilot's position stands on.
    pub fn standing(&self, now: Stamp<Companion>) -> StandsOn {
        let Some((_, aiding, _)) = self.report.filter(|(at, ..)| now - *at <= REPORT_HOLDS) else {
            return StandsOn::Unknown;
        };
        match aiding {
            HorizontalAiding::Gnss => StandsOn::Gnss,
            HorizontalAiding::Nothing => StandsOn::Nothing,
            HorizontalAiding::Other if self.sent.is_some_and(|(_, last)| now - last <= REPORT_HOLDS) => {
                StandsOn::Ours
            }
            HorizontalAiding::Other => StandsOn::Unknown,
            HorizontalAiding::Absolute if self.set == Some(self.sets.external) => StandsOn::Ours,
            HorizontalAiding::Absolute if self.set == Some(self.sets.gnss) => StandsOn::Gnss,
            HorizontalAiding::Absolute => StandsOn::Unknown,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETS: SourceSets = SourceSets { gnss: 1, external: 2 };

    fn at(s: i64) -> Stamp<Companion> {
        Stamp::from_micros(s * 1_000_000)
    }

    fn report(aiding: HorizontalAiding) -> EstimatorReport {
        EstimatorReport::State { aiding, test_ratio: 0.1 }
    }

    fn ardupilot() -> StandingWatch {
        StandingWatch::new(AutopilotKind::ArduPilot, SETS)
    }

    #[test]
    fn what_aids_while_nothing_was_sent_is_gnss_and_stays_so_when_we_send() {
        let mut watch = ardupilot();
        assert_eq!(watch.standing(at(0)), StandsOn::Unknown);
        for s in 0..30 {
            watch.hear(at(s), &report(HorizontalAiding::Absolute));
            let expected = if s > 17 { StandsOn::Gnss } else { StandsOn::Unknown };
            assert_eq!(watch.standing(at(s)), expected, "{s}: it may stand on what was sent before");
        }
        for s in 30..60 {
            watch.sent(at(s));
            watch.fix(at(s));
            watch.hear(at(s), &report(HorizontalAiding::Absolute));
            assert_eq!(watch.standing(at(s)), StandsOn::Gnss, "{s}");
        }
        assert_eq!(watch.standing(at(63)), StandsOn::Unknown, "an old report");
    }

    #[test]
    fn aiding_that_begins_after_we_sent_may_be_either() {
        let mut watch = ardupilot();
        watch.sent(at(0));
        watch.fix(at(1));
        watch.hear(at(1), &report(HorizontalAiding::Absolute));
        assert_eq!(watch.standing(at(1)), StandsOn::Unknown);
    }

    #[test]
    fn aiding_long_after_the_last_fix_is_ours_whoever_switched() {
        let mut watch = ardupilot();
        watch.hear(at(0), &EstimatorReport::StartedOnGnss);
        for s in 1..60 {
            watch.sent(at(s));
            if s <= 20 {
                watch.fix(at(s));
            }
            watch.hear(at(s), &report(HorizontalAiding::Absolute));
            let expected = if s > 37 { StandsOn::Ours } else { StandsOn::Gnss };
            assert_eq!(watch.standing(at(s)), expected, "{s}");
        }
    }

    #[test]
    fn switches_are_known_by_the_command_and_by_the_autopilots_words() {
        let mut watch = ardupilot();
        watch.hear(at(0), &report(HorizontalAiding::Absolute));
        watch.commanded(2);
        assert_eq!(watch.standing(at(0)), StandsOn::Ours);
        watch.hear(at(0), &EstimatorReport::SourceSet(1));
        assert_eq!((watch.standing(at(0)), watch.source_set()), (StandsOn::Gnss, Some(1)));
        watch.hear(at(0), &EstimatorReport::SourceSet(3));
        assert_eq!(watch.standing(at(0)), StandsOn::Unknown, "whatever the third is");
        watch.hear(at(1), &report(HorizontalAiding::Nothing));
        assert_eq!(watch.standing(at(1)), StandsOn::Nothing);
        watch.restart();
        assert_eq!((watch.standing(at(1)), watch.source_set()), (StandsOn::Unknown, None));
    }

    #[test]
    fn px4_tells_it_itself() {
        let mut watch = StandingWatch::new(AutopilotKind::Px4, SETS);
        watch.hear(at(0), &report(HorizontalAiding::Gnss));
        assert_eq!(watch.standing(at(0)), StandsOn::Gnss);
        watch.hear(at(1), &report(HorizontalAiding::Other));
        assert_eq!(watch.standing(at(1)), StandsOn::Unknown, "its own flow: nothing was sent");
        watch.sent(at(1));
        assert_eq!(watch.standing(at(2)), StandsOn::Ours);
    }
}
