//! The fault-tolerant altimeter: the joint filter, guarded sample by sample and watched over time.
//!
//! Every sample is weighted with the probability (32) that its channel works normally, per channel and with the consistent covariance.
//! That holds for a few samples only: what lasts has to be named. The bank of onsets says whether a channel jumped, two of them did, the
//! inertial altitude went astray, or a channel's noise has grown, and since when. A bias that is declared becomes a state that is open
//! from its onset on, so that what the faulty samples did to the height is undone; the channel goes on as a relative height. Grown
//! noise is used with the variance it shows. A channel is healthy again when its bias is zero more likely than not, or its noise is
//! back to normal: never is the truth rejected because a fault was believed. A measurement that is missing is missing.

use super::fault::{Change, Fault, Health};
use super::joint::{CLIMB, Channel, HEIGHT, Innovation, Joint, State};
use super::noise::GrownNoise;
use super::onsets::{Fit, INERTIAL, JUMPS, Onset, Onsets};
use super::probability::normal_operation;
use super::settings::{AltimeterSettings, DetectionSettings};

/// Longest step of the prediction, s.
const MAX_STEP_S: f64 = 0.5;
/// The limit of (32), in standard deviations.
const LIMIT: f64 = 3.0;
/// A channel without a height of its own that was silent for this long begins anew, s.
const FORGOTTEN_S: f64 = 3.0;
/// So many distances in a row that do not fit are to another ground.
const ANOTHER_GROUND: u32 = 5;
/// The least part of the inertial noise, and how fast it grows and shrinks by ν² − 1 of a sample.
const LEAST_DOUBT: f64 = 0.02;
const DOUBT_GAIN: [f64; 2] = [0.1, 0.02];
/// A channel has settled when its prediction's variance is this part of a sample's.
const SETTLED: f64 = 0.1;
/// An innovation beyond this may be the first of a fault, in standard deviations.
const SUSPICIOUS: f64 = 2.5;
/// Or after so many samples.
const SETTLING: u32 = 20;
/// Log-odds by which a bias has to be zero to be over.
const HEALED: f64 = -2.0;
/// Changes that can wait to be asked for.
const CHANGES: usize = 16;

/// What became of a height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum HeightVerdict {
    /// Used with this weight; the innovation over its standard deviation.
    Used {
        /// Probability of normal operation, 0 to 1.
        weight: f64,
        /// ν = Δ/√S.
        normalised: f64,
    },
    /// Not used; the innovation over its standard deviation (NaN when it is no number).
    Rejected(f64),
}

#[derive(Clone, Copy, Debug)]
struct ChannelState {
    started: bool,
    /// What it should read was once known better than a sample tells it. Before, a fault cannot be told from a wrong start.
    settled: bool,
    /// Its last innovation was a large one.
    far: bool,
    /// Samples so far, while it settles.
    settling: u32,
    /// Since when a bias is declared, s.
    biased_since_s: Option<f64>,
    /// What the offset was when the bias was declared, m.
    offset_before_m: f64,
    noise: GrownNoise,
    heard_s: f64,
    /// Samples in a row that were not used.
    refused: u32,
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub struct Altimeter {
    settings: AltimeterSettings,
    joint: Joint,
    onsets: Onsets,
    channels: [ChannelState; 4],
    started: bool,
    /// Time of the state, s since the start.
    clock_s: f64,
    /// What has been integrated since: time, ∫u and ∫∫u.
    pending: (f64, f64, f64),
    /// ∫ of the squared noise density over it.
    pending_noise: f64,
    /// What part of the noise that is asked for the innovations prove to be there, as variance.
    doubt: f64,
    changes: [Option<Change>; CHANGES],
}

impl Altimeter {
    /// An altimeter that waits for its first height.
    pub fn new(settings: AltimeterSettings) -> Self {
        let channel = ChannelState {
            started: false,
            settled: false,
            far: false,
            settling: 0,
            biased_since_s: None,
            offset_before_m: 0.0,
            noise: GrownNoise::default(),
            heard_s: f64::NEG_INFINITY,
            refused: 0,
        };
        let d = &settings.detection;
        Self {
            joint: Joint::new(settings.inertial, settings.channels.map(|c| c.offset)),
            onsets: Onsets::new(d.spacing_s, d.window_s),
            channels: [channel; 4],
            started: false,
            clock_s: 0.0,
            pending: (0.0, 0.0, 0.0),
            pending_noise: 0.0,
            doubt: LEAST_DOUBT,
            changes: [None; CHANGES],
            settings,
        }
    }

