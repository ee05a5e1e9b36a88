//! A camera's computer on a link of its own, with a system number, a clock and no heartbeat of its own.

use std::net::SocketAddr;
use std::time::Duration;

use crate::live::flight::Flight;
use crate::live::process::Holdover;
use holdover::wire::frame::{ComponentId, Scan, SystemId, scan};
use holdover::wire::messages::from_any_component;
use holdover::wire::session::Address;
use holdover::wire::session::outgoing::FrameWriter;
use mavlink::dialects::ardupilotmega::MavMessage;
use tokio::net::UdpSocket;
use tokio::time::sleep;

const COPTER: &str = "ardupilot-copter-gps-loss";
const SPEED: f64 = 15.0;
/// The camera was switched on so much before the autopilot, s.
const EARLIER_S: u64 = 5000;

/// What flow sensor and rangefinder say in a burst of the autopilot's, as a component of another system on another clock; and the rest.
fn split(burst: &[u8], writer: &mut FrameWriter) -> (Vec<u8>, Vec<u8>) {
    let (mut rest, mut autopilot, mut camera) = (burst, Vec::new(), Vec::new());
    while let Scan::Frame(frame) | Scan::Unknown(frame) = scan(rest, true) {
        if from_any_component(frame.message_id()) {
            let message = match frame.parse().unwrap() {
                MavMessage::OPTICAL_FLOW(mut m) => {
                    m.time_usec += EARLIER_S * 1_000_000;
                    MavMessage::OPTICAL_FLOW(m)
                }
                MavMessage::DISTANCE_SENSOR(mut m) => {
                    m.time_boot_ms += EARLIER_S as u32 * 1000;
                    MavMessage::DISTANCE_SENSOR(m)
                }
                other => other,
            };
            camera.extend_from_slice(&writer.write(&message).unwrap());
        } else {
            autopilot.extend_from_slice(frame.bytes());
        }
        rest = &rest[frame.len()..];
    }
    (autopilot, camera)
}

#[tokio::test]
async fn flow_and_distance_of_a_camera_on_its_own_link_carry_an_outage() {
    let flight = Flight::load(COPTER, 100.0);
    let sensors = "link.sensor_endpoints=[\"udpin:127.0.0.1:0\"]";
    let mut holdover =
        Holdover::run(&["--endpoint", "udpin:127.0.0.1:0", "--deny-gnss", "80..200", "--set", sensors]);
    let address = |n: usize| -> SocketAddr {
        holdover.wait_for("listens at", n).rsplit(' ').next().unwrap().parse().unwrap()
    };
    let (to_autopilots, to_sensors) = (address(1), address(2));
    let autopilot = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let camera = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    // It calls itself an autopilot's component of another system, and is none.
    let mut writer = FrameWriter::new(Address { system: SystemId(42), component: ComponentId(1) });
    // The autopilot is there before the camera: measurements without its clock are of no use.
    for _ in 0..100 {
        if holdover.told("following") > 0 {
            break;
        }
        autopilot.send_to(flight.heartbeat(), to_autopilots).await.unwrap();
        sleep(Duration::from_millis(30)).await;
    }
    flight
        .play(0.0, 100.0, SPEED, async |burst: &[u8]| {
            let (own, seen) = split(burst, &mut writer);
            autopilot.send_to(&own, to_autopilots).await.unwrap();
            if !seen.is_empty() {
                camera.send_to(&seen, to_sensors).await.unwrap();
            }
        })
        .await;
    // What is no measurement is not taken there: an origin, or an autopilot's heartbeat.
    let beat = flight.heartbeat();
    camera.send_to(beat, to_sensors).await.unwrap();
    sleep(Duration::from_millis(200)).await;
    holdover.stop();
    let log = holdover.log();
    assert!(log.contains("flow 0 trusted"), "{log}");
    assert!(log.contains("carried by optical flow"), "{log}");
    assert!(log.contains("another component stamps its measurements on a clock of its own"), "{log}");
    assert!(log.contains("measurements of sensors on their own links, 1 other frames there"), "{log}");
    assert!(!log.contains("is heard, too, and ignored") && !log.contains("rebooted"), "{log}");
}

#[tokio::test]
async fn without_that_link_another_system_is_not_listened_to() {
    let flight = Flight::load(COPTER, 40.0);
    let mut holdover = Holdover::run(&["--endpoint", "udpin:127.0.0.1:0"]);
    let to = holdover.address();
    let autopilot = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let mut writer = FrameWriter::new(Address { system: SystemId(42), component: ComponentId(1) });
    flight
        .introduce(async |beat: &[u8]| {
            autopilot.send_to(beat, to).await.unwrap();
        })
        .await;
    flight
        .play(0.0, 40.0, SPEED, async |burst: &[u8]| {
            let (own, seen) = split(burst, &mut writer);
            autopilot.send_to(&own, to).await.unwrap();
            if !seen.is_empty() {
                autopilot.send_to(&seen, to).await.unwrap();
            }
        })
        .await;
    sleep(Duration::from_millis(200)).await;
    holdover.stop();
    let log = holdover.log();
    assert!(!log.contains("flow 0 trusted") && log.contains("wrong system"), "{log}");
}
