//! A fault as text: `SENSOR[ID][.AXIS]:KIND[=VALUE[/COURSE]]@A..B`, as in `flow:zero@100..160`, `gyro.z:bias=3@50..`, `gnss1:walk=0.5/90@60..200`.

use std::fmt;
use std::str::FromStr;

use super::target::{Sensor, Target};
use super::{FaultKind, InjectedFault};

/// What is wrong with a fault's text.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FaultError {
    /// It has not the form.
    #[error("\"{0}\" is not a fault: expected SENSOR:KIND[=VALUE]@A..B, as in flow:zero@100..160")]
    Form(String),
    /// There is no such sensor.
    #[error("\"{0}\" is no sensor that can fail: there are {names}", names = sensors())]
    Sensor(String),
    /// There is no such axis.
    #[error("{0} has no axis \"{1}\"")]
    Axis(&'static str, String),
    /// The sensor cannot fail like that.
    #[error("{0} has no fault \"{1}\": it has {2}")]
    Kind(&'static str, String, String),
    /// The value is missing, or is no number, or cannot be one of this fault.
    #[error("{0}={1}: {2}")]
    Value(&'static str, String, &'static str),
    /// The interval is none.
    #[error("\"{0}\" is not an interval: expected A..B in seconds with 0 <= A < B; without B it lasts")]
    Interval(String),
}

fn sensors() -> String {
    Sensor::ALL.iter().map(|s| s.label()).collect::<Vec<_>>().join(", ")
}

/// How a kind takes a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Takes {
    Nothing,
    /// In the target's unit.
    Value,
    /// In a unit of its own.
    Number,
    /// The same with a course.
    Course,
}

/// A kind's name, which sensors may have it, the value without which it is, what its values may be, and the kind itself.
struct Named {
    name: &'static str,
    of: fn(Sensor) -> bool,
    takes: Takes,
    by_default: Option<f64>,
    bounds: [f64; 2],
    /// Of its value in SI units, and its course, rad.
    make: fn(f64, f64) -> FaultKind,
}

const ANY: [f64; 2] = [f64::MIN, f64::MAX];
const POSITIVE: [f64; 2] = [1e-3, f64::MAX];

const fn plain(name: &'static str, of: fn(Sensor) -> bool, make: fn(f64, f64) -> FaultKind) -> Named {
    Named { name, of, takes: Takes::Nothing, by_default: None, bounds: ANY, make }
}

const fn valued(
    name: &'static str,
    of: fn(Sensor) -> bool,
    takes: Takes,
    make: fn(f64, f64) -> FaultKind,
) -> Named {
    Named { name, of, takes, by_default: None, bounds: ANY, make }
}

impl Named {
    const fn within(mut self, bounds: [f64; 2]) -> Self {
        self.bounds = bounds;
        self
    }

    const fn else_value(mut self, value: f64) -> Self {
        self.by_default = Some(value);
        self
    }
}

fn any(_: Sensor) -> bool {
    true
}

fn told(sensor: Sensor) -> bool {
    sensor != Sensor::All
}

/// Sensors that tell numbers which can be altered one by one.
fn numbers(sensor: Sensor) -> bool {
    !matches!(sensor, Sensor::All | Sensor::Imu | Sensor::Gnss | Sensor::Landmark)
}

fn fixes_too(sensor: Sensor) -> bool {
    numbers(sensor) || sensor == Sensor::Gnss
}

fn axes(sensor: Sensor) -> bool {
    turned(sensor) || sensor == Sensor::Flow
}

fn turned(sensor: Sensor) -> bool {
    matches!(sensor, Sensor::Gyro | Sensor::Accel | Sensor::Mag)
}

fn blown(sensor: Sensor) -> bool {
    matches!(sensor, Sensor::Baro | Sensor::Airspeed | Sensor::Range)
}

fn receiver(sensor: Sensor) -> bool {
    sensor == Sensor::Gnss
}

