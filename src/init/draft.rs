//! A configuration that holds only what differs from the defaults, each key with the reason why.
//!
//! What is written is what was checked: a draft is read as the daemon reads `--set`, and its text has the values that came of that.

use std::fmt::Write;

use crate::config::{ConfigError, InForce, Loaded, Sources};

/// Comments are broken into lines of this width.
const WIDTH: usize = 110;

/// A key that was found to be set.
#[derive(Clone, PartialEq, Eq, Debug)]
struct DraftKey {
    path: String,
    /// `key=value`, as for `--set`.
    assignment: String,
    why: String,
}

/// Something that may have to be set, and that a person has to know more of: it is written as a comment.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct DraftHint {
    /// Why, in sentences.
    pub why: String,
    /// Lines of TOML.
    pub toml: String,
}

/// See the module's documentation.
#[derive(Clone, Debug, Default)]
pub struct Draft {
    headline: Vec<String>,
    keys: Vec<DraftKey>,
    hints: Vec<DraftHint>,
}

impl Draft {
    /// Says at the file's top what it is of.
    pub fn headline(&mut self, text: impl Into<String>) {
        self.headline.push(text.into());
    }

    /// A key is to be this, which is TOML, instead of what it was to be before.
    pub fn set(&mut self, path: &str, toml: &str, why: impl Into<String>) {
        self.assign(path.to_owned(), format!("{path}={toml}"), why.into());
    }

    /// The same as `--set` has it.
    pub fn set_as_told(&mut self, assignment: &str) {
        let path = assignment.split('=').next().unwrap_or_default().trim().to_owned();
        self.assign(path, assignment.to_owned(), "As it was told on the command line.".to_owned());
    }

    fn assign(&mut self, path: String, assignment: String, why: String) {
        self.keys.retain(|k| k.path != path);
        self.keys.push(DraftKey { path, assignment, why });
    }

    /// Whether a key is set already.
    pub fn sets(&self, path: &str) -> bool {
        self.keys.iter().any(|k| k.path == path)
    }

    /// Something that may have to be set.
    pub fn hint(&mut self, hint: DraftHint) {
        self.hints.push(hint);
    }

    /// The settings that it makes.
    ///
    /// # Errors
    /// [`ConfigError`], for what was told on the command line.
    pub fn loaded(&self) -> Result<Loaded, ConfigError> {
        let overrides = self.keys.iter().map(|k| k.assignment.clone()).collect();
        Loaded::load(&Sources { overrides, ..Sources::default() })
    }

    /// What of the settings differs from the defaults, and why.
    ///
    /// # Errors
    /// As [`Draft::loaded`].
    pub fn differing(&self) -> Result<Vec<(InForce, String)>, ConfigError> {
        let (ours, defaults) = (self.loaded()?, Loaded::load(&Sources::default())?);
        let differs = ours.in_force.into_iter().zip(defaults.in_force).filter(|(a, b)| a.value != b.value);
        let why = |entry: &InForce| {
            let path = entry.path();
            self.keys.iter().find(|k| k.path == path).map_or_else(String::new, |k| k.why.clone())
        };
        Ok(differs.map(|(entry, _)| (why(&entry), entry)).map(|(why, entry)| (entry, why)).collect())
    }

    /// The file.
    ///
    /// # Errors
    /// As [`Draft::loaded`].
    pub fn text(&self) -> Result<String, ConfigError> {
        let mut out = String::new();
        for line in &self.headline {
            comment(&mut out, line);
        }
        comment(
            &mut out,
            "Only what differs from the defaults stands here. Every key with its unit and range: holdover check --defaults",
        );
        let mut differing = self.differing()?;
        for key in &self.keys {
            if !differing.iter().any(|(entry, _)| entry.path() == key.path) {
                comment(&mut out, &format!("{} is as by default. {}", key.path, key.why));
            }
        }
        // What stands outside all sections comes first, as in TOML.
        differing.sort_by_key(|(entry, _)| !entry.section.path.is_empty());
        let mut section = "";
        for (entry, why) in &differing {
            out.push('\n');
            if section != entry.section.path {
                section = entry.section.path;
                let _ = writeln!(out, "[{section}]");
            }
            comment(&mut out, why);
            let _ = writeln!(out, "{} = {}", entry.key.name(), entry.value_toml());
        }
        for hint in &self.hints {
            out.push('\n');
            comment(&mut out, &hint.why);
            for line in hint.toml.lines() {
                let _ = writeln!(out, "#   {line}");
            }
        }
        Ok(out)
    }
}

