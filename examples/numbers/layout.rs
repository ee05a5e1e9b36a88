//! How each table is made of what its command prints.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use holdover::navigator::event_codes::{EVENTS, EventCode};
use serde_json::Value;

/// A table that some document has between markers.
pub struct Table {
    name: &'static str,
    layout: Layout,
    /// What `--check` replaces in the command so that it ends soon; then the header and the rows alone are compared.
    pub quick: &'static [(&'static str, &'static str)],
}

/// What is done with the output.
enum Layout {
    /// Shown as it is, but for lines that are left out.
    Lines(fn(&str) -> bool),
    /// The parts under these headlines.
    Sections(&'static [&'static str]),
    /// The events, from the list in the code: no command is run.
    Events,
    /// A Markdown table; rows of flights that are not here are kept.
    Flights(fn(&[Value], &Kept) -> Vec<Vec<String>>),
    /// A Markdown table without its header, of JSON objects one after the other.
    Json(fn(&[Value]) -> Vec<Vec<String>>),
    /// A picture: the output is the file that the text between the markers links to.
    Picture,
}

/// Cells of the rows that stand, by flight and length.
type Kept = BTreeMap<(String, String), Vec<String>>;

const TABLES: &[Table] = &[
    Table { name: "picture", layout: Layout::Picture, quick: &[] },
    Table {
        name: "first_replay",
        layout: Layout::Lines(|line| !line.contains("times real time")),
        quick: &[],
    },
    Table { name: "what_happened", layout: Layout::Sections(&["What happened", "Outages, "]), quick: &[] },
    Table { name: "events", layout: Layout::Events, quick: &[] },
    Table { name: "evaluate", layout: Layout::Lines(|_| true), quick: &[] },
    Table {
        name: "stress",
        layout: Layout::Lines(|line| !line.contains(": not in it: ")),
        quick: &[("--starts 3", "--starts 1")],
    },
    Table { name: "true_sigmas", layout: Layout::Flights(true_sigmas), quick: &[] },
    Table { name: "recordings", layout: Layout::Flights(recordings), quick: &[] },
    Table { name: "recordings_without_flow", layout: Layout::Flights(without_flow), quick: &[] },
    Table { name: "aided", layout: Layout::Json(aided), quick: &[] },
    Table { name: "glitches", layout: Layout::Sections(&["What happened"]), quick: &[] },
    Table { name: "hour_over_markers", layout: Layout::Sections(&["Outages, "]), quick: &[] },
    Table { name: "hour_without_markers", layout: Layout::Sections(&["Outages, "]), quick: &[] },
    Table { name: "flow_solve", layout: Layout::Lines(|_| true), quick: &[] },
    Table { name: "altimeter_flights", layout: Layout::Lines(|_| true), quick: &[] },
    Table { name: "altimeter_flights_real", layout: Layout::Flights(heights), quick: &[] },
    Table {
        name: "paper_altimeter_rms",
        layout: Layout::Json(altimeter_rms),
        quick: &[("--runs 300", "--runs 3")],
    },
    Table {
        name: "paper_altimeter_beyond",
        layout: Layout::Lines(beyond_the_paper),
        quick: &[("--runs 300", "--runs 3")],
    },
    Table { name: "paper_dead_reckoning", layout: Layout::Lines(|_| true), quick: &[("1..10", "1..1")] },
    Table {
        name: "paper_observers",
        layout: Layout::Lines(|_| true),
        quick: &[("1..10 --starts 60", "1..1 --starts 2")],
    },
    Table {
        name: "paper_landmarks",
        layout: Layout::Lines(three_percent_wrong),
        quick: &[("--seeds 24", "--seeds 1")],
    },
];

