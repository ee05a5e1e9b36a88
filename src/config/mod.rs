//! Settings: `config/default.toml`, then files, the environment, and `--set`, checked one by one, then validated into types.
//!
//! The defaults are the schema: a source may only hold keys that they hold, of the same type, within [`limits`]. So every
//! complaint can name the source and the key.

pub mod error;
mod landmarks;
pub mod limits;
mod raw;

use std::path::{Path, PathBuf};

use config::{Config as Merger, Environment, File, FileFormat};
use serde_json::Value;

use crate::pipeline::PipelineSettings;
use crate::wire::endpoint::Endpoint;
use crate::wire::frame::SystemId;
use crate::wire::session::requests::StreamSettings;

pub use error::{ConfigError, Problem};
use limits::Schema;

/// The defaults, with every key, unit and range.
pub const DEFAULT_TOML: &str = include_str!("../../config/default.toml");

/// The environment variable that overrides `log.level`, also with directives as in `info,holdover::wire=debug`.
pub const LOG_VARIABLE: &str = "HOLDOVER_LOG";

/// Prefix of environment variables: `HOLDOVER_OUTBOUND__RATE_HZ` is `outbound.rate_hz`.
const PREFIX: &str = "HOLDOVER";

/// Everything that can be set, validated.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The autopilot to follow; `None` follows the first.
    pub system: Option<SystemId>,
    /// Where it is.
    pub endpoints: Vec<Endpoint>,
    /// Links.
    pub link: LinkSettings,
    /// Messages to ask for.
    pub streams: StreamSettings,
    /// Navigation and output.
    pub pipeline: PipelineSettings,
    /// Tell mode changes by STATUSTEXT.
    pub statustext: bool,
    /// Log level.
    pub log_level: String,
}

/// Settings of the links.
#[derive(Clone, Copy, Debug)]
pub struct LinkSettings {
    /// See the defaults.
    pub peer_timeout_s: f64,
    /// See the defaults.
    pub reconnect_min_ms: u64,
    /// See the defaults.
    pub reconnect_max_ms: u64,
    /// See the defaults.
    pub queue_frames: usize,
    /// See the defaults.
    pub stale_output_ms: u64,
}

/// Where settings come from, in the order in which they override each other.
#[derive(Clone, Debug, Default)]
pub struct Sources {
    /// Files.
    pub files: Vec<PathBuf>,
    /// Environment variables (name, value); only those that begin with `HOLDOVER_` count.
    pub environment: Vec<(String, String)>,
    /// `key=value`.
    pub overrides: Vec<String>,
}

impl Settings {
    /// Loads and validates.
    ///
    /// # Errors
    /// [`ConfigError`] with every problem found, each with its source and key.
    pub fn load(sources: &Sources) -> Result<Self, ConfigError> {
        let schema = Schema::new(parse_toml("config/default.toml", DEFAULT_TOML)?);
        let mut merger = Merger::builder().add_source(File::from_str(DEFAULT_TOML, FileFormat::Toml));
        let mut problems = Vec::new();
        for path in &sources.files {
            let text = read(path)?;
            let name = path.display().to_string();
            let tree = parse_toml(&name, &text)?;
            problems.extend(schema.check(&name, &tree));
            merger = merger.add_source(File::from_str(&text, FileFormat::Toml));
        }
        let environment = environment(&sources.environment);
        let tree = tree_of("environment", Merger::builder().add_source(environment.clone()))?;
        problems.extend(schema.check("environment", &tree));
        merger = merger.add_source(environment);
        for text in &sources.overrides {
            let name = format!("--set {text}");
            let toml =
                override_toml(text).ok_or_else(|| ConfigError::one(&name, "", "expected key=value"))?;
            let tree = parse_toml(&name, &toml)?;
            problems.extend(schema.check(&name, &tree));
            merger = merger.add_source(File::from_str(&toml, FileFormat::Toml));
        }
        if !problems.is_empty() {
            return Err(ConfigError { problems });
        }
        let merged = tree_of("settings", merger)?;
        let raw: raw::Raw =
            serde_json::from_value(merged).map_err(|e| ConfigError::one("settings", "", &e.to_string()))?;
        raw.validate()
    }
}

fn read(path: &Path) -> Result<String, ConfigError> {
    std::fs::read_to_string(path)
        .map_err(|e| ConfigError::one(&path.display().to_string(), "", &e.to_string()))
}

fn parse_toml(name: &str, text: &str) -> Result<Value, ConfigError> {
    tree_of(name, Merger::builder().add_source(File::from_str(text, FileFormat::Toml)))
}

fn tree_of(
    name: &str,
    merger: config::ConfigBuilder<config::builder::DefaultState>,
) -> Result<Value, ConfigError> {
    merger
        .build()
        .and_then(|c| c.try_deserialize::<Value>())
        .map_err(|e| ConfigError::one(name, "", e.to_string().trim_end()))
}

fn environment(variables: &[(String, String)]) -> Environment {
    let setting = |name: &str| name.starts_with("HOLDOVER_") && name != LOG_VARIABLE;
    let ours = variables.iter().filter(|(k, _)| setting(k)).cloned().collect();
    Environment::with_prefix(PREFIX)
        .prefix_separator("_")
        .separator("__")
        .try_parsing(true)
        .list_separator(",")
        .with_list_parse_key("link.endpoints")
        .with_list_parse_key("flow.patches_deg")
        .with_list_parse_key("landmarks.points")
        .with_list_parse_key("landmarks.cameras")
        .source(Some(ours))
}

