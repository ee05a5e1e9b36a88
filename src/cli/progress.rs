//! How far a command is, on a terminal where somebody watches: one bar for whatever is counted, with its rate and the time that is left.

use std::io::IsTerminal;

use indicatif::{ProgressBar, ProgressStyle};

/// What is counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ProgressUnit {
    /// Bytes that are read.
    Bytes,
    /// Logs, or whatever else is done one after the other.
    Jobs,
    /// Seconds that are flown.
    Seconds,
}

/// Less is read before anybody looks, bytes.
const AT_ONCE: u64 = 1 << 20;

impl ProgressUnit {
    fn template(self) -> &'static str {
        match self {
            ProgressUnit::Bytes => {
                "{bar:40} {percent}%, {bytes} of {total_bytes}, {bytes_per_sec}, {eta} left"
            }
            ProgressUnit::Jobs => "{bar:40} {pos} of {len} {msg}, {per_sec}, {eta} left",
            ProgressUnit::Seconds => "{bar:40} {percent}%, {pos} of {len} s flown, {per_sec}, {eta} left",
        }
    }
}

/// A bar over so many; hidden where it is to be `quiet`, where nobody watches, and of what is done at once.
pub(super) fn bar(counted: ProgressUnit, total: u64, quiet: bool) -> ProgressBar {
    let at_once = counted == ProgressUnit::Bytes && total < AT_ONCE;
    if quiet || at_once || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template(counted.template());
    ProgressBar::new(total).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_template_is_one() {
        for counted in [ProgressUnit::Bytes, ProgressUnit::Jobs, ProgressUnit::Seconds] {
            let template = counted.template();
            assert!(ProgressStyle::with_template(template).is_ok(), "{template}");
            assert!(template.contains("_per_sec") || template.contains("{per_sec}"), "{template}");
            assert!(template.contains("{eta}"), "{template}");
        }
    }
}
