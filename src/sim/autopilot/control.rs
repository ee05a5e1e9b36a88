//! Position and velocity control of a quadrotor, on what its own filter believes.

use nalgebra::{Matrix3, Vector3};

use super::own_filter::OwnFilter;
use super::quadrotor::MotorCommand;
use crate::geo::so3;

/// What the vehicle shall do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ControlTarget {
    /// Motors off.
    Stopped,
    /// Be at a place in NED of the double's origin (m), nose at a heading (rad).
    Place {
        /// Where.
        position: Vector3<f64>,
        /// Heading, rad.
        heading_rad: f64,
    },
    /// Come down over a place, or level wherever the wind takes it when there is no position.
    Descend {
        /// Over where.
        over: Option<Vector3<f64>>,
        /// Heading, rad.
        heading_rad: f64,
    },
}

/// Position error to velocity, 1/s; velocity error to acceleration, 1/s; its integral, 1/s².
const POSITION_GAIN: f64 = 0.8;
const VELOCITY_GAIN: f64 = 2.0;
const INTEGRAL_GAIN: f64 = 0.4;
/// Fastest horizontal and vertical motion, m/s.
const CRUISE_MPS: f64 = 4.0;
const CLIMB_MPS: f64 = 2.0;
/// Speed of a landing, m/s, and near the ground, m/s and m.
const LANDING_MPS: f64 = 1.2;
const TOUCHING_MPS: f64 = 0.5;
const TOUCHING_M: f64 = 3.0;
/// Largest horizontal acceleration that is asked for, and most of it by the integral, m/s².
const MOST_ACCELERATION: f64 = 4.0;
const MOST_INTEGRAL: f64 = 3.0;
/// Largest change of the heading that is asked for at once, rad.
const MOST_TURN: f64 = 0.3;

/// The controllers' state.
#[derive(Clone, Copy, Debug)]
pub struct PositionControl {
    /// What the integral adds to the acceleration, NED, m/s².
    integral: Vector3<f64>,
}

impl PositionControl {
    /// Controllers that have done nothing yet.
    pub fn new() -> Self {
        Self { integral: Vector3::zeros() }
    }

    /// What the motors shall do for the next `dt_s`.
    pub fn command(
        &mut self,
        dt_s: f64,
        target: &ControlTarget,
        filter: &OwnFilter,
        gravity: f64,
    ) -> MotorCommand {
        let (velocity, heading_rad) = match *target {
            ControlTarget::Stopped => {
                self.integral = Vector3::zeros();
                return MotorCommand::STOPPED;
            }
            ControlTarget::Place { position, heading_rad } => {
                (Some(approach(position - filter.position())), heading_rad)
            }
            ControlTarget::Descend { over, heading_rad } => {
                let near = -filter.position().z < TOUCHING_M;
                let down = if near { TOUCHING_MPS } else { LANDING_MPS };
                let to = over.map(|place| approach(place - filter.position()));
                (to.map(|v| Vector3::new(v.x, v.y, down)), heading_rad)
            }
        };
        let acceleration = match velocity {
            Some(velocity) => self.towards(dt_s, &(velocity - filter.velocity())),
            None => self.level(dt_s, LANDING_MPS - filter.velocity().z),
        };
        attain(filter.r_body_to_ned(), &acceleration, heading_rad, gravity)
    }

    fn towards(&mut self, dt_s: f64, velocity_error: &Vector3<f64>) -> Vector3<f64> {
        self.integral += velocity_error * (INTEGRAL_GAIN * dt_s);
        self.integral = limited(&self.integral, MOST_INTEGRAL, MOST_INTEGRAL);
        limited(&(velocity_error * VELOCITY_GAIN + self.integral), MOST_ACCELERATION, MOST_ACCELERATION)
    }

    /// Level: nothing is known of where the vehicle goes.
    fn level(&mut self, dt_s: f64, climb_error: f64) -> Vector3<f64> {
        self.integral.x = 0.0;
        self.integral.y = 0.0;
        self.towards(dt_s, &Vector3::new(0.0, 0.0, climb_error))
    }
}

impl Default for PositionControl {
    fn default() -> Self {
        Self::new()
    }
}

/// Velocity towards a place that is so far away.
fn approach(way: Vector3<f64>) -> Vector3<f64> {
    limited(&(way * POSITION_GAIN), CRUISE_MPS, CLIMB_MPS)
}

/// At most so long in the plane, and so long in the vertical.
fn limited(v: &Vector3<f64>, horizontal: f64, vertical: f64) -> Vector3<f64> {
    let length = v.xy().norm();
    let part = if length > horizontal { horizontal / length } else { 1.0 };
    Vector3::new(v.x * part, v.y * part, v.z.clamp(-vertical, vertical))
}

/// Thrust and turn that give an acceleration (NED): thrust along −z, the nose at the heading, on the attitude that is believed.
fn attain(
    believed: &Matrix3<f64>,
    acceleration: &Vector3<f64>,
    heading_rad: f64,
    gravity: f64,
) -> MotorCommand {
    let thrust = Vector3::new(0.0, 0.0, gravity) - acceleration;
    let z = thrust.normalize();
    let yaw = so3::Euler::from_rotation(believed).yaw_rad;
    let turn = so3::wrap_pi(heading_rad - yaw).clamp(-MOST_TURN, MOST_TURN);
    let (s, c) = (yaw + turn).sin_cos();
    let y = z.cross(&Vector3::new(c, s, 0.0)).normalize();
    let wanted = Matrix3::from_columns(&[y.cross(&z), y, z]);
    MotorCommand { turn_body: so3::log(&(believed.transpose() * wanted)), thrust_mps2: thrust.norm() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::autopilot::quadrotor::{Quadrotor, QuadrotorModel};
    use crate::sim::world::Environment;

    /// Flies on an estimate that is the truth but for an offset that is told to the filter.
    #[test]
    fn what_is_believed_is_where_the_vehicle_goes() {
        let world = Environment::trondheim();
        let mut quad = Quadrotor::standing(QuadrotorModel::small(), 0.0);
        let mut filter = OwnFilter::at_rest(quad.truth().r_body_to_ned, 2);
        let mut control = PositionControl::new();
        let target = ControlTarget::Place { position: Vector3::new(20.0, -10.0, -8.0), heading_rad: 1.0 };
        let wind = Vector3::new(3.0, 4.0, 0.0);
        let offset = Vector3::new(2.0, 0.0, 0.0);
        for k in 1..=10_000 {
            let command = control.command(0.004, &target, &filter, world.gravity_mps2);
            let truth = quad.step(0.004, &command, &world, &wind);
            let now = 0.004 * f64::from(k);
            filter.predict(
                now,
                0.004,
                &world.specific_force(&truth),
                &truth.r_body_to_ned,
                world.gravity_mps2,
            );
            filter.heading_by_compass(0.004);
            let told = |what, value_ned| crate::sim::autopilot::own_filter::AxisMeasurement {
                what,
                value_ned,
                variance: Vector3::repeat(0.01),
                time_s: now,
            };
            use crate::sim::autopilot::axis::AxisQuantity::{Position, Velocity};
            filter.fuse(&told(Position, truth.position_ned + offset), &[0, 1, 2]);
            filter.fuse(&told(Velocity, truth.velocity_ned), &[0, 1, 2]);
        }
        let there = quad.truth().position_ned - Vector3::new(18.0, -10.0, -8.0);
        assert!(there.norm() < 0.2, "{there}");
        let yaw = so3::Euler::from_rotation(&quad.truth().r_body_to_ned).yaw_rad;
        assert!((yaw - 1.0).abs() < 0.05, "{yaw}");
    }
}
