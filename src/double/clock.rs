//! TIMESYNC as an autopilot does it: answers at once, and (PX4) questions at 10 Hz that make it believe the companion's stamps.

use mavlink::dialects::ardupilotmega as apm;

use crate::wire::messages::Message;

/// Between two questions, µs.
const ASK_EVERY_US: i64 = 100_000;
/// Answers that take this long or longer are thrown away, ns.
const SLOW_NS: i64 = 10_000_000;
/// Quick answers that make the stamps believed.
const CONVERGED_AFTER: u32 = 500;

/// The exchange with one companion. Times are µs of the autopilot's clock.
#[derive(Clone, Debug, Default)]
pub struct TimesyncExchange {
    asked_us: Option<i64>,
    quick: u32,
}

impl TimesyncExchange {
    /// The question that is due.
    pub fn question(&mut self, now_us: i64) -> Option<Message> {
        if self.asked_us.is_some_and(|t| now_us - t < ASK_EVERY_US) {
            return None;
        }
        self.asked_us = Some(now_us);
        Some(timesync(0, now_us * 1000, (0, 0)))
    }

    /// Takes a TIMESYNC of (system, component); answers what is a question, if `answers`.
    pub fn hear(
        &mut self,
        m: &apm::TIMESYNC_DATA,
        now_us: i64,
        answers: bool,
        from: (u8, u8),
    ) -> Option<Message> {
        if m.tc1 == 0 {
            return answers.then(|| timesync(now_us * 1000, m.ts1, from));
        }
        let round_trip_ns = now_us * 1000 - m.ts1;
        if self.asked_us.is_some() && (0..SLOW_NS).contains(&round_trip_ns) {
            self.quick = self.quick.saturating_add(1);
        }
        None
    }

    /// Whether the companion's stamps are believed.
    pub fn converged(&self) -> bool {
        self.quick >= CONVERGED_AFTER
    }
}

fn timesync(tc1: i64, ts1: i64, (target_system, target_component): (u8, u8)) -> Message {
    Message::TIMESYNC(apm::TIMESYNC_DATA { tc1, ts1, target_system, target_component })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(question: &Message, tc1: i64) -> apm::TIMESYNC_DATA {
        let Message::TIMESYNC(q) = question else { panic!("{question:?}") };
        apm::TIMESYNC_DATA { tc1, ts1: q.ts1, target_system: 1, target_component: 1 }
    }

    #[test]
    fn five_hundred_quick_answers_are_needed() {
        let converged = |late_us| {
            let mut exchange = TimesyncExchange::default();
            let mut after = None;
            for k in 0..60_000 {
                let now_us = 1000 * k;
                if let Some(question) = exchange.question(now_us) {
                    exchange.hear(&answer(&question, 5), now_us + late_us, true, (1, 197));
                }
                after = after.or(exchange.converged().then_some(now_us));
            }
            after
        };
        let after_us = converged(4000).unwrap();
        assert!((49_000_000..51_000_000).contains(&after_us), "{after_us}");
        assert_eq!(converged(12_000), None);
    }

    #[test]
    fn a_question_is_answered_with_the_clock_and_the_number() {
        let mut exchange = TimesyncExchange::default();
        let question = apm::TIMESYNC_DATA { tc1: 0, ts1: 77, target_system: 1, target_component: 1 };
        let Some(Message::TIMESYNC(a)) = exchange.hear(&question, 3, true, (1, 197)) else {
            panic!("no answer")
        };
        assert_eq!((a.tc1, a.ts1, a.target_component), (3000, 77, 197));
        assert_eq!(exchange.hear(&question, 3, false, (1, 197)), None);
    }
}
