//! Switching an ArduPilot's EKF source set over to our position, and back (MAV_CMD_SET_EKF_SOURCE_SET).
//!
//! ArduPilot does not change sources by itself: 15 s after GNSS is lost its EKF failsafe acts, while good ODOMETRY streams. So the command goes out
//! at the decision, is acknowledged, asked for again where no answer comes (and once more where one comes, for anybody can say "accepted"), and what the EKF makes of it is watched: an EKF that has no position on
//! the new set is switched back. After GNSS has been good for a while, and the autopilot's position is where ours is, the other set
//! is commanded. What the pilot's switch has chosen meanwhile stands.
//!
//! The command is sent to an autopilot only that says it receives us (VISO_TYPE is set up and messages come), and while our output is worth it.

use std::fmt;

use mavlink::dialects::ardupilotmega::{COMMAND_ACK_DATA, MavCmd, MavMessage, MavResult};
use serde::{Deserialize, Serialize};

use crate::navigator::solution::Mode;
use crate::outbound::Departure;
use crate::outbound::handover::StandsOn;
use crate::time::{Companion, Span, Stamp};

use super::standing_watch::SourceSets;
use super::{Address, command_long};

/// Who switches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SwitchedBy {
    /// Holdover.
    Holdover,
    /// The pilot.
    Pilot,
}

/// Settings of [`SourceSwitch`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SwitchSettings {
    /// Who switches.
    pub by: SwitchedBy,
    /// The source sets.
    pub sets: SourceSets,
    /// The least quality of our output (1 to 100) that the autopilot is switched over to.
    pub min_quality: i8,
    /// GNSS has to be good for this long before the autopilot is switched back, s.
    pub return_after_s: f64,
    /// And the autopilot's position has to be this near to ours, m.
    pub return_within_m: f64,
}

/// An answer is waited for this long.
const ANSWER: Span = Span::from_millis(700);
/// Commands in vain after which the pilot has to do it; and refusals in a row, for one may be somebody else's word.
const ATTEMPTS: u8 = 5;
const REFUSALS: u8 = 3;
/// An autopilot that has refused, or not answered, is asked again after this long.
const AGAIN: Span = Span::from_millis(60_000);
/// An EKF without a position for this long after the switch is switched back.
const NO_POSITION: Span = Span::from_millis(1000);
/// The autopilot that does not come near is switched back all the same after this long.
const NEARNESS: Span = Span::from_millis(30_000);
/// The pilot is reminded after this time: half of what is left.
const REMINDER: Span = Span::from_millis(7000);
/// The autopilot has this long to say that it receives us.
const RECEIPT: Span = Span::from_millis(2000);

/// What the switch is decided by.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct SwitchInputs {
    /// The navigator's mode.
    pub mode: Mode,
    /// Quality of what is sent, 1 to 100; `None` while nothing is.
    pub quality: Option<i8>,
    /// The autopilot says that it receives us.
    pub received: bool,
    /// What its position stands on.
    pub standing: StandsOn,
    /// Its source set, where that is known.
    pub set: Option<u8>,
    /// How far its position is from ours.
    pub departure: Option<Departure>,
}

/// What is to be told, and to the pilot in 40 characters.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum SwitchNews {
    /// The autopilot has accepted this source set; how far its position was from ours, m, where that is known.
    Switched(u8, Option<f64>),
    /// It was to be switched over to this set, and is not: the pilot has to do it.
    NotSwitched(u8, WhyNot),
    /// The EKF has no position on our set, and was switched back to this one.
    Reverted(u8),
    /// The pilot's switch has taken the set back.
    PilotSwitched(u8),
    /// The pilot has to take this set now: the autopilot will land.
    SwitchOver(u8),
    /// The same, when half of the time is over.
    SwitchSoon(u8),
    /// The pilot may take this set again: GNSS is good.
    SwitchBack(u8),
}

/// Why the autopilot is not switched over.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum WhyNot {
    /// It does not say that it receives us.
    NotReceived,
    /// It does not answer.
    NoAnswer,
    /// It refuses.
    Refused,
}

