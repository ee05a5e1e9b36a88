//! How far sources of heights wander on this vehicle, learned from how two of them part.
//!
//! Rotors' wash, wind and gusts move a barometer by metres, on one vehicle and not on another; a receiver may lose its height while it stands.
//! Heights are averaged over blocks; of the difference d of two sources the structure function D(τ) = E[(d(t) − d(t − τ))²] is kept at some
//! lags (Lindsey and Chie 1976, Proc. IEEE 64). Independent errors add, so that D of a pair is an upper bound of either source's own, and the
//! least over the pairs is the closest. Two barometers in the same wash are not independent, and no pair.
//!
//! With the autocovariance ½(D(∞) − D(τ)) of what comes and goes, its density at low frequency, which is what a sample tells the less by, is
//!
//! S = ∫₀ᵀ (D(T) − D(τ)) dτ, m²s
//!
//! (σ² Δt where samples are independent), and what goes on walking beyond T is q = (D(L) − D(T))/(L − T), m²/s. Between a barometer and GNSS
//! alone nothing tells whose a wander is: it is the barometer's, whose wash is what wanders. GNSS is charged by a rangefinder only.

use crate::altimeter::{AltimeterSettings, Channel};
use crate::navigator::tuning::height_wander::{
    BLOCK_S, CLIPPED, KNOWN_S, LAGS, LEAST_M2, MEMORY_S, PRIOR_S, RANGE_INTERVAL_S, RATE_S, SHORT_LAGS,
    TOLERATED_M2,
};

/// Blocks that are remembered: the longest lag, and the present.
const KEPT: usize = LAGS[LAGS.len() - 1] + 1;
/// What is set against each other.
const PAIRS: [(Channel, Channel); 5] = [
    (Channel::Baro, Channel::Gnss),
    (Channel::SecondBaro, Channel::Gnss),
    (Channel::Baro, Channel::Range),
    (Channel::SecondBaro, Channel::Range),
    (Channel::Gnss, Channel::Range),
];

/// What a source tells within a block.
#[derive(Clone, Copy, Debug, Default)]
struct HeightBlock {
    sum_m: f64,
    count: f64,
    /// Samples in a block, as a rule.
    usual: f64,
    /// What it claimed last, m.
    claimed_m: f64,
}

/// What a source, or a pair, wanders by: S, m²s, and q, m²/s.
#[derive(Clone, Copy, Debug, PartialEq)]
struct WanderBound {
    density: f64,
    walk: f64,
}

/// The difference of two sources.
#[derive(Clone, Copy, Debug)]
struct HeightPair {
    /// By block, in a ring; NaN where one of the two was not heard.
    apart_m: [f64; KEPT],
    /// D at every lag, m², and for how long it was seen, forgotten in [`MEMORY_S`], s.
    spread: [f64; LAGS.len()],
    seen_s: [f64; LAGS.len()],
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(super) struct HeightWander {
    blocks: [HeightBlock; 4],
    pairs: [HeightPair; PAIRS.len()],
    /// Place of the present block in the rings.
    present: usize,
    elapsed_s: f64,
    /// What each source is held to wander by anyway, by its settings.
    known: AltimeterSettings,
    /// What it was found to wander by beyond.
    found: [Option<WanderBound>; 4],
}

impl HeightPair {
    fn new() -> Self {
        Self { apart_m: [f64::NAN; KEPT], spread: [0.0; LAGS.len()], seen_s: [0.0; LAGS.len()] }
    }

    /// One more block, at `present` in the ring. A lone step counts for no more than a wander that is several times the usual: faults are
    /// others' business.
    fn learn(&mut self, present: usize, apart_m: f64) {
        self.apart_m[present] = apart_m;
        for (i, lag) in LAGS.into_iter().enumerate() {
            let change = apart_m - self.apart_m[(present + KEPT - lag) % KEPT];
            self.seen_s[i] *= 1.0 - BLOCK_S / MEMORY_S;
            if change.is_finite() {
                self.seen_s[i] += BLOCK_S;
                let square = (change * change).min(CLIPPED * self.spread[i].max(LEAST_M2));
                self.spread[i] += (square - self.spread[i]) * BLOCK_S / (PRIOR_S + self.seen_s[i]);
            }
        }
    }

