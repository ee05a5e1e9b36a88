//! The real daemon beside an autopilot's double, over loopback and many times as fast as in life: aligned, aided, GNSS lost, held, back.
//! What is asserted is the double's truth and its own failsafe.

use std::sync::Arc;
use std::time::Duration;

use crate::live::process::Holdover;
use holdover::double::manners::Manner;
use holdover::double::{AutopilotDouble, DoublePort, DoubleReport, DoubleSettings};
use holdover::sim::autopilot::FlightMode;
use holdover::sim::autopilot::link::LinkFaults;
use holdover::sim::autopilot::script::{FlightScript, ScriptLeg};
use holdover::sim::models::OutageKind;
use holdover::wire::frame::{ComponentId, Scan, SystemId, scan};
use holdover::wire::frame_bytes::FrameBytes;
use holdover::wire::session::Address;
use holdover::wire::session::identity::AutopilotKind;
use holdover::wire::session::outgoing::FrameWriter;
use mavlink::dialects::ardupilotmega::{COMMAND_LONG_DATA, MavCmd, MavMessage};
use nalgebra::Vector3;
use tokio::net::UdpSocket;
use tokio::time::{Instant, sleep};

/// How much faster than real time.
const SPEED: f64 = 12.0;
/// No flight takes longer than this, s of the simulation.
const LONGEST_S: f64 = 400.0;
/// The simulation is never further behind the clock than this, s of the simulation: a busy machine slows it down instead.
const MOST_BEHIND_S: f64 = 0.1;

/// A flight, when it is over.
struct Flown {
    report: DoubleReport,
    mode: FlightMode,
}

/// Up for a square of 12 m, a hover in which GNSS is lost, another square, GNSS again, and down.
fn outage(hold_s: f64, switches: bool) -> FlightScript {
    outage_after(25.0, hold_s, switches)
}

/// The same after another while on the ground.
fn outage_after(ground_s: f64, hold_s: f64, switches: bool) -> FlightScript {
    let square = || {
        [(12.0, 0.0), (12.0, 12.0), (0.0, 12.0), (0.0, 0.0)].map(|(north_m, east_m)| ScriptLeg::FlyTo {
            north_m,
            east_m,
            heading_rad: 0.6,
        })
    };
    let select = |set| switches.then_some(ScriptLeg::SelectSet(set));
    let mut legs = vec![ScriptLeg::Wait(ground_s), ScriptLeg::Arm, ScriptLeg::TakeOff(10.0)];
    legs.extend(square());
    legs.extend([ScriptLeg::Wait(3.0), ScriptLeg::Gnss(Some(OutageKind::NoFix)), ScriptLeg::Wait(3.0)]);
    legs.extend(select(2));
    legs.push(ScriptLeg::Wait(hold_s));
    legs.extend(square());
    legs.extend([ScriptLeg::Gnss(None), ScriptLeg::Wait(14.0)]);
    legs.extend(select(1));
    legs.extend([ScriptLeg::Wait(5.0), ScriptLeg::Land]);
    FlightScript::new(legs)
}

/// At such a speed answers to TIMESYNC tell the daemon of a clock that runs so many times too fast, which none does.
fn settings(kind: AutopilotKind, script: FlightScript) -> DoubleSettings {
    let settings = DoubleSettings::documented(kind, script);
    let manners = settings.manners.clone().without(Manner::AnswersTimesync).without(Manner::AsksTimesync);
    DoubleSettings { manners, wind_ned: Vector3::new(2.0, 1.5, 0.0), ..settings }
}

fn holdover(more: &[&str]) -> Holdover {
    let config = format!("{}/config/copter.toml", env!("CARGO_MANIFEST_DIR"));
    let arguments = ["--config", &config, "--endpoint", "udpin:127.0.0.1:0"];
    Holdover::run(&[&arguments[..], more].concat())
}

/// Flies a double beside the daemon until it has landed.
async fn fly(settings: DoubleSettings, daemon: &Holdover) -> Flown {
    fly_and(settings, daemon, |_| {}).await
}

