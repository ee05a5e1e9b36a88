//! Text for a page: whatever comes from a log or a file name is text, and stays text.

use std::fmt::Write;

/// A text as it may stand in a page, inside an element or an attribute in double quotes. Characters that no page may hold are left out.
pub(super) fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            // Controls, and what turns the direction of the text around it.
            c if c.is_control() && c != '\n' => out.push('\u{fffd}'),
            '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// A number with so many digits after the point, or a dash.
pub(super) fn number(value: Option<f64>, decimals: usize) -> String {
    value.filter(|v| v.is_finite()).map_or_else(|| "–".to_owned(), |v| format!("{v:.decimals$}"))
}

/// A number with three digits that mean something.
pub(super) fn short(value: f64) -> String {
    let size = value.abs();
    let decimals = match size {
        _ if size >= 99.95 => 0,
        _ if size >= 9.995 => 1,
        _ => 2,
    };
    format!("{value:.decimals$}")
}

/// A time in minutes and seconds, where it is longer than two minutes.
pub(super) fn duration(seconds: f64) -> String {
    let whole = seconds.max(0.0).round() as u64;
    match whole {
        0..120 => format!("{} s", short(seconds)),
        120..7200 => format!("{} min {:02} s", whole / 60, whole % 60),
        _ => format!("{} h {:02} min", whole / 3600, whole / 60 % 60),
    }
}

/// A table; every cell is text.
pub(super) fn table(head: &[&str], rows: &[Vec<String>]) -> String {
    let mut out = String::from("<div class=\"scroll\"><table><thead><tr>");
    for cell in head {
        let _ = write!(out, "<th>{}</th>", escaped(cell));
    }
    out.push_str("</tr></thead><tbody>");
    for row in rows {
        out.push_str("<tr>");
        for cell in row {
            let numeric = cell.starts_with(|c: char| c.is_ascii_digit() || "+-–".contains(c));
            let class = if numeric { " class=\"n\"" } else { "" };
            let _ = write!(out, "<td{class}>{}</td>", escaped(cell));
        }
        out.push_str("</tr>");
    }
    out.push_str("</tbody></table></div>\n");
    out
}

/// What a part of the page cannot show, and why.
pub(super) fn lacking(title: &str, why: &str) -> String {
    format!(
        "<figure class=\"lacking\"><figcaption><h3>{}</h3><p>{}</p></figcaption></figure>\n",
        escaped(title),
        escaped(why)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_stays_text() {
        let hostile = "</td><script>alert('1')</script>\"&\u{202e}\u{7}";
        let safe = escaped(hostile);
        assert!(!safe.contains(['<', '>', '"', '\'', '\u{202e}', '\u{7}']), "{safe}");
        assert_eq!(escaped("a & b"), "a &amp; b");
        let table = table(&["<b>"], &[vec![hostile.to_owned()]]);
        assert!(!table.contains("<script") && !table.contains("<b>"), "{table}");
    }

    #[test]
    fn numbers_are_short() {
        let shown = [0.0, 1.234, 12.34, 123.4, -0.126].map(short);
        assert_eq!(shown, ["0.00", "1.23", "12.3", "123", "-0.13"]);
        assert_eq!(
            (number(None, 1), number(Some(f64::NAN), 1), number(Some(1.26), 1)),
            ("–".into(), "–".into(), "1.3".into())
        );
        assert_eq!([2.0, 154.2, 7260.0].map(duration), ["2.00 s", "2 min 34 s", "2 h 01 min"]);
    }
}
