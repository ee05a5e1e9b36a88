//! A jump that is found afterwards is undone as if the state had been open from its onset on.

use super::super::joint::{HEIGHT, InertialModel, Joint, OffsetModel};
use super::super::settings::AltimeterSettings;
use super::*;

const R: f64 = 0.5;
const USED: [bool; JUMPS] = [true; JUMPS];

fn joint() -> Joint {
    let inertial = InertialModel { accel_noise: 0.3, ..AltimeterSettings::table_1().inertial };
    // The jump of an offset that forgets would be forgotten with it.
    let offset = |rate| OffsetModel { sigma_m: 1.0, walk: 0.1, rate };
    Joint::new(inertial, [0.01, 0.01, 0.0, 0.0].map(offset))
}

/// What a channel reads: deterministic and without any pattern that a filter could know.
fn reading(k: u32, channel: Channel) -> f64 {
    100.0 + (f64::from(k) * 1.7 + channel.index() as f64).sin()
}

/// The filter with its bank after step `onset`, and a filter that was told to have `open` states from there on.
fn run(jumped: &[(Channel, f64)], weight: impl Fn(u32) -> f64) -> (Joint, GlrBank, Joint) {
    let (mut joint, mut onsets) = (joint(), GlrBank::new(0.1, 1e6));
    let mut told: Option<Joint> = None;
    const PRIOR: f64 = 1e9;
    for k in 0..40 {
        let phi = joint.transition(0.1);
        joint.predict(&phi, 0.01, 0.0005, 0.0);
        onsets.predict(&phi, USED);
        if let Some(t) = &mut told {
            t.predict(&phi, 0.01, 0.0005, 0.0);
        }
        if k == 25 {
            onsets.open(0.1 * f64::from(k), true);
            let mut open = joint.clone();
            for (channel, _) in jumped {
                open.p[(channel.fault(), channel.fault())] += PRIOR;
            }
            told = Some(open);
        }
        for channel in [Channel::Baro, Channel::Gnss, Channel::SecondBaro] {
            let jump = jumped.iter().find(|(c, _)| *c == channel && k >= 25).map_or(0.0, |(_, f)| *f);
            let y = reading(k, channel) + jump;
            // Partial weights are gains like others, but only a full one is optimal: there the separation is exact.
            let innovation = joint.innovation(channel, y, R);
            let gain = joint.update(&innovation, weight(k));
            onsets.measured(channel, &innovation, &gain, USED);
            if let Some(t) = &mut told {
                let innovation = t.innovation(channel, y, R);
                t.update(&innovation, 1.0);
            }
        }
    }
    (joint, onsets, told.expect("the onset came"))
}

fn corrected(mut joint: Joint, onset: &Onset, fit: &Fit) -> Joint {
    let effects = fit.jumps.map(|s| State::from(onset.effect[s]));
    for i in 0..2 {
        joint.x -= effects[i] * fit.size[i];
        for j in 0..2 {
            joint.p.ger(fit.covariance[i][j], &effects[i], &effects[j], 1.0);
        }
    }
    joint
}

#[test]
fn going_back_to_the_onset_is_exact() {
    let even = [1.0; 4];
    let one = [(Channel::Gnss, 20.0)];
    let two = [(Channel::Baro, -7.0), (Channel::Gnss, 20.0)];
    for jumped in [&one[..], &two[..]] {
        let (joint, onsets, told) = run(jumped, |_| 1.0);
        let onset = onsets.iter().last().expect("one onset");
        let s = jumped[0].0.index();
        let fit = match jumped.get(1) {
            None => onset.single(s, &even),
            Some((t, _)) => onset.pair(s, t.index(), &even),
        }
        .expect("a fit");
        let separated = corrected(joint, onset, &fit);
        // The prior that was told is not quite infinite.
        assert!((separated.x - told.x).abs().max() < 1e-5, "{} {}", separated.x, told.x);
        assert!((separated.p - told.p).abs().max() < 1e-5, "{}", separated.p - told.p);
        for (i, (_, f)) in jumped.iter().enumerate() {
            assert!((fit.size[i] - f).abs() < 2.0, "{fit:?}");
        }
    }
}

