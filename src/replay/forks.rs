//! One flight, many what-ifs: the navigation with GNSS is run once, and at every start a copy of it goes on its own way.

use crate::pipeline::PipelineSettings;
use crate::sample::Input;

use super::runner::Runner;
use crate::log::{Log, LogError};

/// A what-if: when it leaves the common way, and when it is done, s since the first sample.
#[derive(Clone, Debug)]
pub struct Branch<T> {
    /// When it begins.
    pub from_s: f64,
    /// When it is over.
    pub to_s: f64,
    /// What it is.
    pub what: T,
}

/// A fork is done once samples are later than its end, with some room for late ones, s.
const ROOM_S: f64 = 1.0;

/// Plays a log. `begin` makes of a copy of the common way what a branch is, `watch` sees every branch after every sample with its time,
/// and `done` every one that is over, in no certain order. Returns the common way at its end.
///
/// # Errors
/// What reading the log says.
pub fn play<T>(
    log: &Log,
    settings: &PipelineSettings,
    mut branches: Vec<Branch<T>>,
    begin: impl Fn(&T, &mut Runner),
    mut watch: impl FnMut(&mut T, &Runner, f64),
    mut done: impl FnMut(T, &Runner),
) -> Result<Runner, LogError> {
    branches.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
    let mut waiting = branches.into_iter().peekable();
    let mut common = Runner::new(settings, &[]);
    common.pipeline.follow(log.vehicle());
    let mut forks: Vec<(Branch<T>, Runner)> = Vec::new();
    log.play(
        |_, _| {},
        |clock, item| {
            let now = match item {
                Input::Sample(s) => Some(common.seconds(s.time())),
                _ => None,
            };
            if let Some(t) = now {
                while let Some(branch) = waiting.next_if(|b| b.from_s <= t) {
                    let mut fork = common.fork();
                    begin(&branch.what, &mut fork);
                    forks.push((branch, fork));
                }
                for (branch, fork) in forks.extract_if(.., |(b, _)| t >= b.to_s + ROOM_S) {
                    done(branch.what, &fork);
                }
            }
            common.take(clock, item);
            for (branch, fork) in &mut forks {
                fork.take(clock, item);
                if let Some(t) = now {
                    watch(&mut branch.what, fork, t);
                }
            }
        },
    )?;
    for (branch, fork) in forks {
        done(branch.what, &fork);
    }
    Ok(common)
}

/// `count` starts of intervals of `length_s`, each in one of the flights (from when to when, s) and so long after its beginning, spread evenly
/// over the times that are left to them; none where none fits.
pub fn starts_in(flights: &[(f64, f64)], settle_s: f64, length_s: f64, count: usize) -> Vec<f64> {
    let may_begin: Vec<(f64, f64)> = flights
        .iter()
        .map(|&(from_s, to_s)| (from_s + settle_s, to_s - length_s))
        .filter(|(first, last)| last >= first)
        .collect();
    let room_s: f64 = may_begin.iter().map(|(first, last)| last - first).sum();
    let step = if count > 1 { room_s / (count - 1) as f64 } else { 0.0 };
    let start = |i: usize| {
        let mut into = step * i as f64;
        for (n, (first, last)) in may_begin.iter().enumerate() {
            if into <= last - first || n + 1 == may_begin.len() {
                return Some(first + into);
            }
            into -= last - first;
        }
        None
    };
    (0..count).map_while(start).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn starts_are_spread_over_the_flights_and_none_reaches_over_a_landing() {
        assert_eq!(starts_in(&[(10.0, 140.0)], 30.0, 60.0, 3), [40.0, 60.0, 80.0]);
        assert_eq!(starts_in(&[(10.0, 140.0)], 30.0, 60.0, 1), [40.0]);
        assert_eq!(starts_in(&[(10.0, 99.0)], 30.0, 60.0, 3), [0.0; 0]);
        // The second is too short for one, the third has room for one start alone.
        let flights = [(0.0, 110.0), (120.0, 160.0), (200.0, 290.0), (300.0, 410.0)];
        let starts = starts_in(&flights, 30.0, 60.0, 5);
        assert_eq!(starts, [30.0, 40.0, 50.0, 340.0, 350.0]);
        let inside = |s: f64| flights.iter().any(|(from, to)| s >= from + 30.0 && s + 60.0 <= *to);
        assert!((1..40).flat_map(|n| starts_in(&flights, 30.0, 60.0, n)).all(inside));
    }
}