    /// Height above the origin, m, once a source has given it.
    pub fn height_m(&self) -> Option<f64> {
        let (t, _, dh) = self.pending;
        let x = &self.joint.x;
        self.started.then(|| x[HEIGHT] + t * (x[CLIMB] - 0.5 * t * x[2]) + dh)
    }

    /// Climb rate, m/s.
    pub fn climb_mps(&self) -> f64 {
        let (t, dv, _) = self.pending;
        self.joint.x[CLIMB] + dv - t * self.joint.x[2]
    }

    /// Standard deviation of the height, m.
    pub fn height_sigma_m(&self) -> f64 {
        let (t, p) = (self.pending.0, &self.joint.p);
        (p[(HEIGHT, HEIGHT)] + t * (2.0 * p[(HEIGHT, CLIMB)] + t * p[(CLIMB, CLIMB)])).max(0.0).sqrt()
    }

    /// Standard deviation of the climb rate, m/s.
    pub fn climb_sigma_mps(&self) -> f64 {
        self.joint.sigma(CLIMB)
    }

    /// What a channel's health is.
    pub fn health(&self, channel: Channel) -> Health {
        let c = &self.channels[channel.index()];
        if let Some(since_s) = c.biased_since_s {
            let size_m = self.joint.x[channel.fault()] - c.offset_before_m;
            let sigma_m = self.joint.sigma(channel.fault());
            return Health::Faulty { fault: Fault::Bias { size_m, sigma_m }, for_s: self.now_s() - since_s };
        }
        match c.noise.since_s() {
            Some(since_s) => Health::Faulty {
                fault: Fault::Noise { variance_factor: c.noise.factor() },
                for_s: self.now_s() - since_s,
            },
            None if c.started => Health::Healthy,
            None => Health::Unheard,
        }
    }

    /// Seconds since a channel was last heard.
    pub fn quiet_s(&self, channel: Channel) -> f64 {
        self.now_s() - self.channels[channel.index()].heard_s
    }

    /// What a channel's height is off by as a rule: its reading less the height, without a fault, m.
    pub fn offset_m(&self, channel: Channel) -> Option<f64> {
        self.channels[channel.index()].started.then(|| self.joint.x[channel.offset()])
    }

    /// The oldest change that was not asked for yet.
    pub fn next_change(&mut self) -> Option<Change> {
        let first = self.changes[0].take();
        self.changes.rotate_left(1);
        first
    }

    fn now_s(&self) -> f64 {
        self.clock_s + self.pending.0
    }

    /// A channel's offset may change faster for now (a barometer in the ground effect): it walks by `walk` m/√s over `dt` seconds.
    pub fn loosen(&mut self, channel: Channel, walk: f64, dt: f64) {
        let q = walk * walk * dt;
        if q > 0.0 && q.is_finite() && self.channels[channel.index()].started {
            self.joint.p[(channel.offset(), channel.offset())] += q;
        }
    }

    /// The origin has moved up by `up_m`: heights above it become smaller.
    pub fn shift_origin(&mut self, up_m: f64) {
        if !self.started || !up_m.is_finite() {
            return;
        }
        self.joint.x[HEIGHT] -= up_m;
        for c in Channel::ALL {
            let state = &mut self.channels[c.index()];
            if c != Channel::Gnss && state.started {
                self.joint.x[c.offset()] += up_m;
                state.offset_before_m += if c.is_absolute() { 0.0 } else { up_m };
            }
        }
    }

    /// Predicts over `dt` seconds with the upward acceleration `accel_up` (m/s², gravity taken out).
    ///
    /// `noise` is the noise density that this acceleration may have beyond the settings' own, m/s²/√Hz: a wrong attitude shows in
    /// manoeuvres. How much of it there is, the innovations of the barometer tell.
    pub fn predict(&mut self, dt: f64, accel_up: f64, noise: f64) {
        if !(dt > 0.0 && dt.is_finite() && accel_up.is_finite()) {
            return;
        }
        let steps = (dt / MAX_STEP_S).ceil().min(1e4);
        for _ in 0..steps as usize {
            let (t, dv, dh) = self.pending;
            let dt = dt / steps;
            self.pending = (t + dt, dv + accel_up * dt, dh + dv * dt + 0.5 * accel_up * dt * dt);
            self.pending_noise += if noise.is_finite() { self.doubt * noise * noise * dt } else { 0.0 };
            if t + dt >= MAX_STEP_S {
                self.catch_up();
            }
        }
    }

