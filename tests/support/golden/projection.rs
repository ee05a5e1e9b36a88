//! The parameter projection of both appendices.

use holdover::observer::bias::BiasBounds;
use serde_json::Value;

use super::outcome::Outcome;
use super::values::{Result, at, list, number, vector};

pub fn run(file: &Value) -> Result<Outcome> {
    let p = at(file, "params")?;
    let bounds = BiasBounds { bound_radps: number(p, "Mb")?, limit_radps: number(p, "Mbh")? };
    let mut outcome = Outcome::new("projection", file);
    for (k, case) in list(file, "cases")?.iter().enumerate() {
        let out = bounds.project(&vector(case, "b")?, &vector(case, "tau")?);
        outcome.compare("out", k, out.as_slice(), vector(case, "out")?.as_slice());
    }
    Ok(outcome)
}
