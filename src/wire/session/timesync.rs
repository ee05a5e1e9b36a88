//! TIMESYNC: how the autopilot's clock stands against the companion's.
//!
//! We ask with `tc1 = 0` and a number of our own in `ts1`; the autopilot answers with its clock (nanoseconds since boot) in
//! `tc1` and our number in `ts1`. With the send time t0, the receive time t1 and the answer T, taken to be from half way,
//! offset = T − (t0 + t1)/2 and |error| ≤ (t1 − t0)/2 (Cristian 1989, "Probabilistic clock synchronization", eq. 1-4). Answers
//! with the shortest round trips bound it best, so the estimate is a line through those in a window that are near the shortest
//! (`clock_line`).
//!
//! Each answer bounds the true offset on its own. Several answers in a row that agree with each other and contradict the
//! estimate's bound mean that the autopilot's clock slipped, or, by a second or more, that it was set anew: it rebooted.

use std::collections::VecDeque;

use mavlink::dialects::ardupilotmega::{MavMessage, TIMESYNC_DATA};

use super::Address;
use super::clock_line::{ClockLine, ClockReading};
use crate::time::{Companion, Span, Stamp};

/// Settings of [`TimeSync`].
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct TimeSyncConfig {
    /// Time between two questions until converged, and whenever an answer contradicts the estimate.
    pub fast: Span,
    /// Time between two questions afterwards.
    pub slow: Span,
    /// Good answers that make the estimate converged.
    pub converged_after: usize,
    /// Answers that are older are forgotten.
    pub window: Span,
    /// Answers that took longer are refused.
    pub max_round_trip: Span,
    /// Consecutive answers that must agree on a step.
    pub step_confirmations: usize,
}

impl Default for TimeSyncConfig {
    fn default() -> Self {
        Self {
            fast: Span::from_millis(100),
            slow: Span::from_millis(1000),
            converged_after: 8,
            window: Span::from_millis(30_000),
            max_round_trip: Span::from_millis(10_000),
            step_confirmations: 3,
        }
    }
}

/// What was asked, answered and refused.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct TimeSyncCounters {
    /// Questions we sent.
    pub asked: u64,
    /// Questions of the autopilot that we answered.
    pub answered: u64,
    /// Answers that entered the estimate.
    pub used: u64,
    /// Answers whose round trip was much longer than the shortest.
    pub slow: u64,
    /// Answers to nothing that we had asked: duplicates, inventions, answers to others.
    pub unasked: u64,
    /// Answers with an impossible clock, or after too long.
    pub impossible: u64,
    /// Messages of other senders, or for other receivers.
    pub not_ours: u64,
    /// Answers that contradict the estimate.
    pub contradictions: u64,
    /// Times that the autopilot's clock was set anew.
    pub steps: u64,
    /// Times that it slipped by less than a second.
    pub slips: u64,
}

/// What a TIMESYNC message led to.
#[derive(Clone, Debug, PartialEq)]
pub enum TimeSyncHeard {
    /// The autopilot asked: send this at once.
    Answer(TIMESYNC_DATA),
    /// An answer that was taken into account.
    Measured {
        /// Its offset, autopilot clock less companion clock.
        offset: Span,
        /// Its round trip.
        round_trip: Span,
    },
    /// The autopilot's clock was set anew (it rebooted). The estimate started afresh.
    Stepped {
        /// New offset less old offset.
        step: Span,
    },
    /// The autopilot's clock slipped by less than a second: a simulation that stood still for a moment. The estimate goes on from there.
    Slipped {
        /// New offset less what the old line says.
        slip: Span,
    },
    /// Of no use; counted.
    Ignored,
}

#[derive(Clone, Copy, Debug)]
struct OpenQuestion {
    number: i64,
    sent: Stamp<Companion>,
}

/// Questions that may be under way at once; older ones are given up.
const MAX_OPEN: usize = 32;
/// Samples in the window.
const MAX_SAMPLES: usize = 16;
/// A change of the offset from here on means that the clock was set: that of an autopilot that reboots falls to zero. A smaller one is a
/// slip: the simulation stood still, or ran after its time.
const SET: Span = Span::from_millis(1000);

/// Estimates the offset of the autopilot's clock, and answers its questions for ours.
#[derive(Clone, Debug)]
pub struct TimeSync {
    config: TimeSyncConfig,
    us: Address,
    autopilot: Address,
    open: VecDeque<OpenQuestion>,
    samples: VecDeque<ClockReading>,
    suspects: VecDeque<ClockReading>,
    estimate: Option<ClockLine>,
    used_in_window: usize,
    next_ask: Option<Stamp<Companion>>,
    counters: TimeSyncCounters,
}

