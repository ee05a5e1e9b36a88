//! Constants of what decides, remembers and publishes.

/// Memory, and what carries.
pub(in crate::navigator) mod core {
    /// IMU samples remembered: 1.5 s at 333 Hz.
    pub(in crate::navigator) const REMEMBERED: usize = 512;
    /// The position is that of landmarks for this long after a fix by them, s.
    pub(in crate::navigator) const LANDMARKS_CARRY_S: f64 = 1.5;
}

/// What is told.
pub(in crate::navigator) mod event_log {
    /// The same of the same source is told this often, s.
    pub(in crate::navigator) const TOLD_EVERY_S: f64 = 60.0;
    /// What was held back and is not what was told last is told when it has stayed for this long, s; then for twice as long, and so on. Less would
    /// tell more of what alternates; more would leave "healthy again" standing of what is faulty.
    pub(in crate::navigator) const STAYED_S: f64 = 5.0;
    /// Events and words about sources that are expected; more cost an allocation.
    pub(in crate::navigator) const EXPECTED: usize = 64;
}

/// The place.
pub(in crate::navigator) mod environment {
    /// The year whose magnetic field is taken while no clock has told the date.
    pub(in crate::navigator) const DEFAULT_YEAR: f64 = 2026.0;
    /// A date that is off by less changes no field, years.
    pub(in crate::navigator) const YEAR_TOLERANCE: f64 = 0.02;
    /// An origin further from the vehicle's first place than this is a damaged or hostile message, m.
    pub(in crate::navigator) const FARTHEST_ORIGIN_M: f64 = 100_000.0;
}

/// What was kept.
pub(in crate::navigator) mod memory {
    /// After a longer time nothing that flies is where it was, s.
    pub(in crate::navigator) const MOST_GAP_S: f64 = 60.0;
    /// No glide is longer, and no ground lies further off, m.
    pub(in crate::navigator) const LARGEST_OFFSET_M: f64 = 1e5;
}

/// The altimeter in the navigator.
pub(in crate::navigator) mod height {
    /// A height that a channel moves after so long a silence is a return, s.
    pub(in crate::navigator) const SILENT_S: f64 = 1.0;
    /// What a vertical acceleration may be that nobody has measured, m/s².
    pub(in crate::navigator) const UNKNOWN_VERTICAL: f64 = 2.0;
    /// After a hole the height is known again when its standard deviation is this many times what it was before.
    pub(in crate::navigator) const KNOWN_AGAIN: f64 = 2.0;
    /// Further than this it is jumped to then, m: at the speed of the glide that would take four seconds.
    pub(in crate::navigator) const UNSEEN_JUMP_M: f64 = 2.0;
}

/// How far sources of heights wander.
pub(in crate::navigator) mod height_wander {
    /// Heights are averaged over this long, s: shorter than what wash and gusts last.
    pub(in crate::navigator) const BLOCK_S: f64 = 0.5;
    /// How they part is looked at over so many blocks; over the first so many of them it comes and goes, and goes on walking beyond.
    pub(in crate::navigator) const LAGS: [usize; 5] = [1, 2, 4, 8, 32];
    pub(in crate::navigator) const SHORT_LAGS: usize = 4;
    /// It is forgotten in this time, s; nothing counts as if it had been seen for this long, s, and it is known after this long, s.
    pub(in crate::navigator) const MEMORY_S: f64 = 60.0;
    pub(in crate::navigator) const PRIOR_S: f64 = 5.0;
    pub(in crate::navigator) const KNOWN_S: f64 = 3.0;
    /// One difference counts for no more than so many times the mean square, and that for no less than this, m²: half a metre.
    pub(in crate::navigator) const CLIPPED: f64 = 9.0;
    pub(in crate::navigator) const LEAST_M2: f64 = 0.25;
    /// So much of D is within what is configured, m²: 0.5 m of either source, which any vehicle has.
    pub(in crate::navigator) const TOLERATED_M2: f64 = 0.5;
    /// How often a source tells is known over this long, s; distances are independent this often, s.
    pub(in crate::navigator) const RATE_S: f64 = 5.0;
    pub(in crate::navigator) const RANGE_INTERVAL_S: f64 = 0.1;
    /// Ground changes under a vehicle that moves: by as much as is configured from this speed on, m/s, and by less below.
    pub(in crate::navigator) const GROUND_CHANGES_MPS: f64 = 2.0;
}

/// Fixes by landmarks.
pub(in crate::navigator) mod landmark_fix {
    /// A correction beyond this is no tracking any more, and glides, m.
    pub(in crate::navigator) const SHOWN_AT_ONCE_M: f64 = 0.1;
    /// An observer's velocity is off by this much in manoeuvres, m/s: more than the drift that is configured, and the landmarks' filter, which
    /// it carries, lags by as much in the time that it forgets in.
    pub(in crate::navigator) const OBSERVED_SPEED_SIGMA: f64 = 0.5;
}

