//! Settings: the defaults, then files, the environment, and `--set`, checked one by one, merged, and validated into types.
//!
//! A key stands in one place, a declaration in `sections` that is the serde struct and says type, range, unit, default and doc (see
//! [`Key`]). From it come the checks, `config/default.toml`, the reference in the documentation and what `holdover check` shows. Every
//! complaint names the source with its line, and the key.

mod check;
mod error;
mod generated;
mod in_force;
mod key;
mod nearest;
mod read;
mod sections;

use std::collections::BTreeMap;
use std::path::PathBuf;

use config::{Config as Merger, File, FileFormat};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::pipeline::PipelineSettings;
use crate::record::RecordSettings;
use crate::state::StateDirectory;
use crate::wire::endpoint::Endpoint;
use crate::wire::frame::{ComponentId, SystemId};
use crate::wire::link::LinkLimits;
use crate::wire::session::identity::IdentityConfig;
use crate::wire::session::requests::StreamSettings;
use crate::wire::session::source_switch::SwitchSettings;
use crate::wire::signing::SigningSettings;

pub use error::{ConfigError, Origin, Problem};
pub use generated::{default_toml, reference_markdown};
pub use in_force::InForce;
pub use key::{Key, Preset, Section, Type};
pub use sections::SECTIONS;

/// The environment variable that overrides `log.level`, also with directives as in `info,holdover::wire=debug`.
pub const LOG_VARIABLE: &str = "HOLDOVER_LOG";

/// Prefix of environment variables: `HOLDOVER_OUTBOUND__RATE_HZ` is `outbound.rate_hz`.
const PREFIX: &str = "HOLDOVER";

/// Everything that can be set, validated.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The autopilot's system; `None` follows whichever proves to be one.
    pub system: Option<SystemId>,
    /// The autopilot's component; `None` takes `MAV_COMP_ID_AUTOPILOT1`, or another that shows sensors.
    pub component: Option<ComponentId>,
    /// Where it is.
    pub endpoints: Vec<Endpoint>,
    /// Where sensors of their own are.
    pub sensor_endpoints: Vec<Endpoint>,
    /// Links.
    pub link: LinkSettings,
    /// Whose frames are believed.
    pub signing: SigningSettings,
    /// Messages to ask for.
    pub streams: StreamSettings,
    /// Navigation and output.
    pub pipeline: PipelineSettings,
    /// How an ArduPilot is switched over to our position, and back.
    pub source_switch: SwitchSettings,
    /// Tell mode changes by STATUSTEXT.
    pub statustext: bool,
    /// Where the state is kept.
    pub state: StateDirectory,
    /// What is heard and sent is recorded there, if anywhere.
    pub record: Option<RecordSettings>,
    /// Where the page, the API and the metrics are.
    pub status: StatusSettings,
    /// The daemon's log.
    pub log: LogSettings,
}

/// Settings of the page, the API and the metrics: `[status]`.
#[derive(Clone, Debug, Default)]
pub struct StatusSettings {
    /// Where they are served, if anywhere.
    pub listen: Option<std::net::SocketAddr>,
    /// Names that lead there, beside addresses.
    pub hosts: Vec<String>,
}

/// Settings of the log: `[log]`.
#[derive(Clone, Debug)]
pub struct LogSettings {
    /// How much to say.
    pub level: String,
    /// Where to.
    pub to: LogTo,
    /// Lines of one kind a minute; 0 is no limit.
    pub lines_per_event_per_min: u32,
}

/// Where the log goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LogTo {
    /// To the journal where systemd has connected standard error with it, else to standard error.
    Auto,
    /// To standard error.
    Stderr,
    /// To systemd's journal.
    Journal,
}

