//! What is asked for, and what is made of the answers.

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
    let mut streams = MessageStreams::new(StreamsConfig::default(), AUTOPILOT, &wanted(&[(ATTITUDE, 50.0)]));
    let accepted = |_, _: f32| Some(MavResult::MAV_RESULT_ACCEPTED);
    assert_eq!(play(&mut streams, 0, 100_000, accepted, |_| 50).len(), 1);
    let again = play(&mut streams, 100_000, 101_500, accepted, |_| 4);
    assert_eq!(again.len(), 1, "{again:?}");
    assert_eq!(play(&mut streams, 101_500, 300_000, accepted, |_| 50).len(), 0);
    assert_eq!(verdicts(&streams, 300_000), [StreamVerdict::Met]);
}

#[test]
fn a_quarrel_with_another_client_ends() {
    let mut streams = MessageStreams::new(StreamsConfig::default(), AUTOPILOT, &wanted(&[(ATTITUDE, 50.0)]));
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
            let result = if refused { MavResult::MAV_RESULT_DENIED } else { MavResult::MAV_RESULT_ACCEPTED };
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
    let mut streams = MessageStreams::new(StreamsConfig::default(), AUTOPILOT, &wanted(&[(ATTITUDE, 50.0)]));
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
    let mut streams = MessageStreams::new(StreamsConfig::default(), AUTOPILOT, &wanted(&[(ATTITUDE, 50.0)]));
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
