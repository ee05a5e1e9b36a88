//! Settings from all sources: what is read, what is refused and how, and where it came from.

use super::*;
use crate::geo::{CameraMount, Geodetic, LocalNed};
use crate::landmark::LandmarkCamera;
use crate::navigator::sources::landmarks::LandmarkPlace;
use nalgebra::Vector3;
use proptest::prelude::*;
use std::io::Write;
use std::path::Path;

fn load_bytes(bytes: &[u8]) -> Result<Loaded, ConfigError> {
    let mut file = tempfile::NamedTempFile::with_prefix("mine").unwrap();
    file.write_all(bytes).unwrap();
    Loaded::load(&Sources { files: vec![file.path().to_owned()], ..Sources::default() })
}

fn load_text(text: &str) -> Result<Settings, ConfigError> {
    load_bytes(text.as_bytes()).map(|loaded| loaded.settings)
}

fn load_with(overrides: &[&str], environment: &[(&str, &str)]) -> Result<Loaded, ConfigError> {
    Loaded::load(&Sources {
        overrides: overrides.iter().map(|s| (*s).to_owned()).collect(),
        environment: environment.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect(),
        ..Sources::default()
    })
}

fn message<T: std::fmt::Debug>(result: Result<T, ConfigError>) -> String {
    result.unwrap_err().to_string()
}

/// All that a text's message has to hold.
fn refused(text: &str, words: &[&str]) {
    let m = message(load_text(text));
    for word in words {
        assert!(m.contains(word), "{text}\n{m}\nhas no {word}");
    }
}

#[test]
fn the_defaults_are_valid() {
    let loaded = Loaded::load(&Sources::default()).unwrap();
    let s = loaded.settings;
    assert_eq!(s.pipeline.outbound.rate_hz, 30.0);
    assert_eq!(s.system, None);
    assert_eq!((loaded.warnings.len(), loaded.in_force.len()), (0, nearest::keys().count()));
    assert!(loaded.in_force.iter().all(|e| e.origin == Origin::Default && !e.value.is_null()));
}

#[test]
fn the_shipped_files_are_valid() {
    for name in ["default", "copter", "plane", "sitl"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("config/{name}.toml"));
        Settings::load(&Sources { files: vec![path], ..Sources::default() }).unwrap();
    }
}

#[test]
fn every_word_of_a_choice_can_be_chosen() {
    for (path, key) in nearest::keys() {
        for word in key.choices {
            // Refusing what is unsigned takes a key.
            let loaded = load_with(&["signing.key_file=k", &format!("{path}={word}")], &[]).unwrap();
            let entry = loaded.in_force.into_iter().find(|e| e.path() == path).unwrap();
            assert_eq!(entry.value, *word);
        }
    }
}

#[test]
fn the_ends_of_every_range_are_allowed_and_what_is_beyond_is_not() {
    for (path, key) in nearest::keys() {
        let Some((low, high)) = key.range else { continue };
        let checked = |value: f64| {
            let text = format!("{path} = {value}");
            check::check(&check::SourceText { origin: Origin::Default, text }).problems.len()
        };
        assert_eq!((checked(low), checked(high)), (0, 0), "{path}");
        assert_eq!((checked(low - 1.0), checked(high + 1.0)), (1, 1), "{path}");
    }
}

