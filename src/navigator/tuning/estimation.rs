//! Constants of the estimator.

use crate::time::Span;

/// The estimator as a whole.
pub(in crate::navigator) mod estimator {
    /// Standard deviation of the velocity when a fix has set it, and when it could not, m/s.
    pub(in crate::navigator) const AIDED_SPEED_SIGMA: f64 = 0.3;
    pub(in crate::navigator) const UNKNOWN_SPEED_SIGMA: f64 = 5.0;
}

/// What a stage is judged by.
pub(in crate::navigator) mod estimator_step {
    /// Trusted fixes that are gated out for this long mean that the filter is wrong, s.
    pub(in crate::navigator) const LOCKED_OUT_S: f64 = 2.0;
    /// Observer and filter disagree when their attitudes differ by this much, rad …
    pub(in crate::navigator) const DISAGREEMENT: f64 = 0.35;
    /// … for this long, s.
    pub(in crate::navigator) const DISAGREEMENT_S: f64 = 5.0;
    /// A stage is doubted while more than this part of the fixes does not fit, in the mean over some ten.
    pub(in crate::navigator) const MOST_MISFITS: f64 = 0.5;
    pub(in crate::navigator) const MISFIT_GAIN: f64 = 0.1;
    /// A magnetometer sample is used for this long, s: the slowest that are logged come at 0.5 Hz.
    pub(in crate::navigator) const MAGNETIC_AGE_S: f64 = 2.2;
    /// A flow velocity is used for this long, s.
    pub(in crate::navigator) const FLOW_AGE_S: f64 = 0.5;
}

/// The error-state stage.
pub(in crate::navigator) mod error_state {
    /// Standard deviations at the start: roll and pitch, yaw (rad), velocity (m/s), gyro bias (rad/s), accelerometer bias (m/s²).
    pub(in crate::navigator) const START_TILT: f64 = 0.05;
    pub(in crate::navigator) const START_YAW: f64 = 0.17;
    pub(in crate::navigator) const START_VELOCITY: f64 = 0.7;
    pub(in crate::navigator) const START_GYRO_BIAS: f64 = 0.005;
    pub(in crate::navigator) const START_ACCEL_BIAS: f64 = 0.15;
    /// The same where the attitude was found in motion and no GNSS told what the motion was.
    pub(in crate::navigator) const MOVING_TILT: f64 = 0.15;
    pub(in crate::navigator) const MOVING_YAW: f64 = 0.35;
    pub(in crate::navigator) const MOVING_VELOCITY: f64 = 2.0;
    pub(in crate::navigator) const MOVING_GYRO_BIAS: f64 = 0.01;
    /// The magnetometer is fused this often, s: its errors are not white.
    pub(in crate::navigator) const MAGNETIC_PERIOD_S: f64 = 0.1;
    /// The height is fused this often, s.
    pub(in crate::navigator) const HEIGHT_PERIOD_S: f64 = 0.1;
    /// Standard deviation of the height filter's height as a measurement, m.
    pub(in crate::navigator) const HEIGHT_SIGMA_M: f64 = 0.5;
    /// Beyond this bank or pitch a wing does not fly nose first: cos 60°.
    pub(in crate::navigator) const MIN_UPRIGHT: f64 = 0.5;
    /// The motion in a hole is integrated in steps of this, s.
    pub(in crate::navigator) const BRIDGE_STEP_S: f64 = 0.02;
    /// Beyond this the heading is too uncertain for linear corrections, rad: the magnetic field sets it.
    pub(in crate::navigator) const WIDE_YAW: f64 = 0.6;
}

