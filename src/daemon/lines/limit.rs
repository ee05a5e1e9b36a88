//! How often a line of one kind may be told: who can make Holdover say something must not fill a disk with it.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};

use tracing::Level;

use crate::time::{Companion, Span, Stamp};

/// What the limit is over.
const WINDOW: Span = Span::from_millis(60_000);
/// Kinds that are told apart; whatever comes beyond is one kind.
const KINDS: usize = 64;
/// Kinds that are over are looked for this often.
const SWEEP: Span = Span::from_millis(1000);
/// Letters of a line that stand for its kind.
const LETTERS: usize = 80;
/// The kind of what comes beyond [`KINDS`].
const OTHERS: u64 = u64::MAX;

/// Counts lines by their kind: the level, and the text without its figures.
#[derive(Debug)]
pub(super) struct LineLimit {
    per_min: u32,
    kinds: HashMap<u64, LineKind>,
    swept: Option<Stamp<Companion>>,
}

#[derive(Debug)]
struct LineKind {
    since: Stamp<Companion>,
    lines: u32,
    held: u64,
    level: Level,
    /// How the newest that was held back began.
    text: String,
}

impl LineLimit {
    /// So many lines of a kind a minute; 0 is no limit.
    pub(super) fn new(per_min: u32) -> Self {
        Self { per_min, kinds: HashMap::new(), swept: None }
    }

    /// Another limit from now on.
    pub(super) fn set(&mut self, per_min: u32) {
        self.per_min = per_min;
    }

    /// Whether this line may be told. What was held back of kinds whose minute is over is handed to `told` first.
    pub(super) fn judge(
        &mut self,
        now: Stamp<Companion>,
        level: Level,
        text: &str,
        mut told: impl FnMut(Level, String),
    ) -> bool {
        if self.swept.is_none_or(|swept| now - swept >= SWEEP) {
            self.swept = Some(now);
            self.kinds.retain(|_, kind| {
                let over = now - kind.since >= WINDOW;
                if over && kind.held > 0 {
                    told(kind.level, format!("{} more: {}", kind.held, kind.text));
                }
                !over
            });
        }
        if self.per_min == 0 {
            return true;
        }
        let mut key = key_of(level, text);
        if self.kinds.len() >= KINDS && !self.kinds.contains_key(&key) {
            key = OTHERS;
        }
        let fresh = || LineKind { since: now, lines: 0, held: 0, level, text: String::new() };
        let kind = self.kinds.entry(key).or_insert_with(fresh);
        if kind.lines < self.per_min {
            kind.lines += 1;
            return true;
        }
        kind.held += 1;
        kind.text = text.chars().take(LETTERS).collect();
        false
    }
}

/// The same for lines that differ in their figures only.
fn key_of(level: Level, text: &str) -> u64 {
    let mut hasher = DefaultHasher::new();
    level.hash(&mut hasher);
    for letter in text.chars().filter(|c| !c.is_ascii_digit()).take(LETTERS) {
        letter.hash(&mut hasher);
    }
    hasher.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(s: i64) -> Stamp<Companion> {
        Stamp::from_micros(s * 1_000_000)
    }

    #[test]
    fn what_comes_too_often_is_counted_and_told_when_it_is_over() {
        let mut limit = LineLimit::new(3);
        let mut told = Vec::new();
        let passed = (0..43)
            .filter(|i| limit.judge(at(0), Level::INFO, &format!("armed {i}"), |_, text| told.push(text)))
            .count();
        assert_eq!((passed, told.len()), (3, 0));
        assert!(limit.judge(at(1), Level::WARN, "armed 1", |_, text| told.push(text)), "another level");
        assert!(limit.judge(at(61), Level::INFO, "something else", |_, text| told.push(text)));
        assert_eq!(told, ["40 more: armed 42"]);
        assert!(limit.judge(at(61), Level::INFO, "armed 44", |_, _| {}));
    }

    #[test]
    fn inventions_are_one_kind_and_take_no_memory() {
        let mut limit = LineLimit::new(2);
        let text = |i: u32| "x".repeat(i as usize % 70) + &"y".repeat(i as usize / 70 + 1);
        let passed = (0..4000).filter(|&i| limit.judge(at(0), Level::WARN, &text(i), |_, _| {})).count();
        assert!(limit.kinds.len() <= KINDS + 1);
        assert!(passed <= 2 * (KINDS + 1), "{passed}");
    }

    #[test]
    fn none_is_no_limit() {
        let mut limit = LineLimit::new(0);
        assert!((0..1000).all(|_| limit.judge(at(0), Level::INFO, "same", |_, _| {})));
    }
}
