//! Whether a source holds only what the keys allow: known names, right types, values within range. Every complaint names the line.

use toml::Spanned;
use toml::de::{DeInteger, DeTable, DeValue};

use super::error::{Origin, Problem, shortened};
use super::key::{Key, Preset, Type};
use super::nearest::{most_alike, nearest, renamed, was_section};
use super::sections::SECTIONS;

/// A text of TOML, and where it is from.
pub(super) struct SourceText {
    /// For a file the line is filled in.
    pub origin: Origin,
    pub text: String,
}

/// What was found in a source.
pub(super) struct Checked {
    pub problems: Vec<Problem>,
    /// The keys that it gives.
    pub given: Vec<(String, Origin)>,
}

/// No more problems than this are told of one source.
const MANY: usize = 30;

/// Checks a source.
pub(super) fn check(source: &SourceText) -> Checked {
    let mut walk = Walk { source, problems: Vec::new(), more: 0, given: Vec::new() };
    let (table, errors) = DeTable::parse_recoverable(&source.text);
    if errors.is_empty() {
        walk.table("", table.get_ref());
    }
    for e in &errors {
        walk.complain("", e.span().map_or(0, |s| s.start), e.message());
    }
    let (mut problems, more) = (walk.problems, walk.more);
    problems.sort_by_key(|(at, _)| *at);
    let mut problems: Vec<_> = problems.into_iter().map(|(_, problem)| problem).collect();
    if more > 0 {
        problems.push(Problem::new(source.origin.clone(), "", format!("{more} more problems")));
    }
    Checked { problems, given: walk.given }
}

struct Walk<'a> {
    source: &'a SourceText,
    /// With their places in the text.
    problems: Vec<(usize, Problem)>,
    more: usize,
    given: Vec<(String, Origin)>,
}

impl SourceText {
    /// The origin of what stands at a byte of the text.
    fn at(&self, byte: usize) -> Origin {
        let before = self.text.as_bytes().iter().take(byte);
        let line = 1 + before.filter(|b| **b == b'\n').count();
        match &self.origin {
            Origin::File { path, .. } => Origin::File { path: path.clone(), line: Some(line) },
            other => other.clone(),
        }
    }
}

