//! Writes the tables of numbers into the README and the book, each between its markers, with the command that the marker names.
//!
//! `cargo run --release --example numbers [-- NAME…]` writes all tables, or those that are named.
//! `cargo run --release --example numbers -- --check` writes nothing and fails where a table is stale: where its command is missing, its
//! header or rows are not what the command prints now, or a value differs by more than what is printed.
//!
//! `LOGS` in a command stands for those of the table's flights that lie in `sitl-logs/` or in the folder that the environment variable
//! `HOLDOVER_FLIGHT_LOGS` names. Rows of flights that lie in neither are left as they are, and the command says so.
//!
//! `--check` runs the slow Monte Carlos with few seeds, and compares their headers and rows alone.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

use clap::Parser;

mod compare;
mod layout;
mod markers;

use layout::{Picture, Table};
use markers::{Marker, markers};

#[derive(Parser)]
#[command(about = "Writes the tables of numbers into the README and the book")]
struct Args {
    /// Which tables; all when none is named
    names: Vec<String>,
    /// Compare instead of writing
    #[arg(long)]
    check: bool,
}

/// One document with what was found in it.
struct Document {
    path: PathBuf,
    text: String,
    markers: Vec<Marker>,
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn documents() -> Result<Vec<Document>, String> {
    let mut paths = vec![root().join("README.md")];
    let pages = fs::read_dir(root().join("docs/src")).map_err(|e| format!("docs/src: {e}"))?;
    paths.extend(
        pages.filter_map(|p| Some(p.ok()?.path())).filter(|p| p.extension().is_some_and(|e| e == "md")),
    );
    paths[1..].sort();
    let read = |path: PathBuf| {
        let named = |e: String| format!("{}: {e}", path.display());
        let text = fs::read_to_string(&path).map_err(|e| named(e.to_string()))?;
        let markers = markers(&text).map_err(named)?;
        Ok(Document { path, text, markers })
    };
    paths.into_iter().map(read).collect()
}

/// Where a flight's log lies on this machine.
fn log_of(flight: &str) -> Option<PathBuf> {
    let folders =
        [Some(root().join("sitl-logs")), std::env::var_os("HOLDOVER_FLIGHT_LOGS").map(PathBuf::from)];
    folders.into_iter().flatten().map(|f| f.join(format!("{flight}.tlog"))).find(|p| p.is_file())
}

/// What a command prints on standard output.
fn output(command: &str) -> Result<String, String> {
    let done = Command::new("sh")
        .args(["-c", command])
        // To holdover it would be a setting, and an unknown one.
        .env_remove("HOLDOVER_FLIGHT_LOGS")
        .current_dir(root())
        .stderr(Stdio::piped())
        .output()
        .map_err(|e| format!("sh: {e}"))?;
    if !done.status.success() {
        let said = String::from_utf8_lossy(&done.stderr);
        let last: Vec<&str> = said.lines().rev().take(3).collect();
        return Err(format!(
            "{command}\n  {}: {}",
            done.status,
            last.into_iter().rev().collect::<Vec<_>>().join("\n  ")
        ));
    }
    String::from_utf8(done.stdout).map_err(|e| e.to_string())
}

/// The command with `LOGS` filled in; `None` where the machine has none of the table's flights.
fn filled_in(marker: &Marker, body: &str, table: &Table) -> Option<String> {
    if !marker.command.contains("LOGS") {
        return Some(marker.command.clone());
    }
    let flights = table.flights(body);
    let (here, away): (Vec<_>, Vec<_>) =
        flights.into_iter().map(|f| (log_of(&f), f)).partition(|(p, _)| p.is_some());
    if !away.is_empty() {
        let names: Vec<String> = away.into_iter().map(|(_, f)| f).collect();
        eprintln!("{}: left as they are, the logs are not here: {}", marker.name, names.join(", "));
    }
    let logs: Vec<String> =
        here.iter().filter_map(|(p, _)| Some(p.as_ref()?.display().to_string())).collect();
    (!logs.is_empty()).then(|| marker.command.replace("LOGS", &logs.join(" ")))
}

/// The new text of a marker; `None` where nothing can be said here.
fn renewed(marker: &Marker, page: &Path, body: &str, check: bool) -> Result<Option<(String, bool)>, String> {
    let table = Table::named(&marker.name).ok_or("no table has this name")?;
    let Some(mut command) = filled_in(marker, body, table) else { return Ok(None) };
    let mut exact = true;
    if check {
        for (slow, quick) in table.quick {
            if !command.contains(slow) {
                return Err(format!("\"{slow}\" does not stand in its command"));
            }
            command = command.replace(slow, quick);
            exact = false;
        }
    }
    let printed = if table.has_command() { output(&command)? } else { String::new() };
    let folder = page.parent().unwrap_or(page);
    let picture = if check { Picture::Compare(folder) } else { Picture::Write(folder) };
    let text = table.body(&marker.command, &printed, body, picture)?;
    Ok(Some((text, exact)))
}

/// Puts `new` between the markers, in the document as it is now: the command may have taken minutes.
fn write(document: &Document, marker: &Marker, new: &str) -> Result<(), String> {
    let mut text = fs::read_to_string(&document.path).map_err(|e| e.to_string())?;
    let now = markers(&text)?.into_iter().find(|m| m.name == marker.name && m.command == marker.command);
    text.replace_range(now.ok_or("the marker is gone")?.body, new);
    fs::write(&document.path, text).map_err(|e| e.to_string())
}

/// Writes or compares one table. Whether it is stale.
fn one(document: &Document, marker: &Marker, place: &str, check: bool) -> Result<bool, String> {
    let old = &document.text[marker.body.clone()];
    let Some((new, exact)) = renewed(marker, &document.path, old, check)? else {
        eprintln!("{place}: left as it is");
        return Ok(false);
    };
    if !check {
        write(document, marker, &new)?;
        eprintln!("{place}: {}", if new == old { "as it was" } else { "written" });
    } else if let Some(what) = compare::difference(old, &new, exact) {
        eprintln!("{place}: stale: {what}");
        return Ok(true);
    } else {
        eprintln!("{place}: {}", if exact { "agrees" } else { "has its header and rows" });
    }
    Ok(false)
}

fn run(args: &Args) -> Result<usize, String> {
    let mut stale = 0;
    let mut known: Vec<String> = Vec::new();
    for document in documents()? {
        let page = document.path.strip_prefix(root()).unwrap_or(&document.path).display().to_string();
        for marker in &document.markers {
            known.push(marker.name.clone());
            if args.names.is_empty() || args.names.contains(&marker.name) {
                let place = format!("{page}:{}: {}", marker.line, marker.name);
                stale += usize::from(
                    one(&document, marker, &place, args.check).map_err(|e| format!("{place}: {e}"))?,
                );
            }
        }
    }
    match args.names.iter().find(|n| !known.contains(n)) {
        Some(unknown) => Err(format!("no document has the table \"{unknown}\"")),
        None => Ok(stale),
    }
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(0) => ExitCode::SUCCESS,
        Ok(stale) => {
            eprintln!("{stale} stale; `cargo run --release --example numbers` writes them");
            ExitCode::FAILURE
        }
        Err(what) => {
            eprintln!("numbers: {what}");
            ExitCode::FAILURE
        }
    }
}