const KINDS: &[Named] = &[
    plain("freeze", told, |_, _| FaultKind::Freeze),
    plain("zero", numbers, |_, _| FaultKind::StuckAt(0.0)),
    valued("stuck", numbers, Takes::Value, |v, _| FaultKind::StuckAt(v)),
    valued("bias", numbers, Takes::Value, |v, _| FaultKind::Bias(v)),
    valued("ramp", numbers, Takes::Value, |v, _| FaultKind::Ramp(v)),
    valued("scale", numbers, Takes::Number, |v, _| FaultKind::Scale(v)),
    valued("noise", fixes_too, Takes::Value, |v, _| FaultKind::Noise(v)).within([0.0, f64::MAX]),
    valued("gust", blown, Takes::Value, |v, _| FaultKind::Gust(v)),
    valued("delay", told, Takes::Number, |v, _| FaultKind::Delay(v)).within(POSITIVE),
    valued("drop", any, Takes::Number, |v, _| FaultKind::Drop(v)).within([0.0, 1.0]).else_value(1.0),
    plain("flip", numbers, |_, _| FaultKind::Flip),
    plain("nan", fixes_too, |_, _| FaultKind::NotANumber),
    plain("swap", axes, |_, _| FaultKind::Swap),
    valued("turn", turned, Takes::Number, |v, _| FaultKind::Turn(v.to_radians())),
    valued("jump", receiver, Takes::Course, FaultKind::Jump),
    valued("walk", receiver, Takes::Course, FaultKind::Walk),
    valued("walkboth", receiver, Takes::Course, FaultKind::WalkBoth),
    plain("nofix", receiver, |_, _| FaultKind::NoFix),
    valued("flap", receiver, Takes::Number, |v, _| FaultKind::Flap(v)).within(POSITIVE),
    plain("spoofed", receiver, |_, _| FaultKind::Spoofed),
    plain("jammed", receiver, |_, _| FaultKind::Jammed),
    valued("height", receiver, Takes::Number, |v, _| FaultKind::Height(v)),
];

/// Course of a walk or jump that names none: it moves along both axes.
const COURSE_DEG: f64 = 45.0;

impl FromStr for InjectedFault {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        let form = || FaultError::Form(text.to_owned());
        let (what, interval) = text.split_once('@').ok_or_else(form)?;
        let (sensor, kind) = what.split_once(':').ok_or_else(form)?;
        let target = target(sensor.trim())?;
        let kind = kind_of(&target, kind.trim())?;
        let (from_s, to_s) = parse_span(interval)?;
        Ok(Self { target, kind, from_s, to_s })
    }
}

/// `A..B`, or `A..` for ever.
fn parse_span(text: &str) -> Result<(f64, f64), FaultError> {
    let wrong = || FaultError::Interval(text.to_owned());
    let (a, b) = text.split_once("..").ok_or_else(wrong)?;
    let from: f64 = a.trim().parse().map_err(|_| wrong())?;
    let to = if b.trim().is_empty() { f64::INFINITY } else { b.trim().parse().map_err(|_| wrong())? };
    if from >= 0.0 && from.is_finite() && from < to { Ok((from, to)) } else { Err(wrong()) }
}

fn target(text: &str) -> Result<Target, FaultError> {
    let (name, axis) = text.split_once('.').map_or((text, None), |(name, axis)| (name, Some(axis)));
    let letters = name.trim_end_matches(|c: char| c.is_ascii_digit());
    let unknown = || FaultError::Sensor(name.to_owned());
    let sensor = *Sensor::ALL.iter().find(|s| s.label() == letters).ok_or_else(unknown)?;
    let digits = &name[letters.len()..];
    let id = if digits.is_empty() { None } else { Some(digits.parse().map_err(|_| unknown())?) };
    let mut target = Target { sensor, id, axis: None };
    if let Some(axis) = axis {
        let at = ["x", "y", "z"].iter().position(|a| *a == axis).filter(|a| *a < target.axes());
        target.axis = Some(at.ok_or_else(|| FaultError::Axis(sensor.label(), axis.to_owned()))?);
    }
    Ok(target)
}

fn kind_of(target: &Target, text: &str) -> Result<FaultKind, FaultError> {
    let (name, value) = text.split_once('=').map_or((text, None), |(n, v)| (n, Some(v)));
    let Some(kind) = KINDS.iter().find(|k| k.name == name && (k.of)(target.sensor)) else {
        let has: Vec<_> = KINDS.iter().filter(|k| (k.of)(target.sensor)).map(|k| k.name).collect();
        return Err(FaultError::Kind(target.sensor.label(), name.to_owned(), has.join(", ")));
    };
    let told = value.unwrap_or_default();
    let wrong = |why| FaultError::Value(kind.name, told.to_owned(), why);
    if kind.takes == Takes::Nothing && value.is_some() {
        return Err(wrong("it takes no value"));
    }
    let (number, course) = told.split_once('/').map_or((told, None), |(n, c)| (n, Some(c)));
    if course.is_some() && kind.takes != Takes::Course {
        return Err(wrong("it takes no course"));
    }
    let number = match value {
        Some(_) => finite(number).ok_or_else(|| wrong("that is no number"))?,
        None if kind.takes == Takes::Nothing => 0.0,
        None => kind.by_default.ok_or_else(|| wrong("a value is missing"))?,
    };
    if !(kind.bounds[0]..=kind.bounds[1]).contains(&number) {
        return Err(wrong("it cannot be that"));
    }
    let course =
        course.map_or(Ok(COURSE_DEG), |c| finite(c).ok_or_else(|| wrong("the course is no number")))?;
    let unit = if kind.takes == Takes::Value { target.in_si() } else { 1.0 };
    Ok((kind.make)(number * unit, course.to_radians()))
}

