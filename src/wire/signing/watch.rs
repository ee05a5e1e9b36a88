//! When something is to be told of the signatures, and what.

use super::gate::SigningCounts;
use crate::time::{Companion, Span, Stamp};

/// The first pause between two words, and the longest; each is twice the one before.
const FIRST_PAUSE: Span = Span::from_millis(10_000);
const LONGEST_PAUSE: Span = Span::from_millis(640_000);

/// Tells what was refused, at once and then ever less often: whoever sends it wants to be heard.
#[derive(Clone, Copy, Debug)]
pub struct SigningWatch {
    told: SigningCounts,
    due: Option<Stamp<Companion>>,
    pause: Span,
    no_key_told: bool,
}

impl Default for SigningWatch {
    fn default() -> Self {
        Self { told: SigningCounts::default(), due: None, pause: FIRST_PAUSE, no_key_told: false }
    }
}

impl SigningWatch {
    /// What is to be told now of what was counted, a sentence.
    pub fn poll(&mut self, now: Stamp<Companion>, counts: &SigningCounts) -> Option<String> {
        if counts.no_key > 0 && !std::mem::replace(&mut self.no_key_told, true) {
            return Some("frames are signed, and nobody looks: signing.key_file is not set".to_owned());
        }
        if self.due.is_some_and(|due| now < due) || counts.refused() == self.told.refused() {
            return None;
        }
        self.pause = if self.due.is_some() {
            Span::from_micros(2 * self.pause.micros()).min(LONGEST_PAUSE)
        } else {
            FIRST_PAUSE
        };
        self.due = Some(now + self.pause);
        let before = std::mem::replace(&mut self.told, *counts);
        let parts: Vec<String> = counts
            .reasons()
            .zip(before.reasons())
            .filter(|((_, n), (_, b))| n > b)
            .map(|((reason, n), (_, b))| format!("{} {reason}", n - b))
            .collect();
        Some(format!("signing: frames refused: {}", parts.join(", ")))
    }
}

impl SigningCounts {
    /// Frames refused.
    pub fn refused(&self) -> u64 {
        self.reasons().map(|(_, n)| n).sum()
    }

    fn reasons(&self) -> impl Iterator<Item = (&'static str, u64)> + use<> {
        [
            ("with a bad signature", self.bad_signature),
            ("replayed", self.replayed),
            ("too old", self.too_old),
            ("unsigned", self.unsigned),
        ]
        .into_iter()
    }
}

impl std::fmt::Display for SigningCounts {
    /// For the summary: nothing where nothing is signed. What was refused stands with the other rejects there.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.verified > 0 {
            write!(f, "; signed: {} verified", self.verified)?;
        }
        if self.no_key > 0 {
            write!(f, "; signed: {} not verified, no key", self.no_key)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_refused_is_told_at_once_and_then_ever_less_often() {
        let mut watch = SigningWatch::default();
        let mut counts = SigningCounts::default();
        assert_eq!(watch.poll(Stamp::from_micros(0), &counts), None);
        let mut told = Vec::new();
        for s in 0..3600 {
            counts.unsigned += 20;
            counts.replayed += u64::from(s == 5);
            if let Some(text) = watch.poll(Stamp::from_micros(s * 1_000_000), &counts) {
                told.push((s, text));
            }
        }
        assert_eq!(told[0], (0, "signing: frames refused: 20 unsigned".to_owned()));
        assert_eq!(told[1], (10, "signing: frames refused: 1 replayed, 200 unsigned".to_owned()));
        assert!(told.len() < 14, "{}", told.len());
    }

    #[test]
    fn signatures_that_nobody_looks_at_are_told_once() {
        let mut watch = SigningWatch::default();
        let counts = SigningCounts { no_key: 3, ..SigningCounts::default() };
        assert!(watch.poll(Stamp::from_micros(0), &counts).unwrap().contains("signing.key_file"));
        assert_eq!(watch.poll(Stamp::from_micros(90_000_000), &counts), None);
        assert!(counts.to_string().contains("3 not verified"));
    }
}
