//! Arguments that the examples share with the `holdover` command.

use std::path::PathBuf;

use anyhow::{Context, Result};
use holdover::config::{Settings, Sources};

/// Where the settings come from.
#[derive(Clone, Debug, clap::Args)]
pub struct SettingsArgs {
    /// Configuration file (TOML); may be given several times, later ones override
    #[arg(long, short, value_name = "FILE")]
    config: Vec<PathBuf>,
    /// Override one key, as in --set outbound.rate_hz=50; may be given several times
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
}

impl SettingsArgs {
    /// The settings, with these on top.
    pub fn load(&self, more: &[String]) -> Result<Settings> {
        let overrides = self.set.iter().chain(more).cloned().collect();
        Ok(Settings::load(&Sources { files: self.config.clone(), overrides, ..Sources::default() })?)
    }
}

/// `A..B` in seconds, with 0 ≤ A < B.
pub fn interval(text: &str) -> Result<(f64, f64)> {
    let (a, b) = text.split_once("..").context("expected A..B")?;
    let (a, b): (f64, f64) = (a.trim().parse()?, b.trim().parse()?);
    anyhow::ensure!(a >= 0.0 && a < b && b.is_finite(), "expected A..B with 0 <= A < B");
    Ok((a, b))
}
