//! The manners of both autopilots, as a companion meets them.

use super::*;
use crate::sim::autopilot::script::ScriptLeg;
use crate::sim::models::OutageKind;

const US: Address = Address { system: SystemId(1), component: ComponentId::ODOMETRY_SOURCE };

/// A double, and what it said.
struct Talk {
    double: AutopilotDouble,
    writer: FrameWriter,
    heard: Vec<(f64, ComponentId, Message)>,
}

impl Talk {
    fn with(kind: AutopilotKind, change: impl FnOnce(&mut DoubleSettings)) -> Self {
        let script = FlightScript::new([ScriptLeg::Wait(1e6)]);
        let mut settings = DoubleSettings::documented(kind, script);
        change(&mut settings);
        Self { double: AutopilotDouble::new(settings), writer: FrameWriter::new(US), heard: Vec::new() }
    }

    fn new(kind: AutopilotKind) -> Self {
        Self::with(kind, |_| {})
    }

    fn run(&mut self, seconds: f64) {
        let end = self.double.vehicle.now_s() + seconds;
        let mut out = Vec::new();
        while self.double.vehicle.now_s() < end {
            self.double.step(&mut out);
            for (_, bytes) in out.drain(..) {
                let frame = bytes.frame().unwrap();
                self.heard.push((self.double.vehicle.now_s(), frame.component(), frame.parse().unwrap()));
            }
        }
    }

    fn say(&mut self, message: Message) {
        self.double.hear(self.writer.write(&message).unwrap());
    }

    /// Sends a command, and returns the result of its ACK.
    fn command(&mut self, command: apm::MavCmd, param1: f32, param2: f32) -> apm::MavResult {
        let [param3, param4, param5, param6, param7] = [0.0; 5];
        let (target_system, target_component, confirmation) = (1, 1, 0);
        self.say(Message::COMMAND_LONG(apm::COMMAND_LONG_DATA {
            param1,
            param2,
            param3,
            param4,
            param5,
            param6,
            param7,
            command,
            target_system,
            target_component,
            confirmation,
        }));
        self.heard.clear();
        self.run(0.05);
        let ack = |(_, _, m): &(f64, ComponentId, Message)| match m {
            Message::COMMAND_ACK(a) if a.command == command && a.target_component == 197 => Some(a.result),
            _ => None,
        };
        self.heard.iter().find_map(ack).expect("no acknowledgement")
    }

    fn interval(&mut self, id: u32, hz: f32) -> apm::MavResult {
        self.command(apm::MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, id as f32, 1e6 / hz)
    }

    fn of<T>(&self, take: impl Fn(&Message) -> Option<T>) -> Vec<T> {
        self.heard.iter().filter_map(|(_, _, m)| take(m)).collect()
    }

    fn words(&self) -> String {
        self.of(
            |m| if let Message::STATUSTEXT(s) = m { Some(s.text.to_str().unwrap().to_owned()) } else { None },
        )
        .concat()
    }
}

#[test]
fn a_rate_above_the_loop_is_denied_with_a_word_and_a_lower_one_granted() {
    let mut plane =
        Talk::with(AutopilotKind::ArduPilot, |s| s.parameters.set("SCHED_LOOP_RATE", 50.0).unwrap());
    let imu = apm::HIGHRES_IMU_DATA::ID;
    assert_eq!(plane.interval(imu, 200.0), apm::MavResult::MAV_RESULT_DENIED);
    assert!(plane.words().contains("Requested rate for message ID 105 too fast. Increase SCHED_LOOP_RATE"));
    assert_eq!(plane.interval(imu, 40.0), apm::MavResult::MAV_RESULT_ACCEPTED);
    plane.heard.clear();
    plane.run(10.0);
    let n = plane.of(|m| matches!(m, Message::HIGHRES_IMU(_)).then_some(())).len();
    assert!((395..=405).contains(&n), "{n}");
    plane.command(apm::MavCmd::MAV_CMD_REQUEST_MESSAGE, apm::MESSAGE_INTERVAL_DATA::ID as f32, imu as f32);
    let told = plane.of(|m| {
        if let Message::MESSAGE_INTERVAL(i) = m { Some((i.message_id, i.interval_us)) } else { None }
    });
    assert_eq!(told, [(105, 25_000)]);
    assert_eq!(plane.interval(apm::OPTICAL_FLOW_RAD_DATA::ID, 5.0), apm::MavResult::MAV_RESULT_DENIED);
    assert!(plane.words().contains("No ap_message for mavlink id (106)"));
    let mut px4 = Talk::new(AutopilotKind::Px4);
    assert_eq!(px4.interval(apm::OPTICAL_FLOW_DATA::ID, 5.0), apm::MavResult::MAV_RESULT_FAILED);
    assert_eq!(px4.interval(imu, 200.0), apm::MavResult::MAV_RESULT_ACCEPTED);
}