    /// Carries state, covariance and bank to the present.
    fn catch_up(&mut self) {
        let (dt, delta_v, delta_h) = std::mem::take(&mut self.pending);
        if dt > 0.0 {
            let phi = self.joint.transition(dt);
            let noise = std::mem::take(&mut self.pending_noise);
            self.joint.predict(&phi, delta_v, delta_h, noise / dt);
            self.onsets.predict(&phi, self.in_use());
            self.clock_s += dt;
        }
    }

    /// What can have jumped: the channels that are heard, and the inertial altitude.
    fn in_use(&self) -> [bool; JUMPS] {
        let c = &self.channels;
        let inertial = self.settings.detection.climb_jump_mps > 0.0;
        [c[0].started, c[1].started, c[2].started, c[3].started, inertial]
    }

    /// A channel's height, m, measured `age_s` ago, with the standard deviation that the sensor claims, if it does.
    pub fn measure(
        &mut self,
        channel: Channel,
        height_m: f64,
        claimed_sigma_m: Option<f64>,
        age_s: f64,
    ) -> HeightVerdict {
        let i = channel.index();
        let floor = self.settings.channels[i].noise_m;
        let sigma = claimed_sigma_m.filter(|s| s.is_finite()).unwrap_or(floor).max(floor);
        let y = height_m + self.climb_mps() * age_s;
        if !y.is_finite() {
            return HeightVerdict::Rejected(f64::NAN);
        }
        self.catch_up();
        if !channel.is_absolute() && self.clock_s - self.channels[i].heard_s > FORGOTTEN_S {
            // The ground under the beam is another one, and what a second barometer was off by is known no better than from now on.
            self.channels[i].started = false;
            self.channels[i].biased_since_s = None;
        }
        if !self.channels[i].started {
            self.start(channel, y, sigma);
        }
        self.channels[i].heard_s = self.clock_s;
        let r = sigma * sigma;
        let innovation = self.joint.innovation(channel, y, r * self.channels[i].noise.factor());
        let normalised = innovation.value / innovation.variance.sqrt();
        if !normalised.is_finite() {
            return HeightVerdict::Rejected(normalised);
        }
        self.channels[i].settling = self.channels[i].settling.saturating_add(1);
        self.channels[i].settled |=
            innovation.variance - r < SETTLED * r || self.channels[i].settling > SETTLING;
        let settled = self.channels[i].settled;
        let prob = if settled { normal_operation(normalised, 1.0, LIMIT) } else { 1.0 };
        let weight = if prob < self.settings.least_prob { 0.0 } else { prob };
        let far = normalised.abs() > SUSPICIOUS;
        let begins = !std::mem::replace(&mut self.channels[i].far, far) && far;
        if self.channels.iter().all(|c| c.settled || !c.started) {
            self.onsets.open(self.clock_s, begins);
        }
        let gain = if weight > 0.0 { self.joint.update(&innovation, weight) } else { State::zeros() };
        self.onsets.measured(channel, &innovation, &gain, self.in_use());
        self.note_noise(channel, &innovation, r);
        if settled && channel != Channel::Gnss && channel != Channel::Range {
            let surprise = (normalised * normalised).min(LIMIT * LIMIT) - 1.0;
            let gain = if surprise > 0.0 { DOUBT_GAIN[0] } else { DOUBT_GAIN[1] };
            self.doubt = (self.doubt * (gain * surprise).exp()).clamp(LEAST_DOUBT, 1.0);
        }
        self.look_for_faults();
        self.heal(0.0);
        if weight > 0.0 {
            self.channels[i].refused = 0;
            return HeightVerdict::Used { weight, normalised };
        }
        self.channels[i].refused += 1;
        if channel == Channel::Range && self.channels[i].refused >= ANOTHER_GROUND {
            self.channels[i].started = false;
            self.channels[i].refused = 0;
        }
        HeightVerdict::Rejected(normalised)
    }