#[test]
fn what_is_wrong_names_the_file_the_line_the_key_and_what_is_right() {
    refused("\n[outbound]\nrate = 5.0\n", &["mine", ":3: outbound.rate is no key", "outbound.rate_hz?"]);
    refused("[outbond]\nrate_hz = 5.0\n", &[":1: outbond is no section; did you mean outbound?"]);
    refused(
        "[outbound]\nrate_hz = \"5\"\n",
        &[":2: outbound.rate_hz is to be a number from 4 to 50, not \"5\""],
    );
    refused("[tuning.gnss]\nloss_s = -1.0\n", &[":2: tuning.gnss.loss_s is -1.0, out of range: 0.2 to 60"]);
    refused("[link]\npeer_timeout_s = 1e9\n", &["link.peer_timeout_s is 1e9", "0.5 to 600"]);
    refused(
        "[streams]\nretries = 1.5\n",
        &["streams.retries is to be a whole number from 0 to 100, not 1.5"],
    );
    refused(
        "[outbound]\npublish = \"maybe\"\n",
        &["outbound.publish is to be one of auto, holdover, always, never, not \"maybe\""],
    );
    refused("[flow]\nuse = 3\n", &["flow.use is to be true or false, not 3"]);
    refused("flow = 3\n", &[":1: flow is a section"]);
    refused(
        "[link]\nendpoints = [\"udpin:x:1\",\n  5]\n",
        &[":3: link.endpoints is to be a list of texts", "5"],
    );
    refused("[link]\nendpoints = [\"udp:somewhere\"]\n", &[":2: link.endpoints", "udpin:"]);
    refused("[outbound\n", &["mine", ":1: "]);
    refused("[log]\nlevel = \"info\"\nlevel = \"warn\"\n", &[":3: "]);
    refused("\"a\\nb\" = 1\n", &["a\\nb"]);
    refused("[\"tuning.gnss\"]\nloss_s = 1\n", &[":1: tuning.gnss is to stand without quotes"]);
}

#[test]
fn a_number_that_is_none_is_refused_and_named() {
    for value in ["nan", "-nan", "inf", "-inf", "1e400"] {
        refused(
            &format!("[outbound]\nrate_hz = {value}\n"),
            &[":2: outbound.rate_hz is", "no finite number"],
        );
    }
    refused(
        "[vehicle]\nsystem_id = 12345678901234567890\n",
        &[":2: vehicle.system_id", "out of range: 0 to 255"],
    );
    refused("[vehicle]\nsystem_id = 0xffffffffffffffffffffffffffffffffffff\n", &["vehicle.system_id"]);
    refused("[outbound]\nrate_hz = 12345678901234567890\n", &["outbound.rate_hz", "4 to 50"]);
}

#[test]
fn everything_that_is_wrong_is_told_at_once_but_not_without_end() {
    let sources = Sources {
        files: vec!["no-such.toml".into()],
        environment: vec![("HOLDOVER_OUTBOUND__RAT".into(), "1".into())],
        overrides: vec!["nonsense".into(), "outbound.rate_hz=fast".into()],
    };
    let m = message(Settings::load(&sources));
    for word in [
        "no-such.toml",
        "environment HOLDOVER_OUTBOUND__RAT: outbound.rat",
        "key=value",
        "--set outbound.rate_hz=fast",
    ] {
        assert!(m.contains(word), "{m}");
    }
    let many: String = (0..10_000).map(|i| format!("key{i} = {i}\n")).collect();
    let m = message(load_text(&many));
    assert!(m.lines().count() < 40 && m.contains("more problems"), "{m}");
}

#[test]
fn old_names_are_refused_with_the_new_ones() {
    let mut old = 0;
    let mut refuses = |was: &str, now: &str| {
        old += 1;
        let m = message(load_with(&[&format!("{was}=1")], &[]));
        assert!(m.contains(&format!("{was} is now {now}")), "{m}");
    };
    for (path, key) in nearest::keys() {
        let list = matches!(key.kind, Type::Tables(_));
        for was in key.was {
            refuses(was, &if list { format!("[[{path}]], a table each") } else { path.clone() });
        }
        let Type::Tables(rows) = key.kind else { continue };
        for row in rows {
            row.was.iter().for_each(|was| refuses(was, &format!("{} in [[{path}]]", row.name())));
        }
    }
    assert!(old > 90, "{old}");
    refused(
        "[kalman]\ngyro_noise = 1\ngate_sigma = 5\n",
        &[
            ":2: kalman.gyro_noise is now tuning.filter.gyro_noise",
            ":3: kalman.gate_sigma is now tuning.filter.gate_sigma",
        ],
    );
    refused(
        "[landmarks]\npoints = [\"id=7 north_m=1 east_m=2 down_m=3\"]\n",
        &[":2: ", "[[landmarks.points]]", "id=7"],
    );
    refused("[landmarks]\ncameras = [\"\"]\n", &["landmarks.cameras is now [[cameras]]"]);
    refused("[flow]\nmount_yaw_deg = 90\n", &["flow.mount_yaw_deg is now yaw_deg in [[cameras]]"]);
    refused("[kalman]\n", &["kalman is no section"]);
}

