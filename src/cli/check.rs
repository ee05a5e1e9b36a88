//! `holdover check`: is the configuration right, and what is in force?

use clap::Args;

use crate::config::Settings;

use super::{ConfigArgs, Failure};

/// Arguments of `check`.
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// Settings
    #[command(flatten)]
    pub settings: ConfigArgs,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Config`].
pub fn run(args: &CheckArgs) -> Result<(), Failure> {
    show(&args.settings.load()?)
}

/// Prints what is in force.
///
/// # Errors
/// [`Failure::Usage`] when there is nothing to listen to.
pub(super) fn show(s: &Settings) -> Result<(), Failure> {
    if s.endpoints.is_empty() {
        return Err(Failure::Usage("link.endpoints is empty: there is nothing to listen to".into()));
    }
    println!("The configuration is valid.");
    match s.system {
        Some(system) => println!("  follows   system {}", system.0),
        None => println!("  follows   the first autopilot that is heard"),
    }
    for e in &s.endpoints {
        println!("  listens   {e}");
    }
    let o = &s.pipeline.outbound;
    let profile = s.pipeline.profile.map_or("the autopilot's own".to_owned(), |p| p.to_string());
    println!(
        "  sends     {:?} at {} Hz, publish = {:?}, profile: {profile}",
        o.carriage, o.rate_hz, o.publish
    );
    println!("  estimator {}", s.pipeline.navigator.estimator.label());
    let h = &s.pipeline.navigator.holdover;
    println!("  lost at   {} m of uncertainty, or {} s without velocity", h.max_sigma_m, h.max_coast_s);
    Ok(())
}
