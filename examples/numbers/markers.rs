//! Where generated text stands in a Markdown document: between `<!-- numbers: NAME, COMMAND -->` and `<!-- end -->`, each on a line of its own.

use std::ops::Range;

const OPEN: &str = "<!-- numbers:";
const CLOSE: &str = "-->";
const END: &str = "<!-- end -->";

/// One place for generated text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Marker {
    /// What stands there.
    pub name: String,
    /// What a reader types to see it.
    pub command: String,
    /// The text between the markers: bytes of the document.
    pub body: Range<usize>,
    /// The line of the marker, from 1.
    pub line: usize,
}

/// All markers of a document, in its order.
///
/// # Errors
/// What is wrong with a marker, and its line.
pub fn markers(text: &str) -> Result<Vec<Marker>, String> {
    let mut found = Vec::new();
    let mut open: Option<(String, String, usize, usize)> = None;
    let mut at = 0;
    for (i, line) in text.split_inclusive('\n').enumerate() {
        let number = i + 1;
        let next = at + line.len();
        let trimmed = line.trim_end();
        if let Some(head) = trimmed.strip_prefix(OPEN) {
            if let Some((name, ..)) = &open {
                return Err(format!("line {number}: {name} has no end"));
            }
            let inside =
                head.strip_suffix(CLOSE).ok_or(format!("line {number}: the marker has no \"{CLOSE}\""))?;
            let (name, command) =
                inside.split_once(',').ok_or(format!("line {number}: \"NAME, COMMAND\" expected"))?;
            let (name, command) = (name.trim().to_owned(), command.trim().to_owned());
            if name.is_empty() || command.is_empty() {
                return Err(format!("line {number}: a marker needs a name and a command"));
            }
            open = Some((name, command, next, number));
        } else if trimmed == END {
            let (name, command, from, line) =
                open.take().ok_or(format!("line {number}: an end without a beginning"))?;
            found.push(Marker { name, command, body: from..at, line });
        }
        at = next;
    }
    match open {
        Some((name, ..)) => Err(format!("{name} has no end")),
        None => Ok(found),
    }
}
