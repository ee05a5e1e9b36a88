//! What the trajectory formats share: the recorded sensors, and the parameters that both observers have.

use holdover::observer::attitude::Discretisation;
use holdover::observer::{FixSample, Predictor, Scheme, TranslationGains};
use holdover::time::{AutopilotTime, Span};
use nalgebra::Vector3;
use serde_json::Value;

use super::values::{Result, array, choice, number, numbers, vector_or_zero, vectors};

/// The sensors of a file.
pub struct Flight {
    pub t: Vec<f64>,
    pub gyro: Vec<Vector3<f64>>,
    pub acc: Vec<Vector3<f64>>,
    /// Sample index, position and velocity.
    gnss: Vec<(usize, Vector3<f64>, Vector3<f64>)>,
    /// Sample index, flow velocity and altitude.
    flow: Vec<(usize, Vector3<f64>, f64)>,
    pub gravity_ned: Vector3<f64>,
    pub earth_rate_ned: Vector3<f64>,
}

impl Flight {
    pub fn read(inputs: &Value) -> Result<Self> {
        let t = numbers(inputs, "t")?;
        let (gyro, acc) = (vectors(inputs, "gyro")?, vectors(inputs, "acc")?);
        if gyro.len() != t.len() || acc.len() != t.len() {
            return Err("\"t\", \"gyro\" and \"acc\" differ in length".into());
        }
        let (p, v) = (vectors(inputs, "gnss_pos")?, vectors(inputs, "gnss_vel")?);
        let gnss = numbers(inputs, "gnss_idx")?.into_iter().zip(p.into_iter().zip(v));
        let gnss = gnss.map(|(i, (p, v))| (i as usize, p, v)).collect();
        let mut flow = Vec::new();
        if inputs.get("flow_idx").is_some() {
            let (v, d) = (vectors(inputs, "flow_vb")?, numbers(inputs, "alt_D")?);
            let all = numbers(inputs, "flow_idx")?.into_iter().zip(v.into_iter().zip(d));
            flow = all.map(|(i, (v, d))| (i as usize, v, d)).collect();
        }
        Ok(Self {
            t,
            gyro,
            acc,
            gnss,
            flow,
            gravity_ned: Vector3::new(0.0, 0.0, number(inputs, "g")?),
            earth_rate_ned: vector_or_zero(inputs, "omega_e_ned")?,
        })
    }

    /// Length of the interval before sample k, s.
    pub fn dt(&self, k: usize) -> f64 {
        self.t[k] - self.t[k - 1]
    }

    /// When sample k was, to the microsecond.
    pub fn stamp(&self, k: usize) -> AutopilotTime {
        AutopilotTime::from_micros((self.t[k] * 1e6).round() as i64)
    }

    /// The fix stamped with sample k.
    pub fn fix(&self, k: usize) -> Option<(Vector3<f64>, Vector3<f64>)> {
        self.gnss.iter().find(|g| g.0 == k).map(|g| (g.1, g.2))
    }

    /// The flow velocity and altitude stamped with sample k, and the time since those before (none before the first).
    pub fn frame(&self, k: usize) -> Option<(Vector3<f64>, f64, Option<f64>)> {
        let i = self.flow.iter().position(|f| f.0 == k)?;
        let before = i.checked_sub(1).and_then(|i| self.t.get(self.flow[i].0));
        let interval = before.map(|t| self.t[k] - t);
        Some((self.flow[i].1, self.flow[i].2, interval))
    }
}

/// A measurement signal that never grows old, as the files mean it.
pub fn predictor(scheme: Scheme, earth_rate_ned: Vector3<f64>) -> Predictor {
    Predictor::new(scheme, Span::from_millis(1000), Span::from_millis(1_000_000_000), earth_rate_ned)
}

/// A fix as the files mean it: it is stamped with the sample just processed.
pub fn take_fix(w: &mut Predictor, fix: &FixSample, start: (Vector3<f64>, Vector3<f64>)) -> Result<()> {
    if !w.is_running() {
        w.reset(fix.stamp, &start.0, &start.1);
    }
    let e = w.innovation(fix).ok_or("a fix that cannot be compared with the measurement signal")?;
    w.apply(&e);
    Ok(())
}

pub fn gains(params: &Value) -> Result<TranslationGains> {
    let [pp, pv, vp, vv, xp, xv] = array(params, "K")?;
    Ok(TranslationGains { pp, pv, vp, vv, xp, xv })
}

pub fn discretisation(params: &Value) -> Result<Discretisation> {
    choice(
        params,
        "disc",
        &[("EULER", 0.0, Discretisation::Euler), ("EXP", 1.0, Discretisation::Exponential)],
    )
}
