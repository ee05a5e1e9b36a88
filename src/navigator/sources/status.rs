//! What became of everything that every source told: used, waiting or rejected, fused or gated, and how well it fitted.
//!
//! One record a source. Silence is a bug, so all of it is counted, and whoever runs the navigator can see it at any time.

use std::collections::BTreeMap;
use std::fmt;
use strum::VariantArray;

use serde::Serialize;

use crate::sample::{Sample, SampleKind};
use crate::time::AutopilotTime;

use super::super::judge::Charge;
use super::super::observation::{FitScore, Fused};
use super::super::verdict::{Reason, Verdict};
use crate::navigator::tuning::status::{GATE_SIGMA, HEARD_S, LARGEST_RATIO, RATIO_SCALARS};

/// What kind of source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, strum::IntoStaticStr)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum SourceKind {
    /// Gyros and accelerometers.
    #[strum(serialize = "IMU")]
    Imu,
    /// A GNSS receiver.
    #[strum(serialize = "GNSS")]
    Gnss,
    /// A barometer.
    #[strum(serialize = "barometer")]
    Barometer,
    /// A rangefinder.
    #[strum(serialize = "rangefinder")]
    Rangefinder,
    /// The altimeter's height, which the filter takes as a measurement.
    #[strum(serialize = "height")]
    Height,
    /// A magnetometer.
    #[strum(serialize = "magnetometer")]
    Magnetometer,
    /// An optical flow sensor, or a patch of one.
    #[strum(serialize = "optical flow")]
    Flow,
    /// A pitot tube.
    #[strum(serialize = "airspeed")]
    Airspeed,
    /// The rotors' drag, as the accelerometers show it.
    #[strum(serialize = "rotor drag")]
    Drag,
    /// Standing still.
    #[strum(serialize = "standstill")]
    Standstill,
    /// Known landmarks, by camera.
    #[strum(serialize = "landmarks")]
    Landmarks,
}

impl SourceKind {
    /// Name for tables.
    pub fn label(self) -> &'static str {
        self.into()
    }
}

impl From<SampleKind> for SourceKind {
    fn from(kind: SampleKind) -> Self {
        match kind {
            SampleKind::Imu => Self::Imu,
            SampleKind::Mag => Self::Magnetometer,
            SampleKind::Gnss => Self::Gnss,
            SampleKind::Pressure => Self::Barometer,
            SampleKind::Flow => Self::Flow,
            SampleKind::Range => Self::Rangefinder,
            SampleKind::Airspeed => Self::Airspeed,
            SampleKind::Landmark => Self::Landmarks,
        }
    }
}

/// Which source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct SourceId {
    /// What kind.
    pub kind: SourceKind,
    /// Which of its kind, as the autopilot numbers them.
    pub id: u8,
}

impl fmt::Display for SourceId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.kind.label(), self.id)
    }
}

impl SourceId {
    /// One of which there is only one.
    pub(in super::super) const fn only(kind: SourceKind) -> Self {
        Self { kind, id: 0 }
    }

    /// The one that a sample is of.
    pub(in super::super) const fn of(sample: &Sample) -> Self {
        match sample {
            Sample::Imu(_) => Self::only(SourceKind::Imu),
            Sample::Mag(s) => Self { kind: SourceKind::Magnetometer, id: s.sensor },
            Sample::Gnss(s) => Self { kind: SourceKind::Gnss, id: s.receiver },
            Sample::Pressure(s) => Self { kind: SourceKind::Barometer, id: s.sensor },
            Sample::Flow(s) => Self { kind: SourceKind::Flow, id: s.sensor },
            Sample::Range(s) => Self { kind: SourceKind::Rangefinder, id: s.sensor },
            Sample::Airspeed(_) => Self::only(SourceKind::Airspeed),
            Sample::Landmark(s) => Self { kind: SourceKind::Landmarks, id: s.camera },
        }
    }
}

