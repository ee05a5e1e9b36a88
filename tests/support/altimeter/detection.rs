//! How well the faulty channels were found out.

use holdover::sim::altimeter::AltimeterRun;

/// Alarms of all steps of all runs, against the faults. A channel that is missing is not faulty: there is nothing to find out.
#[derive(Clone, Copy, Debug, Default)]
pub struct Detection {
    runs: u32,
    false_alarms: u32,
    /// Runs in which a channel was faulty at all.
    faulty_runs: u32,
    right: u32,
    wrong: u32,
    detected: u32,
    delay_steps: f64,
}

impl Detection {
    /// Adds a run's alarms, barometer and GNSS, by step.
    pub fn add(&mut self, run: &AltimeterRun, alarms: &[[bool; 2]]) {
        let faulty: Vec<[bool; 2]> =
            run.steps.iter().map(|s| [s.baro, s.gps].map(|f| !f.missing && !f.is_healthy())).collect();
        let first = faulty.iter().position(|f| f[0] || f[1]).unwrap_or(faulty.len());
        self.runs += 1;
        self.false_alarms += u32::from(alarms[..first].iter().any(|a| a[0] || a[1]));
        if first == faulty.len() {
            return;
        }
        self.faulty_runs += 1;
        let (mut all, mut wrong) = (true, false);
        for c in 0..2 {
            match faulty.iter().position(|f| f[c]) {
                Some(onset) => {
                    let found = (onset..faulty.len()).find(|&k| faulty[k][c] && alarms[k][c]);
                    all &= found.is_some();
                    if let Some(k) = found {
                        self.detected += 1;
                        self.delay_steps += (k - onset) as f64;
                    }
                }
                None => wrong |= alarms[first..].iter().any(|a| a[c]),
            }
        }
        self.wrong += u32::from(wrong);
        self.right += u32::from(all && !wrong);
    }

    fn percent(part: u32, of: u32) -> Option<f64> {
        (of > 0).then(|| 100.0 * f64::from(part) / f64::from(of))
    }

    /// The share of runs with an alarm before anything was wrong, %.
    pub fn false_alarm_percent(&self) -> Option<f64> {
        Self::percent(self.false_alarms, self.runs)
    }

    /// Mean time from a channel's onset to its first alarm while it was faulty, steps, of those that had one.
    pub fn delay_steps(&self) -> Option<f64> {
        (self.detected > 0).then(|| self.delay_steps / f64::from(self.detected))
    }

    /// The share of runs with faults in which every faulty channel had its alarm, and no channel that was never faulty had any, %.
    pub fn right_percent(&self) -> Option<f64> {
        Self::percent(self.right, self.faulty_runs)
    }

    /// The share of runs with faults in which a channel that was never faulty had an alarm after the onset, %.
    pub fn wrong_percent(&self) -> Option<f64> {
        Self::percent(self.wrong, self.faulty_runs)
    }
}
