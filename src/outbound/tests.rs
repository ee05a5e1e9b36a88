//! The output as a whole.

use super::*;
use crate::geo::{Body, BodyToNed, Ned, so3};
use crate::navigator::solution::VelocitySource;
use nalgebra::Matrix3;

fn settings(publish: Publish) -> OutboundSettings {
    OutboundSettings {
        publish,
        coasting: Coasting::Briefly,
        covariance: Covariance::Correlated,
        carriage: Carriage::Odometry,
        profile: Profile::Ardupilot,
        rate_hz: 30.0,
        worst_sigma_m: 50.0,
        farewell_s: 1.0,
    }
}

fn solution(ms: i64, mode: Mode) -> Solution {
    Solution {
        time: AutopilotTime::from_micros(ms * 1000),
        mode,
        velocity_source: VelocitySource::Flow,
        position: Ned::new(Vector3::new(10.0, 20.0, -5.0)),
        velocity: Ned::new(Vector3::new(1.0, 2.0, 0.5)),
        glide_velocity: Ned::new(Vector3::zeros()),
        attitude: BodyToNed::from_matrix(&so3::exp(&Vector3::new(0.1, -0.2, 2.0))),
        angular_rate: Body::new(Vector3::zeros()),
        position_covariance: Ned::new(Matrix3::identity() * 4.0),
        velocity_covariance: Ned::new(Matrix3::identity() * 0.04),
        attitude_variance: Vector3::new(1e-4, 1e-4, 4e-4),
        reset_counter: 3,
    }
}

fn run(out: &mut Outbound, from_ms: i64, to_ms: i64, mode: Mode) -> Vec<Odometry> {
    let mut messages = Vec::new();
    for ms in (from_ms..to_ms).step_by(5) {
        out.step(&solution(ms, mode), &mut messages);
    }
    messages
        .into_iter()
        .map(|m| match m {
            OutboundMessage::Odometry(o) => o,
            other => panic!("{other:?}"),
        })
        .collect()
}

#[test]
fn thirty_a_second_in_holdover_and_none_while_aided() {
    let mut out = Outbound::new(settings(Publish::Holdover));
    out.origin_shared(None);
    assert_eq!(run(&mut out, 0, 1000, Mode::Aided).len(), 0);
    let sent = run(&mut out, 1000, 11_000, Mode::Holdover);
    assert!((299..=301).contains(&sent.len()), "{}", sent.len());
    assert!(sent.windows(2).all(|w| w[1].time > w[0].time));
    assert_eq!(sent[0].frame, PoseFrame::LocalFrd);
    let v = solution(0, Mode::Holdover);
    assert_eq!(sent[0].attitude, v.attitude);
    assert!((v.attitude.to_ned(sent[0].velocity) - v.velocity).raw().norm() < 1e-12);
    // It may have been relied on: it ends when the autopilot has been seen on GNSS, and not before.
    assert!(!run(&mut out, 11_000, 12_000, Mode::Aided).is_empty());
    assert_eq!(out.sending(), Sending::NotSeenOff);
    out.set_standing(StandsOn::Ours);
    assert!(!run(&mut out, 12_000, 13_000, Mode::Aided).is_empty());
    assert_eq!(out.sending(), Sending::FlownOn);
    out.set_standing(StandsOn::Gnss);
    assert_eq!(run(&mut out, 13_000, 14_000, Mode::Aided).len(), 0);
    assert_eq!(out.sending(), Sending::GnssGood);
}

#[test]
fn by_default_it_is_sent_from_the_alignment_on() {
    for profile in [Profile::Ardupilot, Profile::Px4] {
        let mut out = Outbound::new(OutboundSettings { profile, ..settings(Publish::Auto) });
        assert_eq!(run(&mut out, 0, 1000, Mode::Aided).len(), 0, "the frame is not known");
        assert_eq!(out.sending(), Sending::NoFrame);
        out.origin_shared(None);
        assert!((29..=31).contains(&run(&mut out, 1000, 2000, Mode::Aided).len()));
        assert_eq!(run(&mut out, 2000, 3000, Mode::Aligning).len(), 0);
    }
}

#[test]
fn a_glide_is_in_the_velocity_that_is_sent() {
    let mut out = Outbound::new(settings(Publish::Auto));
    out.origin_shared(None);
    let glide = Ned::new(Vector3::new(0.0, -3.0, 0.5));
    let s = Solution { glide_velocity: glide, ..solution(0, Mode::Rejoining) };
    let mut messages = Vec::new();
    out.step(&s, &mut messages);
    let Some(OutboundMessage::Odometry(o)) = messages.first() else { panic!("nothing sent") };
    let sent = o.attitude.to_ned(o.velocity);
    assert!((sent - s.velocity - glide).raw().norm() < 1e-12, "{sent:?}");
}

