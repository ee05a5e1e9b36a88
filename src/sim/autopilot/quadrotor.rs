//! A quadrotor that flies by its motors: thrust along −z, the drag of its rotors in the wind, a second-order attitude loop, and the
//! ground it stands on.

use nalgebra::{Matrix3, Vector3};

use crate::geo::so3;
use crate::sim::trajectory::Truth;
use crate::sim::world::Environment;

/// What a quadrotor is like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuadrotorModel {
    /// Deceleration of the rotors' drag over the velocity through the air, across the thrust, 1/s.
    pub drag_per_s: f64,
    /// Natural frequency of the attitude loop, rad/s …
    pub attitude_rad_s: f64,
    /// … and its damping.
    pub attitude_damping: f64,
    /// Time constant of the motors, s.
    pub motor_s: f64,
    /// Largest specific thrust, m/s².
    pub most_thrust_mps2: f64,
}

impl QuadrotorModel {
    /// A quadrotor of one or two kilograms.
    pub fn small() -> Self {
        Self {
            drag_per_s: 0.3,
            attitude_rad_s: 9.0,
            attitude_damping: 0.8,
            motor_s: 0.04,
            most_thrust_mps2: 20.0,
        }
    }
}

/// What the controller wants of the motors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorCommand {
    /// Rotation from the attitude that the vehicle has to the one that it shall have, body axes, rad.
    pub turn_body: Vector3<f64>,
    /// Specific thrust, m/s²; 0 stops the motors.
    pub thrust_mps2: f64,
}

impl MotorCommand {
    /// Motors that stand still.
    pub const STOPPED: Self = Self { turn_body: Vector3::new(0.0, 0.0, 0.0), thrust_mps2: 0.0 };
}

/// A quadrotor in the air or on the ground.
#[derive(Clone, Debug)]
pub struct Quadrotor {
    model: QuadrotorModel,
    truth: Truth,
    thrust_mps2: f64,
    /// p_D of the vehicle when it stands, m.
    ground_down_m: f64,
}

impl Quadrotor {
    /// Standing where it is, level, its nose at this heading.
    pub fn standing(model: QuadrotorModel, heading_rad: f64) -> Self {
        let truth = Truth {
            t_s: 0.0,
            position_ned: Vector3::zeros(),
            velocity_ned: Vector3::zeros(),
            acceleration_ned: Vector3::zeros(),
            r_body_to_ned: so3::exp(&Vector3::new(0.0, 0.0, heading_rad)),
            body_rate: Vector3::zeros(),
        };
        Self { model, truth, thrust_mps2: 0.0, ground_down_m: 0.0 }
    }

    /// The state now.
    pub fn truth(&self) -> &Truth {
        &self.truth
    }

    /// Whether it stands on the ground.
    pub fn stands(&self) -> bool {
        self.truth.position_ned.z >= self.ground_down_m - 1e-6 && self.truth.velocity_ned.norm() < 1e-6
    }