#[test]
fn the_last_source_wins_and_is_named() {
    let mut file = tempfile::NamedTempFile::new().unwrap();
    file.write_all(b"[outbound]\nrate_hz = 20.0\nfarewell_s = 2\n\n[gnss]\ndelay_ms = 150\n").unwrap();
    let path = file.path().display().to_string();
    let loaded = Loaded::load(&Sources {
        files: vec![file.path().to_owned()],
        environment: vec![
            ("HOLDOVER_OUTBOUND__RATE_HZ".into(), "40".into()),
            ("HOLDOVER_GNSS__DELAY_MS".into(), "30".into()),
            ("HOLDOVER_LINK__ENDPOINTS".into(), "udpin:127.0.0.1:9,tcpout:localhost:5760".into()),
            ("HOME".into(), "x".into()),
            (LOG_VARIABLE.into(), "debug".into()),
        ],
        overrides: vec!["outbound.publish=always".into(), "gnss.delay_ms = 20".into()],
    })
    .unwrap();
    assert_eq!(loaded.settings.pipeline.outbound.rate_hz, 40.0);
    assert_eq!(loaded.settings.endpoints.len(), 2);
    assert_eq!(loaded.settings.pipeline.navigator.gnss.delay_s, 0.02);
    assert!(loaded.warnings.is_empty());
    for (key, value, origin) in [
        ("outbound.rate_hz", "40", "environment HOLDOVER_OUTBOUND__RATE_HZ".to_owned()),
        ("outbound.farewell_s", "2", format!("{path}:3")),
        ("outbound.publish", "\"always\"", "--set outbound.publish=always".to_owned()),
        ("gnss.delay_ms", "20", "--set gnss.delay_ms = 20".to_owned()),
        ("gnss.min_satellites", "5", "default".to_owned()),
    ] {
        let entry = loaded.in_force.iter().find(|e| e.path() == key).unwrap();
        assert_eq!((entry.value_toml().as_str(), entry.origin.to_string()), (value, origin), "{key}");
    }
}

#[test]
fn a_strange_variable_is_an_error_only_where_it_means_a_key() {
    let loaded =
        load_with(&[], &[("HOLDOVER_HOME", "/opt"), ("HOLDOVER_CAMERAS", "[{component = 4}]")]).unwrap();
    assert!(
        loaded.warnings.len() == 1 && loaded.warnings[0].contains("HOLDOVER_HOME"),
        "{:?}",
        loaded.warnings
    );
    for name in ["HOLDOVER_OUTBOUND__RAT", "HOLDOVER_A__Ä", "HOLDOVER___"] {
        let m = message(load_with(&[], &[(name, "1")]));
        assert!(m.contains("environment HOLDOVER_"), "{m}");
    }
    assert!(
        message(load_with(&[], &[("HOLDOVER_KALMAN__GYRO_NOISE", "1")])).contains("tuning.filter.gyro_noise")
    );
}

#[test]
fn patches_are_read_and_wrong_ones_named() {
    let s = load_text("[[flow.patches]]\nid = 1\nright_deg = -20\nforward_deg = 15\n[[flow.patches]]\nid = 2\nright_deg = 20\nforward_deg = 15.5\n").unwrap();
    let patches = s.pipeline.navigator.flow.patches;
    assert_eq!(patches.iter().count(), 2);
    let image = patches.find(2).unwrap().image;
    assert!((image.x - 20f64.to_radians().tan()).abs() < 1e-12);
    assert!((image.y + 15.5f64.to_radians().tan()).abs() < 1e-12);
    for (row, words) in [
        ("{id = 1}", &["flow.patches[0] has no right_deg", "flow.patches[0] has no forward_deg"][..]),
        ("{id = 300, right_deg = 0, forward_deg = 0}", &["flow.patches[0].id is 300"]),
        ("{id = 1, right_deg = 90, forward_deg = 0}", &["flow.patches[0].right_deg is 90", "-70 to 70"]),
        (
            "{id = 1, right = 9, forward_deg = 0}",
            &["flow.patches[0].right is no key; did you mean right_deg?"],
        ),
        ("{id = 1, right_deg = nan, forward_deg = 0}", &["flow.patches[0].right_deg", "finite"]),
        (
            "{id = 1, right_deg = 1, forward_deg = 0}, {id = 1, right_deg = 5, forward_deg = 5}",
            &["id 1 twice"],
        ),
        ("\"1:2:3\"", &["[[flow.patches]]"]),
    ] {
        refused(&format!("[flow]\npatches = [{row}]\n"), words);
    }
    refused("[flow.patches]\nid = 1\n", &["flow.patches is to be a list of tables with id"]);
}

