//! `evaluate --json`: rows are printed as they come, whatever their number; losses and logs without rows, which are few, behind them.

use serde::Serialize;

use crate::fleet::{LogOutcome, NaturalLoss};

use super::super::Failure;
use super::peers::{PeerResults, PeerRow};

/// A log without rows, and why.
#[derive(Clone, Debug, Serialize)]
struct WithoutRows {
    log: String,
    why: String,
}

/// What is printed behind the rows.
#[derive(Default, Serialize)]
struct Behind {
    losses: Vec<NaturalLoss>,
    without_rows: Vec<WithoutRows>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    peers: Vec<PeerRow>,
}

/// The object while it is printed.
pub(super) struct JsonPrinter<'a> {
    peers: &'a PeerResults,
    rows: u64,
    behind: Behind,
}

const BEGIN: &str = "{\"rows\":[";

fn text(value: &impl Serialize) -> Result<String, Failure> {
    serde_json::to_string(value).map_err(|e| Failure::Other(e.to_string()))
}

impl<'a> JsonPrinter<'a> {
    pub(super) fn new(peers: &'a PeerResults) -> Self {
        Self { peers, rows: 0, behind: Behind::default() }
    }

    pub(super) fn add(&mut self, outcome: &LogOutcome) -> Result<(), Failure> {
        for row in &outcome.rows {
            // Nothing is printed before there is something: a command that fails prints nothing.
            out!("{}{}", if self.rows == 0 { BEGIN } else { "," }, text(row)?);
            self.rows += 1;
        }
        self.behind.losses.extend(outcome.losses.iter().cloned());
        self.behind.peers.extend(self.peers.rows(outcome));
        if let Some(failure) = &outcome.failure {
            let (log, why) = (outcome.log.clone(), failure.why.clone());
            self.behind.without_rows.push(WithoutRows { log, why });
        }
        Ok(())
    }

    pub(super) fn finish(self) -> Result<(), Failure> {
        let begin = if self.rows == 0 { BEGIN } else { "" };
        // An object without its first brace.
        let behind = text(&self.behind)?.split_off(1);
        outln!("{begin}],{behind}");
        Ok(())
    }
}
