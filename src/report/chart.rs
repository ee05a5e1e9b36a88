//! A plot as SVG with its texts around it.
//!
//! The drawing is stretched to the width of the page; lines keep their width and texts their size, since these stand beside the drawing and not
//! in it. Every line, area and dot says what it is of (`data-name`), and the drawing what its sides are (`data-x`, `data-y`), so that values
//! can be read back: by whoever points at it, and by the tests.

use std::fmt::Write;

use super::html::escaped;
use super::palette::Role;
use super::scale::{PlotScale, RangeFit};
use super::trace::{Point, Trace};

/// Size of a drawing in its own units, whatever it is stretched to.
pub(super) const WIDTH: f64 = 1000.0;
/// See there.
pub(super) const HEIGHT: f64 = 500.0;

/// How a line is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stroke {
    Plain,
    Strong,
    Faint,
    Dashed,
}

impl Stroke {
    const fn class(self) -> &'static str {
        match self {
            Stroke::Plain => "line",
            Stroke::Strong => "line strong",
            Stroke::Faint => "line faint",
            Stroke::Dashed => "line dashed",
        }
    }
}

/// One thing that is drawn.
#[derive(Clone, Debug)]
enum Layer {
    Line {
        name: String,
        role: Role,
        stroke: Stroke,
        stretches: Vec<Vec<Point>>,
    },
    /// Between zero (or the least of the plot) and the values, or between two values.
    Band {
        name: String,
        role: Role,
        stretches: Vec<Vec<(f64, f64, f64)>>,
    },
    Dots {
        name: String,
        role: Role,
        points: Vec<Point>,
    },
}

/// A part of the horizontal side that is marked.
#[derive(Clone, Debug)]
struct Marked {
    from: f64,
    to: f64,
    class: String,
    what: String,
}

/// What kind of plot it is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Shape {
    /// Over the flight's time, as wide as the page.
    Time,
    /// The same, one of several beside each other.
    SmallTime,
    /// Small, over something else.
    SmallApart,
    /// A map of this width over its height.
    Plan(f64),
}

impl Shape {
    const fn class(self) -> &'static str {
        match self {
            Shape::Time => "",
            Shape::SmallTime | Shape::SmallApart => "small",
            Shape::Plan(_) => "plan",
        }
    }

    /// What whoever points at it is told: plots over the same time together.
    const fn kind(self) -> &'static str {
        match self {
            Shape::Time | Shape::SmallTime => "time",
            Shape::SmallApart => "xy",
            Shape::Plan(_) => "plan",
        }
    }

    /// About how many ticks there are along x and y.
    const fn ticks(self) -> [usize; 2] {
        match self {
            Shape::Time => [8, 4],
            Shape::SmallTime | Shape::SmallApart => [5, 4],
            Shape::Plan(_) => [8, 6],
        }
    }
}

