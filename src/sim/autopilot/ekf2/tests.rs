//! PX4's rules, each as it was measured on a running autopilot.

use super::*;

const STEP_S: f64 = 0.01;

fn settings() -> Ekf2Settings {
    Ekf2Settings {
        control: 15,
        delay_s: 0.0,
        most_delay_s: 0.2,
        least_quality: 0,
        position_noise_m: 0.1,
        velocity_noise_mps: 0.1,
        no_aid_s: 5.0,
    }
}

/// A vehicle at rest at its origin.
struct Bench {
    ekf: Ekf2,
    filter: OwnFilter,
    now_s: f64,
}

impl Bench {
    fn new(settings: Ekf2Settings) -> Self {
        Self { ekf: Ekf2::new(settings), filter: OwnFilter::at_rest(Matrix3::identity(), 3), now_s: 0.0 }
    }

    /// Runs on with messages every `period` steps; `each` sees their fates.
    fn run(
        &mut self,
        seconds: f64,
        gnss: bool,
        period: u32,
        pose: &ExternalPose,
        mut each: impl FnMut(&Self, ExternalFate),
    ) {
        for k in 0..(seconds / STEP_S).round() as u32 {
            self.now_s += STEP_S;
            let force = Vector3::new(0.0, 0.0, -9.81);
            self.filter.predict(self.now_s, STEP_S, &force, &Matrix3::identity(), 9.81);
            self.ekf.step(self.now_s, STEP_S, &mut self.filter);
            if gnss && k % 20 == 0 {
                self.ekf.gnss(self.now_s, &Vector3::zeros(), &Vector3::zeros(), &mut self.filter);
            }
            if period > 0 && k % period == 0 {
                let late_s = pose.arrived_s - pose.stamp_s;
                let told = ExternalPose { arrived_s: self.now_s, stamp_s: self.now_s - late_s, ..*pose };
                let fate = self.ekf.external(&told, true, &mut self.filter);
                each(self, fate);
            }
        }
    }
}

fn told(north_m: f64) -> ExternalPose {
    ExternalPose {
        message: ExternalMessage::Odometry {
            pose: ReportedFrame::LocalNed,
            velocity: ReportedFrame::BodyFrd,
            estimator_type: 3,
            quality: 90,
        },
        stamp_s: -0.02,
        arrived_s: 0.0,
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
fn what_is_late_or_not_read_is_dropped_without_a_word() {
    let mut bench = Bench::new(settings());
    let fate = |bench: &mut Bench, pose: &ExternalPose, believed| {
        bench.ekf.external(pose, believed, &mut bench.filter)
    };
    let late = ExternalPose { stamp_s: -0.25, ..told(0.0) };
    assert_eq!(fate(&mut bench, &late, true), ExternalFate::TooLate);
    assert_ne!(
        fate(&mut bench, &late, false),
        ExternalFate::TooLate,
        "the time of arrival counts before TIMESYNC"
    );
    let speed = ExternalPose { message: ExternalMessage::VisionSpeed, ..told(0.0) };
    assert_eq!(fate(&mut bench, &speed, true), ExternalFate::NotRead);
    let odometry = |pose, velocity, estimator_type| ExternalPose {
        message: ExternalMessage::Odometry { pose, velocity, estimator_type, quality: 90 },
        ..told(0.0)
    };
    use ReportedFrame::{BodyFrd, LocalFrd, LocalNed, Other};
    for odd in [odometry(Other, BodyFrd, 3), odometry(LocalNed, Other, 3), odometry(LocalFrd, BodyFrd, 6)] {
        assert_eq!(fate(&mut bench, &odd, true), ExternalFate::NotRead);
    }
}

#[test]
fn fusion_starts_above_five_a_second_and_goes_on_above_two_and_a_half() {
    let started = |period| {
        let mut bench = Bench::new(settings());
        bench.run(5.0, false, period, &told(0.0), |_, _| {});
        bench.ekf.uses_external(bench.now_s)
    };
    assert!(started(19) && !started(21), "5.3 Hz starts and 4.8 Hz does not");
    let goes_on = |period| {
        let mut bench = Bench::new(settings());
        bench.run(5.0, false, 3, &told(0.0), |_, _| {});
        bench.run(5.0, false, period, &told(0.0), |_, _| {});
        bench.ekf.uses_external(bench.now_s)
    };
    assert!(goes_on(38) && !goes_on(43), "2.6 Hz goes on and 2.3 Hz does not");
}

#[test]
fn seven_seconds_after_gnss_the_position_is_reset_to_the_raw_one() {
    let mut bench = Bench::new(settings());
    bench.run(30.0, true, 3, &told(5.0), |_, _| {});
    assert!(bench.filter.position().x.abs() < 0.2, "the bias is tracked: {}", bench.filter.position());
    bench.run(6.5, false, 3, &told(5.0), |_, _| {});
    assert!(bench.filter.position().x.abs() < 0.3 && bench.ekf.uses_gnss());
    bench.run(1.0, false, 3, &told(5.0), |_, _| {});
    assert!(
        (bench.filter.position().x - 5.0).abs() < 0.2,
        "it flies off by that: {}",
        bench.filter.position()
    );
    // GNSS comes back, 5 m away from what is flown on: it is not used again.
    bench.run(20.0, true, 3, &told(5.0), |_, _| {});
    assert!((bench.filter.position().x - 5.0).abs() < 0.3 && !bench.ekf.uses_gnss());
    // An aligned one is.
    let mut bench = Bench::new(settings());
    for gnss in [true, false, true] {
        bench.run(20.0, gnss, 3, &told(0.0), |_, _| {});
    }
    assert!(bench.ekf.uses_gnss() && bench.filter.position().x.abs() < 0.2);
}

#[test]
fn without_aiding_it_lands_after_five_seconds() {
    let mut bench = Bench::new(settings());
    bench.run(20.0, true, 0, &told(0.0), |_, _| {});
    assert!(!bench.ekf.failsafe(bench.now_s));
    bench.run(4.7, false, 0, &told(0.0), |_, _| {});
    assert!(!bench.ekf.failsafe(bench.now_s), "4 s are survived");
    bench.run(1.2, false, 0, &told(0.0), |_, _| {});
    assert!(bench.ekf.failsafe(bench.now_s));
}

#[test]
fn a_sixth_jump_stops_external_vision() {
    let mut bench = Bench::new(settings());
    for reset_counter in 0..7 {
        let pose = ExternalPose { reset_counter, ..told(f64::from(reset_counter)) };
        bench.run(3.0, false, 3, &pose, |_, _| {});
        assert_eq!(bench.ekf.uses_external(bench.now_s), reset_counter < 6, "{reset_counter}");
    }
}
