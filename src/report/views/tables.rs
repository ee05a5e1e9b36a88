//! The numbers.

use super::super::flight::FlightSheet;
use super::super::html::{number, table};
use crate::sample::SampleKind;

/// The tables.
pub(in super::super) fn view(sheet: &FlightSheet) -> String {
    let mut out = aided(sheet);
    if !sheet.outcome.outages.is_empty() {
        out.push_str(&outages(sheet));
    }
    out.push_str(&sources(sheet));
    if sheet.drift.iter().any(|m| m.times > 0) {
        out.push_str(&drift(sheet));
    }
    out
}

fn aided(sheet: &FlightSheet) -> String {
    let a = &sheet.outcome.aided;
    let row =
        |what: &str, value: Option<f64>, unit: &str| vec![what.to_owned(), number(value, 2), unit.to_owned()];
    let rows = [
        row("horizontal position", a.position_rmse_m, "m"),
        row("velocity", a.velocity_rmse_mps, "m/s"),
        row("altitude", a.altitude_rmse_m, "m"),
        row("roll", a.roll_rmse_deg, "deg"),
        row("pitch", a.pitch_rmse_deg, "deg"),
        row("yaw", a.yaw_rmse_deg, "deg"),
    ];
    let compared: Vec<Vec<String>> = rows.into_iter().filter(|r| r[1] != "–").collect();
    if compared.is_empty() {
        return "<p>With GNSS there was nothing to compare the solution with.</p>".to_owned();
    }
    format!(
        "<h3>With GNSS, root mean square against {}</h3>{}",
        sheet.against(),
        table(&["", "error", ""], &compared)
    )
}

fn outages(sheet: &FlightSheet) -> String {
    let rows: Vec<Vec<String>> = sheet
        .outcome
        .outages
        .iter()
        .map(|o| {
            vec![
                format!("{}..{}", o.start_s, o.end_s),
                number(o.distance_m, 0),
                number(o.horizontal_error_end_m, 1),
                number(o.horizontal_error_max_m, 1),
                number(o.drift_percent, 2),
                number(o.sigma_end_m, 1),
                number(o.worst_sigmas, 2),
                number(o.altitude_rmse_m, 2),
                number(o.lost_at_s, 1),
                o.sent_messages.to_string(),
            ]
        })
        .collect();
    let head = [
        "from..to s",
        "distance m",
        "error at end m",
        "largest m",
        "drift %",
        "sigma at end m",
        "largest error / sigma",
        "altitude, RMS m",
        "lost at s",
        "sent",
    ];
    format!("<h3>Outages, against {}</h3>{}", sheet.against(), table(&head, &rows))
}

fn sources(sheet: &FlightSheet) -> String {
    let rows: Vec<Vec<String>> = sheet
        .sources
        .iter()
        .map(|s| {
            let why: Vec<String> = s.rejected.iter().map(|(reason, n)| format!("{n} {reason}")).collect();
            let health = s.charge.map_or_else(
                || s.health.label().to_owned(),
                |charge| format!("{}: {}", s.health.label(), charge.label()),
            );
            vec![
                format!("{} {}", s.kind.label(), s.id),
                health,
                s.used.to_string(),
                s.fused.to_string(),
                s.gated.to_string(),
                number(s.nis_mean, 2),
                number(s.test_ratio, 2),
                why.join(", "),
            ]
        })
        .collect();
    let silent: Vec<&str> = SampleKind::ALL
        .iter()
        .filter(|kind| sheet.outcome.heard[**kind as usize] == 0)
        .map(|kind| kind.label())
        .collect();
    let head = ["source", "health", "used", "fused", "gated", "NIS", "test ratio", "rejected"];
    let silent =
        if silent.is_empty() { String::new() } else { format!("<p>Never heard: {}.</p>", silent.join(", ")) };
    format!("<h3>Sources, at the end</h3>{}{silent}", table(&head, &rows))
}

fn drift(sheet: &FlightSheet) -> String {
    let rows: Vec<Vec<String>> = sheet
        .drift
        .iter()
        .map(|m| {
            vec![
                m.source.label().to_owned(),
                number(Some(m.after_s), 0),
                number(m.error_m, 1),
                m.times.to_string(),
                number(Some(m.factor), 2),
            ]
        })
        .collect();
    let head = ["carried by", "after s", "error, RMS m", "times", "sigma times"];
    format!("<h3>Without GNSS, measured beside it</h3>{}", table(&head, &rows))
}
