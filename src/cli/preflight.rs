//! `holdover preflight`: is the autopilot set up for what Holdover will send, and does it send what Holdover needs?

use clap::Args;
use serde_json::{Value, json};

use crate::config::{Origin, Settings};
use crate::preflight::conversation::{PreflightEnd, PreflightReport, WrittenParameter};
use crate::preflight::finding::{Finding, FindingGrade, plain};
use crate::preflight::outlook::outlook;
use crate::preflight::{Needs, untold};
use crate::sample::SampleKind;
use crate::wire::endpoint::Endpoint;

use super::conversation::{Conversation, converse};
use super::{ConfigArgs, Failure, warn};

/// Arguments of `preflight`.
#[derive(Debug, Args)]
pub struct PreflightArgs {
    /// Where the autopilot is, instead of link.endpoints, as for run; may be given several times
    #[arg(long, short, value_name = "ENDPOINT")]
    pub endpoint: Vec<Endpoint>,
    /// Set the parameters that mend the faults, and read them back. Without it nothing is changed on the autopilot but the rates of
    /// its messages, as run does. An armed vehicle is left alone
    #[arg(long)]
    pub write: bool,
    /// Greatest height over ground of the flight, m: does the rangefinder reach so far?
    #[arg(long, value_name = "METRES")]
    pub altitude: Option<f64>,
    /// How long to wait for an autopilot, s
    #[arg(long, value_name = "SECONDS", default_value_t = 10)]
    pub wait: u16,
    /// Print one JSON object and nothing else
    #[arg(long)]
    pub json: bool,
    /// Settings
    #[command(flatten)]
    pub settings: ConfigArgs,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`]: above all [`Failure::Faults`] when the vehicle is not ready.
pub fn run(args: &PreflightArgs) -> Result<(), Failure> {
    let mut loaded = args.settings.read()?;
    warn(&loaded);
    if !args.endpoint.is_empty() {
        loaded.set_endpoints(&args.endpoint, Origin::Argument("--endpoint".into()));
    }
    let settings = loaded.settings;
    if settings.endpoints.is_empty() {
        return Err(Failure::Usage("link.endpoints is empty: there is nothing to listen to".into()));
    }
    let needs = Needs::of(&settings, args.altitude);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let plan = Conversation {
        settings: &settings,
        needs: &needs,
        write: args.write,
        wait_s: args.wait,
        listen_s: None,
    };
    let report = match runtime.block_on(converse(&plan, &mut |_, _, _| {}))?.end {
        PreflightEnd::Read(report) => report,
        PreflightEnd::NoAutopilot(systems) => {
            return Err(Failure::Link(no_autopilot(&settings, &systems, args.wait)));
        }
        PreflightEnd::FellSilent => return Err(Failure::Link("the autopilot fell silent".into())),
        PreflightEnd::Several(vehicles) => return Err(Failure::Usage(several(&vehicles))),
    };
    if args.json {
        outln!("{}", to_json(&report, &needs));
    } else {
        print(&report, &needs);
    }
    if !report.answers_parameters {
        let text = "the autopilot answers no question for a parameter: only the streams were checked";
        return Err(Failure::Lacking(text.into()));
    }
    match (report.faults(), report.reboot_needed()) {
        (0, false) => Ok(()),
        (0, true) => Err(Failure::Faults("not ready: reboot the autopilot, then check again".into())),
        (1, _) => Err(Failure::Faults("not ready: 1 fault".into())),
        (n, _) => Err(Failure::Faults(format!("not ready: {n} faults"))),
    }
}

pub(super) fn no_autopilot(settings: &Settings, systems: &[u8], wait: u16) -> String {
    let at: Vec<String> = settings.endpoints.iter().map(ToString::to_string).collect();
    let at = at.join(", ");
    match (settings.system, systems) {
        (_, []) => {
            format!("nothing was heard at {at} in {wait} s: is the autopilot on, and does it send here?")
        }
        (Some(wanted), heard) => format!(
            "no autopilot of system {} (vehicle.system_id) in {wait} s at {at}; heard: {}",
            wanted.0,
            systems_named(heard)
        ),
        (None, heard) => format!("no autopilot in {wait} s at {at}; heard: {}", systems_named(heard)),
    }
}

fn systems_named(systems: &[u8]) -> String {
    let names: Vec<String> = systems.iter().map(|s| format!("system {s}")).collect();
    names.join(", ")
}

pub(super) fn several(vehicles: &[u8]) -> String {
    let first = vehicles.first().copied().unwrap_or_default();
    format!(
        "{} are heard: say which is meant, as in --set vehicle.system_id={first}",
        systems_named(vehicles)
    )
}

pub(super) fn to_json(report: &PreflightReport, needs: &Needs) -> Value {
    let r = &report.readings;
    let rate = |k: &SampleKind| (k.label().to_owned(), json!(r.has(*k).then_some(r.rate_hz(*k))));
    json!({
        "ready": report.ready() && report.answers_parameters,
        "autopilot": r.vehicle.autopilot.to_string(),
        "system": r.vehicle.system.0,
        "version": r.vehicle.version.map(|v| v.to_string()),
        "vehicle_type": r.vehicle.vehicle_type,
        "armed": r.vehicle.armed,
        "round_trip_ms": r.round_trip.map(|t| t.seconds() * 1e3),
        "streams_hz": SampleKind::ALL.iter().map(rate).collect::<serde_json::Map<_, _>>(),
        "gnss_fix": r.gnss_fix,
        "parameters": r.parameters,
        "unknown": untold(r),
        "findings": report.findings,
        "written": report.written,
        "not_written": report.not_written,
        "reboot_needed": report.reboot_needed(),
        "after_a_loss": outlook(r, needs),
    })
}

fn print(report: &PreflightReport, needs: &Needs) {
    let r = &report.readings;
    let version = r.vehicle.version.map_or("of unknown version".to_owned(), |v| v.to_string());
    let round_trip = r.round_trip.map_or("no answer to TIMESYNC".to_owned(), |t| {
        format!("round trip {} ms", plain((t.seconds() * 1e4).round() / 10.0))
    });
    let armed = if r.vehicle.armed { "armed" } else { "disarmed" };
    outln!("{} {version}, system {}, {armed}, {round_trip}", r.vehicle.autopilot, r.vehicle.system.0);
    let (come, missing): (Vec<&SampleKind>, Vec<&SampleKind>) =
        SampleKind::ALL.iter().partition(|k| r.has(**k));
    let come: Vec<String> = come.iter().map(|k| format!("{} {:.1} Hz", k.label(), r.rate_hz(**k))).collect();
    let missing: Vec<String> = missing.iter().map(|k| format!("no {}", k.label())).collect();
    outln!("  {}", [come, missing].concat().join(", "));
    if !report.written.is_empty() {
        outln!("\nSet");
        report.written.iter().for_each(print_written);
    }
    if let Some(why) = report.not_written {
        outln!("\nNothing was set: {why}");
    }
    print_findings(&report.findings);
    let unknown = untold(r);
    if report.answers_parameters && !unknown.is_empty() {
        outln!("\nUnknown to this autopilot: {}", unknown.join(", "));
    }
    outln!("\nAfter a loss of GNSS");
    outln!("  {}", outlook(r, needs).text);
    if report.ready() && report.answers_parameters {
        outln!("\nReady");
    }
}

/// What is wrong, and what is worth knowing.
pub(super) fn print_findings(findings: &[Finding]) {
    for (grade, headline) in [(FindingGrade::Fault, "Faults"), (FindingGrade::Advice, "Worth knowing")] {
        if findings.iter().any(|f| f.grade == grade) {
            outln!("\n{headline}");
            findings.iter().filter(|f| f.grade == grade).for_each(print_finding);
        }
    }
}

fn print_finding(f: &Finding) {
    let value = f.value.as_ref().map_or("does not come".to_owned(), |v| format!("is {v}"));
    let boot = if f.reboot { ", from the next boot on" } else { "" };
    outln!("  {} {value}, should be {}{boot}", f.subject, f.should);
    outln!("      {}", f.why);
    if let Some(example) = &f.example {
        outln!("      {example}");
    }
}

fn print_written(w: &WrittenParameter) {
    let outcome = match (w.after, w.took, w.reboot) {
        (_, true, true) => ", read back; in effect from the next boot on".to_owned(),
        (_, true, false) => ", read back".to_owned(),
        (Some(after), false, _) => format!(": not kept, it is {}", plain(after)),
        (None, false, _) => ": not read back".to_owned(),
    };
    outln!("  {} {} -> {}{outcome}", w.parameter, plain(w.before), plain(w.wanted));
}