impl TimeSync {
    /// Begins to ask `autopilot`, as `us`.
    pub fn new(config: TimeSyncConfig, us: Address, autopilot: Address) -> Self {
        Self {
            config,
            us,
            autopilot,
            open: VecDeque::with_capacity(MAX_OPEN),
            samples: VecDeque::with_capacity(MAX_SAMPLES),
            suspects: VecDeque::new(),
            estimate: None,
            used_in_window: 0,
            next_ask: None,
            counters: TimeSyncCounters::default(),
        }
    }

    /// Autopilot clock less companion clock at the newest answer, once there was a usable one.
    pub fn offset(&self) -> Option<Span> {
        self.estimate.map(|e| e.offset)
    }

    /// The same at another time, by the rate at which the clocks drift apart.
    pub fn offset_at(&self, now: Stamp<Companion>) -> Option<Span> {
        self.estimate.map(|e| e.offset_at(now))
    }

    /// The shortest recent round trip; the offset is good to half of it.
    pub fn round_trip(&self) -> Option<Span> {
        self.estimate.map(|e| e.round_trip)
    }

    /// Whether enough good answers agree.
    pub fn converged(&self) -> bool {
        self.used_in_window >= self.config.converged_after && self.suspects.is_empty()
    }

    /// What was asked, answered and refused.
    pub fn counters(&self) -> TimeSyncCounters {
        self.counters
    }

    /// Forgets all answers, for a reboot that was noticed otherwise.
    pub fn restart(&mut self) {
        self.open.clear();
        self.samples.clear();
        self.suspects.clear();
        self.estimate = None;
        self.used_in_window = 0;
        self.next_ask = None;
    }

    /// The question to send now, if one is due.
    pub fn poll(&mut self, now: Stamp<Companion>) -> Option<MavMessage> {
        if self.next_ask.is_some_and(|due| now < due) {
            return None;
        }
        let period = if self.converged() { self.config.slow } else { self.config.fast };
        self.next_ask = Some(now + period);
        self.counters.asked += 1;
        // Nanoseconds of our clock with a running number in the digits that the clock does not use: no two are the same.
        let number = (now.micros().max(1).saturating_mul(1000))
            .saturating_add(i64::try_from(self.counters.asked % 1000).unwrap_or(0));
        while self.open.len() >= MAX_OPEN {
            self.open.pop_front();
        }
        self.open.push_back(OpenQuestion { number, sent: now });
        Some(MavMessage::TIMESYNC(timesync(0, number, self.autopilot)))
    }

    /// Takes a TIMESYNC from `from`, received at `received`.
    ///
    /// `answer_clock_ns` is the clock to answer a question with: what the autopilot's clock says now in our estimation, if our
    /// messages are stamped on that (it then finds no offset), else our own; nanoseconds.
    pub fn hear(
        &mut self,
        received: Stamp<Companion>,
        from: Address,
        message: &TIMESYNC_DATA,
        answer_clock_ns: i64,
    ) -> TimeSyncHeard {
        if from != self.autopilot || !self.us.is_meant_by(message.target_system, message.target_component) {
            self.counters.not_ours += 1;
            return TimeSyncHeard::Ignored;
        }
        if message.tc1 == 0 {
            self.counters.answered += 1;
            return TimeSyncHeard::Answer(timesync(answer_clock_ns, message.ts1, from));
        }
        let Some(index) = self.open.iter().position(|q| q.number == message.ts1) else {
            self.counters.unasked += 1;
            return TimeSyncHeard::Ignored;
        };
        let Some(question) = self.open.remove(index) else { return TimeSyncHeard::Ignored };
        let round_trip = received - question.sent;
        if message.tc1 < 0 || round_trip < Span::ZERO || round_trip > self.config.max_round_trip {
            self.counters.impossible += 1;
            return TimeSyncHeard::Ignored;
        }
        let middle = question.sent + Span::from_micros(round_trip.micros() / 2);
        let offset = Span::from_micros((message.tc1 / 1000).saturating_sub(middle.micros()));
        self.measured(ClockReading { offset, round_trip, at: received })
    }

    fn measured(&mut self, sample: ClockReading) -> TimeSyncHeard {
        if self.estimate.is_some_and(|estimate| estimate.contradicts(&sample)) {
            return self.suspect(sample);
        }
        self.suspects.clear();
        let window = self.config.window;
        self.samples.retain(|s| sample.at - s.at <= window);
        if self.samples.len() >= MAX_SAMPLES {
            self.samples.pop_front();
        }
        self.samples.push_back(sample);
        if self.update() {
            self.counters.used += 1
        } else {
            self.counters.slow += 1
        }
        TimeSyncHeard::Measured { offset: sample.offset, round_trip: sample.round_trip }
    }

