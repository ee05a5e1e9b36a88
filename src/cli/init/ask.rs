//! Questions to whoever sits at the terminal. They are asked on standard error: standard output holds the result.

use std::io::{self, BufRead, IsTerminal};

use super::Failure;

/// Times that an answer may be none.
const PATIENCE: usize = 3;

/// Whether anybody can be asked.
pub(super) fn somebody_is_there(json: bool) -> bool {
    !json && io::stdin().is_terminal() && io::stderr().is_terminal()
}

/// Which of these, by its place; an empty answer is the first.
///
/// # Errors
/// [`Failure::Usage`] where none is chosen.
pub(super) fn which(question: &str, options: &[String]) -> Result<usize, Failure> {
    errln!("{question}");
    for (i, option) in options.iter().enumerate() {
        errln!("  {}  {option}", i + 1);
    }
    for _ in 0..PATIENCE {
        errln!("1 to {}, or return for 1:", options.len());
        let mut line = String::new();
        if io::stdin().lock().read_line(&mut line)? == 0 {
            break;
        }
        if let Some(choice) = choice(&line, options.len()) {
            return Ok(choice);
        }
    }
    Err(Failure::Usage("nothing was chosen".into()))
}

fn choice(line: &str, of: usize) -> Option<usize> {
    match line.trim() {
        "" => Some(0),
        text => text.parse().ok().filter(|n| (1..=of).contains(n)).map(|n: usize| n - 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_is_a_number_that_was_offered() {
        for (line, chosen) in
            [("2\n", Some(1)), ("\n", Some(0)), (" 3 ", Some(2)), ("4", None), ("0", None), ("x", None)]
        {
            assert_eq!(choice(line, 3), chosen, "{line}");
        }
    }
}
