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

/// `count` starts of intervals of `length_s`, spread evenly between two times; none where it does not fit.
pub fn starts_between(from_s: f64, to_s: f64, length_s: f64, count: usize) -> Vec<f64> {
    let last = to_s - length_s;
    if last < from_s {
        return Vec::new();
    }
    let step = if count > 1 { (last - from_s) / (count - 1) as f64 } else { 0.0 };
    (0..count).map(|i| from_s + step * i as f64).collect()
}