/// The error budget of the observers.
pub(in crate::navigator) mod budget {
    /// Path over which the ground's effect on the scale changes, m.
    pub(in crate::navigator) const SCALE_CORRELATION_M: f64 = 100.0;
}

/// What GNSS is believed.
pub(in crate::navigator) mod gnss_integrity {
    /// A hole in the fixes longer than this ends the comparison of positions with velocities, s.
    pub(in crate::navigator) const TRACK_HOLE_S: f64 = 1.0;
    /// Fixes further apart are no rate but a hole, s; the gain of the running mean interval; a receiver is lost after so many intervals.
    pub(in crate::navigator) const SLOWEST_S: f64 = 2.5;
    pub(in crate::navigator) const INTERVAL_GAIN: f64 = 0.1;
    pub(in crate::navigator) const MISSING_FIXES: f64 = 2.5;
    /// Gain of the running mean squares: some 50 fixes.
    pub(in crate::navigator) const NORMAL_GAIN: f64 = 0.02;
    /// Another receiver takes over when the fixes of the one in use have not passed for this long, s.
    pub(in crate::navigator) const REPLACED_S: f64 = 0.5;
    /// Who is lost again within this long, s, and more often than this, has to be good for so many times as long, up to so many times over.
    pub(in crate::navigator) const FREE_FLAPS: u32 = 1;
    pub(in crate::navigator) const STEADY_S: f64 = 30.0;
    pub(in crate::navigator) const BACK_OFF: f64 = 1.5;
    pub(in crate::navigator) const MOST_BACK_OFF: u32 = 4;
}

/// Positions against velocities.
pub(in crate::navigator) mod doppler_track {
    /// They are compared over these lengths of time, s.
    pub(in crate::navigator) const WINDOWS_S: [f64; 4] = [5.0, 10.0, 20.0, 40.0];
    /// One fix in this long is remembered, s, and so many of them: four minutes.
    pub(in crate::navigator) const MARK_S: f64 = 0.9;
    pub(in crate::navigator) const MARKS: usize = 256;
    /// What a receiver is expected to wander by before it has shown it, m, and m/s, and how firmly (as so many observations would show it);
    /// the last so many count.
    pub(in crate::navigator) const WANDER_M: f64 = 0.4;
    pub(in crate::navigator) const DRIFT_MPS: f64 = 0.08;
    pub(in crate::navigator) const FIRM: f64 = 6.0;
    pub(in crate::navigator) const MEMORY: f64 = 60.0;
    /// Beyond what would happen once in 10^7 windows it is a fault: multipath has longer tails than a normal distribution.
    pub(in crate::navigator) const DECADES: f64 = 7.0;
    /// One that has run away still does beyond what would happen once in a hundred, over windows up to this, s.
    pub(in crate::navigator) const GOES_ON_DECADES: f64 = 2.0;
    pub(in crate::navigator) const GOES_ON_S: f64 = 10.0;
    /// Receivers filter position and velocity differently: so many seconds of the change of the velocity are no lie.
    pub(in crate::navigator) const SLACK_S: f64 = 0.25;
    /// And their latency varies by this much, s: of the greatest change of the velocity since.
    pub(in crate::navigator) const JITTER_S: f64 = 0.1;
    /// Less is, where the receiver's own changes of velocity, beyond this, m/s, have shown less: what is expected of it, s and m, and the limit of what is usual.
    pub(in crate::navigator) const CHANGES_MPS: f64 = 4.0;
    pub(in crate::navigator) const DELAY_S: f64 = 0.1;
    pub(in crate::navigator) const TURNING_M: f64 = 2.0;
    pub(in crate::navigator) const DELAY_DECADES: f64 = 3.0;
    /// And of what is likely.
    pub(in crate::navigator) const LIKELY_DECADES: f64 = 1.0;
    /// The same from fix to fix: what is expected, m; how many count; and below this it is no step, m: multipath comes and goes.
    pub(in crate::navigator) const STEP_SIGMA_M: f64 = 0.5;
    pub(in crate::navigator) const STEP_MEMORY: f64 = 100.0;
    pub(in crate::navigator) const LEAST_STEP_M: f64 = 3.0;
    /// No walk is told that is shorter, m, and slower, m/s: multipath and the bias of the velocity come and go in any receiver.
    pub(in crate::navigator) const LEAST_WALK_M: f64 = 4.5;
    pub(in crate::navigator) const LEAST_WALK_MPS: f64 = 0.1;
    /// A receiver is back where so many marks in a row that are this old, s, lead to it.
    pub(in crate::navigator) const MATCHES: u32 = 3;
    pub(in crate::navigator) const SETTLE_S: f64 = 3.0;
    /// … and so many times nearer than those from just before.
    pub(in crate::navigator) const DISTINCT: f64 = 3.0;
}

