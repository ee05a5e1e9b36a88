//! Any list of faults over recorded flights: the solution stays finite, and its error within six of its sigmas for as long as it claims
//! one.

use holdover::config::{Settings, Sources};
use holdover::fault::InjectedFault;
use holdover::log::Log;
use holdover::replay::runner;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use crate::command::sitl_log;

/// The part of a flight that is without GNSS, and the flight.
const FLIGHTS: [(&str, (f64, f64)); 2] =
    [("ardupilot-copter-gps-loss", (265.0, 325.0)), ("ardupilot-plane-survey-light", (300.0, 360.0))];

fn faults() -> impl Strategy<Value = Vec<InjectedFault>> {
    let kinds = prop::sample::select(vec![
        "flow:zero",
        "flow:freeze",
        "flow:scale=2",
        "flow:flip",
        "flow:noise=0.2",
        "flow:delay=0.3",
        "flow:nan",
        "range:stuck=1",
        "range:freeze",
        "range:scale=2",
        "range:drop",
        "range:nan",
        "baro:freeze",
        "baro:bias=4",
        "baro:gust=3",
        "baro:nan",
        "baro0:drop",
        "mag:turn=40",
        "mag:freeze",
        "mag:drop",
        "mag:flip",
        "mag:nan",
        "gnss:jump=20",
        "gnss:nofix",
        "gnss:flap=6",
        "gnss:nan",
        "gnss:freeze",
        "airspeed:scale=0.7",
        "all:drop",
        "all:drop=0.5",
        "gyro:nan",
        "accel:nan",
    ]);
    let one = (kinds, 0.0..330.0f64, 2.0..80.0f64)
        .prop_map(|(kind, from, length)| format!("{kind}@{from:.1}..{:.1}", from + length).parse().unwrap());
    prop::collection::vec(one, 1..4)
}

/// As many as take half a minute. The seed is fixed so that a list that fails, fails for everybody.
const CASES: u32 = 32;
const SEED: u64 = 12;

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(SEED), ..ProptestConfig::with_cases(CASES) })]
    #[test]
    fn no_list_of_faults_makes_a_confident_lie(faults in faults(), which in 0..FLIGHTS.len()) {
        let (name, outage) = FLIGHTS[which];
        let settings = Settings::load(&Sources::default()).unwrap();
        let log = Log::open(&sitl_log(name), None).unwrap();
        let mut finite = true;
        let (runner, _) = runner::run(&log, &settings.pipeline, &[outage], &faults, |_| {}, |runner, _, _, _| {
            finite &= runner.solution().is_none_or(|s| {
                s.position.raw().iter().chain(s.velocity.raw().iter()).all(|v| v.is_finite())
                    && s.position_covariance.raw().iter().all(|v| v.is_finite())
            });
        }).unwrap();
        prop_assert!(finite);
        let told: Vec<String> = faults.iter().map(InjectedFault::to_string).collect();
        let worst = runner.outcome().outages[0].worst_sigmas.unwrap_or(0.0);
        prop_assert!(worst <= 6.0, "{name} with {told:?}: {worst:.1} sigmas");
    }
}
