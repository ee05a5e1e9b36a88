//! The bank that finds the heading from motion, flown on closed-form truth with sensors that err: every initial heading, several seeds, starts
//! at rest, in motion and in a steep turn; and flights that do not show the heading.

use crate::flight;
use holdover::filter::{BankVerdict, HeadingBank, HeadingBankSettings};
use holdover::geo::so3::{self, Euler};
use holdover::sim::models::{GnssModel, ImuModel};
use holdover::sim::{Reading, Scenario, SensorSuite, Simulation, Trajectory};
use holdover::time::{AutopilotTime, Span};
use nalgebra::{Vector2, Vector3};

struct Outcome {
    /// When the heading was found, s.
    found_s: Option<f64>,
    /// Heading error then, and what was claimed, rad.
    at_found: Option<(f64, f64)>,
    /// Heading sigma and error, tilt error at the end, rad.
    end: (f64, f64, f64),
    least_sigma: f64,
}

struct Setup<'a> {
    flight: &'a [Reading],
    /// How far the flight is turned about the vertical: the same under another north.
    north_deg: f64,
    begins_s: f64,
}

/// How late the bank is told that fixes are, s.
const TOLD_S: f64 = 0.12;

/// A flight with a MEMS IMU and fixes that are later than told.
fn read(scenario: &Scenario, duration_s: f64, seed: u64, late_s: f64) -> Vec<Reading> {
    let white = flight::white(ImuModel::mems());
    let gnss = white.gnss.map(|g| GnssModel { latency_s: TOLD_S + late_s, ..g });
    let suite = SensorSuite { gnss, magnetometer: None, barometer: None, flow: None, ..white };
    Simulation::new(scenario.clone().lasting(duration_s), suite, seed).collect()
}

fn fly(s: &Setup<'_>) -> Outcome {
    let north = Euler::new(0.0, 0.0, s.north_deg.to_radians()).to_rotation();
    let gravity = Scenario::hover().environment.gravity_mps2;
    let mut bank = HeadingBank::new(HeadingBankSettings::standard(), gravity);
    let mut out = Outcome { found_s: None, at_found: None, end: (0.0, 0.0, 0.0), least_sigma: 9.0 };
    for r in s.flight.iter().filter(|r| r.t_s > s.begins_s) {
        bank.imu(r.time, r.dt_s, &r.imu.measured.angular_rate, &r.imu.measured.specific_force);
        let Some(fix) = r.gnss.filter(|fix| fix.measured_s > s.begins_s) else { continue };
        let velocity = north * fix.velocity_ned;
        bank.velocity(r.time - Span::from_seconds(TOLD_S), &velocity.xy(), 0.15, 0.06);
        let Some(e) = bank.estimate() else { continue };
        let error = so3::log(&(e.r_body_to_ned * (north * r.truth.r_body_to_ned).transpose()));
        out.end = (e.heading_sigma, error.z, error.xy().norm());
        out.least_sigma = out.least_sigma.min(e.heading_sigma);
        if out.found_s.is_none() && bank.found().is_some() {
            out.found_s = Some(r.t_s - s.begins_s);
            out.at_found = Some((error.z, e.heading_sigma));
        }
    }
    out
}

/// Flies from every heading and several seeds; returns the latest time at which it was found, the worst error then in degrees, and the mean
/// squared error over claimed variance.
fn all_headings(scenario: &Scenario, begins: &[f64], late_s: f64, duration_s: f64) -> (f64, f64, f64) {
    let (mut latest, mut worst_error, mut sum, mut n) = (0.0f64, 0.0f64, 0.0, 0.0);
    for seed in 0..3u64 {
        for &begins_s in begins {
            let flight = read(scenario, begins_s + duration_s, seed, late_s);
            for i in 0..12 {
                let north_deg = 30.0 * f64::from(i) + 7.0 * seed as f64;
                let o = fly(&Setup { flight: &flight, north_deg, begins_s });
                let found = o.found_s.unwrap_or_else(|| {
                    panic!(
                        "from {begins_s} s, north {north_deg}, seed {seed}: sigma {}",
                        o.end.0.to_degrees()
                    )
                });
                let (error, sigma) = o.at_found.unwrap();
                latest = latest.max(found);
                worst_error = worst_error.max(error.abs().to_degrees());
                sum += (error / sigma).powi(2);
                n += 1.0;
                let (sigma, error, tilt) = o.end;
                assert!(error.abs() < 3.5 * sigma, "{} of {}", error.to_degrees(), sigma.to_degrees());
                assert!(tilt < 0.05, "tilt {} deg", tilt.to_degrees());
            }
        }
    }
    (latest, worst_error, sum / n)
}

#[test]
fn a_multirotor_that_flies_a_square_is_found_on_its_first_leg() {
    // From rest, in the middle of a leg, and while it slows down.
    let found = all_headings(&Scenario::corners(), &[0.0, 14.0, 20.0], 0.0, 60.0);
    println!("latest {} s, worst {} deg, NEES {}", found.0, found.1, found.2);
    assert!(found.0 < 25.0 && found.1 < 15.0 && found.2 < 1.5, "{found:?}");
}

