//! The fault-tolerant altimeter: the joint filter, guarded sample by sample and watched over time.
//!
//! Every sample of a channel that has settled is weighted with the probability (32) that it works normally, with the consistent covariance.
//! That holds for a few samples only: what lasts has to be named. The bank of onsets says whether a channel jumped, two of them did, the
//! inertial altitude went astray, or a channel's noise has grown, and since when. A bias that is declared becomes a state that is open
//! from its onset on, so that what the faulty samples did to the height is undone; the channel goes on as a relative height. Grown
//! noise is used with the variance it shows. A channel is healthy again when zero is likely enough for its bias, or its noise is
//! back to normal: never is the truth rejected because a fault was believed. A measurement that is missing is missing.

use super::channel_state::ChannelState;
use super::drift::Drift;
use super::fault::{Change, Fault, Health};
use super::glr_bank::{GlrBank, JUMPS};
use super::joint::{CLIMB, Channel, HEIGHT, Joint, State, UnseenClimb};
use super::probability::normal_operation;
use super::settings::AltimeterSettings;
use super::tuning::{
    ANOTHER_GROUND, CHANGES, FORGOTTEN_S, LARGEST_M, LARGEST_MPS2, LEAST_NOISE_SHARE, LIMIT, LOST_VARIANCE,
    MAX_STEP_S, MAX_TIME_S, NOISE_SHARE_GAIN, SURPRISE, SUSPICIOUS,
};

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

/// See the module's documentation.
#[derive(Clone, Debug)]
pub struct Altimeter {
    pub(super) settings: AltimeterSettings,
    pub(super) joint: Joint,
    pub(super) bank: GlrBank,
    pub(super) channels: [ChannelState; 4],
    pub(super) drift: Drift,
    pub(super) started: bool,
    /// Time of the state, s since the start.
    pub(super) clock_s: f64,
    /// What has been integrated since: time, ∫u and ∫∫u.
    pending: (f64, f64, f64),
    /// ∫ of the squared noise density over it.
    pending_noise: f64,
    /// What part of the noise that is asked for the innovations prove to be there, as variance.
    noise_share: f64,
    /// What the log-likelihood ratios lack at least before anything could be declared.
    pub(super) room: f64,
    pub(super) changes: [Option<Change>; CHANGES],
}

