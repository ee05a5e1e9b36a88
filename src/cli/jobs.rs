//! The same work on many logs, on some threads, with a bar where somebody watches.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::sync_channel;
use std::thread;

use super::Failure;
use super::progress::{ProgressUnit, bar};

/// How many threads `asked` for stands for (0: one a core), for so many jobs.
pub(super) fn threads(asked: usize, jobs: usize) -> usize {
    let cores = || thread::available_parallelism().map_or(1, usize::from);
    let wanted = if asked == 0 { cores() } else { asked };
    wanted.clamp(1, jobs.max(1))
}

/// Does `work` on all jobs, `asked` at a time (0: one a core), begun in their order. What came of one is taken here, with its place, as soon
/// as it is done: nothing is kept. `quietly`: without a bar.
///
/// # Errors
/// The first that taking says; then no further job is begun.
pub(super) fn as_done<J: Sync, R: Send>(
    jobs: &[J],
    asked: usize,
    quietly: bool,
    work: impl Fn(&J) -> R + Sync,
    mut take: impl FnMut(usize, R) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let bar = bar(ProgressUnit::Jobs, jobs.len() as u64, quietly);
    let (next, stopped) = (AtomicUsize::new(0), AtomicBool::new(false));
    let threads = threads(asked, jobs.len());
    // Workers wait for who takes, so that what is done does not pile up.
    let (to, from) = sync_channel(threads);
    let taken = thread::scope(|scope| {
        for _ in 0..threads {
            let (to, next, stopped, work) = (to.clone(), &next, &stopped, &work);
            scope.spawn(move || {
                while !stopped.load(Ordering::Relaxed) {
                    let i = next.fetch_add(1, Ordering::Relaxed);
                    let Some(job) = jobs.get(i) else { break };
                    if to.send((i, work(job))).is_err() {
                        break;
                    }
                }
            });
        }
        drop(to);
        let mut taken = Ok(());
        for (i, result) in from {
            bar.inc(1);
            // What is under way is waited for, and lost.
            if taken.is_ok() {
                taken = take(i, result);
                stopped.store(taken.is_err(), Ordering::Relaxed);
            }
        }
        taken
    });
    bar.finish_and_clear();
    taken
}

/// Does `work` on all jobs, `threads` at a time (0: one a core); what came of them, in their order.
///
/// # Errors
/// The first that fails.
pub(super) fn in_parallel<J: Sync, R: Send, E: Send + Into<Failure>>(
    jobs: &[J],
    threads: usize,
    quietly: bool,
    work: impl Fn(&J) -> Result<R, E> + Sync,
) -> Result<Vec<R>, Failure> {
    let mut done: Vec<Option<R>> = jobs.iter().map(|_| None).collect();
    as_done(jobs, threads, quietly, work, |i, result| {
        done[i] = Some(result.map_err(Into::into)?);
        Ok(())
    })?;
    Ok(done.into_iter().flatten().collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_job_is_done_once_and_comes_in_its_place() {
        let jobs: Vec<usize> = (0..500).collect();
        for asked in [0, 1, 7] {
            let done = in_parallel(&jobs, asked, true, |i| Ok::<_, Failure>(i * i)).unwrap();
            assert_eq!(done, jobs.iter().map(|i| i * i).collect::<Vec<_>>());
        }
        assert!(in_parallel(&[] as &[usize], 3, true, |i| Ok::<_, Failure>(*i)).unwrap().is_empty());
    }

    #[test]
    fn after_a_failure_nothing_more_is_begun() {
        let jobs: Vec<usize> = (0..10_000).collect();
        let begun = AtomicUsize::new(0);
        let failed = as_done(
            &jobs,
            2,
            true,
            |_| begun.fetch_add(1, Ordering::Relaxed),
            |_, _| Err(Failure::Other("full".into())),
        );
        assert!(matches!(failed, Err(Failure::Other(_))));
        // Two that were under way, and those that waited for a place.
        assert!(begun.into_inner() < 100);
    }
}
