//! Reads the drawings of a report back: what a reader sees as numbers.

use roxmltree::{Document, Node};

/// What is drawn of solutions is this far apart, s.
const PERIOD_S: f64 = 0.05;

/// A drawing, found by its title.
pub struct Drawing {
    xml: String,
    x: [f64; 2],
    y: [f64; 2],
    logarithmic: bool,
    height: f64,
}

fn two(node: Node<'_, '_>, name: &str) -> [f64; 2] {
    let text = node.attribute(name).unwrap_or("0 1");
    let numbers: Vec<f64> = text.split(' ').map(|n| n.parse().unwrap()).collect();
    [numbers[0], numbers[1]]
}

/// All drawings of a page, by title.
pub fn titles(page: &str) -> Vec<String> {
    pieces(page)
        .map(|xml| Document::parse(xml).unwrap().root_element().attribute("aria-label").unwrap().to_owned())
        .collect()
}

fn pieces(page: &str) -> impl Iterator<Item = &str> {
    page.split("<svg ").skip(1).map(move |rest| {
        let begin = rest.as_ptr() as usize - page.as_ptr() as usize - "<svg ".len();
        let end = begin + "<svg ".len() + rest.find("</svg>").unwrap() + "</svg>".len();
        &page[begin..end]
    })
}

impl Drawing {
    /// The one of this title.
    pub fn of(page: &str, title: &str) -> Self {
        let xml = pieces(page)
            .find(|xml| Document::parse(xml).unwrap().root_element().attribute("aria-label") == Some(title))
            .unwrap_or_else(|| panic!("no drawing \"{title}\" among {:?}", titles(page)))
            .to_owned();
        let document = Document::parse(&xml).unwrap();
        let root = document.root_element();
        let view = root.attribute("viewBox").unwrap();
        let (x, y) = (two(root, "data-x"), two(root, "data-y"));
        let height = view.split(' ').next_back().unwrap().parse().unwrap();
        let logarithmic = root.attribute("data-log").is_some();
        Self { x, y, logarithmic, height, xml }
    }

    fn value(&self, [x, y]: [f64; 2]) -> (f64, f64) {
        let (x, part) = (self.x[0] + x / 1000.0 * (self.x[1] - self.x[0]), 1.0 - y / self.height);
        let y = if self.logarithmic {
            self.y[0] * (self.y[1] / self.y[0]).powf(part)
        } else {
            self.y[0] + part * (self.y[1] - self.y[0])
        };
        (x, y)
    }

    /// How exactly x and y can be read.
    pub fn resolution(&self) -> (f64, f64) {
        (0.06 / 1000.0 * (self.x[1] - self.x[0]), 0.06 / self.height * (self.y[1] - self.y[0]))
    }

    fn numbers(text: &str) -> Vec<[f64; 2]> {
        let numbers: Vec<f64> = text
            .split(|c: char| !(c.is_ascii_digit() || c == '.' || c == '-'))
            .filter(|n| !n.is_empty())
            .map(|n| n.parse().unwrap())
            .collect();
        numbers.chunks_exact(2).map(|c| [c[0], c[1]]).collect()
    }

    /// The points of the line or area of this name.
    pub fn points(&self, name: &str) -> Vec<(f64, f64)> {
        let document = Document::parse(&self.xml).unwrap();
        let of = document.descendants().filter(|n| n.attribute("data-name") == Some(name));
        let points: Vec<(f64, f64)> = of
            .flat_map(|n| match n.tag_name().name() {
                "path" => Self::numbers(&n.attribute("d").unwrap().replace("h0", "")),
                _ => Self::numbers(n.attribute("points").unwrap()),
            })
            .map(|p| self.value(p))
            .collect();
        assert!(!points.is_empty(), "nothing is called \"{name}\"");
        points
    }

    /// The stays of a lane: from, to, and what it is.
    pub fn stays(&self, lane: &str) -> Vec<(f64, f64, String)> {
        let document = Document::parse(&self.xml).unwrap();
        let lane = document.descendants().find(|n| n.attribute("data-name") == Some(lane)).unwrap();
        let rects = lane.children().filter(|n| n.has_tag_name("rect"));
        rects
            .map(|r| {
                let of = |name: &str| -> f64 { r.attribute(name).unwrap().parse().unwrap() };
                let from = self.value([of("x"), 0.0]).0;
                let to = self.value([of("x") + of("width"), 0.0]).0;
                let what = r.first_element_child().unwrap().text().unwrap();
                (from, to, what.rsplit_once(": ").unwrap().0.to_owned())
            })
            .collect()
    }

    /// What is marked behind the plot.
    pub fn marks(&self, class: &str) -> Vec<(f64, f64)> {
        let document = Document::parse(&self.xml).unwrap();
        let marks = document.descendants().filter(|n| n.attribute("class") == Some(&format!("mark {class}")));
        marks
            .map(|r| {
                let of = |name: &str| -> f64 { r.attribute(name).unwrap().parse().unwrap() };
                (self.value([of("x"), 0.0]).0, self.value([of("x") + of("width"), 0.0]).0)
            })
            .collect()
    }

    /// Fails unless every drawn point is one of `known`, and the greatest and the least of `known` are drawn: of solutions one in [`PERIOD_S`] is.
    pub fn shows(&self, name: &str, known: &[(f64, f64)]) {
        let (drawn, (dx, dy)) = (self.points(name), self.resolution());
        let near = |a: &(f64, f64), b: &(f64, f64)| {
            let dy = if self.logarithmic { 0.01 * b.1.abs().max(0.02) } else { dy };
            (a.0 - b.0).abs() <= dx + 1e-9 && (a.1 - b.1).abs() <= dy + 1e-9
        };
        for point in &drawn {
            // What leaves a logarithmic drawing below has no value.
            let outside = self.logarithmic && point.1 < self.y[0]
                || point.1 < self.y[0] - 2.0 * dy
                || point.1 > self.y[1] + 2.0 * dy;
            assert!(outside || known.iter().any(|k| near(point, k)), "{name}: {point:?} was never so");
        }
        let extremes = [
            known.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap(),
            known.iter().min_by(|a, b| a.1.total_cmp(&b.1)).unwrap(),
        ];
        for extreme in extremes.into_iter().filter(|e| (self.y[0]..=self.y[1]).contains(&e.1)) {
            let then = |d: &&(f64, f64)| (d.0 - extreme.0).abs() <= PERIOD_S + dx;
            let is_drawn = drawn.iter().filter(then).any(|d| near(&(extreme.0, d.1), extreme));
            assert!(is_drawn, "{name}: {extreme:?} is not drawn");
        }
    }
}
