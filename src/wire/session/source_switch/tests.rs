//! When the set is switched, by whom, and what is made of the answers.

use super::*;
use crate::time::AutopilotTime;
use crate::wire::frame::{ComponentId, SystemId};

const US: Address = Address { system: SystemId(1), component: ComponentId(197) };
const AUTOPILOT: Address = Address { system: SystemId(1), component: ComponentId(1) };

const SETTINGS: SwitchSettings = SwitchSettings {
    by: SwitchedBy::Holdover,
    sets: SourceSets { gnss: 1, external: 2 },
    min_quality: 10,
    return_after_s: 5.0,
    return_within_m: 3.0,
};

fn inputs(mode: Mode) -> SwitchInputs {
    SwitchInputs {
        mode,
        quality: Some(90),
        received: true,
        standing: StandsOn::Gnss,
        set: Some(1),
        departure: Some(Departure { time: AutopilotTime::from_micros(0), horizontal_m: 0.2, allowed_m: 2.0 }),
    }
}

fn on_ours(mode: Mode) -> SwitchInputs {
    SwitchInputs { standing: StandsOn::Ours, set: Some(2), ..inputs(mode) }
}

fn switch(by: SwitchedBy) -> SourceSwitch {
    SourceSwitch::new(SwitchSettings { by, ..SETTINGS }, US, AUTOPILOT)
}

fn ack(result: MavResult) -> COMMAND_ACK_DATA {
    COMMAND_ACK_DATA {
        command: MavCmd::MAV_CMD_SET_EKF_SOURCE_SET,
        result,
        target_system: 1,
        target_component: 197,
        ..Default::default()
    }
}

/// The sets commanded with their time, ms, and what was told, polling every 50 ms.
fn play(
    switch: &mut SourceSwitch,
    (from, to): (i64, i64),
    inputs: &SwitchInputs,
) -> (Vec<(i64, u8)>, Vec<SwitchNews>) {
    let (mut commands, mut news) = (Vec::new(), Vec::new());
    for ms in (from..to).step_by(50) {
        let poll = switch.poll(Stamp::from_micros(ms * 1000), inputs);
        if let Some(MavMessage::COMMAND_LONG(c)) = poll.command {
            assert_eq!(c.command, MavCmd::MAV_CMD_SET_EKF_SOURCE_SET);
            assert_eq!((c.target_system, c.target_component), (1, 1));
            commands.push((ms, c.param1 as u8));
        }
        news.extend(poll.news);
    }
    (commands, news)
}

#[test]
fn over_at_the_decision_and_back_when_gnss_has_been_good() {
    let mut s = switch(SwitchedBy::Holdover);
    assert_eq!(play(&mut s, (0, 10_000), &inputs(Mode::Aided)), (vec![], vec![]));
    let (commands, _) = play(&mut s, (10_000, 10_100), &inputs(Mode::Holdover));
    assert_eq!(commands, [(10_000, 2)]);
    assert_eq!(s.acknowledge(&ack(MavResult::MAV_RESULT_ACCEPTED)), Some(2));
    assert_eq!(play(&mut s, (10_100, 60_000), &on_ours(Mode::Holdover)), (vec![(10_700, 2)], vec![]));
    assert_eq!(play(&mut s, (60_000, 70_000), &on_ours(Mode::Rejoining)), (vec![], vec![]));
    let (commands, _) = play(&mut s, (70_000, 75_100), &on_ours(Mode::Aided));
    assert_eq!(commands, [(75_000, 1)]);
    assert_eq!(s.acknowledge(&ack(MavResult::MAV_RESULT_ACCEPTED)), Some(1));
    assert_eq!(play(&mut s, (75_100, 90_000), &inputs(Mode::Aided)), (vec![(75_700, 1)], vec![]));
    let (commands, _) = play(&mut s, (90_000, 90_100), &inputs(Mode::Holdover));
    assert_eq!(commands, [(90_000, 2)], "the next outage");
}