/// A hole in the stream.
pub(in crate::navigator) mod hole {
    /// How far rotation and acceleration in a hole may be from those at its ends, rad/s and m/s², 1 sigma.
    pub(in crate::navigator) const UNKNOWN_RATE: f64 = 0.3;
    pub(in crate::navigator) const UNKNOWN_ACCELERATION: f64 = 2.0;
    /// What a tilt, and a heading, may be off by at most, rad: a vehicle in the air leans so far, and heads anywhere (π/√3).
    pub(in crate::navigator) const MOST_TILT: f64 = 0.5;
    pub(in crate::navigator) const MOST_YAW: f64 = 1.8;
    /// Standard deviation of a velocity on an axis in the long run, m/s, where the last one was less: a multirotor that hovered may have
    /// left. It changes within this time, s.
    pub(in crate::navigator) const LEAST_SPEED: f64 = 4.0;
    pub(in crate::navigator) const CORRELATED_S: f64 = 4.0;
    /// The same of a climb rate, m/s: what multirotors climb and sink by.
    pub(in crate::navigator) const LEAST_CLIMB: f64 = 3.0;
    /// A hole this many correlation times long leaves the most doubt of the position: shorter ones have it go on, in longer ones it turns.
    pub(in crate::navigator) const MOST_DOUBTFUL: f64 = 1.9;
    /// The last velocity is expected to go over within this time, s. Of 19 recorded flights it leaves the least error of the position over
    /// holes of 2 to 200 s, wings and rotors alike; one that stays is off by twice as much after a minute, by eight times after 200 s.
    pub(in crate::navigator) const FADES_S: f64 = 20.0;
    /// The mean specific force over this long, s, says where up is, to within what vehicles accelerate by, rad: 2 m/s² of 1 g.
    pub(in crate::navigator) const SETTLED_S: f64 = 0.15;
    pub(in crate::navigator) const LEVEL_SIGMA: f64 = 0.2;
    /// The first field of the magnetometer is waited for as long as this, s.
    pub(in crate::navigator) const WAIT_FOR_FIELD_S: f64 = 0.25;
    /// A heading that nothing has told to better than this, rad, is sought anew when GNSS comes back.
    pub(in crate::navigator) const LOST_YAW: f64 = 0.7;
}

/// The exogenous stage.
pub(in crate::navigator) mod exogenous {
    /// The second stage has no states for what comes with motion (gyro scale, vibration, the sampling of the stream): its white noise, as a
    /// multiple of the shipped filter's, stands for all of it.
    pub(in crate::navigator) const NOISE_FACTOR: f64 = 3.0;
}

/// The search for a heading.
pub(in crate::navigator) mod heading {
    /// A heading from motion is not believed better than this, rad: what is systematic in a manoeuvre (scale, latency, alignment).
    pub(in crate::navigator) const LEAST_YAW: f64 = 0.12;
}

/// What is remembered of the filter.
pub(in crate::navigator) mod lookback {
    /// The filter is kept this often, s, so many times: longer than it takes to find out that a source is wrong.
    pub(in crate::navigator) const SPACING_S: f64 = 0.5;
    pub(in crate::navigator) const SNAPSHOTS: usize = 14;
    /// So many IMU samples: 7 s at 250 Hz.
    pub(in crate::navigator) const FELT: usize = 1750;
}

/// The observers.
pub(in crate::navigator) mod observer {
    use super::Span;

    /// The interval that Grip's printed gains are for, s. Jitter makes no second step of it.
    pub(in crate::navigator) const PRINTED_STEP_S: f64 = 0.012;
    /// The rate that Fusini's are for, Hz.
    pub(in crate::navigator) const PRINTED_RATE_HZ: f64 = 300.0;
    /// A vehicle that hears no magnetometer for this long starts without, s.
    pub(in crate::navigator) const WAIT_FOR_MAGNETOMETER_S: f64 = 2.5;
    /// Injections are averaged over this long, s, and those this far apart are independent, s: a magnetometer at 5 Hz.
    pub(in crate::navigator) const INJECTION_MEAN_S: f64 = 3.0;
    pub(in crate::navigator) const INJECTION_CORRELATION_S: f64 = 0.2;
    /// What is waited for is told this often, s.
    pub(in crate::navigator) const TELL_EVERY_S: f64 = 10.0;
    /// How long after its last measurement an axis of the measurement signal counts as measured.
    pub(in crate::navigator) const SIGNAL_HOLD: Span = Span::from_millis(700);
    /// The predictor remembers this much of the past; fixes have to be younger still.
    pub(in crate::navigator) const LONGEST_DELAY: Span = Span::from_millis(1500);
}
