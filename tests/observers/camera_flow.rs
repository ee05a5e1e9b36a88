//! The stacked flow solves: against vectors that were computed independently, against the numbers of the specification, and against
//! whatever a camera may send.

#[path = "../../examples/flow_solve.rs"]
#[allow(dead_code, reason = "its command line is not used here")]
mod flow_solve;

use flow_solve::{SCENE, Scene, Score, score_middle, score_six, score_three};
use holdover::camera::features::rotational_flow;
use holdover::camera::*;
use holdover::geo::{Body, CameraMount, so3};
use holdover::landmark::LandmarkCamera;
use nalgebra::{Vector2, Vector3, Vector6};
use proptest::prelude::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
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

/// Root mean squares below `most`, and above three fifths of it: the specification's number, not just something small.
#[track_caller]
fn about(score: &Score, most: [f64; 3]) {
    for (got, most) in score.rms().iter().zip(most) {
        assert!(*got <= most && *got >= 0.6 * most, "{:?}: {most}", score.rms());
    }
}

const TRIALS: u32 = 300;

#[test]
fn the_gyros_take_nine_tenths_of_the_error_away() {
    let six = score_six(&SCENE, TRIALS, 2);
    about(&six, [1.05, 0.9, 0.25]);
    assert!((18.0..40.0).contains(&six.condition()), "{}", six.condition());
    let narrow = score_six(&Scene { field_deg: 25.0, ..SCENE }, TRIALS, 2);
    assert!((90.0..180.0).contains(&narrow.condition()), "{}", narrow.condition());
    let three = score_three(&SCENE, Method::LeastSquares, TRIALS, 2);
    about(&three, [0.1, 0.1, 0.25]);
    assert!((1.1..1.3).contains(&three.condition()), "{}", three.condition());
}

#[test]
fn outliers_spoil_least_squares_and_not_the_robust_solves() {
    let wrong = Scene { wrong: 0.3, ..SCENE };
    about(&score_three(&wrong, Method::LeastSquares, TRIALS, 3), [1.8, 1.8, 4.6]);
    about(&score_three(&wrong, Method::HUBER, TRIALS, 3), [0.17, 0.17, 0.44]);
    about(&score_three(&wrong, Method::RANSAC, TRIALS, 3), [0.12, 0.12, 0.3]);
}

#[test]
fn the_matrix_belongs_in_the_middle_of_the_interval() {
    let [middle, first] = score_middle(TRIALS, 4);
    assert!(middle < 0.03 && (0.25..0.45).contains(&first), "{middle} {first}");
}

/// Normalised squared errors of a solve whose height and gyro bias are wrong, too, by what is stated.
fn nees(features: usize, wrong: f64, method: Method) -> f64 {
    let scene = Scene { features, wrong, ..SCENE };
    let (sigma_h, sigma_w) = (2.5, 0.1f64.to_radians());
    let noise = SolveNoise { height_m: sigma_h, rate_radps: sigma_w, ..scene.noise() };
    let limits = SolveLimits { max_dilution: 1e3, max_residual: f64::INFINITY, ..SolveLimits::default() };
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut score = Score::default();
    for _ in 0..400 {
        let mut seen = scene.look(&mut rng);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        seen.view.height_m += sigma_h * normal();
        let rate = scene.rate + Vector3::from_fn(|_, _| normal()) * sigma_w;
        let features: Vec<Feature> =
            seen.tracks.iter().map(|(a, b)| Feature::between(a, b, scene.dt_s)).collect();
        if let Ok(out) = solve_velocity(&seen.view, &features, &rate, None, method, &noise, &limits) {
            score.add(&(out.velocity_camera - scene.velocity), &out.covariance, out.condition);
        }
    }
    score.nees()
}

#[test]
fn the_claimed_covariance_is_honest() {
    for method in [Method::LeastSquares, Method::HUBER, Method::RANSAC] {
        let clean = nees(40, 0.0, method);
        assert!((0.8..1.2).contains(&clean), "{method:?}: {clean}");
        let few = nees(5, 0.0, method);
        assert!((0.4..1.3).contains(&few), "{method:?}: {few}");
        let outliers = nees(40, 0.3, method);
        assert!((0.5..1.3).contains(&outliers), "{method:?}: {outliers}");
    }
}