impl Altimeter {
    /// An altimeter that waits for its first height.
    pub fn new(settings: AltimeterSettings) -> Self {
        let d = &settings.detection;
        Self {
            joint: Joint::new(settings.inertial, settings.channels.map(|c| c.offset)),
            bank: GlrBank::new(d.spacing_s, d.window_s),
            channels: [ChannelState::new(); 4],
            drift: Drift::default(),
            started: false,
            clock_s: 0.0,
            pending: (0.0, 0.0, 0.0),
            pending_noise: 0.0,
            noise_share: LEAST_NOISE_SHARE,
            room: 0.0,
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
        if let Some(since_s) = self.drift.since_s.filter(|_| channel == Channel::Baro) {
            let size_m = self.offset_difference().map_or(0.0, |(difference, _)| difference);
            return Health::Faulty { fault: Fault::Drift { size_m }, for_s: self.now_s() - since_s };
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

    /// What comes on a channel is another sensor's from now on: its offset is found anew, the height stays.
    pub fn another(&mut self, channel: Channel) {
        if self.health(channel).is_faulty() {
            self.tell(Change::Healed(channel));
        }
        // What a height should read stays known.
        let settled = self.channels[channel.index()].settled;
        self.channels[channel.index()] = ChannelState { settled, ..ChannelState::new() };
        if channel.is_absolute() {
            self.joint.x[channel.fault()] = 0.0;
            self.joint.decorrelate(channel.fault(), 0.0);
        }
        let (o, offset) = (channel.offset(), self.settings.channels[channel.index()].offset.sigma_m);
        self.joint.x[o] = 0.0;
        self.joint.decorrelate(o, offset * offset);
        if channel == Channel::Baro {
            self.drift = Drift::default();
        }
        self.bank.clear();
    }

    /// How far a channel's height, m, with the standard deviation that the sensor claims, lies from what is expected of it, in standard
    /// deviations: without using it. `None` for a channel that was not heard yet.
    pub fn disagreement(&self, channel: Channel, height_m: f64, sigma_m: f64) -> Option<f64> {
        let c = &self.channels[channel.index()];
        let sigma = sigma_m.max(self.settings.channels[channel.index()].noise_m);
        let innovation = self.joint.innovation(channel, height_m, sigma * sigma * c.noise.factor());
        let moved = self.height_m()? - self.joint.x[HEIGHT];
        c.started.then(|| (innovation.value - moved) / innovation.variance.sqrt())
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

    /// A channel's offset may change faster for now (a barometer in the ground effect): it walks by `walk` m/√s over `dt` seconds. Of one
    /// that is off it is the fault's size that walks, so that it is over once it has walked back.
    pub fn loosen(&mut self, channel: Channel, walk: f64, dt: f64) {
        let q = walk * walk * dt;
        let state = &self.channels[channel.index()];
        if q > 0.0 && q < LOST_VARIANCE && state.started {
            let biased = state.biased_since_s.is_some();
            let walks = if biased { channel.fault() } else { channel.offset() };
            self.joint.p[(walks, walks)] += q;
            if channel == Channel::Baro && !biased {
                self.loosen_offset_reference(q);
            }
        }
    }

    /// The origin has moved up by `up_m`: heights above it become smaller.
    pub fn shift_origin(&mut self, up_m: f64) {
        if !self.started || up_m.is_nan() || up_m.abs() > LARGEST_M {
            return;
        }
        self.joint.x[HEIGHT] -= up_m;
        self.shift_offset_reference(up_m);
        for c in Channel::ALL {
            let state = &mut self.channels[c.index()];
            if c != Channel::Gnss && state.started {
                self.joint.x[c.offset()] += up_m;
                state.offset_before_m += if c.is_absolute() { 0.0 } else { up_m };
            }
        }
    }

    /// Heights of the last `for_s` seconds that were not to be used have changed the climb rate by `climb_mps`, m/s, and the height with it: both may be wrong by that, 1 sigma.
    pub fn doubt(&mut self, climb_mps: f64, for_s: f64) {
        self.propagate();
        self.move_by(climb_mps, climb_mps * for_s, climb_mps * climb_mps * for_s);
    }

    /// Nothing was measured for `gap_s` seconds, and this became of the climb.
    pub fn blind(&mut self, gap_s: f64, climb: &UnseenClimb) {
        if !(gap_s > 0.0 && gap_s.is_finite()) {
            return;
        }
        self.propagate();
        self.clock_s += gap_s;
        if self.joint.p[(HEIGHT, HEIGHT)] < LOST_VARIANCE {
            self.joint.unseen(gap_s, climb);
        }
        // Beyond this nothing is a height, and a variance has no digits left for one.
        let most = (LARGEST_M / climb.height_m).min(1.0);
        self.move_by(climb.climb_mps, most * climb.height_m, most * climb.both);
    }

    /// It may have moved by `way` m, and its climb rate by `speed` m/s, 1 sigma, with this covariance, m²/s.
    fn move_by(&mut self, speed: f64, way: f64, both: f64) {
        if (speed * way).is_finite() && self.joint.sigma(HEIGHT) < LARGEST_M {
            self.joint.p[(CLIMB, CLIMB)] += speed * speed;
            self.joint.p[(HEIGHT, HEIGHT)] += way * way;
            self.joint.p[(HEIGHT, CLIMB)] += both;
            self.joint.p[(CLIMB, HEIGHT)] += both;
        }
        self.bank.clear();
    }

    /// Predicts over `dt` seconds with the upward acceleration `accel_up` (m/s², gravity taken out).
    ///
    /// `noise` is the noise density that this acceleration may have beyond the settings' own, m/s²/√Hz: a wrong attitude shows in
    /// manoeuvres. How much of it there is, the innovations of the barometer tell.
    pub fn predict(&mut self, dt: f64, accel_up: f64, noise: f64) {
        if !(dt > 0.0 && dt.is_finite() && accel_up.abs() < LARGEST_MPS2) {
            return;
        }
        let dt = dt.min(MAX_TIME_S);
        let steps = (dt / MAX_STEP_S).ceil().min(1e4);
        for _ in 0..steps as usize {
            let (t, dv, dh) = self.pending;
            let dt = dt / steps;
            self.pending = (t + dt, dv + accel_up * dt, dh + dv * dt + 0.5 * accel_up * dt * dt);
            self.pending_noise +=
                if noise.abs() < LARGEST_MPS2 { self.noise_share * noise * noise * dt } else { 0.0 };
            if t + dt >= MAX_STEP_S {
                self.propagate();
            }
        }
    }

    /// Propagates state, covariance and bank to the present.
    pub(super) fn propagate(&mut self) {
        let (dt, delta_v, delta_h) = std::mem::take(&mut self.pending);
        if dt > 0.0 {
            let phi = self.joint.transition(dt);
            let noise = std::mem::take(&mut self.pending_noise);
            self.clock_s += dt;
            if self.joint.p[(HEIGHT, HEIGHT)] < LOST_VARIANCE {
                self.joint.predict(&phi, delta_v, delta_h, noise / dt);
                self.bank.predict(&phi, self.in_use());
            }
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
        let floor = self.settings.channels[channel.index()].noise_m;
        let sigma = claimed_sigma_m.filter(|s| !s.is_nan()).map_or(floor, |s| s.clamp(floor, LARGEST_M));
        let y = height_m + self.climb_mps() * age_s;
        if y.is_nan() || y.abs() > LARGEST_M {
            return HeightVerdict::Rejected(f64::NAN);
        }
        self.propagate();
        self.begin(channel, y, sigma);
        let r = sigma * sigma;
        let noise = r * self.channels[channel.index()].noise.factor();
        let innovation = self.joint.innovation(channel, y, noise);
        let normalised = innovation.value / innovation.variance.sqrt();
        if !normalised.is_finite() {
            return HeightVerdict::Rejected(normalised);
        }
        let settled = self.channels[channel.index()].settle(innovation.variance - noise, r);
        let weight = self.weight(settled, normalised);
        self.open_onset(channel, normalised);
        let gain = if weight > 0.0 { self.joint.update(&innovation, weight) } else { State::zeros() };
        self.bank.measured(channel, &innovation, &gain, self.in_use());
        self.note_noise(channel, &innovation, r);
        if settled && matches!(channel, Channel::Baro | Channel::SecondBaro) {
            self.follow_surprise(normalised);
        }
        self.detect(channel, normalised);
        self.judge(channel, weight, normalised)
    }

    /// Starts a channel with its first height, and anew after a silence where it has no height of its own.
    fn begin(&mut self, channel: Channel, y: f64, sigma: f64) {
        let i = channel.index();
        if !channel.is_absolute() && self.clock_s - self.channels[i].heard_s > FORGOTTEN_S {
            // The ground under the beam is another one, and what a second barometer was off by is known no better than from now on.
            self.channels[i].started = false;
            if self.channels[i].biased_since_s.take().is_some() {
                self.tell(Change::Healed(channel));
            }
        }
        if !self.channels[i].started {
            self.start(channel, y, sigma);
        }
        self.channels[i].heard_s = self.clock_s;
    }

    /// The weight of a sample: the probability (32) that its channel works normally; 1 while it settles, 0 where that is too little.
    fn weight(&self, settled: bool, normalised: f64) -> f64 {
        let prob = if settled { normal_operation(normalised, 1.0, LIMIT) } else { 1.0 };
        if prob < self.settings.least_prob { 0.0 } else { prob }
    }

    /// Opens an onset in the bank before a sample is used, unless somebody still settles.
    fn open_onset(&mut self, channel: Channel, normalised: f64) {
        let far = normalised.abs() > SUSPICIOUS;
        let begins = !std::mem::replace(&mut self.channels[channel.index()].far, far) && far;
        // Who settles keeps the others from judging, but not for longer than it is heard.
        let silent = |c: &ChannelState| self.clock_s - c.heard_s > FORGOTTEN_S;
        if self.channels.iter().all(|c| c.settled || !c.started || silent(c)) {
            self.bank.open(self.clock_s, begins);
        }
    }

    /// How much of the noise that is asked for there is, by how surprising a barometer's sample was.
    fn follow_surprise(&mut self, normalised: f64) {
        let surprise = (normalised * normalised).min(LIMIT * LIMIT) - SURPRISE;
        let gain = if surprise > 0.0 { NOISE_SHARE_GAIN[0] } else { NOISE_SHARE_GAIN[1] };
        self.noise_share = (self.noise_share * (gain * surprise).exp()).clamp(LEAST_NOISE_SHARE, 1.0);
    }

    /// Looks for what lasts: faults with an onset, biases that are over, drift.
    fn detect(&mut self, channel: Channel, normalised: f64) {
        // A sample adds no more than ½ν² to any log-likelihood ratio: until that could be enough, nobody needs to look.
        self.room -= 0.5 * normalised * normalised;
        if self.room <= 0.0 {
            self.look_for_faults();
        }
        self.heal();
        if channel == Channel::Baro {
            self.look_for_drift();
        }
    }

    /// What became of a sample. Distances that keep being refused are to another ground.
    fn judge(&mut self, channel: Channel, weight: f64, normalised: f64) -> HeightVerdict {
        let state = &mut self.channels[channel.index()];
        if weight > 0.0 {
            state.refused = 0;
            return HeightVerdict::Used { weight, normalised };
        }
        state.refused += 1;
        if channel == Channel::Range && state.refused >= ANOTHER_GROUND {
            state.started = false;
            state.refused = 0;
        }
        HeightVerdict::Rejected(normalised)
    }

    /// The first height of a channel. The first of all is the height; an offset of which nothing is known takes the first difference.
    fn start(&mut self, channel: Channel, y: f64, sigma: f64) {
        self.channels[channel.index()].started = true;
        let offset = self.settings.channels[channel.index()].offset.sigma_m;
        if !self.started {
            self.started = true;
            if offset <= self.settings.inertial.start_sigma[0] {
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
        self.bank.restarted(o);
    }
}