/// A plot. What is added first lies below.
#[derive(Clone, Debug)]
pub(super) struct Chart {
    title: String,
    explained: String,
    x: PlotScale,
    units: [&'static str; 2],
    fit: RangeFit,
    layers: Vec<Layer>,
    marked: Vec<Marked>,
    guides: Vec<(f64, String)>,
    labels: Vec<(f64, f64, String)>,
    shape: Shape,
}

impl Chart {
    /// An empty plot over `x_from` to `x_to`.
    pub(super) fn new(title: &str, x: (f64, f64), units: [&'static str; 2], fit: RangeFit) -> Self {
        Self {
            title: title.to_owned(),
            explained: String::new(),
            x: PlotScale::linear(x.0, x.1),
            units,
            fit,
            layers: Vec::new(),
            marked: Vec::new(),
            guides: Vec::new(),
            labels: Vec::new(),
            shape: Shape::Time,
        }
    }

    /// A sentence under the title: how to read it.
    pub(super) fn explained(mut self, text: impl Into<String>) -> Self {
        self.explained = text.into();
        self
    }

    /// Small, one of several beside each other.
    pub(super) fn small(mut self) -> Self {
        self.shape = Shape::SmallTime;
        self
    }

    /// Small, and not over the flight's time.
    pub(super) fn apart(mut self) -> Self {
        self.shape = Shape::SmallApart;
        self
    }

    /// A map whose drawing has this width over its height.
    pub(super) fn plan(mut self, aspect: f64) -> Self {
        self.shape = Shape::Plan(aspect);
        self
    }

    /// A word beside a point.
    pub(super) fn label(&mut self, x: f64, y: f64, text: String) {
        self.labels.push((x, y, text));
    }

    /// A line.
    pub(super) fn line(&mut self, name: &str, role: Role, stroke: Stroke, stretches: Vec<Vec<Point>>) {
        if !stretches.is_empty() {
            self.layers.push(Layer::Line { name: name.to_owned(), role, stroke, stretches });
        }
    }

    /// A line of a trace.
    pub(super) fn trace(&mut self, name: &str, role: Role, stroke: Stroke, trace: &Trace) {
        self.line(name, role, stroke, trace.stretches());
    }

    /// An area between two values at each time.
    pub(super) fn band(&mut self, name: &str, role: Role, stretches: Vec<Vec<(f64, f64, f64)>>) {
        if !stretches.is_empty() {
            self.layers.push(Layer::Band { name: name.to_owned(), role, stretches });
        }
    }

    /// Dots.
    pub(super) fn dots(&mut self, name: &str, role: Role, points: Vec<Point>) {
        if !points.is_empty() {
            self.layers.push(Layer::Dots { name: name.to_owned(), role, points });
        }
    }

    /// Marks a time: behind everything, with what it is for whoever points at it.
    pub(super) fn mark(&mut self, from: f64, to: f64, class: &str, what: &str) {
        if to >= self.x.least && from <= self.x.most {
            let (from, to) = (from.max(self.x.least), to.min(self.x.most));
            self.marked.push(Marked { from, to, class: class.to_owned(), what: what.to_owned() });
        }
    }

    /// A horizontal line to compare with.
    pub(super) fn guide(&mut self, value: f64, what: &str) {
        self.guides.push((value, what.to_owned()));
    }

    fn values(&self) -> Vec<f64> {
        let mut values = Vec::new();
        for layer in &self.layers {
            match layer {
                Layer::Line { stretches, .. } => values.extend(stretches.iter().flatten().map(|p| p.1)),
                Layer::Band { stretches, .. } => {
                    values.extend(stretches.iter().flatten().flat_map(|p| [p.1, p.2]));
                }
                Layer::Dots { points, .. } => values.extend(points.iter().map(|p| p.1)),
            }
        }
        values
    }

    /// The plot, or `None` of nothing: there are no empty ones.
    pub(super) fn render(&self) -> Option<String> {
        let values = self.values();
        let y = PlotScale::of(values.clone(), self.fit)?;
        let mut out = format!(
            "<figure class=\"chart {}\"><figcaption><h3>{}</h3>",
            self.shape.class(),
            escaped(&self.title)
        );
        self.write_legend(&mut out);
        if !self.explained.is_empty() {
            let _ = write!(out, "<p>{}</p>", escaped(&self.explained));
        }
        if let Some(outside) = self.outside(&values, &y) {
            let _ = write!(out, "<p class=\"outside\">{outside}</p>");
        }
        match self.shape {
            Shape::Plan(aspect) => {
                let _ = write!(out, "</figcaption><div class=\"plot\" style=\"aspect-ratio:{aspect:.4}\">");
            }
            _ => out.push_str("</figcaption><div class=\"plot\">"),
        }
        self.write_ticks(&mut out, &y);
        self.write_drawing(&mut out, &y);
        out.push_str("</div></figure>\n");
        Some(out)
    }

    /// Says so where not everything fits in. A map is cut on purpose, and below a decade there is always another one.
    fn outside(&self, values: &[f64], y: &PlotScale) -> Option<String> {
        if matches!(self.shape, Shape::Plan(_)) {
            return None;
        }
        let outside = || values.iter().copied().filter(|v| !y.holds(*v));
        let least = outside().reduce(f64::min).filter(|v| *v < y.least && !y.logarithmic);
        let most = outside().reduce(f64::max).filter(|v| *v > y.most);
        let far = match (least, most) {
            (Some(least), Some(most)) => format!("down to {least:.1} and up to {most:.1}"),
            (Some(least), None) => format!("down to {least:.1}"),
            (None, Some(most)) => format!("up to {most:.1}"),
            (None, None) => return None,
        };
        Some(format!("Not all fits in: it goes {far} {}.", self.units[1]))
    }

    fn write_legend(&self, out: &mut String) {
        out.push_str("<ul class=\"legend\">");
        let mut told: Vec<&str> = Vec::new();
        for layer in &self.layers {
            let (name, role, class) = match layer {
                Layer::Line { name, role, stroke, .. } => (name, role, stroke.class()),
                Layer::Band { name, role, .. } if name.starts_with('2') => (name, role, "area two"),
                Layer::Band { name, role, .. } => (name, role, "area"),
                Layer::Dots { name, role, .. } => (name, role, "dot"),
            };
            if !told.contains(&name.as_str()) {
                told.push(name);
                let _ = write!(
                    out,
                    "<li class=\"c-{}\"><i class=\"{class}\"></i>{}</li>",
                    role.class(),
                    escaped(name)
                );
            }
        }
        let mut classes: Vec<(&str, &str)> = Vec::new();
        for marked in self.marked.iter().filter(|_| self.shape != Shape::SmallTime) {
            let name = marked.what.split(':').next().unwrap_or_default();
            if !classes.contains(&(marked.class.as_str(), name)) && classes.len() < 4 {
                classes.push((&marked.class, name));
                let _ = write!(out, "<li><i class=\"{}\"></i>{}</li>", marked.class, escaped(name));
            }
        }
        out.push_str("</ul>");
    }

    fn write_ticks(&self, out: &mut String, y: &PlotScale) {
        let _ = write!(out, "<div class=\"y\"><b>{}</b>", escaped(self.units[1]));
        let [columns, rows] = self.shape.ticks();
        for (value, text) in y.ticks(rows) {
            let _ = write!(out, "<span style=\"top:{:.2}%\">{text}</span>", 100.0 * (1.0 - y.part(value)));
        }
        out.push_str("</div><div class=\"x\">");
        for (i, (value, text)) in self.x.ticks(columns).iter().enumerate() {
            let minor = if i % 2 == 1 { " class=\"minor\"" } else { "" };
            let _ =
                write!(out, "<span{minor} style=\"left:{:.2}%\">{text}</span>", 100.0 * self.x.part(*value));
        }
        let _ = write!(out, "<b>{}</b></div>", escaped(self.units[0]));
        for (value, what) in self.guides.iter().filter(|g| y.holds(g.0)) {
            let top = 100.0 * (1.0 - y.part(*value));
            let _ = write!(out, "<em class=\"guide\" style=\"top:{top:.2}%\">{}</em>", escaped(what));
        }
        for (x, value, text) in &self.labels {
            let (left, top) = (100.0 * self.x.part(*x), 100.0 * (1.0 - y.part(*value)));
            if (0.0..=100.0).contains(&left) && (0.0..=100.0).contains(&top) {
                let _ = write!(
                    out,
                    "<em class=\"label\" style=\"top:{top:.2}%;left:{left:.2}%\">{}</em>",
                    escaped(text)
                );
            }
        }
    }

    fn write_drawing(&self, out: &mut String, y: &PlotScale) {
        let logarithmic = if y.logarithmic { " data-log=\"1\"" } else { "" };
        let _ = write!(
            out,
            "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" preserveAspectRatio=\"none\" role=\"img\" aria-label=\"{}\" data-kind=\"{}\" data-x=\"{} {}\" data-y=\"{} {}\" data-unit=\"{}\"{logarithmic}>",
            escaped(&self.title),
            self.shape.kind(),
            self.x.least,
            self.x.most,
            y.least,
            y.most,
            escaped(self.units[1]),
        );
        for m in &self.marked {
            let (from, to) = (WIDTH * self.x.part(m.from), WIDTH * self.x.part(m.to));
            let width = (to - from).max(0.8);
            let _ = write!(
                out,
                "<rect class=\"mark {}\" x=\"{from:.1}\" y=\"0\" width=\"{width:.1}\" height=\"{HEIGHT}\"><title>{}</title></rect>",
                m.class,
                escaped(&m.what)
            );
        }
        let mut grid = String::new();
        let [columns, rows] = self.shape.ticks();
        for (value, _) in y.ticks(rows) {
            let _ = write!(grid, "M0 {:.1}h{WIDTH}", HEIGHT * (1.0 - y.part(value)));
        }
        if matches!(self.shape, Shape::Plan(_)) {
            for (value, _) in self.x.ticks(columns) {
                let _ = write!(grid, "M{:.1} 0v{HEIGHT}", WIDTH * self.x.part(value));
            }
        }
        let _ = write!(out, "<path class=\"grid\" d=\"{grid}\"/>");
        for (value, _) in self.guides.iter().filter(|g| y.holds(g.0)) {
            let _ = write!(
                out,
                "<path class=\"guide\" d=\"M0 {:.1}h{WIDTH}\"/>",
                HEIGHT * (1.0 - y.part(*value))
            );
        }
        for layer in &self.layers {
            self.write_layer(out, y, layer);
        }
        out.push_str("</svg>");
    }

    /// Where a point lies, to a tenth of the drawing's unit; what is far outside stays just outside.
    fn place(&self, y: &PlotScale, (x, value): Point) -> (f64, f64) {
        let up = y.part(value).clamp(-1.0, 2.0);
        (WIDTH * self.x.part(x).clamp(-1.0, 2.0), HEIGHT * (1.0 - up))
    }

    fn write_layer(&self, out: &mut String, y: &PlotScale, layer: &Layer) {
        let places = |out: &mut String, points: &mut dyn Iterator<Item = Point>| {
            for point in points {
                let (x, y) = self.place(y, point);
                let _ = write!(out, "{} {} ", tenths(x), tenths(y));
            }
        };
        match layer {
            Layer::Line { name, role, stroke, stretches } => {
                for stretch in stretches {
                    let _ = write!(
                        out,
                        "<polyline class=\"{} c-{}\" data-name=\"{}\" points=\"",
                        stroke.class(),
                        role.class(),
                        escaped(name)
                    );
                    places(out, &mut stretch.iter().copied());
                    if let [only] = stretch[..] {
                        // A line of one point is drawn as a dot.
                        places(out, &mut std::iter::once(only));
                    }
                    out.push_str("\"/>");
                }
            }
            Layer::Band { name, role, stretches } => {
                for stretch in stretches {
                    let _ = write!(
                        out,
                        "<polygon class=\"band c-{}\" data-name=\"{}\" points=\"",
                        role.class(),
                        escaped(name)
                    );
                    places(out, &mut stretch.iter().map(|p| (p.0, p.2)));
                    places(out, &mut stretch.iter().rev().map(|p| (p.0, p.1)));
                    out.push_str("\"/>");
                }
            }
            Layer::Dots { name, role, points } => {
                let _ = write!(
                    out,
                    "<path class=\"dots c-{}\" data-name=\"{}\" d=\"",
                    role.class(),
                    escaped(name)
                );
                for point in points {
                    let (x, y) = self.place(y, *point);
                    let _ = write!(out, "M{} {}h0", tenths(x), tenths(y));
                }
                out.push_str("\"/>");
            }
        }
    }
}

/// A number with one digit after the point, and none where that is 0.
fn tenths(value: f64) -> f64 {
    // Adding zero makes −0 a plain one.
    (value * 10.0).round() / 10.0 + 0.0
}
