//! Whole flights of the double, without any companion and with a perfect one.

use super::ekf3::{AidingSet, AidingSource};
use super::external::{ExternalFate, ExternalMessage, ReportedFrame};
use super::script::ScriptLeg;
use super::*;

const GPS: AidingSet = AidingSet {
    position: AidingSource::Gps,
    velocity: AidingSource::Gps,
    climb: AidingSource::Gps,
    height: AidingSource::Own,
    heading: AidingSource::Own,
};

fn ardupilot(viso_type: u8) -> AidingRules {
    let external = AidingSource::ExternalNav;
    AidingRules::Ekf3(Ekf3Settings {
        viso_type,
        delay_s: 0.0,
        least_quality: 0,
        position_noise_m: 0.2,
        velocity_noise_mps: 0.1,
        sets: [GPS, AidingSet { position: external, velocity: external, climb: external, ..GPS }, GPS],
    })
}

fn px4(control: u8) -> AidingRules {
    AidingRules::Ekf2(Ekf2Settings {
        control,
        delay_s: 0.0,
        most_delay_s: 0.2,
        least_quality: 0,
        position_noise_m: 0.1,
        velocity_noise_mps: 0.1,
        no_aid_s: 5.0,
    })
}

fn vehicle(rules: AidingRules, script: FlightScript, wind: f64) -> SimulatedAutopilot {
    SimulatedAutopilot::new(VehicleSetup {
        rules,
        imu: ImuModel::mems(),
        sees: true,
        wind_ned: Vector3::new(0.6, 0.8, 0.0) * wind,
        script,
        step_us: 4000,
        seed: 5,
    })
}

fn outage(hold_s: f64) -> FlightScript {
    FlightScript::outage(15.0, hold_s, Some(OutageKind::NoFix), true)
}

/// What a perfect companion sends: the truth in the vehicle's frame, off by so much.
fn told(vehicle: &SimulatedAutopilot, off: &Vector3<f64>) -> Option<ExternalPose> {
    let origin = vehicle.own.origin?.0;
    let truth = vehicle.truth();
    let frame = match vehicle.own.aiding {
        OwnAiding::Ekf3(_) => ReportedFrame::LocalFrd,
        OwnAiding::Ekf2(_) => ReportedFrame::LocalNed,
    };
    Some(ExternalPose {
        message: ExternalMessage::Odometry {
            pose: frame,
            velocity: ReportedFrame::BodyFrd,
            estimator_type: 3,
            quality: 90,
        },
        stamp_s: vehicle.boot_time().micros() as f64 * 1e-6,
        arrived_s: vehicle.now_s(),
        position: Some(truth.position_ned - origin + off),
        attitude: Some(truth.r_body_to_ned),
        quaternion_error: 0.0,
        velocity: Some(truth.velocity_body()),
        position_variance: Vector3::repeat(0.01),
        velocity_variance: Vector3::repeat(0.01),
        reset_counter: 0,
    })
}

/// Flies to the end, or for ten minutes; returns the truth every 0.1 s with what happened.
fn fly(
    vehicle: &mut SimulatedAutopilot,
    companion: impl Fn(&SimulatedAutopilot) -> Option<ExternalPose>,
) -> (Vec<Truth>, Vec<(f64, VehicleNews)>) {
    let (mut track, mut news) = (Vec::new(), Vec::new());
    for k in 0..150_000u32 {
        vehicle.step();
        news.extend(vehicle.take_news().into_iter().map(|n| (vehicle.now_s(), n)));
        if k % 8 == 0
            && let Some(pose) = companion(vehicle)
        {
            vehicle.external(&pose, true);
        }
        if k % 25 == 0 {
            track.push(*vehicle.truth());
        }
        if vehicle.is_done() {
            break;
        }
    }
    assert!(vehicle.is_done(), "{news:?}");
    (track, news)
}

fn when(news: &[(f64, VehicleNews)], wanted: VehicleNews) -> Option<f64> {
    news.iter().find(|(_, n)| *n == wanted).map(|(t, _)| *t)
}

fn farthest(track: &[Truth], from: &Truth, until_s: f64) -> f64 {
    let within = track.iter().filter(|t| (from.t_s..until_s).contains(&t.t_s));
    within.map(|t| (t.position_ned - from.position_ned).xy().norm()).fold(0.0, f64::max)
}

#[test]
fn with_gnss_both_fly_the_script_and_land_where_they_took_off() {
    let square = || {
        let fly = |north_m, east_m| ScriptLeg::FlyTo { north_m, east_m, heading_rad: 0.5 };
        let legs =
            [ScriptLeg::TakeOff(10.0), fly(20.0, 0.0), fly(20.0, 20.0), fly(0.0, 0.0), ScriptLeg::Land];
        FlightScript::new([ScriptLeg::Wait(15.0), ScriptLeg::Arm].into_iter().chain(legs))
    };
    for rules in [ardupilot(0), px4(0)] {
        let mut vehicle = vehicle(rules, square(), 5.0);
        let (track, news) = fly(&mut vehicle, |_| None);
        assert_eq!(when(&news, VehicleNews::Failsafe), None);
        let far = track.iter().map(|t| t.position_ned.xy().norm()).fold(0.0, f64::max);
        assert!((26.0..32.0).contains(&far), "{far}");
        assert!(track.iter().any(|t| (t.position_ned.z + 10.0).abs() < 1.0));
        // The receiver wanders by a metre an axis.
        assert!(vehicle.truth().position_ned.xy().norm() < 4.0, "{}", vehicle.truth().position_ned);
    }
}