#[test]
fn a_wing_in_a_steep_turn_is_found_from_the_first_sample_in_it() {
    for (radius, bank_deg) in [(60.0, 39.0), (28.0, 60.0)] {
        let circle = Scenario::circle(radius, 22.0, 0.0);
        let bank = Euler::from_rotation(&circle.at(0.0).r_body_to_ned).roll_rad.to_degrees();
        assert!((bank - bank_deg).abs() < 2.0, "{bank}");
        let found = all_headings(&circle, &[0.0], 0.0, 60.0);
        println!("bank {bank} deg: latest {} s, worst {} deg, NEES {}", found.0, found.1, found.2);
        assert!(found.0 < 10.0 && found.1 < 15.0 && found.2 < 1.5, "{bank}: {found:?}");
    }
}

#[test]
fn a_wing_that_turns_to_both_sides_is_found() {
    let eight = Scenario::figure_eight();
    let found = all_headings(&eight, &[0.0, 20.0, 33.0], 0.0, 80.0);
    println!("latest {} s, worst {} deg, NEES {}", found.0, found.1, found.2);
    assert!(found.0 < 25.0 && found.1 < 15.0 && found.2 < 1.5, "{found:?}");
}

#[test]
fn fixes_that_are_later_than_thought_cost_little_and_are_claimed() {
    let found = all_headings(&Scenario::corners(), &[0.0], 0.06, 60.0);
    println!("square, 60 ms: {found:?}");
    assert!(found.1 < 15.0 && found.2 < 1.5, "{found:?}");
    let circle = Scenario::circle(60.0, 22.0, 0.0);
    let found = all_headings(&circle, &[0.0], 0.06, 60.0);
    println!("circle, 60 ms: {found:?}");
    assert!(found.1 < 15.0 && found.2 < 1.5, "{found:?}");
}

#[test]
fn a_flight_without_acceleration_says_that_the_heading_is_unknown() {
    let straight = Scenario::northwards(22.0, 0.0);
    let hover = Scenario::hover();
    // In a steady and gentle turn any heading fits with some gyro bias of a degree a second.
    let gentle = Scenario::circle(250.0, 22.0, 0.0);
    for scenario in [&straight, &hover, &gentle] {
        for seed in 0..5 {
            let flight = read(scenario, 120.0, seed, 0.0);
            let o = fly(&Setup { flight: &flight, north_deg: 60.0 * seed as f64, begins_s: 0.0 });
            println!("least sigma {}", o.least_sigma.to_degrees());
            assert!(o.found_s.is_none());
            assert!(o.least_sigma > 0.7, "{}", o.least_sigma.to_degrees());
        }
    }
}

#[test]
fn hostile_samples_and_fixes_are_refused_and_a_wrong_bank_starts_anew() {
    let mut bank = HeadingBank::new(HeadingBankSettings::standard(), 9.81);
    let at = |k: i64| AutopilotTime::from_micros(k * 10_000);
    let (still, up) = (Vector3::zeros(), Vector3::new(0.0, 0.0, -9.81));
    let north = Vector2::new(3.0, 0.0);
    assert_eq!(bank.velocity(at(0), &north, 0.15, 0.06), BankVerdict::TooEarly);
    for k in 1..100 {
        bank.imu(at(k), 0.01, &still, &up);
        bank.imu(at(k), 0.01, &Vector3::repeat(f64::NAN), &up);
        bank.imu(at(k), f64::NAN, &still, &up);
        bank.imu(at(k), -1.0, &still, &up);
    }
    assert_eq!(bank.velocity(at(300), &north, 0.15, 0.06), BankVerdict::Untimely);
    assert_eq!(bank.velocity(at(90), &Vector2::repeat(f64::NAN), 0.15, 0.06), BankVerdict::Outlier);
    assert_eq!(bank.velocity(at(90), &north, 0.15, 0.06), BankVerdict::Started);
    assert_eq!(bank.velocity(at(80), &north, 0.15, 0.06), BankVerdict::Untimely);
    for k in 100..2000 {
        bank.imu(at(k), 0.01, &still, &up);
        bank.imu(at(k - 50), 0.01, &still, &up);
        if k % 10 == 0 {
            // At first velocities that no motion explains; then they stay, and the bank begins with them.
            let wild = Vector2::new(0.0, if k < 1000 { -300.0 } else { 3.0 });
            bank.velocity(at(k), &wild, 0.15, 0.06);
        }
        let e = bank.estimate();
        assert!(e.is_none_or(|e| e.r_body_to_ned.sum().is_finite() && e.heading_sigma.is_finite()));
        assert!(bank.found().is_none());
    }
    assert!((bank.estimate().unwrap().velocity_ne - Vector2::new(0.0, 3.0)).norm() < 0.3);
    // No fix for longer than the ring holds: nothing grows, nothing breaks.
    for k in 2000..6000 {
        bank.imu(at(k), 0.01, &still, &up);
    }
    assert_eq!(bank.velocity(at(5999), &north, 0.15, 0.06), BankVerdict::Started);
}
