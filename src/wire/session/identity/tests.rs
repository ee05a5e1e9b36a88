//! Who is chosen, who is not, and what it takes to change that.

use mavlink::dialects::ardupilotmega::MavProtocolCapability;

use super::super::heartbeat_fields::testing::{frame_of, heartbeat_frame};
use super::*;
use crate::wire::frame_bytes::FrameBytes;

fn at(ms: i64) -> Stamp<Companion> {
    Stamp::from_micros(ms * 1000)
}

fn hear(identity: &mut Identity, ms: i64, bytes: &FrameBytes) -> (Sender, Option<IdentityEvent>) {
    identity.hear(at(ms), &bytes.frame().unwrap())
}

fn version(system: u8, packed: u32) -> FrameBytes {
    let data = AUTOPILOT_VERSION_DATA {
        capabilities: MavProtocolCapability::empty(),
        uid: 0,
        flight_sw_version: packed,
        middleware_sw_version: 0,
        os_sw_version: 0,
        board_version: 0,
        vendor_id: 0,
        product_id: 0,
        flight_custom_version: [0; 8],
        middleware_custom_version: [0; 8],
        os_custom_version: [0; 8],
        uid2: [0; 18],
    };
    frame_of(system, 1, &MavMessage::AUTOPILOT_VERSION(data))
}

/// Heartbeats of a second that begins at `ms`; what the last of them changed.
fn meet(identity: &mut Identity, ms: i64, bytes: &FrameBytes) -> Option<IdentityEvent> {
    [0, 500, 1000].map(|after| hear(identity, ms + after, bytes).1)[2]
}

/// From `from` to `to` ms: heartbeats every second and IMU frames ten times, of each of these. What changed, and when.
fn play(
    identity: &mut Identity,
    (from, to): (i64, i64),
    all: &[(&FrameBytes, Option<&FrameBytes>)],
) -> Vec<(i64, IdentityEvent)> {
    let mut events = Vec::new();
    for ms in (from..to).step_by(100) {
        for (beat, imu) in all {
            if ms % 1000 == 0 {
                events.extend(hear(identity, ms, beat).1.map(|e| (ms, e)));
            }
            if let Some(imu) = imu {
                events.extend(hear(identity, ms, imu).1.map(|e| (ms, e)));
            }
        }
        identity.poll(at(ms));
    }
    events
}

fn imu(system: u8, component: u8) -> FrameBytes {
    frame_of(system, component, &MavMessage::HIGHRES_IMU(Default::default()))
}

fn following(identity: &Identity) -> Option<(u8, u8)> {
    identity.vehicle().map(|v| (v.system.0, v.component.0))
}

#[test]
fn a_rhythm_is_waited_for_and_others_are_counted() {
    let mut identity = Identity::new(IdentityConfig::default());
    assert_eq!(hear(&mut identity, 0, &heartbeat_frame(255, 190, 6, 8, 0)), (Sender::NotPinned, None));
    assert_eq!(meet(&mut identity, 1, &heartbeat_frame(0, 1, 2, 3, 0)), None);
    let event = meet(&mut identity, 2, &heartbeat_frame(7, 1, 2, 3, 0x80));
    let Some(IdentityEvent::Found(vehicle)) = event else { panic!("{event:?}") };
    assert_eq!((vehicle.system, vehicle.component), (SystemId(7), ComponentId(1)));
    assert_eq!((vehicle.autopilot, vehicle.armed), (AutopilotKind::ArduPilot, true));

    let (sender, event) = hear(&mut identity, 1103, &heartbeat_frame(7, 1, 2, 3, 0x80));
    assert_eq!((sender, event), (Sender::Autopilot, None));
    assert_eq!(hear(&mut identity, 1103, &heartbeat_frame(8, 1, 2, 12, 0)), (Sender::WrongSystem, None));
    assert_eq!(hear(&mut identity, 1104, &heartbeat_frame(7, 100, 30, 8, 0)), (Sender::SameSystem, None));
    assert_eq!(identity.vehicle(), Some(&vehicle));
    assert_eq!(identity.wrong_system(), 1);
}

