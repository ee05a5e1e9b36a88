//! Flights in the simulators of ArduPilot and PX4, recorded by the ground station and by the autopilot at once: the navigation is the
//! same from both, as far as the rates allow.

use std::path::PathBuf;

use holdover::config::{Settings, Sources};
use holdover::geo::{Geodetic, LocalNed};
use holdover::log::Log;
use holdover::navigator::solution::{Mode, Solution};
use holdover::replay::runner::{self, Runner};
use holdover::sample::Input;
use holdover::time::AutopilotTime;
use holdover::wire::clock::AutopilotClock;

/// A solution, and where on the globe it is.
#[derive(Clone, Copy)]
struct Point {
    solution: Solution,
    position: Geodetic,
}

/// Solutions of a flight, ten a second, with GNSS withheld in an interval of the autopilot's clock, s.
fn fly(name: &str, outage_s: (f64, f64)) -> Vec<Point> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("sitl-logs").join(name);
    let log = Log::open(&path, None).unwrap();
    let mut first: Option<AutopilotTime> = None;
    log.play(
        |_, _| {},
        |_, i| match i {
            Input::Sample(s) => first = first.or(Some(s.time())),
            Input::Reference(r) => first = first.or(Some(r.time())),
            _ => {}
        },
    )
    .unwrap();
    let first_s = first.unwrap().micros() as f64 * 1e-6;
    let overrides = vec!["flow.use=false".to_owned()];
    let settings = Settings::load(&Sources { overrides, ..Sources::default() }).unwrap().pipeline;
    let outage = (outage_s.0 - first_s, outage_s.1 - first_s);
    let mut points: Vec<Point> = Vec::new();
    let watch = |runner: &Runner, _: &AutopilotClock, item: &Input, _: &[_]| {
        let (Input::Sample(_), Some(solution), Some(frame)) =
            (item, runner.solution(), runner.pipeline.navigator.frame())
        else {
            return;
        };
        if points.last().is_none_or(|p| solution.time.seconds_since(p.solution.time) >= 0.1)
            && solution.mode != Mode::Aligning
        {
            points.push(Point { solution: *solution, position: frame.to_geodetic(&solution.position.raw()) });
        }
    };
    runner::run(&log, &settings, &[outage], &[], |_| {}, watch).unwrap();
    assert!(points.len() > 200, "{name}: {} solutions", points.len());
    points
}

/// How far two navigations are apart, m: root mean square with GNSS, and at the end of the outage over what both claim together.
struct Apart {
    aided_rms_m: f64,
    outage_end_m: f64,
    outage_end_sigma_m: f64,
}

fn apart(a: &[Point], b: &[Point], outage_s: (f64, f64)) -> Apart {
    let frame = LocalNed::new(a[0].position);
    let (mut squares, mut n) = (0.0, 0.0);
    let mut end = (0.0, 0.0);
    for p in a {
        let t = p.solution.time.micros() as f64 * 1e-6;
        let Some(q) = b.iter().min_by_key(|q| (q.solution.time - p.solution.time).micros().abs()) else {
            continue;
        };
        let dt = p.solution.time.seconds_since(q.solution.time);
        if dt.abs() > 0.1 {
            continue;
        }
        let there = frame.to_ned(&q.position) + q.solution.velocity.raw() * dt;
        let off_m = (frame.to_ned(&p.position) - there).xy().norm();
        if (outage_s.0..outage_s.1).contains(&t) {
            end = (off_m, p.solution.horizontal_sigma_m().hypot(q.solution.horizontal_sigma_m()));
        } else if p.solution.mode == Mode::Aided && q.solution.mode == Mode::Aided {
            squares += off_m * off_m;
            n += 1.0;
        }
    }
    assert!(n > 100.0, "{n}");
    Apart { aided_rms_m: (squares / n).sqrt(), outage_end_m: end.0, outage_end_sigma_m: end.1 }
}

#[test]
fn the_autopilots_log_and_the_ground_stations_give_the_same_navigation() {
    let cases = [
        ("ardupilot-copter-golden.tlog.zst", "ardupilot-copter-golden.bin.zst", (70.0, 90.0)),
        ("px4-quad-golden.tlog.zst", "px4-quad-golden.ulg.zst", (45.0, 65.0)),
    ];
    for (tlog, own, outage_s) in cases {
        let apart = apart(&fly(tlog, outage_s), &fly(own, outage_s), outage_s);
        let Apart { aided_rms_m, outage_end_m, outage_end_sigma_m } = apart;
        println!(
            "{own}: {aided_rms_m:.3} m with GNSS, {outage_end_m:.2} m after 20 s without, sigma {outage_end_sigma_m:.1} m"
        );
        assert!(aided_rms_m < 0.3, "{own}: {aided_rms_m} m");
        assert!(
            outage_end_m < 2.0 * outage_end_sigma_m,
            "{own}: {outage_end_m} m, sigma {outage_end_sigma_m} m"
        );
    }
}
