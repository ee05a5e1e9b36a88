//! The recent past: what the attitude was when a late sample was taken, and how the vehicle turned while a flow was integrated.

use nalgebra::{Matrix3, Vector3};

use crate::time::{AutopilotTime, Past, Stamped};

use super::reset::Reset;

/// One remembered instant.
#[derive(Clone, Copy, Debug)]
struct Remembered {
    time: AutopilotTime,
    r_body_to_ned: Matrix3<f64>,
    /// ∫ω dt in body axes since the start, rad: differences give mean rates.
    turned_body: Vector3<f64>,
    acceleration_ned: Vector3<f64>,
    /// ∫ a dt, NED, since the start, m/s, and of what of it the level axes felt.
    impulse_ned: Vector3<f64>,
    sideways_ned: Vector3<f64>,
    position_ned: Vector3<f64>,
    velocity_ned: Vector3<f64>,
}

impl Stamped for Remembered {
    fn stamp(&self) -> AutopilotTime {
        self.time
    }
}

/// What is remembered of an instant.
#[derive(Clone, Copy, Debug)]
pub(super) struct MotionNow {
    /// Attitude.
    pub(super) r_body_to_ned: Matrix3<f64>,
    /// Rotation since the last instant, body axes, rad.
    pub(super) turned: Vector3<f64>,
    /// Acceleration, NED, m/s², and the specific force of the body's x and y axes, NED, m/s².
    pub(super) acceleration_ned: Vector3<f64>,
    pub(super) sideways_ned: Vector3<f64>,
    /// Estimated position, NED, m.
    pub(super) position_ned: Vector3<f64>,
    /// Estimated velocity, NED, m/s.
    pub(super) velocity_ned: Vector3<f64>,
}

/// Corrections are carried back this far, s: no measurement is later.
pub(super) const CORRECTED_S: f64 = 0.6;

/// A stamp may lie this far ahead of the newest instant, s.
const AHEAD_S: f64 = 0.05;

/// The remembered instants; nothing is allocated after construction.
#[derive(Clone, Debug)]
pub(super) struct Timeline {
    past: Past<Remembered>,
    /// How often it began anew.
    epoch: u32,
}

impl Timeline {
    /// Remembers `capacity` IMU samples (512 are 2 s at 250 Hz).
    pub(super) fn new(capacity: usize) -> Self {
        Self { past: Past::new(capacity.max(2)), epoch: 0 }
    }

    /// Whatever breaks the motion, or sets it anew, makes what is remembered another's.
    pub(super) fn reset(&mut self, _: &Reset) {
        self.past.clear();
        self.epoch = self.epoch.wrapping_add(1);
    }

    /// Changes when it begins anew: impulses of different epochs have nothing to do with each other.
    pub(super) fn epoch(&self) -> u32 {
        self.epoch
    }

    /// Adds the newest instant.
    pub(super) fn push(&mut self, time: AutopilotTime, i: &MotionNow) {
        let zero = Vector3::zeros();
        let (turned_body, impulse_ned, sideways_ned) =
            self.past.newest().map_or((i.turned, zero, zero), |last| {
                let dt = time.seconds_since(last.time);
                (
                    last.turned_body + i.turned,
                    last.impulse_ned + i.acceleration_ned * dt,
                    last.sideways_ned + i.sideways_ned * dt,
                )
            });
        self.past.push(Remembered {
            time,
            r_body_to_ned: i.r_body_to_ned,
            turned_body,
            acceleration_ned: i.acceleration_ned,
            impulse_ned,
            sideways_ned,
            position_ned: i.position_ned,
            velocity_ned: i.velocity_ned,
        });
    }

    /// What the acceleration had added up to at `time`, or a little beyond the newest instant, NED, m/s: differences of it are changes of the velocity that nothing corrected.
    pub(super) fn impulse(&self, time: AutopilotTime) -> Option<Vector3<f64>> {
        let newest = self.past.newest()?;
        let ahead = time.seconds_since(newest.time);
        if ahead > 0.0 {
            return (ahead <= AHEAD_S).then(|| newest.impulse_ned + newest.acceleration_ned * ahead);
        }
        let (earlier, later, f) = self.past.around(time)?;
        Some(earlier.impulse_ned + (later.impulse_ned - earlier.impulse_ned) * f)
    }

    /// What of that the body's x and y axes felt: a multirotor's thrust has no part in it.
    pub(super) fn sideways(&self, time: AutopilotTime) -> Option<Vector3<f64>> {
        let (earlier, later, f) = self.past.around(time)?;
        Some(earlier.sideways_ned + (later.sideways_ned - earlier.sideways_ned) * f)
    }