impl fmt::Display for SwitchNews {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Switched(set, None) => write!(f, "EKF source set {set}"),
            Self::Switched(set, Some(m)) => write!(f, "EKF source set {set}, {m:.1} m apart"),
            Self::NotSwitched(set, WhyNot::NotReceived) => {
                write!(f, "set {set} not taken: it receives nothing")
            }
            Self::NotSwitched(set, WhyNot::NoAnswer) => write!(f, "SWITCH EKF TO SET {set}: no answer"),
            Self::NotSwitched(set, WhyNot::Refused) => write!(f, "SWITCH EKF TO SET {set}: it refuses"),
            Self::Reverted(set) => write!(f, "EKF without position: back on set {set}"),
            Self::PilotSwitched(set) => write!(f, "the pilot took EKF source set {set}"),
            Self::SwitchOver(set) => write!(f, "SWITCH EKF TO SET {set}, or it lands in 14 s"),
            Self::SwitchSoon(set) => write!(f, "SWITCH EKF TO SET {set}, or it lands in 7 s"),
            Self::SwitchBack(set) => write!(f, "GNSS is good: switch EKF back to set {set}"),
        }
    }
}

/// What is due.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SwitchPoll {
    /// To be sent to the autopilot.
    pub command: Option<MavMessage>,
    /// To be told.
    pub news: Option<SwitchNews>,
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub struct SourceSwitch {
    settings: SwitchSettings,
    us: Address,
    autopilot: Address,
    state: SwitchState,
    /// Since when GNSS is not navigated on.
    outage: Option<Stamp<Companion>>,
    /// Since when it is again.
    good: Option<Stamp<Companion>>,
    /// Since when the EKF has no position on our set.
    no_position: Option<Stamp<Companion>>,
    /// The pilot was told to switch back.
    back_told: bool,
    /// A set whose acceptance was heard once: it is commanded once more, when this is due.
    again: Option<AgainCommanded>,
}

/// A set is commanded once more, which changes nothing where it was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
struct AgainCommanded {
    set: u8,
    due: Stamp<Companion>,
    sent: bool,
}

/// What was done in this outage.
#[derive(Clone, Copy, Debug, PartialEq)]
enum SwitchState {
    /// Nothing.
    Rest,
    /// A set was commanded, so often, and last then.
    Asking { set: u8, asked: u8, sent: Stamp<Companion>, answer: SwitchAnswer },
    /// The autopilot is on our set by our command.
    Over,
    /// The pilot was told to switch over, and since when he knows; and once more.
    Told { since: Stamp<Companion>, again: bool },
    /// It did not take the set, and the pilot was told; since when.
    InVain { since: Stamp<Companion> },
    /// No more, whatever came of it.
    Done,
}

/// What the autopilot has said to the newest command, and how often it has refused in a row.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct SwitchAnswer {
    refused: bool,
    refusals: u8,
}

impl SourceSwitch {
    /// Has done nothing; speaks as `us`.
    pub fn new(settings: SwitchSettings, us: Address, autopilot: Address) -> Self {
        Self {
            settings,
            us,
            autopilot,
            state: SwitchState::Rest,
            outage: None,
            good: None,
            no_position: None,
            back_told: false,
            again: None,
        }
    }

    /// The autopilot rebooted: it is on its first set.
    pub fn restart(&mut self) {
        *self = Self::new(self.settings, self.us, self.autopilot);
    }

