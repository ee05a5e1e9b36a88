//! What follows when a fault is declared, and when it is over.

use super::fault::{Change, Fault};
use super::fault_tolerant::Altimeter;
use super::glr_bank::{Fit, INERTIAL, Onset};
use super::isolation::{ExplanationScore, explain, score};
use super::joint::{ACCEL_BIAS, CLIMB, Channel, HEIGHT, HeightInnovation, State};
use super::tuning::{AGREE, HEALED};

impl Altimeter {
    /// Follows the noise of a channel whose noise has grown.
    pub(super) fn note_noise(&mut self, channel: Channel, innovation: &HeightInnovation, r: f64) {
        let limit = self.settings.detection.relief;
        let noise = &mut self.channels[channel.index()].noise;
        let predicted = innovation.variance - r * noise.factor();
        if noise.follow(innovation.value * innovation.value, predicted, r, limit) {
            self.bank.clear();
            if !self.health(channel).is_faulty() {
                self.tell(Change::Healed(channel));
            }
        }
    }

    /// Asks the bank what explains the innovations best.
    pub(super) fn look_for_faults(&mut self) {
        let d = &self.settings.detection;
        let mut best: Option<(&Onset, ExplanationScore)> = None;
        for onset in self.bank.iter() {
            let score = score(onset, d);
            if best.is_none_or(|(_, b)| score.most > b.most) {
                best = Some((onset, score));
            }
        }
        let most = best.map_or(0.0, |(_, score)| score.most);
        self.room = d.ratio - most - d.both_cost.max(d.noise_cost);
        let Some((onset, score)) = best else { return };
        let since_s = onset.time_s;
        let lasting = self.clock_s - since_s >= d.lasting_s;
        let found = (lasting && score.jump > d.ratio).then(|| explain(onset, d)).filter(|e| e.ready);
        self.bank.keep(since_s);
        let Some(found) = found else { return };
        for (channel, grown) in Channel::ALL.into_iter().zip(found.grown) {
            if let Some((factor, samples)) = grown {
                let factor = factor * self.channels[channel.index()].noise.factor();
                self.channels[channel.index()].noise.grow(factor, samples, found.since_s);
                if self.channels[channel.index()].biased_since_s.is_some() {
                    // What was taken for a bias a few samples ago may have been noise: it is known by that much less.
                    let r = self.settings.channels[channel.index()].noise_m.powi(2);
                    let f = channel.fault();
                    self.joint.p[(f, f)] += r * factor / f64::from(samples.max(1));
                }
                self.tell(Change::Faulty {
                    channel,
                    fault: Fault::Noise { variance_factor: factor },
                    for_s: self.clock_s - found.since_s,
                });
            }
        }
        if let Some((fit, effects)) = &found.jump {
            self.take_jump(fit, effects, found.since_s);
        }
        self.bank.clear();
    }

    /// Opens the states that jumped from the onset on: x ← x − J f̂, P ← P + J C⁻¹ Jᵀ.
    fn take_jump(&mut self, fit: &Fit, effects: &[State; 2], since_s: f64) {
        let before = self.joint.x[HEIGHT];
        for i in 0..2 {
            self.joint.x -= effects[i] * fit.size[i];
            for j in 0..2 {
                self.joint.p.ger(fit.covariance[i][j], &effects[i], &effects[j], 1.0);
            }
        }
        if fit.jumps[0] == INERTIAL {
            return self.tell(Change::InertialAstray { height_step_m: self.joint.x[HEIGHT] - before });
        }
        let mut declared = [false; 4];
        for (i, s) in fit.jumps.into_iter().enumerate() {
            let Some(channel) = Channel::ALL.get(s).copied() else { continue };
            let state = &mut self.channels[s];
            if state.biased_since_s.is_none() {
                state.biased_since_s = Some(since_s);
                state.offset_before_m =
                    if channel.is_absolute() { 0.0 } else { self.joint.x[channel.fault()] - fit.size[i] };
            }
            declared[s] = true;
        }
        self.heal();
        self.reconcile(since_s);
        for channel in Channel::ALL.into_iter().filter(|c| declared[c.index()]) {
            let state = &self.channels[channel.index()];
            if state.biased_since_s.is_some() {
                let fault = Fault::Bias {
                    size_m: self.joint.x[channel.fault()] - state.offset_before_m,
                    sigma_m: self.joint.sigma(channel.fault()),
                };
                self.tell(Change::Faulty { channel, fault, for_s: self.clock_s - since_s });
            }
        }
    }

