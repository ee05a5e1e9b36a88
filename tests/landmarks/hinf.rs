//! The general filter for implicit outputs: what it promises on systems small enough to know the answer, and on the paper's example.

use crate::paper_vision::{PaperRun, least_gamma, run};
use holdover::landmark::Discount;
use holdover::landmark::{
    AffineDynamics, Definiteness, HinfFilter, HinfSettings, ImplicitOutput, ImplicitSystem, UpdateRefusal,
};
use nalgebra::{DMatrix, DVector};

fn m(rows: usize, columns: usize, by_row: &[f64]) -> DMatrix<f64> {
    DMatrix::from_row_slice(rows, columns, by_row)
}

fn v(values: &[f64]) -> DVector<f64> {
    DVector::from_column_slice(values)
}

/// A point on a plane with a velocity, pushed by a held acceleration; seen by a camera in the origin as a direction, or in one coordinate.
#[derive(Clone)]
struct Ball {
    /// GGᵀ on the velocity, and Qe.
    disturbance: f64,
    weight: f64,
}

enum BallSample {
    Direction([f64; 2]),
    First(f64),
}

impl ImplicitSystem for Ball {
    type Input = [f64; 2];
    type Sample = BallSample;

    fn dimension(&self) -> usize {
        4
    }

    fn dynamics(&self, [ax, ay]: &[f64; 2]) -> AffineDynamics {
        let mut matrix = DMatrix::zeros(4, 4);
        (matrix[(0, 2)], matrix[(1, 3)]) = (1.0, 1.0);
        let g = self.disturbance;
        AffineDynamics {
            matrix,
            constant: v(&[0.0, 0.0, *ax, *ay]),
            disturbance: DMatrix::from_diagonal(&v(&[0.0, 0.0, g, g])),
        }
    }

    fn outputs(&self, sample: &BallSample, _: &[f64; 2], outputs: &mut Vec<ImplicitOutput>) {
        outputs.push(match sample {
            // α y = C x
            BallSample::Direction([x, y]) => ImplicitOutput {
                gradient: m(2, 4, &[-1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0]),
                constant: DVector::zeros(2),
                free: Some(m(2, 1, &[*x, *y])),
                variance: 1.0,
            },
            BallSample::First(x) => ImplicitOutput {
                gradient: m(1, 4, &[-1.0, 0.0, 0.0, 0.0]),
                constant: v(&[*x]),
                free: None,
                variance: 0.25,
            },
        });
    }

    fn error_weight(&self) -> DVector<f64> {
        DVector::from_element(4, self.weight)
    }
}

/// No disturbance and no weight: recursive least squares.
const LEAST_SQUARES: Ball = Ball { disturbance: 0.0, weight: 0.0 };

fn filter(ball: Ball, gamma: f64) -> HinfFilter<Ball> {
    let settings = HinfSettings { discount: Discount { gamma, lambda: 0.0 }, history_s: 1.0 };
    let start = v(&[1.0, 1.0, 0.0, 0.0]);
    HinfFilter::new(ball, settings, start, &DMatrix::identity(4, 4), [0.3, -0.2]).unwrap()
}

#[test]
fn a_late_sample_is_worth_what_a_timely_one_is() {
    let (mut timely, mut late) = (filter(LEAST_SQUARES, 3.0), filter(LEAST_SQUARES, 3.0));
    for k in 0..10 {
        let input = [0.1 * f64::from(k), -0.3];
        let sample = || [BallSample::Direction([1.0, 0.2 * f64::from(k)]), BallSample::First(f64::from(k))];
        timely.set_input(input);
        late.set_input(input);
        timely.update(0.0, &sample()).unwrap();
        timely.propagate(0.1);
        timely.propagate(0.15);
        late.propagate(0.1);
        late.propagate(0.15);
        late.update(0.25, &sample()).unwrap();
    }
    assert!((timely.estimate() - late.estimate()).norm() < 1e-12);
    assert!((timely.information() - late.information()).norm() < 1e-9);
}

/// Everything at once by normal equations: the minimum of (10) without disturbance.
#[test]
fn the_estimate_is_the_minimum_of_the_cost() {
    let mut f = filter(LEAST_SQUARES, 3.0);
    let (mut normal, mut right) = (DMatrix::identity(4, 4), v(&[1.0, 1.0, 0.0, 0.0]));
    for k in 0..12 {
        let t = 0.2 * f64::from(k);
        let y = [1.0, (0.3 * t).tan() + 0.4];
        f.update(0.0, &[BallSample::Direction(y), BallSample::First(t)]).unwrap();
        f.propagate(0.2);
        // x(t) = Φ x(0) + φ
        let phi = m(2, 4, &[1.0, 0.0, t, 0.0, 0.0, 1.0, 0.0, t]);
        let push = v(&[0.15 * t * t, -0.1 * t * t]);
        let across = v(&[-y[1], y[0]]).normalize();
        let row = across.tr_mul(&phi);
        normal += row.transpose() * &row;
        right -= row.transpose() * across.dot(&push);
        let row = phi.row(0).into_owned();
        normal += 4.0 * row.transpose() * &row;
        right += 4.0 * row.transpose() * (t - push[0]);
    }
    let x0 = normal.lu().solve(&right).unwrap();
    let t = 2.4;
    let end = m(4, 4, &[1.0, 0.0, t, 0.0, 0.0, 1.0, 0.0, t, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]) * x0
        + v(&[0.15 * t * t, -0.1 * t * t, 0.3 * t, -0.2 * t]);
    assert!((f.estimate() - end).norm() < 1e-10);
}

