//! The README and the book: their commands run, their links lead somewhere, and what they list is all that there is.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;

use holdover::navigator::event_codes::EVENTS;

use crate::command::holdover;

#[path = "../../examples/numbers/markers.rs"]
mod markers;

/// What stands before the arguments of `holdover` in the documents.
const CARGO: &str = "cargo run --release --";
const EXAMPLE: &str = "cargo run --release --example ";

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The README and every page of the book: path from the root, text.
fn documents() -> Vec<(String, String)> {
    let pages = fs::read_dir(root().join("docs/src")).unwrap().map(|e| e.unwrap().path());
    let mut paths: Vec<PathBuf> = pages.filter(|p| p.extension().is_some_and(|e| e == "md")).collect();
    paths.push(root().join("README.md"));
    paths.sort();
    assert!(paths.len() > 10, "{paths:?}");
    let name = |p: &Path| p.strip_prefix(root()).unwrap().display().to_string();
    paths.iter().map(|p| (name(p), fs::read_to_string(p).unwrap())).collect()
}

/// A fenced block.
#[derive(Debug, PartialEq)]
struct Block {
    line: usize,
    /// What follows the fence.
    info: String,
    text: String,
}

fn blocks(text: &str) -> Vec<Block> {
    let mut out: Vec<Block> = Vec::new();
    let mut fence = String::new();
    for (i, line) in text.lines().enumerate() {
        let code = line.trim_start();
        let ticks: String = code.chars().take_while(|c| *c == '`').collect();
        if fence.is_empty() && ticks.len() >= 3 {
            out.push(Block { line: i + 1, info: code[ticks.len()..].to_owned(), text: String::new() });
            fence = ticks;
        } else if !fence.is_empty() && ticks.len() >= fence.len() && code == ticks {
            fence.clear();
        } else if !fence.is_empty() {
            let block = out.last_mut().unwrap();
            block.text.push_str(line);
            block.text.push('\n');
        }
    }
    assert!(fence.is_empty(), "a block has no end");
    out
}

/// The text without what commands have written into it; as many lines as before.
fn by_hand(page: &str, text: &str) -> String {
    let mut out = text.to_owned();
    for marker in markers::markers(text).unwrap_or_else(|e| panic!("{page}: {e}")).iter().rev() {
        let lines = text[marker.body.clone()].matches('\n').count();
        out.replace_range(marker.body.clone(), &"\n".repeat(lines));
    }
    out
}

/// What a block of commands says of itself: `exit=3`, or `norun="why"`.
fn attribute<'a>(info: &'a str, key: &str) -> Option<&'a str> {
    let (_, rest) = info.split_once(&format!(" {key}="))?;
    Some(match rest.strip_prefix('"') {
        Some(quoted) => quoted.split('"').next().unwrap_or_default(),
        None => rest.split(' ').next().unwrap_or_default(),
    })
}

/// A folder that looks like the repository to the commands, and where they may write.
fn stage() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["config", "sitl-logs", "tests"] {
        symlink(root().join(name), folder.path().join(name)).unwrap();
    }
    fs::create_dir(folder.path().join("target")).unwrap();
    folder
}

/// Runs a block's commands in `folder`; what is wrong with them.
fn run(block: &Block, folder: &Path) -> Result<(), String> {
    let expected: i32 = attribute(&block.info, "exit").map_or(0, |code| code.parse().unwrap());
    let mut script = String::from("set -e\n");
    for line in block.text.lines().map(str::trim_start) {
        if let Some(example) = line.strip_prefix(EXAMPLE) {
            let name = example.split_whitespace().next().unwrap_or_default();
            let files = [format!("examples/{name}.rs"), format!("examples/{name}/main.rs")];
            if !files.iter().any(|f| root().join(f).is_file()) {
                return Err(format!("there is no example {name}"));
            }
        } else {
            script.push_str(&line.replace(CARGO, "\"$HOLDOVER_BINARY\""));
            script.push('\n');
        }
    }
    if script.contains("cargo ") {
        return Err("a command of cargo other than `run` needs norun=\"why\"".into());
    }
    let binary = folder.join("holdover");
    if !binary.exists() {
        symlink(env!("CARGO_BIN_EXE_holdover"), &binary).unwrap();
    }
    let mut shell = Command::new("sh");
    for (name, _) in std::env::vars_os().filter(|(n, _)| n.to_string_lossy().starts_with("HOLDOVER_")) {
        shell.env_remove(name);
    }
    // Set as a variable of the shell, not of the environment, where it would be a setting of Holdover.
    let script = format!("HOLDOVER_BINARY=./holdover\n{script}");
    let done = shell.args(["-c", &script]).current_dir(folder).output().unwrap();
    let said = String::from_utf8_lossy(&done.stderr);
    if done.status.code() == Some(expected) && !said.contains("panicked") {
        return Ok(());
    }
    Err(format!("{:?} instead of {expected}\n{}{said}", done.status.code(), block.text))
}