    /// Ends biases of which zero is likely enough: with a prior N(0, F²) on faults, the odds of zero against a fault are
    /// (F/σ) exp(−f²/2σ²) (Savage and Dickey), and those of two at once alike. Two that coasted together share the error of the height:
    /// either may look large alone.
    pub(super) fn heal(&mut self) {
        let prior = self.settings.detection.bias_m;
        let biased = Channel::ALL.map(|c| self.channels[c.index()].biased_since_s.is_some());
        if !biased.contains(&true) {
            return;
        }
        let size = |c: Channel| self.joint.x[c.fault()] - self.channels[c.index()].offset_before_m;
        let covariance = |c: Channel, d: Channel| self.joint.p[(c.fault(), d.fault())];
        let mut healed = [false; 4];
        for c in Channel::ALL.into_iter().filter(|c| biased[c.index()]) {
            let variance = covariance(c, c);
            let odds = 0.5 * (prior * prior / variance).ln() - 0.5 * size(c).powi(2) / variance;
            if odds > HEALED {
                healed[c.index()] = true;
                break;
            }
            for d in Channel::ALL.into_iter().filter(|d| *d > c && biased[d.index()]) {
                let (a, b, e) = (variance, covariance(c, d), covariance(d, d));
                let det = a * e - b * b;
                let square = (e * size(c).powi(2) - 2.0 * b * size(c) * size(d) + a * size(d).powi(2)) / det;
                if 0.5 * (prior.powi(4) / det).ln() - 0.5 * square > 2.0 * HEALED {
                    healed[c.index()] = true;
                    healed[d.index()] = true;
                }
            }
        }
        for channel in Channel::ALL.into_iter().filter(|c| healed[c.index()]) {
            if channel.is_absolute() {
                self.joint.pin(channel.fault());
            }
            self.channels[channel.index()].biased_since_s = None;
            self.bank.clear();
            self.tell(Change::Healed(channel));
        }
    }

    /// A barometer and GNSS that are off by the same agree: it is inertia that has gone astray, and neither is convicted by it. The height is what it
    /// is with both biases known to be zero, and climb rate and acceleration may be off by what has moved it since `since_s`.
    fn reconcile(&mut self, since_s: f64) {
        let size = |c: Channel| {
            let state = &self.channels[c.index()];
            state.biased_since_s.map(|_| self.joint.x[c.fault()] - state.offset_before_m)
        };
        let variance = |c: Channel| {
            let r =
                self.settings.channels[c.index()].noise_m.powi(2) * self.channels[c.index()].noise.factor();
            self.joint.p[(c.fault(), c.fault())] + r
        };
        // One that never goes astray is worth more than the two.
        let may_go = self.settings.detection.climb_jump_mps > 0.0;
        let Some(by_gnss) = size(Channel::Gnss).filter(|_| may_go) else { return };
        let agrees = |c: Channel| {
            let both = self.joint.p[(c.fault(), Channel::Gnss.fault())];
            let apart = variance(c) + variance(Channel::Gnss) - 2.0 * both;
            size(c).is_some_and(|s| s * by_gnss > 0.0 && (s - by_gnss).powi(2) < AGREE * AGREE * apart)
        };
        if ![Channel::Baro, Channel::SecondBaro].into_iter().any(agrees) {
            return;
        }
        let before_m = self.joint.x[HEIGHT];
        let convicted = |c: &Channel| *c != Channel::Range && size(*c).is_some();
        let undone = Channel::ALL.map(|c| Some(c).filter(convicted));
        for channel in undone.into_iter().flatten() {
            if channel.is_absolute() {
                self.joint.pin(channel.fault());
            }
            // One that was convicted before was told to be.
            let told = self.channels[channel.index()].biased_since_s.take().is_some_and(|t| t < since_s);
            if told && !self.health(channel).is_faulty() {
                self.tell(Change::Healed(channel));
            }
        }
        let lasted_s = (self.clock_s - since_s).max(1.0);
        let moved_m = self.joint.x[HEIGHT] - before_m;
        self.joint.p[(HEIGHT, HEIGHT)] += moved_m * moved_m;
        self.joint.p[(CLIMB, CLIMB)] += (moved_m / lasted_s).powi(2);
        self.joint.p[(ACCEL_BIAS, ACCEL_BIAS)] += (2.0 * moved_m / lasted_s.powi(2)).powi(2);
        self.bank.clear();
        self.tell(Change::InertialAstray { height_step_m: moved_m });
    }

    pub(super) fn tell(&mut self, change: Change) {
        if let Some(free) = self.changes.iter_mut().find(|c| c.is_none()) {
            *free = Some(change);
        }
    }
}