    /// The autopilot's answer to a command; the source set that is in force now, if it is one to ours.
    pub fn acknowledge(&mut self, ack: &COMMAND_ACK_DATA) -> Option<u8> {
        if ack.command != MavCmd::MAV_CMD_SET_EKF_SOURCE_SET
            || !self.us.is_meant_by(ack.target_system, ack.target_component)
        {
            return None;
        }
        if let Some(again) = self.again.take_if(|again| again.sent && refuses(ack.result)) {
            // It contradicts what was accepted in its name.
            let answer = SwitchAnswer { refused: true, refusals: 1 };
            self.state = SwitchState::Asking { set: again.set, asked: 1, sent: again.due, answer };
            return None;
        }
        let SwitchState::Asking { set, answer, sent, .. } = &mut self.state else { return None };
        let (taken, due) = (*set, *sent + ANSWER);
        match ack.result {
            MavResult::MAV_RESULT_ACCEPTED => {
                let over = taken == self.settings.sets.external;
                self.again = Some(AgainCommanded { set: taken, due, sent: false });
                self.state = if over { SwitchState::Over } else { SwitchState::Done };
                self.no_position = None;
                Some(taken)
            }
            // It may be passing (a full queue): it is asked again.
            result if !refuses(result) => None,
            // One answer to a command.
            _ if answer.refused => None,
            _ => {
                *answer = SwitchAnswer { refused: true, refusals: answer.refusals + 1 };
                None
            }
        }
    }

    /// Looks at the time and what is known.
    pub fn poll(&mut self, now: Stamp<Companion>, inputs: &SwitchInputs) -> SwitchPoll {
        self.note(now, inputs.mode);
        match self.command_again(now, inputs) {
            None => self.decide(now, inputs),
            command => SwitchPoll { command, news: None },
        }
    }

    fn decide(&mut self, now: Stamp<Companion>, inputs: &SwitchInputs) -> SwitchPoll {
        match self.state {
            SwitchState::Asking { set, asked, sent, answer } => {
                if set == self.settings.sets.external && inputs.quality.is_none() {
                    self.state = SwitchState::Done;
                    SwitchPoll::default()
                } else if answer.refusals >= REFUSALS {
                    self.give_up(now, set, WhyNot::Refused)
                } else if now - sent < ANSWER {
                    SwitchPoll::default()
                } else if asked < ATTEMPTS {
                    let refusals = if answer.refused { answer.refusals } else { 0 };
                    let poll = self.ask(now, set, asked + 1, None);
                    if let SwitchState::Asking { answer, .. } = &mut self.state {
                        answer.refusals = refusals;
                    }
                    poll
                } else {
                    self.give_up(now, set, WhyNot::NoAnswer)
                }
            }
            SwitchState::Over => self.over(now, inputs),
            SwitchState::Rest | SwitchState::Told { .. } if inputs.mode == Mode::Holdover => {
                self.switch_over(now, inputs)
            }
            SwitchState::InVain { since } if inputs.mode == Mode::Holdover && now - since >= AGAIN => {
                self.switch_over(now, inputs)
            }
            SwitchState::Rest | SwitchState::Told { .. } | SwitchState::InVain { .. } | SwitchState::Done => {
                self.remind(now, inputs)
            }
        }
    }

    /// The command that was accepted, once more; not where another set has been taken meanwhile.
    fn command_again(&mut self, now: Stamp<Companion>, i: &SwitchInputs) -> Option<MavMessage> {
        let asks = matches!(self.state, SwitchState::Asking { .. });
        let again = self.again.as_mut().filter(|again| !again.sent && now >= again.due)?;
        if asks || i.set.is_some_and(|set| set != again.set) {
            self.again = None;
            return None;
        }
        again.sent = true;
        let set = f32::from(again.set);
        Some(command_long(self.autopilot, MavCmd::MAV_CMD_SET_EKF_SOURCE_SET, set, 0.0))
    }

    /// An outage begins with Holdover, and ends with Aided.
    fn note(&mut self, now: Stamp<Companion>, mode: Mode) {
        match mode {
            Mode::Aided => {
                self.outage = None;
                self.good.get_or_insert(now);
            }
            Mode::Holdover if self.outage.is_none() => {
                self.outage = Some(now);
                self.good = None;
                self.back_told = false;
                if self.state != SwitchState::Over {
                    self.state = SwitchState::Rest;
                }
            }
            _ => self.good = None,
        }
    }

