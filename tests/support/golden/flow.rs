//! Optical flow: single patches.

use holdover::camera::single_patch::patch_velocity;
use nalgebra::Vector2;
use serde_json::Value;

use super::outcome::Outcome;
use super::values::{Result, array, list, number};

pub fn run(file: &Value) -> Result<Outcome> {
    let mut outcome = Outcome::new("flow", file);
    if file.get("optical_flow_rad").is_some() {
        for (k, case) in list(file, "optical_flow_rad")?.iter().enumerate() {
            let pair = |x: &str, y: &str| Ok::<_, String>(Vector2::new(number(case, x)?, number(case, y)?));
            let (flow, gyro) = (pair("ix", "iy")?, pair("gx", "gy")?);
            let v = patch_velocity(&flow, &gyro, number(case, "dt")?, number(case, "dist")?);
            outcome.compare("vxy", k, v.as_slice(), &array::<2>(case, "vxy")?);
        }
    }
    Ok(outcome)
}
