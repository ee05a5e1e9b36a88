//! Message rates: asks the autopilot for the streams that the navigator needs, and sees that they come.
//!
//! A request that was acknowledged is no stream: autopilots cap rates, round them to what their loop divides into, and other
//! clients of the same link overwrite them. So the rates are measured, and a stream that is too slow is asked for again, with a
//! growing pause and a limit, because some wishes cannot be met (200 Hz of a 250 Hz sensor are 125 Hz).

use mavlink::dialects::ardupilotmega::{COMMAND_ACK_DATA, MavCmd, MavMessage, MavResult};

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
    next_ask: Option<Stamp<Companion>>,
    /// The request whose acknowledgement is awaited: COMMAND_ACK does not say which message it is about.
    waiting: Option<(usize, Stamp<Companion>)>,
}

#[derive(Clone, Debug)]
struct RequestedStream {
    wanted: WantedStream,
    meter: RateMeter,
    asked: u8,
    next_ask: Option<Stamp<Companion>>,
    good_since: Option<Stamp<Companion>>,
    last_result: Option<MavResult>,
    given_up: Option<GaveUp>,
}

impl MessageStreams {
    /// Will ask `autopilot` for each of `wanted`, from the first [`MessageStreams::poll`] on.
    pub fn new(config: StreamsConfig, autopilot: Address, wanted: &[WantedStream]) -> Self {
        let usable = wanted.iter().filter(|w| w.rate_hz.is_finite() && w.rate_hz > 0.0);
        let streams = usable.map(|&w| RequestedStream::new(w)).collect();
        Self { config, autopilot, streams, next_ask: None, waiting: None }
    }

    /// Begins anew, after a reboot or a reconnection: requests are forgotten by then.
    pub fn restart(&mut self) {
        for stream in &mut self.streams {
            *stream = RequestedStream::new(stream.wanted);
        }
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
    pub fn acknowledge(&mut self, us: Address, ack: &COMMAND_ACK_DATA) {
        if ack.command != MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL
            || !us.is_meant_by(ack.target_system, ack.target_component)
        {
            return;
        }
        let Some((index, _)) = self.waiting.take() else { return };
        let Some(stream) = self.streams.get_mut(index) else { return };
        stream.last_result = Some(ack.result);
        // FAILED may be passing (a full queue), so it only decides once the attempts are used up.
        if matches!(ack.result, MavResult::MAV_RESULT_DENIED | MavResult::MAV_RESULT_UNSUPPORTED) {
            stream.given_up = Some(GaveUp::Refused(ack.result));
        }
    }

    /// The request to send now, if one is due.
    pub fn poll(&mut self, now: Stamp<Companion>) -> Option<MavMessage> {
        for stream in &mut self.streams {
            stream.judge(now, &self.config);
        }
        if self.waiting.is_some_and(|(_, sent)| now - sent < self.config.ack_timeout)
            || self.next_ask.is_some_and(|due| now < due)
        {
            return None;
        }
        let index = self.streams.iter().position(|s| s.is_due(now, &self.config))?;
        let stream = self.streams.get_mut(index)?;
        stream.ask(now, &self.config);
        let interval_us = (1e6 / stream.wanted.rate_hz).round();
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
            meter: RateMeter::for_rate(wanted.rate_hz),
            asked: 0,
            next_ask: None,
            good_since: None,
            last_result: None,
            given_up: None,
        }
    }

    fn is_good(&self, now: Stamp<Companion>, config: &StreamsConfig) -> Option<bool> {
        self.meter.rate(now).map(|rate| rate >= config.enough * self.wanted.rate_hz)
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
        StreamReport { wanted: self.wanted, rate_hz, asked: self.asked, verdict }
    }
}

const BUCKETS: usize = 8;

/// Counts events in a sliding window of equal buckets.
#[derive(Clone, Debug)]
struct RateMeter {
    bucket: Span,
    counts: [u32; BUCKETS],
    /// Number of the newest bucket since the clock's zero.
    newest: i64,
    /// Events from here on are counted.
    begun: Option<Stamp<Companion>>,
}

impl RateMeter {
    /// A meter whose window is at least 4 s, and holds 8 events of `rate_hz` at least.
    fn for_rate(rate_hz: f64) -> Self {
        let bucket = Span::from_seconds((1.0 / rate_hz).clamp(0.5, 3600.0));
        Self { bucket, counts: [0; BUCKETS], newest: i64::MIN, begun: None }
    }

    /// Starts anew.
    fn begin(&mut self, now: Stamp<Companion>) {
        self.counts = [0; BUCKETS];
        self.newest = self.number(now);
        self.begun = Some(now);
    }

    fn number(&self, now: Stamp<Companion>) -> i64 {
        now.micros().div_euclid(self.bucket.micros())
    }

