//! The fault-tolerant altimeter: as good as one that is told the faults, and nothing that sensors can say breaks it.

use crate::altimeter::oracle::OnBias;
use crate::altimeter::{Filter, MonteCarlo};
use holdover::altimeter::HeightVerdict;
use holdover::altimeter::{Altimeter, AltimeterMethod, AltimeterSettings, Channel, Fault, Health};
use holdover::config::{Settings, Sources};
use holdover::sim::altimeter::{FaultCase, FaultSize};
use proptest::prelude::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Runs a case; their seed is not one that settings were chosen with.
const RUNS: u32 = 80;
const SEED: u64 = 7101;
const OKF: Filter = Filter::Published(AltimeterMethod::Okf);
const ORACLE: Filter = Filter::Oracle(OnBias::Estimate);

fn monte_carlo(bias_m: f64, variance_factor: f64) -> MonteCarlo {
    MonteCarlo { seed: SEED, runs: RUNS, size: FaultSize { bias_m, variance_factor } }
}

#[test]
fn it_is_nearly_as_good_as_one_that_is_told_the_faults() {
    for (bias_m, variance_factor) in [(10.0, 25.0), (20.0, 100.0), (30.0, 100.0)] {
        let runs = monte_carlo(bias_m, variance_factor);
        for (scenario, case) in FaultCase::ALL.into_iter().take(6).enumerate() {
            let what = format!("bias {bias_m} m, variance x{variance_factor}, scenario {scenario}");
            let outcome = runs.outcome(case, Filter::Default);
            let (own, oracle) = (outcome.scores[2].rms_m(), runs.fused(case, ORACLE).rms_m());
            let limit = if matches!(scenario, 3 | 5) { 1.5 } else { 1.2 };
            assert!(own <= limit * oracle, "{what}: {own:.3} m, the oracle {oracle:.3} m");
            assert_eq!(outcome.scores[2].locked_percent(), 0.0, "{what}: locked out");
            let detection = outcome.detection.unwrap();
            let alarms = detection.false_alarm_percent().unwrap_or(0.0) * f64::from(RUNS) / 100.0;
            assert!(alarms <= 1.0, "{what}: {alarms} false alarms");
            if scenario > 0 {
                assert!(detection.right_percent() >= Some(95.0), "{what}: {detection:?}");
                assert!(detection.delay_steps() <= Some(10.0), "{what}: {detection:?}");
            }
        }
    }
}

#[test]
fn without_faults_nothing_is_lost_to_the_optimal_filter() {
    let runs = monte_carlo(20.0, 100.0);
    let [own, okf] = [Filter::Default, OKF].map(|f| runs.fused(FaultCase::FaultFree, f).rms_m());
    assert!(own <= 1.03 * okf, "{own:.3} m, the optimal filter {okf:.3} m");
}

#[test]
fn overlapping_and_lasting_faults_are_no_harder() {
    let runs = monte_carlo(20.0, 100.0);
    for case in [FaultCase::Staggered, FaultCase::PermanentBaro, FaultCase::PermanentGps] {
        let [own, oracle] = [Filter::Default, ORACLE].map(|f| runs.fused(case, f));
        assert!(own.rms_m() <= 1.2 * oracle.rms_m(), "{case:?}: {} {}", own.rms_m(), oracle.rms_m());
        assert_eq!(own.locked_percent(), 0.0, "{case:?}");
    }
}

/// An altimeter as it flies, with its sensors: 50 IMU samples, 20 pressures and 5 fixes a second.
struct Flown {
    altimeter: Altimeter,
    rng: ChaCha8Rng,
    /// 10 ms each.
    ticks: u32,
    height_m: f64,
}

/// What a vehicle's barometer is off by, m.
const BARO_OFFSET_M: f64 = 37.0;

impl Flown {
    fn new(height_m: f64) -> Self {
        let settings = Settings::load(&Sources::default()).unwrap().pipeline.navigator.height.altimeter;
        Self { altimeter: Altimeter::new(settings), rng: ChaCha8Rng::seed_from_u64(5), ticks: 0, height_m }
    }