    fn suspect(&mut self, sample: ClockReading) -> TimeSyncHeard {
        self.counters.contradictions += 1;
        if self.suspects.iter().any(|s| s.contradicts(&sample)) {
            self.suspects.clear();
        }
        self.suspects.push_back(sample);
        // Ask quickly: until the matter is settled the estimate cannot be trusted.
        self.next_ask = self.next_ask.map(|due| due.min(sample.at + self.config.fast));
        if self.suspects.len() < self.config.step_confirmations {
            return TimeSyncHeard::Ignored;
        }
        let before = self.estimate.map_or(Span::ZERO, |e| e.offset_at(sample.at));
        self.samples = std::mem::take(&mut self.suspects);
        self.update();
        let after = self.estimate.map_or(Span::ZERO, |e| e.offset);
        let step = Span::from_micros(after.micros().saturating_sub(before.micros()));
        if step.micros().unsigned_abs() < SET.micros().unsigned_abs() {
            self.counters.slips += 1;
            return TimeSyncHeard::Slipped { slip: step };
        }
        // The rate of a clock that was set is another.
        self.estimate = self.estimate.map(|e| ClockLine { rate: None, ..e });
        self.counters.steps += 1;
        TimeSyncHeard::Stepped { step }
    }

    /// Fits the estimate to the samples near the shortest round trip; true if the newest is one of them.
    fn update(&mut self) -> bool {
        let before = self.estimate.and_then(|e| e.rate);
        let Some((line, n)) = ClockLine::fit(self.samples.iter(), before) else { return false };
        self.used_in_window = n;
        self.estimate = Some(line);
        self.samples.back().is_some_and(|newest| newest.is_near(line.round_trip))
    }
}

