//! Many runs on every core, with a progress bar. Shared by the examples.

use indicatif::{ParallelProgressIterator, ProgressBar, ProgressStyle};
use rayon::prelude::*;

/// Runs jobs on every core, with a progress bar; results in the order of the jobs.
pub fn all<J: Sync, R: Send>(
    title: &'static str,
    jobs: &[J],
    work: impl Fn(&J) -> R + Send + Sync,
) -> Vec<R> {
    let style = ProgressStyle::with_template("{prefix} {bar:40} {pos}/{len} {eta}")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    let bar = ProgressBar::new(jobs.len() as u64).with_style(style).with_prefix(title);
    jobs.par_iter().with_max_len(1).progress_with(bar).map(work).collect()
}
