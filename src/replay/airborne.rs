//! When the vehicle was armed and when it flew, by its own word.

use crate::sample::VehicleStatus;

/// A detector that changes its mind for less than this, s, has seen no landing and no flight.
const MOMENT_S: f64 = 2.0;
/// Periods that are told apart: a vehicle that says more of them has no word to rely on.
const MOST: usize = 256;

/// From when to when something was so, s, in their order.
#[derive(Clone, Debug, Default)]
struct Periods {
    /// When it was told for the first time, so or not.
    first_s: Option<f64>,
    since_s: Option<f64>,
    over: Vec<(f64, f64)>,
}

impl Periods {
    /// At `t_s`, where nothing is known of before `heard_from_s`: the log began then, or it had paused.
    fn note(&mut self, t_s: f64, so: bool, heard_from_s: f64) {
        let first_s = *self.first_s.get_or_insert(t_s);
        match (self.since_s, so) {
            (None, true) => {
                // One that ended a moment ago goes on.
                let goes_on = self.over.pop_if(|last| t_s - last.1 < MOMENT_S);
                self.since_s = Some(goes_on.map_or(t_s, |last| last.0));
            }
            (Some(since_s), false) => {
                self.since_s = None;
                // What is over in the moment in which it is first told of began before the log did, or in its pause.
                let since_s = if first_s == t_s { heard_from_s.min(t_s) } else { since_s };
                if self.over.len() < MOST {
                    self.over.push((since_s, t_s));
                }
            }
            _ => {}
        }
    }

    /// The last one, if it ended just now, was over earlier: nothing was heard since.
    fn ended_before(&mut self, now_s: f64, silent_since_s: f64) {
        if let Some(last) = self.over.last_mut().filter(|last| last.1 == now_s) {
            last.1 = silent_since_s.max(last.0);
        }
    }

    /// All of them, the last one to `end_s` if it is not over.
    fn until(&self, end_s: f64) -> Vec<(f64, f64)> {
        let open = self.since_s.map(|since_s| (since_s, end_s));
        let all = self.over.iter().copied().chain(open);
        all.filter(|(from_s, to_s)| to_s - from_s >= MOMENT_S).collect()
    }
}

/// What the vehicle said of itself.
#[derive(Clone, Debug, Default)]
pub struct ToldFlights {
    armed: Periods,
    in_air: Periods,
    /// Since when nothing was heard, before what is heard now; until the vehicle says that it is armed.
    silent_since_s: Option<f64>,
    /// When it was heard again after the last silence.
    heard_again_s: f64,
}

impl ToldFlights {
    /// It says this, so many seconds after the first sample.
    pub fn note(&mut self, t_s: f64, status: &VehicleStatus) {
        // What it says first after a silence comes before the first sample.
        let t_s = t_s.max(self.heard_again_s);
        if status.armed == Some(true)
            && let Some(since_s) = self.silent_since_s.take()
        {
            // Disarmed and armed in one moment: the first was when it fell silent.
            self.armed.ended_before(t_s, since_s);
            self.in_air.ended_before(t_s, since_s);
        }
        if let Some(armed) = status.armed {
            self.armed.note(t_s, armed, self.heard_again_s);
        }
        // One that is disarmed does not fly, whatever else it says.
        if let Some(landed) = status.landed {
            self.in_air.note(t_s, !landed && status.armed != Some(false), self.heard_again_s);
        }
    }

    /// Nothing was heard of it from `t_s` on for `for_s`, longer than samples are apart, and now something is.
    pub fn fell_silent(&mut self, t_s: f64, for_s: f64) {
        self.silent_since_s = Some(t_s);
        self.heard_again_s = t_s + for_s.max(0.0);
    }

    /// From when to when it was armed, of a log that ends at `end_s`.
    pub fn armed(&self, end_s: f64) -> Vec<(f64, f64)> {
        self.armed.until(end_s)
    }

    /// From when to when it was in the air; none where it does not tell.
    pub fn in_air(&self, end_s: f64) -> Vec<(f64, f64)> {
        self.in_air.until(end_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flights_are_told_apart_and_moments_are_none() {
        let mut told = ToldFlights::default();
        let says = |armed, landed| VehicleStatus { armed, landed, ..VehicleStatus::default() };
        assert_eq!((told.armed(5.0), told.in_air(5.0)), (vec![], vec![]));
        for (t_s, armed, landed) in [
            (0.0, Some(false), None),
            (5.0, Some(true), Some(true)),
            (8.0, Some(true), Some(false)),
            (20.0, Some(true), Some(true)),
            (21.0, Some(true), Some(false)),
            (60.0, Some(true), Some(true)),
            (62.5, Some(true), Some(false)),
            (63.0, Some(true), Some(true)),
            (70.0, Some(true), Some(false)),
            // It falls, and is disarmed before it finds that it lies.
            (90.0, Some(false), Some(false)),
            (95.0, Some(true), Some(true)),
        ] {
            told.note(t_s, &says(armed, landed));
        }
        assert_eq!(told.in_air(100.0), [(8.0, 60.0), (70.0, 90.0)]);
        assert_eq!(told.armed(100.0), [(5.0, 90.0), (95.0, 100.0)]);
    }

    #[test]
    fn a_flight_that_the_log_ends_in_lasts_to_its_end_and_memory_is_bounded() {
        let mut told = ToldFlights::default();
        for i in 0..10_000 {
            let status = VehicleStatus { landed: Some(i % 2 == 1), ..VehicleStatus::default() };
            told.note(f64::from(i) * 10.0, &status);
        }
        assert_eq!(told.in_air(1e6).len(), MOST);
        let mut told = ToldFlights::default();
        told.note(3.0, &VehicleStatus { landed: Some(false), ..VehicleStatus::default() });
        assert_eq!(told.in_air(50.0), [(3.0, 50.0)]);
    }
}
