//! Constants of the sources.

use crate::time::Span;

/// Every source.
pub(in crate::navigator) mod every_source {
    /// A source that has not been heard for this long is silent, s.
    pub(in crate::navigator) const SILENT_S: f64 = 3.0;
    /// What is set against the present may be this old, s.
    pub(in crate::navigator) const LATE_S: f64 = 0.5;
}

/// Airspeed.
pub(in crate::navigator) mod airspeed {
    /// One that tells exactly the same for this long is stuck, s.
    pub(in crate::navigator) const STUCK_S: f64 = 3.0;
    /// Noise is stated for samples this far apart, s: gusts last, and more samples tell no more.
    pub(in crate::navigator) const SAMPLE_INTERVAL_S: f64 = 0.2;
    /// What tells more than the speed of sound is no pitot tube of a vehicle's, m/s.
    pub(in crate::navigator) const MOST_MPS: f64 = 340.0;
    /// Beyond this load a wing does not fly nose first, in g.
    pub(in crate::navigator) const MAX_LOAD_G: f64 = 2.5;
    /// An airspeed carries the velocity for this long, s.
    pub(in crate::navigator) const CARRIES_S: f64 = 2.0;
    /// It deviates from what is expected of it by the mean of this long, s, after a gap of no more than this, s; what it has moved that by is
    /// remembered for this long, s, and it lasts at the mean of this long, s. Usual deviations are known after this long, s, and forgotten in this, s; what was taken for usual before counts as
    /// much as this long of them, s.
    pub(in crate::navigator) const MEAN_S: f64 = 1.0;
    pub(in crate::navigator) const MOVED_S: f64 = 5.0;
    pub(in crate::navigator) const LASTING_S: f64 = 20.0;
    /// What is beyond this part of its limit (3 of its 4 sigmas) teaches no more than that.
    pub(in crate::navigator) const LEARNED: f64 = 0.75;
    pub(in crate::navigator) const PRIOR_S: f64 = 3.0;
    pub(in crate::navigator) const LONGEST_GAP_S: f64 = 1.0;
    pub(in crate::navigator) const USUAL_S: f64 = 10.0;
    pub(in crate::navigator) const SPREAD_S: f64 = 120.0;
    /// It is astray beyond so many sigmas of the deviation, and of the scale's prior, for this long, s.
    pub(in crate::navigator) const SIGMAS: f64 = 4.0;
    pub(in crate::navigator) const SCALE_SIGMAS: f64 = 3.0;
    pub(in crate::navigator) const STANDS_S: f64 = 1.0;
    /// It is back within so many sigmas for this long, s; without GNSS only while they are less than this part of what it was astray by.
    pub(in crate::navigator) const BACK_SIGMAS: f64 = 2.0;
    pub(in crate::navigator) const BACK_S: f64 = 5.0;
    pub(in crate::navigator) const BACK: f64 = 0.5;
    /// How it parted from inertia is seen in so many means over so long, s.
    pub(in crate::navigator) const POINTS: usize = 24;
    pub(in crate::navigator) const POINT_S: f64 = 0.5;
    /// Another wind is believed where it is known to this, m/s.
    pub(in crate::navigator) const WIND_KNOWN_MPS: f64 = 1.0;
}

/// Barometers.
pub(in crate::navigator) mod barometer {
    /// A pressure is carried to the present for this long, s.
    pub(in crate::navigator) const LATE_S: f64 = 0.6;
    /// A barometer that is silent for this long has left its place to another, s.
    pub(in crate::navigator) const SILENCE_S: f64 = 10.0;
    /// A barometer that tells exactly the same for this long, s, while the vehicle has climbed by this much, m, is stuck.
    pub(in crate::navigator) const STUCK_S: f64 = 1.0;
    pub(in crate::navigator) const STUCK_CLIMB_M: f64 = 1.5;
    /// So is one that tells the same for this long, s, and so many times longer than it ever has, once it was heard for this long, s.
    pub(in crate::navigator) const UNUSUAL_S: f64 = 3.0;
    pub(in crate::navigator) const UNUSUAL: f64 = 4.0;
    pub(in crate::navigator) const KNOWN_S: f64 = 30.0;
    /// What it tells so many times longer than it ever has, and for this long, s, is not used any more: a height that is kept while the vehicle climbs takes the climb away.
    pub(in crate::navigator) const DOUBTFUL: f64 = 2.0;
    pub(in crate::navigator) const DOUBTFUL_S: f64 = 0.3;
}