/// Two cameras, of which landmarks use both and flow the one that it names.
const CAMERAS: &str = "\
[flow]
camera = 100
[landmarks]
points = [
  {id = 7, north_m = 12.5, east_m = -3, down_m = -0.4},
  {id = 200, latitude_deg = 63.4000213, longitude_deg = 10.4, height_m = 100.4},
]
[[cameras]]
[[cameras]]
component = 100
pitch_deg = 90
yaw_deg = 20
x_m = 0.2
delay_ms = 80
";

#[test]
fn landmarks_and_cameras_are_read() {
    let navigator = load_text(CAMERAS).unwrap().pipeline.navigator;
    let setup = navigator.landmarks.unwrap();
    assert_eq!(setup.points[0], (7, LandmarkPlace::Ned(Vector3::new(12.5, -3.0, -0.4))));
    let frame = LocalNed::new(Geodetic::from_degrees(63.4, 10.4, 100.0));
    let map = setup.map(&frame).unwrap();
    assert!((map.get(200).unwrap() - Vector3::new(2.374, 0.0, -0.4)).norm() < 2e-3);
    assert_eq!(setup.cameras[0].camera, LandmarkCamera::downward([60f64.to_radians(); 2]));
    let forward = setup.cameras[1];
    assert_eq!((forward.component, forward.delay_s), (100, 0.08));
    assert_eq!(forward.camera.mount.lever_arm.raw(), Vector3::new(0.2, 0.0, 0.0));
}

/// One camera, told of once, serves flow and landmarks alike.
#[test]
fn a_camera_is_one_for_flow_and_landmarks() {
    let navigator = load_text(CAMERAS).unwrap().pipeline.navigator;
    let mount = navigator.flow.mount;
    assert_eq!(mount, navigator.landmarks.unwrap().cameras[1].camera.mount);
    // Pitched up by a quarter it looks to the front; turned before by 20 degrees, to the right of it.
    let yaw = 20f64.to_radians();
    assert!((mount.axis().raw() - Vector3::new(yaw.cos(), yaw.sin(), 0.0)).norm() < 1e-12);
}

#[test]
fn flow_looks_down_unless_a_camera_is_named() {
    let mount = |text: &str| load_text(text).unwrap().pipeline.navigator.flow.mount;
    let down = mount("");
    assert_eq!(down, CameraMount::downward());
    assert_eq!(mount("[[cameras]]\ncomponent = 100\npitch_deg = 90\n"), down);
    assert_ne!(mount("[[cameras]]\npitch_deg = 90\n"), down);
    refused("[flow]\ncamera = 3\n", &[":2: flow.camera is 3, but no [[cameras]] has that component"]);
}