    /// Position and velocity at `time`, linearly between two instants, and a little beyond the newest: stamps of other sensors may
    /// lie ahead of the IMU's by some samples.
    pub(super) fn motion(&self, time: AutopilotTime) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let newest = self.past.newest()?;
        let ahead = time.seconds_since(newest.time);
        if ahead > 0.0 {
            let p = newest.position_ned + newest.velocity_ned * ahead;
            return (ahead <= AHEAD_S).then_some((p, newest.velocity_ned));
        }
        let (earlier, later, f) = self.past.around(time)?;
        let between = |a: &Vector3<f64>, b: &Vector3<f64>| a + (b - a) * f;
        Some((
            between(&earlier.position_ned, &later.position_ned),
            between(&earlier.velocity_ned, &later.velocity_ned),
        ))
    }

    /// The estimate was corrected at `now`: the remembered past is moved likewise, as the free motion p − v·(now − t), so that the next
    /// late measurement is not charged for the same error again.
    pub(super) fn correct(
        &mut self,
        now: AutopilotTime,
        position_ned: &Vector3<f64>,
        velocity_ned: &Vector3<f64>,
    ) {
        for past in self.past.iter_mut() {
            let age = now.seconds_since(past.time);
            if age > CORRECTED_S {
                return;
            }
            past.position_ned += position_ned - velocity_ned * age;
            past.velocity_ned += velocity_ned;
        }
    }

    /// The acceleration at `time` (the nearest remembered one), NED, m/s².
    pub(super) fn acceleration(&self, time: AutopilotTime) -> Option<Vector3<f64>> {
        Some(self.nearest(time)?.acceleration_ned)
    }

    /// The attitude at `time` (the nearest remembered one); `None` beyond what is remembered.
    pub(super) fn attitude(&self, time: AutopilotTime) -> Option<Matrix3<f64>> {
        Some(self.nearest(time)?.r_body_to_ned)
    }

    fn nearest(&self, time: AutopilotTime) -> Option<&Remembered> {
        let (earlier, later, _) = self.past.around(time)?;
        Some(if (time - earlier.time) < (later.time - time) { earlier } else { later })
    }

    /// The mean angular rate of the body between two times, rad/s; `None` beyond what is remembered.
    pub(super) fn mean_rate(&self, from: AutopilotTime, to: AutopilotTime) -> Option<Vector3<f64>> {
        let dt = to.seconds_since(from);
        if dt <= 0.0 {
            let (earlier, later, _) = self.past.around(to)?;
            let step = later.time.seconds_since(earlier.time);
            return (step > 0.0).then(|| (later.turned_body - earlier.turned_body) / step);
        }
        Some((self.turned(to)? - self.turned(from)?) / dt)
    }

    fn turned(&self, time: AutopilotTime) -> Option<Vector3<f64>> {
        let (earlier, later, f) = self.past.around(time)?;
        Some(earlier.turned_body + (later.turned_body - earlier.turned_body) * f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::so3;

    #[test]
    fn rates_and_attitudes_of_the_past_come_back() {
        let mut h = Timeline::new(64);
        for k in 0..200i64 {
            let t = k as f64 * 0.01;
            let r = so3::exp(&Vector3::new(0.0, 0.0, t));
            let instant = MotionNow {
                r_body_to_ned: r,
                turned: Vector3::new(0.0, 0.0, 0.01 * if k < 180 { 1.0 } else { 2.0 }),
                acceleration_ned: Vector3::new(t, 0.0, 0.0),
                sideways_ned: Vector3::new(0.0, 0.5, 0.0),
                position_ned: Vector3::new(0.0, t, 0.0),
                velocity_ned: Vector3::new(0.0, 1.0, 0.0),
            };
            h.push(AutopilotTime::from_micros(k * 10_000), &instant);
        }
        let at = |ms: i64| AutopilotTime::from_micros(ms * 1000);
        assert!((h.mean_rate(at(1700), at(1780)).unwrap().z - 1.0).abs() < 1e-9);
        assert!((h.mean_rate(at(1755), at(1835)).unwrap().z - 1.5625).abs() < 1e-9);
        assert!((h.mean_rate(at(1985), at(1985)).unwrap().z - 2.0).abs() < 1e-9);
        let r = h.attitude(at(1803)).unwrap();
        assert!((so3::log(&r).z - 1.80).abs() < 1e-9);
        assert!((h.acceleration(at(1803)).unwrap().x - 1.80).abs() < 1e-9);
        let sideways = h.sideways(at(1985)).unwrap() - h.sideways(at(1785)).unwrap();
        assert!((sideways - Vector3::new(0.0, 0.1, 0.0)).norm() < 1e-9);
        assert!((h.motion(at(1803)).unwrap().0.y - 1.803).abs() < 1e-9);
        h.correct(at(1990), &Vector3::new(1.0, 0.0, 0.0), &Vector3::new(2.0, 0.0, 0.0));
        let (p, v) = h.motion(at(1790)).unwrap();
        assert!((p.x - 0.6).abs() < 1e-9 && (v.x - 2.0).abs() < 1e-9);
        assert!(h.attitude(at(1000)).is_none(), "forgotten");
        assert!(h.attitude(at(1991)).is_none(), "future");
    }
}
