//! The matrix of faults that `stress` puts into every flight: what sensors of each kind are known to do.
//!
//! Times are relative to the scored interval, an outage of GNSS unless a case is about GNSS itself.

use crate::fault::{FaultError, InjectedFault};

/// When a case's faults act, relative to the interval that is scored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Onset {
    /// Some seconds into the outage, to its end.
    Within,
    /// Long before the outage, to its end.
    Before,
    /// For some seconds in the outage.
    Hole,
    /// From the interval's beginning to its end, GNSS being there.
    WithGnss,
    /// The same in its first half: how it returns is scored.
    Returns,
}

impl Onset {
    /// From when to when, s, in an interval of `length_s`.
    fn span_s(self, length_s: f64) -> (f64, f64) {
        match self {
            Onset::Within => (WITHIN_S, length_s),
            Onset::Before => (-LEAD_S, length_s),
            Onset::Hole => (WITHIN_S, WITHIN_S + HOLE_S),
            Onset::WithGnss => (0.0, length_s),
            Onset::Returns => (0.0, 0.5 * length_s),
        }
    }

    fn has_gnss(self) -> bool {
        matches!(self, Onset::WithGnss | Onset::Returns)
    }
}

/// A fault begins so long after GNSS was lost, s: what is learned at the loss is settled.
const WITHIN_S: f64 = 10.0;
/// A fault begins so long before, s: what GNSS could teach of it is taught.
pub const LEAD_S: f64 = 30.0;
/// Length of a hole, s.
const HOLE_S: f64 = 5.0;

/// A combination of faults over one interval.
#[derive(Clone, Debug, PartialEq)]
pub struct StressCase {
    /// The faults as text, without their times; what is put in for each start has them.
    pub name: String,
    /// Relative to the interval's start.
    pub faults: Vec<InjectedFault>,
    /// GNSS is withheld in the interval.
    pub outage: bool,
}

const MATRIX: &[(Onset, &str)] = &[
    (Onset::Within, "flow:zero"),
    (Onset::Within, "flow:freeze"),
    (Onset::Within, "flow:scale=2"),
    (Onset::Within, "flow:scale=0.5"),
    (Onset::Within, "flow:flip"),
    (Onset::Within, "flow:bias=0.1"),
    (Onset::Within, "flow:noise=0.3"),
    (Onset::Within, "flow:delay=0.3"),
    (Onset::Within, "flow:nan"),
    (Onset::WithGnss, "flow:zero"),
    (Onset::WithGnss, "flow:scale=2"),
    (Onset::Within, "range:stuck=0.7"),
    (Onset::Within, "range:stuck=2"),
    (Onset::Before, "range:stuck=2"),
    (Onset::Within, "range:freeze"),
    (Onset::Within, "range:scale=2"),
    (Onset::Within, "range:noise=2"),
    (Onset::Within, "baro:freeze"),
    (Onset::Within, "baro:bias=5"),
    (Onset::Within, "baro:ramp=0.1"),
    (Onset::Within, "baro:gust=3"),
    (Onset::Within, "baro:drop"),
    (Onset::Within, "baro0:freeze"),
    (Onset::Before, "mag:turn=30"),
    (Onset::Within, "mag:turn=30"),
    (Onset::Within, "mag:turn=90"),
    (Onset::WithGnss, "mag:turn=90"),
    (Onset::WithGnss, "mag:turn=180"),
    (Onset::Within, "mag:freeze"),
    (Onset::Within, "mag:bias=20"),
    (Onset::Within, "mag:drop"),
    (Onset::Within, "gyro.x:freeze"),
    (Onset::Within, "gyro.x:flip"),
    (Onset::Within, "gyro.z:bias=3"),
    (Onset::Within, "gyro.y:bias=1"),
    (Onset::Within, "accel.x:freeze"),
    (Onset::Within, "accel.y:flip"),
    (Onset::Within, "accel.z:bias=1"),
    (Onset::WithGnss, "accel.x:freeze"),
    (Onset::WithGnss, "gyro.x:flip"),
    (Onset::Within, "airspeed:scale=0.7"),
    (Onset::Within, "airspeed:freeze"),
    (Onset::Within, "airspeed:zero"),
    (Onset::WithGnss, "airspeed:scale=0.7"),
    (Onset::WithGnss, "gnss:jump=5"),
    (Onset::WithGnss, "gnss:jump=12"),
    (Onset::WithGnss, "gnss:jump=100"),
    (Onset::WithGnss, "gnss:walk=0.5"),
    (Onset::WithGnss, "gnss:walkboth=0.5"),
    (Onset::WithGnss, "gnss:walkboth=1.2"),
    (Onset::WithGnss, "gnss:walkboth=2"),
    (Onset::Returns, "gnss:walkboth=2"),
    (Onset::Returns, "gnss:jump=12"),
    (Onset::WithGnss, "gnss:freeze"),
    (Onset::WithGnss, "gnss:flap=8"),
    (Onset::WithGnss, "gnss:height=5"),
    (Onset::WithGnss, "gnss:noise=5"),
    (Onset::WithGnss, "gnss0:freeze"),
    (Onset::Hole, "all:drop"),
    (Onset::Within, "all:drop=0.5"),
    (Onset::Within, "flow:zero range:stuck=2"),
    (Onset::Within, "mag:turn=30 baro:gust=3"),
    (Onset::Within, "gyro.z:bias=3 mag:freeze"),
];

/// The whole matrix for intervals of `length_s`.
///
/// # Errors
/// Where a text of it is no fault.
pub fn matrix(length_s: f64) -> Result<Vec<StressCase>, FaultError> {
    MATRIX.iter().map(|(onset, faults)| case(*onset, faults, length_s)).collect()
}

fn case(onset: Onset, text: &str, length_s: f64) -> Result<StressCase, FaultError> {
    let (from_s, to_s) = onset.span_s(length_s);
    let faults = text.split(' ').map(|fault| {
        let parsed: InjectedFault = format!("{fault}@0..1").parse()?;
        Ok(InjectedFault { from_s, to_s, ..parsed })
    });
    let when = match onset {
        Onset::Within | Onset::Hole => "",
        Onset::Before => ", from before",
        Onset::WithGnss => ", with GNSS",
        Onset::Returns => ", and back",
    };
    Ok(StressCase {
        name: format!("{text}{when}"),
        faults: faults.collect::<Result<_, _>>()?,
        outage: !onset.has_gnss(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::{FaultKind, Sensor};

    #[test]
    fn the_matrix_has_faults_of_every_sensor_that_flies_and_none_twice() {
        let cases = matrix(60.0).unwrap();
        for sensor in [
            Sensor::Flow,
            Sensor::Range,
            Sensor::Baro,
            Sensor::Mag,
            Sensor::Gyro,
            Sensor::Accel,
            Sensor::Airspeed,
            Sensor::Gnss,
            Sensor::All,
        ] {
            assert!(cases.iter().any(|c| c.faults.iter().any(|f| f.target.sensor == sensor)), "{sensor:?}");
        }
        let mut names: Vec<_> = cases.iter().map(|c| &c.name).collect();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), cases.len());
        let hole = cases.iter().find(|c| c.name == "all:drop").unwrap();
        assert_eq!((hole.outage, hole.faults[0].kind), (true, FaultKind::Drop(1.0)));
        assert_eq!((hole.faults[0].from_s, hole.faults[0].to_s), (10.0, 15.0));
    }
}
