//! Whether two texts with numbers say the same.

/// A word of a text: a number with its decimals, or anything else.
#[derive(Debug, PartialEq)]
enum Token<'a> {
    Number(f64, usize),
    Word(&'a str),
}

/// Words, and numbers inside words: "0.91/0.92" is two numbers and a slash.
fn tokens(line: &str) -> Vec<Token<'_>> {
    let mut out = Vec::new();
    let mut rest = line;
    while let Some(first) = rest.chars().next() {
        let numeric = |c: char| c.is_ascii_digit() || c == '.';
        if first.is_whitespace() {
            rest = rest.trim_start();
            continue;
        }
        let in_number = first.is_ascii_digit();
        let end = rest
            .find(|c: char| c.is_whitespace() || if in_number { !numeric(c) } else { c.is_ascii_digit() })
            .unwrap_or(rest.len());
        let (word, after) = rest.split_at(end);
        let number = if in_number { word.trim_end_matches('.').parse::<f64>().ok() } else { None };
        out.push(match number {
            Some(value) => {
                Token::Number(value, word.trim_end_matches('.').split_once('.').map_or(0, |(_, d)| d.len()))
            }
            None => Token::Word(word),
        });
        rest = after;
    }
    out
}

/// A value that is not known stands as a dash, with the spaces and signs of its number.
fn is_blank(word: &str) -> bool {
    word.chars().all(|c| matches!(c, '-' | '+' | '/' | '|'))
}

fn line_differs(old: &str, new: &str, exact: bool) -> bool {
    let (old, new) = (tokens(old), tokens(new));
    if !exact {
        let words = |tokens: &[Token]| -> Vec<String> {
            let word = |t: &Token| match t {
                Token::Word(w) if !is_blank(w) => Some((*w).to_owned()),
                _ => None,
            };
            tokens.iter().filter_map(word).collect()
        };
        return words(&old) != words(&new);
    }
    old.len() != new.len()
        || old.iter().zip(&new).any(|pair| match pair {
            (Token::Number(a, d), Token::Number(b, e)) => {
                // One unit of the last digit that is printed.
                d != e || (a - b).abs() > 1.01 * 10_f64.powi(-i32::try_from(*d).unwrap_or(0))
            }
            (a, b) => a != b,
        })
}

/// The first line that differs: in a value by more than its last digit when `exact`, else in anything but numbers.
pub fn difference(old: &str, new: &str, exact: bool) -> Option<String> {
    let (a, b): (Vec<&str>, Vec<&str>) = (old.lines().collect(), new.lines().collect());
    if let Some((a, b)) = a.iter().zip(&b).find(|(a, b)| line_differs(a, b, exact)) {
        return Some(format!("\n    stands  {}\n    is now  {}", a.trim(), b.trim()));
    }
    (a.len() != b.len()).then(|| format!("{} lines stand, {} are printed now", a.len(), b.len()))
}