#[test]
fn the_covariance_grows_with_residuals_and_with_every_shared_error() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let seen = SCENE.look(&mut rng);
    let features: Vec<Feature> = seen.tracks.iter().map(|(a, b)| Feature::between(a, b, 0.1)).collect();
    let limits = SolveLimits { max_residual: f64::INFINITY, ..SolveLimits::default() };
    let with = |features: &[Feature], noise: SolveNoise| {
        let method = Method::LeastSquares;
        solve_velocity(&seen.view, features, &SCENE.rate, None, method, &noise, &limits).unwrap().covariance
    };
    let base = with(&features, SCENE.noise());
    assert!(with(&features[..6], SCENE.noise()).trace() > 4.0 * base.trace());
    // One per cent of the height is one per cent of the velocity.
    let height = with(&features, SolveNoise { height_m: 1.25, ..SCENE.noise() }) - base;
    assert!((height[(0, 0)].sqrt() - 0.25).abs() < 0.01, "{height}");
    // 0.1 °/s is 0.22 m/s at 125 m, and a little more for features away from the axis.
    let rate = with(&features, SolveNoise { rate_radps: 0.1f64.to_radians(), ..SCENE.noise() }) - base;
    for axis in 0..2 {
        assert!((0.2..0.3).contains(&rate[(axis, axis)].sqrt()), "{rate}");
    }
    let noisy: Vec<Feature> = features
        .iter()
        .enumerate()
        .map(|(i, f)| Feature { flow: f.flow + Vector2::repeat(if i % 2 == 0 { 20.0 } else { -20.0 }), ..*f })
        .collect();
    assert!(with(&noisy, SCENE.noise()).trace() > 20.0 * base.trace());
}

#[test]
fn mounting_and_lever_arm_are_undone() {
    let mount =
        CameraMount::turned(so3::Euler::new(0.1, -0.15, 1.2), Body::new(Vector3::new(0.3, -0.2, 0.1)));
    let r = so3::Euler::new(0.1, -0.05, 2.0).to_rotation();
    let (v, w) = (Vector3::new(12.0, -3.0, 0.8), Vector3::new(0.2, -0.3, 0.4));
    let to_camera = |body| mount.camera_to_body.to_camera(Body::new(body)).raw();
    let (camera_v, camera_w) = (to_camera(v + w.cross(&mount.lever_arm.raw())), to_camera(w));
    let view = View::mounted(500.0, &mount, &r, 40.0);
    let features: Vec<Feature> = (0..9)
        .map(|i| {
            let image = Vector2::new(f64::from(i % 3 - 1), f64::from(i / 3 - 1)) * 150.0;
            let m = interaction_matrix(500.0, &ground_point(&view, &image).unwrap());
            let motion = Vector6::from_iterator(camera_v.iter().chain(camera_w.iter()).copied());
            Feature { image, flow: -(m * motion) }
        })
        .collect();
    let (noise, limits) = open();
    for method in [Method::LeastSquares, Method::HUBER, Method::RANSAC] {
        let out = solve_velocity(&view, &features, &camera_w, None, method, &noise, &limits).unwrap();
        let (body, covariance) = out.at_body_origin(&mount, &w);
        assert!((body - v).norm() < 1e-9, "{body}");
        assert!((covariance.trace() - out.covariance.trace()).abs() < 1e-9);
        assert_eq!((out.inliers, out.used), (9, 9));
    }
    let six = solve_six(&view, &features, &noise, &limits).unwrap();
    assert!((six.velocity_camera - camera_v).norm() < 1e-7 && (six.rate_camera - camera_w).norm() < 1e-9);
}

