//! Faults put into a flight: what a sensor that is stuck, biased, late or lied to would have told instead.
//!
//! An [`InjectedFault`] says which sensor tells what from when to when, as `flow:zero@100..160` ([`text`]); an [`Injector`] alters the samples of a
//! log or of a simulated flight on their way to the navigator, which knows nothing of it. References are never altered: errors are
//! judged by what was really so. The same faults with the same seed give the same samples.
//!
//! ```
//! use holdover::fault::{InjectedFault, Injector};
//! use holdover::sample::{Input, RangeDirection, RangeSample, Sample};
//! use holdover::time::AutopilotTime;
//!
//! let fault: InjectedFault = "range:stuck=0.7@10..20".parse()?;
//! let mut injector = Injector::new(vec![fault], 1);
//! let told = |s: f64, distance_m| Input::Sample(Sample::Range(RangeSample {
//!     time: AutopilotTime::from_micros((s * 1e6) as i64), sensor: 0, direction: RangeDirection::Down, distance_m, limits_m: None,
//! }));
//! assert_eq!(injector.alter(9.9, &told(9.9, 5.0)), Some(told(9.9, 5.0)));
//! assert_eq!(injector.alter(10.0, &told(10.0, 5.1)), Some(told(10.0, 0.7)));
//! # Ok::<(), holdover::fault::FaultError>(())
//! ```

mod alter;
mod gnss;
mod injector;
mod target;
pub mod text;

pub use injector::Injector;
pub use target::{Sensor, Target};
pub use text::FaultError;

/// What a sensor tells instead of what it should, and when.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InjectedFault {
    /// Which sensor, and which of its axes.
    pub target: Target,
    /// What.
    pub kind: FaultKind,
    /// From when, s since the first sample …
    pub from_s: f64,
    /// … to when; not included.
    pub to_s: f64,
}

/// Kinds of faults. Values are in the target's unit, see [`Target::unit`].
#[derive(Clone, Copy, Debug, PartialEq, strum::IntoStaticStr)]
#[strum(serialize_all = "lowercase")]
pub enum FaultKind {
    /// Always this value.
    #[strum(serialize = "stuck")]
    StuckAt(f64),
    /// Always what it told last; stamps go on.
    Freeze,
    /// Off by a constant.
    Bias(f64),
    /// Off by ever more, a second.
    Ramp(f64),
    /// Times a factor.
    Scale(f64),
    /// White noise more, 1 sigma.
    Noise(f64),
    /// Pulses of this height, half a sine of 2 s, every 10 s.
    Gust(f64),
    /// What was so long ago, s, stamped as if it were new.
    Delay(f64),
    /// Nothing; or, of so large a part of the samples, nothing.
    Drop(f64),
    /// The sign is wrong.
    Flip,
    /// No number.
    #[strum(serialize = "nan")]
    NotANumber,
    /// x and y exchanged.
    Swap,
    /// Turned about the body's z axis, rad.
    Turn(f64),
    /// The position is elsewhere by so much, m, on this course, rad; velocities are honest.
    Jump(f64, f64),
    /// The position walks off with so much, m/s, on this course, rad; velocities are honest.
    Walk(f64, f64),
    /// Position and velocity do, and agree.
    WalkBoth(f64, f64),
    /// The receiver says that it has no fix.
    NoFix,
    /// No fix in every other half of this time, s.
    Flap(f64),
    /// The height is off, m.
    Height(f64),
    /// The receiver says that its signals are spoofed, or jammed.
    Spoofed,
    /// See there.
    Jammed,
}

impl FaultKind {
    /// Its name in a fault's text.
    pub fn name(&self) -> &'static str {
        self.into()
    }
}
