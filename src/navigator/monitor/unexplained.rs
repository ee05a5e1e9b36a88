//! A receiver that comes back elsewhere than the vehicle can have gone.
//!
//! A fix d from the dead reckoning whose sigma is σ is explained by its drift as far as 2σ; nobody knows of the rest, r² = d² − (2σ)², whether the
//! receiver was wrong before or is now. Where it was seen to jump, by j, drift explains nothing as long as it is nearer to where it jumped to than to
//! where it was, and r is no less than j. It is followed, for it may be right, and r stays in what is claimed of the position: until it jumps back by
//! the same, and forgotten as errors of receivers are, over minutes.
//!
//! Where the receiver's velocity and inertia part, and it is not the receiver's that was seen to step, one of the two is wrong and nobody knows which: while that
//! is so the estimate, which goes on with one of them, may be off by all that they are apart.

use nalgebra::Vector2;

use crate::navigator::tuning::unexplained::{EXPLAINED_SIGMAS, FORGOTTEN_S, PARTS_FOR_S};
use crate::time::AutopilotTime;

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct Unexplained {
    /// When the receiver came back, and what was not explained then, NE, m.
    returned: Option<(AutopilotTime, Vector2<f64>)>,
    /// How far it was seen to jump since then, m.
    jumped_m: Option<f64>,
    /// When its positions were furthest from where its velocities lead, as far as that is not forgotten, and by how much, NE, m.
    wandered: Option<(AutopilotTime, Vector2<f64>)>,
    /// How far it had led at most, NE, m, if what was suspected of it was a lie, and when; and how far it has by what is suspected now.
    led: Option<(AutopilotTime, Vector2<f64>)>,
    suspected: Option<(AutopilotTime, Vector2<f64>)>,
    disputed: Option<Parting>,
}

/// A receiver and inertia that have parted: when that was seen last, by how much, NE, m, and how fast they part, m/s.
#[derive(Clone, Copy, Debug)]
struct Parting {
    seen: AutopilotTime,
    apart_ne: Vector2<f64>,
    velocity_mps: f64,
}

impl Unexplained {
    /// A fix that inertia does not follow lies so far from where it should.
    pub(in super::super) fn jumped(&mut self, apart_m: f64) {
        self.jumped_m = self.jumped_m.or(Some(apart_m).filter(|m| m.is_finite()));
    }

    /// The receiver is believed again, `apart_ne` m from a dead reckoning that claimed `sigma_m`.
    pub(in super::super) fn came_back(&mut self, now: AutopilotTime, apart_ne: &Vector2<f64>, sigma_m: f64) {
        self.settled();
        let apart_m = apart_ne.norm();
        let drifted = beyond(apart_m, EXPLAINED_SIGMAS * sigma_m);
        let jumped = self.jumped_m.take().filter(|jump| apart_m > 0.5 * jump);
        let rest_m = jumped.map_or(drifted, |jump| drifted.max(jump.min(apart_m)));
        if rest_m.is_finite() && rest_m > 0.0 {
            self.returned = Some((now, left(self.returned, now) + apart_ne * (rest_m / apart_m)));
        }
    }

    /// A receiver that is navigated on is `wander_m` m from where its own velocities lead, towards `towards_ne`, and claims `sigma_m`. One of the two is wrong, and the
    /// estimate follows the positions: what the claim does not explain may be its error.
    pub(in super::super) fn wanders(
        &mut self,
        now: AutopilotTime,
        towards_ne: &Vector2<f64>,
        wander_m: f64,
        sigma_m: f64,
    ) {
        further(&mut self.wandered, now, &(towards_ne.normalize() * wander_m), sigma_m);
    }

    /// A receiver that is navigated on may have led by `led_ne` m, and claims `sigma_m`, by what is known of a suspicion now, whatever was feared before; zero where there is
    /// none: what the last one has come to stays.
    pub(in super::super) fn suspected(&mut self, now: AutopilotTime, led_ne: &Vector2<f64>, sigma_m: f64) {
        let led_m = led_ne.norm();
        if led_m > 0.0 {
            let rest_m = Some(beyond(led_m, sigma_m)).filter(|m| m.is_finite());
            self.suspected = rest_m.map(|rest_m| (now, led_ne * (rest_m / led_m)));
        } else if let Some((then, rest_ne)) = self.suspected.take() {
            further(&mut self.led, then, &rest_ne, 0.0);
        }
    }

    /// What is suspected of it was no lie.
    pub(in super::super) fn cleared(&mut self) {
        self.suspected = None;
    }

    /// What it had wandered was taken back.
    pub(in super::super) fn undone(&mut self) {
        (self.wandered, self.led, self.suspected) = (None, None, None);
    }