/// Fixes that repeat themselves.
pub(in crate::navigator) mod frozen_fixes {
    /// A vehicle moves beyond this, m/s.
    pub(in crate::navigator) const MOVES_MPS: f64 = 1.0;
    /// So many repetitions over this long are no chance, s.
    pub(in crate::navigator) const FIXES: u32 = 2;
    pub(in crate::navigator) const FROZEN_S: f64 = 0.9;
    /// At rest: so many that last so many times longer than it has ever held a position, and this long, s; after it was heard for so long, s.
    pub(in crate::navigator) const HELD_FIXES: u32 = 5;
    pub(in crate::navigator) const HELD_TIMES: f64 = 3.0;
    pub(in crate::navigator) const HELD_S: f64 = 2.0;
    pub(in crate::navigator) const KNOWN_S: f64 = 30.0;
    /// It was held where the next fix is within this, m.
    pub(in crate::navigator) const HELD_M: f64 = 2.0;
    /// A longer silence is no time in which it was heard, s.
    pub(in crate::navigator) const LONGEST_GAP_S: f64 = 2.5;
}

/// A receiver that comes back elsewhere than the vehicle can have gone.
pub(in crate::navigator) mod unexplained {
    /// A deviation within so many sigmas of the dead reckoning is its drift.
    pub(in crate::navigator) const EXPLAINED_SIGMAS: f64 = 2.0;
    /// What is beyond is forgotten in this time, s: multipath and satellites change over some minutes.
    pub(in crate::navigator) const FORGOTTEN_S: f64 = 300.0;
    /// What is in dispute goes on parting for so long after the last fix, s.
    pub(in crate::navigator) const PARTS_FOR_S: f64 = 1.5;
}

/// The flow's word on GNSS.
pub(in crate::navigator) mod gnss_by_flow {
    /// Between two fixes no walk goes so far, m.
    pub(in crate::navigator) const JUMP_M: f64 = 3.0;
    /// So many blocks are kept; windows of so many are looked at.
    pub(in crate::navigator) const BLOCKS: usize = 32;
    pub(in crate::navigator) const WINDOWS: [usize; 4] = [4, 8, 16, 32];
    /// The flow may have changed so many blocks ago.
    pub(in crate::navigator) const ONSETS: [usize; 16] =
        [1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 20, 24, 28, 32];
    /// What a calibration that is known changes by in a minute, 1 sigma: bias, rad/s, scale and misalignment (terrain, height, heading).
    pub(in crate::navigator) const WANDER: [f64; 4] = [0.0015, 0.0015, 0.02, 0.02];
    /// And what a sensor that fails may do: its scale and direction may be anything, its bias is of the optics.
    pub(in crate::navigator) const CHANGED: [f64; 4] = [0.004, 0.004, 1.0, 0.5];
    /// Normalised squares an axis before they were seen (1 for white noise), how firmly, and how many windows count.
    pub(in crate::navigator) const SPREAD: f64 = 1.5;
    pub(in crate::navigator) const FIRM: f64 = 20.0;
    pub(in crate::navigator) const MEMORY: f64 = 60.0;
    /// It is accused beyond what happens once in 10^5 windows: four end each second, overlapping by nearly all of their length, so that an hour
    /// has some hundreds that are their own. Nothing is learned from it beyond once in 10^2, and what it may have led by is claimed beyond once in 10^3.5.
    pub(in crate::navigator) const DECADES: f64 = 5.0;
    pub(in crate::navigator) const DOUBT_DECADES: f64 = 2.0;
    pub(in crate::navigator) const GRAVE_DECADES: f64 = 3.5;
    /// The walk has to be a hundred times as likely as a change of the flow, ln.
    pub(in crate::navigator) const CLEAR_OF: f64 = 4.6;
    /// … and the flow's change has to explain less than this part: no model is right to the last per cent.
    pub(in crate::navigator) const RIVAL: f64 = 0.7;
    /// Slower is what the velocities of real receivers and flows are biased by for minutes, m/s, and nearer harms nobody, m.
    pub(in crate::navigator) const LEAST_MPS: f64 = 0.25;
    pub(in crate::navigator) const LEAST_WALK_M: f64 = 3.0;
    /// Faster ones are found by the filter, m/s.
    pub(in crate::navigator) const MOST_MPS: f64 = 3.0;
    /// Nor is what is this part of the speed: a flow's scale and heading are not the same everywhere.
    pub(in crate::navigator) const LEAST_PART: f64 = 0.06;
    /// How far such a walk has led is known to this part.
    pub(in crate::navigator) const CONFIRMED: f64 = 0.3;
    /// It walks no more where the short windows are within what happens once in a hundred, ln.
    pub(in crate::navigator) const RESTORED: f64 = 4.6;
}

