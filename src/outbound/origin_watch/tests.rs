//! A vehicle whose autopilot tells origins, true ones and others.

use super::*;
use crate::geo::{Body, BodyToNed};
use crate::navigator::solution::VelocitySource;
use nalgebra::Matrix3;

const NORTH: f64 = 15.0;

fn at(ms: i64) -> AutopilotTime {
    AutopilotTime::from_micros(ms * 1000)
}

fn home() -> Geodetic {
    Geodetic::from_degrees(47.4, 8.55, 500.0)
}

/// So far north and up of home.
fn off(north_m: f64, up_m: f64) -> Geodetic {
    LocalNed::new(home()).to_geodetic(&Vector3::new(north_m, 0.0, -up_m))
}

/// A vehicle that flies north at [`NORTH`] m/s since 0, and an autopilot that tells where it is.
struct Flying {
    watch: OriginWatch,
    frame: LocalNed,
    /// The autopilot's own frame begins there, and its estimate is off by this, NED, m.
    origin: Geodetic,
    error_ned: Vector3<f64>,
    tells_global: bool,
    mode: Mode,
    now_ms: i64,
    contradicted: u32,
}

impl Flying {
    fn new() -> Self {
        Self {
            watch: OriginWatch::new(),
            frame: LocalNed::new(home()),
            origin: home(),
            error_ned: Vector3::new(1.0, -0.7, 2.0),
            tells_global: false,
            mode: Mode::Aided,
            now_ms: 0,
            contradicted: 0,
        }
    }

    /// In flight for 20 s, with an origin that was told before.
    fn in_flight() -> Self {
        let mut flying = Self::new();
        flying.watch.set_disarmed(true);
        assert!(flying.tell(&home()));
        flying.watch.set_disarmed(false);
        flying.fly(20_000);
        flying
    }

    /// Takes what is to be taken; whether that moves the frame.
    fn heed(&mut self, word: Option<OriginWord>) -> bool {
        match word {
            Some(OriginWord::Take(origin)) => {
                let moved = self.frame.to_ned(&origin).norm() > 0.01;
                self.frame = LocalNed::new(origin);
                moved || self.now_ms == 0
            }
            Some(OriginWord::Contradicted(_)) => {
                self.contradicted += 1;
                false
            }
            None => false,
        }
    }

    fn tell(&mut self, origin: &Geodetic) -> bool {
        let word = self.watch.hear(at(self.now_ms), origin, Some(&self.frame), 1.0);
        self.heed(word)
    }

    fn truth(&self) -> Geodetic {
        off(NORTH * self.now_ms as f64 * 1e-3, 50.0)
    }

    fn solution(&self) -> Solution {
        Solution {
            time: at(self.now_ms),
            mode: self.mode,
            velocity_source: VelocitySource::Gnss,
            position: Ned::new(self.frame.to_ned(&self.truth())),
            velocity: Ned::new(Vector3::new(NORTH, 0.0, 0.0)),
            glide_velocity: Ned::new(Vector3::zeros()),
            attitude: BodyToNed::from_matrix(&Matrix3::identity()),
            angular_rate: Body::new(Vector3::zeros()),
            position_covariance: Ned::new(Matrix3::identity()),
            velocity_covariance: Ned::new(Matrix3::identity()),
            attitude_variance: Vector3::repeat(1e-4),
            reset_counter: 0,
        }
    }

    /// Flies on for `ms`, the autopilot's positions at 10 Hz; how long until the frame moved, ms.
    fn fly(&mut self, ms: i64) -> Option<i64> {
        let begun = self.now_ms;
        let mut moved = None;
        while self.now_ms < begun + ms {
            self.now_ms += 100;
            let position = LocalNed::new(self.origin).to_ned(&self.truth()) + self.error_ned;
            let velocity = Ned::new(Vector3::new(NORTH, 0.0, 0.0));
            let local =
                Reference::Local { time: at(self.now_ms - 40), position: Ned::new(position), velocity };
            if self.tells_global {
                let position = LocalNed::new(self.origin).to_geodetic(&position);
                let global = Reference::Global { time: at(self.now_ms - 30), position, velocity };
                let word = self.watch.reference(&global, &self.solution(), Some(&self.frame));
                assert_eq!(word, None);
            }
            let word = self.watch.reference(&local, &self.solution(), Some(&self.frame));
            if self.heed(word) {
                moved = moved.or(Some(self.now_ms - begun));
            }
        }
        moved
    }
}

