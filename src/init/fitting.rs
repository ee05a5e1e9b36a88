//! What of a configuration follows from the vehicle that was heard.

use crate::preflight::conversation::PreflightReport;
use crate::preflight::readings::Readings;
use crate::sample::{Airframe, SampleKind};
use crate::wire::endpoint::Endpoint;
use crate::wire::session::identity::AutopilotKind;

use super::draft::{Draft, DraftHint};
use super::survey::{LinkSurvey, vehicle_word};

/// Where to begin with a kind of vehicle: the files of `config/`.
const COPTER: &str = include_str!("../../config/copter.toml");
const PLANE: &str = include_str!("../../config/plane.toml");

/// Bits on a serial line for a byte.
const BITS_PER_BYTE: f64 = 10.0;
/// How much of a line may be filled.
const FILLED: f64 = 0.8;
/// What an autopilot sends beside its IMU: everything that is asked for at its default rate, bytes/s.
const OTHER_BYTES_PER_S: f64 = 4000.0;
/// HIGHRES_IMU on the wire, bytes.
const IMU_BYTES: f64 = 75.0;
/// No slower IMU can be navigated with, Hz; and what is asked for by default.
const LEAST_IMU_HZ: f64 = 20.0;
const WANTED_IMU_HZ: f64 = 200.0;
/// From this rate on a line carries everything that is asked for, baud.
const COMFORTABLE: u32 = 460_800;

/// The rate of the IMU that a serial line has room for, Hz; `None` where it has for all of it.
pub fn imu_rate_of(baud: u32) -> Option<f64> {
    let bytes_per_s = f64::from(baud) / BITS_PER_BYTE * FILLED - OTHER_BYTES_PER_S;
    let rate = ((bytes_per_s / IMU_BYTES / 5.0).floor() * 5.0).clamp(LEAST_IMU_HZ, WANTED_IMU_HZ);
    (rate < WANTED_IMU_HZ && baud < COMFORTABLE).then_some(rate)
}

/// The links, and what they have room for. `usb` says of a device that it is no line, but a plug whose baud rate means nothing.
pub fn links(draft: &mut Draft, endpoints: &[Endpoint], why: &str, usb: impl Fn(&str) -> bool) {
    draft.set("link.endpoints", &texts(endpoints), why);
    let slowest = endpoints.iter().filter_map(|e| match e {
        Endpoint::Serial(port) if !usb(port.device()) => Some(port.baud()),
        _ => None,
    });
    let Some((baud, rate)) = slowest.min().and_then(|baud| Some((baud, imu_rate_of(baud)?))) else { return };
    if draft.sets("streams.imu_hz") {
        return;
    }
    let why = format!(
        "What {baud} baud have room for: 200 Hz of IMU take 15 kB/s. Faster is better: set the autopilot's port to 921600 baud (ArduPilot \
         SERIALn_BAUD 921, PX4 SER_TELn_BAUD), begin anew, and leave this out."
    );
    draft.set("streams.imu_hz", &format!("{rate:.1}"), why);
}

/// Sensors that speak on links of their own.
pub fn sensor_links(draft: &mut Draft, endpoints: &[Endpoint]) {
    if !endpoints.is_empty() {
        let why = "Flow, distances or landmarks come here, and no autopilot speaks: sensors of their own.";
        draft.set("link.sensor_endpoints", &texts(endpoints), why);
    }
}

/// Endpoints as TOML has them.
fn texts(endpoints: &[Endpoint]) -> String {
    let texts: Vec<String> =
        endpoints.iter().map(|e| serde_json::Value::from(e.to_string()).to_string()).collect();
    format!("[{}]", texts.join(", "))
}

/// Everything that follows from what was heard of a vehicle.
pub fn vehicle(draft: &mut Draft, survey: &LinkSurvey, report: &PreflightReport) {
    let readings = &report.readings;
    let v = &readings.vehicle;
    let version = v.version.map_or_else(String::new, |version| format!(" {version}"));
    draft.headline(format!(
        "Holdover's settings for a {} with {}{version}, system {}, as holdover init heard it.",
        vehicle_word(v.vehicle_type),
        v.autopilot,
        v.system.0
    ));
    whom_to_follow(draft, survey, readings);
    starting_point(draft, readings);
    signatures(draft, survey, report.answers_parameters);
    camera(draft, survey, readings);
    landmarks(draft, survey);
    draft.hint(DraftHint {
        why: "For the first flights: navigate and report, and send no position.".to_owned(),
        toml: "[outbound]\npublish = \"never\"".to_owned(),
    });
}