#[test]
fn the_lost_say_so_and_are_silent_then() {
    let mut out = Outbound::new(settings(Publish::Holdover));
    out.origin_shared(None);
    assert_eq!(run(&mut out, 0, 500, Mode::Lost).len(), 0, "nobody was listening");
    assert!(run(&mut out, 500, 1500, Mode::Holdover).iter().all(|o| o.quality == 94));
    let farewell = run(&mut out, 1500, 9000, Mode::Lost);
    assert!((29..=32).contains(&farewell.len()), "{}", farewell.len());
    assert!(farewell.iter().all(|o| o.quality == -1));
}

#[test]
fn an_unaligned_frame_is_not_sent() {
    let mut out = Outbound::new(settings(Publish::Always));
    assert_eq!(run(&mut out, 0, 1000, Mode::Holdover).len(), 0);
}

#[test]
fn the_autopilots_frame_is_taken_while_gnss_is_good() {
    let mut out = Outbound::new(settings(Publish::Holdover));
    for ms in (0..30_000).step_by(200) {
        let s = solution(ms, Mode::Aided);
        let reference = Reference::Local {
            time: s.time,
            position: s.position + Ned::new(Vector3::new(0.5, -1.0, 2.0)),
            velocity: s.velocity,
        };
        out.reference(&reference, &s);
    }
    let sent = run(&mut out, 30_000, 30_100, Mode::Holdover);
    let position = sent[0].position.raw();
    assert!((position - Vector3::new(10.5, 19.0, -3.0)).norm() < 0.05, "{position}");
}

#[test]
fn one_wild_position_of_the_autopilot_moves_nothing_and_many_do() {
    let mut out = Outbound::new(settings(Publish::Always));
    let tell = |out: &mut Outbound, from: i64, to: i64, north: f64| {
        for ms in (from..to).step_by(100) {
            let s = solution(ms, Mode::Aided);
            let position = s.position + Ned::new(Vector3::new(north, 0.0, 0.0));
            out.reference(&Reference::Local { time: s.time, position, velocity: s.velocity }, &s);
        }
    };
    tell(&mut out, 0, 5000, 1.0);
    tell(&mut out, 5000, 5100, 900.0);
    assert!((out.alignment().offset().raw().x - 1.0).abs() < 1e-9);
    tell(&mut out, 5100, 15_000, 30.0);
    assert!((out.alignment().offset().raw().x - 30.0).abs() < 0.1);
}

#[test]
fn px4_gets_ned_and_the_diagonal_of_the_covariance() {
    let mut out = Outbound::new(settings(Publish::Always));
    out.set_profile(Profile::Px4);
    out.origin_shared(None);
    let o = &run(&mut out, 0, 100, Mode::Aided)[0];
    assert_eq!(o.frame, PoseFrame::LocalNed);
    for (i, v) in [(0, 4.0), (6, 4.0), (11, 4.0), (15, 1e-4), (18, 1e-4), (20, 4e-4)] {
        assert!((o.pose_covariance[i] - v).abs() < 1e-12);
    }
}

/// The autopilot tells its place, `away` from ours, every 100 ms, while we send.
fn tell(out: &mut Outbound, (from, to): (i64, i64), mode: Mode, away: Vector3<f64>) {
    for ms in (from..to).step_by(20) {
        let s = solution(ms, mode);
        let mut messages = Vec::new();
        out.step(&s, &mut messages);
        if ms % 100 == 0 {
            let position = s.position + Ned::new(away);
            out.reference(&Reference::Local { time: s.time, position, velocity: s.velocity }, &s);
        }
    }
}

fn north(m: f64) -> Vector3<f64> {
    Vector3::new(m, 0.0, 0.0)
}

#[test]
fn the_frames_are_aligned_for_as_long_as_the_autopilot_is_on_gnss_and_stand_in_the_outage() {
    let mut out = Outbound::new(settings(Publish::Auto));
    out.origin_shared(None);
    out.set_standing(StandsOn::Gnss);
    let offset = |out: &Outbound| out.alignment().offset().raw().x;
    tell(&mut out, (0, 10_000), Mode::Aided, north(1.0));
    assert!((offset(&out) - 1.0).abs() < 1e-9);
    tell(&mut out, (10_000, 120_000), Mode::Aided, north(2.5));
    assert!((offset(&out) - 2.5).abs() < 0.01, "{}", offset(&out));
    tell(&mut out, (120_000, 180_000), Mode::Holdover, north(6.0));
    assert!((offset(&out) - 2.5).abs() < 0.01, "frozen at the loss");
    out.set_standing(StandsOn::Ours);
    tell(&mut out, (180_000, 240_000), Mode::Aided, north(6.0));
    assert!((offset(&out) - 2.5).abs() < 0.01, "it lives on ours");
    let apart = out.departure().unwrap();
    assert!((apart.horizontal_m - 3.5).abs() < 0.01, "{apart:?}");
}

#[test]
fn a_frame_is_learned_once_of_an_autopilot_that_does_not_tell_and_never_of_one_that_stands_on_nothing() {
    for (standing, expected) in [(StandsOn::Unknown, 1.0), (StandsOn::Nothing, 0.0)] {
        let mut out = Outbound::new(settings(Publish::Auto));
        out.origin_shared(None);
        out.set_standing(standing);
        tell(&mut out, (0, 10_000), Mode::Aided, north(1.0));
        tell(&mut out, (10_000, 60_000), Mode::Aided, north(3.0));
        let offset = out.alignment().offset().raw().x;
        assert!((offset - expected).abs() < 1e-9, "{standing:?}: {offset}");
    }
}

