//! What the daemon counts itself, beside what links, decoder and session do.

use crate::sample::SampleKind;

/// What the daemon counts itself.
#[derive(Clone, Debug, Default)]
pub(super) struct Counts {
    pub(super) sent: u64,
    pub(super) not_finite: u64,
    pub(super) late: u64,
    pub(super) duplicates: u64,
    /// Measurements that came on links for sensors, and frames there that are none.
    pub(super) sensor_frames: [u64; 2],
    pub(super) heard: [u64; SampleKind::ALL.len()],
}
