//! What results were made with: results of another configuration or program are made again, and not mixed.

use sha2::{Digest, Sha256};

/// What is asked of every log.
#[derive(Clone, Debug, PartialEq)]
pub struct Recipe {
    /// Lengths of the outages, s, in the order in which they are shown.
    pub lengths_s: Vec<f64>,
    /// Starts an outage length.
    pub starts: usize,
    /// Estimators.
    pub estimators: Vec<String>,
    /// Every key of the configuration with its value, of all estimators.
    pub settings: String,
}

impl Recipe {
    /// What tells it from another, and this version's results from another's.
    pub fn key(&self) -> String {
        let text = format!(
            "{}\n{:?}\n{}\n{:?}\n{}",
            env!("CARGO_PKG_VERSION"),
            self.lengths_s,
            self.starts,
            self.estimators,
            self.settings
        );
        digest(text.as_bytes())
    }
}

/// What a shard's results belong to.
#[derive(Clone, Debug, PartialEq)]
pub struct Provenance {
    /// [`Recipe::key`].
    pub key: String,
    /// The lengths of its outages, s, in the order in which they are shown.
    pub lengths_s: Vec<f64>,
    /// The program, by its content: between two releases it changes, and its version does not.
    pub program: String,
    /// How many logs the whole list holds.
    pub logs: u64,
    /// What tells the list from another.
    pub list: String,
}

impl Provenance {
    /// Of this program, for a list of logs.
    pub fn of<'a>(recipe: &Recipe, names: impl ExactSizeIterator<Item = &'a str>) -> Self {
        let (logs, mut list) = (names.len() as u64, Sha256::new());
        for name in names {
            list.update(name.as_bytes());
            list.update(b"\n");
        }
        Self {
            key: recipe.key(),
            lengths_s: recipe.lengths_s.clone(),
            program: this_program(),
            logs,
            list: hex(&list.finalize()),
        }
    }
}

/// What this program's file holds; nothing where the system does not give it.
fn this_program() -> String {
    let bytes = std::env::current_exe().and_then(std::fs::read);
    bytes.map_or_else(|_| String::new(), |bytes| digest(&bytes))
}

fn digest(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_question_has_another_key() {
        let recipe = Recipe {
            lengths_s: vec![60.0],
            starts: 8,
            estimators: vec!["shipped".into()],
            settings: "a = 1".into(),
        };
        let others = [
            Recipe { lengths_s: vec![60.0, 61.0], ..recipe.clone() },
            Recipe { starts: 9, ..recipe.clone() },
            Recipe { estimators: vec!["inertial".into()], ..recipe.clone() },
            Recipe { settings: "a = 2".into(), ..recipe.clone() },
        ];
        assert_eq!(recipe.key(), recipe.clone().key());
        assert!(others.iter().all(|other| other.key() != recipe.key()));
        let batch = |names: &[&str]| Provenance::of(&recipe, names.iter().copied());
        assert_ne!(batch(&["a", "b"]), batch(&["ab"]));
        assert!(!batch(&["a"]).program.is_empty());
    }
}