/// Rotor drag.
pub(in crate::navigator) mod drag {
    /// The force is averaged over this long, s.
    pub(in crate::navigator) const PERIOD_S: f64 = 0.1;
    /// Innovations are averaged over this long, s, their mean square over this long, s, …
    pub(in crate::navigator) const MEAN_S: f64 = 5.0;
    pub(in crate::navigator) const SPREAD_S: f64 = 60.0;
    /// … and what they show lasts this long, s.
    pub(in crate::navigator) const LASTING_S: f64 = 30.0;
    /// What is configured counts as if it had been measured for this long, s, and what was learned on an earlier flight for this long.
    pub(in crate::navigator) const ASSUMED_S: f64 = 20.0;
    pub(in crate::navigator) const RECALLED_S: f64 = 20.0;
    /// However well it fitted, the force is wrong by this for half a minute, m/s² (vibration, tilt of the rotors), and the wind by this, m/s.
    pub(in crate::navigator) const LEAST_LASTING_MPS2: f64 = 0.05;
    pub(in crate::navigator) const LEAST_GUST_MPS: f64 = 0.15;
    /// As a witness it is asked for the mean of this long, s: as old as the middle of the flows that it is asked about. And by the wind of so long before, s.
    pub(in crate::navigator) const LATELY_S: f64 = 0.6;
    pub(in crate::navigator) const WIND_KEPT_S: f64 = 5.0;
    /// Drag carries the velocity for this long, s, …
    pub(in crate::navigator) const AGE_S: f64 = 1.0;
    /// … and when it is there at all, 1/s, and known this many times better than it is large.
    pub(in crate::navigator) const LEAST_DRAG: f64 = 0.05;
    pub(in crate::navigator) const KNOWN: f64 = 4.0;
}

/// Optical flow.
pub(in crate::navigator) mod flow {
    /// Sensors (or cameras of patches) that are told apart.
    pub(in crate::navigator) const MAX_SENSORS: usize = 8;
    /// Flow innovations beyond this many sigmas are outliers …
    pub(in crate::navigator) const GATE_SIGMA: f64 = 5.0;
    /// … unless they go on for this long, s: then it is the velocity that is wrong.
    pub(in crate::navigator) const RELOCK_S: f64 = 1.0;
    /// No camera sees the ground move faster, rad/s.
    pub(in crate::navigator) const FASTEST_RADPS: f64 = 100.0;
    /// Nor does one of ten thousand pixels of a radian.
    pub(in crate::navigator) const FASTEST_UNITS: f64 = 1e6;
    /// A sensor's own gyro is compared with the vehicle's over this long, s: its bias follows the temperature.
    pub(in crate::navigator) const GYRO_OFFSET_S: f64 = 60.0;
    /// How well the vehicle's own gyro bias is known, rad/s, 1 sigma.
    pub(in crate::navigator) const GYRO_OFFSET_SIGMA: f64 = 0.003;
    /// A flow that tells the same for this long is stuck, s.
    pub(in crate::navigator) const STUCK_S: f64 = 0.3;
    /// What a camera turns by while the flow tells zero is forgotten in this time, s.
    pub(in crate::navigator) const ZERO_MEMORY_S: f64 = 1.0;
    /// So many repeats are expected of as many that are none before a sensor has shown how often it repeats itself; so many samples are
    /// remembered; and what happens once in this many decades of runs is no accident.
    pub(in crate::navigator) const REPEATS_PRIOR: f64 = 5.0;
    pub(in crate::navigator) const REPEATS_MEMORY: f64 = 4000.0;
    pub(in crate::navigator) const REPEATS_DECADES: f64 = 6.0;
    /// The calibration that is returned to is as old as this at least, s: a wrong flow is found within that.
    pub(in crate::navigator) const CALIBRATION_KEPT_S: f64 = 5.0;
    /// A rangefinder is lost, or back, when it has been for this long, s.
    pub(in crate::navigator) const OTHERWISE_S: f64 = 0.5;
    /// Rotor drag speaks for a flow and against inertia where the squares of the deviations differ by so much (2 sigma).
    pub(in crate::navigator) const SPEAKS: f64 = 4.0;
    /// A flow that has gone astray is back when it is nearer to the filter's velocity, in the mean over this long, s, than this part of the most
    /// that it had gone.
    pub(in crate::navigator) const OFF_S: f64 = 2.0;
    /// … which has to be known to this part of it, without a step back.
    pub(in crate::navigator) const KNOWN: f64 = 0.25;
    pub(in crate::navigator) const BACK: f64 = 0.5;
    /// The latency's effect is looked at over this step, s: some samples of a slow IMU stream.
    pub(in crate::navigator) const LATENCY_STEP_S: f64 = 0.04;
    /// The interval taken for the first sample, and the longest that a sample may stand for, s.
    pub(in crate::navigator) const FIRST_INTERVAL_S: f64 = 0.05;
    pub(in crate::navigator) const LONGEST_INTERVAL_S: f64 = 1.0;
    /// What the observers' signal is wrong by beyond the flow's noise, m/s, squared.
    pub(in crate::navigator) const SIGNAL_VARIANCE: f64 = 1.0;
}