/// What was fused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, strum::IntoStaticStr, strum::VariantArray)]
pub enum Measured {
    /// A GNSS position component.
    #[strum(serialize = "GNSS position")]
    GnssPosition,
    /// A GNSS velocity component.
    #[strum(serialize = "GNSS velocity")]
    GnssVelocity,
    /// A magnetometer vector.
    #[strum(serialize = "magnetometer")]
    Magnetometer,
    /// A flow velocity component.
    #[strum(serialize = "optical flow")]
    Flow,
    /// The height filter's height.
    #[strum(serialize = "height")]
    Height,
    /// Airspeed.
    #[strum(serialize = "airspeed")]
    Airspeed,
    /// No sideslip.
    #[strum(serialize = "sideslip")]
    Sideslip,
    /// Rotor drag along an axis.
    #[strum(serialize = "rotor drag")]
    Drag,
    /// Standing still.
    #[strum(serialize = "standstill")]
    Standstill,
    /// A component of the position that landmarks give.
    #[strum(serialize = "landmark position")]
    LandmarkPosition,
    /// The heading that landmarks give.
    #[strum(serialize = "landmark heading")]
    LandmarkHeading,
}

impl Measured {
    /// All, in the order they are shown.
    pub const ALL: &'static [Self] = Self::VARIANTS;

    /// Name for tables.
    pub fn label(self) -> &'static str {
        self.into()
    }

    /// Whose it is, and which of its two quantities.
    const fn place(self) -> (SourceKind, usize) {
        match self {
            Measured::GnssPosition => (SourceKind::Gnss, 0),
            Measured::GnssVelocity => (SourceKind::Gnss, 1),
            Measured::Magnetometer => (SourceKind::Magnetometer, 0),
            Measured::Flow => (SourceKind::Flow, 0),
            Measured::Height => (SourceKind::Height, 0),
            Measured::Airspeed => (SourceKind::Airspeed, 0),
            Measured::Sideslip => (SourceKind::Airspeed, 1),
            Measured::Drag => (SourceKind::Drag, 0),
            Measured::Standstill => (SourceKind::Standstill, 0),
            Measured::LandmarkPosition => (SourceKind::Landmarks, 0),
            Measured::LandmarkHeading => (SourceKind::Landmarks, 1),
        }
    }
}

/// Count, mean and rejections of one quantity: normalised innovations squared, each counted per scalar.
///
/// Where the filter is honest the mean is 1. Well above: it is too sure of itself. Well below: too cautious.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NisCount {
    /// Scalars fused.
    pub fused: u64,
    /// Measurements outside the gate.
    pub gated: u64,
    sum: f64,
}

impl NisCount {
    /// Mean normalised innovation squared of what was fused.
    pub fn mean(&self) -> Option<f64> {
        (self.fused > 0).then(|| self.sum / self.fused as f64)
    }

    /// Sum of the normalised innovations squared of what was fused.
    pub fn sum(&self) -> f64 {
        self.sum
    }

    fn add(&mut self, other: &Self) {
        self.fused += other.fused;
        self.gated += other.gated;
        self.sum += other.sum;
    }
}

/// Whether a source can be believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[derive(PartialOrd, Ord, strum::IntoStaticStr)]
pub enum SourceHealth {
    /// Nothing speaks against it.
    #[strum(serialize = "healthy")]
    Healthy,
    /// Something does, and it is not used, or with caution, until that is settled.
    #[strum(serialize = "suspect")]
    Suspect,
    /// It was found to be wrong.
    #[strum(serialize = "faulty")]
    Faulty,
    /// It has not been heard for longer than it may be.
    #[strum(serialize = "silent")]
    Silent,
}

impl SourceHealth {
    /// Name for tables.
    pub fn label(self) -> &'static str {
        self.into()
    }

    /// The worse of two.
    pub(super) fn worse(self, other: Self) -> Self {
        self.max(other)
    }
}

/// One source.
#[derive(Clone, Debug)]
pub struct SourceStatus {
    /// Which.
    pub source: SourceId,
    /// When it was last heard, and last used.
    pub last_heard: Option<AutopilotTime>,
    /// See there.
    pub last_used: Option<AutopilotTime>,
    /// Samples that were used.
    pub used: u64,
    rejected: BTreeMap<Reason, u64>,
    quantities: [NisCount; 2],
    /// Innovation over the gate's sigma of late, see [`Self::test_ratio`].
    ratio: f64,
    /// What is held against it, see [`super::super::judge`].
    charge: Option<Charge>,
}