/// A receiver's velocity that steps.
pub(in crate::navigator) mod velocity_step {
    /// So many fixes are looked at, one in so long, s, of the last seconds; a longer hole ends the comparison.
    pub(in crate::navigator) const SAMPLES: usize = 56;
    pub(in crate::navigator) const SPACING_S: f64 = 0.18;
    pub(in crate::navigator) const WINDOW_S: f64 = 10.0;
    pub(in crate::navigator) const HOLE_S: f64 = 2.5;
    /// They are looked at this often, s.
    pub(in crate::navigator) const LOOK_S: f64 = 0.4;
    /// The step was so long ago, s: a receiver lags behind its vehicle by less, and what is remembered of the filter reaches further back.
    pub(in crate::navigator) const YOUNGEST_S: f64 = 1.5;
    /// A younger one gives rise to doubt, where so many fixes show it.
    pub(in crate::navigator) const YOUNG_FIXES: usize = 3;
    pub(in crate::navigator) const OLDEST_S: f64 = 4.5;
    /// Noise of the difference before it was seen, and at least, m/s, and the gain of its running mean square.
    pub(in crate::navigator) const START_NOISE_MPS: f64 = 0.3;
    pub(in crate::navigator) const LEAST_NOISE_MPS: f64 = 0.03;
    pub(in crate::navigator) const NOISE_GAIN: f64 = 0.02;
    /// On the ground, where nothing is learned: noise, m/s, and the acceleration of who stands, m/s², root mean square.
    pub(in crate::navigator) const GROUND_NOISE_MPS: f64 = 0.15;
    pub(in crate::navigator) const STANDS_MPS2: f64 = 0.3;
    /// Jitter of the receiver's time before it was seen, s, how firmly both were, in windows, and how many windows count.
    pub(in crate::navigator) const START_JITTER_S: f64 = 0.02;
    pub(in crate::navigator) const NOISE_FIRM: f64 = 4.0;
    pub(in crate::navigator) const NOISE_MEMORY: f64 = 500.0;
    /// What the best of all steps explains, as a square of sigmas, and its deviation, before they were seen (of white noise alone: 7 ± 3), how firmly, how many
    /// count, one in so long, s, and how many have to be seen before anybody is accused.
    pub(in crate::navigator) const PEAK: f64 = 8.0;
    pub(in crate::navigator) const PEAK_DEVIATION: f64 = 12.0;
    pub(in crate::navigator) const FIRM: f64 = 8.0;
    pub(in crate::navigator) const MEMORY: f64 = 60.0;
    pub(in crate::navigator) const LEARN_S: f64 = 3.0;
    pub(in crate::navigator) const LEARNED: u32 = 8;
    /// A lie is beyond what would happen once in 10^6 windows, were what is usual normal, and explains more than a kink does by so much: a hundred times
    /// as likely.
    pub(in crate::navigator) const DECADES: f64 = 6.0;
    pub(in crate::navigator) const CLEAR_OF: f64 = 9.2;
    /// It may be one beyond what would happen once in 10^3.5, where it is as likely as not, and for so long it may lead away, s.
    pub(in crate::navigator) const DOUBT_DECADES: f64 = 3.5;
    pub(in crate::navigator) const DOUBT_S: f64 = 60.0;
    /// What is less likely is no lie.
    pub(in crate::navigator) const REFUTED: f64 = 0.01;
    /// A step may be a doubt where it leaves no more than this part of what it explains.
    pub(in crate::navigator) const DOUBT_LEAVES: f64 = 0.5;
    /// Hunches: no rarer than once in 10^this windows, s, so many, for so long, s, weighed this often, s.
    pub(in crate::navigator) const HUNCH_DECADES: f64 = 1.0;
    pub(in crate::navigator) const HUNCHES: usize = 6;
    pub(in crate::navigator) const HUNCH_S: f64 = 20.0;
    pub(in crate::navigator) const WEIGH_S: f64 = 0.95;
    /// It is still seen where a step within so long of it, s, explains this part of that; and has vanished where that was last so long, s, before it became too old to be seen.
    pub(in crate::navigator) const STILL: f64 = 0.5;
    pub(in crate::navigator) const STILL_SAME_S: f64 = 1.0;
    pub(in crate::navigator) const VANISHED_S: f64 = 1.0;
    /// … and leaves no more than this part of what it explains: manoeuvres that are sampled badly leave more.
    pub(in crate::navigator) const LEAVES: f64 = 0.33;
    /// It is the same for so long, s, to this, s.
    pub(in crate::navigator) const BORNE_OUT_S: f64 = 0.7;
    pub(in crate::navigator) const SAME_S: f64 = 0.5;
    /// Of what has parted within so long, s, a step is this part between two fixes that are no further apart than this, s.
    pub(in crate::navigator) const PARTED_S: f64 = 3.0;
    pub(in crate::navigator) const AT_ONCE: f64 = 0.6;
    pub(in crate::navigator) const ONCE_S: f64 = 0.35;
    /// Slower it harms nobody soon, m/s: receivers' velocities are biased by as much.
    pub(in crate::navigator) const LEAST_MPS: f64 = 0.3;
    /// A lie is not let go in its first moments, m.
    pub(in crate::navigator) const LEAST_LED_M: f64 = 10.0;
    /// It has ended where what is left of the step is this part of it, by what is known to this part of it, for so long, s.
    pub(in crate::navigator) const BACK: f64 = 0.5;
    pub(in crate::navigator) const KNOWN: f64 = 0.25;
    pub(in crate::navigator) const BACK_S: f64 = 3.0;
    /// How much a fix of another receiver counts of whether it shares a lie.
    pub(in crate::navigator) const SPARE_GAIN: f64 = 0.25;
}

