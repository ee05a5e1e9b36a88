//! The published height on recorded flights: right, without steps, and what is wrong with its sources is told.

use std::path::Path;

use crate::heights::{Heights, Told, fly};
use holdover::altimeter::{Channel, Fault};
use holdover::config::{Settings, Sources};
use holdover::log::Log;
use holdover::navigator::verdict::Reason;
use holdover::sample::{GnssFix, Input, Sample, SampleKind};

const BARO_FAULTS: &str = "ardupilot-copter-baro-faults";
const GPS_GLITCHES: &str = "ardupilot-copter-gps-glitches";
const GPS_LOSS: &str = "ardupilot-copter-gps-loss";
const PX4_LOSS: &str = "px4-quad-gps-loss";
/// The first sample of the flight with barometer faults comes so long after its first frame, from which its events count, s.
const FIRST_SAMPLE_S: f64 = 1.9;
/// The published height does not move by more than this between two IMU samples beyond its climb, m.
const STEP_M: f64 = 0.1;

fn flown(name: &str, filter: &str, change: impl FnMut(f64, Input, &mut Vec<Input>)) -> crate::heights::Watch {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("sitl-logs").join(format!("{name}.tlog"));
    let sources = Sources { overrides: vec![format!("navigator.altimeter={filter}")], ..Sources::default() };
    let settings = Settings::load(&sources).unwrap().pipeline;
    fly(&Log::open(&path, None).unwrap(), &settings, &[], change).unwrap()
}

/// As recorded.
fn flight(name: &str, filter: &str) -> Heights {
    flown(name, filter, |_, item, heard| heard.push(item)).finish()
}

fn check(name: &str, h: &Heights, rmse_m: f64) {
    assert!(h.truth && h.compared.len() > 1000, "{name}: {}", h.compared.len());
    let rmse = h.rmse_m().unwrap();
    assert!(rmse < rmse_m, "{name}: {rmse} m");
    let within = h.within_2_sigma_percent().unwrap();
    assert!(within > 90.0, "{name}: {within} % within 2 sigma");
    assert!(h.resets.is_empty(), "{name}: {:?}", h.resets);
    assert!(h.largest_step.1.abs() < STEP_M, "{name}: step {:?}", h.largest_step);
}

fn biases(h: &Heights, channel: Channel) -> Vec<(&Told, f64)> {
    let size = |f: &Told| if let Fault::Bias { size_m, .. } = f.fault { Some(size_m) } else { None };
    h.faults.iter().filter(|f| f.channel == channel).filter_map(|f| Some((f, size(f)?))).collect()
}

/// A fault that is told as it was: since when within a second, how large within a metre.
fn check_bias(h: &Heights, channel: Channel, size_m: f64, from_s: f64, to_s: f64) {
    let told = biases(h, channel);
    let Some((fault, size)) = told.first() else { panic!("not told: {:?}", h.faults) };
    assert!((size - size_m).abs() < 1.0, "{fault:?}");
    assert!((fault.since_s - from_s).abs() < 1.0 && fault.at_s - from_s < 2.0, "{fault:?}");
    assert!(fault.until_s.is_some_and(|t| (t - to_s).abs() < 3.0), "{fault:?}");
}

#[test]
fn a_barometer_step_and_noise_are_told_and_the_height_stays_right() {
    let h = flight(BARO_FAULTS, "default");
    check(BARO_FAULTS, &h, 0.3);
    check_bias(&h, Channel::Baro, 7.0, 136.65 - FIRST_SAMPLE_S, 196.8 - FIRST_SAMPLE_S);
    // The step was in both barometers.
    check_bias(&h, Channel::SecondBaro, 7.0, 136.65 - FIRST_SAMPLE_S, 196.8 - FIRST_SAMPLE_S);
    // What else is told is the noise, while it lasts.
    let (from, to) = (236.84 - FIRST_SAMPLE_S, 297.11 - FIRST_SAMPLE_S);
    for fault in h.faults.iter().filter(|f| f.at_s > 200.0) {
        let noise = matches!(fault.fault, Fault::Noise { .. }) && fault.channel != Channel::Gnss;
        assert!(noise && fault.since_s > from - 1.0, "{fault:?}");
        assert!(fault.until_s.is_some_and(|t| t < to + 5.0), "{fault:?}");
    }
    assert!(h.rmse_between_m(from, to).unwrap() < 0.4);
    let okf = flight(BARO_FAULTS, "okf").rmse_m().unwrap();
    assert!(okf > 4.0 * h.rmse_m().unwrap(), "the optimal filter: {okf} m");
}