#[test]
fn refusals_carry_their_reason() {
    let (view, noise) = (View::from_roll_pitch(1.0, 0.0, 0.0, 10.0), SolveNoise { flow: 0.01, ..open().0 });
    let limits = SolveLimits::default();
    let at = |r: f64, s: f64, x: f64| Feature { image: Vector2::new(r, s), flow: Vector2::new(x, 0.0) };
    let three = |view: &View, f: &[Feature], method| {
        solve_velocity(view, f, &Vector3::zeros(), None, method, &noise, &limits).map(|s| s.used)
    };
    let least = Method::LeastSquares;
    let pair = [at(-0.2, 0.0, 0.0), at(0.2, 0.0, 0.0)];
    assert_eq!(three(&view, &pair, least), Ok(2));
    assert_eq!(three(&view, &[], least), Err(FlowRefusal::TooFew(0)));
    assert_eq!(three(&view, &pair[..1], least), Err(FlowRefusal::Rank(2)), "one feature sees two components");
    let near = [at(-0.001, 0.0, 0.0), at(0.001, 0.0, 0.0)];
    assert!(matches!(three(&view, &near, least), Err(FlowRefusal::Condition(c)) if c > 500.0));
    assert!(matches!(
        three(&view, &[at(-0.2, 0.0, 1.0), at(0.2, 0.0, 0.0), at(0.0, 0.2, -1.0)], least),
        Err(FlowRefusal::Residual(_))
    ));
    let scattered: Vec<Feature> =
        (0..12).map(|i| at(0.2 * f64::from(i % 4), 0.1 * f64::from(i / 4), f64::from(i * i))).collect();
    for method in [Method::HUBER, Method::RANSAC] {
        assert!(
            matches!(three(&view, &scattered, method), Err(FlowRefusal::Consensus { of: 12, .. })),
            "{method:?}"
        );
    }
    let tilted = View::from_roll_pitch(1.0, 1.0, 0.0, 10.0);
    assert!(matches!(three(&tilted, &pair, least), Err(FlowRefusal::Tilt(_))));
    for height_m in [0.0, -3.0, 1e6] {
        assert_eq!(three(&View { height_m, ..view }, &pair, least), Err(FlowRefusal::Height(height_m)));
    }
    assert!(matches!(three(&View { height_m: f64::NAN, ..view }, &pair, least), Err(FlowRefusal::Height(_))));
    let focal_length = 0.0;
    let lensless = View { focal_length, ..view };
    assert_eq!(three(&lensless, &pair, least), Err(FlowRefusal::FocalLength(0.0)));
    assert_eq!(three(&view, &[at(f64::NAN, 0.0, 0.0)], least), Err(FlowRefusal::NotFinite));
    let six = |f: &[Feature]| solve_six(&view, f, &noise, &limits).map(|s| s.used);
    assert_eq!(six(&pair), Err(FlowRefusal::TooFew(2)));
    let line: Vec<Feature> = (0..5).map(|i| at(0.1 * f64::from(i), 0.0, 0.0)).collect();
    assert!(matches!(six(&line), Err(FlowRefusal::Rank(_) | FlowRefusal::Condition(_))));
}

#[test]
fn a_known_climb_rate_is_the_third_component_of_one_patch() {
    let view = View::from_roll_pitch(1.0, 0.2, -0.1, 30.0);
    let v = Vector3::new(4.0, -2.0, 1.0);
    let image = Vector2::new(0.3, -0.1);
    let m = interaction_matrix(1.0, &ground_point(&view, &image).unwrap());
    let feature = Feature { image, flow: -(m.fixed_columns::<3>(0) * v) };
    let down = view.down_camera;
    let known = KnownComponent { direction_camera: down, speed_mps: down.dot(&v), sigma_mps: 0.2 };
    let noise = SolveNoise { flow: 0.04, height_m: 0.1, rate_radps: 0.0 };
    let solve = |known| {
        let limits = SolveLimits::default();
        solve_velocity(&view, &[feature], &Vector3::zeros(), known, Method::HUBER, &noise, &limits)
    };
    assert_eq!(solve(None), Err(FlowRefusal::Rank(2)));
    let out = solve(Some(&known)).unwrap();
    assert!((out.velocity_camera - v).norm() < 1e-9);
    let climb = down.dot(&(out.covariance * down)).sqrt();
    assert!((0.2..0.4).contains(&climb), "{climb}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn arbitrary_features_give_finite_numbers_or_a_reason(
        x in proptest::collection::vec(proptest::array::uniform4(proptest::num::f64::ANY), 0..12),
        view in proptest::array::uniform3(proptest::num::f64::ANY), w in proptest::array::uniform3(proptest::num::f64::ANY),
        known in proptest::array::uniform3(proptest::num::f64::ANY), flow in proptest::num::f64::ANY, plausible in any::<bool>(),
        method in 0..3usize) {
        let tame = |v: f64, most: f64| if plausible { (v % most).clamp(-most, most) } else { v };
        let view = View::from_roll_pitch(if plausible { 1.0 } else { view[0] }, tame(view[1], 0.7), tame(view[2], 0.7), 10.0);
        let features: Vec<Feature> = x.iter().map(|f| Feature {
            image: Vector2::new(tame(f[0], 0.8), tame(f[1], 0.8)), flow: Vector2::new(tame(f[2], 3.0), tame(f[3], 3.0)),
        }).collect();
        let noise = SolveNoise { flow: if plausible { 0.1 } else { flow }, height_m: 0.1, rate_radps: 0.001 };
        let known = KnownComponent { direction_camera: view.down_camera, speed_mps: known[0], sigma_mps: known[1] };
        let method = [Method::LeastSquares, Method::HUBER, Method::RANSAC][method];
        let limits = open().1;
        let w = Vector3::from(w).map(|c| tame(c, 1.0));
        for known in [None, Some(&known)] {
            if let Ok(out) = solve_velocity(&view, &features, &w, known, method, &noise, &limits) {
                prop_assert!((out.velocity_camera.sum() + out.covariance.sum() + out.condition + out.dilution).is_finite());
                prop_assert!(out.covariance.diagonal().min() >= 0.0);
            }
        }
        if let Ok(out) = solve_six(&view, &features, &noise, &limits) {
            prop_assert!((out.velocity_camera.sum() + out.covariance.sum() + out.condition).is_finite());
        }
    }
}