#[test]
fn what_a_link_has_heard_counts_for_nobody_else_and_not_for_ever() {
    let real = heartbeat_frame(1, 1, 2, 3, 0);
    let address = Address { system: SystemId(1), component: ComponentId(1) };
    let fields = HeartbeatFields::read(&real.frame().unwrap()).unwrap();
    let mut shown = AutopilotShown::new(at(0), address, fields);
    shown.beat(at(1000), fields);
    let after = |ms: i64, bytes: &FrameBytes| {
        let mut identity = Identity::new(IdentityConfig::default());
        identity.heard_before(at(1000), &shown);
        hear(&mut identity, ms, bytes);
        following(&identity)
    };
    assert_eq!(after(1100, &real), Some((1, 1)));
    assert_eq!(after(1100, &heartbeat_frame(9, 1, 2, 3, 0)), None);
    assert_eq!(after(4000, &real), None, "the rhythm begins anew");
    // Another system is configured.
    let config = IdentityConfig { system: Some(SystemId(5)), ..IdentityConfig::default() };
    let mut identity = Identity::new(config);
    identity.heard_before(at(1000), &shown);
    assert_eq!(hear(&mut identity, 1100, &real), (Sender::WrongSystem, None));
}

#[test]
fn a_configured_system_is_waited_for() {
    let config = IdentityConfig { system: Some(SystemId(5)), ..IdentityConfig::default() };
    let mut identity = Identity::new(config);
    assert_eq!(meet(&mut identity, 0, &heartbeat_frame(1, 1, 2, 3, 0)), None);
    meet(&mut identity, 1001, &heartbeat_frame(5, 1, 2, 12, 0));
    assert_eq!(identity.vehicle().unwrap().autopilot, AutopilotKind::Px4);
}

#[test]
fn heartbeats_that_come_before_the_autopilots_win_nothing() {
    // One, or a thousand at once, of other systems and of another component of its own.
    for config in [None, Some(SystemId(1))] {
        let mut identity = Identity::new(IdentityConfig { system: config, ..IdentityConfig::default() });
        for n in 0..1000 {
            for (system, component) in [(9, 1), (1, 77), (1 + (n % 200) as u8, 78)] {
                assert_eq!(
                    hear(&mut identity, n % 10, &heartbeat_frame(system, component, 2, 12, 0)).1,
                    None
                );
            }
        }
        let real = heartbeat_frame(1, 1, 2, 3, 0);
        let events = play(&mut identity, (1000, 5000), &[(&real, None)]);
        assert!(matches!(events[..], [(2000, IdentityEvent::Found(_))]), "{events:?}");
        assert_eq!(following(&identity), Some((1, 1)));
    }
    // A component that is no autopilot's may keep its rhythm for as long as it likes.
    let config = IdentityConfig { system: Some(SystemId(1)), ..IdentityConfig::default() };
    let mut identity = Identity::new(config);
    let (real, forged) = (heartbeat_frame(1, 1, 2, 3, 0), heartbeat_frame(1, 77, 2, 12, 0));
    assert_eq!(play(&mut identity, (0, 20_000), &[(&forged, None)]), []);
    play(&mut identity, (20_000, 22_000), &[(&forged, None), (&real, None)]);
    assert_eq!(following(&identity), Some((1, 1)));
    // Unless it is the one that is asked for, or has the sensors.
    let config = IdentityConfig { component: Some(ComponentId(77)), ..config };
    let mut identity = Identity::new(config);
    play(&mut identity, (0, 3000), &[(&real, None), (&forged, None)]);
    assert_eq!(following(&identity), Some((1, 77)));
    let mut identity = Identity::new(IdentityConfig::default());
    play(&mut identity, (0, 3000), &[(&forged, Some(&imu(1, 77)))]);
    assert_eq!(following(&identity), Some((1, 77)));
}

#[test]
fn who_has_sensors_takes_the_place_of_who_has_none_and_keeps_it() {
    let (real, forged) = (heartbeat_frame(1, 1, 2, 3, 0), heartbeat_frame(9, 1, 2, 12, 0));
    let felt = imu(1, 1);
    // Together from the start: the one with sensors.
    let mut identity = Identity::new(IdentityConfig::default());
    play(&mut identity, (0, 3000), &[(&forged, None), (&real, Some(&felt))]);
    assert_eq!(following(&identity), Some((1, 1)));
    // Who has kept a rhythm before it is given up, silent or not.
    for (goes_on, by) in [(true, 13_000), (false, 7000)] {
        let mut identity = Identity::new(IdentityConfig::default());
        play(&mut identity, (0, 3000), &[(&forged, None)]);
        assert_eq!(following(&identity), Some((9, 1)));
        let both = [(&real, Some(&felt)), (&forged, None)];
        let events = play(&mut identity, (3000, 20_000), &both[..if goes_on { 2 } else { 1 }]);
        let replaced = events.iter().find(|(_, e)| matches!(e, IdentityEvent::Replaced { .. }));
        assert!(replaced.is_some_and(|(ms, _)| *ms <= by), "{events:?}");
        assert_eq!(following(&identity), Some((1, 1)));
        // And now it stays, whoever comes with whatever.
        let with_all = [(&real, Some(&felt)), (&forged, Some(&imu(9, 1)))];
        assert_eq!(play(&mut identity, (20_000, 200_000), &with_all), []);
    }
}