#[test]
fn a_ground_station_sets_everything_to_four_hertz() {
    let mut talk =
        Talk::with(AutopilotKind::ArduPilot, |s| s.manners = s.manners.clone().with(Manner::StationRates));
    talk.interval(apm::HIGHRES_IMU_DATA::ID, 100.0);
    talk.run(32.0 - talk.double.vehicle.now_s());
    talk.heard.clear();
    talk.run(10.0);
    let n = talk.of(|m| matches!(m, Message::HIGHRES_IMU(_)).then_some(())).len();
    assert!((39..=41).contains(&n), "{n}");
}

#[test]
fn readings_are_repeated_by_one_and_stamped_zero_by_the_other() {
    let mut ardupilot = Talk::new(AutopilotKind::ArduPilot);
    ardupilot.interval(apm::GPS_RAW_INT_DATA::ID, 10.0);
    ardupilot.run(5.0);
    ardupilot.heard.clear();
    ardupilot.run(10.0);
    let mut stamps = ardupilot.of(|m| if let Message::GPS_RAW_INT(g) = m { Some(g.time_usec) } else { None });
    assert!((98..=102).contains(&stamps.len()), "{}", stamps.len());
    stamps.dedup();
    assert!((49..=51).contains(&stamps.len()), "{}", stamps.len());
    let mut px4 = Talk::new(AutopilotKind::Px4);
    px4.run(10.0);
    let stamps = px4.of(|m| if let Message::GPS_RAW_INT(g) = m { Some(g.time_usec) } else { None });
    assert!((47..=50).contains(&stamps.len()) && stamps.iter().all(|&s| s == 0), "{stamps:?}");
}

#[test]
fn flow_comes_again_with_a_new_stamp() {
    let script = FlightScript::new([
        ScriptLeg::Wait(20.0),
        ScriptLeg::Arm,
        ScriptLeg::TakeOff(5.0),
        ScriptLeg::Wait(1e6),
    ]);
    let mut talk = Talk::with(AutopilotKind::ArduPilot, |s| {
        s.script = script;
        s.parameters.set("VISO_TYPE", 0.0).unwrap();
    });
    talk.interval(apm::OPTICAL_FLOW_DATA::ID, 50.0);
    talk.run(35.0);
    talk.heard.clear();
    talk.run(10.0);
    let flows =
        talk.of(|m| if let Message::OPTICAL_FLOW(f) = m { Some((f.time_usec, f.flow_rate_x)) } else { None });
    let mut readings: Vec<f32> = flows.iter().map(|f| f.1).collect();
    readings.dedup();
    let ratio = flows.len() as f64 / readings.len() as f64;
    assert!((2.3..=2.7).contains(&ratio), "{ratio}");
    let again = flows.windows(2).filter(|w| w[0].1 == w[1].1);
    assert!(again.clone().count() > 100 && again.clone().all(|w| w[1].0 > w[0].0));
}

#[test]
fn the_field_is_a_million_times_too_large_in_one_message_and_right_in_the_other() {
    let mut talk = Talk::new(AutopilotKind::ArduPilot);
    talk.interval(apm::HIGHRES_IMU_DATA::ID, 50.0);
    talk.run(2.0);
    let high = talk.of(|m| if let Message::HIGHRES_IMU(i) = m { Some(f64::from(i.zmag)) } else { None });
    let raw = talk.of(|m| if let Message::RAW_IMU(i) = m { Some(f64::from(i.zmag) * 1e-3) } else { None });
    let (high, raw) = (high[high.len() - 1], raw[raw.len() - 1]);
    assert!((0.3..0.7).contains(&raw) && (high * 1e-6 - raw).abs() < 0.02, "{high} {raw}");
}

