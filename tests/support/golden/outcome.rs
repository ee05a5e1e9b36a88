//! How far a run was from what a file expects.

use std::fmt;

use serde_json::Value;

/// Tolerance where nothing else is said.
const TOLERANCE: f64 = 1e-9;
/// Tolerance of the six-parameter flow solve, which is ill-conditioned.
const SOLVE_SIX_TOLERANCE: f64 = 1e-7;

/// Tolerances by field.
#[derive(Clone, Debug)]
struct Tolerances {
    general: f64,
    named: Vec<(String, f64)>,
}

impl Tolerances {
    /// Out of a file's `tol`: a number, or text such as "M, points 1e-9; solve6 1e-7 (conditioning)".
    fn of(file: &Value) -> Self {
        let mut out = Self { general: TOLERANCE, named: vec![("solve6".into(), SOLVE_SIX_TOLERANCE)] };
        match file.get("tol") {
            Some(Value::String(text)) => text.split(';').for_each(|part| out.read(part)),
            Some(other) => out.general = other.as_f64().unwrap_or(TOLERANCE),
            None => {}
        }
        out
    }

    /// "NAME, NAME NUMBER (remark)", or a number for everything.
    fn read(&mut self, part: &str) {
        let mut names = Vec::new();
        for word in part.split([',', ' ', ':', '=']).filter(|w| !w.is_empty()) {
            match word.parse::<f64>() {
                Ok(value) if value > 0.0 && names.is_empty() => return self.general = value,
                Ok(value) if value > 0.0 => {
                    return self.named.splice(0..0, names.into_iter().map(|n| (n, value))).for_each(drop);
                }
                _ => names.push(word.to_owned()),
            }
        }
    }

    fn of_field(&self, field: &str) -> f64 {
        self.named.iter().find(|(name, _)| name == field).map_or(self.general, |(_, value)| *value)
    }
}

/// The largest deviation so far, in units of its tolerance. A deviation is relative to max(1, |value|).
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The format.
    pub format: &'static str,
    tolerances: Tolerances,
    compared: usize,
    deviation: f64,
    tolerance: f64,
    place: String,
}

impl Outcome {
    /// Nothing compared yet.
    pub fn new(format: &'static str, file: &Value) -> Self {
        let tolerances = Tolerances::of(file);
        let tolerance = tolerances.general;
        Self { format, tolerances, compared: 0, deviation: 0.0, tolerance, place: String::new() }
    }

    /// Compares a field at a step.
    pub fn compare(&mut self, field: &str, step: usize, got: &[f64], want: &[f64]) {
        let tolerance = self.tolerances.of_field(field);
        if got.len() != want.len() {
            (self.deviation, self.tolerance) = (f64::INFINITY, tolerance);
            self.place = format!("{field} {step}: {} numbers instead of {}", got.len(), want.len());
        }
        for (g, w) in got.iter().zip(want) {
            self.compared += 1;
            let d = (g - w).abs() / w.abs().max(1.0);
            // A value that is not a number is as far off as can be.
            let d = if d.is_nan() { f64::INFINITY } else { d };
            if self.place.is_empty() || d / tolerance > self.deviation / self.tolerance {
                (self.deviation, self.tolerance) = (d, tolerance);
                self.place = format!("{field} {step}");
            }
        }
    }

    /// How many numbers were compared.
    pub fn compared(&self) -> usize {
        self.compared
    }

    /// Whether everything is within its tolerance, and anything was compared at all.
    pub fn is_ok(&self) -> bool {
        self.compared > 0 && self.deviation <= self.tolerance
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verdict = if self.is_ok() { "ok" } else { "TOO LARGE" };
        write!(
            f,
            "{}, {} numbers: largest deviation {:.2e} ({}), tolerance {:.0e}: {verdict}",
            self.format, self.compared, self.deviation, self.place, self.tolerance
        )
    }
}