#[test]
fn alone_in_an_outage_each_lands_by_its_own_failsafe() {
    for (rules, earliest, latest) in [(ardupilot(0), 15.5, 16.5), (px4(0), 5.0, 6.0)] {
        let script = FlightScript::outage(15.0, 60.0, Some(OutageKind::NoFix), false);
        let mut vehicle = vehicle(rules, script, 5.0);
        let mut lost = None;
        for _ in 0..100_000 {
            vehicle.step();
            if lost.is_none() && vehicle.sensors.newest().gnss.is_some_and(|g| g.position.is_none()) {
                lost = Some(vehicle.now_s());
            }
            let news = vehicle.take_news();
            if news.contains(&VehicleNews::Failsafe) {
                let after = vehicle.now_s() - lost.unwrap();
                assert!((earliest..latest).contains(&after), "{after} s after the loss");
                break;
            }
        }
        assert_eq!(vehicle.mode(), FlightMode::FailsafeLanding);
    }
}

#[test]
fn a_perfect_companion_carries_both_through_the_outage() {
    for rules in [ardupilot(1), px4(15)] {
        let mut vehicle = vehicle(rules, outage(30.0), 5.0);
        let (_, news) = fly(&mut vehicle, |v| told(v, &Vector3::zeros()));
        assert_eq!(when(&news, VehicleNews::Failsafe), None, "{news:?}");
        assert_eq!(vehicle.mode(), FlightMode::Landing);
        assert!(vehicle.external_counts().of(ExternalFate::Fused) > 1000, "{:?}", vehicle.external_counts());
        assert!(vehicle.truth().position_ned.xy().norm() < 4.0, "{}", vehicle.truth().position_ned);
    }
}

#[test]
fn an_estimate_that_drifts_moves_the_vehicle() {
    let script = || FlightScript::outage(15.0, 40.0, Some(OutageKind::NoFix), true);
    let moved = |drift_mps: f64| {
        let mut vehicle = vehicle(ardupilot(1), script(), 0.0);
        let began = std::cell::Cell::new(f64::NAN);
        let (track, news) = fly(&mut vehicle, |v| {
            if v.sensors.newest().gnss.is_some_and(|g| g.position.is_none()) && began.get().is_nan() {
                began.set(v.now_s());
            }
            let since = v.now_s() - began.get();
            told(v, &Vector3::new(if since > 0.0 { drift_mps * since } else { 0.0 }, 0.0, 0.0))
        });
        let switched = when(&news, VehicleNews::SetSelected(2)).unwrap();
        let start = *track.iter().find(|t| t.t_s > switched + 3.0).unwrap();
        farthest(&track, &start, switched + 38.0)
    };
    let (still, drifted) = (moved(0.0), moved(0.1));
    assert!(still < 0.6, "{still}");
    assert!((2.5..4.5).contains(&drifted), "0.1 m/s for 35 s: {drifted}");
}

#[test]
fn who_waits_for_messages_does_not_arm_without() {
    let mut vehicle = vehicle(ardupilot(1), outage(5.0), 0.0);
    for _ in 0..10_000 {
        vehicle.step();
    }
    assert!(!vehicle.armed());
    assert!(vehicle.take_news().contains(&VehicleNews::ExternalNotHealthy));
    assert_eq!(vehicle.arm(), Err(VehicleNews::ExternalNotHealthy));
    vehicle.external(&told(&vehicle, &Vector3::zeros()).unwrap(), false);
    assert_eq!(vehicle.arm(), Ok(()));
    assert!(!vehicle.reboot(), "not while it is armed");
}

#[test]
fn one_seed_is_one_flight() {
    let run = |seed| {
        let mut setup = vehicle(px4(0), outage(5.0), 5.0).setup;
        setup.seed = seed;
        let mut vehicle = SimulatedAutopilot::new(setup);
        for _ in 0..12_000 {
            vehicle.step();
        }
        *vehicle.truth()
    };
    assert_eq!(run(1), run(1));
    assert_ne!(run(1).position_ned, run(2).position_ned);
}

#[test]
fn a_reboot_begins_anew() {
    let mut vehicle = vehicle(px4(0), FlightScript::new([ScriptLeg::Wait(1000.0)]), 0.0);
    for _ in 0..5000 {
        vehicle.step();
    }
    assert!(vehicle.origin().is_some() && vehicle.aiding().has_position(vehicle.now_s()));
    assert!(vehicle.reboot());
    assert!(vehicle.origin().is_none() && vehicle.boot_time().micros() == 0);
    assert!(!vehicle.aiding().has_position(vehicle.now_s()));
}
