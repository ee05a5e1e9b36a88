//! Rules for one parameter each, as rows of a table.

use super::Case;
use super::finding::{Finding, FindingGrade};

/// A rule for one parameter. It is silent where the parameter was not told: another version may have none.
pub(super) struct Rule {
    pub(super) name: &'static str,
    pub(super) grade: FindingGrade,
    /// Whether this value will do.
    pub(super) good: fn(f64, &Case<'_>) -> bool,
    /// The value to set instead.
    pub(super) mend: fn(f64, &Case<'_>) -> f64,
    /// What is good, in words.
    pub(super) should: &'static str,
    pub(super) why: &'static str,
    /// Whether it takes effect at the next boot only.
    pub(super) reboot: bool,
}

/// What the rules of a table find.
pub(super) fn apply(rules: &[Rule], case: &Case<'_>) -> Vec<Finding> {
    let find = |rule: &Rule| {
        let value = case.readings.parameter(rule.name)?;
        if (rule.good)(value, case) {
            return None;
        }
        let mend = (rule.mend)(value, case);
        let should =
            if rule.should.is_empty() { super::finding::plain(mend) } else { rule.should.to_owned() };
        let finding = Finding::parameter(rule.grade, (rule.name, value), should, Some(mend), rule.why);
        Some(Finding { reboot: rule.reboot, ..finding })
    };
    rules.iter().filter_map(find).collect()
}

/// Whether bits are set in a parameter that holds a bit mask.
pub(super) fn bits(value: f64, mask: u32) -> bool {
    (value as i64 as u32) & mask == mask
}