#[test]
fn an_autopilot_that_follows_us_without_a_word_leads_us_astray_by_metres_only() {
    let mut out = Outbound::new(settings(Publish::Auto));
    out.origin_shared(None);
    out.set_standing(StandsOn::Gnss);
    tell(&mut out, (0, 10_000), Mode::Aided, north(0.0));
    for ms in (10_000..300_000).step_by(100) {
        let s = solution(ms, Mode::Aided);
        out.step(&s, &mut Vec::new());
        // In truth it is on our set, 2 m behind: each time that is taken for its frame, it is 2 m behind that.
        let position = s.position + out.alignment().offset() - Ned::new(north(2.0));
        out.reference(&Reference::Local { time: s.time, position, velocity: s.velocity }, &s);
    }
    let offset = out.alignment().offset().raw().norm();
    assert!((offset - 5.0).abs() < 0.01, "{offset}");
}

fn tell_heading(out: &mut Outbound, to_ms: i64, turn_rad: f64, rate_radps: f64) {
    for ms in (0..to_ms).step_by(100) {
        let angular_rate = Body::new(Vector3::new(0.0, 0.0, rate_radps));
        let s = Solution { angular_rate, ..solution(ms, Mode::Aided) };
        let turned = so3::exp(&Vector3::new(0.0, 0.0, turn_rad)) * s.attitude.matrix();
        let attitude = BodyToNed::from_matrix(&turned);
        out.reference(&Reference::Attitude { time: s.time, attitude }, &s);
    }
}

#[test]
fn who_turns_our_velocity_by_the_autopilots_heading_has_the_velocity_of_our_positions() {
    let mut out = Outbound::new(settings(Publish::Auto));
    out.set_profile(Profile::Px4);
    out.origin_shared(None);
    tell_heading(&mut out, 10_000, 0.05, 0.0);
    let o = &run(&mut out, 20_000, 20_100, Mode::Holdover)[0];
    let s = solution(0, Mode::Holdover);
    let theirs = BodyToNed::from_matrix(&(so3::exp(&Vector3::new(0.0, 0.0, 0.05)) * s.attitude.matrix()));
    assert!((theirs.to_ned(o.velocity) - s.velocity).raw().norm() < 1e-9);
    assert!((theirs.matrix() - o.attitude.matrix()).norm() < 1e-9);
}

#[test]
fn headings_that_contradict_are_not_bent_and_turning_ones_not_compared() {
    for (turn_rad, rate_radps) in [(0.5, 0.0), (0.05, 1.0)] {
        let mut out = Outbound::new(settings(Publish::Auto));
        tell_heading(&mut out, 10_000, turn_rad, rate_radps);
        assert_eq!(out.alignment().heading_offset_rad(), 0.0);
    }
}

#[test]
fn an_origin_that_comes_late_moves_nothing_that_is_sent() {
    let mut out = Outbound::new(settings(Publish::Auto));
    out.set_standing(StandsOn::Gnss);
    // Our first fix was 300 m north of its origin.
    tell(&mut out, (0, 10_000), Mode::Aided, north(300.0));
    let before = run(&mut out, 10_000, 10_010, Mode::Aided)[0].position;
    out.origin_shared(Some(Ned::new(north(-300.0))));
    let mut messages = Vec::new();
    let s = solution(10_100, Mode::Aided);
    out.step(&Solution { position: s.position + Ned::new(north(300.0)), ..s }, &mut messages);
    let Some(OutboundMessage::Odometry(o)) = messages.first() else { panic!("nothing sent") };
    assert!((o.position - before).raw().norm() < 1e-9);
}

#[test]
fn what_only_inertia_carries_is_not_sent_but_over_gaps() {
    let mut out = Outbound::new(settings(Publish::Auto));
    out.origin_shared(None);
    let mut step = |ms: i64, source: VelocitySource, variance: f64| {
        let s = Solution {
            velocity_source: source,
            velocity_covariance: Ned::new(Matrix3::identity() * variance),
            ..solution(ms, Mode::Holdover)
        };
        out.step(&s, &mut Vec::new());
        out.sending()
    };
    // From the loss on: as long as it takes to see that nothing carries.
    assert_eq!(step(0, VelocitySource::Inertial, 0.01), Sending::Outage);
    assert_eq!(step(600, VelocitySource::Inertial, 0.01), Sending::Coasting);
    // Flow comes, and has a gap.
    assert_eq!(step(1000, VelocitySource::Flow, 0.01), Sending::Outage);
    assert_eq!(step(5000, VelocitySource::Inertial, 0.05), Sending::Outage);
    assert_eq!(step(9000, VelocitySource::Inertial, 0.2), Sending::Coasting);
    assert_eq!(step(9500, VelocitySource::Flow, 0.05), Sending::Outage);
}