    fn slot(number: i64) -> usize {
        usize::try_from(number.rem_euclid(BUCKETS as i64)).unwrap_or(0)
    }

    fn count(&mut self, now: Stamp<Companion>) {
        if self.begun.is_none() {
            self.begin(now);
        }
        let number = self.number(now);
        let ahead = number.saturating_sub(self.newest);
        if ahead < 0 {
            return;
        }
        for step in 1..=ahead.min(BUCKETS as i64) {
            self.counts[Self::slot(number - ahead.min(BUCKETS as i64) + step)] = 0;
        }
        self.newest = number;
        let slot = &mut self.counts[Self::slot(number)];
        *slot = slot.saturating_add(1);
    }

    /// Time from [`RateMeter::begin`] until the rate is known.
    fn settling(&self) -> Span {
        Span::from_micros(self.bucket.micros().saturating_mul(BUCKETS as i64))
    }

    /// Events a second over the complete buckets of the window; `None` before they all were.
    fn rate(&self, now: Stamp<Companion>) -> Option<f64> {
        if now - self.begun? < self.settling() {
            return None;
        }
        // The newest bucket is not complete; of the others, those that `count` did not clear may be outdated.
        let current = self.number(now);
        let sum: u32 = (1..BUCKETS as i64)
            .map(|back| current.saturating_sub(back))
            .filter(|&n| n <= self.newest && n > self.newest.saturating_sub(BUCKETS as i64))
            .map(|n| self.counts[Self::slot(n)])
            .fold(0, u32::saturating_add);
        Some(f64::from(sum) / (self.bucket.seconds() * (BUCKETS - 1) as f64))
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
                    streams.acknowledge(US, &ack(result));
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
        assert_eq!((asked(HIGHRES_IMU), asked(ATTITUDE)), (1, 5));
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
    fn a_restart_asks_for_everything_again() {
        let mut streams =
            MessageStreams::new(StreamsConfig::default(), AUTOPILOT, &wanted(&[(ATTITUDE, 50.0)]));
        let denied = |_, _: f32| Some(MavResult::MAV_RESULT_DENIED);
        assert_eq!(play(&mut streams, 0, 30_000, denied, |_| 0).len(), 1);
        streams.restart();
        assert_eq!(verdicts(&streams, 30_000), [StreamVerdict::Pending]);
        assert_eq!(play(&mut streams, 30_000, 60_000, denied, |_| 0).len(), 1);
    }

    #[test]
    fn acknowledgements_for_others_are_not_ours() {
        let mut streams =
            MessageStreams::new(StreamsConfig::default(), AUTOPILOT, &wanted(&[(ATTITUDE, 50.0)]));
        streams.poll(at(0)).unwrap();
        let other = COMMAND_ACK_DATA { target_component: 190, ..ack(MavResult::MAV_RESULT_DENIED) };
        streams.acknowledge(US, &other);
        let command = MavCmd::MAV_CMD_REQUEST_MESSAGE;
        streams.acknowledge(US, &COMMAND_ACK_DATA { command, ..ack(MavResult::MAV_RESULT_DENIED) });
        assert_eq!(verdicts(&streams, 10), [StreamVerdict::Pending]);
    }

    #[test]
    fn a_rate_falls_to_zero_when_a_stream_stops() {
        let mut meter = RateMeter::for_rate(10.0);
        meter.begin(at(0));
        for ms in (0..10_000).step_by(100) {
            meter.count(at(ms));
        }
        assert!((meter.rate(at(10_000)).unwrap() - 10.0).abs() < 1e-9);
        assert!(meter.rate(at(12_000)).unwrap() < 7.0);
        assert_eq!(meter.rate(at(14_500)), Some(0.0));
        assert_eq!(meter.rate(at(3_600_000)), Some(0.0));
    }

    #[test]
    fn slow_streams_are_measured_over_a_longer_window() {
        let mut meter = RateMeter::for_rate(0.2);
        meter.begin(at(0));
        for s in (0..200).step_by(5) {
            meter.count(at(s * 1000 + 40));
        }
        assert!((meter.rate(at(200_000)).unwrap() - 0.2).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn any_regular_rate_is_measured_to_a_tenth(hz in 2.0f64..400.0, phase_us in 0i64..1_000_000) {
            let mut meter = RateMeter::for_rate(hz);
            meter.begin(Stamp::from_micros(phase_us));
            let step = 1e6 / hz;
            for i in 0..=(hz * 10.0) as i64 {
                meter.count(Stamp::from_micros(phase_us + (i as f64 * step) as i64));
            }
            let rate = meter.rate(Stamp::from_micros(phase_us + 10_000_000)).unwrap();
            prop_assert!((rate - hz).abs() <= 0.15 * hz, "{rate} instead of {hz}");
        }

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