/// A flow in a unit of the sensor's own.
pub(in crate::navigator) mod flow_unit {
    /// How late it may be, s.
    pub(in crate::navigator) const AGES_S: [f64; 5] = [0.0, 0.07, 0.14, 0.21, 0.28];
    /// The unit is known where it explains this part of the flow and its relative error, 1 sigma, is below this: the calibration takes the rest.
    pub(in crate::navigator) const EXPLAINS: f64 = 0.5;
    pub(in crate::navigator) const KNOWN: f64 = 0.05;
    /// What it does not explain (gusts of the filter, height of the ground) lasts this long, s; it is listened to for this long at least, s, and
    /// remembered for this long, s.
    pub(in crate::navigator) const LASTING_S: f64 = 0.5;
    pub(in crate::navigator) const MEMORY_S: f64 = 10.0;
    pub(in crate::navigator) const LONGEST_S: f64 = 120.0;
}

/// Patches of one image.
pub(in crate::navigator) mod flow_image {
    use super::Span;

    /// Stamps that lie this close are of the same image.
    pub(in crate::navigator) const TOGETHER: Span = Span::from_millis(2);
    /// The rest of an image is waited for this long after its first patch came.
    pub(in crate::navigator) const WAIT: Span = Span::from_millis(30);
    /// Beyond this ratio of the best observed direction to the worst the climb rate is the better third component.
    pub(in crate::navigator) const MAX_DILUTION: f64 = 8.0;
}

/// A flow as a velocity.
pub(in crate::navigator) mod flow_measure {
    /// The interval that a flow rate without one is taken over, s.
    pub(in crate::navigator) const RATE_INTERVAL_S: f64 = 0.05;
    /// How far a flow message's own distance may be from the height over ground, m, and as a part of it.
    pub(in crate::navigator) const DISTANCE_TOLERANCE_M: f64 = 1.5;
    pub(in crate::navigator) const DISTANCE_TOLERANCE: f64 = 0.3;
    /// Standard deviation of the height filter's climb rate, m/s.
    pub(in crate::navigator) const CLIMB_SIGMA_MPS: f64 = 0.3;
    /// A distance is never doubted by more than this part of itself.
    pub(in crate::navigator) const LARGEST_DOUBT: f64 = 2.0;
    /// Distance noise, m: the calibration learns the scale.
    pub(in crate::navigator) const DISTANCE_SIGMA_M: f64 = 0.05;
}

/// Flow against inertia.
pub(in crate::navigator) mod flow_witness {
    /// Means are taken over this long, s; so many of them are kept, …
    pub(in crate::navigator) const BLOCK_S: f64 = 0.25;
    pub(in crate::navigator) const BLOCKS: usize = 24;
    /// … and the median of so many is compared: a disturbance of half a second is none.
    pub(in crate::navigator) const GROUP: usize = 5;
    /// Inertia is asked over no more than this, s.
    pub(in crate::navigator) const LONGEST_S: f64 = 6.0;
    /// What any flow's scale is off by from one ground to the next.
    pub(in crate::navigator) const SCALE: f64 = 0.05;
    /// Square over its variance beyond which a difference is no accident (two axes, 5 sigma: one in 270 000), and below which it fits (95 %
    /// of those that fit are below 6).
    pub(in crate::navigator) const CONTRADICTS: f64 = 25.0;
    pub(in crate::navigator) const FIT: f64 = 9.0;
    /// What lies between adds up: so much of it, over the time of a group of blocks, is no accident, either.
    pub(in crate::navigator) const EVIDENCE: f64 = 12.0;
    /// The factor on the variance before it was seen, how long that counts, s, the least that is believed, the time over which it is learned, s, and how much one difference counts at most.
    pub(in crate::navigator) const MISFIT: f64 = 2.0;
    pub(in crate::navigator) const PRIOR_S: f64 = 3.0;
    pub(in crate::navigator) const LEAST_MISFIT: f64 = 0.25;
    pub(in crate::navigator) const LEARNED_S: f64 = 30.0;
    pub(in crate::navigator) const CLIPPED: f64 = 4.0;
    /// An accused flow is believed again when it has fitted for this long, s, and for so much of it inertia would have contradicted a zero.
    pub(in crate::navigator) const FOLLOWED_S: f64 = 4.0;
    pub(in crate::navigator) const MOVED_S: f64 = 1.0;
    /// Thrust without the sideways axes leaves less than this part of what they are apart by.
    pub(in crate::navigator) const BY_THRUST: f64 = 0.5;
}

