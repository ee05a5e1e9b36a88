//! The matrix of faults that `stress` puts into every flight: what sensors of each kind are known to do.
//!
//! Times are relative to the scored interval, an outage of GNSS unless a case is about GNSS itself.

use crate::fault::{FaultError, InjectedFault};

/// When a case's faults act, relative to the interval that is scored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Timing {
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

impl Timing {
    /// From when to when, s, in an interval of `length_s`.
    fn span_s(self, length_s: f64) -> (f64, f64) {
        match self {
            Timing::Within => (WITHIN_S, length_s),
            Timing::Before => (-LEAD_S, length_s),
            Timing::Hole => (WITHIN_S, WITHIN_S + HOLE_S),
            Timing::WithGnss => (0.0, length_s),
            Timing::Returns => (0.0, 0.5 * length_s),
        }
    }

    fn has_gnss(self) -> bool {
        matches!(self, Timing::WithGnss | Timing::Returns)
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

const MATRIX: &[(Timing, &str)] = &[
    (Timing::Within, "flow:zero"),
    (Timing::Within, "flow:freeze"),
    (Timing::Within, "flow:scale=2"),
    (Timing::Within, "flow:scale=0.5"),
    (Timing::Within, "flow:flip"),
    (Timing::Within, "flow:bias=0.1"),
    (Timing::Within, "flow:noise=0.3"),
    (Timing::Within, "flow:delay=0.3"),
    (Timing::Within, "flow:nan"),
    (Timing::WithGnss, "flow:zero"),
    (Timing::WithGnss, "flow:scale=2"),
    (Timing::Within, "range:stuck=0.7"),
    (Timing::Within, "range:stuck=2"),
    (Timing::Before, "range:stuck=2"),
    (Timing::Within, "range:freeze"),
    (Timing::Within, "range:scale=2"),
    (Timing::Within, "range:noise=2"),
    (Timing::Within, "baro:freeze"),
    (Timing::Within, "baro:bias=5"),
    (Timing::Within, "baro:ramp=0.1"),
    (Timing::Within, "baro:gust=3"),
    (Timing::Within, "baro:drop"),
    (Timing::Within, "baro0:freeze"),
    (Timing::Before, "mag:turn=30"),
    (Timing::Within, "mag:turn=30"),
    (Timing::Within, "mag:turn=90"),
    (Timing::WithGnss, "mag:turn=90"),
    (Timing::WithGnss, "mag:turn=180"),
    (Timing::Within, "mag:freeze"),
    (Timing::Within, "mag:bias=20"),
    (Timing::Within, "mag:drop"),
    (Timing::Within, "gyro.x:freeze"),
    (Timing::Within, "gyro.x:flip"),
    (Timing::Within, "gyro.z:bias=3"),
    (Timing::Within, "gyro.y:bias=1"),
    (Timing::Within, "accel.x:freeze"),
    (Timing::Within, "accel.y:flip"),
    (Timing::Within, "accel.z:bias=1"),
    (Timing::WithGnss, "accel.x:freeze"),
    (Timing::WithGnss, "gyro.x:flip"),
    (Timing::Within, "airspeed:scale=0.7"),
    (Timing::Within, "airspeed:freeze"),
    (Timing::Within, "airspeed:zero"),
    (Timing::WithGnss, "airspeed:scale=0.7"),
    (Timing::WithGnss, "gnss:jump=5"),
    (Timing::WithGnss, "gnss:jump=12"),
    (Timing::WithGnss, "gnss:jump=100"),
    (Timing::WithGnss, "gnss:walk=0.5"),
    (Timing::WithGnss, "gnss:walkboth=0.5"),
    (Timing::WithGnss, "gnss:walkboth=1.2"),
    (Timing::WithGnss, "gnss:walkboth=2"),
    (Timing::Returns, "gnss:walkboth=2"),
    (Timing::Returns, "gnss:jump=12"),
    (Timing::WithGnss, "gnss:freeze"),
    (Timing::WithGnss, "gnss:flap=8"),
    (Timing::WithGnss, "gnss:height=5"),
    (Timing::WithGnss, "gnss:noise=5"),
    (Timing::WithGnss, "gnss0:freeze"),
    (Timing::Hole, "all:drop"),
    (Timing::Within, "all:drop=0.5"),
    (Timing::Within, "flow:zero range:stuck=2"),
    (Timing::Within, "mag:turn=30 baro:gust=3"),
    (Timing::Within, "gyro.z:bias=3 mag:freeze"),
];

/// The whole matrix for intervals of `length_s`.
///
/// # Errors
/// Where a text of it is no fault.
pub fn matrix(length_s: f64) -> Result<Vec<StressCase>, FaultError> {
    MATRIX.iter().map(|(onset, faults)| case(*onset, faults, length_s)).collect()
}

fn case(onset: Timing, text: &str, length_s: f64) -> Result<StressCase, FaultError> {
    let (from_s, to_s) = onset.span_s(length_s);
    let faults = text.split(' ').map(|fault| {
        let parsed: InjectedFault = format!("{fault}@0..1").parse()?;
        Ok(InjectedFault { from_s, to_s, ..parsed })
    });
    let when = match onset {
        Timing::Within | Timing::Hole => "",
        Timing::Before => ", from before",
        Timing::WithGnss => ", with GNSS",
        Timing::Returns => ", and back",
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
