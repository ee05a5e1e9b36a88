//! What a rule found.

use std::fmt;

use serde::Serialize;

/// How much it matters.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FindingGrade {
    /// With this, Holdover will not work as it is configured.
    Fault,
    /// Worth knowing.
    Advice,
}

/// A value as it was found.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[serde(untagged)]
pub enum FoundValue {
    /// Of a parameter, or a rate in Hz.
    Number(f64),
    /// Of a key of the configuration.
    Text(String),
}

impl fmt::Display for FoundValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            FoundValue::Number(number) => write!(f, "{}", plain(*number)),
            FoundValue::Text(text) => f.write_str(text),
        }
    }
}

/// A number with as many decimals as it needs, three at most.
pub fn plain(number: f64) -> String {
    let text = format!("{number:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// What a rule found.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Finding {
    /// How much it matters.
    pub grade: FindingGrade,
    /// A parameter, a key of the configuration, or a stream.
    pub subject: String,
    /// What it is; `None` where there is nothing.
    pub value: Option<FoundValue>,
    /// What it should be.
    pub should: String,
    /// Why.
    pub why: String,
    /// The value of the parameter that mends it; `None` where no parameter does, or only a person can choose.
    pub mend: Option<f64>,
    /// A line that mends it, to be typed.
    pub example: Option<String>,
    /// Whether the parameter takes effect at the next boot only.
    pub reboot: bool,
}

impl Finding {
    /// Of a parameter. With `mend`, what to type follows from that.
    pub(super) fn parameter(
        grade: FindingGrade,
        (name, value): (&str, f64),
        should: impl Into<String>,
        mend: Option<f64>,
        why: impl Into<String>,
    ) -> Self {
        Self {
            grade,
            subject: name.to_owned(),
            value: Some(FoundValue::Number(value)),
            should: should.into(),
            why: why.into(),
            mend,
            example: mend.map(|m| format!("param set {name} {}", plain(m))),
            reboot: false,
        }
    }

    /// Of a key of the configuration.
    pub(super) fn key(
        grade: FindingGrade,
        (key, value): (&str, impl fmt::Display),
        should: &str,
        why: impl Into<String>,
    ) -> Self {
        Self {
            grade,
            subject: key.to_owned(),
            value: Some(FoundValue::Text(value.to_string())),
            should: should.to_owned(),
            why: why.into(),
            mend: None,
            example: Some(format!("holdover run --set {key}={should}")),
            reboot: false,
        }
    }

    /// Of a stream that comes at `rate_hz`.
    pub(super) fn stream(
        grade: FindingGrade,
        (name, rate_hz): (&str, f64),
        should: impl Into<String>,
        why: impl Into<String>,
        example: Option<String>,
    ) -> Self {
        let value = (rate_hz > 0.0).then_some(FoundValue::Number((rate_hz * 10.0).round() / 10.0));
        let (should, why) = (should.into(), why.into());
        Self { grade, subject: name.to_owned(), value, should, why, mend: None, example, reboot: false }
    }

    /// The same, in effect at the next boot.
    pub(super) fn at_boot(self) -> Self {
        Self { reboot: true, ..self }
    }
}