/// The same; `meddle` may do something to the double every now and then.
async fn fly_and(
    settings: DoubleSettings,
    daemon: &Holdover,
    mut meddle: impl FnMut(&mut AutopilotDouble),
) -> Flown {
    let mut double = AutopilotDouble::new(settings);
    let socket = Arc::new(UdpSocket::bind("127.0.0.1:0").await.unwrap());
    socket.connect(daemon.address()).await.unwrap();
    let (mut out, mut buffer) = (Vec::new(), vec![0; 2000]);
    let mut began = Instant::now();
    while !double.vehicle().is_done() {
        let now_s = double.vehicle().now_s();
        assert!(now_s < LONGEST_S, "it does not land: {:?}\n{}", double.report(), daemon.log());
        while let Ok(n) = socket.try_recv(&mut buffer) {
            hear(&mut double, &buffer[..n]);
        }
        meddle(&mut double);
        let due_s = began.elapsed().as_secs_f64() * SPEED;
        if due_s - now_s > MOST_BEHIND_S {
            began += Duration::from_secs_f64((due_s - now_s - MOST_BEHIND_S) / SPEED);
        }
        while double.vehicle().now_s() < due_s.min(now_s + MOST_BEHIND_S) {
            double.step(&mut out);
        }
        for (port, bytes) in out.drain(..) {
            assert_eq!(port, DoublePort::Main);
            socket.send(&bytes).await.unwrap();
        }
        sleep(Duration::from_millis(1)).await;
    }
    Flown { report: double.report(), mode: double.vehicle().mode() }
}

/// Gives a datagram's frames to the double.
fn hear(double: &mut AutopilotDouble, mut rest: &[u8]) {
    while let Scan::Frame(frame) = scan(rest, true) {
        double.hear(FrameBytes::new(frame.bytes()).unwrap());
        rest = &rest[frame.len()..];
    }
}

/// Aligned before it flew, holdover when GNSS went, joined when it came back; no failsafe, and near enough to the truth. The log tells
/// everything; STATUSTEXT is paced by the companion's clock, and a flight in a few seconds is too much for it.
fn held(flown: &Flown, daemon: &Holdover, bound_m: f64) {
    let report = &flown.report;
    let told = format!("{report:?}\n{}", daemon.log());
    assert_eq!((flown.mode, report.failsafe_s), (FlightMode::Landing, None), "{told}");
    assert!(report.lost_s.is_some() && report.back_s.is_some(), "{told}");
    for change in ["Aligning -> Aided", "Aided -> Holdover: GNSS no fix", "Rejoining -> Aided"] {
        assert!(daemon.told(change) >= 1, "no \"{change}\": {told}");
    }
    assert!(report.fused > 500, "{told}");
    assert!(report.drift_max_m < bound_m, "{told}");
    println!("{:.2} m astray at most, {:.2} m in the end", report.drift_max_m, report.drift_end_m);
}

#[tokio::test]
async fn beside_ardupilot_the_readme_holds_it_through_an_outage() {
    let mut daemon = holdover(&["--set", "outbound.publish=always"]);
    let flown = fly(settings(AutopilotKind::ArduPilot, outage(20.0, true)), &daemon).await;
    held(&flown, &daemon, 6.0);
    daemon.stop();
}

#[tokio::test]
async fn beside_ardupilot_holdover_switches_over_and_back_by_itself() {
    // By the default settings, but for a patience in real time, which is a twelfth of the flight's.
    let mut daemon = holdover(&["--set", "tuning.handover.return_after_s=0.1"]);
    let flown = fly(settings(AutopilotKind::ArduPilot, outage(20.0, false)), &daemon).await;
    held(&flown, &daemon, 6.0);
    for text in ["EKF source set 2", "EKF source set 1"] {
        assert_eq!(daemon.told(text), 1, "{text}: {}", daemon.log());
    }
    assert!(daemon.told("autopilot flies on our position") > 0, "{}", daemon.log());
    daemon.stop();
}

#[tokio::test]
async fn beside_px4_the_readme_holds_it_through_an_outage() {
    let mut daemon = holdover(&["--set", "outbound.publish=always"]);
    let flown = fly(settings(AutopilotKind::Px4, outage(20.0, false)), &daemon).await;
    held(&flown, &daemon, 6.0);
    daemon.stop();
}

#[tokio::test]
async fn a_companion_camera_carries_a_vehicle_that_has_no_flow_of_its_own() {
    let mut daemon = holdover(&["--set", "outbound.publish=always"]);
    let settings = DoubleSettings {
        camera: Some(DoublePort::Main),
        ..settings(AutopilotKind::ArduPilot, outage(15.0, true))
    };
    let flown = fly(settings, &daemon).await;
    held(&flown, &daemon, 6.0);
    assert_eq!(daemon.told("carried by optical flow"), 1, "{}", daemon.log());
    daemon.stop();
}

