//! The real daemon and an autopilot that answers: which source set it is told to take and when, and what the operator is told of it.

use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::live::flight::{Flight, Heard};
use crate::live::process::Holdover;
use holdover::wire::frame::{ComponentId, Scan, SystemId, scan};
use holdover::wire::session::Address;
use holdover::wire::session::outgoing::FrameWriter;
use mavlink::MessageData;
use mavlink::dialects::ardupilotmega as apm;
use mavlink::dialects::ardupilotmega::{
    EkfStatusFlags, MavCmd, MavMessage, MavResult, MavSeverity, MavSysStatusSensor,
};
use mavlink::types::CharArray;
use tokio::net::UdpSocket;
use tokio::time::sleep;

const COPTER: &str = "ardupilot-copter-gps-loss";
const SPEED: f64 = 15.0;

/// How the autopilot behaves.
#[derive(Clone, Copy)]
struct Manners {
    /// VISO_TYPE is set.
    set_up: bool,
    /// It answers MAV_CMD_SET_EKF_SOURCE_SET.
    answers: bool,
}

/// What it was told, and is.
#[derive(Default)]
struct Inside {
    set: u8,
    /// Sets commanded, with the number of ODOMETRY before.
    commands: Vec<(u8, usize)>,
    odometry: Vec<apm::ODOMETRY_DATA>,
}

/// An ArduPilot: a recorded one, but for its estimator's word on itself, and with the source sets of a running one.
struct Autopilot {
    socket: Arc<UdpSocket>,
    to: SocketAddr,
    writer: FrameWriter,
    manners: Manners,
    inside: Arc<Mutex<Inside>>,
}

impl Autopilot {
    async fn new(to: SocketAddr, manners: Manners, heard: &Heard) -> Self {
        let socket = Arc::new(UdpSocket::bind("127.0.0.1:0").await.unwrap());
        let inside = Arc::new(Mutex::new(Inside { set: 1, ..Inside::default() }));
        let from = Address { system: SystemId(1), component: ComponentId(1) };
        let (listener, heard, state) = (Arc::clone(&socket), heard.clone(), Arc::clone(&inside));
        tokio::spawn(async move {
            let mut answers = FrameWriter::new(from);
            let mut buffer = vec![0; 2000];
            while let Ok(n) = listener.recv(&mut buffer).await {
                heard.add(&buffer[..n]);
                let Scan::Frame(frame) = scan(&buffer[..n], true) else { continue };
                let Ok(message) = frame.parse() else { continue };
                let answer = state.lock().unwrap().take(message, manners);
                if let Some(answer) = answer {
                    let bytes = answers.write(&answer).unwrap();
                    listener.send_to(&bytes, to).await.unwrap();
                }
            }
        });
        Self { socket, to, writer: FrameWriter::new(from), manners, inside }
    }

    async fn say(&mut self, message: &MavMessage) {
        let bytes = self.writer.write(message).unwrap();
        self.socket.send_to(&bytes, self.to).await.unwrap();
    }

    async fn text(&mut self, text: &str) {
        let mut bytes = [0; 50];
        bytes[..text.len()].copy_from_slice(text.as_bytes());
        let severity = MavSeverity::MAV_SEVERITY_INFO;
        let text = CharArray::new(bytes);
        self.say(&MavMessage::STATUSTEXT(apm::STATUSTEXT_DATA { severity, text, id: 0, chunk_seq: 0 })).await;
    }

    /// Plays the flight, with its own word on its estimator, and on the other set its position is the one that it is sent.
    async fn fly(&mut self, flight: &Flight, to_s: f64) {
        let socket = Arc::clone(&self.socket);
        let (to, inside) = (self.to, Arc::clone(&self.inside));
        flight
            .introduce(async |beat: &[u8]| {
                self.socket.send_to(beat, to).await.unwrap();
            })
            .await;
        self.text("EKF3 IMU0 is using GPS").await;
        let kept: Vec<(f64, Vec<u8>)> = flight.frames.clone();
        let mut at_s = 0.0;
        let mut frames = kept.into_iter().peekable();
        let begun = tokio::time::Instant::now();
        while at_s < to_s {
            let mut burst = Vec::new();
            let external = inside.lock().unwrap().set == 2;
            while let Some((_, bytes)) = frames.next_if(|(t, _)| *t <= at_s) {
                let Scan::Frame(frame) = scan(&bytes, true) else { continue };
                let replaced = match frame.message_id() {
                    apm::SYS_STATUS_DATA::ID | apm::EKF_STATUS_REPORT_DATA::ID | apm::STATUSTEXT_DATA::ID => {
                        true
                    }
                    apm::LOCAL_POSITION_NED_DATA::ID => external,
                    _ => false,
                };
                if replaced {
                    continue;
                }
                if burst.len() + bytes.len() > 1400 {
                    socket.send_to(&burst, to).await.unwrap();
                    burst.clear();
                }
                burst.extend_from_slice(&bytes);
            }
            socket.send_to(&burst, to).await.unwrap();
            self.report(external).await;
            at_s += 0.5;
            tokio::time::sleep_until(begun + Duration::from_secs_f64(at_s / SPEED)).await;
        }
    }

