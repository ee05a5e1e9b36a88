//! Message rates: asks the autopilot for the streams that the navigator needs, and sees that they come.
//!
//! A request that was acknowledged is no stream: autopilots cap rates, round them to what their loop divides into, and other
//! clients of the same link overwrite them. So the rates are measured, and a stream that is too slow is asked for again, with a
//! growing pause and a limit, because some wishes cannot be met (200 Hz of a 250 Hz sensor are 125 Hz).
//!
//! A refusal is learned from: ArduPilot denies more than 0.8 of SCHED_LOOP_RATE, and tells the pilot each time. So less is asked for, 0.8
//! of it and then half again and again, until something is granted; no other stream is asked for faster than that. A message that is denied at
//! a rate at which others were granted is one that this autopilot does not have. One denial is no refusal (a frame that somebody else has sent
//! looks the same): it takes two, a second apart. And what was refused is asked for again after a minute, then after two, four and so on.

use mavlink::dialects::ardupilotmega::{COMMAND_ACK_DATA, MavCmd, MavMessage, MavResult};

use super::rate_meter::RateMeter;
use super::{Address, command_long};
use crate::time::{Companion, Span, Stamp};

/// A stream that is wanted.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct WantedStream {
    /// Which message.
    pub message_id: u32,
    /// How often a second; above zero, else the stream is left out.
    pub rate_hz: f64,
}

/// Settings of [`MessageStreams`].
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct StreamsConfig {
    /// Time between two requests, of whichever streams.
    pub pace: Span,
    /// How long an acknowledgement is waited for before the next request goes out.
    pub ack_timeout: Span,
    /// A stream is good enough from this fraction of the wanted rate on.
    pub enough: f64,
    /// Requests for one stream before it is given up.
    pub attempts: u8,
    /// Pause after the first request for a stream, on top of the time its rate takes to be measured; doubled each time.
    pub backoff: Span,
    /// A stream that was good for so long has all its attempts again.
    pub forgive: Span,
    /// Pause after a denial.
    pub denied: Span,
    /// Time until what was refused is asked for again; doubled each time.
    pub again: Span,
}

impl Default for StreamsConfig {
    fn default() -> Self {
        Self {
            pace: Span::from_millis(250),
            ack_timeout: Span::from_millis(1000),
            enough: 0.8,
            attempts: 5,
            backoff: Span::from_millis(1000),
            forgive: Span::from_millis(60_000),
            denied: Span::from_millis(1000),
            again: Span::from_millis(60_000),
        }
    }
}

/// Why a stream is no longer asked for.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum GaveUp {
    /// The autopilot refused: denied, unsupported or failed.
    Refused(MavResult),
    /// It was asked for often enough and is still too slow.
    TooSlow,
    /// It was asked for often enough and never came.
    NeverCame,
}

/// How a stream stands.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum StreamVerdict {
    /// Asked for, or about to be; not judged yet, or to be asked for again.
    Pending,
    /// It comes often enough.
    Met,
    /// It does not, and is no longer asked for.
    GivenUp(GaveUp),
}

/// A stream, its measured rate and what to think of it.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct StreamReport {
    /// What is wanted.
    pub wanted: WantedStream,
    /// What is asked for instead, Hz, where more was refused; and whether that was granted.
    pub reduced: Option<(f64, bool)>,
    /// The measured rate in Hz; `None` before there was time to measure it.
    pub rate_hz: Option<f64>,
    /// How often it was asked for since the (re)start.
    pub asked: u8,
    /// How it stands.
    pub verdict: StreamVerdict,
}

/// Asks for streams and measures them.
#[derive(Clone, Debug)]
pub struct MessageStreams {
    config: StreamsConfig,
    autopilot: Address,
    streams: Vec<RequestedStream>,
    limit: RateLimit,
    next_ask: Option<Stamp<Companion>>,
    /// The request whose acknowledgement is awaited: COMMAND_ACK does not say which message it is about.
    waiting: Option<(usize, Stamp<Companion>)>,
}