/// Where others are that could be followed, it is said who is.
fn whom_to_follow(draft: &mut Draft, survey: &LinkSurvey, readings: &Readings) {
    let (system, component) = (readings.vehicle.system.0, readings.vehicle.component.0);
    let others: Vec<u8> = survey.vehicles().into_iter().filter(|s| *s != system).collect();
    if !others.is_empty() && !draft.sets("vehicle.system_id") {
        let others: Vec<String> = others.iter().map(u8::to_string).collect();
        let why = format!("Vehicles of the systems {} are heard here, too.", others.join(", "));
        draft.set("vehicle.system_id", &system.to_string(), why);
    }
    let twin = survey.autopilots().find(|(s, c)| *s == system && *c != component);
    if let Some((_, twin)) = twin
        && !draft.sets("vehicle.component_id")
    {
        let why = format!("Component {twin} of the same system says that it is an autopilot, too.");
        draft.set("vehicle.component_id", &component.to_string(), why);
    }
}

/// The starting point for its kind, where there is one.
fn starting_point(draft: &mut Draft, readings: &Readings) {
    let low = readings.has(SampleKind::Flow) && readings.has(SampleKind::Range);
    let text = match readings.airframe {
        Some(Airframe::FixedWing) => PLANE,
        Some(Airframe::Multirotor) if low => COPTER,
        _ => return,
    };
    let what = text.lines().next().unwrap_or_default().trim_start_matches(['#', ' ']);
    for (path, value) in keys_of(text) {
        if !draft.sets(&path) {
            draft.set(&path, &value, format!("The starting point for {}", in_a_sentence(what)));
        }
    }
}

fn in_a_sentence(text: &str) -> String {
    let mut chars = text.chars();
    chars.next().map_or_else(String::new, |first| first.to_lowercase().chain(chars).collect())
}

/// Paths and values of a file whose sections hold plain values.
fn keys_of(text: &str) -> Vec<(String, String)> {
    let Ok(root) = toml::from_str::<serde_json::Value>(text) else { return Vec::new() };
    let mut out = Vec::new();
    flatten("", &root, &mut out);
    out
}

fn flatten(path: &str, value: &serde_json::Value, out: &mut Vec<(String, String)>) {
    match value.as_object() {
        Some(table) => {
            for (name, value) in table {
                let path = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
                flatten(&path, value, out);
            }
        }
        None => out.push((path.to_owned(), value.to_string())),
    }
}

/// Some autopilots sign, and take what is not signed all the same: `answered` says that ours was.
fn signatures(draft: &mut Draft, survey: &LinkSurvey, answered: bool) {
    if survey.signed == 0 || draft.sets("signing.key_file") {
        return;
    }
    let believed = if answered {
        "though the autopilot answers what is not signed"
    } else {
        "and the autopilot may believe nothing that is not signed"
    };
    draft.hint(DraftHint {
        why: format!("Frames are signed here, {believed}. Without the key nobody looks at the signatures: import it (holdover key import), and name its file."),
        toml: "[signing]\nkey_file = \"/etc/holdover/keys/holdover.key\"".to_owned(),
    });
}

/// A camera's computer does not tell how the camera is mounted; an autopilot's own sensor is turned by the autopilot.
fn camera(draft: &mut Draft, survey: &LinkSurvey, readings: &Readings) {
    let flow = survey.sensors.iter().find(|((kind, _), _)| *kind == SampleKind::Flow);
    let Some((_, flow)) = flow.filter(|(_, f)| f.from.1 != readings.vehicle.component.0) else { return };
    let component = flow.from.1;
    if draft.sets("cameras") {
        return;
    }
    draft.hint(DraftHint {
        why: format!(
            "Optical flow comes from component {component}, which does not tell how its camera is mounted: it is taken to look down from the IMU, \
             the top of the image forward. If it is mounted otherwise, say how (holdover replay prints after a flight by how much it is turned)."
        ),
        toml: format!(
            "[flow]\ncamera = {component}\n[[cameras]]\ncomponent = {component}\nyaw_deg = 90.0   # the image's top looks to the right\nx_m = 0.1   # \
             forward of the IMU"
        ),
    });
}