    /// What it had wandered was taken back, `by_ne` m, and how far that was is known to `spread_m` m.
    pub(in super::super) fn taken_back(&mut self, now: AutopilotTime, by_ne: &Vector2<f64>, spread_m: f64) {
        let known = spread_m.is_finite() && by_ne.norm() > 0.0;
        self.wandered = known.then(|| (now, by_ne.normalize() * spread_m));
        (self.led, self.suspected) = (None, None);
    }

    /// A fix that inertia parts from is `apart_ne` m from the estimate, and its velocity `velocity_mps` m/s.
    pub(in super::super) fn dispute(
        &mut self,
        seen: AutopilotTime,
        apart_ne: &Vector2<f64>,
        velocity_mps: f64,
    ) {
        if apart_ne.norm().is_finite() && velocity_mps.is_finite() {
            self.disputed = Some(Parting { seen, apart_ne: *apart_ne, velocity_mps });
        }
    }

    /// Whether a dispute goes on.
    pub(in super::super) fn is_disputed(&self) -> bool {
        self.disputed.is_some()
    }

    /// Somebody was found wrong, or they agree again.
    pub(in super::super) fn settled(&mut self) {
        self.disputed = None;
    }

    /// Variances of a component of the horizontal position and velocity by what is in dispute, m² and (m/s)²: it goes on for as long as a fix may be missing,
    /// and is forgotten as the rest is when none comes.
    pub(in super::super) fn disputed(&self, now: Option<AutopilotTime>) -> [f64; 2] {
        let Some((d, now)) = self.disputed.zip(now) else { return [0.0; 2] };
        let parting_m = d.velocity_mps * now.seconds_since(d.seen).clamp(0.0, PARTS_FOR_S);
        let kept = left(Some((d.seen, d.apart_ne)), now).norm();
        [0.5 * (kept + parting_m).powi(2), 0.5 * d.velocity_mps.powi(2)]
    }

    /// Variance of a component of the horizontal position, m².
    pub(in super::super) fn variance(&self, now: Option<AutopilotTime>) -> f64 {
        let square = |rest, now| left(rest, now).norm_squared();
        let led = |now| {
            [self.wandered, self.led, self.suspected]
                .into_iter()
                .map(|rest| square(rest, now))
                .fold(0.0, f64::max)
        };
        now.map_or(0.0, |now| 0.5 * (square(self.returned, now) + led(now)))
    }
}

/// Whoever is `by_ne` m off by now, and claims `sigma_m`, has gone further than before?
fn further(
    then: &mut Option<(AutopilotTime, Vector2<f64>)>,
    now: AutopilotTime,
    by_ne: &Vector2<f64>,
    sigma_m: f64,
) {
    let by_m = by_ne.norm();
    let rest_m = beyond(by_m, sigma_m);
    if rest_m.is_finite() && rest_m > left(*then, now).norm() {
        *then = Some((now, by_ne * (rest_m / by_m)));
    }
}

/// What of a deviation another does not explain, m.
fn beyond(apart_m: f64, explained_m: f64) -> f64 {
    (apart_m.powi(2) - explained_m.powi(2)).max(0.0).sqrt()
}