/// The flow as a witness against GNSS.
pub(in crate::navigator) mod flow_travel {
    /// A calibration testifies when it is this old, s, and until it is twice as old.
    pub(in crate::navigator) const FREEZE_S: f64 = 30.0;
    /// A receiver that walks off faster than this is found by inertia, m/s.
    pub(in crate::navigator) const NO_WALK_MPS: f64 = 2.0;
    /// A longer silence of the flow is a hole, s.
    pub(in crate::navigator) const HOLE_S: f64 = 0.5;
}

/// How far a witness says that the vehicle has travelled.
pub(in crate::navigator) mod travel_path {
    /// So many velocities are remembered: 1.5 s at 75 Hz.
    pub(in crate::navigator) const REMEMBERED: usize = 128;
}

/// A receiver against such a witness, in blocks of time.
pub(in crate::navigator) mod witness_blocks {
    /// Both are compared by blocks of this, s.
    pub(in crate::navigator) const BLOCK_S: f64 = 0.95;
    /// Fixes further apart are not compared, s.
    pub(in crate::navigator) const FIX_HOLE_S: f64 = 2.5;
    /// Noise of a position, m², and its growth, m²/s, before they were seen; the least growth; how long what was seen counts, s; and over so many blocks each it is seen.
    pub(in crate::navigator) const START_VARIANCE: f64 = 0.1;
    pub(in crate::navigator) const START_GROWTH: f64 = 0.05;
    pub(in crate::navigator) const LEAST_GROWTH: f64 = 0.01;
    pub(in crate::navigator) const NOISE_MEMORY_S: f64 = 60.0;
    pub(in crate::navigator) const NOISE_SPANS: [usize; 3] = [1, 2, 4];
    /// A receiver that walks off does so with some metres a second.
    pub(in crate::navigator) const WALK_SIGMA_MPS: f64 = 5.0;
    /// What inertia suspects of a receiver is refuted or confirmed where witnesses find that so many times as likely, ln: a thousand.
    pub(in crate::navigator) const WITNESSES: f64 = 6.9;
}

/// The air as a witness against GNSS.
pub(in crate::navigator) mod gnss_by_air {
    /// A longer silence of the air is a hole, s: airspeeds come at some hertz, and some of them cannot be used.
    pub(in crate::navigator) const HOLE_S: f64 = 1.6;
    /// Between two fixes of a second the air itself may be wrong by so much, m: it is heard at some hertz, and in a turn that is too little.
    pub(in crate::navigator) const JUMP_M: f64 = 15.0;
    /// So many blocks are kept, and so many before and after an onset are looked at at most, and at least. What is usual is learned of so many on both sides.
    pub(in crate::navigator) const BLOCKS: usize = 80;
    pub(in crate::navigator) const BEFORE: usize = 24;
    pub(in crate::navigator) const AFTER: usize = 48;
    pub(in crate::navigator) const SIDE: usize = 16;
    pub(in crate::navigator) const LEAST_BEFORE: usize = 8;
    pub(in crate::navigator) const LEAST_AFTER: usize = 4;
    /// What the wind may be wrong by, m/s, an airspeed or a drag by scale, and its direction, rad.
    pub(in crate::navigator) const WIND_MPS: f64 = 20.0;
    pub(in crate::navigator) const SCALE: f64 = 0.1;
    pub(in crate::navigator) const TURN: f64 = 0.1;
    /// Normalised squares an axis before they were seen (1 for white noise), how firmly, how many windows count, and beyond what part of them, decades, none is usual.
    pub(in crate::navigator) const SPREAD: f64 = 3.0;
    pub(in crate::navigator) const FIRM: f64 = 6.0;
    pub(in crate::navigator) const MEMORY: f64 = 40.0;
    pub(in crate::navigator) const CLIPPED_DECADES: f64 = 5.0;
}

