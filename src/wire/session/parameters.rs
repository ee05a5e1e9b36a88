//! Reads an autopilot's parameters by name, and sets them.
//!
//! A few questions are under way at a time, each is asked again when no answer comes, and a limited number of times: links lose
//! messages, and ArduPilot does not answer for a name that it does not know. PX4 does, with PARAM_ERROR,
//! which is believed when it answers two questions in a row: one may be somebody else's word. A parameter that was set is read
//! back by a question of its own: what is echoed may be what was wished, not what is kept.

use mavlink::MessageData;
use mavlink::dialects::ardupilotmega::{
    MavMessage, MavParamError, PARAM_ERROR_DATA, PARAM_REQUEST_READ_DATA, PARAM_SET_DATA,
};

use super::Address;
use super::parameter_value::{ParameterName, ParameterValue};
use crate::time::{Companion, Span, Stamp};
use crate::wire::frame::Frame;

/// Settings of [`ParameterDialogue`].
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct ParameterConfig {
    /// Questions under way at a time. ArduPilot's queue holds 20.
    pub open: usize,
    /// An answer is waited for this long before the question is asked again.
    pub patience: Span,
    /// How often a question is asked.
    pub attempts: u8,
}

impl Default for ParameterConfig {
    fn default() -> Self {
        Self { open: 8, patience: Span::from_millis(400), attempts: 6 }
    }
}

/// What became of a question.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ParameterAnswer {
    /// No answer yet.
    Open,
    /// The value; after a setting as it was read back.
    Value(ParameterValue),
    /// The autopilot says that it has no such parameter.
    Unknown,
    /// No answer to any attempt: unknown to an autopilot that answers others.
    Unanswered,
}

/// What is asked.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Ask {
    Read,
    Set(ParameterValue),
    ReadBack,
}

#[derive(Clone, Copy, Debug)]
struct ParameterQuestion {
    name: ParameterName,
    ask: Ask,
    asked: u8,
    due: Option<Stamp<Companion>>,
    /// It was denied when it had been asked so often.
    denied: Option<u8>,
    answer: ParameterAnswer,
}

/// The questions to one autopilot, and its answers.
#[derive(Clone, Debug)]
pub struct ParameterDialogue {
    config: ParameterConfig,
    autopilot: Address,
    questions: Vec<ParameterQuestion>,
    answered: usize,
}

impl ParameterDialogue {
    /// Nothing is asked yet.
    pub fn new(config: ParameterConfig, autopilot: Address) -> Self {
        Self { config, autopilot, questions: Vec::new(), answered: 0 }
    }

    /// Asks for a parameter; one that was asked for before is asked for anew.
    pub fn read(&mut self, name: ParameterName) {
        self.question(name, Ask::Read);
    }

    /// Sets a parameter, and reads it back.
    pub fn set(&mut self, value: ParameterValue) {
        self.question(value.name, Ask::Set(value));
    }

    fn question(&mut self, name: ParameterName, ask: Ask) {
        self.questions.retain(|q| q.name != name);
        let answer = ParameterAnswer::Open;
        self.questions.push(ParameterQuestion { name, ask, asked: 0, due: None, denied: None, answer });
    }

    /// Whether no answer is waited for.
    pub fn done(&self) -> bool {
        self.questions.iter().all(|q| q.answer != ParameterAnswer::Open)
    }

    /// Whether the autopilot has answered anything.
    pub fn answers(&self) -> bool {
        self.answered > 0
    }

