//! The crates that are built into the program, with their licences and what these want said: THIRD-PARTY.md.
//!
//! ```sh
//! cargo run --release --example third_party             # writes it
//! cargo run --release --example third_party -- --check  # fails where it is not as the lock file says
//! ```
//!
//! Of a crate that may be had under Apache-2.0 that licence is taken, whose text stands in LICENSE-APACHE. Of the others the texts that they bring
//! are copied, each once.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, ensure};
use serde_json::Value;

const FILE: &str = "THIRD-PARTY.md";
/// Systems that companions run; what only others need is left out.
const TARGETS: [&str; 2] = ["x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu"];

/// A crate.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Dependency {
    name: String,
    version: String,
    licence: String,
    repository: String,
    folder: String,
}

fn main() -> Result<()> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut all = BTreeSet::new();
    for target in TARGETS {
        all.extend(dependencies(root, target)?);
    }
    let text = document(&all)?;
    let path = root.join(FILE);
    if std::env::args().any(|a| a == "--check") {
        let written = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        ensure!(
            written == text,
            "{FILE} is not as the lock file says: cargo run --release --example third_party"
        );
    } else {
        fs::write(&path, text).with_context(|| path.display().to_string())?;
    }
    Ok(())
}

/// What is built into the program for a target: neither tools of the build nor of tests.
fn dependencies(root: &Path, target: &str) -> Result<BTreeSet<Dependency>> {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    let output = Command::new(cargo)
        .args(["metadata", "--format-version=1", "--locked", "--all-features", "--filter-platform", target])
        .current_dir(root)
        .output()?;
    ensure!(output.status.success(), "cargo metadata: {}", String::from_utf8_lossy(&output.stderr));
    let all: Value = serde_json::from_slice(&output.stdout)?;
    let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let nodes: BTreeMap<String, Value> =
        list(&all["resolve"]["nodes"]).into_iter().map(|n| (text(&n["id"]), n)).collect();
    let mut waiting = vec![text(&all["resolve"]["root"])];
    let mut reached = BTreeSet::new();
    while let Some(id) = waiting.pop() {
        if !reached.insert(id.clone()) {
            continue;
        }
        for dependency in list(&nodes[&id]["deps"]) {
            if list(&dependency["dep_kinds"]).iter().any(|k| k["kind"].is_null()) {
                waiting.push(text(&dependency["pkg"]));
            }
        }
    }
    let of = |p: &Value| Dependency {
        name: text(&p["name"]),
        version: text(&p["version"]),
        licence: text(&p["license"]).replace('/', " OR ").replace("  ", " "),
        repository: text(&p["repository"]),
        folder: text(&p["manifest_path"]).trim_end_matches("Cargo.toml").to_owned(),
    };
    let packages = list(&all["packages"]);
    let built_in = packages.iter().filter(|p| reached.contains(&text(&p["id"])) && !p["source"].is_null());
    Ok(built_in.map(of).collect())
}

fn document(all: &BTreeSet<Dependency>) -> Result<String> {
    let mut out = String::from(
        "# Third-party software\n\nWhat is built into `holdover`, for Linux on x86-64 and ARM. Written by `cargo run --release --example third_party`.\n\n\
         Crates that may be had under Apache-2.0 are taken under it ([LICENSE-APACHE](LICENSE-APACHE)); the texts of the others follow the table.\n\n\
         | crate | version | licence | source |\n|---|---|---|---|\n",
    );
    // By text: which crates bring it.
    let mut texts: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for d in all {
        writeln!(out, "| {} | {} | {} | {} |", d.name, d.version, d.licence, d.repository)?;
        if d.licence.contains("Apache-2.0") {
            continue;
        }
        let brought = licence_texts(Path::new(&d.folder))?;
        ensure!(
            !brought.is_empty() || !d.licence.is_empty(),
            "{} has neither a licence nor a text of one",
            d.name
        );
        for text in brought {
            texts.entry(text).or_default().push(&d.name);
        }
    }
    for (text, crates) in texts {
        write!(out, "\n## {}\n\n```text\n{}\n```\n", crates.join(", "), text.trim())?;
    }
    Ok(out)
}

/// The texts of a crate's licence files.
fn licence_texts(folder: &Path) -> Result<BTreeSet<String>> {
    let mut texts = BTreeSet::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().map(|n| n.to_string_lossy().to_lowercase()).unwrap_or_default();
        if path.is_file() && ["licen", "copying", "notice"].iter().any(|start| name.starts_with(start)) {
            let text = fs::read_to_string(&path)?;
            texts.insert(text.lines().map(str::trim_end).collect::<Vec<_>>().join("\n"));
        }
    }
    Ok(texts)
}