/// What the autopilot's answers tell of the fastest rate that it sends.
#[derive(Clone, Copy, Debug, Default)]
struct RateLimit {
    /// The fastest that was granted, Hz.
    granted_hz: Option<f64>,
    /// Whether a rate was refused, and not a message.
    refused: bool,
}

impl RateLimit {
    /// The rate to ask for instead of `rate_hz`.
    fn allowed(&self, rate_hz: f64) -> f64 {
        self.granted_hz.filter(|_| self.refused).map_or(rate_hz, |most| rate_hz.min(most))
    }
}

/// Denials in a row that make a refusal.
const DENIALS: u8 = 2;
/// An answer that comes later is none.
const ANSWERED_WITHIN: Span = Span::from_millis(5000);
/// First reduction of a rate that was refused (ArduPilot sends at most this part of its loop's rate), and the next ones.
const FIRST_REDUCTION: f64 = 0.8;
const NEXT_REDUCTION: f64 = 0.5;
/// A stream is not asked for at less than this part of what is wanted.
const LEAST_PART: f64 = 0.1;

#[derive(Clone, Debug)]
struct RequestedStream {
    wanted: WantedStream,
    /// What is asked for, Hz: `wanted`, or less where that was refused.
    rate_hz: f64,
    /// The slowest rate that was refused, Hz.
    refused_hz: Option<f64>,
    meter: RateMeter,
    asked: u8,
    next_ask: Option<Stamp<Companion>>,
    good_since: Option<Stamp<Companion>>,
    last_result: Option<MavResult>,
    given_up: Option<GaveUp>,
    refusal: Refused,
}

/// What was made of denials.
#[derive(Clone, Copy, Debug, Default)]
struct Refused {
    /// In a row.
    denials: u8,
    /// When it is asked for again, and how often it was already.
    again: Option<Stamp<Companion>>,
    times: u8,
    /// It is asked for again; the rate that was in force before, Hz, if any was.
    retried: Option<Option<f64>>,
}

impl MessageStreams {
    /// Will ask `autopilot` for each of `wanted`, from the first [`MessageStreams::poll`] on.
    pub fn new(config: StreamsConfig, autopilot: Address, wanted: &[WantedStream]) -> Self {
        let usable = wanted.iter().filter(|w| w.rate_hz.is_finite() && w.rate_hz > 0.0);
        let streams = usable.map(|&w| RequestedStream::new(w)).collect();
        Self { config, autopilot, streams, limit: RateLimit::default(), next_ask: None, waiting: None }
    }

    /// Begins anew after a reconnection: the requests may be forgotten by then, but not what was refused.
    pub fn restart(&mut self) {
        for stream in &mut self.streams {
            *stream = stream.anew();
        }
        self.next_ask = None;
        self.waiting = None;
    }

    /// The autopilot rebooted, and may grant what it refused before.
    pub fn reboot(&mut self) {
        for stream in &mut self.streams {
            *stream = RequestedStream::new(stream.wanted);
        }
        self.limit = RateLimit::default();
        self.next_ask = None;
        self.waiting = None;
    }

    /// Wants one more stream; one that is wanted already is left as it is.
    pub fn want(&mut self, wanted: WantedStream) {
        let known = self.streams.iter().any(|s| s.wanted.message_id == wanted.message_id);
        if !known && wanted.rate_hz.is_finite() && wanted.rate_hz > 0.0 {
            self.streams.push(RequestedStream::new(wanted));
        }
    }

    /// Takes note that the autopilot sent message `message_id`.
    pub fn hear(&mut self, now: Stamp<Companion>, message_id: u32) {
        for stream in self.streams.iter_mut().filter(|s| s.wanted.message_id == message_id) {
            stream.meter.count(now);
        }
    }