impl Walk<'_> {
    fn complain(&mut self, path: &str, at: usize, what: impl Into<String>) {
        self.complain_of(path, at, || what.into());
    }

    /// The same where it takes a search to tell what is wrong.
    fn complain_of(&mut self, path: &str, at: usize, what: impl FnOnce() -> String) {
        if self.problems.len() < MANY {
            self.problems.push((at, Problem::new(self.source.at(at), &shortened(path), what())));
        } else {
            self.more += 1;
        }
    }

    /// The keys of a table that may hold sections.
    fn table(&mut self, path: &str, table: &DeTable<'_>) {
        for (name, value) in table {
            let inner = if path.is_empty() {
                name.get_ref().to_string()
            } else {
                format!("{path}.{}", name.get_ref())
            };
            let at = name.span().start;
            let key = SECTIONS
                .iter()
                .filter(|s| s.path == path)
                .find_map(|s| s.keys.iter().find(|k| k.name() == name.get_ref()));
            match (key, value.get_ref()) {
                (Some(key), _) => {
                    self.given.push((inner.clone(), self.source.at(at)));
                    self.value(&inner, key, value);
                }
                // A dot within quotes separates nothing.
                (None, _) if name.get_ref().contains('.') => {
                    self.complain(&inner, at, "is to stand without quotes");
                }
                (None, DeValue::Table(t)) if is_section(&inner) => self.table(&inner, t),
                (None, _) if is_section(&inner) => {
                    self.complain(&inner, at, "is a section, not a value");
                }
                (None, DeValue::Table(t)) if was_section(&inner) && !t.is_empty() => self.table(&inner, t),
                (None, _) => self.complain_of(&inner, at, || unknown(&inner)),
            }
        }
    }

    fn value(&mut self, path: &str, key: &Key, value: &Spanned<DeValue<'_>>) {
        let at = value.span().start;
        match (key.kind, value.get_ref()) {
            (Type::Flag, DeValue::Boolean(_)) => {}
            (Type::Text, DeValue::String(text))
                if key.choices.is_empty() || key.choices.contains(&&**text) => {}
            (Type::Whole | Type::Number, DeValue::Integer(n)) => self.number(path, key, value, integer(n)),
            (Type::Number, DeValue::Float(n)) => {
                // What TOML takes for a number is one; if not it is refused as if it were infinite.
                self.number(path, key, value, n.as_str().parse().unwrap_or(f64::INFINITY));
            }
            (Type::Texts, DeValue::Array(list)) => {
                for wrong in list.iter().filter(|v| !v.get_ref().is_str()) {
                    let what = format!("is to be {}, not one with {}", key.allowed(), shown(wrong.get_ref()));
                    self.complain(path, wrong.span().start, what);
                }
            }
            (Type::Tables(rows), DeValue::Array(list)) => {
                for (i, row) in list.iter().enumerate() {
                    self.row(path, i, rows, row);
                }
            }
            (_, other) => {
                self.complain(path, at, format!("is to be {}, not {}", key.allowed(), shown(other)));
            }
        }
    }

    fn number(&mut self, path: &str, key: &Key, value: &Spanned<DeValue<'_>>, number: f64) {
        let (at, given) = (value.span().start, shown(value.get_ref()));
        match key.range {
            _ if !number.is_finite() => {
                let what = format!("is {given}, no finite number: it is to be {}", key.allowed());
                self.complain(path, at, what);
            }
            Some((low, high)) if number < low || number > high => {
                self.complain(path, at, format!("is {given}, out of range: {low} to {high}"));
            }
            _ => {}
        }
    }

    /// A table of a list.
    fn row(&mut self, list: &str, i: usize, keys: &'static [Key], row: &Spanned<DeValue<'_>>) {
        let at = row.span().start;
        let DeValue::Table(table) = row.get_ref() else {
            let names: Vec<_> = keys.iter().map(Key::name).collect();
            let given = shown(row.get_ref());
            let what = format!("is to be tables, [[{list}]], with {}, not {given}", names.join(", "));
            return self.complain(list, at, what);
        };
        for (name, value) in table {
            let path = format!("{list}[{i}].{}", name.get_ref());
            match keys.iter().find(|k| k.name() == name.get_ref()) {
                Some(key) => self.value(&path, key, value),
                None => self.complain_of(&path, name.span().start, || {
                    let near = most_alike(name.get_ref(), keys.iter().map(|k| k.name().to_owned()));
                    did_you_mean("is no key", near)
                }),
            }
        }
        for key in keys.iter().filter(|k| k.preset == Preset::Required && !table.contains_key(k.name())) {
            self.complain(&format!("{list}[{i}]"), at, format!("has no {}", key.name()));
        }
    }
}

/// Whether it is a section, or holds some.
fn is_section(path: &str) -> bool {
    SECTIONS.iter().any(|s| s.path.strip_prefix(path).is_some_and(|r| r.is_empty() || r.starts_with('.')))
}

fn unknown(path: &str) -> String {
    if let Some(now) = renamed(path) {
        return format!("is now {now}");
    }
    did_you_mean(if path.contains('.') { "is no key" } else { "is no section" }, nearest(path))
}

fn did_you_mean(what: &str, near: Option<String>) -> String {
    near.map_or_else(|| what.to_owned(), |near| format!("{what}; did you mean {near}?"))
}

/// As near as a double comes to it; digits that are no number at all are refused as infinite.
fn integer(n: &DeInteger<'_>) -> f64 {
    match i128::from_str_radix(n.as_str(), n.radix()) {
        Ok(v) => v as f64,
        Err(_) => f64::INFINITY,
    }
}

/// A value as a message shows it.
fn shown(value: &DeValue<'_>) -> String {
    match value {
        DeValue::String(text) => format!("\"{}\"", shortened(text)),
        DeValue::Integer(n) => shortened(&n.to_string()),
        DeValue::Float(n) => shortened(n.as_str()),
        DeValue::Boolean(b) => b.to_string(),
        DeValue::Datetime(d) => d.to_string(),
        DeValue::Array(_) => "a list".to_owned(),
        DeValue::Table(_) => "a table".to_owned(),
    }
}