    /// The first height of a channel. The first of all is the height; an offset of which nothing is known takes the first difference.
    fn start(&mut self, channel: Channel, y: f64, sigma: f64) {
        self.channels[channel.index()].started = true;
        let offset = self.settings.channels[channel.index()].offset.sigma_m;
        if !self.started {
            self.started = true;
            if offset < self.settings.inertial.start_sigma[0] {
                self.joint.x[HEIGHT] = y;
            }
        }
        if offset > self.joint.sigma(HEIGHT) {
            self.set_offset(channel, y, sigma);
        }
    }

    /// Puts all of a reading's disagreement into the channel's offset, whose error is the height's and the reading's from then on.
    fn set_offset(&mut self, channel: Channel, y: f64, sigma: f64) {
        let o = channel.offset();
        self.joint.x[o] = y - self.joint.x[HEIGHT];
        let row = -self.joint.p.row(HEIGHT).into_owned();
        self.joint.p.row_mut(o).copy_from(&row);
        self.joint.p.column_mut(o).copy_from(&row.transpose());
        self.joint.p[(o, o)] = -row[HEIGHT] + sigma * sigma;
    }

    /// Follows the noise of a channel whose noise has grown.
    fn note_noise(&mut self, channel: Channel, innovation: &Innovation, r: f64) {
        let limit = self.settings.detection.relief;
        let noise = &mut self.channels[channel.index()].noise;
        let predicted = innovation.variance - r * noise.factor();
        if noise.follow(innovation.value * innovation.value, predicted, r, limit) {
            self.onsets.clear();
            self.tell(Change::Healed { channel, height_step_m: 0.0 });
        }
    }

    /// Asks the bank what explains the innovations best.
    fn look_for_faults(&mut self) {
        let d = &self.settings.detection;
        let explanations = self.onsets.iter().map(|onset| explain(onset, d));
        let best = explanations.reduce(|a, b| if b.score > a.score { b } else { a });
        if let Some(best) = &best {
            self.onsets.keep(best.since_s);
        }
        let lasting = |e: &Explanation| self.clock_s - e.since_s >= d.lasting_s;
        let Some(found) = best.filter(|e| e.ready && lasting(e)) else { return };
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
                    height_step_m: 0.0,
                });
            }
        }
        if let Some((fit, effects)) = &found.jump {
            self.take_jump(fit, effects, found.since_s);
        }
        self.onsets.clear();
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
        let height_step_m = self.joint.x[HEIGHT] - before;
        if fit.jumps[0] == INERTIAL {
            return self.tell(Change::InertialAstray { height_step_m });
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
        let mut moved_m = self.heal(height_step_m);
        for channel in Channel::ALL.into_iter().filter(|c| declared[c.index()]) {
            let state = &self.channels[channel.index()];
            if state.biased_since_s.is_some() {
                let fault = Fault::Bias {
                    size_m: self.joint.x[channel.fault()] - state.offset_before_m,
                    sigma_m: self.joint.sigma(channel.fault()),
                };
                self.tell(Change::Faulty {
                    channel,
                    fault,
                    for_s: self.clock_s - since_s,
                    height_step_m: moved_m,
                });
                moved_m = 0.0;
            }
        }
    }

    /// Ends biases that are zero more likely than not: with a prior N(0, F²) on faults, the odds of zero against a fault are
    /// (F/σ) exp(−f²/2σ²) (Savage and Dickey), and those of two at once alike. Two that coasted together share the error of the height:
    /// either may look large alone. `moved_m` is what the height has moved by before; returns what of it was not told.
    fn heal(&mut self, mut moved_m: f64) -> f64 {
        let prior = self.settings.detection.bias_m;
        let biased = Channel::ALL.map(|c| self.channels[c.index()].biased_since_s.is_some());
        if !biased.contains(&true) {
            return moved_m;
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
            let before = self.joint.x[HEIGHT];
            if channel.is_absolute() {
                self.joint.pin(channel.fault());
            }
            self.channels[channel.index()].biased_since_s = None;
            self.onsets.clear();
            self.tell(Change::Healed { channel, height_step_m: moved_m + self.joint.x[HEIGHT] - before });
            moved_m = 0.0;
        }
        moved_m
    }

    fn tell(&mut self, change: Change) {
        if let Some(free) = self.changes.iter_mut().find(|c| c.is_none()) {
            *free = Some(change);
        }
    }
}

