//! Proof of fusion: what the autopilot makes of what it is sent, and why not where it makes nothing of it.
//!
//! An acknowledged command and a stream that leaves are no proof. *Received* is what the autopilot says of its external navigation (SYS_STATUS of
//! ArduPilot); *fused* is an estimator that stands on us, whose test ratio is below 1, and whose own position is where ours is.

use std::fmt;

use crate::navigator::solution::Mode;
use crate::outbound::Departure;
use crate::outbound::handover::StandsOn;
use crate::time::{Companion, Span, Stamp};

use super::identity::AutopilotKind;

/// PX4 drops what is older when it arrives (EKF2_DELAY_MAX's default), s.
pub const PX4_OLDEST_S: f64 = 0.2;
/// What is seen is so when it has been so for this long.
const SETTLED: Span = Span::from_millis(1500);
/// A position that is apart is so when it has been for this long: filters converge.
const APART: Span = Span::from_millis(4000);
/// The autopilot's word on its external navigation holds for this long.
const WORD_HOLDS: Span = Span::from_millis(5000);
/// At this test ratio a measurement lies at its gate.
const GATE: f64 = 1.0;

/// What becomes of what is sent.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Fusion {
    /// Nothing is sent.
    NotSent,
    /// It is sent, and nothing tells more.
    Sent,
    /// The autopilot receives it, and stands on something else.
    Received,
    /// PX4 fuses GNSS, and learns how ours differs from it.
    Beside,
    /// The autopilot stands on it, and is where it says.
    Fused,
    /// It is of no use to the autopilot.
    Refused(Refused),
}

/// Why what is sent is of no use.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Refused {
    /// External navigation is not set up (ArduPilot: VISO_TYPE).
    NotSetUp,
    /// Nothing comes to it.
    NotReceived,
    /// It is too old when it comes; by that, s.
    TooOld(f64),
    /// The autopilot's gate does not let it pass; the test ratio.
    Gated(f64),
    /// Nothing aids the autopilot's position in the outage.
    NotAided,
    /// The autopilot stands on it, and is somewhere else.
    Apart(Departure),
}

impl Fusion {
    /// Whether it is another state, and not the same with other numbers.
    fn differs(&self, other: &Self) -> bool {
        std::mem::discriminant(self) != std::mem::discriminant(other)
            || match (self, other) {
                (Self::Refused(a), Self::Refused(b)) => {
                    std::mem::discriminant(a) != std::mem::discriminant(b)
                }
                _ => false,
            }
    }

    /// What to look at, for the log.
    pub fn advice(&self) -> Option<&'static str> {
        let Self::Refused(why) = self else { return None };
        Some(match why {
            Refused::NotSetUp => "set VISO_TYPE 1 and restart the autopilot",
            Refused::NotReceived => {
                "is the link open in both directions, and is this component's ODOMETRY forwarded?"
            }
            Refused::TooOld(_) => "raise EKF2_DELAY_MAX above the age, or shorten the link",
            Refused::Gated(_) => "the frames disagree, or the delay (VISO_DELAY_MS, EKF2_EV_DELAY) is wrong",
            Refused::NotAided => {
                "ArduPilot: is the source set with external navigation in force? PX4: EKF2_EV_CTRL 7, EKF2_EV_QMIN"
            }
            Refused::Apart(_) => {
                "the autopilot weighs its own prediction more: fly by its position, or by hand"
            }
        })
    }
}

/// 40 characters at most: it is told to the pilot.
impl fmt::Display for Fusion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotSent => f.write_str("nothing is sent"),
            Self::Sent => f.write_str("sent, fusion not shown"),
            Self::Received => f.write_str("autopilot receives our position"),
            Self::Beside => f.write_str("PX4 holds our position beside GNSS"),
            Self::Fused => f.write_str("autopilot flies on our position"),
            Self::Refused(Refused::NotSetUp) => f.write_str("not used: VISO_TYPE is not set"),
            Self::Refused(Refused::NotReceived) => f.write_str("not used: the autopilot receives none"),
            Self::Refused(Refused::TooOld(s)) => write!(f, "not used: {:.0} ms old when it comes", 1e3 * s),
            Self::Refused(Refused::Gated(ratio)) => write!(f, "not used: test ratio {ratio:.1}"),
            Self::Refused(Refused::NotAided) => f.write_str("not used: autopilot has no position"),
            Self::Refused(Refused::Apart(d)) => {
                write!(f, "autopilot {:.0} m from ours, allowed {:.0}", d.horizontal_m, d.allowed_m)
            }
        }
    }
}