    /// S and q, once they are known; a lag that was never seen is left out of the integral.
    fn wander(&self) -> Option<WanderBound> {
        let last = LAGS.len() - 1;
        let (short_s, long_s) = (BLOCK_S * LAGS[SHORT_LAGS - 1] as f64, BLOCK_S * LAGS[last] as f64);
        let most = self.spread[SHORT_LAGS - 1];
        let (mut density, mut from_s, mut left) = (0.0, 0.0, most);
        for (i, lag) in LAGS.into_iter().enumerate().take(SHORT_LAGS).filter(|(i, _)| self.seen_s[*i] > 0.0) {
            let (to_s, here) = (BLOCK_S * lag as f64, (most - self.spread[i]).max(0.0));
            density += 0.5 * (left + here) * (to_s - from_s);
            (from_s, left) = (to_s, here);
        }
        let walked = if self.seen_s[last] > KNOWN_S { (self.spread[last] - most).max(0.0) } else { 0.0 };
        let counts = |of: f64| (1.0 - TOLERATED_M2 / of.max(TOLERATED_M2)).max(0.0);
        (self.seen_s[SHORT_LAGS - 1] > KNOWN_S).then_some(WanderBound {
            density: counts(most) * density,
            walk: counts(self.spread[last]) * walked / (long_s - short_s),
        })
    }
}

impl HeightWander {
    pub(super) fn new(known: &AltimeterSettings) -> Self {
        Self {
            blocks: [HeightBlock::default(); 4],
            pairs: [HeightPair::new(); PAIRS.len()],
            present: 0,
            elapsed_s: 0.0,
            known: *known,
            found: [None; 4],
        }
    }

    /// A height that a source told, m, and what it claims of it, m.
    pub(super) fn hear(&mut self, channel: Channel, height_m: f64, claimed_m: Option<f64>) {
        if height_m.is_finite() {
            let block = &mut self.blocks[channel.index()];
            (block.sum_m, block.count) = (block.sum_m + height_m, block.count + 1.0);
            block.claimed_m = claimed_m.filter(|s| s.is_finite()).unwrap_or(0.0);
        }
    }

    /// What a channel told is explained by something else, and its heights from before are not comparable.
    pub(super) fn forget(&mut self, channel: Channel) {
        self.blocks[channel.index()].count = 0.0;
        self.blocks[channel.index()].sum_m = 0.0;
        for (pair, (a, b)) in self.pairs.iter_mut().zip(PAIRS) {
            if channel == a || channel == b {
                pair.apart_m = [f64::NAN; KEPT];
            }
        }
    }

    /// What comes on a channel is another sensor's from now on.
    pub(super) fn another(&mut self, channel: Channel) {
        self.blocks[channel.index()] = HeightBlock::default();
        self.found[channel.index()] = None;
        for (pair, (a, b)) in self.pairs.iter_mut().zip(PAIRS) {
            if channel == a || channel == b {
                *pair = HeightPair::new();
            }
        }
    }

    /// Time goes on; nothing is learned of a vehicle that rests: no air moves there, and no rotor.
    pub(super) fn step(&mut self, dt: f64, resting: bool) {
        self.elapsed_s += dt;
        if self.elapsed_s < BLOCK_S {
            return;
        }
        self.elapsed_s = if self.elapsed_s < 2.0 * BLOCK_S { self.elapsed_s - BLOCK_S } else { 0.0 };
        let means = self.blocks.map(|block| block.sum_m / block.count);
        for block in &mut self.blocks {
            block.usual += (block.count - block.usual) * BLOCK_S / RATE_S;
            (block.sum_m, block.count) = (0.0, 0.0);
        }
        self.present = (self.present + 1) % KEPT;
        for (pair, (a, b)) in self.pairs.iter_mut().zip(PAIRS) {
            let apart_m = if resting { f64::NAN } else { means[a.index()] - means[b.index()] };
            pair.learn(self.present, apart_m);
        }
        for channel in [Channel::Baro, Channel::SecondBaro, Channel::Gnss] {
            self.found[channel.index()] = self.charged(channel);
        }
    }

    /// How far apart in time a channel's samples are, s.
    fn interval_s(&self, channel: Channel) -> f64 {
        let usual = self.blocks[channel.index()].usual;
        if channel == Channel::Range { RANGE_INTERVAL_S } else { BLOCK_S / usual.max(BLOCK_S) }
    }

