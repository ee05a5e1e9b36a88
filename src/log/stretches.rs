//! A stream's rate over the stretches in which it runs, and the holes between them.

use crate::time::AutopilotTime;

/// Longer than this between two samples is a hole, s: the slowest streams that are used come every two seconds.
const HOLE_S: f64 = 2.5;
/// Holes that are kept for showing.
const SHOWN: usize = 8;

/// What is known of one stream of samples.
#[derive(Clone, Copy, Debug, Default)]
pub struct Stretches {
    n: u64,
    last: Option<AutopilotTime>,
    covered_s: f64,
    longest_gap_s: f64,
    missing_s: f64,
    holes: u32,
    shown: [Option<(AutopilotTime, f64)>; SHOWN],
}

impl Stretches {
    /// Notes a sample.
    pub fn note(&mut self, time: AutopilotTime) {
        let gap = self.last.map(|last| time.seconds_since(last)).filter(|gap| *gap > 0.0);
        self.n += 1;
        self.last = self.last.max(Some(time));
        let Some(gap) = gap else { return };
        self.longest_gap_s = self.longest_gap_s.max(gap);
        if gap <= HOLE_S {
            self.covered_s += gap;
            return;
        }
        if let Some(place) = self.shown.get_mut(self.holes as usize) {
            *place = Some((time, gap));
        }
        self.holes += 1;
        self.missing_s += gap;
    }

    /// Samples.
    pub fn count(&self) -> u64 {
        self.n
    }

    /// Their rate where they come, Hz.
    pub fn rate_hz(&self) -> Option<f64> {
        let intervals = self.n.checked_sub(1 + u64::from(self.holes))?;
        (self.covered_s > 0.0).then(|| intervals as f64 / self.covered_s)
    }

    /// How long they run, without the holes, s.
    pub fn covered_s(&self) -> f64 {
        self.covered_s
    }

    /// The longest time between two of them, s.
    pub fn longest_gap_s(&self) -> f64 {
        self.longest_gap_s
    }

    /// Holes, and how long they are together, s.
    pub fn holes(&self) -> (u32, f64) {
        (self.holes, self.missing_s)
    }

    /// The first holes: when each ended, and how long it was, s.
    pub fn shown(&self) -> impl Iterator<Item = (AutopilotTime, f64)> + '_ {
        self.shown.iter().flatten().copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hole_does_not_slow_a_stream_down() {
        let mut stream = Stretches::default();
        let at = AutopilotTime::from_micros;
        for i in 0..500 {
            stream.note(at(i * 20_000));
        }
        for i in 0..500 {
            stream.note(at(100_000_000 + i * 20_000));
        }
        assert!((stream.rate_hz().unwrap() - 50.0).abs() < 1e-9);
        assert_eq!(stream.holes(), (1, 90.02));
        assert_eq!(stream.shown().collect::<Vec<_>>(), [(at(100_000_000), 90.02)]);
        assert_eq!((stream.count(), stream.longest_gap_s()), (1000, 90.02));
        assert_eq!(Stretches::default().rate_hz(), None);
    }

    #[test]
    fn fixes_of_one_a_second_have_no_holes() {
        let mut stream = Stretches::default();
        (0..60).for_each(|i| stream.note(AutopilotTime::from_micros(i * 1_002_000)));
        assert_eq!(stream.holes().0, 0);
        assert!((stream.rate_hz().unwrap() - 1.0 / 1.002).abs() < 1e-9);
    }
}