#[test]
fn the_rotation_of_an_image_needs_no_depth() {
    let image = Vector2::new(120.0, -80.0);
    let w = Vector3::new(0.1, -0.2, 0.3);
    let views = [5.0, 50.0].map(|h| View::from_roll_pitch(700.0, 0.1, 0.2, h));
    for view in views {
        let m = interaction_matrix(700.0, &ground_point(&view, &image).unwrap());
        let motion = Vector6::new(0.0, 0.0, 0.0, w.x, w.y, w.z);
        assert!((rotational_flow(700.0, &image, &w) + m * motion).norm() < 1e-9);
    }
}

/// A drone that flies along and turns, and a camera on its nose that looks ahead and down, is turned in its own image and sits off the IMU.
/// The image of a marker on the ground is that of a pinhole, computed in words of the image: how far right, how far down.
#[test]
fn a_camera_configured_once_serves_flow_and_landmarks_alike() {
    let mount = CameraMount::turned(so3::Euler::new(0.1, 0.5, 0.7), Body::new(Vector3::new(0.3, -0.1, 0.2)));
    let camera = LandmarkCamera { mount, half_field_of_view_rad: [0.7; 2] };
    let (v_body, w) = (Vector3::new(9.0, -2.0, 0.5), Vector3::new(0.2, -0.3, 0.4));
    let (r, height_m) = (so3::Euler::new(0.05, -0.1, 2.0).to_rotation(), 30.0);
    // In NED about the IMU: the camera, its axes, the ground.
    let columns = |t: f64| r * so3::exp(&(w * t)) * *mount.camera_to_body.matrix();
    let eye = |t: f64| r * v_body * t + r * so3::exp(&(w * t)) * mount.lever_arm.raw();
    let image = |marker: &Vector3<f64>, t: f64| {
        let (axes, towards) = (columns(t), marker - eye(t));
        let [top, right, axis] = [0, 1, 2].map(|i| axes.column(i).dot(&towards));
        Vector2::new(right, -top) / axis
    };
    let axis = columns(0.0).column(2).into_owned();
    let centre = eye(0.0) + axis * ((height_m - eye(0.0).z) / axis.z);
    let markers: Vec<Vector3<f64>> = (0..9)
        .map(|i| centre + Vector3::new(f64::from(i % 3 - 1) * 6.0, f64::from(i / 3 - 1) * 6.0, 0.0))
        .collect();

    // Flow: the images of all of them, a moment before and after.
    let dt = 1e-4;
    let features: Vec<Feature> = markers
        .iter()
        .map(|m| Feature { image: image(m, 0.0), flow: (image(m, dt) - image(m, -dt)) / (2.0 * dt) })
        .collect();
    let view = View::mounted(1.0, &mount, &r, height_m - eye(0.0).z);
    let rate_camera = mount.camera_to_body.to_camera(Body::new(w)).raw();
    let noise = SolveNoise { flow: 0.01, height_m: 0.0, rate_radps: 0.0 };
    let limits = SolveLimits { max_tilt_rad: 1.0, ..SolveLimits::default() };
    let solved =
        solve_velocity(&view, &features, &rate_camera, None, Method::HUBER, &noise, &limits).unwrap();
    let (velocity, _) = solved.at_body_origin(&mount, &w);
    assert!((velocity - v_body).norm() < 1e-4, "{velocity}");

    // One patch, as a flow sensor in the same place tells it: about the image's axes, right-handed.
    let patch = FlowPatch {
        integration_time_s: 0.02,
        flow_rad: features[4].flow * 0.02,
        rotation_rad: rate_camera.xy() * 0.02,
        body_rate: w,
        distance_m: Some((centre - eye(0.0)).norm()),
        height_m: None,
        quality: 1.0,
    };
    let limits = PatchLimits { max_tilt_rad: 1.0, ..PatchLimits::default() };
    let seen = single_patch::solve(&patch, &mount, &r, &limits, &PatchNoise::default()).unwrap();
    assert!((seen.velocity_camera - seen.body_to_measurement * v_body).norm() < 1e-4);

    // Landmarks: the same images as bearings, in the body.
    for marker in &markers {
        let bearing = camera.towards(image(marker, 0.0).map(f64::atan).into()).raw().normalize();
        let truth = r.tr_mul(&(marker - eye(0.0))).normalize();
        assert!((bearing - truth).norm() < 1e-12, "{bearing} {truth}");
        assert!(camera.sees(Body::new(truth)) && !camera.sees(Body::new(-truth)));
    }
}
