//! The joint filter against the same equations with whole matrices.

use nalgebra::{RowSVector, SMatrix};

use super::*;

fn models() -> (InertialModel, [OffsetModel; 4]) {
    let inertial = InertialModel {
        accel_noise: 0.3,
        accel_bias_sigma: 0.1,
        accel_bias_walk: 0.01,
        accel_bias_rate: 0.02,
        start_sigma: [3.0, 0.5],
        gravity_gradient: 3e-3,
    };
    let offset = |sigma_m, walk, rate| OffsetModel { sigma_m, walk, rate };
    (
        inertial,
        [offset(2.0, 0.1, 0.05), offset(1.0, 0.2, 0.01), offset(3.0, 0.05, 0.0), offset(5.0, 0.5, 0.0)],
    )
}

fn joint() -> Joint {
    let (inertial, offsets) = models();
    Joint::new(inertial, offsets)
}

fn phi(dt: f64) -> Covariance {
    let (inertial, offsets) = models();
    let mut phi = Covariance::identity();
    phi[(HEIGHT, CLIMB)] = dt;
    phi[(HEIGHT, ACCEL_BIAS)] = -0.5 * dt * dt;
    phi[(CLIMB, HEIGHT)] = inertial.gravity_gradient * dt;
    phi[(CLIMB, ACCEL_BIAS)] = -dt;
    phi[(ACCEL_BIAS, ACCEL_BIAS)] = 1.0 - inertial.accel_bias_rate * dt;
    for c in 0..4 {
        phi[(OFFSETS + c, OFFSETS + c)] = 1.0 - offsets[c].rate * dt;
    }
    phi
}

/// H of a channel.
fn row(channel: Channel) -> RowSVector<f64, STATES> {
    let mut h = RowSVector::zeros();
    h[HEIGHT] = 1.0;
    h[channel.offset()] = 1.0;
    h[channel.fault()] = 1.0;
    h
}

/// After some time with everything in use, a bias of GNSS among it.
fn flown() -> Joint {
    let mut joint = joint();
    joint.decorrelate(Channel::Gnss.fault(), 400.0);
    for k in 0..40 {
        let transition = joint.transition(0.1);
        joint.predict(&transition, 0.02, 0.001, 0.01);
        for c in Channel::ALL {
            let innovation = joint.innovation(c, 10.0 + f64::from(k % 3), 0.5);
            joint.update(&innovation, 0.9);
        }
    }
    joint
}

fn near(a: &Covariance, b: &Covariance) {
    assert!((a - b).abs().max() < 1e-9 * a.abs().max(), "{}", a - b);
}

#[test]
fn the_prediction_is_that_of_whole_matrices() {
    let mut joint = flown();
    let (x, p, dt, noise) = (joint.x, joint.p, 0.3, 0.2);
    let (inertial, offsets) = models();
    joint.predict(&joint.transition(dt), 0.4, 0.05, noise);
    let mut want = phi(dt) * x;
    want[HEIGHT] += 0.05;
    want[CLIMB] += 0.4;
    assert!((joint.x - want).abs().max() < 1e-12);
    let mut q = Covariance::zeros();
    let density = inertial.accel_noise.powi(2) + noise;
    q[(HEIGHT, HEIGHT)] = density * dt.powi(3) / 3.0;
    q[(HEIGHT, CLIMB)] = density * dt * dt / 2.0;
    q[(CLIMB, HEIGHT)] = q[(HEIGHT, CLIMB)];
    q[(CLIMB, CLIMB)] = density * dt;
    q[(ACCEL_BIAS, ACCEL_BIAS)] = inertial.accel_bias_walk.powi(2) * dt;
    for c in 0..4 {
        q[(OFFSETS + c, OFFSETS + c)] = offsets[c].walk.powi(2) * dt;
    }
    near(&joint.p, &(phi(dt) * p * phi(dt).transpose() + q));
}