#[test]
fn an_origin_that_nothing_confirms_is_not_used_in_flight() {
    for tells_global in [false, true] {
        for (north_m, up_m) in [(4.0, 0.0), (30.0, 0.0), (0.0, 200.0), (90_000.0, 10.0)] {
            let mut flying = Flying { tells_global, ..Flying::in_flight() };
            flying.fly(5000);
            for n in 0..60 {
                assert!(!flying.tell(&off(north_m, up_m)), "{north_m} {up_m}");
                // Beside the true one, or alone.
                assert!(n < 30 || !flying.tell(&home()));
                assert_eq!(flying.fly(1000), None, "{north_m} {up_m}");
            }
            assert!((1..=4).contains(&flying.contradicted), "{}", flying.contradicted);
            assert_eq!(flying.frame.origin(), home());
        }
    }
}

#[test]
fn many_small_moves_are_no_large_one() {
    let mut flying = Flying::in_flight();
    for n in 1..200 {
        flying.tell(&off(f64::from(n) * 0.4, 0.0));
        flying.fly(100);
    }
    assert!(flying.frame.to_ned(&home()).norm() < 1.1);
}

#[test]
fn an_autopilot_that_moves_its_origin_is_followed_within_a_second() {
    for tells_global in [false, true] {
        for mode in [Mode::Aided, Mode::Holdover] {
            for north_m in [6.0, 30.0, 2000.0] {
                let mut flying = Flying { tells_global, mode, ..Flying::in_flight() };
                flying.fly(5000);
                flying.origin = off(north_m, 3.0);
                assert!(!flying.tell(&off(north_m, 3.0)));
                let after = flying.fly(1000);
                assert!(after.is_some_and(|ms| ms <= 700), "{north_m} m, {mode:?}: {after:?}");
                assert_eq!((flying.frame.origin(), flying.contradicted), (flying.origin, 0));
                // And back.
                flying.origin = home();
                flying.tell(&home());
                assert!(flying.fly(1000).is_some());
            }
        }
    }
}

#[test]
fn positions_that_agree_now_and_then_are_no_proof() {
    // Somebody tells both: an origin, and positions that fit, between those of the autopilot.
    let mut flying = Flying::in_flight();
    flying.tell(&off(500.0, 0.0));
    for _ in 0..100 {
        flying.origin = off(500.0, 0.0);
        assert_eq!(flying.fly(200), None);
        flying.origin = home();
        assert_eq!(flying.fly(100), None);
    }
}

#[test]
fn the_first_origin_is_taken_at_once_unless_the_autopilots_positions_deny_it() {
    // Our first fix was 300 m north of where the autopilot began, on the ground or in flight.
    for disarmed in [true, false] {
        let mut flying = Flying { frame: LocalNed::new(off(300.0, 0.0)), ..Flying::new() };
        flying.watch.set_disarmed(disarmed);
        flying.fly(10_000);
        assert!(flying.tell(&home()));
        // It is the rule from now on.
        assert_eq!((flying.tell(&off(800.0, 0.0)), flying.fly(5000)), (disarmed, None));
        let mut flying = Flying { tells_global: true, ..Flying::new() };
        flying.watch.set_disarmed(disarmed);
        flying.fly(10_000);
        assert!(!flying.tell(&off(5000.0, 0.0)), "it says that it is elsewhere");
        assert!(flying.fly(2000).is_none() && flying.contradicted == 1);
        assert!(!flying.tell(&home()), "it is where it was");
        assert_eq!(flying.frame.origin(), home());
    }
    // Nothing else is known.
    let mut flying = Flying::new();
    let word = flying.watch.hear(at(0), &off(70.0, 0.0), None, 0.0);
    assert_eq!(word, Some(OriginWord::Take(off(70.0, 0.0))));
}

#[test]
fn where_no_positions_come_an_origin_moves_on_the_ground_only() {
    let mut flying = Flying::in_flight();
    flying.now_ms += 3000;
    for _ in 0..100 {
        flying.now_ms += 1000;
        assert!(!flying.tell(&off(60.0, 0.0)), "however often it is told");
    }
    assert!((3..=4).contains(&flying.contradicted), "{}", flying.contradicted);
    flying.watch.set_disarmed(true);
    assert!(flying.tell(&off(60.0, 0.0)));
}