fn landmarks(draft: &mut Draft, survey: &LinkSurvey) {
    let heard = survey.sensors.keys().any(|(kind, _)| *kind == SampleKind::Landmark);
    if heard && !draft.sets("landmarks.points") {
        landmark_hint(draft);
    }
}

fn landmark_hint(draft: &mut Draft) {
    draft.hint(DraftHint {
        why: "LANDING_TARGET comes. Where the landmarks are has to be said before they are of use.".to_owned(),
        toml: "[landmarks]\npoints = [{id = 1, latitude_deg = 47.397742, longitude_deg = 8.545594, height_m = 488.0}]".to_owned(),
    });
}

/// What to type next.
pub fn next_steps(config: &str, autopilot: AutopilotKind, faults: usize) -> Vec<String> {
    let mut out = Vec::new();
    if faults > 0 && !matches!(autopilot, AutopilotKind::Other(_)) {
        out.push(format!("holdover preflight --config {config} --write    sets what the autopilot lacks"));
    } else {
        out.push(format!("holdover preflight --config {config}    checks the autopilot before each flight"));
    }
    out.push(format!(
        "holdover run --config {config} --set outbound.publish=never    navigates, and sends no position"
    ));
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Loaded, Sources};
    use crate::preflight::conversation::PreflightReport;
    use crate::sample::{FlowRotation, FlowSample, Input, Sample};
    use crate::time::{AutopilotTime, Span, Stamp};
    use crate::wire::frame::{ComponentId, SystemId};
    use crate::wire::session::heartbeat_fields::testing::heartbeat_frame;
    use crate::wire::session::identity::Vehicle;

    fn report(airframe: Airframe, come: &[SampleKind]) -> PreflightReport {
        let mut rates_hz = [0.0; SampleKind::ALL.len()];
        come.iter().for_each(|k| rates_hz[*k as usize] = 20.0);
        let vehicle = Vehicle {
            system: SystemId(1),
            component: ComponentId(1),
            autopilot: AutopilotKind::ArduPilot,
            vehicle_type: 2,
            armed: false,
            version: None,
        };
        let readings = Readings {
            vehicle,
            airframe: Some(airframe),
            mavlink1: false,
            rates_hz,
            gnss_fix: true,
            round_trip: None,
            parameters: Default::default(),
            untold: Vec::new(),
        };
        PreflightReport {
            readings,
            answers_parameters: true,
            findings: Vec::new(),
            written: Vec::new(),
            not_written: None,
        }
    }

    /// Heartbeats of autopilots, and flow of component 100 in the second frame.
    fn survey(autopilots: &[(u8, u8)], flow: bool) -> LinkSurvey {
        let mut survey = LinkSurvey::default();
        for (system, component) in autopilots {
            let frame = heartbeat_frame(*system, *component, 2, 3, 0);
            survey.hear(&frame.frame().unwrap(), Stamp::from_micros(0), &[]);
        }
        if flow {
            let sample = FlowSample {
                time: AutopilotTime::from_micros(1),
                sensor: 0,
                interval: Span::ZERO,
                rate_xy: [0.0; 2],
                rotation: FlowRotation::Contained,
                quality: 0.7,
                distance_m: None,
            };
            let frame = heartbeat_frame(1, 100, 30, 8, 0);
            survey.hear(
                &frame.frame().unwrap(),
                Stamp::from_micros(1),
                &[Input::Sample(Sample::Flow(sample))],
            );
        }
        survey
    }

    fn differing(draft: &Draft) -> Vec<(String, String)> {
        draft.differing().unwrap().into_iter().map(|(e, _)| (e.path(), e.value_toml())).collect()
    }

    fn pairs(of: &[(&str, &str)]) -> Vec<(String, String)> {
        of.iter().map(|(a, b)| ((*a).to_owned(), (*b).to_owned())).collect()
    }

    #[test]
    fn a_slow_line_is_asked_for_what_it_has_room_for() {
        assert_eq!(imu_rate_of(57_600), Some(20.0));
        assert_eq!(imu_rate_of(115_200), Some(65.0));
        assert_eq!(imu_rate_of(230_400), Some(190.0));
        assert_eq!(imu_rate_of(921_600), None);
        let endpoints = ["serial:/dev/ttyAMA0:115200".parse().unwrap()];
        let mut draft = Draft::default();
        links(&mut draft, &endpoints, "", |_| false);
        let expected = [("link.endpoints", "[\"serial:/dev/ttyAMA0:115200\"]"), ("streams.imu_hz", "65.0")];
        assert_eq!(differing(&draft), pairs(&expected));
        // A plug of USB is as fast as it is, and what was told is left as it is.
        let mut draft = Draft::default();
        links(&mut draft, &endpoints, "", |_| true);
        assert_eq!(differing(&draft), pairs(&expected[..1]));
        let mut draft = Draft::default();
        draft.set_as_told("streams.imu_hz=100");
        links(&mut draft, &endpoints, "", |_| false);
        assert_eq!(differing(&draft)[1], ("streams.imu_hz".to_owned(), "100".to_owned()));
    }

    #[test]
    fn sensors_of_their_own_have_a_link_of_their_own() {
        let mut draft = Draft::default();
        sensor_links(&mut draft, &[]);
        assert_eq!(differing(&draft), []);
        sensor_links(&mut draft, &["udpin:127.0.0.1:14551".parse().unwrap()]);
        assert_eq!(differing(&draft), pairs(&[("link.sensor_endpoints", "[\"udpin:127.0.0.1:14551\"]")]));
    }

    #[test]
    fn whom_to_follow_is_said_where_there_are_several() {
        let of = |autopilots: &[(u8, u8)]| {
            let mut draft = Draft::default();
            vehicle(&mut draft, &survey(autopilots, false), &report(Airframe::Multirotor, &[]));
            differing(&draft)
        };
        assert_eq!(of(&[(1, 1)]), []);
        assert_eq!(of(&[(1, 1), (7, 1)]), pairs(&[("vehicle.system_id", "1")]));
        assert_eq!(of(&[(1, 1), (1, 2)]), pairs(&[("vehicle.component_id", "1")]));
    }

    #[test]
    fn a_kind_of_vehicle_begins_where_its_file_does() {
        let of = |airframe, come: &[SampleKind]| {
            let mut draft = Draft::default();
            vehicle(&mut draft, &survey(&[(1, 1)], false), &report(airframe, come));
            draft
        };
        for (airframe, name) in [(Airframe::Multirotor, "copter"), (Airframe::FixedWing, "plane")] {
            let draft = of(airframe, &[SampleKind::Flow, SampleKind::Range]);
            let file = format!("{}/config/{name}.toml", env!("CARGO_MANIFEST_DIR"));
            let by_file = Loaded::load(&Sources { files: vec![file.into()], ..Sources::default() }).unwrap();
            let values = |l: Loaded| -> Vec<_> { l.in_force.into_iter().map(|e| e.value).collect() };
            assert_eq!(values(draft.loaded().unwrap()), values(by_file), "{name}");
        }
        assert_eq!(differing(&of(Airframe::Multirotor, &[SampleKind::Flow])), []);
        assert_eq!(differing(&of(Airframe::Surface, &[SampleKind::Flow, SampleKind::Range])), []);
    }

    #[test]
    fn hints_are_settings_that_can_be_made() {
        let mut draft = Draft::default();
        let mut heard = survey(&[(1, 1)], true);
        heard.signed = 1;
        vehicle(&mut draft, &heard, &report(Airframe::Multirotor, &[SampleKind::Flow]));
        landmark_hint(&mut draft);
        let text = draft.text().unwrap();
        for word in ["key_file", "component = 100", "points = [", "publish = \"never\""] {
            assert!(text.contains(word), "no {word} in {text}");
        }
        // Each as it is when its mark is taken away.
        let blocks: Vec<&str> = text.split("\n\n").filter(|b| b.contains("\n#   ")).collect();
        assert_eq!(blocks.len(), 4, "{text}");
        for block in blocks {
            let toml: String =
                block.lines().filter_map(|l| l.strip_prefix("#   ")).map(|l| format!("{l}\n")).collect();
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("hint.toml");
            std::fs::write(&path, &toml).unwrap();
            let loaded = Loaded::load(&Sources { files: vec![path], ..Sources::default() });
            assert!(loaded.is_ok(), "{toml}\n{:?}", loaded.err());
        }
    }
}
