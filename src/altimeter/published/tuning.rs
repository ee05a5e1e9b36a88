//! What the published altimeters need and their paper leaves open, with reasons; the paper's own numbers are in
//! [`super::ErrorModel::table_1`].

/// Bound on the normalised innovation in (32): the paper's.
pub(super) const NORMAL_SIGMAS: f64 = 3.0;
/// A weight below this is a rejection, where samples are counted as used or rejected: about 5 σ.
pub(super) const LEAST_PROB: f64 = 0.02;
/// Altitude differences beyond this are no heights, m: an inertial altitude with 1 m/s² of error runs that far in half a day.
pub(super) const LARGEST_M: f64 = 1e9;
/// Variance of an altitude of which nothing is known any more, m²: from here on time stands still, for (11) grows without bound.
pub(super) const LOST_VARIANCE: f64 = LARGEST_M * LARGEST_M;
/// An interval beyond this is no interval between measurements, s: it is cut.
pub(super) const LONGEST_INTERVAL_S: f64 = 86_400.0;
/// An interval is divided into no more steps than this, so that none costs more: its steps are longer then.
pub(super) const MOST_STEPS: f64 = 20_000.0;

/// Innovations that the selector looks at together: the paper has them every 0.5 s, so 10 s.
pub(super) const WINDOW: usize = 20;
/// Bound on Σν² of a full window: the χ² distribution with 20 degrees of freedom is beyond it once in 30 000 windows. An innovation of
/// 7.5 σ, three of 4.4 σ, or noise of 1.7 times its standard deviation exceed it.
pub(super) const SQUARES: f64 = 56.0;
/// Bound on |Σν|/√n: a normal number is beyond it once in 150 000. Finds a bias of 1 σ after 20 innovations.
pub(super) const SUM: f64 = 4.5;
/// The same for a faulty channel to be healthy again: the longer the doubt about the prediction grows the more bias it lets pass, so this is
/// as narrow as a channel that is healthy allows.
pub(super) const SUM_BACK: f64 = 2.5;
