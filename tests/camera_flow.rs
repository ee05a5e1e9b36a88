//! The stacked flow solves: against vectors that were computed independently, against the numbers of the specification, and against
//! whatever a camera may send.

#![allow(clippy::unwrap_used, clippy::panic)] // a test may fail

use holdover::camera::*;
use nalgebra::{Vector2, Vector3};
use serde_json::Value;

fn numbers(v: &Value) -> Vec<f64> {
    v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

fn vector(v: &Value) -> Vector3<f64> {
    Vector3::from_column_slice(&numbers(v))
}

fn cases() -> Vec<Value> {
    let path = format!("{}/tests/golden/observers/flow.json", env!("CARGO_MANIFEST_DIR"));
    let file: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    file["cases"].as_array().unwrap().clone()
}

fn view_of(case: &Value) -> View {
    let n = |key: &str| case[key].as_f64().unwrap();
    View::from_roll_pitch(n("l"), n("roll"), n("pitch"), n("height"))
}

fn features_of(case: &Value) -> Vec<Feature> {
    let [r, s, rdot, sdot] = ["r", "s", "rdot", "sdot"].map(|key| numbers(&case[key]));
    (0..r.len())
        .map(|i| Feature { image: Vector2::new(r[i], s[i]), flow: Vector2::new(rdot[i], sdot[i]) })
        .collect()
}

/// Nothing is refused, a unit of noise.
fn open() -> (SolveNoise, SolveLimits) {
    let limits = SolveLimits {
        max_tilt_rad: 1.5,
        max_height_m: 1e4,
        max_condition: 1e6,
        max_dilution: 1e6,
        max_residual: f64::INFINITY,
        min_consensus: 0.0,
        ..SolveLimits::default()
    };
    (SolveNoise { flow: 1.0, height_m: 0.0, rate_radps: 0.0 }, limits)
}

#[test]
fn points_and_matrices_match_the_golden_ones() {
    for case in cases() {
        let view = view_of(&case);
        for (i, feature) in features_of(&case).iter().enumerate() {
            let point = ground_point(&view, &feature.image).unwrap();
            assert!((point - vector(&case["points"][i])).norm() < 1e-9);
            let m = interaction_matrix(view.focal_length, &point);
            for row in 0..2 {
                for (column, want) in numbers(&case["M"][2 * i + row]).iter().enumerate() {
                    let got = m[(row, column)];
                    assert!((got - want).abs() < 1e-9 * want.abs().max(1.0), "{got} {want}");
                }
            }
        }
    }
}

#[test]
fn every_solve_matches_the_golden_one() {
    let (noise, limits) = open();
    for case in cases() {
        let (view, features, omega) = (view_of(&case), features_of(&case), vector(&case["omega"]));
        let six = solve_six(&view, &features, &noise, &limits).unwrap();
        let want = &case["solve6"];
        assert!((six.velocity_camera - vector(&want["v"])).norm() < 1e-7);
        assert!((six.rate_camera - vector(&want["w"])).norm() < 1e-7);
        assert!((six.condition - want["cond"].as_f64().unwrap()).abs() < 1e-6);
        let with = |method| solve_velocity(&view, &features, &omega, None, method, &noise, &limits).unwrap();
        let three = with(Method::LeastSquares);
        assert!((three.velocity_camera - vector(&case["solve3"]["v"])).norm() < 1e-9);
        assert!((three.condition - case["solve3"]["cond"].as_f64().unwrap()).abs() < 1e-9);
        let huber = with(Method::Huber { threshold: 6.0, iterations: 10 });
        assert!((huber.velocity_camera - vector(&case["huber6_10it"]["v"])).norm() < 1e-9);
        let ransac = with(Method::Ransac { threshold: 20.0, samples: 64, huber: 0.0 });
        let want = &case["ransac_thr20_n64_seed1"];
        // Another sequence of samples finds the same features.
        assert_eq!(ransac.weights, numbers(&want["inliers"]));
        assert!((ransac.velocity_camera - vector(&want["v"])).norm() < 1e-9);
        assert!((ransac.condition - want["cond"].as_f64().unwrap()).abs() < 1e-9);
    }
}
