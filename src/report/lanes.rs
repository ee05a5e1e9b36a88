//! States over time, each in a lane of its own: the mode, what carries, the health of every source.

use std::fmt::Write;

use super::html::escaped;
use super::palette::Tone;
use super::scale::PlotScale;

/// A state from one time to another, s.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Stay {
    pub(super) from_s: f64,
    pub(super) to_s: f64,
    pub(super) tone: Tone,
    pub(super) what: String,
}

/// The states of one thing, one after the other.
#[derive(Clone, Debug)]
pub(super) struct Lane {
    pub(super) name: String,
    pub(super) stays: Vec<Stay>,
}

impl Lane {
    pub(super) fn new(name: impl Into<String>) -> Self {
        Self { name: name.into(), stays: Vec::new() }
    }

    /// It is so now.
    pub(super) fn note(&mut self, t_s: f64, tone: Tone, what: &str) {
        if let Some(last) = self.stays.last_mut() {
            last.to_s = t_s;
            if last.tone == tone && last.what == what {
                return;
            }
        }
        self.stays.push(Stay { from_s: t_s, to_s: t_s, tone, what: what.to_owned() });
    }

    /// It was so from one time to another.
    pub(super) fn add(&mut self, from_s: f64, to_s: f64, tone: Tone, what: impl Into<String>) {
        self.stays.push(Stay { from_s, to_s, tone, what: what.into() });
    }

    /// What can be seen of it: stays of less than `part_s` that follow each other are one, as bad as the worst of them.
    fn seen(&self, part_s: f64) -> Vec<Stay> {
        let is_short = |stay: &Stay| stay.to_s - stay.from_s < part_s;
        let mut out: Vec<Stay> = Vec::new();
        for stay in &self.stays {
            match out.last_mut().filter(|last| is_short(last)) {
                Some(last)
                    if stay.from_s - last.to_s < part_s && (is_short(stay) || last.tone <= stay.tone) =>
                {
                    let from_s = last.from_s;
                    if stay.tone >= last.tone {
                        *last = stay.clone();
                    }
                    (last.from_s, last.to_s) = (from_s, stay.to_s);
                }
                _ => out.push(stay.clone()),
            }
        }
        out
    }
}

/// Width of a drawing in its own units, and height of a lane.
const WIDTH: f64 = 1000.0;
const LANE: f64 = 20.0;
/// A stay that is shorter than this part of the time is not seen alone.
const LEAST_PART: f64 = 1.0 / 1500.0;
/// A stay that is at least this part of the time has room for its text.
const TEXT_PART: f64 = 0.09;

/// Lanes below each other, over the time of the flight; `None` where there are none.
pub(super) fn lanes(
    title: &str,
    explained: &str,
    (from_s, to_s): (f64, f64),
    lanes: &[Lane],
) -> Option<String> {
    let lanes: Vec<&Lane> = lanes.iter().filter(|lane| !lane.stays.is_empty()).collect();
    if lanes.is_empty() || to_s <= from_s {
        return None;
    }
    let x = PlotScale::linear(from_s, to_s);
    let height = LANE * lanes.len() as f64;
    let mut out = format!(
        "<figure class=\"chart lanes\"><figcaption><h3>{}</h3><p>{}</p></figcaption><div class=\"plot\" style=\"height:{:.0}px\"><div class=\"y\">",
        escaped(title),
        escaped(explained),
        height * 1.1
    );
    for (i, lane) in lanes.iter().enumerate() {
        let top = 100.0 * (i as f64 + 0.5) / lanes.len() as f64;
        let _ = write!(out, "<span style=\"top:{top:.2}%\">{}</span>", escaped(&lane.name));
    }
    out.push_str("</div><div class=\"x\">");
    for (i, (value, text)) in x.ticks(8).iter().enumerate() {
        let minor = if i % 2 == 1 { " class=\"minor\"" } else { "" };
        let _ = write!(out, "<span{minor} style=\"left:{:.2}%\">{text}</span>", 100.0 * x.part(*value));
    }
    out.push_str("<b>s</b></div>");
    let mut texts = String::new();
    let _ = write!(
        out,
        "<svg viewBox=\"0 0 {WIDTH} {height}\" preserveAspectRatio=\"none\" role=\"img\" aria-label=\"{}\" data-kind=\"lanes\" data-x=\"{from_s} {to_s}\">",
        escaped(title)
    );
    for (i, lane) in lanes.iter().enumerate() {
        let _ = write!(out, "<g data-name=\"{}\">", escaped(&lane.name));
        for stay in lane.seen(LEAST_PART * (to_s - from_s)) {
            write_stay(&mut out, &mut texts, &x, (i, lanes.len()), &stay);
        }
        out.push_str("</g>");
    }
    let _ = writeln!(out, "</svg><div class=\"texts\">{texts}</div></div></figure>");
    Some(out)
}

/// One stay in lane `row` of `rows`, and its text where there is room for it.
fn write_stay(out: &mut String, texts: &mut String, x: &PlotScale, (row, rows): (usize, usize), stay: &Stay) {
    let (left, right) = (x.part(stay.from_s).clamp(0.0, 1.0), x.part(stay.to_s).clamp(0.0, 1.0));
    let width = (WIDTH * (right - left)).max(1.0);
    let what = escaped(&stay.what);
    let _ = write!(
        out,
        "<rect class=\"t-{}\" x=\"{:.1}\" y=\"{:.0}\" width=\"{width:.1}\" height=\"{:.0}\"><title>{what}: {:.1} to {:.1} s</title></rect>",
        stay.tone.class(),
        WIDTH * left,
        LANE * row as f64 + 1.0,
        LANE - 2.0,
        stay.from_s,
        stay.to_s
    );
    if right - left >= TEXT_PART {
        let middle = 100.0 * (row as f64 + 0.5) / rows as f64;
        let _ = write!(
            texts,
            "<em style=\"top:{middle:.2}%;left:{:.2}%;width:{:.2}%\">{what}</em>",
            100.0 * left,
            100.0 * (right - left)
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_goes_on_until_it_changes_and_a_short_bad_one_is_still_seen() {
        let mut lane = Lane::new("flow 0");
        for i in 0..1000 {
            let t = f64::from(i);
            if i == 500 { lane.note(t, Tone::Bad, "faulty") } else { lane.note(t, Tone::Good, "healthy") }
        }
        assert_eq!(lane.stays.len(), 3);
        assert_eq!((lane.stays[1].from_s, lane.stays[1].to_s), (500.0, 501.0));
        let seen = lane.seen(20.0);
        assert_eq!(seen.iter().map(|s| s.tone).collect::<Vec<_>>(), [Tone::Good, Tone::Bad, Tone::Good]);
        let text = lanes("Sources", "", (0.0, 999.0), &[lane.clone(), Lane::new("never heard")]).unwrap();
        assert!(text.contains("t-bad") && text.contains("faulty") && !text.contains("never heard"));
        let mut flaps = Lane::new("flaps");
        for i in 0..100_000 {
            flaps.note(f64::from(i), if i % 2 == 0 { Tone::Good } else { Tone::Caution }, "x");
        }
        assert!(flaps.seen(100_000.0 * LEAST_PART).len() < 1600, "too many to draw");
        assert_eq!(lanes("Sources", "", (0.0, 10.0), &[]), None);
    }
}