#[test]
fn the_commands_run() {
    let (mut ran, mut wrong) = (0, Vec::new());
    for (page, text) in documents() {
        let folder = stage();
        for block in blocks(&by_hand(&page, &text)) {
            let place = format!("{page}:{}", block.line);
            if block.info.is_empty() {
                wrong.push(format!("{place}: a block without a language"));
            }
            if block.info.split(' ').next() != Some("sh") {
                continue;
            }
            match attribute(&block.info, "norun") {
                Some("") => wrong.push(format!("{place}: norun needs a reason")),
                Some(_) => {}
                None => {
                    ran += 1;
                    wrong.extend(run(&block, folder.path()).err().map(|e| format!("{place}: {e}")));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(ran >= 6, "only {ran} blocks were run");
}

#[test]
fn the_configurations_are_valid() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("page.toml");
    let mut checked = 0;
    for (page, text) in documents() {
        for block in blocks(&text).iter().filter(|b| b.info == "toml") {
            fs::write(&file, &block.text).unwrap();
            let ran = holdover(&["check", "--config", file.to_str().unwrap()]);
            assert_eq!(ran.code, Some(0), "{page}:{}: {}", block.line, ran.err);
            checked += 1;
        }
    }
    assert!(checked >= 2, "{checked} configurations");
}

/// What stands between backticks in the prose and its tables.
fn spans(text: &str) -> Vec<(usize, String)> {
    let mut in_block = false;
    let mut out = Vec::new();
    for (i, line) in text.lines().enumerate() {
        in_block ^= line.trim_start().starts_with("```");
        if !in_block {
            out.extend(line.split('`').skip(1).step_by(2).map(|s| (i + 1, s.to_owned())));
        }
    }
    out
}

/// `gnss.delay_ms`, also with a value; a section alone, a file or a path is none.
fn key_in<'a>(span: &'a str, sections: &[&str]) -> Option<&'a str> {
    let key = span.split([' ', '=']).next()?;
    let (section, name) = key.rsplit_once('.')?;
    let is_key =
        !name.is_empty() && name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
    // Also what was a section once must be found out.
    let known = sections.contains(&section)
        || ["kalman", "height", "observer", "range", "rejoin", "imu"].contains(&section);
    (is_key && known && !["rs", "md", "toml", "tlog"].contains(&name)).then_some(key)
}

#[test]
fn the_keys_that_are_named_exist() {
    let json = holdover(&["check", "--json"]).json();
    let keys: Vec<&str> =
        json["keys"].as_array().unwrap().iter().map(|k| k["key"].as_str().unwrap()).collect();
    let sections: Vec<&str> = keys.iter().filter_map(|k| Some(k.rsplit_once('.')?.0)).collect();
    let (mut seen, mut wrong) = (0, Vec::new());
    for (page, text) in documents() {
        for (line, span) in spans(&text) {
            if let Some(key) = key_in(&span, &sections) {
                seen += 1;
                if !keys.contains(&key) {
                    wrong.push(format!("{page}:{line}: there is no key {key}"));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(seen > 40, "only {seen} keys");
}

/// What a headline's link is called.
fn anchor(headline: &str) -> String {
    let kept = headline
        .to_lowercase()
        .chars()
        .filter(|c| c.is_alphanumeric() || " -_".contains(*c))
        .collect::<String>();
    kept.trim().replace(' ', "-")
}

fn anchors(text: &str) -> Vec<String> {
    let mut in_block = false;
    let mut out = Vec::new();
    for line in text.lines() {
        in_block ^= line.trim_start().starts_with("```");
        if !in_block && let Some(headline) = line.trim_start_matches("> ").strip_prefix('#') {
            out.push(anchor(headline.trim_start_matches('#')));
        }
    }
    out
}

/// Targets of `[text](target)` outside of code.
fn links(text: &str) -> Vec<(usize, String)> {
    let mut out = Vec::new();
    let mut in_block = false;
    for (i, line) in text.lines().enumerate() {
        in_block ^= line.trim_start().starts_with("```");
        if in_block {
            continue;
        }
        // Every second piece lies between backticks.
        let prose: String = line.split('`').step_by(2).collect::<Vec<_>>().join("x");
        for (at, _) in prose.match_indices("](") {
            let target: String = prose[at + 2..].chars().take_while(|c| *c != ')').collect();
            out.push((i + 1, target));
        }
    }
    out
}

#[test]
fn every_link_leads_somewhere() {
    let documents = documents();
    let texts: BTreeMap<&str, &str> = documents.iter().map(|(p, t)| (p.as_str(), t.as_str())).collect();
    let (mut seen, mut wrong) = (0, Vec::new());
    for (page, text) in &documents {
        for (line, target) in links(text).iter().filter(|(_, t)| !t.contains("://")) {
            seen += 1;
            let (file, part) = target.split_once('#').unwrap_or((target, ""));
            let folder = Path::new(page).parent().unwrap();
            let path = if file.is_empty() { PathBuf::from(page) } else { folder.join(file) };
            if !root().join(&path).is_file() {
                wrong.push(format!("{page}:{line}: no file {target}"));
            } else if page.starts_with("docs/") && !path.starts_with("docs/src") {
                wrong.push(format!("{page}:{line}: {target} is not in the book"));
            } else if !part.is_empty() {
                let text = texts.get(path.to_str().unwrap()).copied().unwrap_or_default();
                if !anchors(text).iter().any(|a| a == part) {
                    wrong.push(format!("{page}:{line}: no headline {target}"));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(seen > 50, "only {seen} links");
}

#[test]
fn the_summary_has_every_page() {
    let summary = fs::read_to_string(root().join("docs/src/SUMMARY.md")).unwrap();
    for (page, _) in
        documents().iter().filter(|(p, _)| p.starts_with("docs/src/") && !p.ends_with("SUMMARY.md"))
    {
        let file = page.trim_start_matches("docs/src/");
        assert!(summary.contains(&format!("({file})")), "{page} is not in the summary");
    }
}

#[test]
fn every_event_is_explained() {
    let page = fs::read_to_string(root().join("docs/src/events.md")).unwrap();
    for event in EVENTS {
        let rows = page.lines().filter(|l| l.starts_with(&format!("| `{}` | ", event.code))).count();
        assert_eq!(rows, 1, "{}: cargo run --release --example numbers -- events", event.code);
    }
}

#[test]
fn the_readme_is_short() {
    let length = fs::metadata(root().join("README.md")).unwrap().len();
    assert!(length <= 15_000, "{length} bytes");
    assert!(fs::metadata(root().join("docs/src/outage.svg")).unwrap().len() < 60_000);
}

#[test]
fn documents_are_read_as_they_are_written() {
    let text = "a\n```sh exit=4\nx\n```\n````text\n```sh\n````\n";
    let expected = [(2, "sh exit=4", "x\n"), (5, "text", "```sh\n")].map(|(line, info, text)| Block {
        line,
        info: info.into(),
        text: text.into(),
    });
    assert_eq!(blocks(text), expected);
    assert_eq!(attribute("sh exit=4", "exit"), Some("4"));
    assert_eq!(attribute("sh norun=\"needs an autopilot\"", "norun"), Some("needs an autopilot"));
    assert_eq!(attribute("sh", "norun"), None);
    assert_eq!(anchor(" Modes, uncertainty, time"), "modes-uncertainty-time");
    assert_eq!(links("[a](b.md#c) `[d](e)`\n```\n[f](g)\n```"), [(1, "b.md#c".to_owned())]);
    assert!(markers::markers("<!-- numbers: a, b -->\n").is_err(), "no end");
    assert!(markers::markers("<!-- numbers: a -->\n<!-- end -->\n").is_err(), "no command");
    let page = "x\n<!-- numbers: a, b c -->\n```sh\nd\n```\n<!-- end -->\ny\n";
    assert_eq!(blocks(&by_hand("page", page)), []);
}