#[test]
fn of_two_without_sensors_one_after_the_other_is_asked() {
    // Neither sends any before it is asked.
    let (real, forged) = (heartbeat_frame(1, 1, 2, 3, 0), heartbeat_frame(9, 1, 2, 12, 0));
    let mut identity = Identity::new(IdentityConfig::default());
    play(&mut identity, (0, 3000), &[(&forged, None)]);
    let felt = imu(1, 1);
    let mut events = Vec::new();
    for s in 3..60 {
        let answers = following(&identity) == Some((1, 1));
        let both = [(&real, answers.then_some(&felt)), (&forged, None)];
        events.extend(play(&mut identity, (s * 1000, s * 1000 + 1000), &both));
    }
    let replaced = events.iter().filter(|(_, e)| matches!(e, IdentityEvent::Replaced { .. }));
    assert_eq!((following(&identity), replaced.count()), (Some((1, 1)), 1));
}

#[test]
fn in_flight_nobody_takes_its_place_and_on_the_ground_after_a_minute() {
    let other = (heartbeat_frame(9, 1, 2, 12, 0x80), imu(9, 1));
    for (base_mode, given_up) in [(0x80, false), (0, true)] {
        let mut identity = Identity::new(IdentityConfig::default());
        let (beat, felt) = (heartbeat_frame(1, 1, 2, 3, base_mode), imu(1, 1));
        play(&mut identity, (0, 10_000), &[(&beat, Some(&felt))]);
        play(&mut identity, (10_000, 65_000), &[(&other.0, Some(&other.1))]);
        assert_eq!(following(&identity), Some((1, 1)));
        play(&mut identity, (65_000, 300_000), &[(&other.0, Some(&other.1))]);
        assert_eq!(following(&identity) == Some((9, 1)), given_up);
    }
}

#[test]
fn a_vehicle_that_was_served_a_moment_ago_is_known() {
    let mut identity = Identity::new(IdentityConfig::default());
    identity.expect(SystemId(1));
    assert_eq!(hear(&mut identity, 0, &heartbeat_frame(1, 77, 2, 3, 0)).1, None);
    assert_eq!(hear(&mut identity, 0, &heartbeat_frame(2, 1, 2, 3, 0)).1, None);
    assert!(hear(&mut identity, 0, &heartbeat_frame(1, 1, 2, 3, 0)).1.is_some());
}

#[test]
fn another_autopilot_type_is_believed_with_a_reboot_only() {
    let (ardupilot, px4) = (heartbeat_frame(1, 1, 2, 3, 0x80), heartbeat_frame(1, 1, 2, 12, 0x80));
    let mut identity = Identity::new(IdentityConfig::default());
    play(&mut identity, (0, 3000), &[(&ardupilot, None)]);
    // Beside its own, and alone.
    let events = play(&mut identity, (3000, 30_000), &[(&px4, None), (&ardupilot, None)]);
    assert_eq!(events, [(3000, IdentityEvent::Contradicted(1))]);
    let events = play(&mut identity, (30_000, 50_000), &[(&px4, None)]);
    assert_eq!((events, identity.vehicle().unwrap().autopilot), (vec![], AutopilotKind::ArduPilot));
    identity.rebooted();
    let events = play(&mut identity, (50_000, 60_000), &[(&px4, None)]);
    assert!(matches!(events[..], [(50_000, IdentityEvent::Found(v))] if v.autopilot == AutopilotKind::Px4));
}

#[test]
fn other_firmware_is_evidence_of_its_own() {
    let (ardupilot, px4) = (heartbeat_frame(1, 1, 2, 3, 0), heartbeat_frame(1, 1, 2, 12, 0));
    let mut identity = Identity::new(IdentityConfig::default());
    play(&mut identity, (0, 3000), &[(&ardupilot, None)]);
    hear(&mut identity, 3000, &version(1, 0x0407_00FF));
    hear(&mut identity, 4000, &px4);
    assert!(identity.poll(at(4001)).send.is_some(), "it is asked again");
    play(&mut identity, (5000, 20_000), &[(&px4, None)]);
    hear(&mut identity, 20_002, &version(1, 0x0111_00FF));
    play(&mut identity, (21_000, 22_000), &[(&px4, None)]);
    assert_eq!(identity.vehicle().unwrap().autopilot, AutopilotKind::Px4);
}