#[test]
fn parameters_are_told_and_set_and_change_the_rules() {
    let mut talk = Talk::new(AutopilotKind::Px4);
    let ids = |name: &str| (1u8, 1u8, name.into());
    let (target_system, target_component, param_id) = ids("EKF2_EV_CTRL");
    let param_type = apm::MavParamType::MAV_PARAM_TYPE_INT32;
    let param_value = f32::from_bits(5);
    talk.say(Message::PARAM_SET(apm::PARAM_SET_DATA {
        param_value,
        target_system,
        target_component,
        param_id,
        param_type,
    }));
    talk.say(Message::PARAM_REQUEST_LIST(apm::PARAM_REQUEST_LIST_DATA { target_system, target_component }));
    talk.run(1.0);
    let told = talk.of(|m| {
        if let Message::PARAM_VALUE(p) = m {
            Some((p.param_id.to_str().unwrap().to_owned(), p.param_value))
        } else {
            None
        }
    });
    assert_eq!(told[0].0, "EKF2_EV_CTRL");
    assert_eq!(told[0].1.to_bits(), 5);
    assert_eq!(told.len(), 1 + talk.double.parameters.count());
    let crate::sim::autopilot::AidingRules::Ekf2(rules) = talk.double.parameters.rules() else {
        panic!("not PX4's")
    };
    assert_eq!(rules.control, 5);
}

#[test]
fn a_reboot_is_silent_forgets_the_streams_and_starts_the_clock_anew() {
    let mut talk = Talk::new(AutopilotKind::ArduPilot);
    talk.interval(apm::HIGHRES_IMU_DATA::ID, 100.0);
    talk.run(5.0);
    let result = talk.command(apm::MavCmd::MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0, 0.0);
    assert_eq!(result, apm::MavResult::MAV_RESULT_ACCEPTED);
    talk.heard.clear();
    talk.run(1.8);
    assert!(talk.heard.is_empty(), "{:?}", talk.heard);
    talk.run(3.0);
    assert!(talk.of(|m| matches!(m, Message::HIGHRES_IMU(_)).then_some(())).is_empty());
    let boots = talk.of(|m| if let Message::ATTITUDE(a) = m { Some(a.time_boot_ms) } else { None });
    assert!(!boots.is_empty() && boots.iter().all(|&ms| ms < 5000), "{boots:?}");
}

#[test]
fn source_sets_are_selected_by_command_and_only_by_one_of_the_two() {
    let select = apm::MavCmd::MAV_CMD_SET_EKF_SOURCE_SET;
    let mut ardupilot = Talk::new(AutopilotKind::ArduPilot);
    assert_eq!(ardupilot.command(select, 2.0, 0.0), apm::MavResult::MAV_RESULT_ACCEPTED);
    assert_eq!(ardupilot.command(select, 4.0, 0.0), apm::MavResult::MAV_RESULT_DENIED);
    assert_eq!(
        Talk::new(AutopilotKind::Px4).command(select, 2.0, 0.0),
        apm::MavResult::MAV_RESULT_UNSUPPORTED
    );
    let arm = ardupilot.command(apm::MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 0.0);
    assert_eq!(arm, apm::MavResult::MAV_RESULT_FAILED);
    assert!(ardupilot.words().contains("PreArm: VisOdom: not healthy"));
}

#[test]
fn a_camera_speaks_as_a_component_of_its_own_and_px4_repeats_it() {
    for (kind, echoed) in [(AutopilotKind::ArduPilot, false), (AutopilotKind::Px4, true)] {
        let script = FlightScript::new([
            ScriptLeg::Wait(17.0),
            ScriptLeg::Arm,
            ScriptLeg::TakeOff(5.0),
            ScriptLeg::Wait(1e6),
        ]);
        let mut talk = Talk::with(kind, |s| {
            s.script = script;
            s.camera = Some(DoublePort::Main);
            if kind == AutopilotKind::ArduPilot {
                s.parameters.set("VISO_TYPE", 0.0).unwrap();
            }
        });
        talk.run(40.0);
        let flows = |component: u8| {
            talk.heard
                .iter()
                .filter(|(_, c, m)| c.0 == component && matches!(m, Message::OPTICAL_FLOW_RAD(_)))
                .count()
        };
        assert!(flows(100) > 200, "{}", flows(100));
        assert_eq!(flows(1) == flows(100), echoed);
        assert!(talk.heard.iter().any(|(_, c, m)| c.0 == 100 && matches!(m, Message::DISTANCE_SENSOR(_))));
    }
}

#[test]
fn the_report_tells_of_the_loss_and_the_failsafe() {
    let script = FlightScript::outage(20.0, 60.0, Some(OutageKind::NoFix), false);
    let mut talk = Talk::with(AutopilotKind::Px4, |s| s.script = script);
    while !talk.double.vehicle.is_done() && talk.double.vehicle.now_s() < 400.0 {
        talk.run(1.0);
    }
    let report = talk.double.report();
    let (lost, acted) = (report.lost_s.unwrap(), report.failsafe_s.unwrap());
    assert!((5.0..6.5).contains(&(acted - lost)), "{report:?}");
    assert!(report.landed_s.is_some() && report.external == 0 && report.back_s.is_none(), "{report:?}");
}
