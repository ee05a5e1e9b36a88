//! Types and ranges: every source against the defaults, which are the schema. Ranges and choices are read from the comment that
//! stands over each key in `config/default.toml`, so what is documented is what is enforced.

use std::collections::BTreeMap;

use serde_json::{Map, Value};

use super::DEFAULT_TOML;
use super::error::Problem;

/// What a key may hold.
#[derive(Clone, Debug, PartialEq)]
pub enum Limit {
    /// A number between two bounds, both included.
    Range(f64, f64),
    /// One of these words.
    Choice(Vec<String>),
    /// Anything of the right type.
    Free,
}

/// What the defaults say: keys, types and limits.
#[derive(Clone, Debug)]
pub struct Schema {
    tree: Value,
    limits: BTreeMap<String, Limit>,
}

impl Schema {
    /// The schema of [`DEFAULT_TOML`], given as a tree too.
    pub fn new(tree: Value) -> Self {
        Self { tree, limits: read_comments(DEFAULT_TOML) }
    }

    /// The limit of every key, by its path.
    pub fn limits(&self) -> &BTreeMap<String, Limit> {
        &self.limits
    }

    /// Everything in `tree` that the schema does not allow.
    pub fn check(&self, source: &str, tree: &Value) -> Vec<Problem> {
        let mut walk = Walk { source, limits: &self.limits, problems: Vec::new() };
        walk.value("", tree, &self.tree);
        walk.problems
    }
}

fn read_comments(text: &str) -> BTreeMap<String, Limit> {
    let mut out = BTreeMap::new();
    let (mut section, mut comment) = (String::new(), String::new());
    for line in text.lines().map(str::trim) {
        if let Some(name) = line.strip_prefix('[').and_then(|l| l.strip_suffix(']')) {
            section = name.to_owned();
        } else if let Some(words) = line.strip_prefix('#') {
            comment = words.trim().to_owned();
        } else if let Some((key, _)) = line.split_once('=') {
            out.insert(format!("{section}.{}", key.trim()), limit_in(&comment));
            comment.clear();
        }
    }
    out
}

/// "… [0, 5]" is a range, "…. a | b" a choice.
fn limit_in(comment: &str) -> Limit {
    if let Some((_, range)) = comment.strip_suffix(']').and_then(|c| c.rsplit_once('['))
        && let Some((low, high)) = range.split_once(',')
        && let (Ok(low), Ok(high)) = (low.trim().parse(), high.trim().parse())
    {
        return Limit::Range(low, high);
    }
    let last = comment.rsplit_once([':', '.']).map_or(comment, |(_, last)| last);
    let words: Vec<String> = last.split('|').map(|w| w.trim().to_owned()).collect();
    if words.len() > 1 { Limit::Choice(words) } else { Limit::Free }
}

struct Walk<'a> {
    source: &'a str,
    limits: &'a BTreeMap<String, Limit>,
    problems: Vec<Problem>,
}

impl Walk<'_> {
    fn complain(&mut self, path: &str, what: String) {
        self.problems.push(Problem { source: self.source.into(), key: path.into(), what });
    }

    fn value(&mut self, path: &str, value: &Value, schema: &Value) {
        match (schema, value) {
            (Value::Object(known), Value::Object(given)) => {
                for (key, inner) in given {
                    let inner_path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                    match known.get(key) {
                        Some(s) => self.value(&inner_path, inner, s),
                        None => self.complain(&inner_path, unknown(&inner_path, known, path)),
                    }
                }
            }
            (Value::Object(_), _) => self.complain(path, "this is a section, not a value".into()),
            (Value::Bool(_), Value::Bool(_)) => {}
            (Value::Bool(_), other) => self.complain(path, format!("expected true or false, not {other}")),
            (Value::Number(n), Value::Number(given)) if n.is_f64() || !given.is_f64() => {
                if let Some(what) = self.out_of_range(path, given.as_f64()) {
                    self.complain(path, what);
                }
            }
            (Value::Number(_), Value::Number(given)) => {
                self.complain(path, format!("expected a whole number, not {given}"));
            }
            // TOML's nan and inf have no JSON number: they arrive as null.
            (Value::Number(_), other) => self.complain(path, format!("expected a number, not {other}")),
            (Value::String(_), Value::String(given)) => {
                if let Some(Limit::Choice(words)) = self.limits.get(path)
                    && !words.contains(given)
                {
                    self.complain(path, format!("\"{given}\" is not one of {}", words.join(", ")));
                }
            }
            (Value::String(_), other) => self.complain(path, format!("expected text in quotes, not {other}")),
            (Value::Array(_), Value::Array(given)) => {
                if let Some(wrong) = given.iter().find(|v| !v.is_string()) {
                    self.complain(path, format!("expected a list of texts in quotes, not {wrong} in it"));
                }
            }
            (Value::Array(_), other) => {
                self.complain(path, format!("expected a list of texts in quotes, not {other}"));
            }
            (Value::Null, _) => {}
        }
    }

    fn out_of_range(&self, path: &str, value: Option<f64>) -> Option<String> {
        let Some(v) = value.filter(|v| v.is_finite()) else { return Some("expected a finite number".into()) };
        match self.limits.get(path) {
            Some(&Limit::Range(low, high)) if v < low || v > high => {
                Some(format!("{v} is out of range: {low} to {high}"))
            }
            _ => None,
        }
    }
}

fn unknown(path: &str, known: &Map<String, Value>, section: &str) -> String {
    let name = path.rsplit('.').next().unwrap_or(path);
    let near = known
        .keys()
        .map(|k| (distance(name, k), k))
        .filter(|(d, k)| *d <= 3 || k.contains(name) || name.contains(k.as_str()))
        .min();
    match near {
        Some((_, k)) if section.is_empty() => format!("unknown section; did you mean {k}?"),
        Some((_, k)) => format!("unknown key; did you mean {section}.{k}?"),
        None if section.is_empty() => "unknown section".into(),
        None => "unknown key".into(),
    }
}

/// Edit distance.
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let substituted = diagonal + usize::from(x != *y);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn schema() -> Schema {
        Schema::new(super::super::parse_toml("default", DEFAULT_TOML).unwrap())
    }

    /// What their elements may hold is read where they are.
    const LISTS: [&str; 4] = ["link.endpoints", "flow.patches_deg", "landmarks.points", "landmarks.cameras"];

    #[test]
    fn every_key_of_the_defaults_says_what_it_may_hold() {
        let schema = schema();
        let limits = schema.limits();
        for (key, limit) in limits {
            assert!(
                *limit != Limit::Free || LISTS.contains(&key.as_str()),
                "{key} has neither a range nor choices"
            );
        }
        assert!(limits.len() > 60);
        assert_eq!(limits["gnss.loss_s"], Limit::Range(0.2, 60.0));
        let words = ["holdover", "always", "never"].map(str::to_owned).to_vec();
        assert_eq!(limits["outbound.publish"], Limit::Choice(words));
    }

    #[test]
    fn the_defaults_keep_their_own_limits() {
        let schema = schema();
        assert_eq!(schema.check("default", &schema.tree), Vec::new());
    }
}
