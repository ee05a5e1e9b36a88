//! How far inertia and a receiver's velocity can be believed beside each other: from how the velocities move against what the accelerometers add up to.
//!
//! Over a lag τ GNSS tells Δv_G and the accelerometers, turned to NED, Δv_I. Their difference has the receiver's noise, whatever τ is, and what vibration,
//! aliasing, tilt and scale make of the inertial velocity, which grows with τ: see [`NoiseAndWalk`]. A heading that is off turns Δv_I by an angle, which is
//! no noise of either: the angle that fits best is taken out first.

use nalgebra::{Rotation2, Vector2};

use crate::filter::{LAGS, Lags, NoiseAndWalk};
use crate::time::AutopilotTime;

use crate::navigator::tuning::inertial_noise::{
    LAGS_S, MEMORY_S, MOST_ACCEL, MOST_MPS, RECEIVER_MPS, UNTURNED,
};

/// A velocity of a fix, NE, m/s, and what inertia has added up to then.
type Pair = (Vector2<f64>, Vector2<f64>);

/// See the module's documentation.
#[derive(Clone, Copy, Debug)]
pub(super) struct InertialNoise {
    velocities: Lags<Pair>,
    velocity: NoiseAndWalk,
    /// Mean of conj(Δv_I) Δv_G at the long lag, (m/s)²: its argument is the angle that fits best.
    turned: Vector2<f64>,
    last: Option<AutopilotTime>,
    /// Inertia's sum begins anew with each.
    epoch: u32,
}

impl InertialNoise {
    /// Accelerometers as configured, m/s²/√Hz.
    pub(super) fn new(accel: f64) -> Self {
        let velocity = NoiseAndWalk::expecting(RECEIVER_MPS * RECEIVER_MPS, accel * accel, MEMORY_S);
        Self {
            velocities: Lags::new(LAGS_S),
            velocity: velocity.beyond_chance(2.0),
            turned: Vector2::zeros(),
            last: None,
            epoch: 0,
        }
    }

    /// The velocity of a fix that is navigated on, NE, m/s, and what inertia has added up to at its time, of which epoch.
    pub(super) fn observe(
        &mut self,
        time: AutopilotTime,
        velocity_ne: &Vector2<f64>,
        impulse: Option<(Vector2<f64>, u32)>,
    ) {
        let dt = self.last.replace(time).map_or(0.0, |t| time.seconds_since(t));
        let Some((impulse_ne, epoch)) = impulse else { return self.velocities.forget() };
        if epoch != self.epoch {
            self.epoch = epoch;
            self.velocities.forget();
        }
        let pair = (*velocity_ne, impulse_ne);
        for (at, earlier) in self.velocities.observe(time, pair).into_iter().enumerate() {
            if let Some((lag_s, (velocity, impulse))) = earlier {
                let (seen, felt) = (velocity_ne - velocity, impulse_ne - impulse);
                if at == LAGS - 1 {
                    let product = Vector2::new(felt.dot(&seen), felt.perp(&seen));
                    self.turned += (product - self.turned) * (dt / MEMORY_S).min(1.0);
                }
                let angle = self.turned.y.atan2(self.turned.x.max(0.0) + UNTURNED);
                let apart = seen - Rotation2::new(angle) * felt;
                self.velocity.learn(at, dt, lag_s, 0.5 * apart.norm_squared());
            }
        }
    }

    /// Noise density of the accelerometers as it is seen in the velocity, m/s²/√Hz.
    pub(super) fn density(&self) -> f64 {
        self.velocity.parts().1.sqrt().min(MOST_ACCEL)
    }

    /// What of it does not grow with time, m/s, 1 sigma: the receiver's own noise, and what an IMU that is sampled misses between two fixes.
    pub(super) fn between_fixes_mps(&self) -> f64 {
        self.velocity.parts().0.max(0.0).sqrt().min(MOST_MPS)
    }

    /// Another receiver, or another time: what was before is not compared with what comes.
    pub(super) fn interrupt(&mut self) {
        self.velocities.forget();
        self.last = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// Two minutes of figures of eight at 5 Hz: velocities with this noise, felt through accelerometers of this density at a heading that is off.
    fn flown(sigma: f64, density: f64, heading: f64) -> InertialNoise {
        let mut noise = InertialNoise::new(0.03);
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut walked = Vector2::zeros();
        for k in 0..600_i64 {
            let t = k as f64 * 0.2;
            let v = Vector2::new((0.5 * t).sin(), (0.9 * t).cos()) * 4.0;
            walked += Vector2::new(normal(), normal()) * (density * 0.2_f64.sqrt());
            let seen = v + Vector2::new(normal(), normal()) * sigma;
            let felt = Rotation2::new(-heading) * v + walked;
            noise.observe(AutopilotTime::from_micros(k * 200_000), &seen, Some((felt, 1)));
        }
        noise
    }

    #[test]
    fn accelerometers_are_told_apart_from_the_receiver_and_a_wrong_heading_is_neither() {
        for heading in [0.0, 0.4] {
            for (sigma, density) in [(0.3, 0.05), (0.05, 0.4), (0.1, 1.5)] {
                let noise = flown(sigma, density, heading);
                let (found, between) = (noise.density(), noise.between_fixes_mps());
                assert!(
                    (found - density).abs() < 0.4 * density + 0.3 * sigma,
                    "{sigma} {density} {heading}: {found}"
                );
                assert!(
                    (between - sigma).abs() < 0.3 * sigma + 0.2 * density,
                    "{sigma} {density} {heading}: {between}"
                );
            }
        }
    }

    #[test]
    fn nothing_is_made_of_chance_and_no_accelerometer_is_worse_than_the_bound() {
        assert!(flown(0.0, 0.0, 0.0).density() < 0.01);
        assert!(
            flown(0.1, 50.0, 0.0).density() <= MOST_ACCEL
                && flown(9.0, 0.1, 0.0).between_fixes_mps() <= MOST_MPS
        );
        assert_eq!(InertialNoise::new(0.03).density(), 0.03);
    }
}