    /// Takes note of the autopilot's answer to a request of `us`.
    pub fn acknowledge(&mut self, now: Stamp<Companion>, us: Address, ack: &COMMAND_ACK_DATA) {
        if ack.command != MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL
            || !us.is_meant_by(ack.target_system, ack.target_component)
        {
            return;
        }
        let Some((index, _)) = self.waiting.take().filter(|(_, sent)| now - *sent <= ANSWERED_WITHIN) else {
            return;
        };
        let Some(stream) = self.streams.get_mut(index) else { return };
        stream.last_result = Some(ack.result);
        // FAILED may be passing (a full queue), so it only decides once the attempts are used up.
        match ack.result {
            MavResult::MAV_RESULT_ACCEPTED => {
                let most = self.limit.granted_hz.unwrap_or(0.0).max(stream.rate_hz);
                self.limit.granted_hz = Some(most);
                stream.refusal.denials = 0;
                stream.refusal.retried = None;
            }
            MavResult::MAV_RESULT_UNSUPPORTED | MavResult::MAV_RESULT_DENIED => {
                stream.denied(now, ack.result, &mut self.limit, &self.config);
                if stream.refusal.denials > 0 {
                    // What is granted to others meanwhile tells nothing of this one.
                    self.next_ask = Some(now + self.config.denied);
                }
            }
            _ => {}
        }
    }

    /// The request to send now, if one is due.
    pub fn poll(&mut self, now: Stamp<Companion>) -> Option<MavMessage> {
        for stream in &mut self.streams {
            stream.judge(now, &self.config);
            stream.retry(now);
        }
        if self.waiting.is_some_and(|(_, sent)| now - sent < self.config.ack_timeout)
            || self.next_ask.is_some_and(|due| now < due)
        {
            return None;
        }
        let index = self.streams.iter().position(|s| s.is_due(now, &self.config))?;
        let stream = self.streams.get_mut(index)?;
        if stream.refusal.retried.is_none() {
            stream.reduce(self.limit.allowed(stream.rate_hz));
        }
        stream.ask(now, &self.config);
        let interval_us = (1e6 / stream.rate_hz).round();
        let id = stream.wanted.message_id as f32;
        self.waiting = Some((index, now));
        self.next_ask = Some(now + self.config.pace);
        let command = MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL;
        Some(command_long(self.autopilot, command, id, interval_us as f32))
    }

    /// How each stream stands, in the order they were wanted.
    pub fn reports(&self, now: Stamp<Companion>) -> impl Iterator<Item = StreamReport> + '_ {
        self.streams.iter().map(move |s| s.report(now, &self.config))
    }
}

impl RequestedStream {
    fn new(wanted: WantedStream) -> Self {
        Self {
            wanted,
            rate_hz: wanted.rate_hz,
            refused_hz: None,
            meter: RateMeter::for_rate(wanted.rate_hz),
            asked: 0,
            next_ask: None,
            good_since: None,
            last_result: None,
            given_up: None,
            refusal: Refused::default(),
        }
    }

    /// As at first, but for what was refused.
    fn anew(&self) -> Self {
        let refused = matches!(
            self.given_up,
            Some(GaveUp::Refused(MavResult::MAV_RESULT_DENIED | MavResult::MAV_RESULT_UNSUPPORTED))
        );
        Self {
            rate_hz: self.rate_hz,
            refused_hz: self.refused_hz,
            meter: RateMeter::for_rate(self.rate_hz),
            given_up: self.given_up.filter(|_| refused),
            refusal: Refused { denials: 0, ..self.refusal },
            ..Self::new(self.wanted)
        }
    }

    /// Asks for this rate from now on.
    fn reduce(&mut self, rate_hz: f64) {
        if rate_hz < self.rate_hz {
            self.rate_hz = rate_hz;
            self.meter = RateMeter::for_rate(rate_hz);
        }
    }

    /// The request was denied.
    fn denied(
        &mut self,
        now: Stamp<Companion>,
        result: MavResult,
        limit: &mut RateLimit,
        config: &StreamsConfig,
    ) {
        self.refusal.denials += 1;
        if let Some(before_hz) = self.refusal.retried.take() {
            // It was refused before: everything is as it was then.
            self.refusal.denials = 0;
            match before_hz {
                Some(hz) => self.reduce(hz),
                None => self.given_up = Some(GaveUp::Refused(result)),
            }
        } else if self.refusal.denials < DENIALS {
            self.asked = 0;
            self.next_ask = Some(now + config.denied);
            return;
        } else {
            self.refusal.denials = 0;
            match result {
                MavResult::MAV_RESULT_DENIED => self.refused(limit),
                _ => self.given_up = Some(GaveUp::Refused(result)),
            }
        }
        let doubled = config.again.micros().saturating_mul(1 << self.refusal.times.min(10));
        self.refusal.again = Some(now + Span::from_micros(doubled));
    }

