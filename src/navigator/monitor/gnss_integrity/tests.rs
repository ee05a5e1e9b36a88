//! Trust in a receiver: how it is lost, and the way back.

use super::*;

fn settings() -> TrustSettings {
    TrustSettings {
        loss_s: 1.0,
        recover_s: 3.0,
        recover_far_s: 10.0,
        min_satellites: 5,
        max_horizontal_accuracy_m: 10.0,
        gate_sigma: 5.0,
        min_position_gate_m: 4.0,
        min_velocity_gate_mps: 2.0,
    }
}

fn at(s: f64) -> AutopilotTime {
    AutopilotTime::from_micros((s * 1e6) as i64)
}

fn off(position_m: f64) -> FixInnovation {
    FixInnovation {
        position_m,
        velocity_mps: Some(0.1),
        position_sigma_m: 0.1,
        velocity_sigma_mps: 0.1,
        drift_sigma_m: 0.1,
        aided: false,
        carried: true,
        speed_mps: 3.0,
    }
}

fn near() -> Option<FixInnovation> {
    Some(off(0.3))
}

fn trusted_after(seconds: f64) -> GnssIntegrity {
    let mut t = GnssIntegrity::new(settings());
    let mut time = 0.0;
    while time < seconds {
        let v = Vector2::new(3.0, 0.0);
        assert_eq!(t.judge(at(time), v * time, Some(v), near()), Ok(Standing::Near));
        t.good(at(time), Standing::Near);
        time += 0.2;
    }
    t
}

#[test]
fn trust_takes_time_and_silence_ends_it() {
    let mut t = trusted_after(2.0);
    assert!(!t.trusted());
    t = trusted_after(4.0);
    assert!(t.trusted());
    assert!(!t.check(at(4.5)));
    assert!(t.check(at(5.2)));
    assert_eq!(t.state(), GnssState::Untrusted(GnssFault::Silence));
}

const V: Vector2<f64> = Vector2::new(3.0, 0.0);

/// Fixes from `from_s` on that lie off by `by`; when trust was lost, and when it was won.
fn judged(t: &mut GnssIntegrity, from_s: f64, to_s: f64, by: f64, i: &FixInnovation) -> [Option<f64>; 2] {
    let mut changes = [None, None];
    let mut time = from_s;
    while time < to_s {
        let lost = match t.judge(at(time), V * time + Vector2::new(0.0, by), Some(V), Some(*i)) {
            Ok(standing) => {
                changes[1] = changes[1].or(t.good(at(time), standing).then_some(time));
                false
            }
            Err(fault) => t.bad(at(time), fault),
        };
        changes[0] = changes[0].or(lost.then_some(time));
        time += 0.2;
    }
    changes
}

#[test]
fn a_jump_is_not_believed_for_standing_where_flow_carries() {
    let mut t = trusted_after(10.0);
    let [lost, won] = judged(&mut t, 10.0, 300.0, 5.0, &off(5.0));
    assert!(lost.unwrap() < 11.5, "{lost:?}");
    assert_eq!(won, None);
    // And its end is.
    let [_, won] = judged(&mut t, 300.0, 310.0, 0.0, &off(0.3));
    assert!(won.unwrap() < 305.0, "{won:?}");
}

#[test]
fn a_jump_is_believed_where_the_dead_reckoning_may_be_off_by_as_much() {
    let mut t = trusted_after(10.0);
    assert_eq!(judged(&mut t, 10.0, 40.0, 5.0, &off(5.0))[1], None);
    let unsure = FixInnovation { drift_sigma_m: 6.0, position_sigma_m: 6.0, ..off(5.0) };
    assert!(judged(&mut t, 40.0, 50.0, 5.0, &unsure)[1].unwrap() < 44.0);
    // Without anything that carries, time has to tell.
    let mut t = trusted_after(10.0);
    let coasting = FixInnovation { carried: false, ..off(5.0) };
    let won = judged(&mut t, 10.0, 60.0, 5.0, &coasting)[1].unwrap();
    assert!((20.0..30.0).contains(&won), "{won}");
}

