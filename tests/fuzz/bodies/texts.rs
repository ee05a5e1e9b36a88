//! What a user writes.

use holdover::config::{Settings, Sources};

/// Lines of `key=value` on the command line and in the environment: refused with a reason, or within the limits.
pub fn config(bytes: &[u8]) -> u64 {
    let text = String::from_utf8_lossy(bytes);
    let overrides: Vec<String> = text.lines().map(str::to_owned).collect();
    let environment = text.lines().filter_map(|line| {
        let (key, value) = line.split_once('=')?;
        Some((format!("HOLDOVER_{}", key.to_uppercase().replace('.', "__")), value.to_owned()))
    });
    let sources = Sources { environment: environment.collect(), overrides, ..Sources::default() };
    match Settings::load(&sources) {
        Ok(settings) => assert!(settings.pipeline.outbound.rate_hz.is_finite()),
        Err(e) => assert!(e.problems.iter().all(|p| !p.what.is_empty()), "{e}"),
    }
    1
}