/// How two velocities parted.
pub(in crate::navigator) mod parting {
    /// Points before the onset, and since.
    pub(in crate::navigator) const BEFORE: usize = 3;
    pub(in crate::navigator) const POINTS_SINCE: usize = 3;
    /// One way of parting explains more than another by so much, as a square of sigmas: a hundred times as likely.
    pub(in crate::navigator) const CLEAR_OF: f64 = 9.2;
    /// What scatters by this more, as a square, since they have parted is a sensor's noise: three times.
    pub(in crate::navigator) const NOISIER: f64 = 9.0;
    /// Inertia leads away over no less than so many points.
    pub(in crate::navigator) const LEADS_POINTS: usize = 5;
    /// No velocity is better than this, as a square, (m/s)²; what keeps least squares regular where nothing moves.
    pub(in crate::navigator) const LEAST_SQUARE: f64 = 1e-4;
    pub(in crate::navigator) const RIDGE: f64 = 1e-9;
    /// Inertia has led away for this long, at least, s.
    pub(in crate::navigator) const DOUBTED_S: f64 = 0.5;
}

/// Whether a distance follows the height.
pub(in crate::navigator) mod following {
    /// What is remembered, s.
    pub(in crate::navigator) const MEMORY_S: f64 = 20.0;
    /// A height that has varied by less tells nothing, variance in m².
    pub(in crate::navigator) const TELLS_M2: f64 = 1.0;
    /// var(r − h)/var(h) above which the distance does not follow, and below which it does again.
    pub(in crate::navigator) const ASTRAY: f64 = 0.5;
    pub(in crate::navigator) const FOLLOWS: f64 = 0.2;
}

/// A receiver that holds its course.
pub(in crate::navigator) mod held_course {
    /// A course that is repeated so often with another speed is held.
    pub(in crate::navigator) const FIXES: u32 = 2;
    /// Slower, m/s, its direction does not matter; faster, no receiver holds it, and one that rounds repeats it on every straight leg.
    pub(in crate::navigator) const SLOWEST_MPS: f64 = 0.3;
    pub(in crate::navigator) const FASTEST_MPS: f64 = 3.0;
}

/// GNSS receivers.
pub(in crate::navigator) mod gnss {
    /// Another receiver takes over when the one in use had no fix for this long, s.
    pub(in crate::navigator) const RECEIVER_SILENCE_S: f64 = 1.0;
    /// Two receivers are expected to be this far apart, m, before they have shown it, and how firmly; so many looks count, this far apart, s.
    pub(in crate::navigator) const AGREE_M: f64 = 1.5;
    pub(in crate::navigator) const AGREE_FIRM: f64 = 8.0;
    pub(in crate::navigator) const AGREE_MEMORY: f64 = 60.0;
    pub(in crate::navigator) const AGREE_EVERY_S: f64 = 5.0;
    /// One of them lies beyond what happens once in 10^6 looks, and beyond so many sigmas of what they claim.
    pub(in crate::navigator) const AGREE_DECADES: f64 = 6.0;
    pub(in crate::navigator) const AGREE_SIGMA: f64 = 3.0;
    /// … for this long, s: what fails by itself is found sooner.
    pub(in crate::navigator) const AGREE_FOR_S: f64 = 2.0;
    /// A receiver's speed is not believed better than this, m/s.
    pub(in crate::navigator) const LEAST_SPEED_SIGMA: f64 = 0.15;
    /// On the way back a speed without a claim is known to this, m/s.
    pub(in crate::navigator) const UNCLAIMED_SPEED_SIGMA: f64 = 0.3;
    /// The latency of a fix varies by this much, s: at speed, a distance.
    pub(in crate::navigator) const LATENCY_JITTER_S: f64 = 0.1;
    /// Vertical over horizontal accuracy of a receiver that claims none.
    pub(in crate::navigator) const VERTICAL_RATIO: f64 = 1.5;
    /// A filter that knows its velocity no better than this, m/s, is what is wrong where a fix does not fit.
    pub(in crate::navigator) const DOUBTFUL_MPS: f64 = 1.0;
    /// What a receiver claims is followed by this part a fix.
    pub(in crate::navigator) const CLAIM_GAIN: f64 = 0.1;
}