/// What fusion is judged by.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct FusionInputs {
    /// Something is sent.
    pub sends: bool,
    /// The navigator's mode.
    pub mode: Mode,
    /// What the autopilot's position stands on.
    pub standing: StandsOn,
    /// Its horizontal position's test ratio.
    pub test_ratio: Option<f64>,
    /// Age of a message when it comes to the autopilot, s, where the clocks are synchronised.
    pub age_s: Option<f64>,
    /// How far its position is from what it was sent.
    pub departure: Option<Departure>,
}

/// Watches what becomes of what is sent.
#[derive(Clone, Debug)]
pub struct FusionWatch {
    kind: AutopilotKind,
    /// (set up, messages come) by the autopilot's word, and when.
    word: Option<(Stamp<Companion>, bool, bool)>,
    shown: Fusion,
    seen: Option<(Stamp<Companion>, Fusion)>,
}

impl FusionWatch {
    /// Nothing is sent yet.
    pub fn new(kind: AutopilotKind) -> Self {
        Self { kind, word: None, shown: Fusion::NotSent, seen: None }
    }

    /// The autopilot says whether its external navigation is set up, and whether messages come.
    pub fn says(&mut self, at: Stamp<Companion>, present: bool, healthy: bool) {
        self.word = Some((at, present, healthy));
    }

    /// Whether the autopilot says that what is sent comes to it.
    pub fn receives(&self, now: Stamp<Companion>) -> bool {
        self.word(now) == Some((true, true))
    }

    fn word(&self, now: Stamp<Companion>) -> Option<(bool, bool)> {
        let (at, present, healthy) = self.word?;
        (now - at <= WORD_HOLDS).then_some((present, healthy))
    }

    /// What becomes of what is sent, as it was last told.
    pub fn fusion(&self) -> Fusion {
        self.shown
    }

    /// Looks at the time and what is known. What has changed for good is to be told.
    pub fn poll(&mut self, now: Stamp<Companion>, inputs: &FusionInputs) -> Option<Fusion> {
        let judged = self.judge(now, inputs);
        let since = match self.seen {
            Some((since, seen)) if !seen.differs(&judged) => since,
            _ => now,
        };
        self.seen = Some((since, judged));
        let patience = if matches!(judged, Fusion::Refused(Refused::Apart(_))) { APART } else { SETTLED };
        if now - since < patience {
            return None;
        }
        let differs = self.shown.differs(&judged);
        self.shown = judged;
        differs.then_some(judged)
    }

    fn judge(&self, now: Stamp<Companion>, i: &FusionInputs) -> Fusion {
        if !i.sends {
            return Fusion::NotSent;
        }
        if let Some(why) = self.refused(now, i) {
            return Fusion::Refused(why);
        }
        let word = self.word(now);
        match i.standing {
            StandsOn::Ours if i.departure.is_some() => Fusion::Fused,
            StandsOn::Gnss if self.kind == AutopilotKind::Px4 => Fusion::Beside,
            _ if word == Some((true, true)) => Fusion::Received,
            _ => Fusion::Sent,
        }
    }