/// Motion as a witness of the heading.
pub(in crate::navigator) mod heading_witness {
    /// A window is at least and at most so long, s: long enough for the velocity to change, short enough for the bias of an accelerometer.
    pub(in crate::navigator) const SHORTEST_S: f64 = 0.9;
    pub(in crate::navigator) const LONGEST_S: f64 = 3.0;
    /// What was seen fades by 1/e in this time, s.
    pub(in crate::navigator) const FORGET_S: f64 = 30.0;
    /// So many windows before anything is said.
    pub(in crate::navigator) const LEAST_WINDOWS: f64 = 4.0;
    /// Changes of the velocity that are at least motion, m/s, root mean square, and their sum of squares, (m/s)².
    pub(in crate::navigator) const LEAST_CHANGE: f64 = 0.7;
    pub(in crate::navigator) const LEAST_SUM: f64 = 12.0;
    /// A heading is wrong when it is off by this much, rad, and by so many of its sigmas, and when the turn leaves less than this part of what
    /// did not fit.
    pub(in crate::navigator) const LEAST_TURN: f64 = 0.35;
    pub(in crate::navigator) const SIGNIFICANT: f64 = 4.0;
    pub(in crate::navigator) const UNEXPLAINED: f64 = 0.4;
    /// How well the rest is known when the heading was wrong: tilt, rad, gyro bias, rad/s, the velocity of a fix, m/s.
    pub(in crate::navigator) const TILT_SIGMA: f64 = 0.1;
    pub(in crate::navigator) const GYRO_BIAS_SIGMA: f64 = 0.005;
    pub(in crate::navigator) const SPEED_SIGMA: f64 = 0.7;
}

/// Witnesses of the IMU.
pub(in crate::navigator) mod inertia_witness {
    /// Inertia contradicts what is seen when they are apart by so many times what is usual in a window, and by no less than this, m/s²: a tilt that is
    /// off by 7°; and by this while what is usual is not known: 18°.
    pub(in crate::navigator) const TIMES_USUAL: f64 = 5.0;
    pub(in crate::navigator) const LEAST_MPS2: f64 = 1.2;
    pub(in crate::navigator) const UNKNOWN_MPS2: f64 = 3.0;
    /// What is usual is known after so many windows, and forgets by this part a window.
    pub(in crate::navigator) const USUAL_WINDOWS: u32 = 20;
    pub(in crate::navigator) const USUAL_GAIN: f64 = 0.02;
    pub(in crate::navigator) const UNUSUAL_GAIN: f64 = 0.002;
    /// Latency, scale and heading make this part of a motion be apart.
    pub(in crate::navigator) const EXPLAINED: f64 = 0.5;
    /// It is wrong when so many of so many windows say so, none of them older than this, s.
    pub(in crate::navigator) const WINDOWS: usize = 5;
    pub(in crate::navigator) const MOST_OF: usize = 4;
    pub(in crate::navigator) const MEMORY_S: f64 = 9.0;
    /// The barometer's long windows: at least and at most so long, s; so many, no older than this, s.
    pub(in crate::navigator) const SLOW_S: f64 = 3.0;
    pub(in crate::navigator) const SLOW_LONGEST_S: f64 = 4.5;
    pub(in crate::navigator) const SLOW_WINDOWS: usize = 2;
    pub(in crate::navigator) const SLOW_MEMORY_S: f64 = 9.5;
    /// A witness that accelerates by more than this between two of its own velocities is none, m/s²: small vehicles cannot, receivers that are
    /// lost do. Nor is one whose position moves otherwise than its velocity by this much in a window, m.
    pub(in crate::navigator) const FASTEST_MPS2: f64 = 20.0;
    pub(in crate::navigator) const STRAYS_M: f64 = 5.0;
    /// What the filter's own doubt of its tilt explains so many sigmas of, is no fault of the IMU's.
    pub(in crate::navigator) const TILT_SIGMAS: f64 = 2.0;
    /// An IMU that was contradicted is tried again after this long, s, and after twice as long each time that it fails, at most this long, s.
    pub(in crate::navigator) const FIRST_TRIAL_S: f64 = 10.0;
    pub(in crate::navigator) const LAST_TRIAL_S: f64 = 160.0;
    /// It passes a trial that was so long, s, and saw so much motion, a sum of squares, (m/s)².
    pub(in crate::navigator) const TRIAL_S: f64 = 10.0;
    pub(in crate::navigator) const TRIAL_MOTION: f64 = 12.0;
    /// A heading that has to be turned again within this, s, is not what is wrong.
    pub(in crate::navigator) const TURNED_S: f64 = 60.0;
    /// What it has done until it was found, s: a stuck axis, a contradicted one.
    pub(in crate::navigator) const STUCK_FOR_S: f64 = 0.5;
    pub(in crate::navigator) const WRONG_FOR_S: f64 = 5.0;
}

