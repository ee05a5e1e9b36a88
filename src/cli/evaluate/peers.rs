//! Results of somebody else's filter on the same flights, to stand beside ours.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::fleet::LogOutcome;
use crate::navigator::settings::Estimator;

use super::super::Failure;
use super::super::table::median;

/// A peer's outage is the same as ours if it begins within this, s.
const SAME_START_S: f64 = 0.5;
/// Lengths that differ by less are one, s.
const SAME_LENGTH_S: f64 = 0.01;
/// What a peer without a name is called.
const UNNAMED: &str = "peer";

/// A line of the file: one outage, or, without `start_s`, the median of several.
#[derive(Clone, Debug, Deserialize)]
struct PeerLine {
    #[serde(default)]
    peer: Option<String>,
    log: String,
    length_s: f64,
    #[serde(default)]
    start_s: Option<f64>,
    error_m: f64,
    /// Of several outages the worst.
    #[serde(default)]
    worst_m: Option<f64>,
}

/// One of our outages.
#[derive(Clone, Copy, Debug)]
pub(super) struct OutageWindow {
    pub(super) start_s: f64,
    pub(super) error_m: f64,
}

/// What a peer has beside some of our outages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct Beside {
    /// Outages that both have; `None` where only the peer's median is told.
    pub(super) n: Option<usize>,
    /// The peer's error, median and worst, m.
    pub(super) median_m: Option<f64>,
    pub(super) worst_m: Option<f64>,
    /// In how many of them our error is less.
    pub(super) ours_less: Option<usize>,
}

/// A line of `--json`.
#[derive(Clone, Debug, Serialize)]
pub(super) struct PeerRow {
    log: String,
    peer: String,
    estimator: &'static str,
    length_s: f64,
    #[serde(flatten)]
    beside: Beside,
}

/// The results of peers, by name and log.
#[derive(Clone, Debug, Default)]
pub(super) struct PeerResults {
    peers: BTreeMap<String, BTreeMap<String, Vec<PeerLine>>>,
}

/// What a log is called here and there: the file's name without folders and endings.
fn stem(log: &str) -> &str {
    let name = log.rsplit('/').next().unwrap_or(log);
    const ENDINGS: [&str; 7] = [".gz", ".zst", ".raw", ".tlog", ".ulg", ".bin", ".BIN"];
    ENDINGS.iter().fold(name, |name, ending| name.strip_suffix(ending).unwrap_or(name))
}

impl PeerResults {
    /// Reads the files.
    ///
    /// # Errors
    /// [`Failure::Usage`] with the line that is wrong.
    pub(super) fn read(paths: &[PathBuf]) -> Result<Self, Failure> {
        let mut all = Self::default();
        for path in paths {
            all.read_one(path)?;
        }
        Ok(all)
    }

    fn read_one(&mut self, path: &Path) -> Result<(), Failure> {
        let wrong = |why: String| Failure::Usage(format!("--peer {}: {why}", path.display()));
        let mut reader = csv::ReaderBuilder::new()
            .trim(csv::Trim::All)
            .comment(Some(b'#'))
            .from_path(path)
            .map_err(|e| wrong(e.to_string()))?;
        for line in reader.deserialize() {
            let line: PeerLine = line.map_err(|e| wrong(e.to_string()))?;
            let numbers = [Some(line.length_s), line.start_s, Some(line.error_m), line.worst_m];
            if numbers.into_iter().flatten().any(|v| !v.is_finite() || v < 0.0) || line.length_s == 0.0 {
                return Err(wrong(format!(
                    "{}: lengths and errors are numbers of m and s, not below 0",
                    line.log
                )));
            }
            let name = line.peer.clone().filter(|n| !n.is_empty()).unwrap_or_else(|| UNNAMED.to_owned());
            let of_log = self.peers.entry(name).or_default().entry(stem(&line.log).to_owned()).or_default();
            of_log.push(line);
        }
        Ok(())
    }