/// Noise of accelerometers beside GNSS.
pub(in crate::navigator) mod inertial_noise {
    /// Velocities are compared from fix to fix and over this long, s: a filter with GNSS remembers its velocity no longer.
    pub(in crate::navigator) const LAGS_S: [f64; 2] = [0.5, 2.0];
    /// What was seen fades within this, s.
    pub(in crate::navigator) const MEMORY_S: f64 = 30.0;
    /// Noise of a receiver's velocity before any was seen, m/s.
    pub(in crate::navigator) const RECEIVER_MPS: f64 = 0.1;
    /// Accelerometers are never taken to be worse than this, m/s²/√Hz.
    pub(in crate::navigator) const MOST_ACCEL: f64 = 3.0;
    /// Nor a receiver's velocity worse than this, m/s: then it is not noise that parts the two.
    pub(in crate::navigator) const MOST_MPS: f64 = 1.0;
    /// So much motion, (m/s)², is needed before it says half of a turn of the heading.
    pub(in crate::navigator) const UNTURNED: f64 = 0.25;
}

/// Noise of magnetometers.
pub(in crate::navigator) mod magnetic_noise {
    /// Fields this far apart are compared, s, and over this long, s: currents follow the throttle, and gyros hold a heading well for longer.
    pub(in crate::navigator) const SPACING_S: f64 = 0.09;
    pub(in crate::navigator) const LAGS_S: [f64; 2] = [2.0, 10.0];
    /// What was seen fades within this, s.
    pub(in crate::navigator) const MEMORY_S: f64 = 120.0;
    /// No magnetometer is believed better than this, T: what such sensors resolve. Its bias walks by at least and at most this, T/√s.
    pub(in crate::navigator) const LEAST_T: f64 = 0.2e-6;
    pub(in crate::navigator) const LEAST_WALK: f64 = 0.02e-6;
    pub(in crate::navigator) const MOST_WALK: f64 = 20e-6;
}

/// The magnetometer's latency.
pub(in crate::navigator) mod magnetic_latency {
    /// What is not known of it before the vehicle has turned, s: averages and buses of autopilots; by how much it scatters, and what turning that weighs as much
    /// as that, rad²/s².
    pub(in crate::navigator) const SIGMA_S: f64 = 0.1;
    pub(in crate::navigator) const SCATTER_S: f64 = 0.03;
    pub(in crate::navigator) const SCATTER_AFTER: f64 = 0.5;
    /// The turning that is remembered, rad²/s², and how many times its scatter a field counts.
    pub(in crate::navigator) const SCATTER_MEMORY: f64 = 20.0;
    pub(in crate::navigator) const CLIPPED: f64 = 4.0;
    /// It scatters by no less than this, s.
    pub(in crate::navigator) const LEAST_SCATTER_S: f64 = 0.005;
    /// No magnetometer is older than this, s.
    pub(in crate::navigator) const LONGEST_S: f64 = 0.3;
    /// The derivative is taken over this, s.
    pub(in crate::navigator) const SLOPE_S: f64 = 0.04;
    /// Only a change of the rate by which the field turns of at least this much teaches anything, rad/s.
    pub(in crate::navigator) const LEAST_CHANGE: f64 = 0.05;
    /// A field later than usual by more than so many sigmas is none.
    pub(in crate::navigator) const SIGMAS: f64 = 3.0;
}

/// Landmarks.
pub(in crate::navigator) mod landmarks {
    /// The filter is carried on in steps of this, s: at fast streams several samples at once.
    pub(in crate::navigator) const PUSH_S: f64 = 0.009;
    /// A sighting may overtake the IMU stream by this much, s, …
    pub(in crate::navigator) const AHEAD_S: f64 = 0.5;
    /// … and so many of them may wait.
    pub(in crate::navigator) const HELD: usize = 64;
    /// Nothing was seen for this long, s: the filter begins anew where the navigator believes to be, for what it knows has drifted away.
    pub(in crate::navigator) const BLIND_S: f64 = 5.0;
    /// The least that a guess for the filter may be off, m and rad.
    pub(in crate::navigator) const GUESS_M: f64 = 0.5;
    pub(in crate::navigator) const GUESS_RAD: f64 = 0.05;
    /// Beyond the field, m: from how far away it may be seen when nothing is known.
    pub(in crate::navigator) const AROUND_M: f64 = 30.0;
}

