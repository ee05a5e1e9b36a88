//! How much of what a peer sends is taken: token buckets far above any real link, so that one sender's flood leaves the others' frames
//! their places, and garbage costs no more than so much.

use super::LinkLimits;
use super::bucket::Bucket;
use crate::time::{Companion, Stamp};
use crate::wire::frame::{ComponentId, Frame, SystemId};

/// Senders with a bucket of their own; the others, and messages that cannot be checked, share one.
const OWN: usize = 8;
/// What a bucket holds, as a share of what it gets a second: a process that was stopped for a while takes what has come meanwhile.
const BURST: f64 = 0.1;

/// Signatures that are looked at, 1/s: a hash of a microsecond each, so a tenth of a core at most. All links of today are a hundred times slower;
/// fewer would help who drowns the real frames in forged ones.
const SIGNATURES_PER_S: f64 = 100_000.0;

/// The buckets of one link.
#[derive(Debug)]
pub(super) struct Throttle {
    frames: Bucket,
    own: Vec<(SystemId, ComponentId, Bucket)>,
    others: Bucket,
    search: Bucket,
    signatures: Bucket,
}

impl Throttle {
    pub(super) fn new(limits: &LinkLimits) -> Self {
        let bucket = |per_s: f64| Bucket::new(per_s, per_s * BURST);
        let frames = bucket(limits.frames_per_s);
        Self {
            frames,
            own: Vec::with_capacity(OWN),
            others: frames,
            search: bucket(limits.search_bytes_per_s),
            signatures: bucket(SIGNATURES_PER_S),
        }
    }

    /// Whether one more frame of its sender is passed on. `checked` if its checksum was tested.
    pub(super) fn admits(&mut self, frame: &Frame<'_>, checked: bool, now: Stamp<Companion>) -> bool {
        if !checked {
            return self.others.take(1, now);
        }
        let (system, component) = (frame.system(), frame.component());
        if let Some((.., bucket)) = self.own.iter_mut().find(|(s, c, _)| (*s, *c) == (system, component)) {
            return bucket.take(1, now);
        }
        if self.own.len() == OWN {
            return self.others.take(1, now);
        }
        let mut bucket = self.frames;
        let admitted = bucket.take(1, now);
        self.own.push((system, component, bucket));
        admitted
    }

    /// Whether one more signature is looked at.
    pub(super) fn may_verify(&mut self, now: Stamp<Companion>) -> bool {
        self.signatures.take(1, now)
    }

    /// Whether so many bytes are searched in which no frame stands where it should.
    pub(super) fn may_search(&mut self, bytes: usize, now: Stamp<Companion>) -> bool {
        self.search.take(bytes, now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::session::heartbeat_fields::testing::heartbeat_frame;

    #[test]
    fn a_flood_of_one_sender_leaves_the_others_their_places() {
        let limits = LinkLimits { frames_per_s: 100.0, ..LinkLimits::default() };
        let mut throttle = Throttle::new(&limits);
        let mut admitted = [0; 3];
        for ms in 0..10_000 {
            let now = Stamp::from_micros(ms * 1000);
            for (sender, passed) in admitted.iter_mut().enumerate() {
                // The first sends ten a millisecond, the others ten a second.
                for _ in 0..if sender == 0 { 10 } else { i64::from(ms % 100 == 0) } {
                    let bytes = heartbeat_frame(7 + sender as u8, 1, 2, 3, 0);
                    *passed += i32::from(throttle.admits(&bytes.frame().unwrap(), true, now));
                }
            }
        }
        assert_eq!(admitted[1..], [100, 100]);
        assert!((1000..=1011).contains(&admitted[0]), "{admitted:?}");
    }

    #[test]
    fn forged_signatures_cost_no_more_than_so_much() {
        let mut throttle = Throttle::new(&LinkLimits::default());
        let looked_at = (0..1_000_000).filter(|us| throttle.may_verify(Stamp::from_micros(*us))).count();
        assert!((109_000..=110_001).contains(&looked_at), "{looked_at}");
    }

    #[test]
    fn invented_senders_share_one_bucket() {
        let limits = LinkLimits { frames_per_s: 100.0, ..LinkLimits::default() };
        let mut throttle = Throttle::new(&limits);
        let now = Stamp::from_micros(0);
        let vehicle = heartbeat_frame(1, 1, 2, 3, 0);
        assert!(throttle.admits(&vehicle.frame().unwrap(), true, now));
        let invented = (2..=255).filter(|system| {
            let bytes = heartbeat_frame(*system, 1, 2, 3, 0);
            throttle.admits(&bytes.frame().unwrap(), true, now)
        });
        assert_eq!(invented.count(), OWN - 1 + 10);
        assert!(throttle.admits(&vehicle.frame().unwrap(), true, now));
    }
}