impl SourceStatus {
    fn new(source: SourceId) -> Self {
        Self {
            source,
            last_heard: None,
            last_used: None,
            used: 0,
            rejected: BTreeMap::new(),
            quantities: [NisCount::default(); 2],
            ratio: 0.0,
            charge: None,
        }
    }

    /// Rejections by reason.
    pub fn rejected(&self) -> impl Iterator<Item = (Reason, u64)> + '_ {
        self.rejected.iter().map(|(reason, n)| (*reason, *n))
    }

    /// All that was fused of it.
    pub fn nis(&self) -> NisCount {
        let mut all = self.quantities[0];
        all.add(&self.quantities[1]);
        all
    }

    /// The same by what was fused.
    pub fn quantities(&self) -> impl Iterator<Item = (Measured, NisCount)> + '_ {
        let own = Measured::ALL.iter().filter(|m| m.place().0 == self.source.kind);
        own.map(|m| (*m, self.quantities[m.place().1]))
    }

    /// Innovations of late (RMS over some 20 scalars) over five of their sigmas: above 1 they do not fit. `None` while nothing was
    /// compared.
    pub fn test_ratio(&self) -> Option<f64> {
        let n = self.nis();
        (n.fused + n.gated > 0).then(|| self.ratio.sqrt())
    }

    /// What is held against it.
    pub fn charge(&self) -> Option<Charge> {
        self.charge
    }

    /// By what is held against it alone.
    pub(super) fn charged_health(&self) -> SourceHealth {
        self.charge.map_or(SourceHealth::Healthy, Charge::health)
    }

    /// By how it fitted of late alone.
    pub(super) fn fit(&self) -> SourceHealth {
        if self.test_ratio().is_some_and(|r| r > 1.0) { SourceHealth::Suspect } else { SourceHealth::Healthy }
    }

    fn count(&mut self, time: AutopilotTime, verdict: Verdict) {
        match verdict {
            Verdict::Used => {
                self.used += 1;
                self.last_used = Some(time);
            }
            Verdict::Waiting => {}
            Verdict::Rejected(reason) => *self.rejected.entry(reason).or_default() += 1,
        }
    }

    fn score(&mut self, quantity: usize, now: AutopilotTime, score: FitScore) {
        let count = &mut self.quantities[quantity];
        let squared = match score {
            FitScore::Fused(nis) => {
                count.fused += 1;
                count.sum += nis;
                self.last_used = Some(now);
                nis
            }
            FitScore::Gated(sigmas) => {
                count.gated += 1;
                sigmas * sigmas
            }
        };
        let ratio = (squared / (GATE_SIGMA * GATE_SIGMA)).min(LARGEST_RATIO * LARGEST_RATIO);
        if ratio.is_finite() {
            self.ratio += (ratio - self.ratio) / RATIO_SCALARS;
        }
    }
}

/// A source as it is shown: in `replay --json`, in tables and in the daemon's summary.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SourceReport {
    /// Which kind.
    pub kind: SourceKind,
    /// Which of its kind.
    pub id: u8,
    /// Samples that were used.
    pub used: u64,
    /// Scalars of it that the filter fused, and those that it gated out.
    pub fused: u64,
    /// See there.
    pub gated: u64,
    /// Samples that were rejected, by reason.
    pub rejected: BTreeMap<&'static str, u64>,
    /// Mean normalised innovation squared of what was fused; 1 where the filter is honest.
    pub nis_mean: Option<f64>,
    /// See [`SourceStatus::test_ratio`].
    pub test_ratio: Option<f64>,
    /// Whether it can be believed.
    pub health: SourceHealth,
    /// What is held against it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub charge: Option<Charge>,
}

impl SourceReport {
    pub(in super::super) fn new(status: &SourceStatus, health: SourceHealth) -> Self {
        let nis = status.nis();
        let mut rejected = BTreeMap::new();
        for (reason, n) in status.rejected() {
            *rejected.entry(reason.label()).or_default() += n;
        }
        Self {
            kind: status.source.kind,
            id: status.source.id,
            used: status.used,
            fused: nis.fused,
            gated: nis.gated,
            rejected,
            nis_mean: nis.mean(),
            test_ratio: status.test_ratio(),
            health,
            charge: status.charge(),
        }
    }
}