    /// What was refused is asked for again when it is time: the present rate stays until it is granted.
    fn retry(&mut self, now: Stamp<Companion>) {
        if self.refusal.again.is_none_or(|due| now < due) {
            return;
        }
        self.refusal.again = None;
        self.refusal.times = self.refusal.times.saturating_add(1);
        self.refusal.retried = Some(self.given_up.is_none().then_some(self.rate_hz));
        self.given_up = None;
        self.rate_hz = self.wanted.rate_hz;
        self.meter = RateMeter::for_rate(self.rate_hz);
        self.asked = 0;
        self.next_ask = None;
    }

    /// It is refused: for its rate, or for the message.
    fn refused(&mut self, limit: &mut RateLimit) {
        let reduction = if self.refused_hz.is_none() { FIRST_REDUCTION } else { NEXT_REDUCTION };
        let next = self.rate_hz * reduction;
        self.refused_hz = Some(self.rate_hz);
        if limit.granted_hz.is_some_and(|granted| granted >= self.rate_hz)
            || next < LEAST_PART * self.wanted.rate_hz
        {
            self.given_up = Some(GaveUp::Refused(MavResult::MAV_RESULT_DENIED));
            return;
        }
        limit.refused = true;
        self.reduce(next);
        // Another request, not one more of the same.
        self.asked = 0;
        self.next_ask = None;
    }

    fn is_good(&self, now: Stamp<Companion>, config: &StreamsConfig) -> Option<bool> {
        self.meter.rate(now).map(|rate| rate >= config.enough * self.rate_hz)
    }

    fn judge(&mut self, now: Stamp<Companion>, config: &StreamsConfig) {
        if self.is_good(now, config) != Some(true) {
            self.good_since = None;
            return;
        }
        let since = *self.good_since.get_or_insert(now);
        if now - since >= config.forgive {
            self.asked = 1;
            self.given_up = None;
            self.next_ask = Some(now);
        }
    }

    fn is_due(&self, now: Stamp<Companion>, config: &StreamsConfig) -> bool {
        if self.given_up.is_some() || self.next_ask.is_some_and(|due| now < due) {
            return false;
        }
        self.asked == 0 || (self.asked < config.attempts && self.is_good(now, config) == Some(false))
    }

    fn ask(&mut self, now: Stamp<Companion>, config: &StreamsConfig) {
        let doubled = config.backoff.micros().saturating_mul(1 << self.asked.min(16));
        self.asked = self.asked.saturating_add(1);
        self.meter.begin(now);
        self.next_ask = Some(now + self.meter.settling() + Span::from_micros(doubled));
    }

    fn report(&self, now: Stamp<Companion>, config: &StreamsConfig) -> StreamReport {
        let rate_hz = self.meter.rate(now);
        let used_up = self.asked >= config.attempts && self.next_ask.is_some_and(|due| now >= due);
        let verdict = match (self.is_good(now, config), self.given_up) {
            (Some(true), _) => StreamVerdict::Met,
            (_, Some(reason)) => StreamVerdict::GivenUp(reason),
            (Some(false), None) if used_up => StreamVerdict::GivenUp(match self.last_result {
                Some(result @ MavResult::MAV_RESULT_FAILED) => GaveUp::Refused(result),
                _ if rate_hz.is_some_and(|r| r > 0.0) => GaveUp::TooSlow,
                _ => GaveUp::NeverCame,
            }),
            _ => StreamVerdict::Pending,
        };
        let granted = self.last_result == Some(MavResult::MAV_RESULT_ACCEPTED);
        let reduced = (self.rate_hz < self.wanted.rate_hz).then_some((self.rate_hz, granted));
        StreamReport { wanted: self.wanted, reduced, rate_hz, asked: self.asked, verdict }
    }
}