#[test]
fn a_slow_walk_is_lost_at_once_when_it_is_found_and_its_size_is_known() {
    let mut t = trusted_after(100.0);
    let mut found = None;
    for k in 0..200 {
        let time = 100.0 + 0.2 * f64::from(k);
        let walked = Vector2::new(0.0, 0.75 * (time - 100.0));
        if let Err(fault) = t.judge(at(time), V * time + walked, Some(V), near()) {
            assert_eq!(fault, GnssFault::Inconsistent);
            assert!(t.bad(at(time), fault), "it leaves no doubt");
            found = Some((time, walked));
            break;
        }
    }
    let (time, walked) = found.unwrap();
    assert!(time < 115.0, "{time}");
    assert!((t.walked() - walked).norm() < 2.0, "{} {walked}", t.walked());
}

#[test]
fn what_the_receiver_says_of_itself_is_believed_at_once_and_taken_back_after_some_seconds() {
    let mut t = trusted_after(10.0);
    assert!(t.bad(at(10.0), GnssFault::Spoofed));
    assert_eq!(t.state(), GnssState::Untrusted(GnssFault::Spoofed));
    let won = judged(&mut t, 12.0, 20.0, 0.0, &off(0.3))[1].unwrap();
    assert!((14.9..15.5).contains(&won), "{won}");
}

#[test]
fn a_fix_that_comes_and_goes_has_to_stay_for_longer_and_is_forgiven() {
    let mut t = trusted_after(40.0);
    let mut from_s = 40.0;
    let mut needed = Vec::new();
    for _ in 0..5 {
        t.bad(at(from_s + 2.0), GnssFault::NoFix);
        let won = judged(&mut t, from_s + 3.0, from_s + 30.0, 0.0, &off(0.3))[1].unwrap();
        needed.push(won - from_s - 3.0);
        from_s += 30.0;
    }
    assert!(needed[0] < 3.5 && needed[4] > 6.0 && needed[4] < 16.0, "{needed:?}");
    judged(&mut t, from_s, from_s + 60.0, 0.0, &off(0.3));
    t.bad(at(from_s + 62.0), GnssFault::NoFix);
    let won = judged(&mut t, from_s + 63.0, from_s + 80.0, 0.0, &off(0.3))[1].unwrap();
    assert!(won - from_s - 63.0 < 3.5, "{won}");
}

#[test]
fn a_fix_has_to_be_one() {
    let t = GnssIntegrity::new(settings());
    let mut fix = GnssSample {
        time: at(0.0),
        receiver: 0,
        fix: GnssFix::ThreeD,
        position: Some(crate::geo::Geodetic::from_degrees(47.0, 8.0, 400.0)),
        ground_velocity: None,
        horizontal_accuracy_m: None,
        vertical_accuracy_m: None,
        speed_accuracy_mps: None,
        satellites: None,
        warning: None,
    };
    assert_eq!(t.admit(&fix), Ok(()));
    let warned = |warning| t.admit(&GnssSample { warning: Some(warning), ..fix });
    assert_eq!(warned(GnssWarning::Spoofed), Err(GnssFault::Spoofed));
    assert_eq!(warned(GnssWarning::Jammed), Err(GnssFault::Jammed));
    assert_eq!(warned(GnssWarning::Inconsistent), Err(GnssFault::SignalsInconsistent));
    fix.satellites = Some(3);
    assert_eq!(t.admit(&fix), Err(GnssFault::FewSatellites));
    fix.satellites = Some(12);
    fix.horizontal_accuracy_m = Some(35.0);
    assert_eq!(t.admit(&fix), Err(GnssFault::Inaccurate));
    fix.fix = GnssFix::None;
    assert_eq!(t.admit(&fix), Err(GnssFault::NoFix));
}

#[test]
fn a_walk_has_led_the_estimate_as_far_as_it_was_followed() {
    let mut t = trusted_after(4.0);
    let walked = Vector2::new(3.0, 4.0);
    t.walks(walked, 0.5);
    for (apart, led) in [(0.0, 1.0), (0.4, 0.6), (1.5, 0.0), (-0.5, 1.0)] {
        t.leads(&(walked * apart + Vector2::new(-4.0, 3.0)));
        assert!((t.led() - walked * led).norm() < 1e-9, "{apart}: {}", t.led());
    }
    t.walks(Vector2::zeros(), 0.0);
    t.leads(&walked);
    assert_eq!(t.led(), Vector2::zeros());
}