#[test]
fn a_step_of_the_gnss_height_is_told_and_the_height_stays_right() {
    let h = flight(GPS_GLITCHES, "default");
    check(GPS_GLITCHES, &h, 0.2);
    check_bias(&h, Channel::Gnss, 25.0, 287.2, 317.2);
    assert!(h.faults.iter().all(|f| f.channel == Channel::Gnss), "{:?}", h.faults);
    let okf = flight(GPS_GLITCHES, "okf").rmse_m().unwrap();
    assert!(okf > 10.0 * h.rmse_m().unwrap(), "the optimal filter: {okf} m");
}

#[test]
fn gnss_that_is_gone_is_no_fault() {
    for (name, rmse_m) in [(GPS_LOSS, 0.2), (PX4_LOSS, 0.15)] {
        let h = flight(name, "default");
        check(name, &h, rmse_m);
        assert!(h.faults.is_empty(), "{name}: {:?}", h.faults);
    }
}

/// Without GNSS a barometer that jumps is outvoted by another one and by inertia.
#[test]
fn a_second_barometer_votes() {
    for step_m in [-8.0, 8.0] {
        let mut first = None;
        let h = flown(GPS_LOSS, "default", |t, mut item, heard| {
            if let Input::Sample(Sample::Pressure(s)) = &mut item
                && *first.get_or_insert(s.sensor) == s.sensor
                && (180.0..210.0).contains(&t)
            {
                s.pressure_pa *= (-step_m / 8400.0_f64).exp();
            }
            heard.push(item);
        })
        .finish();
        check(GPS_LOSS, &h, 0.4);
        check_bias(&h, Channel::Baro, step_m, 180.0, 210.0);
        assert!(h.faults.iter().all(|f| f.channel == Channel::Baro), "{step_m}: {:?}", h.faults);
    }
}

/// What is no measurement at all never reaches the altimeter.
#[test]
fn pressures_of_zero_and_heights_without_a_fix_are_refused_as_such() {
    let mut zeros = 0;
    let watch = flown(PX4_LOSS, "default", |t, mut item, heard| {
        if (100.0..120.0).contains(&t) {
            match &mut item {
                Input::Sample(Sample::Pressure(s)) => {
                    s.pressure_pa = if zeros % 2 == 0 { 0.0 } else { f64::NAN };
                    zeros += 1;
                }
                Input::Sample(Sample::Gnss(s)) => {
                    s.fix = GnssFix::None;
                    s.position = s.position.map(|p| holdover::geo::Geodetic { height_m: 0.0, ..p });
                }
                _ => (),
            }
        }
        heard.push(item);
    });
    let tally = watch.runner().pipeline.navigator.statuses();
    let refused = tally.rejected(SampleKind::Pressure).find(|(r, _)| *r == Reason::NotFinite).map(|(_, n)| n);
    assert!(zeros > 100 && refused == Some(zeros), "{zeros} {refused:?}");
    let h = watch.finish();
    // Twenty seconds of inertia alone.
    check(PX4_LOSS, &h, 0.6);
    assert!(h.faults.is_empty(), "{:?}", h.faults);
}

/// A fix that claims to be one and has a height of zero: the flight's height is not.
#[test]
fn a_fix_with_a_height_of_zero_is_a_fault() {
    let h = flown(GPS_LOSS, "default", |t, mut item, heard| {
        if let Input::Sample(Sample::Gnss(s)) = &mut item
            && (90.0..110.0).contains(&t)
        {
            s.position = s.position.map(|p| holdover::geo::Geodetic { height_m: 0.0, ..p });
        }
        heard.push(item);
    })
    .finish();
    check(GPS_LOSS, &h, 0.3);
    let told = biases(&h, Channel::Gnss);
    assert!(
        told.first().is_some_and(|(f, size)| *size < -300.0 && (f.since_s - 90.0).abs() < 1.0),
        "{told:?}"
    );
    assert!(told.iter().all(|(f, _)| f.until_s.is_some_and(|t| t < 115.0)), "{told:?}");
}