/// The pose that landmarks give.
pub(in crate::navigator) mod landmark_pose {
    /// The pose is looked at this often, s.
    pub(in crate::navigator) const PERIOD_S: f64 = 0.2;
    /// A pose without a sighting for this long is dead reckoning, s.
    pub(in crate::navigator) const FRESH_S: f64 = 1.0;
    /// Landmarks are found when their pose counts for this long, s, and lost when it does not for as long.
    pub(in crate::navigator) const FOUND_S: f64 = 1.0;
    pub(in crate::navigator) const LOST_S: f64 = 2.0;
    /// A heading is not believed better than this, rad: mounting.
    pub(in crate::navigator) const LEAST_HEADING: f64 = 0.004;
    /// A pose further away than this many sigmas of what drift and landmarks may be off by …
    pub(in crate::navigator) const GATE_SIGMA: f64 = 4.0;
    /// … is believed when it has stood for this long, s.
    pub(in crate::navigator) const BELIEVED_S: f64 = 10.0;
    /// Poses that the filter will not have for this long mean that the filter is wrong, s.
    pub(in crate::navigator) const LOCKED_OUT_S: f64 = 3.0;
    /// Landmarks and GNSS contradict each other when they are this many sigmas apart, and this far, m, …
    pub(in crate::navigator) const APART_SIGMA: f64 = 3.0;
    pub(in crate::navigator) const APART_M: f64 = 2.0;
    /// … for this long, s. Who is apart has to come well within the limit to agree.
    pub(in crate::navigator) const APART_S: f64 = 5.0;
    pub(in crate::navigator) const AGREE: f64 = 0.7;
}

/// The frame of the landmarks.
pub(in crate::navigator) mod landmark_relation {
    /// What was learned longer ago than this counts 1/e, s.
    pub(in crate::navigator) const MEMORY_S: f64 = 300.0;
    /// The relation is known when it was learned for this long, s.
    pub(in crate::navigator) const LEARNED_S: f64 = 20.0;
}

/// Latencies.
pub(in crate::navigator) mod latency {
    /// Latencies do not change much in flight: walk of the estimate, s² an observation.
    pub(in crate::navigator) const WALK: f64 = 1e-8;
    /// A residual is believed up to this many sigmas of its noise …
    pub(in crate::navigator) const GATE_SIGMA: f64 = 4.0;
    /// … and as much more as this misjudgement explains, s.
    pub(in crate::navigator) const GATE_S: f64 = 0.3;
    /// Only a change of the acceleration of at least this much teaches anything, m/s².
    pub(in crate::navigator) const LEAST_CHANGE: f64 = 0.5;
    /// Length of a block, s.
    pub(in crate::navigator) const BLOCK_S: f64 = 0.2;
    /// A block is compared with the one so many before it: a second, in which the acceleration has changed.
    pub(in crate::navigator) const LAG: usize = 5;
    /// Blocks further apart are not compared, s.
    pub(in crate::navigator) const BLOCKS_APART_S: f64 = 3.0;
    /// Noise of the velocity that GNSS gives over a block, m/s: what is not flow's own.
    pub(in crate::navigator) const REFERENCE_NOISE: f64 = 0.1;
    /// Flow's noise is averaged by no more samples than this: it is not white.
    pub(in crate::navigator) const INDEPENDENT: f64 = 3.0;
    /// No flow sensor is older than this, s.
    pub(in crate::navigator) const LONGEST_FLOW_S: f64 = 0.3;
}

/// How old a fix is.
pub(in crate::navigator) mod gnss_latency {
    /// A window is this long, s, and holds so many fixes; a longer silence ends it, s.
    pub(in crate::navigator) const WINDOW_S: f64 = 6.0;
    pub(in crate::navigator) const LEAST_FIXES: u32 = 8;
    pub(in crate::navigator) const WINDOW_HOLE_S: f64 = 2.5;
    /// The derivative of what was felt is a difference over so long before and after, s: no longer than the latencies that are to be told apart, and some samples of a slow IMU.
    pub(in crate::navigator) const SLOPE_S: f64 = 0.1;
    /// Noise of the difference, at least, m/s: receivers round.
    pub(in crate::navigator) const LEAST_NOISE_MPS: f64 = 0.05;
    /// A window tells something where this part of what it seems to tell is motion.
    pub(in crate::navigator) const LEAST_TOLD: f64 = 0.3;
    /// What is expected besides, 1 sigma: an offset, m/s, and an acceleration that tilt and biases make, m/s², on both axes; a heading that is off, rad, a scale; and of the
    /// delay nothing is, s.
    pub(in crate::navigator) const NUISANCE_SIGMA: [f64; 7] = [10.0, 10.0, 1.0, 1.0, 0.3, 0.05, 10.0];
    /// By how much windows scatter beyond what they claim, as a variance, before that was seen, how firmly, in windows, and how many count.
    pub(in crate::navigator) const EXPECTED: f64 = 4.0;
    pub(in crate::navigator) const FIRM: f64 = 4.0;
    pub(in crate::navigator) const MEMORY: f64 = 60.0;
    /// A window counts for no more than so many sigmas.
    pub(in crate::navigator) const CLIPPED_SIGMA: f64 = 3.0;
    /// Latencies do not change much in flight: walk of the estimate, s² a window.
    pub(in crate::navigator) const WALK: f64 = 1e-7;
    /// No receiver is older than this, s.
    pub(in crate::navigator) const LONGEST_S: f64 = 0.5;
}

