//! Rates, order, streams, and errors of simulated flights.

use super::*;
use crate::geo::so3;
use crate::sample::{FlowRotation, SampleKind};
use crate::sim::models::{GnssOutage, OutageKind, RotationContent};

fn short(name: &str, duration_s: f64) -> Scenario {
    Scenario::by_name(name).unwrap().lasting(duration_s)
}

fn everything() -> SensorSuite {
    SensorSuite { airspeed: Some(AirspeedModel::pitot()), ..SensorSuite::mems().near_the_ground() }
}

#[test]
fn the_same_seed_gives_the_same_flight_and_another_does_not() {
    let fly = |seed| Simulation::new(short("square", 40.0), everything(), seed).collect::<Vec<_>>();
    assert_eq!(fly(5), fly(5));
    assert_ne!(fly(5), fly(6));
}

#[test]
fn changing_one_sensor_changes_no_other() {
    let fly = |suite| Simulation::new(short("circles", 20.0), suite, 5);
    let without = SensorSuite { magnetometer: None, imu: ImuModel::tactical(), ..SensorSuite::mems() };
    for (a, b) in fly(SensorSuite::mems()).zip(fly(without)) {
        assert_eq!((a.gnss, a.flow, a.barometer), (b.gnss, b.flow, b.barometer));
        assert_ne!(a.imu, b.imu);
    }
}

#[test]
fn sensors_come_at_their_rates_and_in_order() {
    let mut counts = [0; SampleKind::ALL.len()];
    let mut newest = None;
    for r in Simulation::new(short("square", 60.0), everything(), 1) {
        for (i, s) in r.samples.iter().enumerate() {
            counts[s.kind() as usize] += 1;
            assert_eq!(s.time(), r.time);
            assert!(i > 0 || matches!(s, Sample::Imu(_)));
        }
        assert!(newest < Some(r.time));
        newest = Some(r.time);
    }
    let of = |k: SampleKind| counts[k as usize];
    assert_eq!((of(SampleKind::Imu), of(SampleKind::Mag), of(SampleKind::Pressure)), (6000, 3000, 1500));
    assert_eq!((of(SampleKind::Gnss), of(SampleKind::Range), of(SampleKind::Airspeed)), (300, 1200, 600));
    // None while it stands on the ground.
    assert!((700..900).contains(&of(SampleKind::Flow)), "{}", of(SampleKind::Flow));
}

#[test]
fn without_errors_the_sensors_say_the_truth() {
    let frame = LocalNed::new(Scenario::cessna().origin);
    for r in Simulation::new(Scenario::cessna(), SensorSuite::ideal(), 1) {
        assert_eq!(r.imu.measured, r.imu.ideal);
        if let Some(g) = r.gnss {
            assert_eq!((g.position_ned, g.velocity_ned), (r.truth.position_ned, r.truth.velocity_ned));
        }
        if let Some(f) = r.flow {
            assert!((f.velocity_body - f.ideal_body).norm() < 1e-12);
        }
        for s in r.samples.iter() {
            match s {
                Sample::Gnss(g) => {
                    let p = frame.to_ned(&g.position.unwrap());
                    assert!((p - r.truth.position_ned).norm() < 1e-6);
                    let (n, e) = g.ground_velocity.unwrap().north_east();
                    assert!((n - r.truth.velocity_ned.x).hypot(e - r.truth.velocity_ned.y) < 1e-9);
                }
                Sample::Pressure(p) => {
                    // The standard atmosphere's height, by its own formula.
                    let h = 288.15 / 0.0065 * (1.0 - (p.pressure_pa / 101_325.0).powf(0.190_263));
                    assert!((h - 100.0 + r.truth.position_ned.z).abs() < 0.01, "{h}");
                }
                _ => {}
            }
        }
    }
}

#[test]
fn a_patch_gives_the_erroneous_velocity_back() {
    let contents = [RotationContent::Contained, RotationContent::SensorGyro(0.0), RotationContent::Removed];
    for rotation in contents {
        let flow = Some(FlowModel { rotation, ..FlowModel::camera() });
        let suite = SensorSuite { flow, ..SensorSuite::ideal() };
        let mut rates: Vec<Vector3<f64>> = Vec::new();
        for r in Simulation::new(short("circles", 60.0), suite, 3) {
            rates.push(r.imu.ideal.angular_rate);
            let Some(f) = r.flow else { continue };
            let [x, y] = match f.rotation {
                FlowRotation::Removed | FlowRotation::InOwnUnit => [0.0; 2],
                FlowRotation::SensorGyro(gyro) => gyro,
                FlowRotation::Contained => {
                    let last = &rates[rates.len() - 10..];
                    let mean = last.iter().sum::<Vector3<f64>>() / 10.0;
                    [mean.x, mean.y]
                }
            };
            let v = [f.distance_m * (f.rate_xy[1] - y), -f.distance_m * (f.rate_xy[0] - x)];
            // The vehicle's gyro holds the Earth's turn as well: 130 m times 7e-5 rad/s.
            assert!((v[0] - f.velocity_body.x).hypot(v[1] - f.velocity_body.y) < 0.012, "{rotation:?}");
        }
    }
}