/// `key=value` as TOML; a value that is no TOML is taken as a string.
fn override_toml(text: &str) -> Option<String> {
    let (key, value) = text.split_once('=')?;
    let (key, value) = (key.trim(), value.trim());
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '.';
    if key.is_empty() || !key.chars().all(plain) {
        return None;
    }
    let as_is = format!("{key} = {value}");
    let reads = !value.contains('\n')
        && Merger::builder().add_source(File::from_str(&as_is, FileFormat::Toml)).build().is_ok();
    Some(if reads { as_is } else { format!("{key} = {}", Value::String(value.to_owned())) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::Write;

    fn load_text(text: &str) -> Result<Settings, ConfigError> {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(text.as_bytes()).unwrap();
        Settings::load(&Sources { files: vec![file.path().to_owned()], ..Sources::default() })
    }

    fn message(result: Result<Settings, ConfigError>) -> String {
        result.unwrap_err().to_string()
    }

    #[test]
    fn the_defaults_are_valid() {
        let s = Settings::load(&Sources::default()).unwrap();
        assert_eq!(s.pipeline.outbound.rate_hz, 30.0);
        assert_eq!(s.system, None);
    }

    #[test]
    fn the_shipped_files_are_valid() {
        for name in ["copter", "plane", "sitl"] {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("config/{name}.toml"));
            Settings::load(&Sources { files: vec![path], ..Sources::default() }).unwrap();
        }
    }

    #[test]
    fn an_unknown_key_names_the_file_and_the_key_and_a_near_one() {
        let m = message(load_text("[outbound]\nrate = 5.0\n"));
        assert!(m.contains("outbound.rate") && m.contains("outbound.rate_hz") && m.contains("tmp"), "{m}");
    }

    #[test]
    fn a_wrong_type_and_an_impossible_value_name_the_key() {
        let m = message(load_text("[outbound]\nrate_hz = \"5\"\n[gnss]\nloss_s = -1.0\n"));
        assert!(m.contains("outbound.rate_hz") && m.contains("gnss.loss_s") && m.contains("0.2"), "{m}");
        let m = message(load_text("[outbound]\npublish = \"sometimes\"\n"));
        assert!(m.contains("sometimes") && m.contains("holdover"), "{m}");
        let m = message(load_text("[outbound]\nrate_hz = nan\n"));
        assert!(m.contains("outbound.rate_hz"), "{m}");
    }

    #[test]
    fn broken_toml_names_the_file() {
        let m = message(load_text("[outbound\n"));
        assert!(m.contains("tmp") && m.contains("line 1"), "{m}");
    }

    #[test]
    fn the_environment_and_the_command_line_override() {
        let sources = Sources {
            environment: vec![
                ("HOLDOVER_OUTBOUND__RATE_HZ".into(), "40".into()),
                ("HOLDOVER_LINK__ENDPOINTS".into(), "udpin:127.0.0.1:9,tcpout:localhost:5760".into()),
                ("HOME".into(), "x".into()),
                (LOG_VARIABLE.into(), "debug".into()),
            ],
            overrides: vec!["outbound.publish=always".into(), "gnss.delay_ms = 20".into()],
            ..Sources::default()
        };
        let s = Settings::load(&sources).unwrap();
        assert_eq!(s.pipeline.outbound.rate_hz, 40.0);
        assert_eq!(s.endpoints.len(), 2);
        assert_eq!(s.pipeline.navigator.gnss.delay_s, 0.02);
    }

    #[test]
    fn patches_are_read_and_wrong_ones_named() {
        let s = load_text("[flow]\npatches_deg = [\"1:-20:15\", \"2: 20 : 15.5\"]\n").unwrap();
        let patches = s.pipeline.navigator.flow.patches;
        assert_eq!(patches.iter().count(), 2);
        let image = patches.find(2).unwrap().image;
        assert!((image.x - 20f64.to_radians().tan()).abs() < 1e-12);
        assert!((image.y + 15.5f64.to_radians().tan()).abs() < 1e-12);
        for wrong in ["1", "1:2", "1:2:3:4", "300:0:0", "1:90:0", "1:0:nan", "x:0:0", "", "1:0:0\", \"1:5:5"]
        {
            let m = message(load_text(&format!("[flow]\npatches_deg = [\"{wrong}\"]\n")));
            assert!(m.contains("flow.patches_deg"), "{wrong}: {m}");
        }
        let m = message(load_text("[flow]\npatches_deg = [1.0]\n"));
        assert!(m.contains("flow.patches_deg"), "{m}");
        let environment = vec![("HOLDOVER_FLOW__PATCHES_DEG".into(), "3:0:0,4:10:-10".into())];
        let s = Settings::load(&Sources { environment, ..Sources::default() }).unwrap();
        assert_eq!(s.pipeline.navigator.flow.patches.iter().count(), 2);
    }

    #[test]
    fn a_wrong_override_is_named() {
        let sources = Sources { overrides: vec!["outbound.rate_hz=fast".into()], ..Sources::default() };
        let m = message(Settings::load(&sources));
        assert!(m.contains("--set") && m.contains("outbound.rate_hz"), "{m}");
        let sources = Sources { overrides: vec!["nonsense".into()], ..Sources::default() };
        assert!(message(Settings::load(&sources)).contains("key=value"));
        let sources = Sources {
            environment: vec![("HOLDOVER_OUTBOUND__RAT".into(), "1".into())],
            ..Sources::default()
        };
        assert!(message(Settings::load(&sources)).contains("outbound.rat"));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]
        #[test]
        fn arbitrary_text_is_refused_or_valid_but_never_a_panic(text in "\\PC*", key in "[a-z_.]{0,12}", value in "\\PC{0,12}") {
            let schema = Schema::new(parse_toml("d", DEFAULT_TOML).unwrap());
            let _ = parse_toml("x", &text).map(|t| schema.check("x", &t));
            let _ = Settings::load(&Sources { overrides: vec![format!("{key}={value}")], ..Sources::default() });
        }
    }
}