/// Magnetometers.
pub(in crate::navigator) mod magnetometer {
    /// A magnetometer that tells the same for this long, s (a slow one is told several times), while the vehicle has turned by this much, rad,
    /// beyond this rate, rad/s (or that, while the gyros' bias is not known: a cheap one's after its calibration at boot), within so long, s, is stuck.
    pub(in crate::navigator) const STUCK_S: f64 = 0.3;
    pub(in crate::navigator) const STUCK_TURN: f64 = 0.03;
    pub(in crate::navigator) const STUCK_RATE: f64 = 0.02;
    pub(in crate::navigator) const STUCK_UNKNOWN_RATE: f64 = 0.1;
    pub(in crate::navigator) const STUCK_LOOK_S: f64 = 2.0;
    /// A field that dips more or less than Earth's by this much, rad, in the mean over this long, s (and no less than that long), is bent by
    /// something on the vehicle. Before there is a filter, down is what accelerometers feel whose force is gravity's within this part.
    pub(in crate::navigator) const LARGEST_DIP: f64 = 0.26;
    pub(in crate::navigator) const DIP_MEAN_S: f64 = 10.0;
    pub(in crate::navigator) const DIP_LEAST_S: f64 = 1.0;
    pub(in crate::navigator) const FEELS_GRAVITY: f64 = 0.05;
    /// One that motion has contradicted is believed again when it shows the heading within this, rad, for this long, s.
    pub(in crate::navigator) const AGREES: f64 = 0.2;
    pub(in crate::navigator) const AGREES_S: f64 = 30.0;
}

/// The magnetometer against the gyros.
pub(in crate::navigator) mod compass_step {
    /// Their headings part when they are so many sigmas of what is usual from each other, and no less than this, rad: what tilt and currents make
    /// of a sound one. What is usual is learned where its latency makes less than this of a turn, rad.
    pub(in crate::navigator) const SIGMAS: f64 = 5.0;
    pub(in crate::navigator) const LEAST_STEP: f64 = 0.2;
    pub(in crate::navigator) const CALM: f64 = 0.1;
    /// So much of it has to come between two samples.
    pub(in crate::navigator) const SHARP: f64 = 0.6;
    /// It has to stand for so long, s.
    pub(in crate::navigator) const STANDS_S: f64 = 0.5;
    /// One that came little by little has to for this long, s: by then a gyro would be found to be wrong.
    pub(in crate::navigator) const SOFT_STANDS_S: f64 = 3.0;
    /// A step takes no longer than this, s.
    pub(in crate::navigator) const BEFORE_S: f64 = 0.5;
    /// A turn hides one if it takes so long, s; one that takes longer is none that gyros could bridge. What is found over a turn is more than iron makes of
    /// another heading, rad, and than gyros drift, rad/s.
    pub(in crate::navigator) const TURN_S: f64 = 0.7;
    pub(in crate::navigator) const TURNS_S: f64 = 15.0;
    pub(in crate::navigator) const LEAST_TURN_STEP: f64 = 0.3;
    /// … and than so many sigmas of what is usual within a moment.
    pub(in crate::navigator) const TURN_SIGMAS: f64 = 4.0;
    pub(in crate::navigator) const DRIFT_RADPS: f64 = 0.01;
    /// What is usual: a spread over this long, s, known after this long, s.
    pub(in crate::navigator) const SPREAD_S: f64 = 60.0;
    pub(in crate::navigator) const USUAL_S: f64 = 10.0;
    /// A magnetometer that was silent for longer begins anew, s.
    pub(in crate::navigator) const LONGEST_GAP_S: f64 = 3.0;
    /// A heading that is not known to this, rad, judges none.
    pub(in crate::navigator) const KNOWN_YAW: f64 = 0.2;
}

