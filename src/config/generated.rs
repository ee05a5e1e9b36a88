//! What is written from the declarations of the keys: `config/default.toml`, and the reference in the documentation.

use std::fmt::Write;

use super::key::{Key, Preset, Section, Type};
use super::sections::SECTIONS;

const HEADER: &str = "\
# Holdover's settings. Every key stands here with its default, its unit and its range. Written by: holdover check --defaults
# A configuration file holds only the keys that differ:   holdover run --config my.toml
# The environment overrides files:                        HOLDOVER_OUTBOUND__RATE_HZ=50
# The command line overrides everything:                  --set outbound.rate_hz=50
";

/// Every key with its default, fully commented: the text of `config/default.toml`.
pub fn default_toml() -> String {
    let mut out = HEADER.to_owned();
    for section in SECTIONS {
        let _ = writeln!(out);
        if !section.path.is_empty() {
            let _ = writeln!(out, "[{}]", section.path);
        }
        let (lists, plain): (Vec<_>, Vec<_>) =
            section.keys.iter().partition(|k| matches!(k.kind, Type::Tables(_)));
        for key in plain {
            setting(&mut out, key);
        }
        for key in lists {
            list(&mut out, section, key);
        }
    }
    out
}

fn setting(out: &mut String, key: &Key) {
    let _ = writeln!(out, "# {}", comment(key));
    if let Some(default) = key.default_toml() {
        let _ = writeln!(out, "{} = {default}", key.name());
    }
}

/// Tables that are there by default are written out; of others it is told what they hold.
fn list(out: &mut String, section: &Section, key: &Key) {
    let Type::Tables(rows) = key.kind else { return };
    let path = key.path(section.path);
    let _ = writeln!(out, "# {}", key.doc());
    if key.default_toml() == Some("[]") {
        let _ = writeln!(out, "# [[{path}]]");
        for row in rows {
            let _ = writeln!(out, "#     {}: {}", row.name(), comment(row));
        }
        return;
    }
    let _ = writeln!(out, "[[{path}]]");
    for row in rows {
        setting(out, row);
    }
}

/// One line: the doc, the unit, and what is allowed.
fn comment(key: &Key) -> String {
    let doc = key.doc();
    let (stem, end) = match doc.strip_suffix(" …") {
        Some(stem) => (stem, " …"),
        None => (doc.trim_end_matches('.'), "."),
    };
    let unit = if key.unit().is_empty() { String::new() } else { format!(", {}", key.unit()) };
    let allowed = allowed(key, " | ");
    let allowed = if allowed.is_empty() { allowed } else { format!(" {allowed}") };
    format!("{stem}{unit}{end}{allowed}")
}

/// The range, or the words.
fn allowed(key: &Key, between: &str) -> String {
    match (key.range, key.kind) {
        (Some((low, high)), _) => format!("[{low}, {high}]"),
        (None, Type::Flag) => ["true", "false"].join(between),
        (None, _) => key.choices.join(between),
    }
}

/// All keys as Markdown, a table each section: key, unit, what is allowed, default and meaning.
pub fn reference_markdown() -> String {
    let mut out = String::new();
    for (title, for_users) in [("Settings that a user meets", true), ("Tuning", false)] {
        let _ = writeln!(out, "## {title}\n");
        for section in SECTIONS.iter().filter(|s| s.for_users() == for_users) {
            let (lists, plain): (Vec<_>, Vec<_>) =
                section.keys.iter().partition(|k| matches!(k.kind, Type::Tables(_)));
            if !plain.is_empty() {
                let _ = writeln!(out, "### `[{}]`\n\n{}\n", section.path, section.doc());
                table(&mut out, &plain);
            }
            for key in lists {
                let Type::Tables(rows) = key.kind else { continue };
                let _ = writeln!(out, "### `[[{}]]`\n\n{}\n", key.path(section.path), key.doc());
                table(&mut out, &rows.iter().collect::<Vec<_>>());
            }
        }
    }
    out
}

fn table(out: &mut String, keys: &[&Key]) {
    let _ = writeln!(out, "| key | unit | allowed | default | meaning |\n|---|---|---|---|---|");
    for key in keys {
        let default = match key.preset {
            Preset::Toml(text) => format!("`{text}`"),
            Preset::Required => "has to be given".to_owned(),
            Preset::Absent => "none".to_owned(),
        };
        let cells = [key.unit().to_owned(), allowed(key, ", "), default, key.doc().to_owned()];
        let cells: Vec<_> = cells.iter().map(|c| c.replace('|', "\\|")).collect();
        let _ = writeln!(out, "| `{}` | {} |", key.name(), cells.join(" | "));
    }
    let _ = writeln!(out);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_of_defaults_is_what_the_declarations_say() {
        let written = include_str!("../../config/default.toml");
        assert!(
            written == default_toml(),
            "write it anew: cargo run -- check --defaults > config/default.toml"
        );
    }

    #[test]
    fn the_book_holds_the_reference() {
        let page = include_str!("../../docs/src/configuration.md");
        assert!(
            page.contains(reference_markdown().trim_end()),
            "put it between the marks: cargo run -- check --reference"
        );
    }

    #[test]
    fn the_reference_holds_every_key() {
        let text = reference_markdown();
        for section in SECTIONS {
            for key in section.keys {
                let row = match key.kind {
                    Type::Tables(_) => format!("### `[[{}]]`", key.path(section.path)),
                    _ => format!("| `{}` | {} | ", key.name(), key.unit()),
                };
                assert!(text.contains(&row), "{row}");
            }
        }
        assert!(text.contains("| `loss_s` | s | [0.2, 60] | `1.0` | No good fix for this long is a loss. |"));
        assert!(text.contains("| `publish` |  | auto, holdover, always, never | `\"auto\"` |"));
    }

    #[test]
    fn every_number_says_its_range_and_every_word_its_choices() {
        let all = || SECTIONS.iter().flat_map(|s| s.keys);
        let rows = all().flat_map(|k| if let Type::Tables(rows) = k.kind { rows } else { &[] });
        for key in all().chain(rows) {
            match key.kind {
                Type::Whole | Type::Number => assert!(key.range.is_some(), "{}", key.name()),
                // Free text has none, and says what it is.
                Type::Text => assert!(key.choices.len() != 1, "{}", key.name()),
                Type::Flag | Type::Texts | Type::Tables(_) => {}
            }
            // A number without a unit says so: `unit ""`.
            let number = key.kind == Type::Whole || key.kind == Type::Number;
            assert!(!number || key.own_unit.is_some() || !key.unit().is_empty(), "{}", key.name());
            assert!(key.doc().ends_with(['.', '…']), "{}: {}", key.name(), key.doc());
        }
        let users = SECTIONS.iter().filter(|s| s.for_users()).map(|s| s.keys.len()).sum::<usize>();
        assert!((40..=67).contains(&users), "{users} keys that a user meets");
    }
}
