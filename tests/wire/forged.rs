//! The real daemon, and frames on its link that are not the autopilot's: whom it follows, and what it sends.

use std::time::Duration;

use crate::live::flight::{Flight, Heard};
use crate::live::process::Holdover;
use holdover::sample::VehicleStatus;
use holdover::wire::encode_vehicle;
use holdover::wire::frame::{ComponentId, SystemId};
use holdover::wire::session::Address;
use holdover::wire::session::identity::AutopilotKind;
use holdover::wire::session::outgoing::FrameWriter;
use mavlink::dialects::ardupilotmega::{self as apm, MavMessage};
use tokio::net::UdpSocket;
use tokio::time::sleep;

const COPTER: &str = "ardupilot-copter-gps-loss";
const SPEED: f64 = 15.0;

fn frames_of(system: u8, component: u8, message: &MavMessage, times: usize) -> Vec<u8> {
    let from = Address { system: SystemId(system), component: ComponentId(component) };
    let mut writer = FrameWriter::new(from);
    (0..times).flat_map(|_| writer.write(message).unwrap().to_vec()).collect()
}

#[tokio::test]
async fn a_heartbeat_that_comes_first_wins_nothing() {
    let flight = Flight::load(COPTER, 10.0);
    let beat = encode_vehicle::heartbeat(AutopilotKind::Px4, &VehicleStatus::default());
    for arguments in [&["--set", "vehicle.system_id=1"][..], &[]] {
        let mut holdover = Holdover::run(&[&["--endpoint", "udpin:127.0.0.1:0"], arguments].concat());
        let to = holdover.address();
        // Behind one router: what is forged, and the autopilot.
        let router = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        for (system, component) in [(9, 1), (1, 77), (1, 77), (9, 1)] {
            router.send_to(&frames_of(system, component, &beat, 20), to).await.unwrap();
        }
        sleep(Duration::from_millis(1600)).await;
        flight
            .introduce(async |beat: &[u8]| {
                router.send_to(beat, to).await.unwrap();
            })
            .await;
        holdover.wait_for("following ArduPilot, system 1", 1);
        holdover.stop();
        assert_eq!(holdover.told("following"), 1, "{}", holdover.log());
    }
}

#[tokio::test]
async fn what_somebody_else_says_in_flight_neither_moves_nor_silences_it() {
    let (flight, heard) = (Flight::load(COPTER, 90.0), Heard::default());
    let mut holdover = Holdover::run(&["--endpoint", "udpin:127.0.0.1:0", "--deny-gnss", "70..200"]);
    let to = holdover.address();
    let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    flight
        .introduce(async |beat: &[u8]| {
            socket.send_to(beat, to).await.unwrap();
        })
        .await;
    let answers = async |seconds: std::ops::Range<f64>| {
        let play = async |burst: &[u8]| {
            socket.send_to(burst, to).await.unwrap();
            let mut buffer = [0; 2000];
            while let Ok(n) = socket.try_recv(&mut buffer) {
                heard.add(&buffer[..n]);
            }
        };
        flight.play(seconds.start, seconds.end, SPEED, play).await;
    };
    answers(0.0..80.0).await;
    let odometry = |m| match m {
        MavMessage::ODOMETRY(o) => Some(o),
        _ => None,
    };
    let before = heard.odometry().len();
    let origin =
        apm::GPS_GLOBAL_ORIGIN_DATA { latitude: 485_000_000, longitude: 151_000_000, ..Default::default() };
    let near =
        apm::GPS_GLOBAL_ORIGIN_DATA { latitude: 479_090_000, longitude: 151_000_000, ..Default::default() };
    let denied = apm::COMMAND_ACK_DATA {
        command: apm::MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL,
        result: apm::MavResult::MAV_RESULT_DENIED,
        ..Default::default()
    };
    let beat = encode_vehicle::heartbeat(AutopilotKind::Px4, &VehicleStatus::default());
    let mut forged = vec![beat, MavMessage::GPS_GLOBAL_ORIGIN(origin), MavMessage::GPS_GLOBAL_ORIGIN(near)];
    forged.push(MavMessage::COMMAND_ACK(denied));
    for n in 0..40 {
        let (time_usec, zacc) = (100_000 + n * 10_000, -1000);
        forged.push(MavMessage::RAW_IMU(apm::RAW_IMU_DATA { time_usec, zacc, ..Default::default() }));
    }
    for message in &forged {
        socket.send_to(&frames_of(1, 1, message, 1), to).await.unwrap();
    }
    answers(80.0..90.0).await;
    sleep(Duration::from_millis(200)).await;
    holdover.stop();
    let log = holdover.log();
    assert!(!log.contains("rebooted") && !log.contains("origin moved by 1") && !log.contains("PX4"), "{log}");
    let sent: Vec<_> = heard.messages().into_iter().filter_map(odometry).collect();
    // Ten seconds of flight, at 30 a second.
    assert!(sent.len() > before + 200, "{} after {before}", sent.len());
    let jumps = sent.windows(2).map(|w| (w[1].x - w[0].x).hypot(w[1].y - w[0].y)).fold(0.0, f32::max);
    assert!(jumps < 2.0, "{jumps} m");
}
