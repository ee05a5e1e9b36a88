//! The flight in some numbers.

use std::fmt::Write;

use super::super::flight::FlightSheet;
use super::super::html::{duration, escaped, number, short};
use super::super::palette::Tone;
use crate::navigator::shadow::MeasuredDrift;
use crate::navigator::solution::Mode;
use crate::navigator::sources::status::SourceHealth;

/// A number that is at once to be seen, what it is, and whether it is as it should be.
type Card = (String, String, Tone);

/// The cards.
pub(in super::super) fn cards(sheet: &FlightSheet) -> String {
    let mut cards: Vec<Card> =
        vec![(duration(sheet.time_s().1), "from first to last sample".to_owned(), Tone::Idle)];
    cards.extend(modes(sheet));
    let aided = &sheet.outcome.aided;
    if let Some(rmse) = aided.position_rmse_m {
        cards.push((
            format!("{} m", short(rmse)),
            format!("off with GNSS (RMS), against {}", sheet.against()),
            Tone::Idle,
        ));
    }
    let outages = &sheet.outcome.outages;
    let worst = outages.iter().max_by(|a, b| {
        a.horizontal_error_end_m.unwrap_or(0.0).total_cmp(&b.horizontal_error_end_m.unwrap_or(0.0))
    });
    if let Some((worst, error)) = worst.and_then(|w| Some((w, w.horizontal_error_end_m?))) {
        let sigma = worst.sigma_end_m.unwrap_or(f64::INFINITY);
        let tone = match error / sigma {
            within if within <= 2.0 => Tone::Good,
            within if within <= 4.0 => Tone::Caution,
            _ => Tone::Bad,
        };
        let which = if outages.len() > 1 { "worst outage's end" } else { "outage's end" };
        let what = format!("off at the {which}, {} m claimed (1 sigma)", number(worst.sigma_end_m, 1));
        cards.push((format!("{} m", short(error)), what, tone));
    }
    if let Some(told) = MeasuredDrift::to_tell(&sheet.drift).filter(|m| m.times > 0) {
        let what = format!("off {:.0} s after a loss, on {}", told.after_s, told.source.label());
        cards.push((format!("{} m", number(told.error_m, 1)), what, Tone::Idle));
    }
    let wrong: Vec<String> = sheet
        .sources
        .iter()
        .filter(|s| s.health == SourceHealth::Faulty)
        .map(|s| format!("{} {}", s.kind.label(), s.id))
        .collect();
    if wrong.is_empty() {
        cards.push(("none".to_owned(), "faulty source at the end".to_owned(), Tone::Good));
    } else {
        cards.push((wrong.len().to_string(), format!("faulty at the end: {}", wrong.join(", ")), Tone::Bad));
    }
    let mut out = String::from("<ul class=\"cards\">");
    for (value, what, tone) in cards {
        let _ = write!(
            out,
            "<li class=\"k-{}\"><b>{}</b><span>{}</span></li>",
            tone.class(),
            escaped(&value),
            escaped(&what)
        );
    }
    out.push_str("</ul>");
    out
}

/// How long it navigated with GNSS, and without.
fn modes(sheet: &FlightSheet) -> Vec<Card> {
    let in_mode = |mode: Mode| -> f64 {
        let stays = sheet.recorder.states.mode.stays.iter().filter(|s| s.what == mode.label());
        stays.map(|s| s.to_s - s.from_s).sum()
    };
    let all = [
        (in_mode(Mode::Aided) + in_mode(Mode::Rejoining), "with GNSS", Tone::Good),
        (in_mode(Mode::Holdover), "without GNSS", Tone::Caution),
        (in_mode(Mode::Lost), "lost", Tone::Bad),
    ];
    let known = all.into_iter().filter(|(time_s, ..)| *time_s > 0.0);
    let cards: Vec<Card> =
        known.map(|(time_s, what, tone)| (duration(time_s), what.to_owned(), tone)).collect();
    if cards.is_empty() { vec![("never".to_owned(), "aligned".to_owned(), Tone::Bad)] } else { cards }
}