    /// Their names, in the order in which they are shown.
    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.peers.keys().map(String::as_str)
    }

    /// What each peer has beside our outages of one length in a log.
    pub(super) fn beside(
        &self,
        log: &str,
        length_s: f64,
        ours: &[OutageWindow],
    ) -> impl Iterator<Item = Option<Beside>> {
        self.peers.values().map(move |logs| beside(logs.get(stem(log))?, length_s, ours))
    }

    /// The same of all outages of a log.
    pub(super) fn rows(&self, outcome: &LogOutcome) -> Vec<PeerRow> {
        let mut rows = Vec::new();
        for &estimator in Estimator::ALL {
            let own = outcome.rows.iter().filter(|r| r.estimator == estimator.label());
            let mut lengths: Vec<f64> = own.clone().map(|r| r.row.length_s).collect();
            lengths.sort_by(f64::total_cmp);
            lengths.dedup();
            for length_s in lengths {
                let window = |r: &&crate::fleet::OutageRow| r.row.length_s == length_s;
                let ours: Vec<OutageWindow> = own
                    .clone()
                    .filter(window)
                    .filter_map(|r| {
                        let error_m = r.row.horizontal_error_end_m?;
                        Some(OutageWindow { start_s: r.row.start_s, error_m })
                    })
                    .collect();
                for (peer, beside) in self.names().zip(self.beside(&outcome.log, length_s, &ours)) {
                    let Some(beside) = beside else { continue };
                    let (log, peer) = (outcome.log.clone(), peer.to_owned());
                    rows.push(PeerRow { log, peer, estimator: estimator.label(), length_s, beside });
                }
            }
        }
        rows
    }
}

fn beside(lines: &[PeerLine], length_s: f64, ours: &[OutageWindow]) -> Option<Beside> {
    let of_length = || lines.iter().filter(|l| (l.length_s - length_s).abs() < SAME_LENGTH_S);
    let mut pairs = Vec::new();
    for window in ours {
        let same =
            of_length().find(|l| l.start_s.is_some_and(|s| (s - window.start_s).abs() <= SAME_START_S));
        pairs.extend(same.map(|line| (window.error_m, line.error_m)));
    }
    if pairs.is_empty() {
        let whole = of_length().find(|l| l.start_s.is_none())?;
        return Some(Beside { median_m: Some(whole.error_m), worst_m: whole.worst_m, ..Beside::default() });
    }
    let theirs: Vec<f64> = pairs.iter().map(|p| p.1).collect();
    Some(Beside {
        n: Some(pairs.len()),
        worst_m: theirs.iter().copied().reduce(f64::max),
        median_m: median(theirs),
        ours_less: Some(pairs.iter().filter(|(ours, theirs)| ours < theirs).count()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn results(text: &[u8]) -> Result<PeerResults, Failure> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        PeerResults::read(&[file.path().to_owned()])
    }

    #[test]
    fn the_same_outages_are_compared_and_others_only_as_a_whole() {
        let peers = results(
            b"peer,log,length_s,start_s,error_m,worst_m\n# what they told\nEKF2,a.ulg,60,100.2,5,\nEKF2,a.ulg,60,200,1,\nEKF2, a ,60,400,9,\nEKF2,b,60,,4.5,7.5\n",
        )
        .unwrap();
        assert_eq!(peers.names().collect::<Vec<_>>(), ["EKF2"]);
        let ours = [(100.0, 3.0), (200.0, 2.0), (300.0, 8.0)]
            .map(|(start_s, error_m)| OutageWindow { start_s, error_m });
        let one = |log, length_s| peers.beside(log, length_s, &ours).next().unwrap();
        let both = Beside { n: Some(2), median_m: Some(3.0), worst_m: Some(5.0), ours_less: Some(1) };
        assert_eq!(one("/logs/a.ulg.zst", 60.0), Some(both));
        let whole = Beside { median_m: Some(4.5), worst_m: Some(7.5), ..Beside::default() };
        assert_eq!(one("b.bin", 60.0), Some(whole));
        assert_eq!((one("a.ulg", 30.0), one("c", 60.0)), (None, None));
    }

    #[test]
    fn a_file_that_is_wrong_is_told_with_its_line() {
        let wrong = |text: &str| results(text.as_bytes()).unwrap_err().to_string();
        assert!(wrong("log,length_s,error_m\na,60,x\n").contains("line: 2"));
        assert!(wrong("log,length_s,error_m\na,60,-1\n").contains("not below 0"));
        assert!(wrong("log,error_m\na,60\n").contains("length_s"));
        let none = PeerResults::read(&["no-such.csv".into()]).unwrap_err();
        assert!(none.exit_code() == 2 && none.to_string().contains("no-such.csv"));
    }

    proptest! {
        #[test]
        fn any_bytes_are_results_or_an_error(bytes in proptest::collection::vec(any::<u8>(), 0..200), head in any::<bool>()) {
            let head: &[u8] = if head { b"log,length_s,start_s,error_m\n" } else { b"" };
            let _ = results(&[head, &bytes].concat());
        }
    }
}
