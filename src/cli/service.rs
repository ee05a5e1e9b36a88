//! What the service manager is told (sd_notify): that it runs, that it is about to end, and that it is alive.

use sd_notify::NotifyState;

/// Tells it, where there is one that listens. One that cannot be told changes nothing.
pub(super) fn tell(state: NotifyState<'_>) {
    if let Err(error) = sd_notify::notify(&[state]) {
        tracing::debug!("the service manager is not told: {error}");
    }
}
