//! Golden files, recognised by what is in them, run through the library's public types. Shared by the tests and the `golden` example;
//! the formats are described in `tests/golden/README.md`.
#![allow(dead_code, reason = "the tests and the example each use their part")]

mod altimeter;
mod flight;
mod flow;
mod fusini;
mod grip;
mod landmarks;
pub mod outcome;
mod projection;
pub mod values;
mod xkf;

use std::path::Path;

use serde_json::Value;

use outcome::Outcome;
use values::Result;

/// Runs one file.
pub fn run(path: &Path) -> Result<Outcome> {
    run_value(&read(path)?, path.parent().unwrap_or(Path::new(".")))
}

/// Reads a file.
pub fn read(path: &Path) -> Result<Value> {
    let text = std::fs::read_to_string(path).map_err(|e| e.to_string())?;
    serde_json::from_str(&text).map_err(|e| format!("no JSON: {e}"))
}

/// Runs a file's content; `folder` is where files that it names stand.
pub fn run_value(file: &Value, folder: &Path) -> Result<Outcome> {
    let has = |place: &str, key: &str| file.pointer(place).and_then(|v| v.get(key)).is_some();
    if has("/expected", "Theta_p_v_bw_bf_bv") {
        xkf::run(file, folder)
    } else if has("/expected", "p_v_xi_bw_bf_bv") {
        fusini::run(file)
    } else if has("/expected", "xi") && has("/inputs", "mag") {
        grip::run(file)
    } else if has("", "z_ibi") && has("", "ibig") {
        altimeter::run(file)
    } else if has("", "prob_table") && has("", "ibi") {
        altimeter::run_params(file)
    } else if has("/cases/0", "tau") {
        projection::run(file)
    } else if has("", "optical_flow_rad") || has("/cases/0", "rdot") {
        flow::run(file)
    } else if has("/propagate/0", "P_next_ut") {
        landmarks::primitives(file)
    } else if has("", "inputs_vw") && has("", "x_order") {
        landmarks::dead_reckoned(file)
    } else if has("/events/0", "P_ut") && has("", "landmarks_V") {
        landmarks::paper(file)
    } else {
        let keys: Vec<&str> = file.as_object().into_iter().flatten().map(|(k, _)| k.as_str()).collect();
        Err(format!("not a format that is known (its keys: {})", keys.join(", ")))
    }
}
