//! ArduPilot's rules, each as it was measured on a running autopilot.

use nalgebra::Matrix3;

use super::*;

const STEP_S: f64 = 0.01;
const GPS: AidingSet = AidingSet {
    position: AidingSource::Gps,
    velocity: AidingSource::Gps,
    climb: AidingSource::Gps,
    height: AidingSource::Own,
    heading: AidingSource::Own,
};
const EXTERNAL: AidingSet = AidingSet {
    position: AidingSource::ExternalNav,
    velocity: AidingSource::ExternalNav,
    climb: AidingSource::ExternalNav,
    ..GPS
};

fn settings() -> Ekf3Settings {
    Ekf3Settings {
        viso_type: 1,
        delay_s: 0.0,
        least_quality: 0,
        position_noise_m: 0.2,
        velocity_noise_mps: 0.1,
        sets: [GPS, EXTERNAL, GPS],
    }
}

/// A vehicle at rest at its origin.
struct Bench {
    ekf: Ekf3,
    filter: OwnFilter,
    now_s: f64,
}

impl Bench {
    fn new(settings: Ekf3Settings) -> Self {
        let filter = OwnFilter::at_rest(Matrix3::identity(), 3);
        Self { ekf: Ekf3::new(settings), filter, now_s: 0.0 }
    }

    /// Runs on; `each` is called at every step.
    fn run(&mut self, seconds: f64, mut each: impl FnMut(&mut Self)) {
        for _ in 0..(seconds / STEP_S) as u32 {
            self.now_s += STEP_S;
            let force = Vector3::new(0.0, 0.0, -9.81);
            self.filter.predict(self.now_s, STEP_S, &force, &Matrix3::identity(), 9.81);
            self.ekf.step(STEP_S, &mut self.filter);
            each(self);
        }
    }

    fn gps(&mut self) {
        self.ekf.gps(self.now_s, &Vector3::zeros(), &Vector3::zeros(), &mut self.filter);
    }

    fn odometry(&mut self, north_m: f64) -> ExternalFate {
        let pose = told(self.now_s, north_m);
        self.ekf.external(&pose, &mut self.filter)
    }
}

fn told(now_s: f64, north_m: f64) -> ExternalPose {
    ExternalPose {
        message: ExternalMessage::Odometry {
            pose: ReportedFrame::LocalFrd,
            velocity: ReportedFrame::BodyFrd,
            estimator_type: 3,
            quality: 90,
        },
        stamp_s: now_s - 0.02,
        arrived_s: now_s,
        position: Some(Vector3::new(north_m, 0.0, 0.0)),
        attitude: Some(Matrix3::identity()),
        quaternion_error: 0.0,
        velocity: Some(Vector3::zeros()),
        position_variance: Vector3::repeat(0.01),
        velocity_variance: Vector3::repeat(0.01),
        reset_counter: 0,
    }
}

#[test]
fn only_one_pair_of_frames_is_read_and_only_what_is_read_is_healthy() {
    use ReportedFrame::{BodyFrd, LocalFrd, LocalNed, Other};
    for (pose, velocity) in [(LocalNed, BodyFrd), (LocalFrd, LocalFrd), (LocalNed, LocalNed), (Other, Other)]
    {
        let mut bench = Bench::new(settings());
        let message = ExternalMessage::Odometry { pose, velocity, estimator_type: 3, quality: 90 };
        let odd = ExternalPose { message, ..told(0.0, 0.0) };
        assert_eq!(bench.ekf.external(&odd, &mut bench.filter), ExternalFate::NotRead);
        assert!(!bench.ekf.external_is_healthy(0.0));
    }
    let mut bench = Bench::new(settings());
    bench.odometry(0.0);
    assert!(bench.ekf.external_is_healthy(0.29) && !bench.ekf.external_is_healthy(0.31));
    assert!(
        Ekf3::new(Ekf3Settings { viso_type: 0, ..settings() }).external_is_healthy(9.0),
        "it is not wanted"
    );
}

#[test]
fn a_set_is_switched_to_by_a_jump_to_the_new_source() {
    let mut bench = Bench::new(settings());
    bench.run(20.0, |b| {
        b.gps();
        assert!(matches!(b.odometry(10.0), ExternalFate::NotSelected | ExternalFate::TooSoon));
    });
    assert!(bench.filter.position().xy().norm() < 0.2);
    assert!(!bench.ekf.select(0) && !bench.ekf.select(4) && bench.ekf.select(2));
    bench.run(0.1, |b| {
        b.odometry(10.0);
    });
    assert!(
        (bench.filter.position().x - 10.0).abs() < 0.1,
        "a frame that is 10 m off moves the vehicle by 10 m"
    );
}

