//! Boot time across 2³² ms in flight; the day's flight of `examples/long_flight.rs` in short.

use holdover::navigator::solution::Mode;

#[path = "../support/long_flight.rs"]
mod long_flight;

use long_flight::{LongFlight, LongFlightPlan, WRAP_S};

#[test]
fn nothing_is_refused_when_the_milliseconds_begin_anew() {
    let plan = LongFlightPlan {
        duration_s: 400.0,
        boot_s: WRAP_S - 250.0,
        outage_every_s: 235.0,
        outage_s: 60.0,
        seed: 1,
    };
    let mut flight = LongFlight::new(&plan).unwrap();
    while flight.step().is_some() {}
    let counts = &flight.counts;
    assert_eq!(flight.refused().seen().collect::<Vec<_>>(), []);
    let faults = [counts.no_frame, counts.not_sent, counts.unsound, counts.backwards];
    assert_eq!(faults, [0; 4], "no frame, not sent, unsound, out of time");
    assert_eq!(counts.told.len(), 1, "one vehicle, no reboot, no gap: {:?}", counts.told);
    // All but what came before the vehicle was chosen, of 100 Hz, 10 Hz of each of two sensors, and 5 Hz.
    for (kind, least) in [("IMU", 39_000), ("optical flow", 7_800), ("GNSS", 1_950)] {
        assert!(counts.samples[kind] >= least, "{kind}: {:?}", counts.samples);
    }
    assert!(counts.sent > 10_000, "{}", counts.sent);
    // Those that carry an outage: of the camera's flow, what is due after every step is fused.
    let flow = flight.sources().into_iter().find(|s| s.kind.label() == "optical flow" && s.id == 0).unwrap();
    assert!(flow.fused > 7000, "{flow:?}");
    // The outage goes across the wrap.
    let (_, modes): (Vec<f64>, Vec<Mode>) = counts.modes.iter().copied().unzip();
    assert_eq!(modes.iter().filter(|m| **m == Mode::Holdover).count(), 1, "{modes:?}");
    assert_eq!(modes.last(), Some(&Mode::Aided), "{modes:?}");
    assert!(!modes.contains(&Mode::Lost) && counts.most_sigma_m < 40.0, "{}", counts.most_sigma_m);
    let (error_m, sigma_m) = (flight.error_m().unwrap(), flight.solution.unwrap().horizontal_sigma_m());
    assert!(error_m < 4.0 * sigma_m, "{error_m} m at {sigma_m} m");
    let (offset, round_trip) = flight.timesync().unwrap();
    assert!((offset.seconds() - plan.boot_s).abs() < 0.1 && round_trip.seconds() < 0.1, "{offset:?}");
}
