//! Whether the autopilot's frame begins where GPS_GLOBAL_ORIGIN says.
//!
//! Everything that is sent is told from that origin: one that moves in flight moves every position by as much. So it is taken at once only where
//! nothing speaks against it, on the ground or before any was told, and where it moves by no more than the uncertainty. In flight the autopilot's own
//! positions have to move with it: its place in its frame, LOCAL_POSITION_NED, taken from its place on Earth, which is what it tells itself
//! (GLOBAL_POSITION_INT) or, where it does not, our solution, is where its frame begins. An autopilot that sets its origin anew tells another
//! local position from that moment on, and within a second its origin is taken. Until then the one before is used. Where no position comes, nothing else
//! depends on the origin, and telling it again is no evidence: one that moves in flight is not used before the vehicle is disarmed. The first of all is,
//! when it is told for seconds, since without any there is no frame to share.

use nalgebra::Vector3;

use crate::geo::{Geodetic, LocalNed, Ned};
use crate::navigator::solution::{Mode, Solution};
use crate::sample::Reference;
use crate::time::AutopilotTime;

/// The least and the most that an origin may move by without anything else, m; between them it is the solution's standard deviation.
const SHIFT_M: [f64; 2] = [0.5, 3.0];
/// On the ground the autopilot's own two positions contradict an origin that lies further off, horizontally, m.
const OWN_M: f64 = 20.0;
/// Two positions that are compared are no further apart, s.
const PAIRED_S: f64 = 0.3;
/// A position is of the present for this long, s.
const FRESH_S: f64 = 2.0;
/// Positions in a row that have to agree with the new origin, and the time that they come over, s.
const AGREE: u32 = 3;
const AGREE_S: f64 = 0.3;
/// Tellings of an origin that no position confirms or denies, and the time that they come over, s.
const TOLD: u32 = 5;
const TOLD_S: f64 = 5.0;
/// Gain of where the frame begins as a rule.
const GAIN: f64 = 0.1;
/// A contradiction is told once in this time, s.
const EVERY_S: f64 = 30.0;

/// What to do with an origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OriginWord {
    /// The frame's origin is there.
    Take(Geodetic),
    /// It contradicts the autopilot's own positions; by how much it would move, m.
    Contradicted(f64),
}

/// Where the frame begins by one kind of evidence: as a rule, and in the newest comparison, NED of our frame, m.
#[derive(Clone, Copy, Debug, Default)]
struct OriginEvidence {
    usual: Option<Vector3<f64>>,
    newest: Option<(AutopilotTime, Vector3<f64>)>,
}

impl OriginEvidence {
    fn hear(&mut self, time: AutopilotTime, begins_ned: Vector3<f64>, waits: bool) {
        self.newest = Some((time, begins_ned));
        if !waits {
            let usual = self.usual.get_or_insert(begins_ned);
            *usual += (begins_ned - *usual) * GAIN;
        }
    }

    fn fresh(&self, now: AutopilotTime) -> Option<Vector3<f64>> {
        self.newest.filter(|(t, _)| now.seconds_since(*t) <= FRESH_S).map(|(_, begins)| begins)
    }

    fn moved(&mut self, moved_ned: &Vector3<f64>) {
        if let Some((_, begins)) = &mut self.newest {
            *begins -= moved_ned;
        }
    }
}

/// An origin that waits for its confirmation.
#[derive(Clone, Copy, Debug)]
struct WaitingOrigin {
    origin: Geodetic,
    since: AutopilotTime,
    told: u32,
    /// Since when positions agree with it, and how many.
    agreed: Option<(AutopilotTime, u32)>,
}

/// See the module's documentation.
#[derive(Clone, Debug, Default)]
pub struct OriginWatch {
    /// The origin that was believed last: small shifts are counted from there.
    anchor: Option<Geodetic>,
    waiting: Option<WaitingOrigin>,
    /// By the autopilot's own place on Earth, and by our solution.
    own: OriginEvidence,
    ours: OriginEvidence,
    global: Option<(AutopilotTime, Geodetic, Vector3<f64>)>,
    disarmed: bool,
    contradicted: Option<AutopilotTime>,
}

impl OriginWatch {
    /// Nothing was told.
    pub fn new() -> Self {
        Self::default()
    }

    /// Whether the vehicle says that it is disarmed.
    pub fn set_disarmed(&mut self, disarmed: bool) {
        self.disarmed = disarmed;
    }

    /// The autopilot told an origin. `frame` is ours, where it has a place on Earth; `sigma_m` what its horizontal position is uncertain by.
    pub fn hear(
        &mut self,
        now: AutopilotTime,
        origin: &Geodetic,
        frame: Option<&LocalNed>,
        sigma_m: f64,
    ) -> Option<OriginWord> {
        let Some(frame) = frame.filter(|_| origin.is_plausible()) else {
            return Some(self.take(origin, None));
        };
        let moved_ned = frame.to_ned(origin);
        let allowed_m = sigma_m.clamp(SHIFT_M[0], SHIFT_M[1]);
        if let Some(anchor) = self.anchor {
            if LocalNed::new(anchor).to_ned(origin).norm() <= allowed_m {
                self.waiting = None;
                return Some(OriginWord::Take(*origin));
            }
        } else if moved_ned.norm() <= allowed_m {
            return Some(self.take(origin, None));
        }
        let first = self.anchor.is_none();
        if (first || self.disarmed) && !self.is_denied(now, &moved_ned, first) {
            return Some(self.take(origin, Some((&moved_ned, first))));
        }
        self.wait(now, origin, frame)
    }

