//! The layering, held by reading the sources: what the core must not know, which room may use which, and what every file owes
//! its reader.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests may fail like tests"
)]

mod known;
mod sizes;

use std::fs;
use std::path::{Path, PathBuf};

/// What each room may use besides itself. A room that is not here is a decision that somebody has to make: add it.
const ROOMS: &[(&str, &[&str])] = &[
    ("time", &[]),
    ("files", &[]),
    ("geo", &["time"]),
    ("sample", &["time", "geo"]),
    ("camera", &["geo", "sample", "time"]),
    ("altimeter", &["geo", "sample", "time"]),
    ("filter", &["camera", "geo", "sample", "time"]),
    ("observer", &["camera", "filter", "geo", "sample", "time"]),
    ("landmark", &["geo", "sample", "time"]),
    ("navigator", &["altimeter", "camera", "filter", "geo", "landmark", "observer", "sample", "time"]),
    ("outbound", &["geo", "navigator", "sample", "time"]),
    ("metrics", &["geo", "navigator", "sample", "time"]),
    ("sim", &["altimeter", "geo", "sample", "time"]),
    ("fault", &["geo", "sample", "time"]),
    ("wire", &["files", "geo", "navigator", "outbound", "sample", "time"]),
    ("log", &["files", "geo", "sample", "time", "wire"]),
    ("double", &["geo", "sample", "sim", "time", "wire"]),
    ("pipeline", &["geo", "navigator", "outbound", "sample", "time", "wire"]),
    ("record", &["files", "time", "wire"]),
    ("state", &["files", "navigator", "outbound", "time", "wire"]),
    (
        "config",
        &[
            "altimeter",
            "camera",
            "filter",
            "geo",
            "landmark",
            "navigator",
            "observer",
            "outbound",
            "pipeline",
            "record",
            "state",
            "time",
            "wire",
        ],
    ),
    ("status", &["config", "geo", "metrics", "navigator", "outbound", "pipeline", "sample", "time", "wire"]),
    (
        "replay",
        &[
            "config",
            "fault",
            "geo",
            "log",
            "metrics",
            "navigator",
            "outbound",
            "pipeline",
            "sample",
            "sim",
            "state",
            "time",
            "wire",
        ],
    ),
    ("export", &["files", "geo", "navigator", "replay", "sample", "time", "wire"]),
    ("fleet", &["files", "log", "replay"]),
    ("report", &["altimeter", "fleet", "geo", "metrics", "navigator", "replay", "sample", "time"]),
    (
        "daemon",
        &[
            "altimeter",
            "config",
            "geo",
            "metrics",
            "navigator",
            "outbound",
            "pipeline",
            "record",
            "sample",
            "state",
            "status",
            "time",
            "wire",
        ],
    ),
    ("preflight", &["config", "navigator", "outbound", "sample", "time", "wire"]),
    ("init", &["config", "preflight", "sample", "time", "wire"]),
    (
        "cli",
        &[
            "altimeter",
            "config",
            "daemon",
            "double",
            "export",
            "fault",
            "files",
            "fleet",
            "geo",
            "init",
            "log",
            "metrics",
            "navigator",
            "outbound",
            "pipeline",
            "preflight",
            "record",
            "replay",
            "report",
            "sample",
            "sim",
            "status",
            "time",
            "wire",
        ],
    ),
    ("main", &["cli"]),
    ("lib", &[]),
];

/// The rooms without input, output, clock or chance.
const CORE: &[&str] = &[
    "time",
    "geo",
    "sample",
    "camera",
    "altimeter",
    "observer",
    "filter",
    "landmark",
    "navigator",
    "outbound",
    "metrics",
    "sim",
    "double",
];