/// A rangefinder.
pub(in crate::navigator) mod rangefinder {
    /// Steepest tilt at which a range beam still measures the height over ground: cos 60°.
    pub(in crate::navigator) const MIN_COSINE: f64 = 0.5;
    /// Whether a distance follows the height is judged where the vehicle leans by less: cos 18°.
    pub(in crate::navigator) const LEVEL_COSINE: f64 = 0.95;
    /// The ground may step by this much, m, or this part of the height over it, from one sample to the next …
    pub(in crate::navigator) const GROUND_STEP_M: f64 = 1.0;
    pub(in crate::navigator) const GROUND_STEP_FRACTION: f64 = 0.2;
    /// … and by more when it stays there for this long, s, while the vehicle climbs or sinks by this much, m: a roof or a cliff stays where it
    /// is, an echo of something else moves with the vehicle.
    pub(in crate::navigator) const GROUND_BELIEVED_S: f64 = 5.0;
    pub(in crate::navigator) const GROUND_TELLS_M: f64 = 1.5;
    /// The ground moves below a vehicle by this much, m/s, and this much over the horizontal speed: what the altimeter drifts, and terrain.
    pub(in crate::navigator) const GROUND_RATE_MPS: f64 = 0.3;
    pub(in crate::navigator) const GROUND_SLOPE: f64 = 0.3;
    /// Over a longer silence it is not followed, s.
    pub(in crate::navigator) const FOLLOW_STEP_S: f64 = 0.5;
    /// One that tells exactly the same for this long, s, while its beam becomes longer or shorter by this much, m, is stuck.
    pub(in crate::navigator) const STUCK_S: f64 = 1.0;
    pub(in crate::navigator) const STUCK_M: f64 = 0.5;
    /// Heights drift by this much, m/s, while nothing moves: GNSS by some metres within minutes.
    pub(in crate::navigator) const STUCK_DRIFT_MPS: f64 = 0.02;
    /// A height that was told longer ago than this is no witness, s: receivers tell one a second.
    pub(in crate::navigator) const WITNESS_S: f64 = 1.2;
    /// What a source tells speaks for a distance within this part of what the altimeter does.
    pub(in crate::navigator) const WITNESSED: f64 = 0.5;
    /// Up to so many times its least distance a vehicle may stand.
    pub(in crate::navigator) const STANDS: f64 = 1.2;
    /// A dispute whose last word is older than this is over, s.
    pub(in crate::navigator) const DISPUTE_S: f64 = 1.0;
    /// Where no other height was heard for this long, s, they are heights at any distance.
    pub(in crate::navigator) const ONLY_S: f64 = 3.0;
    /// Distances are heights this often, s, and known to this part of themselves.
    pub(in crate::navigator) const HEIGHT_PERIOD_S: f64 = 0.1;
    pub(in crate::navigator) const RELATIVE_SIGMA: f64 = 0.03;
    /// At their limits sensors report the limit: this near to the least and the greatest they are not believed.
    pub(in crate::navigator) const NEAR_LEAST: f64 = 1.05;
    pub(in crate::navigator) const NEAR_GREATEST: f64 = 0.98;
}

/// Rangefinders and their spare.
pub(in crate::navigator) mod rangefinders {
    /// The spare takes over when the first has been silent for this long, s.
    pub(in crate::navigator) const SILENCE_S: f64 = 1.0;
}

/// The place of take-off.
pub(in crate::navigator) mod takeoff {
    /// How well the ground's height is known there, m: ground effect and the altimeter's drift; and the terrain's slope around.
    pub(in crate::navigator) const GROUND_SIGMA_M: f64 = 0.7;
    pub(in crate::navigator) const TERRAIN_SLOPE: f64 = 0.05;
}

/// Standing still.
pub(in crate::navigator) mod standstill {
    /// A quiet IMU: no faster than this, rad/s …
    pub(in crate::navigator) const QUIET_RATE: f64 = 0.1;
    /// … with a specific force this near to gravity, m/s² …
    pub(in crate::navigator) const QUIET_FORCE: f64 = 0.6;
    /// … for this long, s.
    pub(in crate::navigator) const QUIET_S: f64 = 1.0;
    /// A standstill is fused this often, s.
    pub(in crate::navigator) const PERIOD_S: f64 = 0.2;
    /// How still a standstill is, m/s and rad/s.
    pub(in crate::navigator) const SIGMA_MPS: f64 = 0.1;
    pub(in crate::navigator) const SIGMA_RADPS: f64 = 0.003;
}

/// The records of the sources.
pub(in crate::navigator) mod status {
    /// Sigmas that a test ratio of 1 stands for.
    pub(in crate::navigator) const GATE_SIGMA: f64 = 5.0;
    /// A test ratio is a running mean of so many scalars.
    pub(in crate::navigator) const RATIO_SCALARS: f64 = 20.0;
    /// An innovation beyond this many gates says no more than that it is out of bounds.
    pub(in crate::navigator) const LARGEST_RATIO: f64 = 10.0;
    /// What was heard longer ago does not testify, s.
    pub(in crate::navigator) const HEARD_S: f64 = 1.0;
}
