//! `[tuning.observer]`: the nonlinear observers.

use crate::config::key::section;
use crate::navigator::settings::{FlowBiasSource, ObserverSettings};

section! {
    /// The nonlinear observers.
    "tuning.observer" struct ObserverTuning {
        /// Attitude gain K_P.
        k_p: f64 = 0.3 in 0.0001 ..= 10.0 unit "1/s" was "observer.k_p";
        /// Gyro bias gain k_I.
        k_i: f64 = 0.03 in 0.0 ..= 10.0 unit "1/s" was "observer.k_i";
        /// Fast start-up gains are in force for this long after the first guess of the attitude.
        start_s: f64 = 30.0 in 0.0 ..= 600.0 was "observer.start_s";
        /// Inject the velocity of fixes, too; Grip's observer has its position gains only without (Theorem 2).
        gnss_velocity: bool = true was "observer.gnss_velocity";
        /// What takes the flow's errors out for the observers: the calibration (bias, scale and misalignment), or a low pass of the velocity bias alone, in body axes or as Fusini prints it.
        flow_bias: FlowBiasSource = "calibration" of "calibration" | "body" | "as_printed" was "observer.flow_bias";
        /// Time constant of that low pass.
        flow_bias_time_s: f64 = 30.0 in 0.1 ..= 600.0 was "observer.flow_bias_time_s";
        /// Factor on K_P in holdover.
        holdover_k_p_factor: f64 = 1.0 in 0.0 ..= 10.0 unit "" was "observer.holdover_k_p_factor";
        /// Gain of the velocity error in holdover: K'_vv.
        holdover_k_vv: f64 = 1.5 in 0.001 ..= 100.0 unit "1/s" was "observer.holdover_k_vv";
        /// Gain of the velocity error in holdover: K'_xv.
        holdover_k_xv: f64 = 0.5 in 0.0 ..= 1000.0 unit "1/s²" was "observer.holdover_k_xv";
        /// Below this |f x v| the velocity says nothing of the attitude (Assumption 3).
        guard: f64 = 5.0 in 0.0 ..= 1000.0 unit "m²/s³" was "observer.guard";
        /// The attitude counts as found when the injection's norm stays below this …
        aligned_injection: f64 = 0.2 in 0.01 ..= 2.8 unit "" was "observer.aligned_injection";
        /// … for this long.
        aligned_s: f64 = 5.0 in 0.1 ..= 600.0 was "observer.aligned_s";
    }
}

impl ObserverTuning {
    pub(super) fn settings(&self) -> ObserverSettings {
        ObserverSettings {
            k_p: self.k_p,
            k_i: self.k_i,
            start_s: self.start_s,
            gnss_velocity: self.gnss_velocity,
            flow_bias: self.flow_bias,
            flow_bias_time_s: self.flow_bias_time_s,
            holdover_k_p_factor: self.holdover_k_p_factor,
            holdover_k_vv: self.holdover_k_vv,
            holdover_k_xv: self.holdover_k_xv,
            guard: self.guard,
            aligned_injection: self.aligned_injection,
            aligned_s: self.aligned_s,
        }
    }
}