/// Words in lines of a comment. No line of the text gets out of it.
fn comment(out: &mut String, text: &str) {
    let mut line = String::new();
    for word in text.split_whitespace() {
        if !line.is_empty() && line.chars().count() + word.chars().count() >= WIDTH {
            let _ = writeln!(out, "#{line}");
            line.clear();
        }
        line.push(' ');
        line.push_str(word);
    }
    if !line.is_empty() {
        let _ = writeln!(out, "#{line}");
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::Value;

    use super::*;

    /// Every value that a file makes.
    fn values_of(text: &str) -> Vec<Value> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.toml");
        std::fs::write(&path, text).unwrap();
        let loaded = Loaded::load(&Sources { files: vec![path], ..Sources::default() });
        let loaded = loaded.unwrap_or_else(|e| panic!("{e}\n{text}"));
        loaded.in_force.into_iter().map(|entry| entry.value).collect()
    }

    fn values(draft: &Draft) -> Vec<Value> {
        draft.loaded().unwrap().in_force.into_iter().map(|entry| entry.value).collect()
    }

    #[test]
    fn only_what_differs_is_written_with_its_reason() {
        let mut draft = Draft::default();
        draft.headline("Of a vehicle.");
        draft.set("link.endpoints", "[\"udpin:127.0.0.1:14550\"]", "Heard there.");
        draft.set("vehicle.system_id", "4", "Two vehicles are heard.");
        draft.set("holdover.max_sigma_m", "30", "First.");
        draft.set("holdover.max_sigma_m", "40", "It flies low.");
        draft.set_as_told("outbound.publish=never");
        draft.hint(DraftHint { why: "Perhaps.".into(), toml: "[signing]\nkey_file = \"k\"".into() });
        let text = draft.text().unwrap();
        let expected = "\
# Of a vehicle.
# Only what differs from the defaults stands here. Every key with its unit and range: holdover check --defaults
# link.endpoints is as by default. Heard there.

[vehicle]
# Two vehicles are heard.
system_id = 4

[outbound]
# As it was told on the command line.
publish = \"never\"

[holdover]
# It flies low.
max_sigma_m = 40

# Perhaps.
#   [signing]
#   key_file = \"k\"
";
        assert_eq!(text, expected);
        assert_eq!(values_of(&text), values(&draft));
    }

    #[test]
    fn what_is_no_setting_is_refused() {
        for wrong in ["vehicle.system_id=400", "vehicle.sytem_id=4", "", "link.endpoints=nowhere"] {
            let mut draft = Draft::default();
            draft.set_as_told(wrong);
            assert!(draft.text().is_err(), "{wrong}");
        }
    }

    proptest! {
        #[test]
        fn what_is_written_makes_the_same_settings(
            device in "[!-~äß❤]{1,40}",
            baud in 1u32..3_000_000,
            system in prop::option::of(0u8..),
            sigma in prop::option::of(1.0f64..1e5),
            publish in prop::option::of(prop::sample::select(vec!["auto", "never", "always"])),
            hosts in prop::collection::vec("[a-z]{1,9}", 0..3),
            yaw in prop::option::of(-180.0f64..180.0),
            words in "\\PC{0,300}",
            lines in "[\n\r\t #=\\[\\]a-z\"]{0,60}",
        ) {
            let mut draft = Draft::default();
            draft.headline(lines.clone());
            let endpoint = Value::from(format!("serial:{device}:{baud}"));
            draft.set("link.endpoints", &format!("[{endpoint}]"), words.clone());
            if let Some(system) = system {
                draft.set("vehicle.system_id", &system.to_string(), lines.clone());
            }
            if let Some(sigma) = sigma {
                draft.set("holdover.max_sigma_m", &format!("{sigma:?}"), words.clone());
            }
            if let Some(publish) = publish {
                draft.set_as_told(&format!("outbound.publish={publish}"));
            }
            if !hosts.is_empty() {
                draft.set_as_told(&format!("status.hosts={}", hosts.join(",")));
            }
            if let Some(yaw) = yaw {
                draft.set("cameras", &format!("[{{component = 100, yaw_deg = {yaw:?}}}]"), lines.clone());
                draft.set("flow.camera", "100", words);
            }
            draft.hint(DraftHint { why: lines, toml: "[flow]\nuse = false".into() });
            let text = draft.text().unwrap();
            prop_assert_eq!(values_of(&text), values(&draft), "{}", text);
        }
    }
}