#[cfg(test)]
mod tests {
    use mavlink::MessageData;
    use mavlink::dialects::ardupilotmega as apm;
    use proptest::prelude::*;

    use super::*;
    use crate::wire::frame::{ComponentId, SystemId};

    const US: Address = Address { system: SystemId(1), component: ComponentId(197) };
    const AUTOPILOT: Address = Address { system: SystemId(1), component: ComponentId(1) };
    const HIGHRES_IMU: u32 = apm::HIGHRES_IMU_DATA::ID;
    const ATTITUDE: u32 = apm::ATTITUDE_DATA::ID;

    fn at(ms: i64) -> Stamp<Companion> {
        Stamp::from_micros(ms * 1000)
    }

    fn ack(result: MavResult) -> COMMAND_ACK_DATA {
        COMMAND_ACK_DATA {
            command: MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL,
            result,
            progress: 0,
            result_param2: 0,
            target_system: 1,
            target_component: 197,
        }
    }

    fn wanted(rates: &[(u32, f64)]) -> Vec<WantedStream> {
        rates.iter().map(|&(message_id, rate_hz)| WantedStream { message_id, rate_hz }).collect()
    }

    /// Polls every 10 ms from `from` to `to` (ms); `autopilot` is called with each request and returns its answer, `rate`
    /// gives what is sent in Hz. Returns the requests with their times.
    fn play(
        streams: &mut MessageStreams,
        from: i64,
        to: i64,
        mut autopilot: impl FnMut(u32, f32) -> Option<MavResult>,
        rate: impl Fn(u32) -> i64,
    ) -> Vec<(i64, u32)> {
        let mut requests = Vec::new();
        for ms in from..to {
            for id in [HIGHRES_IMU, ATTITUDE] {
                let hz = rate(id);
                if hz > 0 && ms % (1000 / hz) == 0 {
                    streams.hear(at(ms), id);
                }
            }
            if ms % 10 != 0 {
                continue;
            }
            if let Some(MavMessage::COMMAND_LONG(command)) = streams.poll(at(ms)) {
                assert_eq!(command.command, MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL);
                let id = command.param1 as u32;
                requests.push((ms, id));
                if let Some(result) = autopilot(id, command.param2) {
                    streams.acknowledge(at(ms), US, &ack(result));
                }
            }
        }
        requests
    }

    fn verdicts(streams: &MessageStreams, ms: i64) -> Vec<StreamVerdict> {
        streams.reports(at(ms)).map(|r| r.verdict).collect()
    }

    #[test]
    fn each_stream_is_asked_for_once_if_it_comes() {
        let mut streams = MessageStreams::new(
            StreamsConfig::default(),
            AUTOPILOT,
            &wanted(&[(HIGHRES_IMU, 100.0), (ATTITUDE, 50.0)]),
        );
        let requests = play(
            &mut streams,
            0,
            300_000,
            |id, interval| {
                assert_eq!(interval, if id == HIGHRES_IMU { 10_000.0 } else { 20_000.0 });
                Some(MavResult::MAV_RESULT_ACCEPTED)
            },
            |id| if id == HIGHRES_IMU { 100 } else { 50 },
        );
        assert_eq!(requests, [(0, HIGHRES_IMU), (250, ATTITUDE)]);
        assert_eq!(verdicts(&streams, 300_000), [StreamVerdict::Met; 2]);
        let rates: Vec<f64> = streams.reports(at(300_000)).map(|r| r.rate_hz.unwrap()).collect();
        assert!((rates[0] - 100.0).abs() < 1.0 && (rates[1] - 50.0).abs() < 1.0, "{rates:?}");
    }

    #[test]
    fn a_wish_that_cannot_be_met_is_given_up() {
        let mut streams =
            MessageStreams::new(StreamsConfig::default(), AUTOPILOT, &wanted(&[(HIGHRES_IMU, 200.0)]));
        let requests = play(&mut streams, 0, 600_000, |_, _| Some(MavResult::MAV_RESULT_ACCEPTED), |_| 125);
        assert_eq!(requests.len(), 5, "{requests:?}");
        let pauses: Vec<i64> = requests.windows(2).map(|w| w[1].0 - w[0].0).collect();
        assert!(pauses.windows(2).all(|w| w[1] > w[0]), "pauses do not grow: {pauses:?}");
        let report = streams.reports(at(600_000)).next().unwrap();
        assert_eq!(report.verdict, StreamVerdict::GivenUp(GaveUp::TooSlow));
        assert!((report.rate_hz.unwrap() - 125.0).abs() < 1.0);
    }