    fn noise(&mut self, sigma: f64) -> f64 {
        let n: f64 = StandardNormal.sample(&mut self.rng);
        sigma * n
    }

    /// Hovers for `seconds`; `say` makes of a height what the sensor says and how old that is (m, s), or nothing.
    fn hover(&mut self, seconds: f64, mut say: impl FnMut(Channel, f64) -> Option<(f64, f64)>) -> &mut Self {
        for _ in 0..(100.0 * seconds) as u32 {
            self.ticks += 1;
            if self.ticks.is_multiple_of(2) {
                let accel = self.noise(0.05);
                self.altimeter.predict(0.02, accel, 0.0);
            }
            for (channel, every, sigma, offset) in
                [(Channel::Baro, 5, 0.3, BARO_OFFSET_M), (Channel::Gnss, 20, 1.0, 0.0)]
            {
                if self.ticks.is_multiple_of(every) {
                    let height = self.height_m + offset + self.noise(sigma);
                    if let Some((height, age_s)) = say(channel, height) {
                        self.altimeter.measure(channel, height, None, age_s);
                        self.check();
                    }
                }
            }
        }
        self.check();
        self
    }

    fn well(&mut self, seconds: f64) -> &mut Self {
        self.hover(seconds, |_, h| Some((h, 0.0)))
    }

    fn check(&self) {
        let a = &self.altimeter;
        for v in [a.height_m().unwrap_or(0.0), a.climb_mps(), a.height_sigma_m(), a.climb_sigma_mps()] {
            assert!(v.is_finite(), "{a:?}");
        }
        assert!(a.height_m().is_none() || a.height_sigma_m() > 0.0 && a.climb_sigma_mps() > 0.0);
    }

    /// How wrong it is, m, which it must own up to.
    fn error(&self) -> f64 {
        let error = (self.altimeter.height_m().unwrap() - self.height_m).abs();
        let sigma = self.altimeter.height_sigma_m();
        assert!(error < 4.0 * sigma, "{error} m off with a sigma of {sigma} m");
        error
    }

    fn fault(&self, channel: Channel) -> Option<(Fault, f64)> {
        match self.altimeter.health(channel) {
            Health::Faulty { fault, for_s } => Some((fault, for_s)),
            _ => None,
        }
    }

    fn healthy(&self) {
        assert!(self.fault(Channel::Baro).is_none() && self.fault(Channel::Gnss).is_none());
    }
}

#[test]
fn what_is_no_number_is_refused_and_changes_nothing() {
    let mut flown = Flown::new(300.0);
    flown.well(60.0);
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for channel in Channel::ALL {
            let before = (flown.altimeter.height_m(), flown.altimeter.height_sigma_m());
            let verdict = flown.altimeter.measure(channel, bad, None, 0.0);
            assert!(matches!(verdict, HeightVerdict::Rejected(n) if n.is_nan()), "{verdict:?}");
            flown.altimeter.predict(bad, 0.0, 0.0);
            flown.altimeter.predict(0.02, bad, 0.0);
            flown.altimeter.shift_origin(bad);
            flown.altimeter.loosen(channel, bad, 1.0);
            assert_eq!((flown.altimeter.height_m(), flown.altimeter.height_sigma_m()), before);
            // What the sensor claims for itself may be no number, and the height is still one.
            flown.altimeter.measure(Channel::Baro, 300.0 + BARO_OFFSET_M, Some(bad), 0.0);
        }
    }
    assert!(flown.well(10.0).error() < 2.0);
    flown.healthy();
}

#[test]
fn a_fix_whose_height_is_zero_at_300_metres_is_found_out() {
    let mut flown = Flown::new(300.0);
    flown.well(60.0);
    flown.hover(30.0, |c, h| Some((if c == Channel::Gnss { 0.0 } else { h }, 0.0)));
    assert!(flown.error() < 3.0, "{}", flown.error());
    let Some((Fault::Bias { size_m, .. }, for_s)) = flown.fault(Channel::Gnss) else {
        panic!("{:?}", flown.altimeter.health(Channel::Gnss))
    };
    assert!((size_m + 300.0).abs() < 3.0, "{size_m}");
    assert!((for_s - 30.0).abs() < 1.0, "{for_s}");
    assert!(flown.fault(Channel::Baro).is_none());
    // And trusted again when it tells the height.
    assert!(flown.well(20.0).error() < 2.0);
    flown.healthy();
}