    fn ask(&mut self, now: Stamp<Companion>, set: u8, asked: u8, news: Option<SwitchNews>) -> SwitchPoll {
        self.state = SwitchState::Asking { set, asked, sent: now, answer: SwitchAnswer::default() };
        let command = MavCmd::MAV_CMD_SET_EKF_SOURCE_SET;
        SwitchPoll { command: Some(command_long(self.autopilot, command, f32::from(set), 0.0)), news }
    }

    fn give_up(&mut self, now: Stamp<Companion>, set: u8, why: WhyNot) -> SwitchPoll {
        self.state = SwitchState::InVain { since: now };
        SwitchPoll { command: None, news: Some(SwitchNews::NotSwitched(set, why)) }
    }

    /// In an outage, on another set than ours.
    fn switch_over(&mut self, now: Stamp<Companion>, i: &SwitchInputs) -> SwitchPoll {
        let external = self.settings.sets.external;
        if i.set == Some(external) {
            self.state = SwitchState::Done;
            return SwitchPoll::default();
        }
        if i.quality.is_none_or(|q| q < self.settings.min_quality) {
            return SwitchPoll::default();
        }
        if self.settings.by == SwitchedBy::Pilot {
            return self.tell_pilot(now);
        }
        if i.received {
            return self.ask(now, external, 1, None);
        }
        if self.outage.is_some_and(|since| now - since > RECEIPT) {
            return self.give_up(now, external, WhyNot::NotReceived);
        }
        SwitchPoll::default()
    }

    fn tell_pilot(&mut self, now: Stamp<Companion>) -> SwitchPoll {
        let again = match self.state {
            SwitchState::Told { since, again: false } if now - since >= REMINDER => true,
            SwitchState::Told { .. } => return SwitchPoll::default(),
            _ => false,
        };
        self.state = SwitchState::Told { since: now, again };
        let set = self.settings.sets.external;
        let news = if again { SwitchNews::SwitchSoon(set) } else { SwitchNews::SwitchOver(set) };
        SwitchPoll { command: None, news: Some(news) }
    }

    /// The autopilot is on our set by our command.
    fn over(&mut self, now: Stamp<Companion>, i: &SwitchInputs) -> SwitchPoll {
        let gnss = self.settings.sets.gnss;
        if i.set.is_some_and(|set| set != self.settings.sets.external) {
            self.state = SwitchState::Done;
            let news = i.set.map(SwitchNews::PilotSwitched);
            return SwitchPoll { command: None, news };
        }
        if i.standing != StandsOn::Nothing {
            self.no_position = None;
        } else if now - *self.no_position.get_or_insert(now) > NO_POSITION {
            return self.ask(now, gnss, 1, Some(SwitchNews::Reverted(gnss)));
        }
        if self.may_return(now, i) { self.ask(now, gnss, 1, None) } else { SwitchPoll::default() }
    }

    /// GNSS has been good for long enough, and the autopilot is near, or will not come nearer.
    fn may_return(&self, now: Stamp<Companion>, i: &SwitchInputs) -> bool {
        let Some(good) = self.good.map(|since| now - since) else { return false };
        let near = i.departure.is_some_and(|d| d.horizontal_m <= self.settings.return_within_m);
        let beyond_s = good.seconds() - self.settings.return_after_s;
        beyond_s >= 0.0 && (near || beyond_s >= NEARNESS.seconds())
    }

    /// A set that the pilot has taken is the pilot's to leave.
    fn remind(&mut self, now: Stamp<Companion>, i: &SwitchInputs) -> SwitchPoll {
        let on_ours = i.set == Some(self.settings.sets.external) && i.standing == StandsOn::Ours;
        let mut poll = SwitchPoll::default();
        if on_ours && !self.back_told && self.may_return(now, i) {
            self.back_told = true;
            poll.news = Some(SwitchNews::SwitchBack(self.settings.sets.gnss));
        }
        poll
    }
}

/// Whether a command is refused for good.
fn refuses(result: MavResult) -> bool {
    use MavResult as R;
    !matches!(result, R::MAV_RESULT_ACCEPTED | R::MAV_RESULT_TEMPORARILY_REJECTED | R::MAV_RESULT_IN_PROGRESS)
}

#[cfg(test)]
mod tests;