#[test]
fn a_gamma_that_is_too_small_is_told_and_there_is_a_way_out() {
    let mut f = filter(Ball { disturbance: 0.1, weight: 1.0 }, 0.7);
    let mut steps = 0;
    while f.propagate(0.1) == Definiteness::Definite {
        steps += 1;
        assert!(steps < 100);
    }
    assert_eq!(f.definiteness(), Definiteness::Indefinite);
    assert_eq!(f.update(0.0, &[BallSample::First(1.0)]), Err(UpdateRefusal::Indefinite));
    assert!(f.information().clone().cholesky().is_some(), "the last definite one is kept");
    assert!(f.estimate().iter().all(|v| v.is_finite()));
    let x = f.estimate().clone();
    assert!(!f.restart(x.clone(), &-DMatrix::identity(4, 4)));
    assert!(f.restart(x, &(DMatrix::identity(4, 4) * 100.0)));
    assert_eq!(f.update(0.3, &[BallSample::First(1.0)]), Ok(()), "its inputs are still known");
    assert_eq!(f.propagate(0.1), Definiteness::Definite);
}

#[test]
fn what_cannot_be_used_changes_nothing() {
    let mut f = filter(LEAST_SQUARES, 3.0);
    (0..30).for_each(|_| assert_eq!(f.propagate(0.1), Definiteness::Definite));
    let before = (f.estimate().clone(), f.information().clone());
    let nan = f64::NAN;
    for (age, sample, why) in [
        (1.2, BallSample::First(1.0), UpdateRefusal::TooOld),
        (-0.1, BallSample::First(1.0), UpdateRefusal::FromTheFuture),
        (nan, BallSample::First(1.0), UpdateRefusal::Unusable),
        (0.1, BallSample::First(nan), UpdateRefusal::Unusable),
        (0.1, BallSample::Direction([f64::INFINITY, 0.0]), UpdateRefusal::Unusable),
        (0.1, BallSample::First(f64::MAX), UpdateRefusal::Unusable),
    ] {
        assert_eq!(f.update(age, &[sample]), Err(why), "{age}");
    }
    for dt in [nan, -1.0, 0.0, f64::INFINITY] {
        f.propagate(dt);
    }
    assert_eq!((f.estimate(), f.information()), (&before.0, &before.1));
    let bad = HinfSettings { discount: Discount { gamma: nan, lambda: 0.0 }, history_s: 1.0 };
    let eye = DMatrix::identity(4, 4);
    assert!(HinfFilter::new(LEAST_SQUARES, bad, DVector::zeros(4), &eye, [0.0; 2]).is_none());
    // No direction at all says nothing, and is no harm: Π = I.
    assert_eq!(f.update(0.0, &[BallSample::Direction([0.0, 0.0])]), Ok(()));
}

fn paper(gamma: f64, lambda: f64, noise: f64, camera_only: bool) -> PaperRun {
    PaperRun { discount: Discount { gamma, lambda }, noise, camera_only, duration_s: 40.0, seed: 1 }
}

#[test]
fn the_papers_three_cases_converge() {
    let late = |what: &PaperRun| {
        let (points, state) = run(what);
        assert_eq!(state, Definiteness::Definite);
        points.iter().filter(|(t, _)| *t > 39.0).map(|(_, [p, _])| *p).fold(0.0, f64::max)
    };
    let exact = late(&paper(100.0, 0.3, 0.0, false));
    assert!(exact < 1e-4, "{exact}");
    for camera_only in [false, true] {
        let noisy = late(&paper(100.0, 0.3, 0.05, camera_only));
        assert!(noisy < 1.0, "{camera_only}: {noisy}");
    }
}

/// Computed independently of this library.
#[test]
fn the_least_gamma_is_the_known_one() {
    for (lambda, imu, alone) in [(0.0, 3.9, 2.3), (0.1, 7.2, 3.2), (0.5, 29.0, 10.8), (1.0, 66.0, 24.0)] {
        for (camera_only, want) in [(false, imu), (true, alone)] {
            let got = least_gamma(lambda, camera_only);
            assert!((got / want - 1.0).abs() < 0.05, "lambda {lambda}, {camera_only}: {got}, not {want}");
        }
    }
    let (_, state) = run(&paper(3.0, 0.5, 0.0, false));
    assert_eq!(state, Definiteness::Indefinite);
}
