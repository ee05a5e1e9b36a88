//! The page around the plots: one file, which loads nothing and sends nothing.

use std::fmt::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use sha2::{Digest, Sha256};
use strum::VariantArray;

use super::html::escaped;
use super::palette::{Role, Tone};

const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("hover.js");

/// The colours of both kinds of page, as they stand in [`Role`] and [`Tone`].
fn colours() -> String {
    let all = || {
        let roles = Role::VARIANTS.iter().map(|r| (r.colours(), "c"));
        roles.chain(Tone::VARIANTS.iter().map(|t| (t.colours(), "t")))
    };
    let mut out = String::from(":root{");
    for ((class, light, _), kind) in all() {
        let _ = write!(out, "--{kind}-{class}:{light};");
    }
    out.push_str("}@media (prefers-color-scheme:dark){:root{");
    for ((class, _, dark), kind) in all() {
        let _ = write!(out, "--{kind}-{class}:{dark};");
    }
    out.push_str("}}");
    for ((class, ..), kind) in all() {
        let _ = match kind {
            "c" => write!(out, ".c-{class}{{--c:var(--c-{class})}}"),
            _ => write!(out, ".t-{class}{{fill:var(--t-{class})}}"),
        };
    }
    out
}

/// A whole page. `body` is markup, `title` is text.
pub(super) fn page(title: &str, body: &str) -> String {
    // A page that somebody made of a log that somebody else made: nothing in it may run but this script, and nothing may be loaded.
    let hash = STANDARD.encode(Sha256::digest(SCRIPT.as_bytes()));
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"/>\n<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{hash}'; base-uri 'none'; form-action 'none'\"/>\n<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/><meta name=\"referrer\" content=\"no-referrer\"/>\n<title>{}</title>\n<style>{}{STYLE}</style></head>\n<body>\n{body}\n<footer>Made by Holdover {}. Times are seconds since the first sample of the log; heights and places are relative to the origin of its local frame.</footer>\n<script>{SCRIPT}</script></body></html>\n",
        escaped(title),
        colours(),
        env!("CARGO_PKG_VERSION"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_loads_nothing_and_runs_only_its_own_script() {
        let page = page("</title><script>x</script>", "<p>body</p>");
        assert_eq!(page.matches("<script>").count(), 1);
        for outside in ["http:", "https:", "//cdn", "@import", "url("] {
            let found = page.replace("http://www.w3.org/2000/svg", "").contains(outside);
            assert!(!found, "{outside}");
        }
        let script = page.split("<script>").nth(1).unwrap().split("</script>").next().unwrap();
        let hash = STANDARD.encode(Sha256::digest(script.as_bytes()));
        assert!(page.contains(&format!("script-src 'sha256-{hash}'")));
        assert!(page.contains("default-src 'none'"));
    }

    #[test]
    fn no_two_things_have_one_colour() {
        for dark in [false, true] {
            let of = |c: (&'static str, &'static str, &'static str)| if dark { c.2 } else { c.1 };
            let mut all: Vec<&str> = Role::VARIANTS.iter().map(|r| of(r.colours())).collect();
            all.extend(Tone::VARIANTS.iter().map(|t| of(t.colours())));
            let count = all.len();
            all.sort_unstable();
            all.dedup();
            assert_eq!(all.len(), count);
        }
    }
}