#[test]
fn an_autopilot_that_does_not_answer_is_asked_five_times_and_the_pilot_told() {
    let mut s = switch(SwitchedBy::Holdover);
    let (commands, news) = play(&mut s, (0, 20_000), &inputs(Mode::Holdover));
    assert_eq!(commands, [(0, 2), (700, 2), (1400, 2), (2100, 2), (2800, 2)]);
    assert_eq!(news, [SwitchNews::NotSwitched(2, WhyNot::NoAnswer)]);
    let mut s = switch(SwitchedBy::Holdover);
    play(&mut s, (0, 50), &inputs(Mode::Holdover));
    assert_eq!(s.acknowledge(&ack(MavResult::MAV_RESULT_DENIED)), None);
    // One may be somebody else's; three in a row are its own.
    let (commands, news) = play(&mut s, (50, 750), &inputs(Mode::Holdover));
    assert_eq!((commands, news), (vec![(700, 2)], vec![]));
    s.acknowledge(&ack(MavResult::MAV_RESULT_DENIED));
    s.acknowledge(&ack(MavResult::MAV_RESULT_DENIED));
    assert_eq!(play(&mut s, (750, 1450), &inputs(Mode::Holdover)), (vec![(1400, 2)], vec![]));
    s.acknowledge(&ack(MavResult::MAV_RESULT_DENIED));
    let (commands, news) = play(&mut s, (1450, 61_000), &inputs(Mode::Holdover));
    assert_eq!((commands, news), (vec![], vec![SwitchNews::NotSwitched(2, WhyNot::Refused)]));
    // It is asked again after a minute, while the outage lasts.
    let (commands, _) = play(&mut s, (61_000, 62_000), &inputs(Mode::Holdover));
    assert_eq!(commands, [(61_450, 2)]);
    assert_eq!(s.acknowledge(&ack(MavResult::MAV_RESULT_ACCEPTED)), Some(2));
}

#[test]
fn one_refusal_before_the_answer_changes_nothing() {
    let mut s = switch(SwitchedBy::Holdover);
    play(&mut s, (0, 50), &inputs(Mode::Holdover));
    assert_eq!(s.acknowledge(&ack(MavResult::MAV_RESULT_DENIED)), None);
    assert_eq!(s.acknowledge(&ack(MavResult::MAV_RESULT_ACCEPTED)), Some(2));
    assert_eq!(play(&mut s, (50, 30_000), &on_ours(Mode::Holdover)), (vec![(700, 2)], vec![]));
}

#[test]
fn an_acceptance_in_its_name_is_found_out() {
    // The autopilot refuses, or has not heard the command; somebody else has said that it accepts.
    let mut s = switch(SwitchedBy::Holdover);
    play(&mut s, (0, 50), &inputs(Mode::Holdover));
    assert_eq!(s.acknowledge(&ack(MavResult::MAV_RESULT_ACCEPTED)), Some(2));
    let (commands, _) = play(&mut s, (50, 750), &on_ours(Mode::Holdover));
    assert_eq!(commands, [(700, 2)], "what was not heard is heard now");
    let mut news = Vec::new();
    for ms in [750, 1450, 2150] {
        s.acknowledge(&ack(MavResult::MAV_RESULT_DENIED));
        news.extend(play(&mut s, (ms, ms + 700), &on_ours(Mode::Holdover)).1);
    }
    assert_eq!(news, [SwitchNews::NotSwitched(2, WhyNot::Refused)]);
}

#[test]
fn answers_to_others_are_not_ours() {
    let mut s = switch(SwitchedBy::Holdover);
    play(&mut s, (0, 50), &inputs(Mode::Holdover));
    let accepted = ack(MavResult::MAV_RESULT_ACCEPTED);
    assert_eq!(s.acknowledge(&COMMAND_ACK_DATA { target_system: 255, ..accepted.clone() }), None);
    let other = COMMAND_ACK_DATA { command: MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, ..accepted };
    assert_eq!(s.acknowledge(&other), None);
    let passing = ack(MavResult::MAV_RESULT_TEMPORARILY_REJECTED);
    assert_eq!(s.acknowledge(&passing), None);
    assert_eq!(play(&mut s, (50, 800), &inputs(Mode::Holdover)).0, [(700, 2)], "asked again");
}

#[test]
fn what_is_not_fit_or_not_received_is_not_switched_to() {
    let mut s = switch(SwitchedBy::Holdover);
    for quality in [None, Some(9)] {
        let unfit = SwitchInputs { quality, ..inputs(Mode::Holdover) };
        assert_eq!(play(&mut s, (0, 20_000), &unfit), (vec![], vec![]));
    }
    let deaf = SwitchInputs { received: false, ..inputs(Mode::Holdover) };
    let mut s = switch(SwitchedBy::Holdover);
    let (commands, news) = play(&mut s, (0, 20_000), &deaf);
    assert_eq!((commands, news), (vec![], vec![SwitchNews::NotSwitched(2, WhyNot::NotReceived)]));
}