    /// What a source is held to wander by anyway. One that says that it is worse than it is held to be is so in both.
    fn expected(&self, channel: Channel) -> WanderBound {
        let known = &self.known.channels[channel.index()];
        let sigma_m = self.blocks[channel.index()].claimed_m.max(known.noise_m);
        let worse = (sigma_m / known.noise_m).max(1.0);
        let walk = if channel == Channel::Range { 0.0 } else { (worse * known.offset.walk).powi(2) };
        WanderBound { density: sigma_m * sigma_m * self.interval_s(channel), walk }
    }

    /// The least that its pairs leave to a channel beyond what the other of each is held to wander by. What was seen long ago does not count beside
    /// what was seen lately.
    fn charged(&self, channel: Channel) -> Option<WanderBound> {
        let of =
            |(a, b): (Channel, Channel)| if a == channel { Some(b) } else { (b == channel).then_some(a) };
        let pairs = || self.pairs.iter().zip(PAIRS).filter_map(move |(pair, names)| Some((pair, of(names)?)));
        let seen = |pair: &HeightPair| pair.seen_s[SHORT_LAGS - 1];
        let longest_s = pairs().map(|(pair, _)| seen(pair)).fold(0.0, f64::max);
        let lately = |pair: &HeightPair| seen(pair) > 0.5 * longest_s;
        if channel == Channel::Gnss && !pairs().any(|(pair, other)| other == Channel::Range && lately(pair)) {
            return None;
        }
        let left = |(pair, other): (&HeightPair, Channel)| {
            let (all, others) = (pair.wander()?, self.expected(other));
            Some(WanderBound { density: all.density - others.density, walk: all.walk - others.walk })
        };
        let least = |a: WanderBound, b: WanderBound| WanderBound {
            density: a.density.min(b.density),
            walk: a.walk.min(b.walk),
        };
        pairs().filter(|(pair, _)| lately(pair)).filter_map(left).reduce(least)
    }

    /// What a sample of a channel is worth, m, 1 sigma: as good as it claims or is held to be, or as it was found to be.
    pub(super) fn sigma_m(&self, channel: Channel, claimed_m: Option<f64>) -> Option<f64> {
        let Some(found) = self.found[channel.index()] else { return claimed_m };
        let found_m = (found.density.max(0.0) / self.interval_s(channel)).sqrt();
        let least_m = claimed_m.unwrap_or(self.known.channels[channel.index()].noise_m);
        Some(least_m.max(found_m))
    }

