//! `holdover check`: is the configuration right, what is in force, and where did it come from?

use clap::Args;
use serde_json::{Value, json};

use crate::config::{InForce, Loaded, Origin, default_toml, reference_markdown};

use super::{ConfigArgs, Failure, warn};

/// Arguments of `check`.
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// Show all keys, not only those that a user meets or that differ from the defaults
    #[arg(long)]
    pub all: bool,
    /// Print one JSON object with all keys, and nothing else
    #[arg(long, conflicts_with = "all")]
    pub json: bool,
    /// Print every key with its default, unit, range and meaning, as in config/default.toml, and check nothing
    #[arg(long, conflicts_with_all = ["all", "json", "reference", "config", "set"])]
    pub defaults: bool,
    /// Print the same as tables in Markdown
    #[arg(long, conflicts_with_all = ["all", "json", "config", "set"])]
    pub reference: bool,
    /// Settings
    #[command(flatten)]
    pub settings: ConfigArgs,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Config`].
pub fn run(args: &CheckArgs) -> Result<(), Failure> {
    if args.defaults {
        outln!("{}", default_toml().trim_end());
        return Ok(());
    }
    if args.reference {
        outln!("{}", reference_markdown().trim_end());
        return Ok(());
    }
    let loaded = args.settings.read()?;
    warn(&loaded);
    if args.json {
        endpoints(&loaded)?;
        outln!("{}", to_json(&loaded));
        return Ok(());
    }
    show(&loaded, args.all)
}

/// Prints what is in force: all of it, or what a user meets and what differs from the defaults.
///
/// # Errors
/// [`Failure::Usage`] when there is nothing to listen to.
pub(super) fn show(loaded: &Loaded, all: bool) -> Result<(), Failure> {
    endpoints(loaded)?;
    outln!("The configuration is valid.");
    summary(loaded);
    let mut shown: Vec<_> =
        loaded.in_force.iter().filter(|e| all || e.section.for_users() || is_set(e)).collect();
    // What stands outside all sections comes first, as in TOML.
    shown.sort_by_key(|e| !e.section.path.is_empty());
    let width = |text: &dyn Fn(&InForce) -> String| {
        shown.iter().map(|e| text(e).chars().count()).filter(|n| *n <= WIDEST).max().unwrap_or(0)
    };
    let (names, values) = (width(&|e| e.key.name().to_owned()), width(&InForce::value_toml));
    let mut section = None;
    for entry in shown {
        if section.replace(entry.section.path) != Some(entry.section.path) {
            outln!("");
            if !entry.section.path.is_empty() {
                outln!("[{}]", entry.section.path);
            }
        }
        let (name, value) = (entry.key.name(), entry.value_toml());
        outln!("{name:names$} = {value:values$}  # {}", entry.origin);
    }
    Ok(())
}

/// A longer value does not make its column wider.
const WIDEST: usize = 40;

fn endpoints(loaded: &Loaded) -> Result<(), Failure> {
    if loaded.settings.endpoints.is_empty() {
        return Err(Failure::Usage("link.endpoints is empty: there is nothing to listen to".into()));
    }
    Ok(())
}

fn is_set(entry: &InForce) -> bool {
    entry.origin != Origin::Default
}

/// The gist, in words.
fn summary(loaded: &Loaded) {
    let s = &loaded.settings;
    match s.system {
        Some(system) => outln!("  follows   system {}", system.0),
        None => outln!("  follows   the first autopilot that is heard"),
    }
    for e in &s.endpoints {
        outln!("  listens   {e}");
    }
    let o = &s.pipeline.outbound;
    let profile = s.pipeline.profile.map_or("the autopilot's own".to_owned(), |p| p.to_string());
    outln!("  sends     {:?} at {} Hz, publish = {:?}, profile: {profile}", o.carriage, o.rate_hz, o.publish);
    outln!("  estimator {}", s.pipeline.navigator.estimator.label());
    if let Some(l) = &s.pipeline.navigator.landmarks {
        let (points, cameras) = (l.points.len(), l.cameras.len());
        outln!(
            "  landmarks {points}, {:?}, seen by {cameras} camera{}",
            l.frame,
            if cameras == 1 { "" } else { "s" }
        );
    }
    let h = &s.pipeline.navigator.holdover;
    outln!("  lost at   {} m of uncertainty, or {} s without velocity", h.max_sigma_m, h.max_coast_s);
}

fn to_json(loaded: &Loaded) -> Value {
    let keys: Vec<_> = loaded.in_force.iter().map(entry_json).collect();
    json!({ "valid": true, "warnings": loaded.warnings, "keys": keys })
}

/// `{"key": "gnss.delay_ms", "value": 20, "unit": "ms", "source": "file", "file": "my.toml", "line": 3}`
fn entry_json(entry: &InForce) -> Value {
    let mut out = json!({ "key": entry.path(), "value": entry.value, "unit": entry.key.unit() });
    match &entry.origin {
        Origin::Default => out["source"] = json!("default"),
        Origin::File { path, line } => {
            out["source"] = json!("file");
            out["file"] = json!(path);
            out["line"] = json!(line);
        }
        Origin::Environment(name) => {
            out["source"] = json!("environment");
            out["variable"] = json!(name);
        }
        Origin::Argument(text) => {
            out["source"] = json!("argument");
            out["argument"] = json!(text);
        }
    }
    out
}