    /// What became of each question, in the order they were asked.
    pub fn results(&self) -> impl Iterator<Item = (ParameterName, ParameterAnswer)> + '_ {
        self.questions.iter().map(|q| (q.name, q.answer))
    }

    /// Takes note of a frame of the autopilot.
    pub fn hear(&mut self, frame: &Frame<'_>) {
        if let Some(value) = ParameterValue::read(frame) {
            self.answered += 1;
            self.value(value);
        } else if frame.message_id() == PARAM_ERROR_DATA::ID
            && let Ok(MavMessage::PARAM_ERROR(error)) = frame.parse()
            && let Some(name) = ParameterName::from_wire(*error.param_id)
        {
            self.answered += 1;
            if error.error == MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST {
                self.denied(name);
            }
        }
    }

    fn value(&mut self, value: ParameterValue) {
        let open = |q: &&mut ParameterQuestion| q.name == value.name && q.asked > 0;
        let Some(question) = self.questions.iter_mut().find(open) else { return };
        match question.ask {
            Ask::Read | Ask::ReadBack => question.answer = ParameterAnswer::Value(value),
            Ask::Set(_) => {
                *question =
                    ParameterQuestion { ask: Ask::ReadBack, asked: 0, due: None, denied: None, ..*question }
            }
        }
    }

    /// The autopilot says that there is no such parameter: it is asked once more.
    fn denied(&mut self, name: ParameterName) {
        let waits = |q: &&mut ParameterQuestion| q.name == name && q.answer == ParameterAnswer::Open;
        for question in self.questions.iter_mut().filter(waits) {
            match question.denied {
                None if question.asked > 0 => (question.denied, question.due) = (Some(question.asked), None),
                Some(then) if question.asked > then => question.answer = ParameterAnswer::Unknown,
                _ => {}
            }
        }
    }

    /// The questions to ask now.
    pub fn poll(&mut self, now: Stamp<Companion>) -> Vec<MavMessage> {
        let ParameterConfig { open, patience, attempts } = self.config;
        let waiting = |q: &ParameterQuestion| q.due.is_some_and(|due| now < due);
        let is_open = |q: &ParameterQuestion| q.answer == ParameterAnswer::Open;
        let spent = |q: &ParameterQuestion| is_open(q) && !waiting(q) && q.asked >= attempts;
        let mut given_up = false;
        for question in self.questions.iter_mut().filter(|q| spent(q)) {
            question.answer = ParameterAnswer::Unanswered;
            given_up = true;
        }
        if given_up && self.answered == 0 {
            // It answers nothing at all: the others need not be tried.
            self.give_up();
        }
        let mut room =
            open.saturating_sub(self.questions.iter().filter(|q| is_open(q) && waiting(q)).count());
        let mut out = Vec::new();
        for question in self.questions.iter_mut().filter(|q| is_open(q) && !waiting(q)) {
            if room == 0 {
                break;
            }
            room -= 1;
            question.asked += 1;
            question.due = Some(now + patience);
            out.extend(question.message(self.autopilot));
        }
        out
    }

    /// Waits for nothing more.
    pub fn give_up(&mut self) {
        for question in self.questions.iter_mut().filter(|q| q.answer == ParameterAnswer::Open) {
            question.answer = ParameterAnswer::Unanswered;
        }
    }
}

impl ParameterQuestion {
    fn message(&self, to: Address) -> Option<MavMessage> {
        let (target_system, target_component) = (to.system.0, to.component.0);
        let param_id = self.name.bytes().into();
        Some(match self.ask {
            Ask::Read | Ask::ReadBack => MavMessage::PARAM_REQUEST_READ(PARAM_REQUEST_READ_DATA {
                param_index: -1,
                target_system,
                target_component,
                param_id,
            }),
            Ask::Set(value) => MavMessage::PARAM_SET(PARAM_SET_DATA {
                param_value: f32::from_le_bytes(value.bits),
                target_system,
                target_component,
                param_id,
                param_type: value.wire_type()?,
            }),
        })
    }
}

#[cfg(test)]
mod tests {
    use mavlink::dialects::ardupilotmega::{MavParamType, PARAM_VALUE_DATA};

    use super::super::heartbeat_fields::testing::frame_of;
    use super::super::parameter_value::ParameterEncoding;
    use super::*;
    use crate::wire::frame::{ComponentId, SystemId};

    const AUTOPILOT: Address = Address { system: SystemId(1), component: ComponentId(1) };

    fn at(ms: i64) -> Stamp<Companion> {
        Stamp::from_micros(ms * 1000)
    }

    fn name(text: &str) -> ParameterName {
        ParameterName::new(text).unwrap()
    }