    /// By how much a channel's offset walks beyond what it is held to, m/√s.
    pub(super) fn walk(&self, channel: Channel) -> f64 {
        let known = self.expected(channel).walk;
        self.found[channel.index()].map_or(0.0, |found| (found.walk - known).max(0.0).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Settings, Sources};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// What a source is off by: comes and goes with σ, m, and τ, s; walks, m/√s; runs away, m/s.
    #[derive(Clone, Copy, Default)]
    struct Off {
        comes_and_goes: (f64, f64),
        walks: f64,
        runs: f64,
        m: [f64; 2],
    }

    /// Two pressures, two distances and one fix every 0.2 s for `for_s`, of a vehicle that climbs and sinks; white noise of 5 cm.
    fn watched(for_s: f64, off: [Off; 4], heard: [bool; 4]) -> HeightWander {
        seeded(11, for_s, off, heard)
    }

    fn seeded(seed: u64, for_s: f64, mut off: [Off; 4], heard: [bool; 4]) -> HeightWander {
        let settings = Settings::load(&Sources::default()).unwrap().pipeline.navigator;
        let mut wander = HeightWander::new(&settings.height.altimeter);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let dt = 0.1;
        for k in 0..(for_s / dt) as u32 {
            let t = f64::from(k) * dt;
            for channel in Channel::ALL {
                let mut n = || StandardNormal.sample(&mut rng);
                let Off { comes_and_goes: (sigma, tau), walks, runs, m } = &mut off[channel.index()];
                let keep = if *tau > 0.0 { (-dt / *tau).exp() } else { 0.0 };
                let (a, b, c): (f64, f64, f64) = (n(), n(), n());
                m[0] = keep * m[0] + *sigma * (1.0 - keep * keep).sqrt() * a;
                m[1] += *walks * dt.sqrt() * b + *runs * dt;
                let height_m = 20.0 + 5.0 * (0.3 * t).sin() + m[0] + m[1] + 0.05 * c;
                let due = channel != Channel::Gnss || k % 2 == 0;
                if due && heard[channel.index()] {
                    wander.hear(channel, height_m, (channel == Channel::Gnss).then_some(0.3));
                }
            }
            wander.step(dt, false);
        }
        wander
    }

    const ALL: [bool; 4] = [true; 4];
    const NO_RANGE: [bool; 4] = [true, true, true, false];

    fn washed(sigma: f64, tau: f64) -> Off {
        Off { comes_and_goes: (sigma, tau), ..Off::default() }
    }

    #[test]
    fn sound_sources_are_what_they_are_held_to_be() {
        let wander = watched(120.0, [Off::default(); 4], ALL);
        for channel in [Channel::Baro, Channel::SecondBaro] {
            assert_eq!((wander.sigma_m(channel, None), wander.walk(channel)), (Some(0.4), 0.0));
        }
        assert_eq!((wander.sigma_m(Channel::Gnss, Some(0.3)), wander.walk(Channel::Gnss)), (Some(0.3), 0.0));
        let unheard = watched(5.0, [Off::default(); 4], ALL);
        assert_eq!(unheard.sigma_m(Channel::Baro, None), None);
    }

    /// What comes and goes with σ and τ has the density 2 σ² τ, of which S sees what falls off within T: 2 σ² (τ − (τ + T) exp(−T/τ)).
    #[test]
    fn a_washed_barometer_is_worth_what_its_density_says() {
        for heard in [ALL, NO_RANGE] {
            let (sigma, tau, long_s) = (2.0f64, 1.0, 4.0f64);
            let off = [washed(sigma, tau), Off::default(), Off::default(), Off::default()];
            let wander = watched(600.0, off, heard);
            let density = 2.0 * sigma * sigma * (tau - (tau + long_s) * (-long_s / tau).exp());
            let expected = (density / 0.1).sqrt();
            let found = wander.sigma_m(Channel::Baro, None).unwrap();
            assert!((found / expected - 1.0).abs() < 0.25, "{found} m for {expected}");
            assert!(wander.sigma_m(Channel::SecondBaro, None).unwrap() < 1.0);
            assert_eq!(wander.sigma_m(Channel::Gnss, Some(0.3)), Some(0.3));
        }
    }

    #[test]
    fn a_walk_is_charged_to_the_source_that_every_pair_of_it_shows() {
        let walks = Off { walks: 1.0, ..Off::default() };
        let quiet = Off::default();
        // In the minute that counts a walk is seen only a few times over: in the mean of many it is what it is.
        let walks_of = |seed| {
            let wander = seeded(seed, 180.0, [walks, quiet, quiet, quiet], ALL);
            assert_eq!((wander.walk(Channel::SecondBaro), wander.walk(Channel::Gnss)), (0.0, 0.0));
            wander.walk(Channel::Baro).powi(2)
        };
        let walk = ((0..30).map(walks_of).sum::<f64>() / 30.0).sqrt();
        assert!((0.75..1.1).contains(&walk), "{walk}");
        // Two in the same wash, and GNSS with the rangefinder against them.
        let both = watched(600.0, [walks, quiet, walks, quiet], ALL);
        assert!(both.walk(Channel::Baro) > 0.3 && both.walk(Channel::SecondBaro) > 0.3);
        assert_eq!(both.walk(Channel::Gnss), 0.0);
        // A fix that sinks beside a barometer and a rangefinder that do not.
        let sinks = Off { runs: -0.3, ..Off::default() };
        let sunk = watched(120.0, [quiet, sinks, quiet, quiet], ALL);
        assert!(sunk.walk(Channel::Gnss) > 0.5, "{}", sunk.walk(Channel::Gnss));
        assert_eq!((sunk.walk(Channel::Baro), sunk.walk(Channel::SecondBaro)), (0.0, 0.0));
        // Without a rangefinder nobody knows, and a barometer is what drifts.
        let alone = watched(120.0, [quiet, sinks, quiet, quiet], NO_RANGE);
        assert!(alone.walk(Channel::Gnss) == 0.0 && alone.walk(Channel::Baro) > 0.3);
    }

    #[test]
    fn ground_that_changes_is_no_wander_of_barometer_or_gnss() {
        let quiet = Off::default();
        let rough = Off { walks: 1.0, ..washed(2.0, 2.0) };
        let wander = watched(300.0, [quiet, quiet, quiet, rough], ALL);
        assert_eq!((wander.walk(Channel::Baro), wander.walk(Channel::Gnss)), (0.0, 0.0));
        assert!(wander.sigma_m(Channel::Baro, None).unwrap() < 0.5);
    }
}