    /// Moves on by `dt_s` in a wind (NED, m/s). The acceleration is linear over the step, and velocity and position are its exact
    /// integrals, so that what an ideal IMU measures between two steps gives the motion back.
    pub fn step(
        &mut self,
        dt_s: f64,
        command: &MotorCommand,
        world: &Environment,
        wind_ned: &Vector3<f64>,
    ) -> Truth {
        let before = self.truth;
        let wanted = command.thrust_mps2.clamp(0.0, self.model.most_thrust_mps2);
        self.thrust_mps2 += (wanted - self.thrust_mps2) * (dt_s / self.model.motor_s).min(1.0);
        let t_s = before.t_s + dt_s;
        if self.stands() && self.thrust_mps2 <= world.gravity_mps2 {
            let yaw = so3::Euler::from_rotation(&before.r_body_to_ned).yaw_rad;
            let r_body_to_ned = so3::exp(&Vector3::new(0.0, 0.0, yaw));
            let still = Vector3::zeros();
            self.truth = Truth {
                t_s,
                velocity_ned: still,
                acceleration_ned: still,
                body_rate: still,
                r_body_to_ned,
                ..before
            };
            return self.truth;
        }
        let (wn, damping) = (self.model.attitude_rad_s, self.model.attitude_damping);
        let turning = command.turn_body * wn.powi(2) - before.body_rate * (2.0 * damping * wn);
        let body_rate = before.body_rate + turning * dt_s;
        let r_body_to_ned = before.r_body_to_ned * so3::exp(&((before.body_rate + body_rate) * (0.5 * dt_s)));
        let acceleration_ned = self.acceleration(&r_body_to_ned, &before.velocity_ned, world, wind_ned);
        let (a, change) = (before.acceleration_ned, acceleration_ned - before.acceleration_ned);
        let velocity_ned = before.velocity_ned + (a + change * 0.5) * dt_s;
        let position_ned =
            before.position_ned + before.velocity_ned * dt_s + (a * 0.5 + change / 6.0) * dt_s.powi(2);
        self.truth = Truth { t_s, position_ned, velocity_ned, acceleration_ned, r_body_to_ned, body_rate };
        if self.truth.position_ned.z > self.ground_down_m {
            self.touch_down();
        }
        self.truth
    }

    fn acceleration(
        &self,
        r_body_to_ned: &Matrix3<f64>,
        velocity_ned: &Vector3<f64>,
        world: &Environment,
        wind_ned: &Vector3<f64>,
    ) -> Vector3<f64> {
        let air_body = r_body_to_ned.tr_mul(&(velocity_ned - wind_ned));
        // Rotor drag lies in the plane of the rotors.
        let drag = Vector3::new(air_body.x, air_body.y, 0.0) * -self.model.drag_per_s;
        world.gravity_ned() + r_body_to_ned * (drag - Vector3::new(0.0, 0.0, self.thrust_mps2))
    }

    fn touch_down(&mut self) {
        self.truth.position_ned.z = self.ground_down_m;
        self.truth.velocity_ned = Vector3::zeros();
        self.truth.acceleration_ned = Vector3::zeros();
        self.truth.body_rate = Vector3::zeros();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hover_needs_gravity_and_a_tilted_one_flies_off_until_drag_holds_it() {
        let world = Environment::trondheim();
        let mut quad = Quadrotor::standing(QuadrotorModel::small(), 0.0);
        assert!(quad.stands());
        let calm = Vector3::zeros();
        let up = MotorCommand { turn_body: Vector3::zeros(), thrust_mps2: world.gravity_mps2 + 1.0 };
        for _ in 0..500 {
            quad.step(0.004, &up, &world, &calm);
        }
        assert!(
            !quad.stands() && (quad.truth().velocity_ned.z + 2.0).abs() < 0.2,
            "{}",
            quad.truth().velocity_ned
        );
        // Nose down by 5°: g·tan(5°) = drag · v, so 2.9 m/s north in the end (and a little less by the climb).
        let pitch = -5f64.to_radians();
        for _ in 0..6000 {
            let truth = quad.truth();
            let wanted = so3::exp(&Vector3::new(0.0, pitch, 0.0));
            let command = MotorCommand {
                turn_body: so3::log(&(truth.r_body_to_ned.transpose() * wanted)),
                thrust_mps2: world.gravity_mps2 / pitch.cos(),
            };
            quad.step(0.004, &command, &world, &calm);
        }
        let v = quad.truth().velocity_ned;
        assert!((v.x - world.gravity_mps2 * 5f64.to_radians().tan() / 0.3).abs() < 0.3, "{v}");
    }

    #[test]
    fn the_ground_holds_it() {
        let world = Environment::trondheim();
        let mut quad = Quadrotor::standing(QuadrotorModel::small(), 1.0);
        let gale = Vector3::new(10.0, 0.0, 0.0);
        for _ in 0..500 {
            quad.step(0.004, &MotorCommand::STOPPED, &world, &gale);
        }
        assert_eq!(quad.truth().position_ned, Vector3::zeros());
        assert!((world.specific_force(quad.truth()).z + world.gravity_mps2).abs() < 1e-9);
    }
}
