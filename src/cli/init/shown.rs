//! What `init` says.

use std::path::Path;

use serde_json::{Value, json};

use crate::cli::preflight::{print_findings, to_json as preflight_json};
use crate::init::fitting::next_steps;
use crate::init::survey::vehicle_word;
use crate::init::verdict::{SensorVerdict, verdicts};
use crate::preflight::Needs;
use crate::preflight::outlook::outlook;
use crate::wire::counters::Cause;
use crate::wire::link::{LinkEventKind, LinkStats};

use super::{Failure, InitFindings};

/// A link in numbers.
struct LinkWord {
    endpoint: String,
    frames: u64,
    damaged: u64,
    lost: u64,
}

impl LinkWord {
    fn of(stats: &LinkStats) -> Self {
        Self {
            endpoint: stats.endpoint.to_string(),
            frames: stats.frames_in,
            damaged: stats.rejects.of(Cause::BadChecksum),
            lost: stats.lost_frames(),
        }
    }
}

/// What else is to be said of the link.
fn remarks(found: &InitFindings) -> Vec<String> {
    let mut out = Vec::new();
    let survey = &found.survey;
    if survey.mavlink1 > 0 {
        out.push(format!("{} of {} frames are MAVLink 1", survey.mavlink1, survey.frames));
    }
    match (survey.signed, found.settings.signing.key_file.is_some()) {
        (0, _) => out.push("frames are not signed: whoever reaches the link is believed".to_owned()),
        (n, true) => out.push(format!("{n} of {} frames are signed, with our key", survey.frames)),
        (n, false) => out.push(format!("{n} of {} frames are signed, and there is no key", survey.frames)),
    }
    for event in &found.conversed.events {
        let told =
            matches!(event.kind, LinkEventKind::RivalsHeard { .. } | LinkEventKind::StrangerIgnored { .. });
        if told {
            out.push(event.kind.to_string());
        }
    }
    out
}

/// One object with everything.
///
/// # Errors
/// As the draft's text.
pub(super) fn to_json(found: &InitFindings, out: &Path, text: &str) -> Result<Value, Failure> {
    let needs = Needs::of(&found.settings, None);
    let link = |l: &LinkStats| {
        let w = LinkWord::of(l);
        json!({"endpoint": w.endpoint, "frames": w.frames, "damaged": w.damaged, "lost": w.lost})
    };
    let differs = found.draft.differing().map_err(Failure::Config)?;
    let differs: serde_json::Map<String, Value> =
        differs.into_iter().map(|(entry, _)| (entry.path(), entry.value)).collect();
    let looked_at: Vec<String> = found.chosen.looked_at.iter().map(ToString::to_string).collect();
    Ok(json!({
        "written": out.display().to_string(),
        "differs": differs,
        "configuration": text,
        "looked_at": looked_at,
        "links": found.conversed.links.iter().map(link).collect::<Vec<_>>(),
        "signed_frames": found.survey.signed,
        "speakers": found.survey.words(),
        "sensors": verdicts(&found.survey, &found.report.readings),
        "remarks": remarks(found),
        "preflight": preflight_json(&found.report, &needs),
    }))
}

/// The same for people.
///
/// # Errors
/// As the draft's text.
pub(super) fn print(found: &InitFindings, out: &Path, text: &str) -> Result<(), Failure> {
    for looked in &found.chosen.looked_at {
        outln!("{looked}");
    }
    let readings = &found.report.readings;
    let vehicle = &readings.vehicle;
    let version = vehicle.version.map_or("of unknown version".to_owned(), |v| v.to_string());
    outln!(
        "{} {version}, {}, system {}, component {}, {}",
        vehicle.autopilot,
        vehicle_word(vehicle.vehicle_type),
        vehicle.system.0,
        vehicle.component.0,
        if vehicle.armed { "armed" } else { "disarmed" }
    );
    let own = (vehicle.system.0, vehicle.component.0);
    for word in found.survey.words().iter().filter(|w| (w.system, w.component) != own) {
        outln!("  beside it: {word}");
    }
    for link in found.conversed.links.iter().map(LinkWord::of) {
        outln!("  {}: {} frames, {} damaged, {} lost", link.endpoint, link.frames, link.damaged, link.lost);
    }
    for remark in remarks(found) {
        outln!("  {remark}");
    }
    print_sensors(&verdicts(&found.survey, readings));
    print_findings(&found.report.findings);
    if !found.report.answers_parameters {
        outln!(
            "\nThe autopilot answers no question for a parameter: what it has to be set to was not checked."
        );
    }
    outln!("\nAfter a loss of GNSS");
    outln!("  {}", outlook(readings, &Needs::of(&found.settings, None)).text);
    outln!("\n{}", out.display());
    for line in text.lines() {
        outln!("{}", format!("  {line}").trim_end());
    }
    outln!("\nNext");
    for step in next_steps(&out.display().to_string(), vehicle.autopilot, found.report.faults()) {
        outln!("  {step}");
    }
    Ok(())
}

fn print_sensors(sensors: &[SensorVerdict]) {
    outln!("\nSensors");
    let row = |s: &SensorVerdict| {
        let what = match (s.message, &s.remark) {
            (Some(message), remark) => {
                let by = s.component.map(|c| format!(" of component {c}")).unwrap_or_default();
                let tells = s.tells.as_ref().map(|t| format!(": {t}")).unwrap_or_default();
                let remark = remark.as_ref().map(|r| format!("; {r}")).unwrap_or_default();
                format!("{:6.1} Hz  {message}{by}{tells}{remark}", s.rate_hz)
            }
            (None, remark) => remark.clone().unwrap_or_default(),
        };
        [s.sensor.clone(), s.grade.label().to_owned(), what]
    };
    let rows: Vec<[String; 3]> = sensors.iter().map(row).collect();
    let width = rows.iter().map(|[sensor, ..]| sensor.chars().count()).max().unwrap_or(0);
    for [sensor, grade, what] in rows {
        outln!("  {sensor:<width$}  {grade}  {what}");
    }
}