impl Table {
    /// The table of this name.
    pub fn named(name: &str) -> Option<&'static Table> {
        TABLES.iter().find(|t| t.name == name)
    }

    /// Whether it is made of what its command prints.
    pub fn has_command(&self) -> bool {
        !matches!(self.layout, Layout::Events)
    }

    /// The flights of the rows that stand.
    pub fn flights(&self, body: &str) -> Vec<String> {
        let mut flights: Vec<String> = kept(body).into_keys().map(|(flight, _)| flight).collect();
        flights.dedup();
        flights
    }

    /// The text between the markers, of what the command printed and what stands there.
    ///
    /// # Errors
    /// What is wrong with the output.
    pub fn body(&self, command: &str, output: &str, old: &str, picture: Picture) -> Result<String, String> {
        let shown = format!("```sh\n{}\n```\n\n", command.replace(" && ", "\n"));
        let text =
            |lines: Vec<&str>| format!("{shown}```text\n{}\n```\n", lines.join("\n").trim_matches('\n'));
        Ok(match self.layout {
            Layout::Lines(keep) => text(output.lines().filter(|l| keep(l)).collect()),
            Layout::Sections(headlines) => {
                let mut lines = Vec::new();
                for headline in headlines {
                    let section = section(output, headline);
                    if section.is_empty() {
                        return Err(format!("nothing begins with \"{headline}\""));
                    }
                    lines.extend(section);
                    lines.push("");
                }
                text(lines)
            }
            Layout::Events => events(),
            Layout::Flights(rows) => {
                let mut all = kept(old);
                for row in rows(&objects(output)?, &kept(old)) {
                    all.insert(key(&row), row);
                }
                format!("{shown}{}", with_rows(old, in_order(old, all))?)
            }
            Layout::Json(rows) => format!("{shown}{}", with_rows(old, rows(&objects(output)?))?),
            Layout::Picture => {
                picture.take(output, old)?;
                old.to_owned()
            }
        })
    }
}

/// What becomes of a picture.
#[derive(Clone, Copy)]
pub enum Picture<'a> {
    /// It is written, relative to this folder.
    Write(&'a Path),
    /// It is compared with the file there.
    Compare(&'a Path),
}

impl Picture<'_> {
    fn take(self, svg: &str, link: &str) -> Result<(), String> {
        let (Picture::Write(folder) | Picture::Compare(folder)) = self;
        let (_, rest) = link.split_once("](").ok_or("no link to a picture")?;
        let (path, _) = rest.split_once(')').ok_or("no link to a picture")?;
        let path = folder.join(path);
        let named = |e: std::io::Error| format!("{}: {e}", path.display());
        match self {
            Picture::Write(_) => fs::write(&path, svg).map_err(named),
            Picture::Compare(_) => {
                let stands = fs::read_to_string(&path).map_err(named)?;
                super::compare::difference(&stands, svg, true)
                    .map_or(Ok(()), |what| Err(format!("stale picture: {what}")))
            }
        }
    }
}

fn events() -> String {
    let row = |e: &EventCode| format!("| `{}` | {} | {} |\n", e.code, e.meaning, e.advice);
    format!(
        "| code | what it means | what to do |\n|---|---|---|\n{}",
        EVENTS.iter().map(row).collect::<String>()
    )
}

/// From a line that begins with the headline to the next empty one.
fn section<'a>(output: &'a str, headline: &str) -> Vec<&'a str> {
    output.lines().skip_while(|l| !l.starts_with(headline)).take_while(|l| !l.is_empty()).collect()
}

fn objects(output: &str) -> Result<Vec<Value>, String> {
    let values: Result<Vec<Value>, _> = serde_json::Deserializer::from_str(output).into_iter().collect();
    values.map_err(|e| e.to_string())
}

fn cells(line: &str) -> Vec<String> {
    line.trim().trim_matches('|').split('|').map(|c| c.trim().to_owned()).collect()
}

fn key(row: &[String]) -> (String, String) {
    let cell = |i: usize| row.get(i).cloned().unwrap_or_default();
    (cell(0), cell(1))
}

/// Lines of the table: header, rule, rows.
fn table_lines(body: &str) -> Vec<&str> {
    body.lines().filter(|l| l.starts_with('|')).collect()
}

fn kept(body: &str) -> Kept {
    table_lines(body).into_iter().skip(2).map(cells).map(|row| (key(&row), row)).collect()
}

/// Rows in the order in which they stand.
fn in_order(body: &str, mut all: Kept) -> Vec<Vec<String>> {
    let standing = table_lines(body).into_iter().skip(2).map(|l| key(&cells(l)));
    let mut rows: Vec<Vec<String>> = standing.filter_map(|k| all.remove(&k)).collect();
    rows.extend(all.into_values());
    rows
}

