//! What is in force, key by key, and where each value came from.

use std::collections::BTreeMap;

use config::Config as Merger;
use serde_json::{Map, Value};

use super::error::{ConfigError, Origin};
use super::key::{Key, Section, Type};
use super::sections::SECTIONS;
use super::{toml, tree};

/// A key, its value, and where that came from.
#[derive(Clone, Debug)]
pub struct InForce {
    /// The section that it stands in.
    pub section: &'static Section,
    /// The key.
    pub key: &'static Key,
    /// Its value; the tables of a list are complete.
    pub value: Value,
    /// Where it came from.
    pub origin: Origin,
}

impl InForce {
    /// The path of the key.
    pub fn path(&self) -> String {
        self.key.path(self.section.path)
    }

    /// The value as TOML; what the tables of a list have by default is left out.
    pub fn value_toml(&self) -> String {
        match (self.key.kind, &self.value) {
            (Type::Tables(rows), Value::Array(list)) => {
                let list: Vec<_> = list.iter().map(|row| row_toml(rows, row)).collect();
                format!("[{}]", list.join(", "))
            }
            (_, Value::Array(list)) => {
                let list: Vec<_> = list.iter().map(Value::to_string).collect();
                format!("[{}]", list.join(", "))
            }
            (_, plain) => plain.to_string(),
        }
    }
}

/// A table of a list in one line. What names it, its first key, is always there.
fn row_toml(keys: &[Key], row: &Value) -> String {
    let mut cells = Vec::new();
    for (i, key) in keys.iter().enumerate() {
        let Some(value) = row.get(key.name()) else { continue };
        let preset = key.default_toml().and_then(|text| text.parse::<f64>().ok());
        if i == 0 || preset.is_none() || value.as_f64() != preset {
            cells.push(format!("{} = {value}", key.name()));
        }
    }
    format!("{{{}}}", cells.join(", "))
}

/// Lists of tables that are not given, and what their tables leave out.
pub(super) fn fill(merged: &mut Value) -> Result<(), ConfigError> {
    for section in SECTIONS {
        for key in section.keys {
            let Type::Tables(rows) = key.kind else { continue };
            let Some(parent) = pointer(merged, section.path) else { continue };
            let list = parent.entry(key.name()).or_insert_with(|| Value::Array(Vec::new()));
            let preset = presets(rows)?;
            for row in list.as_array_mut().into_iter().flatten().filter_map(Value::as_object_mut) {
                for (name, value) in &preset {
                    row.entry(name.clone()).or_insert_with(|| value.clone());
                }
            }
        }
    }
    Ok(())
}

/// What a table of a list holds that says nothing.
fn presets(rows: &[Key]) -> Result<Map<String, Value>, ConfigError> {
    let lines = rows.iter().filter_map(|k| k.default_toml().map(|text| format!("{} = {text}\n", k.name())));
    match tree(Merger::builder().add_source(toml(&lines.collect::<String>())))? {
        Value::Object(map) => Ok(map),
        _ => Ok(Map::new()),
    }
}

fn pointer<'a>(tree: &'a mut Value, path: &str) -> Option<&'a mut Map<String, Value>> {
    let mut at = tree;
    for name in path.split('.').filter(|n| !n.is_empty()) {
        at = at.get_mut(name)?;
    }
    at.as_object_mut()
}

/// All keys.
pub(super) fn collect(merged: &Value, origins: &BTreeMap<String, Origin>) -> Vec<InForce> {
    let mut out = Vec::new();
    for section in SECTIONS {
        for key in section.keys {
            let path = key.path(section.path);
            let value = merged.pointer(&format!("/{}", path.replace('.', "/"))).cloned().unwrap_or_default();
            let origin = origins.get(&path).cloned().unwrap_or(Origin::Default);
            out.push(InForce { section, key, value, origin });
        }
    }
    out
}
