//! The rows of both tables, and what their columns are.

use crate::geo::so3::Euler;
use crate::navigator::solution::Solution;
use crate::navigator::sources::status::SourceReport;

/// What kind of values a column has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColumnKind {
    /// A number.
    Number,
    /// A whole number.
    Count,
    /// Words.
    Words,
}

/// A column: its name, with the unit, and what kind of values it has.
pub type Column = (&'static str, ColumnKind);

/// What stands in a row's column.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum RowValue {
    /// Nothing is known.
    Unknown,
    Number(f64),
    Count(u64),
    Words(String),
}

impl From<Option<f64>> for RowValue {
    fn from(value: Option<f64>) -> Self {
        value.filter(|v| v.is_finite()).map_or(Self::Unknown, Self::Number)
    }
}

use ColumnKind::{Count, Number, Words};

/// The solution: position and velocity in the local frame (north, east, down), angles, and what is claimed.
pub(super) const SOLUTION: &[Column] = &[
    ("t_s", Number),
    ("mode", Words),
    ("carrier", Words),
    ("north_m", Number),
    ("east_m", Number),
    ("down_m", Number),
    ("velocity_north_mps", Number),
    ("velocity_east_mps", Number),
    ("velocity_down_mps", Number),
    ("roll_deg", Number),
    ("pitch_deg", Number),
    ("yaw_deg", Number),
    ("sigma_horizontal_m", Number),
    ("sigma_down_m", Number),
    ("sigma_velocity_mps", Number),
    ("sigma_yaw_deg", Number),
    ("reset_counter", Count),
];

/// A source: what became of what it told, since the beginning.
pub(super) const SOURCES: &[Column] = &[
    ("t_s", Number),
    ("source", Words),
    ("id", Count),
    ("health", Words),
    ("charge", Words),
    ("used", Count),
    ("rejected", Count),
    ("fused", Count),
    ("gated", Count),
    ("nis_mean", Number),
    ("test_ratio", Number),
];

/// A row of the solution at `t_s` since the first sample.
pub(super) fn solution(t_s: f64, s: &Solution) -> Vec<RowValue> {
    let angles = Euler::from_rotation(s.attitude.matrix());
    let (p, v) = (s.position.raw(), s.velocity.raw());
    let (of_p, of_v) = (s.position_covariance.raw(), s.velocity_covariance.raw());
    let number = |value: f64| RowValue::from(Some(value));
    let mut row = vec![
        number(t_s),
        RowValue::Words(s.mode.label().to_owned()),
        RowValue::Words(s.velocity_source.label().to_owned()),
    ];
    row.extend(p.iter().chain(&v).copied().map(number));
    row.extend([angles.roll_rad, angles.pitch_rad, angles.yaw_rad].map(|a| number(a.to_degrees())));
    row.extend([
        number(s.horizontal_sigma_m()),
        number(of_p[(2, 2)].max(0.0).sqrt()),
        number((of_v[(0, 0)] + of_v[(1, 1)]).max(0.0).sqrt()),
        number(s.attitude_variance.z.max(0.0).sqrt().to_degrees()),
        RowValue::Count(u64::from(s.reset_counter)),
    ]);
    row
}

/// A row of a source.
pub(super) fn source(t_s: f64, r: &SourceReport) -> Vec<RowValue> {
    vec![
        RowValue::from(Some(t_s)),
        RowValue::Words(r.kind.label().to_owned()),
        RowValue::Count(u64::from(r.id)),
        RowValue::Words(r.health.label().to_owned()),
        r.charge.map_or(RowValue::Unknown, |charge| RowValue::Words(charge.label().to_owned())),
        RowValue::Count(r.used),
        RowValue::Count(r.rejected.values().sum()),
        RowValue::Count(r.fused),
        RowValue::Count(r.gated),
        RowValue::from(r.nis_mean),
        RowValue::from(r.test_ratio),
    ]
}
