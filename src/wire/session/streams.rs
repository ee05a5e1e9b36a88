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
    refusal: RefusalState,
}

/// What was made of denials.
#[derive(Clone, Copy, Debug, Default)]
struct RefusalState {
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
            refusal: RefusalState::default(),
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
            refusal: RefusalState { denials: 0, ..self.refusal },
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
mod tests;