#[test]
fn gnss_is_late_and_goes_when_told() {
    let outage = |kind| Some(GnssOutage { from_s: 4.0, to_s: 6.0, kind });
    let fly = |kind| {
        let gnss = GnssModel { latency_s: 0.2, outage: outage(kind), ..GnssModel::ideal() };
        let suite = SensorSuite { gnss: Some(gnss), ..SensorSuite::ideal() };
        Simulation::new(short("straight", 10.0), suite, 3)
    };
    let flight = fly(OutageKind::Silent);
    let truth = |t| flight.truth(t);
    let fixes: Vec<_> =
        fly(OutageKind::NoFix).filter_map(|r| r.gnss.map(|g| (r.t_s, g, r.samples))).collect();
    assert_eq!(fixes.len(), 50);
    for (t, g, samples) in &fixes {
        assert!((t - g.measured_s - 0.2).abs() < 1e-9);
        assert_eq!(g.position_ned, truth(g.measured_s).position_ned);
        let lost = (4.0..6.0).contains(t);
        let said = samples.iter().find_map(|s| if let Sample::Gnss(g) = s { Some(g.fix) } else { None });
        assert_eq!(said, Some(if lost { GnssFix::None } else { GnssFix::ThreeD }), "{t}");
    }
    let said = fly(OutageKind::Silent)
        .flat_map(|r| r.samples.iter().filter(|s| s.kind() == SampleKind::Gnss).count().checked_sub(1))
        .count();
    assert_eq!(said, 40);
}

#[test]
fn biases_stay_what_they_are_said_to_be() {
    let flight = Simulation::new(short("circles", 300.0), SensorSuite::mems(), 4);
    let (mut sum, mut n) = (Vector3::zeros(), 0.0);
    for r in flight {
        let scaled = r.imu.gyro_scale.component_mul(&r.imu.ideal.angular_rate);
        sum += r.imu.measured.angular_rate - r.imu.ideal.angular_rate - scaled - r.imu.gyro_bias;
        n += 1.0;
        let size = r.imu.gyro_bias.map(|b| b.abs().to_degrees());
        assert!((size - Vector3::new(0.5, 0.3, 0.8)).amax() < 0.02, "{size}");
    }
    let expected = ImuModel::mems().gyro_density / 0.1 / f64::sqrt(n);
    assert!((sum / n).norm() < 5.0 * expected);
}

/// Horizontal error of a strapdown integration through the outage, in % of the way, from the true state with the biases as they
/// were on the average of the last 100 s and the scale known.
fn coasted(name: &str, imu: ImuModel, seed: u64) -> f64 {
    let suite = SensorSuite {
        imu,
        gnss: None,
        magnetometer: None,
        barometer: None,
        flow: None,
        ..SensorSuite::ideal()
    };
    let simulation = Simulation::new(Scenario::by_name(name).unwrap(), suite, seed);
    let world = simulation.scenario().environment;
    let start = simulation.truth(720.0);
    let (mut r, mut v, mut p) = (start.r_body_to_ned, start.velocity_ned, start.position_ned);
    let (mut gyro, mut accel) = (Vector3::zeros(), Vector3::zeros());
    let (mut way, mut before) = (0.0, p);
    for x in simulation.filter(|x| x.t_s > 620.0) {
        let (measured, ideal) = (x.imu.measured, x.imu.ideal);
        if x.t_s <= 720.0 {
            let scaled = x.imu.gyro_scale.component_mul(&ideal.angular_rate);
            gyro += (measured.angular_rate - ideal.angular_rate - scaled) / 1e4;
            accel += (measured.specific_force - ideal.specific_force) / 1e4;
            continue;
        }
        let scale = x.imu.gyro_scale.map(|s| 1.0 + s);
        let rate = (measured.angular_rate - gyro).component_div(&scale) - r.tr_mul(&world.earth_rate_ned);
        let middle = r * so3::exp(&(0.5 * x.dt_s * rate));
        let force = middle * (measured.specific_force - accel);
        let a = force + world.gravity_ned() - 2.0 * world.earth_rate_ned.cross(&v);
        p += x.dt_s * (v + 0.5 * x.dt_s * a);
        v += x.dt_s * a;
        r *= so3::exp(&(x.dt_s * rate));
        // Height comes from the barometer.
        (p.z, v.z) = (x.truth.position_ned.z, x.truth.velocity_ned.z);
        way += (x.truth.position_ned - before).norm();
        before = x.truth.position_ned;
    }
    100.0 * (p - before).xy().norm() / way
}

#[test]
fn the_grades_of_imu_coast_as_badly_as_the_literature_says() {
    let median = |name, imu| {
        let mut percent: Vec<f64> = (1..=5).map(|seed| coasted(name, imu, seed)).collect();
        percent.sort_by(f64::total_cmp);
        percent[2]
    };
    for (name, imu, least, most) in
        [("straight", ImuModel::tactical(), 6.0, 25.0), ("straight", ImuModel::mems(), 40.0, 140.0)]
    {
        let percent = median(name, imu);
        assert!((least..most).contains(&percent), "{name}: {percent} %");
    }
    assert!(coasted("straight", ImuModel::ideal(), 1) < 0.01);
}