/// The header that stands, over these rows.
fn with_rows(body: &str, rows: Vec<Vec<String>>) -> Result<String, String> {
    let lines = table_lines(body);
    let [header, rule, ..] = lines[..] else { return Err("the table has no header".into()) };
    let columns = cells(header).len();
    if let Some(row) = rows.iter().find(|r| r.len() != columns) {
        return Err(format!("{} columns in the header, {} in a row", columns, row.len()));
    }
    let line = |row: Vec<String>| format!("| {} |\n", row.join(" | ")).replace("|  |", "| |");
    Ok(format!("{header}\n{rule}\n{}", rows.into_iter().map(line).collect::<String>()))
}

fn name(log: &Value) -> String {
    let path = Path::new(log.as_str().unwrap_or_default());
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn number(v: &Value, decimals: usize) -> String {
    v.as_f64().map_or("-".to_owned(), |v| format!("{v:.decimals$}"))
}

/// Metres with three figures.
fn metres(v: f64) -> String {
    if v < 99.95 { format!("{v:.1}") } else { format!("{v:.0}") }
}

fn median(mut v: Vec<f64>) -> Option<f64> {
    v.sort_by(f64::total_cmp);
    let n = v.len();
    (n > 0).then(|| 0.5 * (v[(n - 1) / 2] + v[n / 2]))
}

/// flight, s, EKF2 (as it stands), shipped, drift and error/sigma of shipped, then the other estimators that the table has.
fn recordings(objects: &[Value], kept: &Kept) -> Vec<Vec<String>> {
    let rows: Vec<&Value> = objects.iter().filter_map(|o| o["rows"].as_array()).flatten().collect();
    let groups: BTreeMap<(String, u64), ()> =
        rows.iter().map(|r| ((name(&r["log"]), r["length_s"].as_f64().unwrap_or(0.0) as u64), ())).collect();
    let of = |flight: &str, length: u64, estimator: &str| -> Vec<&Value> {
        let is = |r: &&&Value| {
            name(&r["log"]) == flight
                && r["length_s"].as_f64() == Some(length as f64)
                && r["estimator"] == estimator
        };
        rows.iter().filter(is).copied().collect()
    };
    let errors = |group: &[&Value]| -> String {
        let errors: Vec<f64> = group.iter().filter_map(|r| r["horizontal_error_end_m"].as_f64()).collect();
        let worst = errors.iter().copied().fold(0.0, f64::max);
        median(errors).map_or(String::new(), |m| format!("{} / {}", metres(m), metres(worst)))
    };
    let row = |(flight, length): (String, u64)| {
        let stands = kept.get(&(flight.clone(), length.to_string()));
        let shipped = of(&flight, length, "shipped");
        let drift = median(shipped.iter().filter_map(|r| r["drift_percent"].as_f64()).collect());
        let ratio = |r: &&Value| Some(r["horizontal_error_end_m"].as_f64()? / r["sigma_end_m"].as_f64()?);
        let ratio = median(shipped.iter().filter_map(ratio).collect());
        let quality = drift.zip(ratio).map_or(String::new(), |(d, r)| format!("{d:.2}; {r:.2}"));
        let peer = stands.and_then(|row| row.get(2)).cloned().unwrap_or_default();
        let mut out = vec![flight.clone(), length.to_string(), peer, errors(&shipped), quality];
        out.extend(["xkf", "nlo", "ekf15", "inertial"].map(|e| errors(&of(&flight, length, e))));
        out
    };
    // Lengths that the flight is too short for have no row.
    groups.into_keys().map(row).filter(|row| !row[3].is_empty()).collect()
}

/// The same without other estimators.
fn without_flow(objects: &[Value], kept: &Kept) -> Vec<Vec<String>> {
    let mut rows = recordings(objects, kept);
    rows.iter_mut().for_each(|row| row.truncate(5));
    rows
}

/// flight, build, outages, parts of the errors within two and four sigmas, root mean square of error over sigma. What another build measured
/// stays.
fn true_sigmas(objects: &[Value], _: &Kept) -> Vec<Vec<String>> {
    let mut flights: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for r in objects.iter().filter_map(|o| o["rows"].as_array()).flatten() {
        let (error, sigma) = (r["horizontal_error_end_m"].as_f64(), r["sigma_end_m"].as_f64());
        if let Some((error, sigma)) = error.zip(sigma).filter(|(_, sigma)| *sigma > 0.0) {
            flights.entry(name(&r["log"])).or_default().push(error / sigma);
        }
    }
    let row = |(flight, ratios): (String, Vec<f64>)| {
        let n = ratios.len() as f64;
        let within = |k: f64| format!("{:.0}", 100.0 * ratios.iter().filter(|r| **r <= k).count() as f64 / n);
        let rms = (ratios.iter().map(|r| r * r).sum::<f64>() / n).sqrt();
        vec![flight, "now".to_owned(), format!("{n}"), within(2.0), within(4.0), format!("{rms:.2}")]
    };
    flights.into_iter().map(row).collect()
}

fn heights(objects: &[Value], _: &Kept) -> Vec<Vec<String>> {
    let rows = objects.iter().filter_map(|o| o["rows"].as_array()).flatten();
    rows.map(|r| {
        vec![
            name(&r["log"]),
            r["filter"].as_str().unwrap_or_default().to_owned(),
            r["reference"].as_str().unwrap_or("-").to_owned(),
            number(&r["altitude_rmse_m"], 2),
            number(&r["altitude_max_m"], 2),
            number(&r["largest_step_m"], 3),
            number(&r["within_2_sigma_percent"], 0),
            r["resets"].to_string(),
        ]
    })
    .collect()
}

fn aided(objects: &[Value]) -> Vec<Vec<String>> {
    let row = |o: &Value| {
        let a = &o["aided"];
        let angles = ["roll", "pitch", "yaw"].map(|n| number(&a[format!("{n}_rmse_deg")], 2));
        vec![
            name(&o["log"]),
            number(&a["position_rmse_m"], 2),
            number(&a["velocity_rmse_mps"], 2),
            number(&a["altitude_rmse_m"], 2),
            angles.join(" / "),
        ]
    };
    objects.iter().map(row).collect()
}

/// Bias and variance, filter, then the root mean square of the fused altitude in the paper's cases 0 to 5.
fn altimeter_rms(objects: &[Value]) -> Vec<Vec<String>> {
    let mut out = Vec::new();
    for object in objects {
        let rows: Vec<&Value> =
            object["rows"].as_array().into_iter().flatten().filter(|r| r["scheme"] == "ibig").collect();
        let mut filters: Vec<&str> = Vec::new();
        for filter in rows.iter().filter_map(|r| r["filter"].as_str()) {
            if !filters.contains(&filter) {
                filters.push(filter);
            }
        }
        for filter in filters {
            let of_case = |case: &str| rows.iter().find(|r| r["filter"] == filter && r["case"] == case);
            let size = &rows[0];
            let mut row = vec![
                format!("{} m, × {}", number(&size["bias_m"], 0), number(&size["variance_factor"], 0)),
                if filter == "default" { "**default**".to_owned() } else { filter.to_owned() },
            ];
            row.extend(
                ["0", "1", "2", "3", "4", "5"]
                    .map(|c| of_case(c).map_or("-".into(), |r| number(&r["rms_m"], 2))),
            );
            out.push(row);
        }
    }
    out
}

/// The header, and rows of cases that the paper does not have: the optimal filter, the default one and the oracle, fused.
fn beyond_the_paper(line: &str) -> bool {
    let words: Vec<&str> = line.split_whitespace().collect();
    let fused = words.contains(&"ibig") && ["okf", "default", "oracle"].iter().any(|f| words.contains(f));
    let case = words.first().is_some_and(|w| w.starts_with(|c: char| c.is_ascii_alphabetic()));
    words.first() == Some(&"case") || (fused && case)
}

/// Of the rows with another share of wrong ids than 3 %, none.
fn three_percent_wrong(line: &str) -> bool {
    let words: Vec<&str> = line.split_whitespace().collect();
    words.len() < 7 || words[0] != "moving" || words[3] == "0.03"
}