#[test]
fn a_barometer_that_jumps_is_told_with_its_size_and_onset() {
    for step_m in [-15.0, -5.0, 5.0, 40.0] {
        let mut flown = Flown::new(100.0);
        flown.well(60.0);
        flown.hover(20.0, |c, h| Some((if c == Channel::Baro { h + step_m } else { h }, 0.0)));
        let Some((Fault::Bias { size_m, sigma_m }, for_s)) = flown.fault(Channel::Baro) else {
            panic!("{step_m}: {:?}", flown.altimeter.health(Channel::Baro))
        };
        assert!((size_m - step_m).abs() < 1.0 && sigma_m < 2.0, "{step_m}: {size_m} ± {sigma_m}");
        assert!((for_s - 20.0).abs() < 1.0, "{step_m}: {for_s}");
        assert!(flown.fault(Channel::Gnss).is_none(), "{step_m}");
        assert!(flown.error() < 2.0, "{step_m}: {}", flown.error());
        flown.well(10.0).healthy();
        assert!(flown.error() < 2.0, "{step_m}: {}", flown.error());
    }
}

/// What a barometer is off by may walk back, and then it is over.
#[test]
fn a_barometer_that_is_off_and_walks_back_heals_where_it_began() {
    let returned = |loose: f64| {
        let mut flown = Flown::new(100.0);
        flown.well(60.0);
        flown.hover(20.0, |c, h| Some((if c == Channel::Baro { h + 12.0 } else { h }, 0.0)));
        assert!(flown.fault(Channel::Baro).is_some());
        for k in 0..400 {
            let off_m = 12.0 * (1.0 - f64::from(k) / 400.0);
            flown.altimeter.loosen(Channel::Baro, loose, 0.2);
            flown.hover(0.2, |c, h| Some((if c == Channel::Baro { h + off_m } else { h }, 0.0)));
            // Within what it claims.
            flown.error();
        }
        flown.well(20.0).fault(Channel::Baro).is_none()
    };
    assert!(returned(0.7));
}

#[test]
fn a_stuck_channel_does_no_harm_while_nothing_moves_and_a_missing_one_never() {
    for channel in [Channel::Baro, Channel::Gnss] {
        let mut flown = Flown::new(100.0);
        let mut stuck = None;
        flown.well(60.0);
        flown.hover(60.0, |c, h| Some((if c == channel { *stuck.get_or_insert(h) } else { h }, 0.0)));
        assert!(flown.error() < 3.0, "{channel:?}: {}", flown.error());
        flown.well(20.0);
        flown.hover(600.0, |c, h| (c != channel).then_some((h, 0.0)));
        assert!(flown.error() < 4.0, "{channel:?}: {}", flown.error());
        assert!(flown.altimeter.quiet_s(channel) > 599.0);
        assert!(flown.well(20.0).error() < 2.0, "{channel:?}: {}", flown.error());
    }
}

#[test]
fn late_heights_that_say_so_are_carried_to_the_present() {
    let mut flown = Flown::new(100.0);
    flown.well(30.0);
    let mut climb = 0.0;
    for (late_s, faster) in [(0.2, 5.0), (0.5, -10.0)] {
        for k in 0..600 {
            // A second of acceleration, and on.
            let accel = if k < 50 { faster } else { 0.0 };
            flown.altimeter.predict(0.02, accel, 0.0);
            flown.height_m += 0.02 * (climb + 0.01 * accel);
            climb += 0.02 * accel;
            let then = flown.height_m - climb * late_s;
            flown.altimeter.measure(Channel::Baro, then + BARO_OFFSET_M, None, late_s);
            flown.altimeter.measure(Channel::Gnss, then, None, late_s);
            flown.check();
        }
        assert!(flown.error() < 1.0, "{}", flown.error());
        flown.healthy();
    }
    // An age that is none cannot be carried.
    for age_s in [f64::NAN, f64::INFINITY] {
        let verdict = flown.altimeter.measure(Channel::Gnss, 100.0, None, age_s);
        assert!(matches!(verdict, HeightVerdict::Rejected(_)), "{verdict:?}");
        flown.check();
    }
}

