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
    outln!("The configuration is valid.");
    match s.system {
        Some(system) => outln!("  follows   system {}", system.0),
        None => outln!("  follows   the first autopilot that is heard"),
    }
    for e in &s.endpoints {
        outln!("  listens   {e}");
    }
    let o = &s.pipeline.outbound;
    let profile = s.pipeline.profile.map_or("the autopilot's own".to_owned(), |p| p.to_string());
    outln!("  sends     {:?} at {} Hz, publish = {:?}, profile: {profile}", o.carriage, o.rate_hz, o.publish);
    outln!("  estimator {}", s.pipeline.navigator.estimator.label());
    if let Some(l) = &s.pipeline.navigator.landmarks {
        let (points, cameras) = (l.points.len(), l.cameras.len());
        outln!(
            "  landmarks {points}, {:?}, seen by {cameras} camera{}",
            l.frame,
            if cameras == 1 { "" } else { "s" }
        );
    }
    let h = &s.pipeline.navigator.holdover;
    outln!("  lost at   {} m of uncertainty, or {} s without velocity", h.max_sigma_m, h.max_coast_s);
    Ok(())
}
