//! What Holdover can do with a log, by what it holds and by what became of it when it was flown: nothing is promised that was not used.

use crate::log::stretches::Stretches;
use crate::navigator::Navigator;
use crate::sample::{Airframe, SampleKind};

use super::Contents;

/// Fixes over less than this, all stretches together, are nothing to compare with, s: aligning alone takes half of it.
const LEAST_GNSS_S: f64 = 10.0;
/// Half a second after it was measured a flow carries nothing any more: what comes more seldom than this, Hz, never does for long.
const LEAST_FLOW_HZ: f64 = 2.0;

/// What optical flow is good for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum FlowUse {
    /// There is none.
    Unheard,
    /// It comes at this rate, Hz.
    TooSeldom(f64),
    /// The flight has not shown it to be of use, or something is held against it.
    Unproven,
    /// It carries.
    Carries,
}

impl FlowUse {
    /// Of a log that was flown to its end; `carried`: it was measured what flow is worth.
    pub(super) fn of(flow: &Stretches, navigator: &Navigator, carried: bool) -> Self {
        let rate_hz = flow.rate_hz().unwrap_or(0.0);
        if flow.count() == 0 {
            Self::Unheard
        } else if carried {
            Self::Carries
        } else if rate_hz < LEAST_FLOW_HZ {
            Self::TooSeldom(rate_hz)
        } else if navigator.may_carry_on_flow() {
            Self::Carries
        } else {
            Self::Unproven
        }
    }

    fn carries(self) -> bool {
        self == Self::Carries
    }

    /// Why it does not carry.
    fn lacking(self) -> String {
        match self {
            Self::Unheard | Self::Carries => "no optical flow".to_owned(),
            Self::TooSeldom(hz) => {
                format!("optical flow comes at {hz:.1} Hz, and carries at {LEAST_FLOW_HZ} Hz or more")
            }
            Self::Unproven => "optical flow has not proven true".to_owned(),
        }
    }
}

/// What was seen when the log was flown.
#[derive(Clone, Copy, Debug)]
pub(super) struct SeenInFlight {
    pub(super) flow: FlowUse,
    /// Most ranges were of use.
    pub(super) ranged: bool,
    /// Landmarks that are configured.
    pub(super) landmarks: Option<usize>,
}

/// What Holdover can do with it, in words.
pub(super) fn abilities(contents: &Contents, shown: &SeenInFlight) -> Vec<String> {
    let has = |k: SampleKind| contents.streams.of(k).count() > 0;
    let mut can = Vec::new();
    can.push(heading(has(SampleKind::Mag), shown.flow));
    can.push(holdover(contents.airframe, has(SampleKind::Airspeed), shown));
    if has(SampleKind::Landmark) {
        can.push(match shown.landmarks {
            Some(n) => format!("position in holdover from landmarks in view: {n} landmarks are configured"),
            None => "landmarks: a position in holdover, once configured (landmarks.points)".to_owned(),
        });
    }
    if !has(SampleKind::Pressure) {
        can.push("height from GNSS and inertia only: no barometer".to_owned());
    }
    let fixed_s = contents.streams.of(SampleKind::Gnss).covered_s();
    can.push(if contents.truth {
        "score against the simulator's truth".to_owned()
    } else if fixed_s < LEAST_GNSS_S {
        format!("no score: GNSS has fixes over {fixed_s:.1} s alone, and there is no truth in this log")
    } else {
        "score against GNSS (no truth in this log)".to_owned()
    });
    can
}

fn heading(magnetometer: bool, flow: FlowUse) -> String {
    if magnetometer {
        "heading from the magnetometer".to_owned()
    } else if flow.carries() {
        "heading from optical flow against GNSS, while moving (no magnetometer)".to_owned()
    } else {
        format!("heading from GNSS acceleration: needs motion (no magnetometer; {})", flow.lacking())
    }
}

fn holdover(airframe: Option<Airframe>, airspeed: bool, shown: &SeenInFlight) -> String {
    if shown.flow.carries() {
        let height = if shown.ranged { "rangefinder" } else { "altimeter" };
        return format!("holdover on optical flow, its height from the {height}");
    }
    let on = match airframe {
        Some(Airframe::FixedWing) if airspeed => "holdover on airspeed and the wind as GNSS showed it",
        Some(Airframe::Multirotor) => "holdover on rotor drag, as far as it proves true",
        _ => "holdover by inertial coasting only",
    };
    format!("{on}: {}", shown.flow.lacking())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flow_is_promised_where_it_carries_and_named_where_it_does_not() {
        let said = |flow, ranged| {
            let shown = SeenInFlight { flow, ranged, landmarks: None };
            holdover(Some(Airframe::Multirotor), false, &shown)
        };
        assert_eq!(said(FlowUse::Carries, true), "holdover on optical flow, its height from the rangefinder");
        assert_eq!(said(FlowUse::Carries, false), "holdover on optical flow, its height from the altimeter");
        let seldom = said(FlowUse::TooSeldom(0.5), true);
        assert!(seldom.starts_with("holdover on rotor drag") && seldom.contains("at 0.5 Hz"), "{seldom}");
        let unproven = said(FlowUse::Unproven, true);
        assert!(
            unproven.ends_with("as far as it proves true: optical flow has not proven true"),
            "{unproven}"
        );
        assert!(heading(false, FlowUse::TooSeldom(0.5)).starts_with("heading from GNSS acceleration"));
    }

    #[test]
    fn a_flow_that_is_too_seldom_never_carries() {
        use crate::config::{Settings, Sources};
        use crate::time::AutopilotTime;
        let settings = Settings::load(&Sources::default()).unwrap();
        let navigator = Navigator::new(settings.pipeline.navigator);
        let of = |period_ms: i64| {
            let mut flow = Stretches::default();
            (0..50).for_each(|i| flow.note(AutopilotTime::from_micros(i * period_ms * 1000)));
            FlowUse::of(&flow, &navigator, false)
        };
        assert_eq!(of(2000), FlowUse::TooSeldom(0.5));
        assert_eq!(of(100), FlowUse::Unproven);
        assert_eq!(FlowUse::of(&Stretches::default(), &navigator, false), FlowUse::Unheard);
    }
}