/// What is left of something that was not explained then, NE, m.
fn left(then: Option<(AutopilotTime, Vector2<f64>)>, now: AutopilotTime) -> Vector2<f64> {
    then.map_or(Vector2::zeros(), |(then, rest_ne)| {
        rest_ne * (-now.seconds_since(then).max(0.0) / FORGOTTEN_S).exp()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(s: f64) -> AutopilotTime {
        AutopilotTime::from_micros((s * 1e6) as i64)
    }

    fn sigma(u: &Unexplained, s: f64) -> f64 {
        (2.0 * u.variance(Some(at(s)))).sqrt()
    }

    #[test]
    fn what_drift_explains_leaves_nothing_and_the_rest_is_forgotten_over_minutes() {
        let mut u = Unexplained::default();
        let apart = Vector2::new(60.0, -80.0);
        u.came_back(at(10.0), &apart, 60.0);
        assert_eq!(sigma(&u, 10.0), 0.0);
        u.came_back(at(10.0), &apart, 30.0);
        assert!((sigma(&u, 10.0) - 80.0).abs() < 1e-9);
        assert!(sigma(&u, 70.0) > 60.0 && sigma(&u, 1800.0) < 1.0);
        u.came_back(at(1800.0), &Vector2::repeat(f64::NAN), 1.0);
        assert!(sigma(&u, 1800.0) < 1.0);
    }

    #[test]
    fn a_jump_is_no_drift_and_a_jump_back_takes_it_away() {
        let jump = Vector2::new(3.0, 4.0);
        let mut u = Unexplained::default();
        u.jumped(5.0);
        u.jumped(50.0);
        u.came_back(at(1.0), &(jump * 1.1), 4.0);
        assert!((sigma(&u, 1.0) - 5.0).abs() < 1e-9, "{}", sigma(&u, 1.0));
        u.jumped(5.0);
        u.came_back(at(20.0), &-jump, 4.0);
        assert!(sigma(&u, 20.0) < 0.5, "{}", sigma(&u, 20.0));
        // It has jumped, and come back to where it was before it is believed again.
        u.jumped(20.0);
        u.came_back(at(30.0), &Vector2::new(2.0, 0.0), 4.0);
        assert!(sigma(&u, 30.0) < 0.5);
    }

    #[test]
    fn who_wanders_is_doubted_as_far_as_he_has_gone_at_most_until_it_is_taken_back() {
        let mut u = Unexplained::default();
        let gone = Vector2::new(3.0, -4.0);
        u.wanders(at(0.0), &gone, 5.0, 5.0);
        assert_eq!(sigma(&u, 0.0), 0.0, "it claims no more");
        u.wanders(at(1.0), &gone, 5.0, 3.0);
        assert!((sigma(&u, 1.0) - 4.0).abs() < 1e-9);
        u.wanders(at(2.0), &gone, 2.5, 0.0);
        u.wanders(at(3.0), &gone, f64::NAN, 0.0);
        assert!((3.9..4.0).contains(&sigma(&u, 3.0)), "what was less or is no number changes nothing");
        u.undone();
        assert_eq!(sigma(&u, 3.0), 0.0);
    }

    #[test]
    fn a_suspicion_is_worth_what_is_known_of_it_now_and_leaves_that_or_nothing() {
        let mut u = Unexplained::default();
        let led = Vector2::new(6.0, -8.0);
        u.suspected(at(0.0), &led, 0.0);
        assert!((sigma(&u, 0.0) - 10.0).abs() < 1e-9);
        // It has become less likely.
        u.suspected(at(1.0), &(led * 0.3), 0.0);
        assert!((sigma(&u, 1.0) - 3.0).abs() < 1e-9);
        // It ends, and nobody knows whether it was true.
        u.suspected(at(2.0), &Vector2::zeros(), 0.0);
        assert!((2.9..3.0).contains(&sigma(&u, 2.0)), "{}", sigma(&u, 2.0));
        // Another one, that was none.
        u.suspected(at(3.0), &(led * 2.0), 0.0);
        u.cleared();
        u.suspected(at(4.0), &Vector2::zeros(), 0.0);
        assert!((2.9..3.0).contains(&sigma(&u, 4.0)), "{}", sigma(&u, 4.0));
        u.suspected(at(5.0), &Vector2::repeat(f64::NAN), 0.0);
        assert!(sigma(&u, 5.0).is_finite());
    }

    #[test]
    fn what_was_taken_back_is_known_as_well_as_the_walk_was() {
        let mut u = Unexplained::default();
        let gone = Vector2::new(3.0, -4.0);
        u.wanders(at(0.0), &gone, 5.0, 1.0);
        u.taken_back(at(0.0), &gone, 2.0);
        assert!((sigma(&u, 0.0) - 2.0).abs() < 1e-9);
        u.taken_back(at(0.0), &Vector2::zeros(), f64::NAN);
        assert_eq!(sigma(&u, 0.0), 0.0);
    }

    #[test]
    fn while_two_are_in_dispute_the_position_may_be_with_either_and_they_go_on_parting() {
        let mut u = Unexplained::default();
        let sigmas = |u: &Unexplained, s: f64| u.disputed(Some(at(s))).map(|square| (2.0 * square).sqrt());
        assert_eq!(sigmas(&u, 0.0), [0.0; 2]);
        u.dispute(at(1.0), &Vector2::new(6.0, 8.0), 5.0);
        assert!((sigmas(&u, 1.0)[0] - 10.0).abs() < 1e-9 && (sigmas(&u, 1.0)[1] - 5.0).abs() < 1e-9);
        assert!((sigmas(&u, 1.4)[0] - 12.0).abs() < 0.05, "{:?}", sigmas(&u, 1.4));
        let silent = sigmas(&u, 30.0)[0];
        assert!((15.0..17.5).contains(&silent), "no fix comes any more: {silent}");
        u.dispute(at(2.0), &Vector2::repeat(f64::NAN), f64::NAN);
        assert!(sigmas(&u, 2.0)[0].is_finite());
        u.settled();
        assert_eq!(sigmas(&u, 2.0), [0.0; 2]);
        u.dispute(at(3.0), &Vector2::new(6.0, 8.0), 5.0);
        u.came_back(at(4.0), &Vector2::new(6.0, 8.0), 9.0);
        assert_eq!(sigmas(&u, 4.0), [0.0; 2]);
    }
}