/// The magnetic field, of the gyros.
pub(in crate::navigator) mod gyro_by_field {
    /// A turn is looked at over at least this, s, and so many of them together; a longer hole ends the comparison, s.
    pub(in crate::navigator) const BLOCK_S: f64 = 0.095;
    pub(in crate::navigator) const BLOCKS: usize = 20;
    pub(in crate::navigator) const HOLE_S: f64 = 0.6;
    /// Mean square of what a block does not fit by, over the field's, at least, and the gain of its running mean, in which a block counts no more
    /// than so many times; what is found is beyond so many of its sigmas.
    pub(in crate::navigator) const LEAST_NOISE: f64 = 1e-4;
    pub(in crate::navigator) const CLIPPED: f64 = 4.0;
    pub(in crate::navigator) const NOISE_GAIN: f64 = 0.02;
    pub(in crate::navigator) const SIGMAS: f64 = 6.0;
    /// Gains that may be iron, latency, or a magnetometer that stands still (−1).
    pub(in crate::navigator) const SOUND: std::ops::RangeInclusive<f64> = -1.4..=0.7;
    /// What the axis should have turned the field by, rad, root of the sum of squares.
    pub(in crate::navigator) const LEAST_TURN: f64 = 0.2;
    /// The axis explains this part of what does not fit where it is found, and where it is suspected; one block is no more than this part of it.
    pub(in crate::navigator) const EXPLAINS: f64 = 0.75;
    pub(in crate::navigator) const SUSPECTED: f64 = 0.5;
    pub(in crate::navigator) const ONE_BLOCK: f64 = 0.5;
    /// A magnetometer that stands still leaves so many times as much unexplained.
    pub(in crate::navigator) const RIVAL: f64 = 2.0;
}

/// Jumps of the IMU's axes.
pub(in crate::navigator) mod inertia_jumps {
    /// They are looked for this often, s, and in windows that are at least so long, s.
    pub(in crate::navigator) const LOOK_S: f64 = 0.2;
    pub(in crate::navigator) const YOUNGEST_S: f64 = 1.0;
    /// What a jump explains, as a square of sigmas, before it was seen (1 for white noise), how firmly, how many count, one in so long, s.
    pub(in crate::navigator) const SPREAD: f64 = 2.0;
    pub(in crate::navigator) const FIRM: f64 = 12.0;
    pub(in crate::navigator) const MEMORY: f64 = 60.0;
    pub(in crate::navigator) const LEARN_S: f64 = 4.0;
    /// Slower turns make no errors that matter, rad/s.
    pub(in crate::navigator) const CALM: f64 = 0.15;
    /// Nothing is said before so many were seen in flight.
    pub(in crate::navigator) const LEARNED: u32 = 8;
    /// It has to last for this long, s: without GNSS, and with.
    pub(in crate::navigator) const LASTS_S: f64 = 0.4;
    pub(in crate::navigator) const LASTS_AIDED_S: f64 = 2.0;
    /// One has jumped beyond what would happen once in 10^10 windows, were what is usual normal (it has longer tails), and where that explains more than a rival does by so much, as a square of sigmas: a
    /// hundred times as likely.
    pub(in crate::navigator) const DECADES: f64 = 10.0;
    pub(in crate::navigator) const CLEAR_OF: f64 = 9.2;
    /// Before anything is seen no axis has jumped within these seconds: ln of the odds, once in a thousand windows.
    pub(in crate::navigator) const UNLIKELY: f64 = 6.9;
    /// Axes that nothing has been suspected of for this long are sound again, s.
    pub(in crate::navigator) const QUIET_S: f64 = 15.0;
    /// More jumps than this, each within this of the last, s, are no jumps.
    pub(in crate::navigator) const REPEATED: u32 = 4;
    pub(in crate::navigator) const REPEATED_S: f64 = 15.0;
}

/// A receiver whose lie all the innovations show: looked for as jumps of the IMU's axes are.
pub(in crate::navigator) mod receiver_lie {
    pub(in crate::navigator) use super::inertia_jumps::{
        CLEAR_OF, DECADES, FIRM, LEARN_S, LEARNED, LOOK_S, MEMORY, SPREAD, UNLIKELY, YOUNGEST_S,
    };
    /// It has to last for this long, s.
    pub(in crate::navigator) const LASTS_S: f64 = 1.0;
    /// A window that reaches back to where it began, to this, s, has to explain this part of what made it likely.
    pub(in crate::navigator) const STILL: f64 = 0.5;
    pub(in crate::navigator) const SAME_S: f64 = 0.3;
    /// A flow is heard while its newest velocity is no older than this, s.
    pub(in crate::navigator) const CARRIED_S: f64 = 1.0;
    /// Slower it harms nobody soon, m/s.
    pub(in crate::navigator) const LEAST_MPS: f64 = 0.25;
}

/// Dead reckoning.
pub(in crate::navigator) mod outage {
    /// What carries is told when it has carried for this long, s.
    pub(in crate::navigator) const TOLD_AFTER_S: f64 = 3.0;
}

/// What vehicles can do.
pub(in crate::navigator) mod plausibility {
    /// As a rule: a multirotor, m/s; at most, and a wing as a rule, m/s; a wing at most, m/s; on the surface, m/s; any, m/s. Over ground, with the wind.
    pub(in crate::navigator) const FLIES_MPS: f64 = 18.0;
    pub(in crate::navigator) const USUAL_MPS: f64 = 40.0;
    pub(in crate::navigator) const WING_MPS: f64 = 90.0;
    pub(in crate::navigator) const SURFACE_MPS: f64 = 20.0;
    pub(in crate::navigator) const MOST_MPS: f64 = 150.0;
    /// What has flown at a speed may fly at this many times that: against the wind and with it.
    pub(in crate::navigator) const SEEN_FACTOR: f64 = 1.5;
    /// Impossible is what is beyond by this many sigmas for this long, s.
    pub(in crate::navigator) const SIGMAS: f64 = 3.0;
    pub(in crate::navigator) const IMPOSSIBLE_S: f64 = 1.0;
}

