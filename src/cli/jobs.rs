//! The same work on many logs, on some threads, with a bar where somebody watches.

use std::io::IsTerminal;

use indicatif::{ParallelProgressIterator, ProgressBar, ProgressStyle};
use rayon::ThreadPoolBuilder;
use rayon::prelude::*;

use super::Failure;

/// Does `work` on all jobs, `threads` at a time (0: one a core); what came of them, in their order. `quietly`: without a bar.
///
/// # Errors
/// The first job's, in their order, that fails.
pub(super) fn in_parallel<J: Sync, R: Send, E: Send + Into<Failure>>(
    jobs: &[J],
    threads: usize,
    quietly: bool,
    work: impl Fn(&J) -> Result<R, E> + Sync,
) -> Result<Vec<R>, Failure> {
    let bar = if quietly || !std::io::stderr().is_terminal() {
        ProgressBar::hidden()
    } else {
        let style = ProgressStyle::with_template("{bar:40} {pos}/{len} {msg} {eta}");
        ProgressBar::new(jobs.len() as u64).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
    };
    let pool = ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = pool.map_err(|e| Failure::Other(e.to_string()))?;
    let done: Vec<Result<R, E>> =
        pool.install(|| jobs.par_iter().with_max_len(1).progress_with(bar.clone()).map(&work).collect());
    bar.finish_and_clear();
    done.into_iter().map(|result| result.map_err(Into::into)).collect()
}