/// Settings of the links: `[link]` and `[tuning.link]`.
#[derive(Clone, Copy, Debug)]
pub struct LinkSettings {
    /// A silent UDP peer may be replaced after this, s.
    pub peer_timeout_s: f64,
    /// The first pause before reconnecting, ms.
    pub reconnect_min_ms: u64,
    /// The longest pause, ms.
    pub reconnect_max_ms: u64,
    /// Frames that may wait for the navigator.
    pub queue_frames: usize,
    /// What waited longer for a slow link is dropped, ms.
    pub stale_output_ms: u64,
    /// How long an autopilot's heartbeats must come from a UDP address before it is answered, ms.
    pub peer_confirm_ms: u64,
    /// How much a peer, or a stranger, may ask of a link.
    pub limits: LinkLimits,
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

/// Settings, and what is to be told of them.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The settings.
    pub settings: Settings,
    /// Every key with its value and where that came from, in the order of [`SECTIONS`].
    pub in_force: Vec<InForce>,
    /// What is odd, but no error.
    pub warnings: Vec<String>,
}

impl Settings {
    /// Which autopilot is to be served.
    pub fn identity(&self) -> IdentityConfig {
        IdentityConfig { system: self.system, component: self.component, ..IdentityConfig::default() }
    }

    /// Loads and validates.
    ///
    /// # Errors
    /// [`ConfigError`] with every problem found, each with its source and key.
    pub fn load(sources: &Sources) -> Result<Self, ConfigError> {
        Loaded::load(sources).map(|loaded| loaded.settings)
    }
}

impl Loaded {
    /// What differs from the defaults, as the text of a configuration file.
    pub fn differing_toml(&self) -> String {
        let given = self.in_force.iter().filter(|key| key.origin != Origin::Default);
        given.map(|key| format!("{} = {}\n", key.path(), key.value_toml())).collect()
    }

    /// Loads and validates.
    ///
    /// # Errors
    /// [`ConfigError`] with every problem found, each with its source and key.
    pub fn load(sources: &Sources) -> Result<Self, ConfigError> {
        let variables = read::environment(&sources.environment);
        let mut problems = Vec::new();
        let mut texts = Vec::new();
        for read in sources.files.iter().map(|path| read::file(path)) {
            read.map_or_else(|problem| problems.push(problem), |text| texts.push(text));
        }
        texts.extend(variables.sources);
        problems.extend(variables.problems);
        for read in sources.overrides.iter().map(|text| read::argument(text)) {
            read.map_or_else(|problem| problems.push(problem), |text| texts.push(text));
        }
        let mut origins = BTreeMap::new();
        let mut merger = Merger::builder().add_source(toml(&default_toml()));
        for text in &texts {
            let checked = check::check(text);
            problems.extend(checked.problems);
            origins.extend(checked.given);
            merger = merger.add_source(toml(&text.text));
        }
        if !problems.is_empty() {
            return Err(ConfigError { problems });
        }
        let mut merged = tree(merger)?;
        in_force::fill(&mut merged)?;
        let in_force = in_force::collect(&merged, &origins);
        let keys: sections::AllKeys = serde_json::from_value(merged).map_err(unexpected)?;
        let origin = |key: &str| origins.get(key).cloned().unwrap_or(Origin::Default);
        let settings = keys.validate(&mut |key, what| problems.push(Problem::new(origin(key), key, what)));
        if !problems.is_empty() {
            return Err(ConfigError { problems });
        }
        Ok(Self { settings, in_force, warnings: variables.warnings })
    }

    /// Other endpoints, from elsewhere.
    pub fn set_endpoints(&mut self, endpoints: &[Endpoint], origin: Origin) {
        self.settings.endpoints = endpoints.to_vec();
        if let Some(entry) = self.in_force.iter_mut().find(|e| e.path() == "link.endpoints") {
            entry.value = endpoints.iter().map(ToString::to_string).collect();
            entry.origin = origin;
        }
    }
}

fn toml(text: &str) -> File<config::FileSourceString, FileFormat> {
    File::from_str(text, FileFormat::Toml)
}

fn tree(merger: config::ConfigBuilder<config::builder::DefaultState>) -> Result<Value, ConfigError> {
    merger.build().and_then(|merged| merged.try_deserialize::<Value>()).map_err(unexpected)
}

/// What the checks of the sources should have found.
fn unexpected(e: impl std::fmt::Display) -> ConfigError {
    ConfigError { problems: vec![Problem::new(Origin::Default, "", e.to_string())] }
}

#[cfg(test)]
mod tests;