#[test]
fn wrong_landmarks_and_cameras_are_named() {
    let point = |id: &str| format!("{{{id}, north_m = 1, east_m = 2, down_m = 3}}");
    for (points, word) in [
        (point("id = 256"), "landmarks.points[0].id is 256"),
        (point("id = 1.5"), "whole number"),
        (point("id = \"x\""), "whole number"),
        ("{north_m = 1, east_m = 2, down_m = 3}".into(), "landmarks.points[0] has no id"),
        (format!("{}, {}", point("id = 1"), point("id = 1")), "landmark 1 is there twice"),
        ("{id = 1, north_m = nan, east_m = 2, down_m = 3}".into(), "north_m is nan"),
        ("{id = 1, north_m = 1e9, east_m = 2, down_m = 3}".into(), "north_m is 1e9"),
        ("{id = 1, north_m = 1, east_m = 2}".into(), "has landmark 1 with neither"),
        ("{id = 1, latitude_deg = 91, longitude_deg = 0, height_m = 0}".into(), "latitude_deg is 91"),
        ("{id = 1, latitude_deg = 9, longitude_deg = 0, down_m = 0}".into(), "has landmark 1 with neither"),
        ("7".into(), "is to be tables"),
    ] {
        refused(&format!("[landmarks]\npoints = [{points}]\n"), &["mine", ":2: landmarks.points", word]);
    }
    refused(&format!("{CAMERAS}\n[landmarks.x]\n"), &["landmarks.x is no key"]);
    refused(
        "[landmarks]\nframe = \"local\"\npoints = [{id = 3, latitude_deg = 1, longitude_deg = 1, height_m = 1}]\n",
        &["landmark 3", "local frame"],
    );
    for (cameras, word) in [
        ("[{half_x_deg = 90}]", "cameras[0].half_x_deg is 90"),
        ("[{colour = 1}]", "cameras[0].colour is no key"),
        ("[{}, {component = 0}]", "cameras has component 0 twice"),
        ("[]", "cameras is empty"),
    ] {
        refused(
            &format!("cameras = {cameras}\n[landmarks]\npoints = [{}]\n", point("id = 1")),
            &[":1: ", word],
        );
    }
}

#[test]
fn what_does_not_fit_together_is_refused() {
    for word in ["never", "heartbeat"] {
        refused(
            &format!("[signing]\naccept_unsigned = \"{word}\"\n"),
            &[":2: signing.accept_unsigned", "signing.key_file"],
        );
    }
    refused("[tuning.link]\nreconnect_min_ms = 6000\n", &[":2: tuning.link.reconnect_min_ms is greater"]);
    refused("[tuning.gnss]\nrecover_s = 300\n", &["tuning.gnss.recover_far_s is less"]);
}

/// Values of all kinds.
fn value() -> impl Strategy<Value = String> {
    prop_oneof![
        any::<f64>().prop_map(|v| format!("{v:?}").to_lowercase()),
        any::<i64>().prop_map(|v| v.to_string()),
        "[0-9]{18,40}",
        any::<bool>().prop_map(|v| v.to_string()),
        "[a-z_]{0,12}".prop_map(|v| format!("\"{v}\"")),
        Just("[{}]".to_owned()),
        Just("[[[]], {a.b = 1}]".to_owned()),
        Just("1979-05-27".to_owned()),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn arbitrary_bytes_are_refused_or_valid_but_never_a_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = load_bytes(&bytes).map_err(|e| e.to_string());
    }

    #[test]
    fn arbitrary_text_is_refused_or_valid_but_never_a_panic(text in "\\PC*", key in "[a-z_.]{0,12}", value in "\\PC{0,12}") {
        let _ = load_text(&text).map_err(|e| e.to_string());
        let _ = load_with(&[&format!("{key}={value}"), &text], &[(&format!("HOLDOVER_{key}"), &value)]);
    }

    #[test]
    fn arbitrary_toml_is_refused_or_within_the_limits(picked in prop::collection::vec((0usize..1000, value(), 0usize..8), 1..6)) {
        let keys: Vec<_> = nearest::keys().collect();
        let overrides: Vec<String> = picked
            .iter()
            .map(|(i, value, cut)| {
                let (path, _) = &keys[i % keys.len()];
                // Now and then a key that there is not.
                let path = if *cut == 0 { &path[..path.len() - 1] } else { path };
                format!("{path}={value}")
            })
            .collect();
        let texts: Vec<&str> = overrides.iter().map(String::as_str).collect();
        match load_with(&texts, &[]) {
            Ok(loaded) => for entry in loaded.in_force {
                if let (Some((low, high)), Some(v)) = (entry.key.range, entry.value.as_f64()) {
                    prop_assert!((low..=high).contains(&v), "{} = {v}", entry.path());
                }
            },
            Err(e) => prop_assert!(e.problems.iter().all(|p| !p.what.is_empty()), "{e}"),
        }
    }
}