    async fn report(&mut self, external: bool) {
        let flags = EkfStatusFlags::EKF_ATTITUDE | EkfStatusFlags::EKF_POS_HORIZ_ABS;
        self.say(&MavMessage::EKF_STATUS_REPORT(apm::EKF_STATUS_REPORT_DATA { flags, ..Default::default() }))
            .await;
        let sensor = MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_VISION_POSITION;
        let sensors = if self.manners.set_up { sensor } else { MavSysStatusSensor::empty() };
        self.say(&MavMessage::SYS_STATUS(apm::SYS_STATUS_DATA {
            onboard_control_sensors_present: sensors,
            onboard_control_sensors_enabled: sensors,
            onboard_control_sensors_health: sensors,
            ..Default::default()
        }))
        .await;
        let newest = self.inside.lock().unwrap().odometry.last().cloned();
        if let Some(o) = newest.filter(|_| external) {
            let time_boot_ms = u32::try_from(o.time_usec / 1000).unwrap();
            let position =
                apm::LOCAL_POSITION_NED_DATA { time_boot_ms, x: o.x, y: o.y, z: o.z, ..Default::default() };
            self.say(&MavMessage::LOCAL_POSITION_NED(position)).await;
        }
    }

    fn commands(&self) -> Vec<u8> {
        self.inside.lock().unwrap().commands.iter().map(|(set, _)| *set).collect()
    }
}

impl Inside {
    fn take(&mut self, message: MavMessage, manners: Manners) -> Option<MavMessage> {
        match message {
            MavMessage::ODOMETRY(o) => {
                self.odometry.push(o);
                None
            }
            MavMessage::COMMAND_LONG(c) if c.command == MavCmd::MAV_CMD_SET_EKF_SOURCE_SET => {
                let set = c.param1 as u8;
                self.commands.push((set, self.odometry.len()));
                if !manners.answers {
                    return None;
                }
                self.set = set;
                Some(MavMessage::COMMAND_ACK(apm::COMMAND_ACK_DATA {
                    command: c.command,
                    result: MavResult::MAV_RESULT_ACCEPTED,
                    target_system: 1,
                    target_component: 197,
                    ..Default::default()
                }))
            }
            _ => None,
        }
    }
}

/// What the pilot was told.
fn words(heard: &Heard) -> Vec<String> {
    let word = |m| match m {
        MavMessage::STATUSTEXT(t) => t.text.to_str().ok().map(str::to_owned),
        _ => None,
    };
    heard.messages().into_iter().filter_map(word).collect()
}

fn told(heard: &Heard, text: &str) -> usize {
    words(heard).iter().filter(|w| w.contains(text)).count()
}

async fn flown(manners: Manners, to_s: f64, arguments: &[&str]) -> (Autopilot, Heard, String) {
    let (flight, heard) = (Flight::load(COPTER, to_s), Heard::default());
    let endpoint = ["--endpoint", "udpin:127.0.0.1:0", "--deny-gnss", "60..110"];
    let mut holdover = Holdover::run(&[&endpoint[..], arguments].concat());
    let mut autopilot = Autopilot::new(holdover.address(), manners, &heard).await;
    autopilot.fly(&flight, to_s).await;
    sleep(Duration::from_millis(200)).await;
    holdover.stop();
    let log = holdover.log();
    (autopilot, heard, log)
}

const SET_UP: Manners = Manners { set_up: true, answers: true };

