//! Many runs on every core, with a progress bar. Shared by the examples.

use std::sync::atomic::{AtomicUsize, Ordering};

use indicatif::{ProgressBar, ProgressStyle};

/// Runs jobs on every core, with a progress bar; results in the order of the jobs.
pub fn all<J: Sync, R: Send>(title: &'static str, jobs: &[J], work: impl Fn(&J) -> R + Sync) -> Vec<R> {
    let style = ProgressStyle::with_template("{prefix} {bar:40} {pos}/{len} {eta}")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    let bar = ProgressBar::new(jobs.len() as u64).with_style(style).with_prefix(title);
    let next = AtomicUsize::new(0);
    let workers = std::thread::available_parallelism().map_or(1, usize::from).min(jobs.len().max(1));
    let mut results: Vec<(usize, R)> = std::thread::scope(|scope| {
        let work_off = || {
            let mut done = Vec::new();
            while let Some((i, job)) =
                Some(next.fetch_add(1, Ordering::Relaxed)).and_then(|i| Some((i, jobs.get(i)?)))
            {
                done.push((i, work(job)));
                bar.inc(1);
            }
            done
        };
        let threads: Vec<_> = (0..workers).map(|_| scope.spawn(work_off)).collect();
        threads.into_iter().flat_map(|t| t.join().unwrap_or_default()).collect()
    });
    bar.finish_and_clear();
    results.sort_by_key(|(i, _)| *i);
    results.into_iter().map(|(_, r)| r).collect()
}