#[test]
fn an_ekf_without_a_position_is_switched_back() {
    let mut s = switch(SwitchedBy::Holdover);
    play(&mut s, (0, 50), &inputs(Mode::Holdover));
    s.acknowledge(&ack(MavResult::MAV_RESULT_ACCEPTED));
    let lost = SwitchInputs { standing: StandsOn::Nothing, ..on_ours(Mode::Holdover) };
    let (commands, news) = play(&mut s, (50, 1500), &lost);
    assert_eq!((commands, news), (vec![(700, 2), (1100, 1)], vec![SwitchNews::Reverted(1)]));
    assert_eq!(s.acknowledge(&ack(MavResult::MAV_RESULT_ACCEPTED)), Some(1));
    let (commands, news) = play(&mut s, (1500, 30_000), &inputs(Mode::Holdover));
    assert_eq!((commands, news), (vec![(1800, 1)], vec![]), "the other not again");
}

#[test]
fn the_pilots_switch_stands() {
    let mut s = switch(SwitchedBy::Holdover);
    play(&mut s, (0, 50), &inputs(Mode::Holdover));
    s.acknowledge(&ack(MavResult::MAV_RESULT_ACCEPTED));
    let (commands, news) = play(&mut s, (50, 30_000), &inputs(Mode::Holdover));
    assert_eq!((commands, news), (vec![], vec![SwitchNews::PilotSwitched(1)]));
    // A pilot who switches over before the decision also switches back.
    let mut s = switch(SwitchedBy::Holdover);
    assert_eq!(play(&mut s, (0, 30_000), &on_ours(Mode::Holdover)), (vec![], vec![]));
    let (commands, news) = play(&mut s, (30_000, 60_000), &on_ours(Mode::Aided));
    assert_eq!((commands, news), (vec![], vec![SwitchNews::SwitchBack(1)]));
}

#[test]
fn a_pilot_who_switches_is_told_when() {
    let mut s = switch(SwitchedBy::Pilot);
    let (commands, news) = play(&mut s, (0, 20_000), &inputs(Mode::Holdover));
    assert_eq!((commands, news), (vec![], vec![SwitchNews::SwitchOver(2), SwitchNews::SwitchSoon(2)]));
    let mut s = switch(SwitchedBy::Pilot);
    assert_eq!(play(&mut s, (0, 3000), &inputs(Mode::Holdover)).1, [SwitchNews::SwitchOver(2)]);
    assert_eq!(play(&mut s, (3000, 20_000), &on_ours(Mode::Holdover)).1, [], "he has");
    assert_eq!(play(&mut s, (20_000, 40_000), &on_ours(Mode::Aided)).1, [SwitchNews::SwitchBack(1)]);
}

#[test]
fn an_autopilot_far_from_ours_is_waited_for_and_not_for_ever() {
    let mut s = switch(SwitchedBy::Holdover);
    play(&mut s, (0, 50), &inputs(Mode::Holdover));
    s.acknowledge(&ack(MavResult::MAV_RESULT_ACCEPTED));
    let far = Departure { time: AutopilotTime::from_micros(0), horizontal_m: 43.0, allowed_m: 9.0 };
    let far = SwitchInputs { departure: Some(far), ..on_ours(Mode::Aided) };
    let (commands, _) = play(&mut s, (1000, 36_100), &far);
    assert_eq!(commands, [(1000, 2), (36_000, 1)]);
}

#[test]
fn words_to_the_pilot_are_short() {
    let why = [WhyNot::NotReceived, WhyNot::NoAnswer, WhyNot::Refused];
    let mut all: Vec<SwitchNews> = why.into_iter().map(|w| SwitchNews::NotSwitched(2, w)).collect();
    all.extend([SwitchNews::Switched(2, None), SwitchNews::Switched(2, Some(1234.5))]);
    all.extend([SwitchNews::Reverted(1), SwitchNews::PilotSwitched(1), SwitchNews::SwitchBack(1)]);
    all.extend([SwitchNews::SwitchOver(2), SwitchNews::SwitchSoon(2)]);
    assert!(all.iter().all(|n| n.to_string().len() <= 40), "{all:?}");
}
