//! The tables for people, filled log by log: what is held of a log is its lines.

use std::fmt;
use std::path::Path;

use crate::fleet::{LogOutcome, NaturalLoss};
use crate::navigator::settings::Estimator;
use crate::replay::runner::ReferenceKind;
use crate::replay::sweep::SweepRow;

use super::super::table::{Table, median, number};
use super::peers::{OutageWindow, PeerResults};

/// The tables of an evaluation.
pub(super) struct Tables<'a> {
    lengths_s: Vec<f64>,
    peers: &'a PeerResults,
    outages: Table,
    losses: Table,
    any_loss: bool,
    honesty: Vec<Honesty>,
}

impl<'a> Tables<'a> {
    pub(super) fn new(lengths_s: &[f64], peers: &'a PeerResults) -> Self {
        let mut header: Vec<String> = [
            "log",
            "estimator",
            "length s",
            "n",
            "median m",
            "worst m",
            "drift %",
            "error/sigma",
            "altitude m",
        ]
        .map(str::to_owned)
        .to_vec();
        for peer in peers.names() {
            header.extend(["median m", "worst m", "n", "ours less"].map(|of| format!("{peer}: {of}")));
        }
        let header: Vec<&str> = header.iter().map(String::as_str).collect();
        let losses = ["log", "estimator", "at s", "length s", "error m", "sigma m", "own m", "against"];
        Self {
            lengths_s: lengths_s.to_vec(),
            peers,
            outages: Table::new(&header),
            losses: Table::new(&losses),
            any_loss: false,
            honesty: Estimator::ALL.iter().map(|_| Honesty::default()).collect(),
        }
    }

    /// Adds a log's lines.
    pub(super) fn add(&mut self, outcome: &LogOutcome) {
        for (&estimator, honesty) in Estimator::ALL.iter().zip(&mut self.honesty) {
            let own: Vec<&SweepRow> =
                outcome.rows.iter().filter(|r| r.estimator == estimator.label()).map(|r| &r.row).collect();
            own.iter().for_each(|row| honesty.add(row));
            for &length_s in &self.lengths_s {
                let group: Vec<&SweepRow> = own.iter().copied().filter(|r| r.length_s == length_s).collect();
                if !group.is_empty() {
                    let mut cells = cells(&outcome.log, estimator, length_s, &group);
                    let windows: Vec<OutageWindow> = group
                        .iter()
                        .filter_map(|r| {
                            Some(OutageWindow { start_s: r.start_s, error_m: r.horizontal_error_end_m? })
                        })
                        .collect();
                    for beside in self.peers.beside(&outcome.log, length_s, &windows) {
                        cells.extend([
                            number(beside.and_then(|b| b.median_m), 1),
                            number(beside.and_then(|b| b.worst_m), 1),
                            beside.and_then(|b| b.n).map_or_else(|| "-".to_owned(), |n| n.to_string()),
                            beside
                                .and_then(|b| b.ours_less)
                                .map_or_else(|| "-".to_owned(), |n| n.to_string()),
                        ]);
                    }
                    self.outages.row(cells);
                }
            }
        }
        for loss in &outcome.losses {
            self.any_loss = true;
            self.losses.row(loss_cells(loss));
        }
    }

    pub(super) fn print(&self) {
        outln!(
            "Horizontal error at the end of an outage: median / worst m, drift in % of distance (median), error over sigma (median)"
        );
        self.outages.print();
        for (&estimator, honesty) in Estimator::ALL.iter().zip(&self.honesty) {
            if honesty.outages > 0 {
                outln!("  {}: {honesty}", estimator.label());
            }
        }
        if self.any_loss {
            // There the autopilot's own filter is a peer: in the outages above it had GNSS.
            outln!(
                "\nLosses of GNSS in the logs themselves; \"own\" is the autopilot's own estimate, which had no GNSS either"
            );
            self.losses.print();
        }
    }
}

fn short(log: &str) -> String {
    Path::new(log).file_stem().map_or_else(|| log.to_owned(), |s| s.to_string_lossy().into_owned())
}

fn cells(log: &str, estimator: Estimator, length_s: f64, group: &[&SweepRow]) -> Vec<String> {
    let of = |f: fn(&SweepRow) -> Option<f64>| -> Vec<f64> { group.iter().filter_map(|r| f(r)).collect() };
    let errors = of(|r| r.horizontal_error_end_m);
    let worst = errors.iter().copied().reduce(f64::max);
    let ratio = of(|r| Some(r.horizontal_error_end_m? / r.sigma_end_m.filter(|s| *s > 0.0)?));
    vec![
        short(log),
        estimator.label().into(),
        format!("{length_s}"),
        errors.len().to_string(),
        number(median(errors), 1),
        number(worst, 1),
        number(median(of(|r| r.drift_percent)), 2),
        number(median(ratio), 2),
        number(median(of(|r| r.altitude_rmse_m)), 2),
    ]
}

fn loss_cells(loss: &NaturalLoss) -> Vec<String> {
    vec![
        short(&loss.log),
        loss.estimator.clone(),
        number(Some(loss.row.start_s), 1),
        number(Some(loss.row.length_s), 1),
        number(loss.row.error_m, 1),
        number(loss.row.sigma_m, 1),
        number(loss.row.own_error_m, 1),
        match loss.row.reference {
            ReferenceKind::Truth => "truth".into(),
            ReferenceKind::Gnss => "the first fix".into(),
        },
    ]
}

/// Whether what was claimed was true, over many outages.
#[derive(Clone, Copy, Debug, Default)]
struct Honesty {
    outages: usize,
    /// Errors within two and within four of their sigmas.
    within: [usize; 2],
    /// Sums of the squares of sigma and of the error, m².
    squares_m2: [f64; 2],
}

impl Honesty {
    fn add(&mut self, row: &SweepRow) {
        let (Some(error), Some(sigma)) =
            (row.horizontal_error_end_m, row.sigma_end_m.filter(|sigma| *sigma > 0.0))
        else {
            return;
        };
        self.outages += 1;
        for (within, k) in self.within.iter_mut().zip([2.0, 4.0]) {
            *within += usize::from(error <= k * sigma);
        }
        self.squares_m2[0] += sigma.powi(2);
        self.squares_m2[1] += error.powi(2);
    }
}

impl fmt::Display for Honesty {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [two, four] = self.within.map(|n| 100.0 * n as f64 / self.outages as f64);
        let caution = (self.squares_m2[0] / self.squares_m2[1]).sqrt();
        write!(
            f,
            "{} outages, {two:.1} % of the errors within 2 sigma, {four:.1} % within 4, sigma {caution:.1} times the error (RMS)",
            self.outages
        )
    }
}