#[test]
fn armed_and_disarmed_in_turns_are_told_now_and_then() {
    let mut identity = Identity::new(IdentityConfig::default());
    let (armed, disarmed) = (heartbeat_frame(1, 1, 2, 3, 0x80), heartbeat_frame(1, 1, 2, 3, 0));
    let mut told = play(&mut identity, (0, 3000), &[(&armed, None)]).len();
    for ms in 3000..303_000 {
        let beat = if ms % 2 == 0 { &armed } else { &disarmed };
        told += usize::from(hear(&mut identity, ms, beat).1.is_some());
    }
    assert!(told <= 10, "{told} in five minutes");
    assert!(identity.vehicle().unwrap().armed);
}

#[test]
fn silence_is_told_once_and_so_is_the_return() {
    let mut identity = Identity::new(IdentityConfig::default());
    let beat = heartbeat_frame(1, 1, 2, 3, 0);
    meet(&mut identity, -1000, &beat);
    hear(&mut identity, 1, &version(1, 0x0407_00FF));
    assert_eq!(identity.poll(at(3001)).event, None);
    let lost = identity.poll(at(3002)).event;
    assert_eq!(lost, Some(IdentityEvent::Lost { silent: Span::from_millis(3001) }));
    assert_eq!(identity.poll(at(9000)), IdentityPoll::default());
    assert!(!identity.is_heard() && identity.vehicle().is_some());
    assert_eq!(hear(&mut identity, 9500, &beat).1, Some(IdentityEvent::Back));
    assert!(identity.is_heard());
    assert!(identity.poll(at(9501)).send.is_some(), "the version is asked for again");
}

#[test]
fn an_autopilot_whose_heartbeats_are_lost_is_not_silent() {
    let mut identity = Identity::new(IdentityConfig::default());
    meet(&mut identity, -1000, &heartbeat_frame(1, 1, 2, 3, 0));
    let mut told = Vec::new();
    for ms in (100..30_000).step_by(100) {
        hear(&mut identity, ms, &version(1, 0x0407_00FF));
        told.extend(identity.poll(at(ms)).event);
        assert!(identity.is_heard());
    }
    assert_eq!(told, [IdentityEvent::NoHeartbeat(Span::from_millis(10_100))]);
    assert!(matches!(identity.poll(at(33_000)).event, Some(IdentityEvent::Lost { .. })));
    // Any message of its shows that it is back.
    assert_eq!(hear(&mut identity, 34_000, &version(1, 0x0407_00FF)).1, Some(IdentityEvent::Back));
}

#[test]
fn the_version_is_asked_for_a_few_times_only() {
    let mut identity = Identity::new(IdentityConfig::default());
    meet(&mut identity, -1001, &heartbeat_frame(1, 1, 2, 3, 0));
    let mut asked = 0;
    let mut given_up = 0;
    for ms in (0..60_000).step_by(100) {
        if ms % 1000 == 0 {
            hear(&mut identity, ms, &heartbeat_frame(1, 1, 2, 3, 0));
        }
        let polled = identity.poll(at(ms));
        given_up += usize::from(polled.event == Some(IdentityEvent::VersionUnknown));
        if let Some(MavMessage::COMMAND_LONG(command)) = polled.send {
            asked += 1;
            assert_eq!(command.command, MavCmd::MAV_CMD_REQUEST_MESSAGE);
            assert_eq!((command.param1, command.target_system, command.target_component), (148.0, 1, 1));
        }
    }
    assert_eq!((asked, given_up), (5, 1));
    // A late answer is still welcome.
    let event = hear(&mut identity, 60_001, &version(1, 0x0407_02C0)).1;
    let Some(IdentityEvent::Version(version)) = event else { panic!("{event:?}") };
    assert_eq!(version.to_string(), "4.7.2-rc");
    assert_eq!(identity.vehicle().unwrap().version, Some(version));
}

#[test]
fn a_version_of_another_vehicle_is_not_ours() {
    let mut identity = Identity::new(IdentityConfig::default());
    meet(&mut identity, -1000, &heartbeat_frame(1, 1, 2, 12, 0));
    assert_eq!(hear(&mut identity, 1, &version(2, 0x0111_00FF)).1, None);
    assert_eq!(identity.vehicle().unwrap().version, None);
    hear(&mut identity, 2, &version(1, 0x0111_00FF));
    assert_eq!(identity.vehicle().unwrap().version.unwrap().to_string(), "1.17.0");
}

#[test]
fn arming_is_told() {
    let mut identity = Identity::new(IdentityConfig::default());
    meet(&mut identity, -1000, &heartbeat_frame(1, 1, 2, 12, 0));
    let armed = hear(&mut identity, 1, &heartbeat_frame(1, 1, 2, 12, 0x80)).1;
    assert_eq!(armed, Some(IdentityEvent::Armed(true)));
    assert_eq!(hear(&mut identity, 2, &heartbeat_frame(1, 1, 2, 12, 0x80)).1, None);
}