    fn refused(&self, now: Stamp<Companion>, i: &FusionInputs) -> Option<Refused> {
        if self.kind == AutopilotKind::Px4 {
            if let Some(age_s) = i.age_s.filter(|&age| age > PX4_OLDEST_S) {
                return Some(Refused::TooOld(age_s));
            }
        } else {
            match self.word(now) {
                Some((false, _)) => return Some(Refused::NotSetUp),
                Some((true, false)) => return Some(Refused::NotReceived),
                _ => {}
            }
        }
        let outage = matches!(i.mode, Mode::Holdover | Mode::Rejoining);
        match i.standing {
            StandsOn::Nothing if outage => Some(Refused::NotAided),
            StandsOn::Ours => match (i.test_ratio, i.departure) {
                (_, Some(d)) if d.horizontal_m > d.allowed_m => Some(Refused::Apart(d)),
                (Some(ratio), _) if ratio > GATE => Some(Refused::Gated(ratio)),
                _ => None,
            },
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::AutopilotTime;

    const INPUTS: FusionInputs = FusionInputs {
        sends: true,
        mode: Mode::Aided,
        standing: StandsOn::Gnss,
        test_ratio: Some(0.1),
        age_s: None,
        departure: None,
    };

    fn at(ms: i64) -> Stamp<Companion> {
        Stamp::from_micros(ms * 1000)
    }

    fn apart(horizontal_m: f64) -> Option<Departure> {
        Some(Departure { time: AutopilotTime::from_micros(0), horizontal_m, allowed_m: 7.0 })
    }

    /// What is told within ten seconds of this, every 50 ms.
    fn told(watch: &mut FusionWatch, from_ms: i64, inputs: &FusionInputs) -> Vec<Fusion> {
        (from_ms..from_ms + 10_000).step_by(50).filter_map(|ms| watch.poll(at(ms), inputs)).collect()
    }

    #[test]
    fn a_flight_on_ardupilot_is_told_step_by_step() {
        let mut watch = FusionWatch::new(AutopilotKind::ArduPilot);
        assert_eq!(told(&mut watch, 0, &FusionInputs { sends: false, ..INPUTS }), []);
        assert_eq!(told(&mut watch, 10_000, &INPUTS), [Fusion::Sent]);
        watch.says(at(25_000), true, true);
        assert!(watch.receives(at(26_000)) && !watch.receives(at(31_000)));
        assert_eq!(told(&mut watch, 20_000, &INPUTS), [Fusion::Received]);
        let ours =
            FusionInputs { mode: Mode::Holdover, standing: StandsOn::Ours, departure: apart(0.3), ..INPUTS };
        assert_eq!(told(&mut watch, 30_000, &ours), [Fusion::Fused]);
        let away = FusionInputs { departure: apart(43.0), ..ours };
        let refused = told(&mut watch, 40_000, &away);
        assert_eq!(refused.len(), 1, "once, though the numbers change");
        assert_eq!(refused[0].to_string(), "autopilot 43 m from ours, allowed 7");
        assert_eq!(told(&mut watch, 50_000, &FusionInputs { departure: apart(44.0), ..ours }), []);
        assert_eq!(told(&mut watch, 60_000, &ours), [Fusion::Fused]);
        assert_eq!(
            told(&mut watch, 70_000, &FusionInputs { standing: StandsOn::Nothing, ..ours }),
            [Fusion::Refused(Refused::NotAided)]
        );
    }

    #[test]
    fn an_ardupilot_that_is_not_set_up_or_does_not_hear_says_why() {
        for (present, why) in [(false, Refused::NotSetUp), (true, Refused::NotReceived)] {
            let mut watch = FusionWatch::new(AutopilotKind::ArduPilot);
            watch.says(at(5000), present, false);
            assert_eq!(told(&mut watch, 0, &INPUTS), [Fusion::Refused(why)]);
            assert!(watch.fusion().advice().is_some());
        }
    }

    #[test]
    fn px4_drops_what_is_old_and_it_is_told() {
        let mut watch = FusionWatch::new(AutopilotKind::Px4);
        assert_eq!(told(&mut watch, 0, &FusionInputs { age_s: Some(0.1), ..INPUTS }), [Fusion::Beside]);
        let late = told(&mut watch, 10_000, &FusionInputs { age_s: Some(0.24), ..INPUTS });
        assert_eq!(late, [Fusion::Refused(Refused::TooOld(0.24))]);
        assert_eq!(late[0].to_string(), "not used: 240 ms old when it comes");
    }

    #[test]
    fn a_moment_is_not_told() {
        let mut watch = FusionWatch::new(AutopilotKind::Px4);
        told(&mut watch, 0, &INPUTS);
        let moment = FusionInputs { standing: StandsOn::Nothing, mode: Mode::Holdover, ..INPUTS };
        for ms in (10_000..20_000).step_by(50) {
            let inputs = if ms % 2000 < 1000 { &moment } else { &INPUTS };
            assert_eq!(watch.poll(at(ms), inputs), None, "{ms}");
        }
    }

    #[test]
    fn a_gate_that_stays_shut_is_told() {
        let mut watch = FusionWatch::new(AutopilotKind::ArduPilot);
        let ours = FusionInputs { standing: StandsOn::Ours, departure: apart(3.0), ..INPUTS };
        let shut = told(&mut watch, 0, &FusionInputs { test_ratio: Some(1.84), ..ours });
        assert_eq!(shut, [Fusion::Refused(Refused::Gated(1.84))]);
    }

    #[test]
    fn every_state_fits_into_a_word_to_the_pilot() {
        let departure = Departure { horizontal_m: 12_345.0, allowed_m: 123.0, ..apart(0.0).unwrap() };
        let refused = [
            Refused::NotSetUp,
            Refused::NotReceived,
            Refused::TooOld(12.345),
            Refused::Gated(123.4),
            Refused::NotAided,
            Refused::Apart(departure),
        ];
        let others = [Fusion::NotSent, Fusion::Sent, Fusion::Received, Fusion::Beside, Fusion::Fused];
        for state in others.into_iter().chain(refused.map(Fusion::Refused)) {
            assert!(state.to_string().len() <= 40, "{state}");
        }
    }
}