fn finite(text: &str) -> Option<f64> {
    text.trim().parse().ok().filter(|v: &f64| v.is_finite())
}

/// A number that was given comes back without the rounding of its unit's factor.
fn rounded(value: f64) -> f64 {
    (value * 1e9).round() / 1e9
}

fn degrees(radians: f64) -> f64 {
    rounded(radians.to_degrees())
}

impl fmt::Display for InjectedFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let t = &self.target;
        write!(f, "{t}:{}", self.kind.name())?;
        match self.kind {
            FaultKind::StuckAt(v)
            | FaultKind::Bias(v)
            | FaultKind::Ramp(v)
            | FaultKind::Noise(v)
            | FaultKind::Gust(v) => write!(f, "={}", rounded(v / t.in_si())),
            FaultKind::Scale(v)
            | FaultKind::Delay(v)
            | FaultKind::Drop(v)
            | FaultKind::Flap(v)
            | FaultKind::Height(v) => write!(f, "={v}"),
            FaultKind::Turn(by) => write!(f, "={}", degrees(by)),
            FaultKind::Jump(v, course) | FaultKind::Walk(v, course) | FaultKind::WalkBoth(v, course) => {
                write!(f, "={v}/{}", degrees(course))
            }
            _ => Ok(()),
        }?;
        write!(f, "@{}..", self.from_s)?;
        if self.to_s.is_finite() { write!(f, "{}", self.to_s) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parsed(text: &str) -> Result<InjectedFault, FaultError> {
        text.parse()
    }

    #[test]
    fn what_is_written_is_what_is_read() {
        for text in [
            "flow:stuck=0@100..160",
            "range0:stuck=0.7@10..",
            "gyro.z:bias=3@50..60",
            "gnss1:walk=0.5/90@60..200",
            "mag:turn=-90@1..2",
            "all:drop=1@5..7.5",
            "accel.x:freeze@0..9",
            "baro1:gust=3@1..9",
        ] {
            assert_eq!(parsed(text).unwrap().to_string(), text);
        }
        assert_eq!(parsed("flow:zero@1..2"), parsed("flow:stuck=0@1..2"));
        assert_eq!(parsed("gyro.z:bias=180@1..2").unwrap().kind, FaultKind::Bias(std::f64::consts::PI));
    }

    #[test]
    fn what_cannot_be_is_refused_with_what_can() {
        for (text, hint) in [
            ("flow:zero", "expected SENSOR:KIND"),
            ("sonar:zero@1..2", "there are all, imu, gyro"),
            ("flow.z:zero@1..2", "no axis"),
            ("gnss:scale=2@1..2", "it has freeze"),
            ("range:bias@1..2", "a value is missing"),
            ("range:bias=NaN@1..2", "no number"),
            ("range:zero=1@1..2", "takes no value"),
            ("range:drop=2@1..2", "cannot be that"),
            ("flow:zero@2..1", "not an interval"),
            ("flow:zero@-1..1", "not an interval"),
            ("flow999:zero@1..2", "no sensor"),
        ] {
            let error = parsed(text).unwrap_err().to_string();
            assert!(error.contains(hint), "{text}: {error}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_a_fault_or_an_error(text in "\\PC{0,40}") {
            let _ = parsed(&text);
        }

        #[test]
        fn nearly_right_texts_are_too(text in "(flow|gnss1|gyro\\.z|all|baro)[:=](bias|walk|drop|zero|delay)(=[-0-9e.]{0,5}(/[0-9]{0,3})?)?@[0-9.]{0,6}\\.\\.[0-9.]{0,6}") {
            if let Ok(fault) = parsed(&text) {
                prop_assert_eq!(parsed(&fault.to_string()), Ok(fault));
            }
        }
    }
}
