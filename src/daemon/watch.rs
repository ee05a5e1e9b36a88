//! Whether the IMU is heard, by the companion's clock: a stream that stopped has no newer stamp to tell so.

use crate::time::{Companion, Span, Stamp};

/// Time without any IMU sample after the autopilot was found that is worth a word.
const PATIENCE: Span = Span::from_millis(15_000);
/// A scheduler of a small computer may pause for so long.
const LEAST: Span = Span::from_millis(500);
/// After a silence the stream has to come for so long without another one before it is said to be back: one that comes in bits is one
/// silence, and one word to the pilot.
const STEADY: Span = Span::from_millis(5_000);

/// What is to be told.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) enum ImuNews {
    /// None has come at all since the autopilot was found.
    NeverCame,
    /// They stopped, so long ago.
    Silent(Span),
    /// They are back.
    Back(Span),
}

/// Watches the IMU stream.
#[derive(Clone, Copy, Debug)]
pub(super) struct ImuWatch {
    limit: Span,
    since: Option<Stamp<Companion>>,
    came: bool,
    silent: bool,
    /// A silence was told whose end was not: when it began, and since when the stream has come again.
    told: Option<(Stamp<Companion>, Option<Stamp<Companion>>)>,
}

impl ImuWatch {
    pub(super) fn new(max_gap: Span) -> Self {
        Self { limit: max_gap.max(LEAST), since: None, came: false, silent: false, told: None }
    }

    /// Whether it was heard and is not any more, or should have been heard by now.
    pub(super) fn silent(&self) -> bool {
        self.silent
    }

    /// The autopilot was found, or began anew.
    pub(super) fn expect(&mut self, now: Stamp<Companion>) {
        self.since.get_or_insert(now);
    }

    /// A sample came.
    pub(super) fn heard(&mut self, now: Stamp<Companion>) -> Option<ImuNews> {
        self.since = Some(now);
        self.came = true;
        let (began, again) = self.told.as_mut()?;
        if std::mem::take(&mut self.silent) {
            *again = Some(now);
        }
        let again = (*again)?;
        if now - again < STEADY {
            return None;
        }
        let silence = again - *began;
        self.told = None;
        Some(ImuNews::Back(silence))
    }

    /// Looks at the time.
    pub(super) fn poll(&mut self, now: Stamp<Companion>) -> Option<ImuNews> {
        let silence = now - self.since?;
        let limit = if self.came { self.limit } else { PATIENCE };
        if self.silent || silence <= limit {
            return None;
        }
        self.silent = true;
        if self.told.is_some() {
            return None;
        }
        self.told = Some((self.since?, None));
        Some(if self.came { ImuNews::Silent(silence) } else { ImuNews::NeverCame })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: i64) -> Stamp<Companion> {
        Stamp::from_micros(ms * 1000)
    }

    #[test]
    fn silence_is_told_once_and_so_is_its_end() {
        let mut watch = ImuWatch::new(Span::from_millis(600));
        assert_eq!(watch.poll(at(99_000)), None, "no autopilot, no IMU");
        watch.expect(at(100_000));
        assert_eq!(watch.heard(at(101_000)), None);
        assert_eq!(watch.poll(at(101_600)), None);
        assert_eq!(watch.poll(at(101_601)), Some(ImuNews::Silent(Span::from_millis(601))));
        assert!(watch.silent());
        assert_eq!(watch.poll(at(102_000)), None);
        assert_eq!(watch.heard(at(103_000)), None);
        assert!(!watch.silent());
        let back: Vec<_> = (103_010..109_000).step_by(10).filter_map(|ms| watch.heard(at(ms))).collect();
        assert_eq!(back, [ImuNews::Back(Span::from_millis(2000))]);
    }

    #[test]
    fn a_stream_that_comes_in_bits_is_one_silence() {
        let mut watch = ImuWatch::new(Span::from_millis(500));
        watch.expect(at(0));
        let mut told = Vec::new();
        // One sample a second for a minute, then a stream as it should be.
        for ms in 1..80_000 {
            let sample = if ms < 60_000 { ms % 1000 == 0 } else { ms % 10 == 0 };
            told.extend(sample.then(|| watch.heard(at(ms))).flatten());
            told.extend(watch.poll(at(ms)));
            assert!(!(2000..=60_000).contains(&ms) || watch.silent() == (ms % 1000 > 500), "{ms}");
        }
        let began = ImuNews::Silent(Span::from_millis(501));
        assert_eq!(told, [began, ImuNews::Back(Span::from_millis(59_000))]);
    }

    #[test]
    fn an_imu_that_never_comes_is_told() {
        let mut watch = ImuWatch::new(Span::from_millis(100));
        watch.expect(at(0));
        assert_eq!(watch.poll(at(15_000)), None);
        assert_eq!(watch.poll(at(15_001)), Some(ImuNews::NeverCame));
    }
}