    #[test]
    fn refusals_end_it_and_silence_ends_it_after_all_attempts() {
        let mut streams = MessageStreams::new(
            StreamsConfig::default(),
            AUTOPILOT,
            &wanted(&[(HIGHRES_IMU, 50.0), (ATTITUDE, 50.0)]),
        );
        let answer = |id, _: f32| (id == HIGHRES_IMU).then_some(MavResult::MAV_RESULT_UNSUPPORTED);
        let requests = play(&mut streams, 0, 600_000, answer, |_| 0);
        let asked = |id| requests.iter().filter(|r| r.1 == id).count();
        // Twice, and then after one, two and four minutes.
        assert_eq!((asked(HIGHRES_IMU), asked(ATTITUDE)), (5, 5));
        let refused = GaveUp::Refused(MavResult::MAV_RESULT_UNSUPPORTED);
        let expected = [StreamVerdict::GivenUp(refused), StreamVerdict::GivenUp(GaveUp::NeverCame)];
        assert_eq!(verdicts(&streams, 600_000), expected);
    }

    #[test]
    fn a_rate_that_another_client_overwrites_is_asked_for_again() {
        let mut streams =
            MessageStreams::new(StreamsConfig::default(), AUTOPILOT, &wanted(&[(ATTITUDE, 50.0)]));
        let accepted = |_, _: f32| Some(MavResult::MAV_RESULT_ACCEPTED);
        assert_eq!(play(&mut streams, 0, 100_000, accepted, |_| 50).len(), 1);
        let again = play(&mut streams, 100_000, 101_500, accepted, |_| 4);
        assert_eq!(again.len(), 1, "{again:?}");
        assert_eq!(play(&mut streams, 101_500, 300_000, accepted, |_| 50).len(), 0);
        assert_eq!(verdicts(&streams, 300_000), [StreamVerdict::Met]);
    }

    #[test]
    fn a_quarrel_with_another_client_ends() {
        let mut streams =
            MessageStreams::new(StreamsConfig::default(), AUTOPILOT, &wanted(&[(ATTITUDE, 50.0)]));
        let accepted = |_, _: f32| Some(MavResult::MAV_RESULT_ACCEPTED);
        let mut requests = 0;
        // The other one wins every 20 s.
        for round in 0..60 {
            let t = round * 20_000;
            requests += play(&mut streams, t, t + 10_000, accepted, |_| 50).len();
            requests += play(&mut streams, t + 10_000, t + 20_000, accepted, |_| 4).len();
        }
        assert!(requests <= 5, "{requests}");
    }

    #[test]
    fn requests_keep_their_pace_and_wait_for_an_acknowledgement() {
        let many: Vec<(u32, f64)> = (0..12).map(|i| (200 + i, 10.0)).collect();
        let mut streams = MessageStreams::new(StreamsConfig::default(), AUTOPILOT, &wanted(&many));
        let requests = play(&mut streams, 0, 20_000, |_, _| None, |_| 0);
        assert!(requests.windows(2).all(|w| w[1].0 - w[0].0 >= 1000), "{requests:?}");
        let mut streams = MessageStreams::new(StreamsConfig::default(), AUTOPILOT, &wanted(&many));
        let requests = play(&mut streams, 0, 3000, |_, _| Some(MavResult::MAV_RESULT_ACCEPTED), |_| 0);
        assert_eq!(requests.len(), 12);
        assert!(requests.windows(2).all(|w| w[1].0 - w[0].0 >= 250), "{requests:?}");
    }