#[test]
fn without_the_jump_the_filter_is_what_it_would_have_been() {
    // A jump of a size that is known is taken out to the last digit: the filter is linear.
    for (channel, size) in [(Channel::Baro, 5.0), (Channel::Gnss, -30.0), (Channel::SecondBaro, 2.0)] {
        for weight in [1.0, 0.4] {
            let (clean, _, _) = run(&[], |_| weight);
            let (mut joint, onsets, _) = run(&[(channel, size)], |_| weight);
            let onset = onsets.iter().last().expect("one onset");
            joint.x -= State::from(onset.effect[channel.index()]) * size;
            // What is left is the jump itself, in its own state.
            joint.x[channel.fault()] -= size;
            assert!((joint.x - clean.x).abs().max() < 1e-9, "{channel:?}: {}", joint.x - clean.x);
            assert_eq!(joint.p, clean.p);
        }
    }
}

#[test]
fn a_sample_adds_no_more_than_half_its_square_to_a_ratio() {
    let (mut joint, mut onsets) = (joint(), GlrBank::new(0.1, 1e6));
    onsets.open(0.0, true);
    let mut before = 0.0;
    for k in 0..60 {
        let phi = joint.transition(0.1);
        joint.predict(&phi, 0.0, 0.0, 0.0);
        onsets.predict(&phi, USED);
        let channel = [Channel::Baro, Channel::Gnss][k as usize % 2];
        let y = reading(k, channel) + if k > 20 { 15.0 } else { 0.0 };
        let innovation = joint.innovation(channel, y, R);
        let gain = joint.update(&innovation, 0.5);
        onsets.measured(channel, &innovation, &gain, USED);
        let onset = onsets.iter().next().expect("one onset");
        let even = [1.0; 4];
        let fits = [onset.single(0, &even), onset.single(1, &even), onset.pair(0, 1, &even)];
        let ratio = fits.into_iter().flatten().map(|f| f.ratio).fold(0.0, f64::max);
        let most = 0.5 * innovation.value.powi(2) / innovation.variance;
        assert!(ratio <= before + most + 1e-9, "{k}: {before} to {ratio}, {most}");
        before = ratio.max(before);
    }
    assert!(before > 20.0 && joint.x[HEIGHT].is_finite());
}

#[test]
fn two_jumps_that_look_alike_are_not_told_apart() {
    let mut onset = Onset::new(0.0);
    onset.information[0][0] = [4.0, 4.0, 0.0, 0.0, 0.0];
    onset.information[0][1][1] = 4.0;
    onset.evidence[0] = [8.0, 8.0, 0.0, 0.0, 0.0];
    assert!(onset.pair(0, 1, &[1.0; 4]).is_none());
    let one = onset.single(0, &[1.0; 4]).expect("a fit");
    assert_eq!((one.size[0], one.ratio, one.covariance[0][0]), (2.0, 8.0, 0.25));
    assert!(onset.single(2, &[1.0; 4]).is_none());
}

#[test]
fn thinning_keeps_the_kept_onset_and_the_oldest() {
    let mut onsets = GlrBank::new(1.0, 1e6);
    onsets.keep(7.0);
    for k in 0..500 {
        onsets.open(f64::from(k), false);
        let times: Vec<f64> = onsets.iter().map(|o| o.time_s).collect();
        assert!(times.len() <= ONSETS && times.is_sorted(), "{times:?}");
        assert_eq!(times.first(), Some(&0.0));
        assert_eq!(times.last(), Some(&f64::from(k)));
        assert!(k < 7 || times.contains(&7.0), "{k}: {times:?}");
        let newest: Vec<f64> =
            (0..DENSE as i32 - 1).map(|i| f64::from(k - i)).filter(|t| *t >= 0.0).collect();
        assert!(newest.iter().all(|t| times.contains(t)), "{k}: {times:?}");
    }
    // Neither too near nor too old.
    onsets.open(499.5, false);
    assert_eq!(onsets.iter().last().map(|o| o.time_s), Some(499.0));
    onsets.open(499.5, true);
    assert_eq!(onsets.iter().last().map(|o| o.time_s), Some(499.5));
    let mut short = GlrBank::new(1.0, 5.0);
    (0..20).for_each(|k| short.open(f64::from(k), false));
    assert!(short.iter().all(|o| o.time_s >= 14.0));
}

#[test]
fn noise_is_worth_what_its_likelihood_says() {
    assert_eq!(Onset::noise(0.0, 0), (0.0, 1.0));
    assert_eq!(Onset::noise(7.0, 10), (0.0, 1.0));
    let (ratio, factor) = Onset::noise(90.0, 10);
    assert!((factor - 9.0).abs() < 1e-12);
    // ln Π N(ν; 0, 9)/N(ν; 0, 1)
    assert!((ratio - (0.5 * 90.0 * (1.0 - 1.0 / 9.0) - 5.0 * 9.0_f64.ln())).abs() < 1e-12);
}