fn timesync(tc1: i64, ts1: i64, to: Address) -> TIMESYNC_DATA {
    TIMESYNC_DATA { tc1, ts1, target_system: to.system.0, target_component: to.component.0 }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::wire::frame::{ComponentId, SystemId};

    const US: Address = Address { system: SystemId(1), component: ComponentId(197) };
    const AUTOPILOT: Address = Address { system: SystemId(1), component: ComponentId(1) };

    fn sync() -> TimeSync {
        TimeSync::new(TimeSyncConfig::default(), US, AUTOPILOT)
    }

    fn us(micros: i64) -> Stamp<Companion> {
        Stamp::from_micros(micros)
    }

    fn data(message: MavMessage) -> TIMESYNC_DATA {
        match message {
            MavMessage::TIMESYNC(data) => data,
            other => panic!("{other:?}"),
        }
    }

    /// An autopilot whose clock is `offset_us` ahead and which answers after `there` and `back` microseconds.
    fn exchange(
        sync: &mut TimeSync,
        now: i64,
        offset_us: i64,
        there: i64,
        back: i64,
    ) -> Option<TimeSyncHeard> {
        let question = data(sync.poll(us(now))?);
        assert_eq!((question.tc1, question.target_system, question.target_component), (0, 1, 1));
        let answer = TIMESYNC_DATA {
            tc1: (now + there + offset_us) * 1000,
            ts1: question.ts1,
            target_system: 1,
            target_component: 197,
        };
        Some(sync.hear(us(now + there + back), AUTOPILOT, &answer, 0))
    }

    #[test]
    fn a_question_is_answered_at_once_to_the_asker() {
        let mut sync = sync();
        let question = TIMESYNC_DATA { tc1: 0, ts1: 77, target_system: 0, target_component: 0 };
        let TimeSyncHeard::Answer(answer) = sync.hear(us(5), AUTOPILOT, &question, 123_456) else {
            panic!("no answer")
        };
        let expected = TIMESYNC_DATA { tc1: 123_456, ts1: 77, target_system: 1, target_component: 1 };
        assert_eq!(answer, expected);
        let elsewhere = TIMESYNC_DATA { tc1: 0, ts1: 77, target_system: 1, target_component: 191 };
        assert_eq!(sync.hear(us(5), AUTOPILOT, &elsewhere, 1), TimeSyncHeard::Ignored);
        assert_eq!((sync.counters().answered, sync.counters().not_ours), (1, 1));
    }

    #[test]
    fn asks_at_ten_hertz_until_converged_and_then_once_a_second() {
        let mut sync = sync();
        let asked = |sync: &mut TimeSync, from_ms: i64, to_ms: i64| {
            (from_ms..to_ms).filter(|ms| exchange(sync, ms * 1000, 7, 400, 400).is_some()).count()
        };
        assert_eq!(asked(&mut sync, 1, 701), 7);
        assert!(!sync.converged());
        assert_eq!(asked(&mut sync, 701, 801), 1);
        assert!(sync.converged());
        assert!((10..=11).contains(&asked(&mut sync, 801, 10_801)));
    }

    #[test]
    fn without_answers_it_asks_on_at_ten_hertz_and_forgets_old_questions() {
        let mut sync = sync();
        assert_eq!((0..60_000).filter(|ms| sync.poll(us(ms * 1000)).is_some()).count(), 600);
        assert!(sync.open.len() <= MAX_OPEN);
        assert_eq!((sync.offset(), sync.round_trip()), (None, None));
    }

    #[test]
    fn a_symmetric_path_gives_the_exact_offset() {
        let mut sync = sync();
        for i in 4001..4020 {
            exchange(&mut sync, i * 1_000_000, -3_600_000_123, 1500, 1500);
        }
        assert_eq!(sync.offset(), Some(Span::from_micros(-3_600_000_123)));
        assert_eq!(sync.round_trip(), Some(Span::from_micros(3000)));
    }

    #[test]
    fn jitter_on_the_way_back_is_filtered_by_the_shortest_round_trips() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut sync = sync();
        let mut worst = 0;
        for i in 1..300 {
            // One answer in three is quick; the others wait up to 60 ms in a queue on their way back.
            let wait = if i % 3 == 0 { 0 } else { rng.random_range(0..60_000) };
            exchange(&mut sync, i * 1_000_000, 5_000_000, 800, 800 + wait);
            if i > 10 {
                worst = worst.max((sync.offset().unwrap().micros() - 5_000_000).abs());
            }
        }
        // The plain mean would be 10 ms off.
        assert!(worst < 700, "{worst} us");
        assert!(sync.counters().slow > 150, "{:?}", sync.counters());
    }

    #[test]
    fn a_drifting_clock_is_followed() {
        let mut sync = sync();
        let mut worst = 0;
        for i in 1..3600i64 {
            let offset = 1_000_000 + i * 50; // 50 ppm
            exchange(&mut sync, i * 1_000_000, offset, 1000, 1000);
            worst = worst.max((sync.offset().unwrap().micros() - offset).abs());
        }
        assert!(worst <= 450, "{worst} us");
        assert_eq!(sync.counters().steps, 0);
    }

    /// Answers for `seconds` of a clock that gains `rate` and stands still for `slip_us` each `every` seconds. The worst error of the
    /// offset 0.9 s after each answer, µs, and what is counted.
    fn simulated(seconds: i64, rate: f64, slip_us: i64, every: i64) -> (i64, TimeSyncCounters) {
        let mut sync = sync();
        let (mut worst, mut slipped) = (0, 0);
        for ms in 1..seconds * 1000 {
            slipped += if ms % (every * 1000) == 0 { slip_us } else { 0 };
            let offset = |ms: i64| 5_000_000 + (ms as f64 * 1000.0 * rate) as i64 - slipped;
            let heard = exchange(&mut sync, ms * 1000, offset(ms), 300, 300);
            let settled = ms > 20_000 && (slip_us == 0 || ms % (every * 1000) > 5000);
            if heard.is_some() && settled {
                let later = sync.offset_at(us((ms + 900) * 1000)).unwrap().micros();
                worst = worst.max((later - offset(ms + 900)).abs());
            }
        }
        (worst, sync.counters())
    }

    #[test]
    fn a_clock_that_runs_one_percent_off_is_followed_and_not_set() {
        for rate in [0.01, -0.01, 0.03] {
            let (worst, counters) = simulated(120, rate, 0, 1000);
            assert_eq!((counters.steps, counters.slips, counters.contradictions), (0, 0, 0), "{rate}");
            assert!(worst < 500, "{rate}: {worst} us");
        }
    }

    #[test]
    fn a_slip_is_a_slip() {
        let (worst, counters) = simulated(300, -0.01, 20_000, 20);
        assert_eq!((counters.steps, counters.slips), (0, 14), "{counters:?}");
        assert!(worst < 3000, "{worst} us");
    }

    #[test]
    fn only_answers_to_open_questions_of_the_autopilot_count() {
        let mut sync = sync();
        let question = data(sync.poll(us(1_000_000)).unwrap());
        let answer =
            TIMESYNC_DATA { tc1: 9_000_000_000, ts1: question.ts1, target_system: 1, target_component: 197 };
        let stranger = Address { system: SystemId(1), component: ComponentId(158) };
        let unasked = TIMESYNC_DATA { ts1: question.ts1 + 1, ..answer.clone() };
        assert_eq!(sync.hear(us(1_001_000), stranger, &answer, 0), TimeSyncHeard::Ignored);
        assert_eq!(sync.hear(us(1_001_000), AUTOPILOT, &unasked, 0), TimeSyncHeard::Ignored);
        assert_eq!(sync.offset(), None);
        let measured = sync.hear(us(1_002_000), AUTOPILOT, &answer, 0);
        assert!(matches!(measured, TimeSyncHeard::Measured { .. }));
        // The same answer once more.
        assert_eq!(sync.hear(us(1_003_000), AUTOPILOT, &answer, 0), TimeSyncHeard::Ignored);
        let counters = sync.counters();
        assert_eq!((counters.not_ours, counters.unasked, counters.used), (1, 2, 1));
    }

    #[test]
    fn impossible_answers_are_refused() {
        let mut sync = sync();
        let question = data(sync.poll(us(1_000_000)).unwrap());
        let answer = TIMESYNC_DATA { tc1: -5, ts1: question.ts1, target_system: 0, target_component: 0 };
        sync.hear(us(1_001_000), AUTOPILOT, &answer, 0);
        exchange(&mut sync, 2_000_000, 0, 6_000_000, 6_000_000);
        exchange(&mut sync, 20_000_000, 0, 0, -5);
        assert_eq!((sync.counters().impossible, sync.offset()), (3, None));
    }

    #[test]
    fn a_reboot_is_noticed_within_a_second_and_one_odd_answer_is_not_a_reboot() {
        let mut sync = sync();
        for i in 1..30 {
            exchange(&mut sync, i * 1_000_000, 500_000_000, 1000, 1000);
        }
        assert!(exchange(&mut sync, 31_000_000, 123, 1000, 1000).is_some());
        exchange(&mut sync, 31_200_000, 500_000_000, 1000, 1000);
        assert_eq!((sync.counters().steps, sync.counters().contradictions), (0, 1));
        assert_eq!(sync.offset(), Some(Span::from_micros(500_000_000)));

        let mut stepped = None;
        for ms in 33_000..34_000 {
            if let Some(TimeSyncHeard::Stepped { step }) =
                exchange(&mut sync, ms * 1000, -32_000_000, 1000, 1000)
            {
                stepped = Some((ms, step));
                break;
            }
        }
        let (ms, step) = stepped.expect("the step goes unnoticed");
        assert!(ms < 33_500, "{ms}");
        assert_eq!(step, Span::from_micros(-532_000_000));
        assert_eq!(sync.offset(), Some(Span::from_micros(-32_000_000)));
        assert!(!sync.converged());
    }

    #[test]
    fn a_path_that_becomes_slow_for_good_is_accepted_again() {
        let mut sync = sync();
        for i in 1..40 {
            exchange(&mut sync, i * 1_000_000, 0, 1000, 1000);
        }
        for i in 40..80 {
            exchange(&mut sync, i * 1_000_000, 0, 100_000, 100_000);
        }
        assert_eq!(sync.round_trip(), Some(Span::from_micros(200_000)));
        assert!(sync.converged());
    }

    proptest! {
        #[test]
        fn no_message_panics_or_moves_the_estimate_unasked(
            messages in prop::collection::vec((any::<i64>(), any::<i64>(), any::<u8>(), any::<u8>(), any::<i64>()), 0..50),
        ) {
            let mut sync = sync();
            for i in 1..12 {
                exchange(&mut sync, i * 1_000_000, 42, 500, 500);
            }
            for (tc1, ts1, target_system, target_component, at) in messages {
                let message = TIMESYNC_DATA { tc1, ts1, target_system, target_component };
                sync.hear(us(at), AUTOPILOT, &message, i64::MIN);
                sync.poll(us(at));
            }
            prop_assert_eq!(sync.offset(), Some(Span::from_micros(42)));
        }

        #[test]
        fn hostile_answers_to_real_questions_never_panic(
            answers in prop::collection::vec((any::<i64>(), any::<i64>(), any::<i64>()), 1..40),
        ) {
            let mut sync = sync();
            for (now, later, tc1) in answers {
                if let Some(question) = sync.poll(us(now)) {
                    let answer = TIMESYNC_DATA { tc1, ..data(question) };
                    sync.hear(us(later), AUTOPILOT, &TIMESYNC_DATA { target_component: 0, ..answer }, 0);
                }
            }
        }
    }
}
