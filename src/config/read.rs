//! The sources as texts of TOML: files, which are bounded, environment variables, and `key=value` of the command line.

use std::fs::{self, File};
use std::io::Read;
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

use config::{Environment, Source as _};
use toml::de::DeTable;

use super::check::SourceText;
use super::error::{Origin, Problem, shortened};
use super::key::Type;
use super::nearest;
use super::{LOG_VARIABLE, PREFIX};

/// No configuration is larger, bytes. A pipe may never end.
const LARGEST_FILE: u64 = 1 << 20;

/// A file.
pub(super) fn file(path: &Path) -> Result<SourceText, Problem> {
    let origin = Origin::File { path: path.display().to_string(), line: None };
    let wrong = |what: String| Problem::new(origin.clone(), "", what);
    let mut bytes = Vec::new();
    let is = fs::metadata(path).map_err(|e| wrong(e.to_string()))?.file_type();
    if is.is_dir() {
        return Err(wrong("is a directory: a file is to be given".to_owned()));
    }
    // A pipe is as good as a file: it may be another program's output.
    if !is.is_file() && !is.is_fifo() {
        return Err(wrong("is a device: that is no configuration".to_owned()));
    }
    let read = File::open(path).and_then(|f| f.take(LARGEST_FILE + 1).read_to_end(&mut bytes));
    read.map_err(|e| wrong(e.to_string()))?;
    if bytes.len() as u64 > LARGEST_FILE {
        return Err(wrong("is larger than 1 MiB: that is no configuration".to_owned()));
    }
    match String::from_utf8(bytes) {
        Ok(text) => Ok(SourceText { origin, text }),
        Err(e) => {
            let good = &e.as_bytes()[..e.utf8_error().valid_up_to()];
            let line = 1 + good.iter().filter(|b| **b == b'\n').count();
            Err(wrong(format!("line {line} is not UTF-8")))
        }
    }
}

/// What the environment holds.
#[derive(Default)]
pub(super) struct Variables {
    pub sources: Vec<SourceText>,
    pub problems: Vec<Problem>,
    /// Variables that look like ours and set nothing.
    pub warnings: Vec<String>,
}

/// `HOLDOVER_OUTBOUND__RATE_HZ` is `outbound.rate_hz`. A variable without a double underscore that names no key may be somebody else's.
pub(super) fn environment(variables: &[(String, String)]) -> Variables {
    let mut out = Variables::default();
    for (name, value) in variables {
        let Some(path) = variable_path(name) else { continue };
        let known = nearest::keys().any(|(p, _)| p == path);
        let origin = Origin::Environment(name.clone());
        if !known && !name.contains("__") {
            out.warnings.push(format!(
                "the environment's {} is no setting: those are {PREFIX}_SECTION__KEY",
                shortened(name)
            ));
        } else {
            match key_value(&path, value) {
                Some(text) => out.sources.push(SourceText { origin, text }),
                None => out.problems.push(Problem::new(origin, &shortened(&path), "is no key")),
            }
        }
    }
    out
}

/// The path that a variable names, if it is one of ours.
fn variable_path(name: &str) -> Option<String> {
    if name == LOG_VARIABLE {
        return None;
    }
    let one = [(name.to_owned(), String::new())].into_iter().collect();
    let reader = Environment::with_prefix(PREFIX).prefix_separator("_").separator("__").source(Some(one));
    reader.collect().ok()?.into_keys().next()
}

/// `key=value`.
pub(super) fn argument(text: &str) -> Result<SourceText, Problem> {
    let origin = Origin::Argument(format!("--set {text}"));
    let toml = text.split_once('=').and_then(|(key, value)| key_value(key.trim(), value.trim()));
    match toml {
        Some(text) => Ok(SourceText { origin, text }),
        None => Err(Problem::new(origin, "", "expected key=value")),
    }
}

/// A key and its value as TOML. A value that is no TOML is taken as text, or, where the key has a list of texts, as texts between commas.
fn key_value(key: &str, value: &str) -> Option<String> {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '.';
    if key.is_empty() || !key.chars().all(plain) {
        return None;
    }
    let reads = |text: &String| DeTable::parse(text).is_ok();
    let as_is = format!("{key} = {value}");
    if !value.contains('\n') && reads(&as_is) {
        return Some(as_is);
    }
    let list = nearest::keys().any(|(path, k)| path == key && k.kind == Type::Texts);
    let text = if list {
        let texts: Vec<_> = value.split(',').map(|t| quoted(t.trim())).collect();
        format!("{key} = [{}]", texts.join(", "))
    } else {
        format!("{key} = {}", quoted(value))
    };
    Some(text).filter(reads)
}

/// A text as a basic string of TOML.
fn quoted(text: &str) -> String {
    let inner: String = text
        .chars()
        .map(|c| match c {
            '"' | '\\' => format!("\\{c}"),
            c if c.is_control() => format!("\\U{:08X}", u32::from(c)),
            c => c.to_string(),
        })
        .collect();
    format!("\"{inner}\"")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_become_toml_whatever_they_hold() {
        for (value, toml) in [
            ("5", "a.b = 5"),
            ("[1, 2]", "a.b = [1, 2]"),
            ("never", "a.b = \"never\""),
            ("say \"no\" \\ \u{7f}\n", "a.b = \"say \\\"no\\\" \\\\ \\U0000007F\\U0000000A\""),
        ] {
            assert_eq!(key_value("a.b", value).as_deref(), Some(toml));
        }
        assert_eq!(key_value("link.endpoints", "x:1, y:2").unwrap(), "link.endpoints = [\"x:1\", \"y:2\"]");
        for key in ["", ".", "a..b", "a b", "ä"] {
            assert_eq!(key_value(key, "1"), None, "{key}");
        }
    }

    #[test]
    fn variables_name_paths() {
        assert_eq!(variable_path("HOLDOVER_OUTBOUND__RATE_HZ").as_deref(), Some("outbound.rate_hz"));
        assert_eq!(variable_path("HOLDOVER_CAMERAS").as_deref(), Some("cameras"));
        for other in ["HOME", "HOLDOVERX__Y", LOG_VARIABLE] {
            assert_eq!(variable_path(other), None, "{other}");
        }
    }

    #[test]
    fn a_file_is_read_only_so_far() {
        for endless in ["/dev/zero", "/dev/urandom"] {
            let problem = file(Path::new(endless)).err().unwrap().to_string();
            assert!(problem.contains(endless) && problem.contains("is a device"), "{problem}");
        }
        let folder = tempfile::tempdir().unwrap();
        let problem = file(folder.path()).err().unwrap().to_string();
        assert!(problem.contains("is a directory"), "{problem}");
        let large = folder.path().join("large.toml");
        std::fs::write(&large, vec![b'#'; LARGEST_FILE as usize + 1]).unwrap();
        let problem = file(&large).err().unwrap().to_string();
        assert!(problem.contains("1 MiB") && problem.contains("large.toml"), "{problem}");
        let path = folder.path().join("latin.toml");
        std::fs::write(&path, b"# fine\n# caf\xe9\n").unwrap();
        assert!(file(&path).err().unwrap().to_string().contains("line 2 is not UTF-8"));
    }
}
