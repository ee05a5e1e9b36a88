//! The log of a simulated flight over markers, from end to end: `simulate` writes it with the configuration, `replay` loses GNSS.

use std::path::Path;

use crate::command::holdover;
use holdover::geo::Body;
use holdover::sample::{Input, LandmarkSample, Sample, Sighting};
use holdover::time::AutopilotTime;
use holdover::wire::counters::Cause;
use holdover::wire::decode::Decoder;
use holdover::wire::encode_vehicle;
use holdover::wire::frame::{ComponentId, SystemId};
use holdover::wire::session::Address;
use holdover::wire::session::identity::{AutopilotKind, Vehicle};
use holdover::wire::session::outgoing::FrameWriter;
use mavlink::dialects::ardupilotmega::{MavFrame, MavMessage};
use nalgebra::Vector3;
use serde_json::Value;
use tempfile::tempdir;

fn replay(log: &Path, more: &[&str]) -> Value {
    let fixed = ["replay", log.to_str().unwrap(), "--json", "--outage", "120..420", "--outage", "135..420"];
    holdover(&[&fixed[..], more].concat()).json()
}

fn outage(report: &Value, nth: usize, key: &str) -> f64 {
    report["outages"][nth][key].as_f64().unwrap_or_else(|| panic!("{key}: {report}"))
}

#[test]
fn a_field_of_markers_takes_the_drift_out_of_five_minutes_without_gnss() {
    let folder = tempdir().unwrap();
    let log = folder.path().join("field.tlog");
    let path = log.to_str().unwrap();
    let field =
        ["--markers", "8", "--wrong-ids", "3", "--lost-sightings", "40", "--imu", "mems", "--seed", "11"];
    let simulate = |more: &[&str]| {
        holdover(&[&["simulate", "patrol", "--duration", "425", "--out", path], &field[..], more].concat())
    };
    let ran = simulate(&[]);
    let config = log.with_extension("landmarks.toml");
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert!(ran.out.contains("markers") && ran.out.contains(config.to_str().unwrap()), "{}", ran.out);
    simulate(&[]).fails(2, &["--force"]);
    let config = config.to_str().unwrap();
    let with = replay(&log, &["--config", config]);
    let max = outage(&with, 1, "horizontal_error_max_m");
    assert!(max < 0.3, "{max} m");
    assert!(outage(&with, 0, "horizontal_error_max_m") < 2.5, "what GNSS was wrong by: {with}");
    let (error, sigma) = (outage(&with, 1, "horizontal_error_end_m"), outage(&with, 1, "sigma_end_m"));
    assert!(sigma < 0.3 && error < 3.0 * sigma, "{error} m, sigma {sigma} m");
    let without = replay(&log, &[]);
    assert!(outage(&without, 1, "horizontal_error_max_m") > 5.0 * max, "{without}");
    assert!(outage(&without, 1, "sigma_end_m") > 5.0 * sigma, "{without}");
    // Present, but switched off: the same bytes as without.
    let off = replay(&log, &["--config", config, "--set", "landmarks.use=false"]);
    assert_eq!(off["outages"], without["outages"]);
    let told = holdover(&["replay", path, "--config", config, "--outage", "120..420"]).out;
    for word in ["landmarks found", "carried by landmarks", "landmark position"] {
        assert!(told.contains(word), "no \"{word}\" in {told}");
    }
    let inspected = holdover(&["inspect", path]).out;
    assert!(inspected.contains("landmarks: a position in holdover, once configured"), "{inspected}");
    let inspected = holdover(&["inspect", path, "--config", config]).out;
    assert!(inspected.contains("64 landmarks are configured"), "{inspected}");
}

#[test]
fn fields_that_cannot_be_laid_out_are_refused() {
    let folder = tempdir().unwrap();
    let out = folder.path().join("x.tlog");
    let simulate =
        |more: &[&str]| holdover(&[&["simulate", "patrol", "--out", out.to_str().unwrap()], more].concat());
    simulate(&["--markers", "1"]).fails(2, &["256"]);
    simulate(&["--markers", "0"]).fails(2, &["--markers"]);
    simulate(&["--markers", "8", "--wrong-ids", "101"]).fails(2, &["--wrong-ids"]);
    simulate(&["--wrong-ids", "1"]).fails(2, &["--markers"]);
    assert!(!out.exists());
}

