//! `holdover init`: listens to a link, says what is there and what is missing, and writes a configuration for it.

mod ask;
mod holders;
mod look;
mod places;
mod shown;

use std::io::Write;
use std::path::PathBuf;
use std::str::FromStr;

use clap::Args;

use crate::config::Settings;
use crate::files::{OutputFile, Overwrite, READABLE};
use crate::init::draft::Draft;
use crate::init::fitting;
use crate::init::survey::LinkSurvey;
use crate::preflight::Needs;
use crate::preflight::conversation::{PreflightEnd, PreflightReport};
use crate::wire::endpoint::{ACCEPTED_FORMS, Endpoint, EndpointFault};

use super::Failure;
use super::conversation::{Conversation, ConverseError, Conversed, converse};
use super::preflight::{no_autopilot, several};

use look::Chosen;

/// Arguments of `init`.
#[derive(Debug, Args)]
pub struct InitArgs {
    /// Where the autopilot is, as for run; may be given several times. serial:DEVICE:auto tries the usual baud rates. Without it serial ports and
    /// the usual UDP ports are looked at, and you are asked
    #[arg(long, short, value_name = "ENDPOINT")]
    endpoint: Vec<InitEndpoint>,
    /// The configuration to be written
    #[arg(long, short, value_name = "FILE", default_value = "holdover.toml")]
    out: PathBuf,
    /// Overwrite what is there
    #[arg(long)]
    force: bool,
    /// Listen to the autopilot for so long, s; and wait for so long for one
    #[arg(long, value_name = "SECONDS", default_value_t = 10, value_parser = clap::value_parser!(u16).range(5..=600))]
    listen_s: u16,
    /// Without an endpoint, look at these UDP ports, and where no --device is named, at these alone
    #[arg(long, value_name = "PORT", value_delimiter = ',', conflicts_with = "endpoint")]
    port: Vec<u16>,
    /// Without an endpoint, look at these serial devices, and where no --port is named, at these alone
    #[arg(long, value_name = "DEVICE", conflicts_with = "endpoint")]
    device: Vec<String>,
    /// A key that you know already, as in vehicle.system_id=2: heeded while listening, and written; may be given several times
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Print one JSON object and nothing else, and ask nothing
    #[arg(long)]
    json: bool,
}

/// An endpoint, or a serial device whose baud rate is to be found.
#[derive(Clone, PartialEq, Eq, Debug)]
enum InitEndpoint {
    Known(Endpoint),
    AnyBaud(String),
}

impl FromStr for InitEndpoint {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse::<Endpoint>() {
            Ok(endpoint) => Ok(Self::Known(endpoint)),
            Err(e) => match (text.strip_prefix("serial:"), &e.fault) {
                (Some(device), EndpointFault::NoBaud) if !device.is_empty() => {
                    Ok(Self::AnyBaud(device.trim_end_matches(':').to_owned()))
                }
                (Some(rest), EndpointFault::BadBaud(baud)) if baud == "auto" => {
                    Ok(Self::AnyBaud(rest.trim_end_matches(":auto").to_owned()))
                }
                _ => Err(format!("{}; the accepted forms are {ACCEPTED_FORMS}, serial:DEVICE:auto", e.fault)),
            },
        }
    }
}