#[test]
fn an_hour_without_any_height_is_owned_up_to() {
    let mut flown = Flown::new(100.0);
    flown.well(60.0);
    let mut sigma = flown.altimeter.height_sigma_m();
    for minute in 1..=60 {
        flown.hover(60.0, |_, _| None);
        let grown = flown.altimeter.height_sigma_m();
        assert!(grown > sigma, "minute {minute}: {grown} after {sigma}");
        sigma = grown;
        assert!(flown.error() < 4.0 * sigma);
        assert!((flown.altimeter.quiet_s(Channel::Baro) - 60.0 * f64::from(minute)).abs() < 0.2);
    }
    assert!(sigma > 100.0, "{sigma}");
    // The first heights after it are believed, and no channel is accused.
    assert!(flown.well(20.0).error() < 3.0, "{}", flown.error());
    flown.healthy();
}

/// Everything that can be asked of an altimeter.
#[derive(Clone, Debug)]
enum Asked {
    Predict(f64, f64, f64),
    Measure(usize, f64, Option<f64>, f64),
    Loosen(usize, f64, f64),
    Shift(f64),
    /// Ordinary seconds in between.
    Fly(u8),
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        2 => prop::num::f64::ANY,
        1 => Just(f64::NAN),
        1 => Just(f64::MAX),
        1 => Just(f64::MIN_POSITIVE),
        4 => -1e3..1e3,
    ]
}

fn asked() -> impl Strategy<Value = Asked> {
    let n = any_number;
    prop_oneof![
        (n(), n(), n()).prop_map(|(a, b, c)| Asked::Predict(a, b, c)),
        (0..4usize, n(), prop::option::of(n()), n()).prop_map(|(c, a, b, d)| Asked::Measure(c, a, b, d)),
        (0..4usize, n(), n()).prop_map(|(c, a, b)| Asked::Loosen(c, a, b)),
        n().prop_map(Asked::Shift),
        (1..60u8).prop_map(Asked::Fly),
    ]
}

fn all_numbers(a: &Altimeter) -> Vec<f64> {
    let mut v = vec![a.climb_mps(), a.height_sigma_m(), a.climb_sigma_mps()];
    v.extend(a.height_m());
    for channel in Channel::ALL {
        v.extend(a.offset_m(channel));
        if let Health::Faulty { fault, for_s } = a.health(channel) {
            v.push(for_s);
            v.push(match fault {
                Fault::Bias { size_m, sigma_m } => size_m + sigma_m,
                Fault::Drift { size_m } => size_m,
                Fault::Noise { variance_factor } => variance_factor,
            });
        }
    }
    v
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn no_number_that_is_none_ever_comes_out(
        flown in any::<bool>(),
        all in prop::collection::vec(asked(), 1..40),
    ) {
        let recorded = Settings::load(&Sources::default()).unwrap().pipeline.navigator.height.altimeter;
        let mut a = Altimeter::new(if flown { recorded } else { AltimeterSettings::table_1() });
        for (i, asked) in all.iter().enumerate() {
            match *asked {
                Asked::Predict(dt, accel, noise) => a.predict(dt, accel, noise),
                Asked::Measure(c, height, sigma, age) => {
                    a.measure(Channel::ALL[c], height, sigma, age);
                }
                Asked::Loosen(c, walk, dt) => a.loosen(Channel::ALL[c], walk, dt),
                Asked::Shift(up) => a.shift_origin(up),
                Asked::Fly(n) => for k in 0..n {
                    a.predict(0.1, 0.0, 0.0);
                    a.measure(Channel::ALL[usize::from(k) % 4], 100.0 + f64::from(k % 3), None, 0.1);
                },
            }
            while a.next_change().is_some() {}
            for v in all_numbers(&a) {
                prop_assert!(v.is_finite(), "{v} after {i}: {:?} in {a:?}", asked);
            }
        }
    }
}