/// What no core room may name, and why.
const NOT_IN_THE_CORE: &[(&str, &str)] = &[
    ("tokio", "the core is synchronous"),
    ("Instant", "the core has no clock: every sample brings its time"),
    ("SystemTime", "the core has no clock: every sample brings its time"),
    ("std::fs", "the core has no input or output"),
    ("std::net", "the core has no input or output"),
    ("std::env", "the core is configured by its caller"),
    ("std::io", "the core has no input or output"),
    ("std::thread", "the core is synchronous"),
    ("std::process", "the core does not end the process"),
    ("tracing", "the core tells what happened by events"),
    ("HashMap", "its order changes from run to run: the same log has to give the same bytes"),
    ("HashSet", "its order changes from run to run: the same log has to give the same bytes"),
];

/// Only the simulation may throw dice, and only with a seed.
const RANDOM: &[&str] = &["rand", "rand_chacha", "rand_distr", "getrandom", "fastrand"];
const UNSEEDED: &[&str] = &["thread_rng", "from_os_rng", "from_entropy", "OsRng"];

const LONGEST_FILE: usize = 600;

struct Source {
    path: String,
    room: String,
    /// Names of the modules from the crate's root to this file.
    depth: usize,
    text: String,
    /// (line number, code without comments and without test modules)
    code: Vec<(usize, String)>,
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn files_in(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let mut out = Vec::new();
    let Ok(entries) = fs::read_dir(folder) else { return out };
    for entry in entries {
        let path = entry.unwrap().path();
        if path.is_dir() {
            out.extend(files_in(&path, extension));
        } else if path.extension().is_some_and(|e| e == extension) {
            out.push(path);
        }
    }
    out.sort();
    out
}

fn relative(path: &Path) -> String {
    path.strip_prefix(root()).unwrap().display().to_string().replace('\\', "/")
}

fn sources() -> Vec<Source> {
    let found: Vec<Source> = files_in(&root().join("src"), "rs").iter().map(|path| source(path)).collect();
    assert!(found.len() > 50, "only {} sources found", found.len());
    found
}

fn source(path: &Path) -> Source {
    let text = fs::read_to_string(path).unwrap();
    let name = relative(path);
    let mut modules: Vec<&str> = name.trim_start_matches("src/").trim_end_matches(".rs").split('/').collect();
    if modules.len() > 1 && modules.last() == Some(&"mod") {
        modules.pop();
    }
    let (room, depth) = (modules[0].to_owned(), modules.len());
    Source { code: code_of(&text), path: name, room, depth, text }
}

/// Code lines with their numbers: no comments, nothing between `#[cfg(test)] mod … {` and its end.
fn code_of(text: &str) -> Vec<(usize, String)> {
    let mut out = Vec::new();
    let (mut test_next, mut in_test) = (false, false);
    for (i, line) in text.lines().enumerate() {
        if in_test {
            in_test = line != "}";
            continue;
        }
        if line.trim() == "#[cfg(test)]" {
            test_next = true;
            continue;
        }
        if test_next && !line.trim_start().starts_with('#') {
            test_next = false;
            in_test = line.starts_with("mod ") && line.ends_with('{');
            continue;
        }
        let code = line.split("//").next().unwrap_or_default();
        if !code.trim().is_empty() {
            out.push((i + 1, code.to_owned()));
        }
    }
    out
}

fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// Whether `word` stands in `code` with no letter on either side.
fn names(code: &str, word: &str) -> bool {
    code.match_indices(word).any(|(at, _)| {
        let before = code[..at].chars().next_back().is_some_and(is_word);
        let after = code[at + word.len()..].chars().next().is_some_and(is_word);
        !before && !after
    })
}

/// The rooms that a line reaches: `crate::x`, `crate::{x, y::z}`, and `super::…` that climbs to the crate's root.
fn rooms_used(code: &str, depth: usize) -> Vec<String> {
    let climb = "super::".repeat(depth);
    let mut out = Vec::new();
    for (at, prefix) in
        code.match_indices("crate::").chain(code.match_indices(climb.as_str())).collect::<Vec<_>>()
    {
        if code[..at].chars().next_back().is_some_and(|c| is_word(c) || c == '$' || c == ':') {
            continue;
        }
        let rest = &code[at + prefix.len()..];
        let word = |s: &str| s.chars().take_while(|&c| is_word(c)).collect::<String>();
        match rest.strip_prefix('{') {
            None => out.push(word(rest)),
            Some(list) => {
                let (mut nested, mut item) = (0, String::new());
                for c in list.chars().chain([',']) {
                    match c {
                        '{' => nested += 1,
                        '}' if nested == 0 => break,
                        '}' => nested -= 1,
                        ',' if nested == 0 => out.push(word(std::mem::take(&mut item).trim())),
                        _ if nested == 0 => item.push(c),
                        _ => {}
                    }
                }
                out.push(word(item.trim()));
            }
        }
    }
    out.retain(|r| r.chars().next().is_some_and(|c| c.is_lowercase()));
    out
}

fn report(violations: &[String]) {
    assert!(violations.is_empty(), "{} violations:\n{}", violations.len(), violations.join("\n"));
}

#[test]
fn the_core_knows_no_input_output_clock_or_chance() {
    let mut violations = Vec::new();
    for s in sources().iter().filter(|s| CORE.contains(&s.room.as_str())) {
        for (line, code) in &s.code {
            for (word, why) in NOT_IN_THE_CORE.iter().filter(|(word, _)| names(code, word)) {
                violations.push(format!("{}:{line}: {word}: {why}", s.path));
            }
            if s.room != "sim"
                && let Some(word) = RANDOM.iter().find(|w| names(code, w))
            {
                violations.push(format!("{}:{line}: {word}: randomness belongs into sim", s.path));
            }
            if let Some(word) = UNSEEDED.iter().find(|w| names(code, w)) {
                violations.push(format!("{}:{line}: {word}: randomness has a seed", s.path));
            }
        }
    }
    report(&violations);
}

#[test]
fn only_wire_and_the_other_end_of_it_name_mavlink() {
    let mut violations = Vec::new();
    for s in sources().iter().filter(|s| !["wire", "double"].contains(&s.room.as_str())) {
        for (line, _) in s.code.iter().filter(|(_, code)| names(code, "mavlink")) {
            violations.push(format!("{}:{line}: mavlink: what is on the wire is known in wire only", s.path));
        }
    }
    report(&violations);
}

#[test]
fn rooms_use_only_the_rooms_below_them() {
    let mut violations = Vec::new();
    for s in &sources() {
        let Some((_, allowed)) = ROOMS.iter().find(|(room, _)| *room == s.room) else {
            violations.push(format!("{}:1: the room {} is not in the table of rooms", s.path, s.room));
            continue;
        };
        for (line, code) in &s.code {
            for used in rooms_used(code, s.depth) {
                if used != s.room && !allowed.contains(&used.as_str()) {
                    violations.push(format!("{}:{line}: {} may not use {used}", s.path, s.room));
                }
            }
        }
    }
    report(&violations);
}

#[test]
fn the_table_of_rooms_has_no_circles() {
    // Each room stands below those that use it, except that the table lists main and lib last.
    for (i, (room, uses)) in ROOMS.iter().enumerate() {
        for used in *uses {
            let at = ROOMS.iter().position(|(r, _)| r == used);
            assert!(
                at.is_some_and(|at| at < i),
                "{room} uses {used}, which does not stand above it in the table"
            );
        }
    }
}

/// The rows of the documentation's table of rooms: what a line "| `room` | what lives there | may use |" says of a room.
fn documented(text: &str) -> Vec<(String, Vec<String>)> {
    let words = |cell: &str| -> Vec<String> {
        cell.split([',', ' ', '`'])
            .map(|w| w.trim_end_matches('/'))
            .filter(|w| !w.is_empty())
            .map(str::to_owned)
            .collect()
    };
    text.lines()
        .filter(|line| line.starts_with("| `"))
        .filter_map(|line| {
            let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
            let [room, _, uses] = cells[..] else { return None };
            let mut uses = words(uses);
            uses.retain(|w| w != "–" && w != "-");
            uses.sort();
            Some((words(room).join(" "), uses))
        })
        .collect()
}

#[test]
fn the_documentation_draws_the_same_house() {
    let Ok(text) = fs::read_to_string(root().join("docs/src/architecture.md")) else { return };
    let told = documented(&text);
    let mut violations = Vec::new();
    for (room, uses) in ROOMS.iter().filter(|(room, _)| !["main", "lib"].contains(room)) {
        let mut uses: Vec<&str> = uses.to_vec();
        uses.sort_unstable();
        match told.iter().find(|(r, _)| r == room) {
            None => violations.push(format!("docs/src/architecture.md: no row of {room}")),
            Some((_, told)) if *told != uses => violations.push(format!(
                "docs/src/architecture.md: {room} may use {}, not {}",
                uses.join(", "),
                told.join(", ")
            )),
            Some(_) => {}
        }
    }
    for (room, _) in told.iter().filter(|(r, _)| !ROOMS.iter().any(|(room, _)| room == r)) {
        violations.push(format!("docs/src/architecture.md: there is no room {room}"));
    }
    report(&violations);
}

#[test]
fn every_file_says_what_it_is_and_is_short_enough_to_read() {
    let mut violations = Vec::new();
    for s in &sources() {
        if !s.text.starts_with("//! ") {
            violations.push(format!("{}:1: no module documentation", s.path));
        }
        let lines = s.text.lines().count();
        if lines > LONGEST_FILE {
            violations.push(format!("{}:{lines}: longer than {LONGEST_FILE} lines", s.path));
        }
    }
    for path in files_in(&root().join("tests"), "rs") {
        let lines = fs::read_to_string(&path).unwrap().lines().count();
        if lines > LONGEST_FILE {
            violations.push(format!("{}:{lines}: longer than {LONGEST_FILE} lines", relative(&path)));
        }
    }
    report(&violations);
}

#[test]
fn nothing_depends_on_one_machine() {
    // In pieces, so that this file passes its own test.
    let places: Vec<String> =
        ["work", "tmp", "root", "home"].iter().map(|folder| format!("{}{folder}{}", '/', '/')).collect();
    let mut violations = Vec::new();
    let mut paths: Vec<PathBuf> =
        ["src", "tests"].iter().flat_map(|d| files_in(&root().join(d), "rs")).collect();
    paths.extend(files_in(&root().join("config"), "toml"));
    paths.extend(["README.md", "sitl-logs/README.md", ".ci/run", "Cargo.toml"].map(|f| root().join(f)));
    for path in paths.iter().filter(|p| p.is_file()) {
        for (i, line) in fs::read_to_string(path).unwrap().lines().enumerate() {
            for place in places.iter().filter(|p| line.contains(p.as_str())) {
                violations.push(format!("{}:{}: {place} is a place on one machine", relative(path), i + 1));
            }
        }
    }
    report(&violations);
}

#[test]
fn the_rules_can_be_broken() {
    assert_eq!(rooms_used("use crate::wire::link;", 2), ["wire"]);
    assert_eq!(rooms_used("use crate::{geo::{so3, Wgs}, cli::Cli, time};", 2), ["geo", "cli", "time"]);
    assert_eq!(rooms_used("let x = super::super::daemon::go();", 2), ["daemon"]);
    assert_eq!(rooms_used("use super::daemon;", 1), ["daemon"]);
    assert_eq!(rooms_used("use super::daemon;", 2), Vec::<String>::new());
    assert!(names("use tokio::net;", "tokio") && !names("let tokios = 1;", "tokio"));
    let code = code_of("use a;\n// use tokio;\n#[cfg(test)]\nmod tests {\n    use rand;\n}\nuse b;\n");
    assert_eq!(code, [(1, "use a;".to_owned()), (7, "use b;".to_owned())]);
    let rows = documented(
        "| room | what | may use |\n|---|---|---|\n| `geo/` | Earth | `time`, sample |\n| `time` | stamps | – |\n",
    );
    let owned = |words: &[&str]| words.iter().map(|w| (*w).to_owned()).collect::<Vec<_>>();
    assert_eq!(rows, [("geo".to_owned(), owned(&["sample", "time"])), ("time".to_owned(), vec![])]);
}