/// Everything that was found.
#[derive(Debug)]
struct InitFindings {
    chosen: Chosen,
    survey: LinkSurvey,
    report: PreflightReport,
    conversed: Conversed,
    settings: Settings,
    draft: Draft,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for what is in the file's place, and where it has to be said which of several is meant; [`Failure::Link`] where nothing is heard.
pub fn run(args: &InitArgs, quiet: bool) -> Result<(), Failure> {
    // What is in the way is told before somebody waits.
    let mut out = OutputFile::create(&args.out, Overwrite::forced(args.force), READABLE)?;
    let mut draft = Draft::default();
    args.set.iter().for_each(|assignment| draft.set_as_told(assignment));
    draft.loaded().map_err(Failure::Config)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let chosen = runtime.block_on(look::choose(args, quiet || args.json))?;
    fitting::links(&mut draft, &chosen.endpoints, &chosen.why, places::is_usb);
    fitting::sensor_links(&mut draft, &chosen.sensor_endpoints);
    let mut found = runtime.block_on(listen(args, chosen, draft, quiet || args.json))?;
    // A name that is still being resolved is not waited for.
    runtime.shutdown_background();
    fitting::vehicle(&mut found.draft, &found.survey, &found.report);
    let text = found.draft.text().map_err(Failure::Config)?;
    out.write_all(text.as_bytes())?;
    out.finish()?;
    if args.json {
        outln!("{}", shown::to_json(&found, &args.out, &text)?);
    } else {
        shown::print(&found, &args.out, &text)?;
    }
    Ok(())
}

/// Listens until an autopilot was heard for long enough; of several, whoever is there is asked which.
async fn listen(
    args: &InitArgs,
    chosen: Chosen,
    mut draft: Draft,
    quiet: bool,
) -> Result<InitFindings, Failure> {
    if !quiet {
        let at: Vec<String> = chosen.endpoints.iter().map(ToString::to_string).collect();
        errln!("holdover: listening at {} for {} s and more", at.join(", "), args.listen_s);
    }
    loop {
        let settings = draft.loaded().map_err(Failure::Config)?.settings;
        let needs = Needs::of(&settings, None);
        let plan = Conversation {
            settings: &settings,
            needs: &needs,
            write: false,
            wait_s: args.listen_s,
            listen_s: Some(args.listen_s),
        };
        let mut survey = LinkSurvey::default();
        let conversed = converse(&plan, &mut |frame, at, inputs| survey.hear(frame, at, inputs))
            .await
            .map_err(|error| match error {
                ConverseError::Open(error) => Failure::Link(look::refusal(&error)),
                other => other.into(),
            })?;
        match conversed.end.clone() {
            PreflightEnd::Read(report) => {
                return Ok(InitFindings { chosen, survey, report: *report, conversed, settings, draft });
            }
            PreflightEnd::Several(vehicles) => {
                let system = which_vehicle(args, &survey, &vehicles)?;
                let others: Vec<String> =
                    vehicles.iter().filter(|v| **v != system).map(u8::to_string).collect();
                let why = format!("Vehicles of the systems {} are heard here, too.", others.join(", "));
                draft.set("vehicle.system_id", &system.to_string(), why);
            }
            PreflightEnd::FellSilent => return Err(Failure::Link("the autopilot fell silent".into())),
            PreflightEnd::NoAutopilot(systems) => {
                let told = no_autopilot(&settings, &systems, args.listen_s);
                return Err(Failure::Link(look::silence(&told, &conversed.links)));
            }
        }
    }
}

fn which_vehicle(args: &InitArgs, survey: &LinkSurvey, vehicles: &[u8]) -> Result<u8, Failure> {
    if !ask::somebody_is_there(args.json) {
        return Err(Failure::Usage(several(vehicles)));
    }
    let words = survey.words();
    let options: Vec<String> = vehicles
        .iter()
        .map(|v| {
            let word = words
                .iter()
                .find(|w| w.system == *v && survey.autopilots().any(|a| a == (w.system, w.component)));
            word.map_or_else(|| format!("system {v}"), ToString::to_string)
        })
        .collect();
    let chosen = ask::which("Several vehicles are heard. Which is meant?", &options)?;
    vehicles.get(chosen).copied().ok_or_else(|| Failure::Usage(several(vehicles)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_baud_rate_may_be_left_to_be_found() {
        for (text, device) in [
            ("serial:/dev/ttyUSB0", "/dev/ttyUSB0"),
            ("serial:/dev/ttyUSB0:", "/dev/ttyUSB0"),
            ("serial:/dev/ttyUSB0:auto", "/dev/ttyUSB0"),
            ("serial:/dev/serial/by-path/usb-0:1:1.0:auto", "/dev/serial/by-path/usb-0:1:1.0"),
        ] {
            assert_eq!(text.parse(), Ok(InitEndpoint::AnyBaud(device.into())), "{text}");
        }
        let known: InitEndpoint = "serial:/dev/ttyUSB0:57600".parse().unwrap();
        assert_eq!(known, InitEndpoint::Known("serial:/dev/ttyUSB0:57600".parse().unwrap()));
        for wrong in ["serial:", "serial::auto", "udpin:1.2.3.4", "/dev/ttyUSB0"] {
            let told = wrong.parse::<InitEndpoint>().unwrap_err();
            assert!(told.contains("serial:DEVICE:auto"), "{told}");
        }
    }
}