#[tokio::test]
async fn the_autopilot_is_switched_over_at_the_decision_and_back_when_gnss_is_good() {
    // Its patience is in real time, which is a fifteenth of the flight's.
    let (autopilot, heard, log) =
        flown(SET_UP, 140.0, &["--set", "tuning.handover.return_after_s=0.2"]).await;
    // Each once more when it was accepted.
    assert_eq!(autopilot.commands(), [2, 2, 1, 1], "{log}");
    let inside = autopilot.inside.lock().unwrap();
    let before = inside.commands[0].1;
    assert!(before > 300, "{before} positions before the loss: it arms only with them");
    // At this speed there is no room for every word to the pilot: the log has them all.
    for text in ["EKF source set 2", "autopilot flies on our position", "EKF source set 1"] {
        let lines = log.lines().filter(|l| l.contains(text) && !l.contains("in the end"));
        assert_eq!(lines.count(), 1, "{text}:\n{log}");
    }
    assert_eq!(told(&heard, "EKF source set 2"), 1, "{:?}", words(&heard));
    // Sent all along, at one rate: the switch makes no hole.
    let times: Vec<u64> = inside.odometry.iter().map(|o| o.time_usec).collect();
    let longest_us = times.windows(2).map(|w| w[1] - w[0]).max().unwrap();
    assert!(longest_us < 100_000, "{longest_us}");
    assert!(log.contains("sent: GNSS is not trusted"), "{log}");
}

#[tokio::test]
async fn the_command_goes_out_within_a_tick_of_the_decision() {
    let (flight, heard) = (Flight::load(COPTER, 70.0), Heard::default());
    let arguments = ["--endpoint", "udpin:127.0.0.1:0", "--deny-gnss", "60..90"];
    let mut holdover = Holdover::run(&arguments);
    let mut autopilot = Autopilot::new(holdover.address(), SET_UP, &heard).await;
    autopilot.fly(&flight, 70.0).await;
    holdover.stop();
    // In the order in which they left: the word of the decision, then positions, then the command.
    let messages = heard.messages();
    let word = |m: &MavMessage| matches!(m, MavMessage::STATUSTEXT(t) if t.text.to_str().is_ok_and(|t| t.contains("Aided -> Holdover")));
    let command = |m: &MavMessage| matches!(m, MavMessage::COMMAND_LONG(c) if c.command == MavCmd::MAV_CMD_SET_EKF_SOURCE_SET);
    let decided = messages.iter().position(word).expect("no decision");
    let commanded = messages.iter().position(command).expect("no command");
    assert!(commanded > decided);
    let between = &messages[decided..commanded];
    let positions = between.iter().filter(|m| matches!(m, MavMessage::ODOMETRY(_))).count();
    // 300 ms, at fifteen times the speed.
    assert!(positions as f64 <= 0.3 * SPEED * 30.0, "{positions} positions later");
}

#[tokio::test]
async fn an_autopilot_that_does_not_answer_is_the_pilots() {
    let silent = Manners { answers: false, ..SET_UP };
    let (autopilot, heard, log) = flown(silent, 150.0, &["--deny-gnss", "60..200"]).await;
    assert_eq!(autopilot.commands(), [2, 2, 2, 2, 2], "{log}");
    assert_eq!(told(&heard, "SWITCH EKF TO SET 2: no answer"), 1, "{:?}", words(&heard));
}

#[tokio::test]
async fn an_autopilot_that_is_not_set_up_is_not_switched_and_it_is_said_before_the_loss() {
    let bare = Manners { set_up: false, answers: true };
    let (autopilot, heard, log) = flown(bare, 100.0, &[]).await;
    assert_eq!(autopilot.commands(), [] as [u8; 0], "{log}");
    let words = words(&heard);
    let place =
        |text: &str| words.iter().position(|w| w.contains(text)).unwrap_or_else(|| panic!("{words:?}"));
    assert!(place("not used: VISO_TYPE is not set") < place("Aided -> Holdover"), "{words:?}");
}

#[tokio::test]
async fn a_pilot_who_switches_himself_is_told_to() {
    let (autopilot, heard, log) = flown(SET_UP, 100.0, &["--set", "handover.switched_by=pilot"]).await;
    assert_eq!(autopilot.commands(), [] as [u8; 0], "{log}");
    assert_eq!(told(&heard, "SWITCH EKF TO SET 2, or it lands in 14 s"), 1, "{:?}", words(&heard));
}