/// What explains the innovations since an onset.
#[derive(Clone, Copy, Debug)]
struct Explanation {
    /// Log-likelihood ratio against "nothing happened", less what it costs.
    score: f64,
    since_s: f64,
    /// What jumped, and that alone as log-likelihood ratio.
    jump: Option<(Fit, [State; 2])>,
    /// Channels whose noise has grown: by which factor, and how many samples show it.
    grown: [Option<(f64, u32)>; 4],
    /// Nothing else explains it nearly as well, and there are samples enough.
    ready: bool,
}

/// The best explanation of what came since an onset.
///
/// An explanation says of every channel that it is as it was, has jumped, or has become noisy; or that the inertial altitude jumped.
/// What an explanation declares has to be ahead of every explanation without it.
fn explain(onset: &Onset, d: &DetectionSettings) -> Explanation {
    let mut noisy = [0.0; 4];
    let mut quiet = [1.0; 4];
    let mut total = 0;
    for c in 0..4 {
        total += onset.count[c];
        let (ratio, factor) = Onset::noise(onset.square[c], onset.count[c]);
        if ratio > d.noise_cost {
            noisy[c] = ratio - d.noise_cost;
            quiet[c] = 1.0 / factor;
        }
    }
    let noise: f64 = noisy.iter().sum();
    // A channel that jumped has its own noise, one that did not has what its innovations show.
    let weights = |s: usize, t: usize| std::array::from_fn(|c| if c == s || c == t { 1.0 } else { quiet[c] });
    // The ground may be anywhere: that is no fault of the rangefinder, but it has its say about the others.
    let heard = |c: usize| onset.count[c] > 0 && c != Channel::Range.index();
    // Scores of: no jump, the inertial altitude, one channel, two channels.
    let mut tried: [(f64, Option<Fit>); 12] = [(f64::NEG_INFINITY, None); 12];
    tried[0].0 = noise;
    if let Some(fit) = onset.inertial(d.climb_jump_mps, &[1.0; 4]) {
        tried[1] = (fit.ratio - d.jump_cost, Some(fit));
    }
    let mut n = 2;
    for s in 0..4 {
        if !heard(s) {
            continue;
        }
        if let Some(fit) = onset.single(s, &weights(s, s)) {
            tried[n] = (fit.ratio - d.jump_cost + noise - noisy[s], Some(fit));
            n += 1;
        }
        for t in s + 1..4 {
            if heard(t)
                && let Some(fit) = onset.pair(s, t, &weights(s, t))
            {
                tried[n] = (fit.ratio - d.jump_cost - d.both_cost + noise - noisy[s] - noisy[t], Some(fit));
                n += 1;
            }
        }
    }
    let tried = tried.get(..n).unwrap_or(&tried);
    let best = tried.iter().fold(tried[0], |a, b| if b.0 > a.0 { *b } else { a });
    let ahead_of = |without: &dyn Fn(&Option<Fit>) -> bool| {
        tried.iter().filter(|(_, fit)| without(fit)).all(|(score, _)| best.0 > score + d.margin)
    };
    let jumps = |fit: &Option<Fit>, s: usize| fit.is_some_and(|f| f.jumps.contains(&s));
    let mut ready = true;
    let mut grown = [None; 4];
    for c in 0..4 {
        let (ratio, _) = Onset::noise(onset.bounded[c], onset.count[c]);
        if !jumps(&best.1, c) && onset.count[c] >= d.samples && ratio > d.ratio {
            if ahead_of(&|fit| jumps(fit, c)) {
                let (_, factor) = Onset::noise(onset.square[c], onset.count[c]);
                grown[c] = Some((factor, onset.count[c]));
            }
        }
    }
    match &best.1 {
        Some(fit) => {
            ready &= fit.ratio - d.jump_cost > d.ratio;
            let mut seen = 0;
            for s in fit.jumps {
                let n = onset.count.get(s).map_or(total, |n| *n);
                seen += n;
                ready &= n >= d.samples.div_ceil(2);
                ready &= ahead_of(&|other| !jumps(other, s));
            }
            ready &= seen >= 2 * d.samples;
        }
        None => ready = grown.iter().any(Option::is_some),
    }
    let jump = best.1.map(|fit| (fit, fit.jumps.map(|s| State::from(onset.effect[s]))));
    Explanation { score: best.0, since_s: onset.time_s, jump, grown, ready }
}