/// What is published: glides and what counts as joined.
pub(in crate::navigator) mod published {
    /// The position has joined the estimate when it is this near, m.
    pub(in crate::navigator) const JOINED_M: f64 = 0.05;
    /// What single heights move the height by is shown over this time, s: enough that nothing steps, too little to lag.
    pub(in crate::navigator) const SMOOTHED_S: f64 = 0.25;
    /// A height whose distance to the estimate is below this has joined it, m.
    pub(in crate::navigator) const HEIGHT_JOINED_M: f64 = 1e-3;
    /// An origin that moved by less moves nobody, m.
    pub(in crate::navigator) const ORIGIN_MOVED_M: f64 = 0.01;
}

/// Where there was never any GNSS.
pub(in crate::navigator) mod relative {
    /// Where it begins is known to this, by definition, m.
    pub(in crate::navigator) const PLACE_SIGMA_M: f64 = 0.05;
    /// A flow sensor is there when it has been heard within this, s, whatever came of it.
    pub(in crate::navigator) const FLOW_HEARD_S: f64 = 1.0;
}

/// The IMU step.
pub(in crate::navigator) mod step {
    /// A step longer than this leaves room for what was not seen, s.
    pub(in crate::navigator) const LONG_STEP_S: f64 = 0.1;
    /// A magnetic field is held for this long, s, before it is turned with the vehicle.
    pub(in crate::navigator) const HELD_FIELD_S: f64 = 0.1;
}

/// The stream of the IMU.
pub(in crate::navigator) mod stream {
    /// Autopilots' IMUs measure up to 2000 °/s and 16 g; at their limits, less 1 %, they tell the limit and not the motion, rad/s and m/s².
    /// What is missed so is bridged by the samples around it, and where that takes too long, it is a hole in the stream.
    pub(in crate::navigator) const FULL_RATE: f64 = 34.55;
    pub(in crate::navigator) const FULL_FORCE: f64 = 155.3;
    /// Far beyond any sensor (m/s² or rad/s), and far from where squares overflow.
    pub(in crate::navigator) const POSSIBLE: f64 = 1e4;
    /// An IMU in the air that tells the same six numbers for this long is stuck, s.
    pub(in crate::navigator) const STUCK_S: f64 = 0.5;
    /// An axis is stuck when a run of equal values of its own would come with less than this probability, ln (once in 10^9 samples: years of
    /// flight), and lasts for this many samples, and so many times the longest run. Axes change with nearly every sample: no mean run is taken for
    /// shorter than this.
    pub(in crate::navigator) const AXIS_ALARM_LOG: f64 = -20.7;
    pub(in crate::navigator) const AXIS_LEAST_RUN: u32 = 10;
    pub(in crate::navigator) const AXIS_TIMES_LONGEST: u32 = 3;
    pub(in crate::navigator) const AXIS_SHORTEST_RUN: f64 = 1.05;
    /// A mean run is known after so many, and forgets by this part a run.
    pub(in crate::navigator) const AXIS_RUNS: u32 = 50;
    pub(in crate::navigator) const AXIS_RUN_GAIN: f64 = 0.01;
    /// A stuck axis that changes with this many samples in a row is sound.
    pub(in crate::navigator) const AXIS_MOVES: u32 = 10;
    /// A stream that goes on in the past for this long has another clock than it had, s.
    pub(in crate::navigator) const BEHIND_S: f64 = 0.2;
}

/// What is not known.
pub(in crate::navigator) mod uncertainty {
    /// Attitude uncertainty while aligning, rad.
    pub(in crate::navigator) const UNKNOWN_ATTITUDE: f64 = 0.5;
    /// Velocity uncertainty with GNSS, m/s.
    pub(in crate::navigator) const AIDED_VELOCITY_SIGMA: f64 = 0.15;
    /// What "not known" is in metres and m/s: for a solution that is still aligning.
    pub(in crate::navigator) const UNKNOWN_M: f64 = 1e4;
    pub(in crate::navigator) const UNKNOWN_MPS: f64 = 100.0;
}

/// What the vehicle says of itself.
pub(in crate::navigator) mod vehicle {
    /// A vehicle that is this fast, m/s, or this high above where it began, m, is in the air, whatever it says of its motors.
    pub(in crate::navigator) const FLYING_MPS: f64 = 3.0;
    pub(in crate::navigator) const FLYING_M: f64 = 3.0;
    /// Above the ground by more than this, m, is off it, whatever the altimeter's noise.
    pub(in crate::navigator) const IN_AIR_M: f64 = 1.0;
}