/// A flight beside a Holdover that says nothing: which is what the others would be if it were of no use.
async fn alone(kind: AutopilotKind, after_s: std::ops::Range<f64>) {
    let mut daemon = holdover(&["--set", "outbound.publish=never"]);
    let mut settings = settings(kind, outage(20.0, false));
    if kind == AutopilotKind::ArduPilot {
        // With it ArduPilot would not arm.
        settings.parameters.set("VISO_TYPE", 0.0).unwrap();
    }
    let flown = fly(settings, &daemon).await;
    let report = flown.report;
    assert_eq!((flown.mode, report.external), (FlightMode::FailsafeLanding, 0), "{report:?}");
    let acted = report.failsafe_s.unwrap() - report.lost_s.unwrap();
    assert!(after_s.contains(&acted), "{acted} s after the loss");
    daemon.stop();
}

#[tokio::test]
async fn without_a_word_from_holdover_px4_lands_by_its_own_failsafe() {
    alone(AutopilotKind::Px4, 5.0..6.5).await;
}

#[tokio::test]
async fn without_a_word_from_holdover_ardupilot_lands_by_its_own_failsafe() {
    alone(AutopilotKind::ArduPilot, 15.5..17.0).await;
}

/// Beside an ArduPilot whose pilot never switches nothing that is sent helps.
#[tokio::test]
async fn who_is_not_switched_to_does_not_help() {
    let mut daemon = holdover(&["--set", "outbound.publish=always"]);
    let mut settings = settings(AutopilotKind::ArduPilot, outage(20.0, false));
    // As an autopilot of old: no command of a companion switches it.
    settings.parameters.set("EK3_SRC2_POSXY", 0.0).unwrap();
    settings.parameters.set("EK3_SRC2_VELXY", 0.0).unwrap();
    settings.parameters.set("EK3_SRC2_VELZ", 0.0).unwrap();
    let flown = fly(settings, &daemon).await;
    assert_eq!(flown.mode, FlightMode::FailsafeLanding, "{:?}", flown.report);
    assert!(flown.report.external > 500 && flown.report.fused == 0, "{:?}", flown.report);
    daemon.stop();
}

fn reboot() -> FrameBytes {
    let station = Address { system: SystemId(255), component: ComponentId(190) };
    let command = COMMAND_LONG_DATA {
        param1: 1.0,
        param2: 0.0,
        param3: 0.0,
        param4: 0.0,
        param5: 0.0,
        param6: 0.0,
        param7: 0.0,
        command: MavCmd::MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN,
        target_system: 1,
        target_component: 1,
        confirmation: 0,
    };
    FrameWriter::new(station).write(&MavMessage::COMMAND_LONG(command)).unwrap()
}

#[tokio::test]
async fn an_autopilot_that_reboots_on_the_ground_is_flown_all_the_same() {
    let mut daemon = holdover(&["--set", "outbound.publish=always"]);
    let settings = settings(AutopilotKind::Px4, outage_after(45.0, 10.0, false));
    let mut rebooted = false;
    let flown = fly_and(settings, &daemon, |double| {
        if double.vehicle().now_s() > 20.0 && !std::mem::replace(&mut rebooted, true) {
            double.hear(reboot());
        }
    })
    .await;
    assert_eq!(daemon.told("the autopilot rebooted"), 1, "{}", daemon.log());
    held(&flown, &daemon, 6.0);
    daemon.stop();
}

/// ArduPilot does not wait for longer than eight seconds, and Holdover tells what it lacked.
#[tokio::test]
async fn a_link_that_is_silent_for_ten_seconds_ends_in_a_landing_with_its_cause() {
    let mut daemon = holdover(&["--set", "outbound.publish=always"]);
    let silent = (90.0, 100.0);
    let mut settings = settings(AutopilotKind::ArduPilot, outage(40.0, true));
    settings.faults = LinkFaults { silent_s: Some(silent), ..LinkFaults::default() };
    let flown = fly(settings, &daemon).await;
    let report = flown.report;
    assert!(report.lost_s.unwrap() + 5.0 < silent.0, "the flight is another: {report:?}");
    let acted = report.failsafe_s.expect("no failsafe acted") - silent.0;
    assert!((7.5..9.0).contains(&acted), "{acted} s after the link fell silent");
    daemon.wait_for("silent", 1);
    daemon.stop();
}