/// All sources that were ever heard. A source is allocated when it is first heard.
#[derive(Clone, Debug, Default)]
pub struct StatusBoard(Vec<SourceStatus>);

/// SourceSet that are expected; more cost an allocation.
const EXPECTED: usize = 24;

impl StatusBoard {
    pub(in super::super) fn new() -> Self {
        Self(Vec::with_capacity(EXPECTED))
    }

    /// All, in the order in which they were first heard.
    pub fn iter(&self) -> impl Iterator<Item = &SourceStatus> {
        self.0.iter()
    }

    fn of(&mut self, source: SourceId) -> &mut SourceStatus {
        let at = match self.0.iter().position(|s| s.source == source) {
            Some(at) => at,
            None => {
                self.0.push(SourceStatus::new(source));
                self.0.len() - 1
            }
        };
        &mut self.0[at]
    }

    /// A sample of this source was heard, and this came of it.
    pub(in super::super) fn heard(&mut self, source: SourceId, time: AutopilotTime, verdict: Verdict) {
        let status = self.of(source);
        status.last_heard = Some(time);
        status.count(time, verdict);
    }

    /// A sample that had waited.
    pub(in super::super) fn count(&mut self, source: SourceId, time: AutopilotTime, verdict: Verdict) {
        self.of(source).count(time, verdict);
    }

    /// What became of an observation of this source.
    pub(in super::super) fn fused(&mut self, source: SourceId, now: AutopilotTime, fused: &Fused) {
        for (measured, score) in fused.scores() {
            let (kind, quantity) = measured.place();
            let id = if kind == source.kind { source } else { SourceId::only(kind) };
            self.of(id).score(quantity, now, score);
        }
    }

    /// What did not fit until now is explained.
    pub(in super::super) fn explained(&mut self) {
        self.0.iter_mut().for_each(|status| status.ratio = 0.0);
    }

    /// Whether a source of these kinds does not fit that nothing is held against, and that is heard.
    pub(in super::super) fn misfits(&self, now: AutopilotTime, kinds: &[SourceKind]) -> bool {
        let heard = |s: &&SourceStatus| s.last_heard.is_none_or(|t| now.seconds_since(t) < HEARD_S);
        let of = self.0.iter().filter(|s| kinds.contains(&s.source.kind)).filter(heard);
        of.filter(|s| s.charge.is_none()).any(|s| s.fit() != SourceHealth::Healthy)
    }

    /// What is held against a source is now `charge`; what was before.
    pub(in super::super) fn charged(&mut self, source: SourceId, charge: Option<Charge>) -> Option<Charge> {
        std::mem::replace(&mut self.of(source).charge, charge)
    }

    /// What is held against a source: everything that builds on it asks first.
    pub fn charge(&self, source: SourceId) -> Option<Charge> {
        self.0.iter().find(|s| s.source == source).and_then(SourceStatus::charge)
    }

    /// When a source of this kind was heard last.
    pub(in super::super) fn last_heard(&self, kind: SourceKind) -> Option<AutopilotTime> {
        self.of_kind(kind).filter_map(|s| s.last_heard).max()
    }

    /// Samples of a kind that were used.
    pub fn used(&self, kind: SampleKind) -> u64 {
        self.of_kind(kind.into()).map(|s| s.used).sum()
    }

    /// Rejections of a kind by reason.
    pub fn rejected(&self, kind: SampleKind) -> impl Iterator<Item = (Reason, u64)> {
        let mut all: BTreeMap<Reason, u64> = BTreeMap::new();
        for (reason, n) in self.of_kind(kind.into()).flat_map(SourceStatus::rejected) {
            *all.entry(reason).or_default() += n;
        }
        all.into_iter()
    }

    /// How well a quantity fitted.
    pub fn nis(&self, measured: Measured) -> NisCount {
        let (kind, quantity) = measured.place();
        let mut all = NisCount::default();
        self.of_kind(kind).for_each(|s| all.add(&s.quantities[quantity]));
        all
    }

    fn of_kind(&self, kind: SourceKind) -> impl Iterator<Item = &SourceStatus> {
        self.0.iter().filter(move |s| s.source.kind == kind)
    }
}
