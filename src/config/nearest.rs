//! What somebody may have meant who wrote a key that there is not: a key of another name today, or one that is spelled alike.

use super::key::{Key, Type};
use super::sections::SECTIONS;

/// A longer name is no slip of the fingers.
const LONGEST: usize = 64;

/// Every key with its path.
pub(super) fn keys() -> impl Iterator<Item = (String, &'static Key)> {
    SECTIONS.iter().flat_map(|s| s.keys.iter().map(|k| (k.path(s.path), k)))
}

/// The name of today of a key that had another one.
pub(super) fn renamed(path: &str) -> Option<String> {
    keys().find_map(|(now, key)| {
        if key.was.contains(&path) {
            return Some(match key.kind {
                Type::Tables(_) => format!("[[{now}]], a table each"),
                _ => now,
            });
        }
        let Type::Tables(rows) = key.kind else { return None };
        rows.iter().find(|r| r.was.contains(&path)).map(|r| format!("{} in [[{now}]]", r.name()))
    })
}

/// Whether keys that were in this section are elsewhere now.
pub(super) fn was_section(path: &str) -> bool {
    let inside = |old: &&str| old.strip_prefix(path).is_some_and(|rest| rest.starts_with('.'));
    keys().any(|(_, key)| {
        let rows = if let Type::Tables(rows) = key.kind { rows } else { &[] };
        key.was.iter().chain(rows.iter().flat_map(|r| r.was)).any(inside)
    })
}

/// The key or, where `path` is one of no section, the section that is spelled most alike.
pub(super) fn nearest(path: &str) -> Option<String> {
    let paths = keys().map(|(path, _)| path);
    if path.contains('.') {
        return most_alike(path, paths);
    }
    most_alike(path, SECTIONS.iter().map(|s| s.path).chain(["tuning"]).map(str::to_owned).chain(paths))
}

/// The one of `names` that is spelled most like `name`, if one is.
pub(super) fn most_alike(name: &str, names: impl Iterator<Item = String>) -> Option<String> {
    if name.len() > LONGEST {
        return None;
    }
    let close = 3.max(name.len() / 4);
    // The beginning of a name is as good as one slip: the unit is easily forgotten.
    let begins = |n: &str| name.len() > 2 && !n.is_empty() && (n.starts_with(name) || name.starts_with(n));
    let far = |n: &str| if begins(n) { 1 } else { distance(name, n) };
    names.map(|n| (far(&n), n)).filter(|(d, n)| *d <= close && !n.is_empty()).min().map(|(_, n)| n)
}

/// Edit distance (Levenshtein).
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let substituted = diagonal + usize::from(x != *y);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_key_is_found() {
        for (wrong, right) in [
            ("outbound.rate", Some("outbound.rate_hz")),
            ("outbond", Some("outbound")),
            ("tunning", Some("tuning")),
            ("outbound.rat", Some("outbound.rate_hz")),
            ("camera", Some("cameras")),
            ("tuning.gnss.gate_sgima", Some("tuning.gnss.gate_sigma")),
            ("tunning.gnss.gate_sigma", Some("tuning.gnss.gate_sigma")),
            ("flow.gate_sigma", None),
            ("nothing.of_the_kind", None),
        ] {
            assert_eq!(nearest(wrong).as_deref(), right, "{wrong}");
        }
        assert_eq!(nearest(&"outbound.rate_hz".repeat(1000)), None);
    }

    #[test]
    fn the_distance_is_that_of_levenshtein() {
        for (a, b, d) in [("", "", 0), ("", "abc", 3), ("kitten", "sitting", 3), ("flaw", "lawn", 2)] {
            assert_eq!((distance(a, b), distance(b, a)), (d, d));
        }
    }

    #[test]
    fn no_old_name_is_a_name_of_today_or_of_two_keys() {
        let mut old: Vec<&str> = keys().flat_map(|(_, k)| k.was).copied().collect();
        for (_, key) in keys() {
            if let Type::Tables(rows) = key.kind {
                old.extend(rows.iter().flat_map(|r| r.was));
            }
        }
        let today: Vec<String> = keys().map(|(path, _)| path).collect();
        for name in &old {
            assert!(!today.iter().any(|t| t == name), "{name}");
            assert_eq!(old.iter().filter(|o| *o == name).count(), 1, "{name}");
        }
    }
}