/// A decoder that follows system 1, and its clock running at 20 s.
fn decoder() -> Decoder {
    let mut decoder = Decoder::new();
    decoder.follow(&Vehicle {
        system: SystemId(1),
        component: ComponentId::AUTOPILOT,
        autopilot: AutopilotKind::ArduPilot,
        vehicle_type: 2,
        armed: false,
        version: None,
    });
    let time =
        encode_vehicle::system_time(AutopilotTime::from_micros(20_000_000), 1_790_000_020_000_000).unwrap();
    assert!(hear(&mut decoder, 1, 1, &time).is_empty());
    decoder
}

fn hear(decoder: &mut Decoder, system: u8, component: u8, message: &MavMessage) -> Vec<Input> {
    let from = Address { system: SystemId(system), component: ComponentId(component) };
    let bytes = FrameWriter::new(from).write(message).unwrap();
    let mut items = Vec::new();
    decoder.decode(&bytes.frame().unwrap(), None, &mut items);
    items
}

fn message(sample: &LandmarkSample) -> MavMessage {
    let mut out = Vec::new();
    encode_vehicle::samples(&[Sample::Landmark(*sample)], &mut out);
    out.pop().unwrap()
}

#[test]
fn landing_target_of_any_component_of_the_vehicle_is_a_sighting() {
    let bearing = Sighting::Bearing { angle_xy: [0.25, -0.5], distance_m: Some(12.5) };
    let time = AutopilotTime::from_micros(19_950_000);
    for (component, sighting) in
        [(1, bearing), (100, bearing), (191, Sighting::Body(Body::new(Vector3::new(1.0, -2.0, 8.0))))]
    {
        let sample = LandmarkSample { time, camera: component, id: 7, sighting };
        let items = hear(&mut decoder(), 1, component, &message(&sample));
        assert_eq!(items, [Input::Sample(Sample::Landmark(sample))]);
        let mut other = decoder();
        assert!(hear(&mut other, 2, component, &message(&sample)).is_empty());
        assert_eq!(other.counters().of(Cause::WrongSystem), 1);
    }
}

#[test]
fn stamps_of_another_clock_and_frames_that_are_not_the_vehicles_are_counted() {
    let sighting = Sighting::Body(Body::new(Vector3::new(1.0, -2.0, 8.0)));
    let at = |us| LandmarkSample { time: AutopilotTime::from_micros(us), camera: 100, id: 7, sighting };
    let mut decoder = decoder();
    (0..20).for_each(|k| assert!(hear(&mut decoder, 1, 100, &message(&at(900_000_000 + k))).is_empty()));
    assert_eq!((decoder.counters().of(Cause::Stale), decoder.clock().reboots()), (20, 0));
    // Microseconds since 1970 are understood.
    let unix = hear(&mut decoder, 1, 100, &message(&at(1_790_000_019_990_000)));
    assert_eq!(unix, [Input::Sample(Sample::Landmark(at(19_990_000)))]);
    let mut in_frame = |frame, x| {
        let MavMessage::LANDING_TARGET(mut m) = message(&at(19_990_000)) else { panic!("no LANDING_TARGET") };
        (m.frame, m.x) = (frame, x);
        hear(&mut decoder, 1, 100, &MavMessage::LANDING_TARGET(m)).len()
    };
    assert_eq!(in_frame(MavFrame::MAV_FRAME_LOCAL_NED, 1.0) + in_frame(MavFrame::MAV_FRAME_GLOBAL, 1.0), 0);
    assert_eq!(in_frame(MavFrame::MAV_FRAME_BODY_FRD, f32::NAN), 0);
    assert_eq!(in_frame(MavFrame::MAV_FRAME_BODY_FRD, 1.0), 1);
    let counters = decoder.counters();
    assert_eq!((counters.of(Cause::ForeignFrame), counters.of(Cause::NotFinite)), (2, 1));
}