    #[test]
    fn a_restart_asks_again_but_for_what_was_refused_and_a_reboot_for_everything() {
        let all = wanted(&[(HIGHRES_IMU, 100.0), (ATTITUDE, 50.0)]);
        let mut streams = MessageStreams::new(StreamsConfig::default(), AUTOPILOT, &all);
        let answer = |id, _: f32| {
            Some(if id == ATTITUDE { MavResult::MAV_RESULT_DENIED } else { MavResult::MAV_RESULT_ACCEPTED })
        };
        let rate = |id| if id == HIGHRES_IMU { 100 } else { 0 };
        assert_eq!(play(&mut streams, 0, 30_000, answer, rate).len(), 3);
        streams.restart();
        let again = play(&mut streams, 30_000, 60_000, answer, rate);
        assert_eq!(again.iter().map(|r| r.1).collect::<Vec<_>>(), [HIGHRES_IMU]);
        streams.reboot();
        assert_eq!(verdicts(&streams, 60_000), [StreamVerdict::Pending; 2]);
        assert_eq!(play(&mut streams, 60_000, 90_000, answer, rate).len(), 3);
    }

    /// An ArduPilot that sends at most `most_hz` and has no `unknown`: the requests, as (id, Hz).
    fn asked_of(most_hz: f32, unknown: u32) -> (Vec<(u32, i64)>, MessageStreams) {
        let all = wanted(&[(HIGHRES_IMU, 200.0), (ATTITUDE, 50.0), (100, 50.0), (106, 50.0), (32, 10.0)]);
        let mut streams = MessageStreams::new(StreamsConfig::default(), AUTOPILOT, &all);
        let mut asked = Vec::new();
        for ms in (0..600_000).step_by(10) {
            if let Some(MavMessage::COMMAND_LONG(c)) = streams.poll(at(ms)) {
                let (id, hz) = (c.param1 as u32, 1e6 / c.param2);
                asked.push((id, hz.round() as i64));
                let refused = hz > most_hz + 0.5 || id == unknown;
                let result =
                    if refused { MavResult::MAV_RESULT_DENIED } else { MavResult::MAV_RESULT_ACCEPTED };
                streams.acknowledge(at(ms), US, &ack(result));
            }
            // Whatever was granted comes.
            for report in streams.reports(at(ms)).collect::<Vec<_>>() {
                let hz = report.reduced.map_or(report.wanted.rate_hz, |r| r.0);
                let granted = report.reduced.is_none_or(|r| r.1) && f64::from(most_hz) + 0.5 > hz;
                if granted && report.wanted.message_id != unknown && ms % (1000.0 / hz) as i64 / 10 == 0 {
                    streams.hear(at(ms), report.wanted.message_id);
                }
            }
        }
        (asked, streams)
    }

    #[test]
    fn a_refused_rate_is_learned_from_and_never_asked_for_again() {
        // A plane whose SCHED_LOOP_RATE is 50, without OPTICAL_FLOW_RAD.
        let (asked, streams) = asked_of(40.0, 106);
        let imu: Vec<i64> = asked.iter().filter(|a| a.0 == HIGHRES_IMU).map(|a| a.1).collect();
        // Each rate twice; and what is wanted after one, two and four minutes.
        assert_eq!(imu, [200, 200, 160, 160, 80, 80, 40, 200, 200, 200]);
        // Nothing else is asked for faster than that meanwhile, and what is denied all the same is not there.
        let others = asked.iter().filter(|a| a.0 != HIGHRES_IMU && a.1 > 40).count();
        assert!(others <= 6, "{asked:?}");
        assert_eq!(asked.iter().filter(|a| a.0 == 106).count(), 5, "{asked:?}");
        let reports: Vec<StreamReport> = streams.reports(at(600_000)).collect();
        assert_eq!(reports[0].reduced.map(|r| r.0), Some(40.0));
        let denied = StreamVerdict::GivenUp(GaveUp::Refused(MavResult::MAV_RESULT_DENIED));
        assert_eq!((reports[3].verdict, reports[4].reduced), (denied, None));
    }

    #[test]
    fn an_autopilot_that_refuses_everything_is_left_in_peace() {
        let (asked, _) = asked_of(0.0, 0);
        let imu: Vec<i64> = asked.iter().filter(|a| a.0 == HIGHRES_IMU).map(|a| a.1).collect();
        assert_eq!(imu, [200, 200, 160, 160, 80, 80, 40, 40, 20, 20, 200, 200, 200]);
    }