    fn dialogue(names: &[&str]) -> ParameterDialogue {
        let mut dialogue = ParameterDialogue::new(ParameterConfig::default(), AUTOPILOT);
        names.iter().for_each(|n| dialogue.read(name(n)));
        dialogue
    }

    fn tell(dialogue: &mut ParameterDialogue, id: &str, number: f32) {
        let data = PARAM_VALUE_DATA {
            param_value: number,
            param_count: 9,
            param_index: 0,
            param_id: id.into(),
            param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
        };
        dialogue.hear(&frame_of(1, 1, &MavMessage::PARAM_VALUE(data)).frame().unwrap());
    }

    fn answer(dialogue: &ParameterDialogue, of: &str) -> ParameterAnswer {
        dialogue.results().find(|(n, _)| *n == name(of)).unwrap().1
    }

    #[test]
    fn a_lost_answer_is_asked_for_again_and_an_unknown_name_has_a_limit() {
        let mut dialogue = dialogue(&["A", "B"]);
        assert_eq!(dialogue.poll(at(0)).len(), 2);
        assert_eq!(dialogue.poll(at(399)).len(), 0);
        tell(&mut dialogue, "A", 1.0);
        let asked: usize = (400..20_000).map(|ms| dialogue.poll(at(ms)).len()).sum();
        assert_eq!((asked, dialogue.done()), (5, true));
        assert!(matches!(answer(&dialogue, "A"), ParameterAnswer::Value(_)));
        assert_eq!(answer(&dialogue, "B"), ParameterAnswer::Unanswered);
    }

    #[test]
    fn one_that_answers_nothing_is_not_asked_for_everything() {
        let names: Vec<String> = (0..100).map(|i| format!("P{i}")).collect();
        let mut dialogue = dialogue(&names.iter().map(String::as_str).collect::<Vec<_>>());
        let asked: usize = (0..60_000).map(|ms| dialogue.poll(at(ms)).len()).sum();
        assert_eq!((asked, dialogue.done(), dialogue.answers()), (48, true, false));
    }

    #[test]
    fn an_autopilot_that_says_no_twice_is_believed() {
        let mut dialogue = dialogue(&["A"]);
        dialogue.poll(at(0));
        let error = PARAM_ERROR_DATA {
            param_index: -1,
            target_system: 1,
            target_component: 197,
            param_id: "A".into(),
            error: MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST,
        };
        let denied = frame_of(1, 1, &MavMessage::PARAM_ERROR(error));
        // However often it is said to one question.
        (0..20).for_each(|_| dialogue.hear(&denied.frame().unwrap()));
        assert_eq!(answer(&dialogue, "A"), ParameterAnswer::Open);
        assert_eq!(dialogue.poll(at(10)).len(), 1, "asked again at once");
        let mut forged = dialogue.clone();
        dialogue.hear(&denied.frame().unwrap());
        assert_eq!(answer(&dialogue, "A"), ParameterAnswer::Unknown);
        // The autopilot's own answer is the value.
        tell(&mut forged, "A", 3.0);
        assert!(matches!(answer(&forged, "A"), ParameterAnswer::Value(_)));
    }

    #[test]
    fn what_was_set_is_read_back() {
        let mut dialogue = dialogue(&["A"]);
        dialogue.poll(at(0));
        tell(&mut dialogue, "A", 1.0);
        let ParameterAnswer::Value(before) = answer(&dialogue, "A") else { panic!("no answer") };
        dialogue.set(before.with(ParameterEncoding::Cast, 7.0).unwrap());
        let messages = dialogue.poll(at(1000));
        assert!(matches!(&messages[..], [MavMessage::PARAM_SET(set)] if set.param_value == 7.0));
        tell(&mut dialogue, "A", 7.0);
        assert!(!dialogue.done(), "an echo is no proof");
        assert!(matches!(dialogue.poll(at(1100))[..], [MavMessage::PARAM_REQUEST_READ(_)]));
        tell(&mut dialogue, "A", 1.0);
        assert_eq!(answer(&dialogue, "A"), ParameterAnswer::Value(before));
        assert!(dialogue.done());
    }
}