#[test]
fn a_jump_is_refused_for_ten_seconds_and_taken_then_and_at_once_with_the_counter() {
    let mut bench = Bench::new(settings());
    bench.ekf.select(2);
    bench.run(30.0, |b| {
        b.odometry(0.0);
    });
    bench.run(8.0, |b| {
        b.odometry(5.0);
    });
    assert!(bench.filter.position().x.abs() < 0.5, "{}", bench.filter.position());
    bench.run(4.0, |b| {
        b.odometry(5.0);
    });
    assert!((bench.filter.position().x - 5.0).abs() < 0.2, "{}", bench.filter.position());
    bench.now_s += 0.05;
    let pose = ExternalPose { reset_counter: 1, ..told(bench.now_s, -3.0) };
    assert_eq!(bench.ekf.external(&pose, &mut bench.filter), ExternalFate::Jumped);
    assert!((bench.filter.position().x + 3.0).abs() < 0.05, "{}", bench.filter.position());
}

#[test]
fn fifty_a_second_are_taken_and_a_low_quality_is_heard_and_not_used() {
    let mut bench = Bench::new(Ekf3Settings { least_quality: 50, ..settings() });
    bench.ekf.select(2);
    let mut fates = super::super::external::ExternalCounts::default();
    bench.run(10.0, |b| {
        let fate = b.odometry(0.0);
        fates.count(fate);
    });
    let taken = fates.total() - fates.of(ExternalFate::TooSoon);
    assert!((495..=505).contains(&taken), "{taken} of {}", fates.total());
    bench.now_s += 1.0;
    let low = ExternalMessage::Odometry {
        pose: ReportedFrame::LocalFrd,
        velocity: ReportedFrame::BodyFrd,
        estimator_type: 3,
        quality: 40,
    };
    let pose = ExternalPose { message: low, ..told(bench.now_s, 0.0) };
    assert_eq!(bench.ekf.external(&pose, &mut bench.filter), ExternalFate::LowQuality);
    assert!(bench.ekf.external_is_healthy(bench.now_s));
    let vision = ExternalPose { message: ExternalMessage::VisionPosition, ..pose };
    assert_eq!(bench.ekf.external(&vision, &mut bench.filter), ExternalFate::LowQuality);
}

#[test]
fn buffers_are_made_at_boot_only() {
    let mut bench = Bench::new(Ekf3Settings { sets: [GPS; 3], ..settings() });
    bench.ekf.set(settings());
    bench.ekf.select(2);
    bench.run(1.0, |b| assert!(!matches!(b.odometry(0.0), ExternalFate::Fused | ExternalFate::Jumped)));
}

#[test]
fn failsafes_act_when_they_were_seen_to() {
    let mut bench = Bench::new(settings());
    bench.run(10.0, Bench::gps);
    let mut acted = None;
    // GPS is lost, nobody switches, good messages stream.
    let lost = bench.now_s;
    bench.run(20.0, |b| {
        b.odometry(0.0);
        acted = acted.or_else(|| b.ekf.failsafe(b.now_s).then_some(b.now_s - lost));
    });
    assert!(acted.is_some_and(|t| (15.0..=16.1).contains(&t)), "{acted:?}");
    // On set 2 the messages stop.
    bench.ekf.select(2);
    bench.run(10.0, |b| {
        b.odometry(0.0);
    });
    assert!(bench.ekf.is_aided(bench.now_s) && !bench.ekf.failsafe(bench.now_s));
    let (stopped, mut acted, mut ended) = (bench.now_s, None, None);
    bench.run(20.0, |b| {
        acted = acted.or_else(|| b.ekf.failsafe(b.now_s).then_some(b.now_s - stopped));
        ended = ended.or_else(|| (!b.ekf.has_position(b.now_s)).then_some(b.now_s - stopped));
    });
    assert!(acted.is_some_and(|t| (7.9..=8.1).contains(&t)), "{acted:?}");
    assert!(ended.is_some_and(|t| (14.9..=15.1).contains(&t)), "{ended:?}");
}