    #[test]
    fn one_denial_ends_no_stream() {
        let all = wanted(&[(HIGHRES_IMU, 200.0), (ATTITUDE, 50.0)]);
        for denial in [MavResult::MAV_RESULT_DENIED, MavResult::MAV_RESULT_UNSUPPORTED] {
            let mut streams = MessageStreams::new(StreamsConfig::default(), AUTOPILOT, &all);
            // The first answer to each is somebody else's.
            let mut denied = Vec::new();
            let answer = |id, _: f32| {
                let first = !denied.contains(&id);
                denied.push(id);
                Some(if first { denial } else { MavResult::MAV_RESULT_ACCEPTED })
            };
            let rate = |id| if id == HIGHRES_IMU { 200 } else { 50 };
            let requests = play(&mut streams, 0, 200_000, answer, rate);
            assert_eq!(requests.len(), 4, "{requests:?}");
            assert_eq!(verdicts(&streams, 200_000), [StreamVerdict::Met; 2]);
            assert!(streams.reports(at(200_000)).all(|r| r.reduced.is_none()));
        }
    }

    #[test]
    fn what_was_refused_is_asked_for_again_and_may_be_granted() {
        let all = wanted(&[(HIGHRES_IMU, 200.0)]);
        let mut streams = MessageStreams::new(StreamsConfig::default(), AUTOPILOT, &all);
        let denied = |_, _: f32| Some(MavResult::MAV_RESULT_UNSUPPORTED);
        assert_eq!(play(&mut streams, 0, 60_000, denied, |_| 0).len(), 2);
        let granted = |_, _: f32| Some(MavResult::MAV_RESULT_ACCEPTED);
        let again = play(&mut streams, 60_000, 80_000, granted, |_| 200);
        assert_eq!((again.len(), again[0].0 / 1000), (1, 61));
        assert_eq!(verdicts(&streams, 80_000), [StreamVerdict::Met]);
    }

    #[test]
    fn an_answer_to_nothing_changes_nothing() {
        let mut streams =
            MessageStreams::new(StreamsConfig::default(), AUTOPILOT, &wanted(&[(ATTITUDE, 50.0)]));
        for ms in 0..1000 {
            streams.acknowledge(at(ms), US, &ack(MavResult::MAV_RESULT_UNSUPPORTED));
        }
        assert!(streams.poll(at(1000)).is_some());
        for ms in 7000..8000 {
            streams.acknowledge(at(ms), US, &ack(MavResult::MAV_RESULT_UNSUPPORTED));
        }
        assert!(!matches!(verdicts(&streams, 8000)[0], StreamVerdict::GivenUp(_)));
    }

    #[test]
    fn acknowledgements_for_others_are_not_ours() {
        let mut streams =
            MessageStreams::new(StreamsConfig::default(), AUTOPILOT, &wanted(&[(ATTITUDE, 50.0)]));
        streams.poll(at(0)).unwrap();
        let other = COMMAND_ACK_DATA { target_component: 190, ..ack(MavResult::MAV_RESULT_DENIED) };
        streams.acknowledge(at(10), US, &other);
        let command = MavCmd::MAV_CMD_REQUEST_MESSAGE;
        streams.acknowledge(at(10), US, &COMMAND_ACK_DATA { command, ..ack(MavResult::MAV_RESULT_DENIED) });
        assert_eq!(verdicts(&streams, 10), [StreamVerdict::Pending]);
    }

    proptest! {
        #[test]
        fn stamps_in_any_order_never_panic(stamps in prop::collection::vec(any::<i64>(), 0..60)) {
            let mut streams = MessageStreams::new(StreamsConfig::default(), AUTOPILOT, &wanted(&[(ATTITUDE, 50.0), (1, f64::NAN)]));
            for us in stamps {
                streams.hear(Stamp::from_micros(us), ATTITUDE);
                streams.poll(Stamp::from_micros(us));
                streams.reports(Stamp::from_micros(us)).count();
            }
        }
    }
}