    /// The autopilot's own positions say that it is not there.
    fn is_denied(&self, now: AutopilotTime, moved_ned: &Vector3<f64>, first: bool) -> bool {
        let far = |begins: Vector3<f64>, m: f64| (begins - moved_ned).xy().norm() > m;
        let in_flight = first && !self.disarmed;
        self.own.fresh(now).is_some_and(|begins| far(begins, OWN_M))
            || (in_flight && self.ours.fresh(now).is_some_and(|begins| far(begins, OWN_M)))
    }

    fn take(&mut self, origin: &Geodetic, moved: Option<(&Vector3<f64>, bool)>) -> OriginWord {
        self.anchor = Some(*origin);
        self.waiting = None;
        if let Some((moved_ned, first)) = moved {
            for evidence in [&mut self.own, &mut self.ours] {
                evidence.moved(moved_ned);
                // Where the frame begins as a rule is told from the frame's origin, which only the first one moves against it.
                evidence.usual = evidence.usual.map(|u| if first { u - moved_ned } else { u });
            }
        }
        OriginWord::Take(*origin)
    }

    fn wait(&mut self, now: AutopilotTime, origin: &Geodetic, frame: &LocalNed) -> Option<OriginWord> {
        let same = |w: &WaitingOrigin| LocalNed::new(w.origin).to_ned(origin).norm() <= SHIFT_M[0];
        let new = WaitingOrigin { origin: *origin, since: now, told: 0, agreed: None };
        let waiting = self.waiting.insert(self.waiting.filter(same).unwrap_or(new));
        waiting.told += 1;
        let lasts = waiting.told >= TOLD && now.seconds_since(waiting.since) >= TOLD_S;
        if !lasts || self.own.fresh(now).is_some() || self.ours.fresh(now).is_some() {
            return None;
        }
        let moved_ned = frame.to_ned(origin);
        if self.anchor.is_some() {
            return self.contradict(now, moved_ned.norm());
        }
        Some(self.take(origin, Some((&moved_ned, true))))
    }

    /// The autopilot's own estimate; `solution` is ours.
    pub fn reference(
        &mut self,
        reference: &Reference,
        solution: &Solution,
        frame: Option<&LocalNed>,
    ) -> Option<OriginWord> {
        let frame = frame?;
        let (time, local) = match reference {
            Reference::Global { time, position, velocity } => {
                self.global = Some((*time, *position, velocity.raw()));
                return None;
            }
            Reference::Local { time, position, .. } => (*time, position.raw()),
            _ => return None,
        };
        let waits = self.waiting.is_some();
        if let Some((then, place, velocity)) = self.global
            && time.seconds_since(then).abs() <= PAIRED_S
        {
            let here = frame.to_ned(&place) + velocity * time.seconds_since(then);
            self.own.hear(time, here - local, waits);
        }
        let known = matches!(solution.mode, Mode::Aided | Mode::Holdover | Mode::Rejoining);
        let age_s = solution.time.seconds_since(time);
        if known && age_s.abs() <= PAIRED_S {
            let here: Ned<Vector3<f64>> = solution.position - solution.velocity * age_s;
            self.ours.hear(time, here.raw() - local, waits);
        }
        self.judge(time, frame)
    }

    /// Whether the autopilot's place in its frame has moved with the origin that waits.
    fn judge(&mut self, now: AutopilotTime, frame: &LocalNed) -> Option<OriginWord> {
        let mut waiting = self.waiting?;
        let moved_ned = frame.to_ned(&waiting.origin);
        let told = self.anchor.is_some();
        let evidence = if self.own.fresh(now).is_some() { &self.own } else { &self.ours };
        let begins = evidence.fresh(now)?;
        // What the two filters differ by as a rule is no move. Before any origin was told there is no rule.
        let seen = if told { begins - evidence.usual.unwrap_or_default() } else { begins };
        let agrees = if told {
            (seen - moved_ned).norm() <= 0.5 * seen.norm()
        } else {
            (seen - moved_ned).xy().norm() <= OWN_M
        };
        if !agrees {
            waiting.agreed = None;
            self.waiting = Some(waiting);
            return self.contradict(now, moved_ned.norm());
        }
        let (since, times) = waiting.agreed.map_or((now, 1), |(since, times)| (since, times + 1));
        waiting.agreed = Some((since, times));
        self.waiting = Some(waiting);
        let confirmed = times >= AGREE && now.seconds_since(since) >= AGREE_S;
        confirmed.then(|| self.take(&waiting.origin, Some((&moved_ned, !told))))
    }

    fn contradict(&mut self, now: AutopilotTime, moved_m: f64) -> Option<OriginWord> {
        if self.contradicted.is_some_and(|t| now.seconds_since(t) < EVERY_S) {
            return None;
        }
        self.contradicted = Some(now);
        Some(OriginWord::Contradicted(moved_m))
    }
}

#[cfg(test)]
mod tests;
