//! A fault as text: `SENSOR[ID][.AXIS]:KIND[=VALUE[/COURSE]]@A..B`, as in `flow:zero@100..160`, `gyro.z:bias=3@50..`, `gnss1:walk=0.5/90@60..200`.

use std::fmt;
use std::str::FromStr;

use super::target::{Sensor, Target};
use super::{Fault, FaultKind};

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
    Value,
    Course,
    Either,
}

/// A kind's name, and what of it the sensor may have.
struct Named {
    name: &'static str,
    takes: Takes,
    of: fn(Sensor) -> bool,
}

const fn named(name: &'static str, takes: Takes, of: fn(Sensor) -> bool) -> Named {
    Named { name, takes, of }
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

fn axes(sensor: Sensor) -> bool {
    matches!(sensor, Sensor::Gyro | Sensor::Accel | Sensor::Mag | Sensor::Flow)
}

fn turned(sensor: Sensor) -> bool {
    matches!(sensor, Sensor::Gyro | Sensor::Accel | Sensor::Mag)
}

fn receiver(sensor: Sensor) -> bool {
    sensor == Sensor::Gnss
}

const KINDS: &[Named] = &[
    named("stuck", Takes::Either, |s| numbers(s) || matches!(s, Sensor::Imu | Sensor::Gnss)),
    named("freeze", Takes::Nothing, told),
    named("zero", Takes::Nothing, numbers),
    named("bias", Takes::Value, numbers),
    named("ramp", Takes::Value, numbers),
    named("scale", Takes::Value, numbers),
    named("noise", Takes::Value, |s| numbers(s) || s == Sensor::Gnss),
    named("gust", Takes::Value, |s| matches!(s, Sensor::Baro | Sensor::Airspeed | Sensor::Range)),
    named("delay", Takes::Value, told),
    named("drop", Takes::Either, any),
    named("flip", Takes::Nothing, numbers),
    named("nan", Takes::Nothing, |s| numbers(s) || s == Sensor::Gnss),
    named("swap", Takes::Nothing, axes),
    named("turn", Takes::Value, turned),
    named("jump", Takes::Course, receiver),
    named("walk", Takes::Course, receiver),
    named("walkboth", Takes::Course, receiver),
    named("nofix", Takes::Nothing, receiver),
    named("flap", Takes::Value, receiver),
    named("height", Takes::Value, receiver),
];

/// Course of a walk or jump that names none: it moves along both axes.
const COURSE_DEG: f64 = 45.0;

impl FromStr for Fault {
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
    let told = value.unwrap_or_default().to_owned();
    let wrong = |why| FaultError::Value(kind.name, told.clone(), why);
    let (number, course) = match value {
        None if matches!(kind.takes, Takes::Value | Takes::Course) => {
            return Err(wrong("a value is missing"));
        }
        None => (None, None),
        Some(_) if kind.takes == Takes::Nothing => return Err(wrong("it takes no value")),
        Some(text) => {
            let (number, course) = text.split_once('/').map_or((text, None), |(n, c)| (n, Some(c)));
            if course.is_some() && kind.takes != Takes::Course {
                return Err(wrong("it takes no course"));
            }
            (Some(finite(number).ok_or_else(|| wrong("not a number"))?), course)
        }
    };
    let course = match course {
        Some(text) => finite(text).ok_or_else(|| wrong("the course is not a number"))?,
        None => COURSE_DEG,
    };
    Ok(made(name, target, number, course.to_radians()).map_err(wrong)?)
}

fn finite(text: &str) -> Option<f64> {
    text.trim().parse().ok().filter(|v: &f64| v.is_finite())
}

/// The kind with its value, in SI units.
fn made(name: &str, target: &Target, number: Option<f64>, course: f64) -> Result<FaultKind, &'static str> {
    let bare = number.unwrap_or(0.0);
    let si = bare * target.in_si();
    let positive = |ok: bool, kind| if ok { Ok(kind) } else { Err("it has to be positive") };
    match name {
        "stuck" => match number {
            Some(_) if matches!(target.sensor, Sensor::Imu | Sensor::Gnss) => Err("it takes no value"),
            Some(_) => Ok(FaultKind::StuckAt(si)),
            None => Ok(FaultKind::Freeze),
        },
        "freeze" => Ok(FaultKind::Freeze),
        "zero" => Ok(FaultKind::StuckAt(0.0)),
        "bias" => Ok(FaultKind::Bias(si)),
        "ramp" => Ok(FaultKind::Ramp(si)),
        "scale" => Ok(FaultKind::Scale(bare)),
        "noise" => positive(bare >= 0.0, FaultKind::Noise(si)),
        "gust" => Ok(FaultKind::Gust(si)),
        "delay" => positive(bare > 0.0, FaultKind::Delay(bare)),
        "drop" => {
            let part = number.unwrap_or(1.0);
            if (0.0..=1.0).contains(&part) {
                Ok(FaultKind::Drop(part))
            } else {
                Err("a part lies between 0 and 1")
            }
        }
        "flip" => Ok(FaultKind::Flip),
        "nan" => Ok(FaultKind::NotANumber),
        "swap" => Ok(FaultKind::Swap),
        "turn" => Ok(FaultKind::Turn(bare.to_radians())),
        "jump" => Ok(FaultKind::Jump(bare, course)),
        "walk" => Ok(FaultKind::Walk(bare, course)),
        "walkboth" => Ok(FaultKind::WalkBoth(bare, course)),
        "nofix" => Ok(FaultKind::NoFix),
        "flap" => positive(bare > 0.0, FaultKind::Flap(bare)),
        _ => Ok(FaultKind::Height(bare)),
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let t = &self.target;
        let back = |si: f64| si / t.in_si();
        write!(f, "{t}:")?;
        match self.kind {
            FaultKind::StuckAt(v) if v == 0.0 => write!(f, "zero"),
            FaultKind::StuckAt(v) => write!(f, "stuck={}", back(v)),
            FaultKind::Freeze => write!(f, "freeze"),
            FaultKind::Bias(v) => write!(f, "bias={}", back(v)),
            FaultKind::Ramp(v) => write!(f, "ramp={}", back(v)),
            FaultKind::Scale(v) => write!(f, "scale={v}"),
            FaultKind::Noise(v) => write!(f, "noise={}", back(v)),
            FaultKind::Gust(v) => write!(f, "gust={}", back(v)),
            FaultKind::Delay(s) => write!(f, "delay={s}"),
            FaultKind::Drop(p) if p == 1.0 => write!(f, "drop"),
            FaultKind::Drop(p) => write!(f, "drop={p}"),
            FaultKind::Flip => write!(f, "flip"),
            FaultKind::NotANumber => write!(f, "nan"),
            FaultKind::Swap => write!(f, "swap"),
            FaultKind::Turn(by) => write!(f, "turn={}", by.to_degrees()),
            FaultKind::Jump(m, course) => write!(f, "jump={m}/{}", course.to_degrees()),
            FaultKind::Walk(v, course) => write!(f, "walk={v}/{}", course.to_degrees()),
            FaultKind::WalkBoth(v, course) => write!(f, "walkboth={v}/{}", course.to_degrees()),
            FaultKind::NoFix => write!(f, "nofix"),
            FaultKind::Flap(s) => write!(f, "flap={s}"),
            FaultKind::Height(m) => write!(f, "height={m}"),
        }?;
        write!(f, "@{}..", self.from_s)?;
        if self.to_s.is_finite() { write!(f, "{}", self.to_s) } else { Ok(()) }
    }
}