#[test]
fn the_update_is_joseph_with_the_weighted_gain() {
    for channel in Channel::ALL {
        for prob in [1.0, 0.6, 0.05] {
            let mut joint = flown();
            let (x, p, r, y) = (joint.x, joint.p, 0.7, 12.0);
            let innovation = joint.innovation(channel, y, r);
            let h = row(channel);
            let s = (h * p * h.transpose())[0] + r;
            assert!((innovation.variance / s - 1.0).abs() < 1e-12);
            assert!((innovation.value - (y - (h * x)[0])).abs() < 1e-12);
            let k = p * h.transpose() / s;
            let gain = joint.update(&innovation, prob);
            assert!((gain - k * prob).abs().max() < 1e-12);
            assert!((joint.x - (x + k * (prob * innovation.value))).abs().max() < 1e-12);
            let rest = Covariance::identity() - k * prob * h;
            near(&joint.p, &(rest * p * rest.transpose() + k * k.transpose() * (prob * prob * r)));
        }
    }
}

#[test]
fn a_pinned_state_is_measured_as_zero_without_noise() {
    let mut joint = flown();
    let state = Channel::Gnss.fault();
    let (x, p) = (joint.x, joint.p);
    let mut h = RowSVector::<f64, STATES>::zeros();
    h[state] = 1.0;
    let k = p * h.transpose() / (h * p * h.transpose())[0];
    let rest: SMatrix<f64, STATES, STATES> = Covariance::identity() - k * h;
    joint.pin(state);
    assert!((joint.x - (x - k * x[state])).abs().max() < 1e-9);
    near(&joint.p, &(rest * p * rest.transpose()));
    assert_eq!((joint.x[state], joint.sigma(state)), (0.0, 0.0));
    // Once more changes nothing.
    let before = joint.clone();
    joint.pin(state);
    assert_eq!((joint.x, joint.p), (before.x, before.p));
}

#[test]
fn the_covariance_stays_one_for_hours() {
    let mut joint = joint();
    for k in 0..200_000 {
        let transition = joint.transition(if k % 1000 == 0 { 0.5 } else { 0.02 });
        joint.predict(&transition, 0.0, 0.0, 0.0);
        let channel = Channel::ALL[k % 4];
        let innovation = joint.innovation(channel, 10.0, 0.25);
        joint.update(&innovation, if k % 7 == 0 { 0.3 } else { 1.0 });
    }
    let p = joint.p;
    assert!((p - p.transpose()).abs().max() < 1e-9 * p.abs().max());
    let least = (0.5 * (p + p.transpose())).symmetric_eigenvalues().min();
    assert!(least > -1e-9, "{least}");
}

/// Ten minutes that nobody saw: a bias has no acceleration to be in, a climb ends, and offsets go on as they do from step to step.
#[test]
fn over_a_time_that_was_not_seen_nothing_runs_away() {
    let mut joint = joint();
    joint.x[CLIMB] = 2.0;
    joint.x[ACCEL_BIAS] = 0.08;
    for channel in Channel::ALL {
        joint.x[channel.offset()] = 4.0;
    }
    let mut stepped = joint.clone();
    let climb = UnseenClimb { kept: 0.1, way_s: 18.0, height_m: 0.0, climb_mps: 0.0, both: 0.0 };
    joint.unseen(617.0, &climb);
    assert!((joint.x[HEIGHT] - 36.0).abs() < 1e-9 && (joint.x[CLIMB] - 0.2).abs() < 1e-9, "{}", joint.x);
    // What is known of the climb rate is 0.5 m/s, and of the height 3 m.
    assert!((joint.p[(HEIGHT, HEIGHT)] - (9.0 + 18.0 * 18.0 * 0.25)).abs() < 1e-6);
    assert!((joint.p[(CLIMB, CLIMB)] - 0.0025).abs() < 1e-9);
    assert!((joint.p[(HEIGHT, CLIMB)] - 0.45).abs() < 1e-9);
    let small = stepped.transition(0.01);
    (0..61_700).for_each(|_| stepped.predict(&small, 0.0, 0.0, 0.0));
    assert!(stepped.x[HEIGHT].abs() > 1e3, "that is what ran away: {}", stepped.x);
    for state in (ACCEL_BIAS..ACCEL_BIAS + 5).chain([FAULTS]) {
        let (x, p) = (joint.x[state] - stepped.x[state], joint.p[(state, state)] / stepped.p[(state, state)]);
        assert!(x.abs() < 1e-3 && (p.is_nan() || (p - 1.0).abs() < 2e-3), "{state}: {x} {p}");
    }
    assert!((joint.p - joint.p.transpose()).amax() == 0.0);
}
