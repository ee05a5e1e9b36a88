//! The report of a flight: every plot holds the data that it claims to hold, nothing hostile gets through, and what is lacking is said.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use holdover::altimeter::Channel;
use holdover::config::{Settings, Sources};
use holdover::geo::so3::{Euler, wrap_pi};
use holdover::log::Log;
use holdover::metrics::{ErrorSample, ReferenceState};
use holdover::navigator::event::EventKind;
use holdover::navigator::solution::{Mode, VelocitySource};
use holdover::navigator::sources::status::Measured;
use holdover::replay::runner::{self, Runner};
use holdover::report::{FaultShown, FlightRecorder, FlightSheet, flights_page};
use holdover::sample::{Input, Reference, Sample};
use tempfile::tempdir;

use crate::command::{PX4, bytes_of, holdover, records, write_log};
use crate::drawing::{Drawing, titles};

const OUTAGE: (f64, f64) = (100.0, 140.0);
const FAULT: &str = "baro:bias=8@150..190";

/// What is known of the flight without the report's own code.
struct Known {
    page: String,
    runner: Runner,
    errors: Vec<(f64, f64)>,
    sigmas: Vec<(f64, f64)>,
    places: Vec<[f64; 2]>,
    heights: Vec<(f64, f64)>,
    barometer: Vec<(f64, f64)>,
    yaw_errors: Vec<(f64, f64)>,
    forces: Vec<(f64, [f64; 3])>,
}

/// A square of a quadrotor with flow, an outage and a barometer that lies.
fn known() -> &'static Known {
    static KNOWN: OnceLock<Known> = OnceLock::new();
    KNOWN.get_or_init(|| {
        let folder = tempdir().unwrap();
        let path = folder.path().join("square.tlog");
        let out = path.to_str().unwrap();
        assert_eq!(holdover(&["simulate", "square", "--duration", "220", "--out", out]).code, Some(0));
        fly(&path)
    })
}

fn fly(path: &Path) -> Known {
    let settings = Settings::load(&Sources::default()).unwrap();
    let log = Log::open(path, None).unwrap();
    let (mut recorder, fault) = (FlightRecorder::new(), FAULT.parse().unwrap());
    let (mut errors, mut sigmas, mut places, mut heights) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut barometer, mut yaw_errors, mut forces) = (Vec::new(), Vec::new(), Vec::new());
    let (runner, summary) = runner::run(
        &log,
        &settings.pipeline,
        &[OUTAGE],
        &[fault],
        |_| {},
        |runner, _, item, _| {
            recorder.note(runner, item);
            let navigator = &runner.pipeline.navigator;
            let Some(s) = runner.solution().filter(|s| s.mode != Mode::Aligning) else { return };
            let t = runner.seconds(s.time);
            match item {
                Input::Sample(Sample::Imu(imu)) => {
                    let p = s.position.raw();
                    places.push([p.x, p.y]);
                    heights.push((t, -p.z));
                    sigmas.push((t, s.horizontal_sigma_m()));
                    forces.push((t, imu.specific_force.raw().into()));
                    if let Some((_, height)) = navigator.height_reading(Channel::Baro) {
                        let offset = navigator.height_standing(Channel::Baro).unwrap().0;
                        barometer.push((t, height - offset));
                    }
                }
                Input::Reference(Reference::Truth(truth)) => {
                    let state = ReferenceState::from_truth(truth, navigator.frame().unwrap()).unwrap();
                    errors.push((runner.seconds(truth.time), ErrorSample::between(s, &state).horizontal_m));
                    let yaw = |r| Euler::from_rotation(r).yaw_rad;
                    if let Some(attitude) = truth.attitude {
                        let apart = wrap_pi(yaw(attitude.matrix()) - yaw(s.attitude.matrix()));
                        yaw_errors.push((runner.seconds(truth.time), apart.to_degrees()));
                    }
                }
                _ => {}
            }
        },
    )
    .unwrap();
    recorder.finish();
    let navigator = &runner.pipeline.navigator;
    let sheet = FlightSheet {
        name: "square.tlog".into(),
        about: "a quadrotor".into(),
        recorder,
        outcome: runner.outcome(),
        sources: navigator.source_reports(),
        drift: navigator.measured_drift(),
        faults: vec![FaultShown { text: FAULT.into(), from_s: 150.0, to_s: 190.0 }],
        remarks: summary.remarks(),
        lacking: None,
    };
    let page = flights_page(&[sheet]);
    Known { page, runner, errors, sigmas, places, heights, barometer, yaw_errors, forces }
}

#[test]
fn errors_are_drawn_with_what_was_claimed_over_the_flight_and_in_the_outage() {
    let known = known();
    let whole = Drawing::of(&known.page, "Horizontal error and what was claimed");
    whole.shows("error", &known.errors);
    let claimed: Vec<(f64, f64)> = known.sigmas.iter().map(|(t, s)| (*t, 2.0 * s)).collect();
    // The area's lower side is zero.
    let upper = whole.points("2 sigma").into_iter().map(|p| p.1).fold(0.0, f64::max);
    let most = claimed.iter().map(|p| p.1).fold(0.0, f64::max);
    assert!((upper / most - 1.0).abs() < 0.02, "{upper} {most}");
    let marked = whole.marks("m-withheld");
    assert!((marked[0].0 - OUTAGE.0).abs() < 0.2 && (marked[0].1 - OUTAGE.1).abs() < 0.2, "{marked:?}");

    let title =
        titles(&known.page).into_iter().find(|t| t.starts_with("1: GNSS withheld from 100 s")).unwrap();
    let one = Drawing::of(&known.page, &title);
    let outage = known.runner.outcome().outages[0];
    let (dx, dy) = one.resolution();
    let drawn = one.points("error");
    let at_end = drawn.iter().rev().find(|p| p.0 <= OUTAGE.1 - OUTAGE.0 + dx).unwrap();
    let (told, most) = (outage.horizontal_error_end_m.unwrap(), outage.horizontal_error_max_m.unwrap());
    assert!((at_end.1 - told).abs() < 0.05 * told.max(1.0) + dy, "{at_end:?} {told}");
    let inside =
        drawn.iter().filter(|p| (0.0..OUTAGE.1 - OUTAGE.0).contains(&p.0)).map(|p| p.1).fold(0.0, f64::max);
    assert!((inside - most).abs() < 2.0 * dy, "{inside} {most}");
}

#[test]
fn the_map_has_the_same_metres_in_both_directions_and_the_ways_that_were_flown() {
    let known = known();
    let plan = Drawing::of(&known.page, "From above");
    let (dx, dy) = plan.resolution();
    for drawn in plan.points("estimate") {
        // East is to the right, north is up.
        let near = known.places.iter().any(|[n, e]| (drawn.0 - e).abs() <= dx && (drawn.1 - n).abs() <= dy);
        assert!(near, "{drawn:?} was never flown");
    }
    let extent = |values: &mut dyn Iterator<Item = f64>| {
        values.fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)))
    };
    let drawn = extent(&mut plan.points("estimate").iter().map(|p| p.1));
    let flown = extent(&mut known.places.iter().map(|p| p[0]));
    assert!((drawn.0 - flown.0).abs() < 0.3 && (drawn.1 - flown.1).abs() < 0.3, "{drawn:?} {flown:?}");
    for name in ["truth", "GNSS"] {
        let way = extent(&mut plan.points(name).iter().map(|p| p.1));
        assert!((way.1 - flown.1).abs() < 6.0 && (way.0 - flown.0).abs() < 6.0, "{name} {way:?} {flown:?}");
    }
    let aspect: f64 =
        known.page.split("aspect-ratio:").nth(1).unwrap().split('"').next().unwrap().parse().unwrap();
    let metres = (1000.0 * dx / 0.06) / (500.0 * dy / 0.06);
    assert!((metres / aspect - 1.0).abs() < 0.01, "{metres} {aspect}");
}

#[test]
fn heights_are_drawn_with_the_source_that_lies_and_its_conviction() {
    let known = known();
    let heights = Drawing::of(&known.page, "Height above the origin");
    heights.shows("estimate", &known.heights);
    let (dx, dy) = heights.resolution();
    for drawn in heights.points("barometer") {
        let near = |k: &(f64, f64)| (drawn.0 - k.0).abs() < 0.06 + dx && (drawn.1 - k.1).abs() < 1.0 + dy;
        assert!(drawn.0 < known.barometer[0].0 + 0.1 || known.barometer.iter().any(near), "{drawn:?}");
    }
    let apart = Drawing::of(&known.page, "Every source of the height, less the estimate");
    let lies: Vec<f64> =
        apart.points("barometer").iter().filter(|p| (165.0..185.0).contains(&p.0)).map(|p| p.1).collect();
    let mean = lies.iter().sum::<f64>() / lies.len() as f64;
    assert!((mean - 8.0).abs() < 1.0, "{mean}");
    let convicted = Drawing::of(&known.page, "Sources of heights that were convicted").stays("barometer");
    let outcome = known.runner.outcome();
    let found = outcome.events.iter().find_map(|(t, e)| match e.kind {
        EventKind::HeightFault { channel: Channel::Baro, for_s, .. } => Some(t - for_s),
        _ => None,
    });
    assert!(
        (convicted[0].0 - found.unwrap()).abs() < 0.5 && (convicted[0].0 - 150.0).abs() < 3.0,
        "{convicted:?}"
    );
}

#[test]
fn witnesses_of_the_heading_are_drawn_less_the_estimate() {
    let known = known();
    let drawing = Drawing::of(&known.page, "Every witness of the heading, less the estimate");
    let (dx, dy) = drawing.resolution();
    for drawn in drawing.points("truth") {
        // What turns between a solution and the truth's own time is taken out: the raw difference has it in.
        let near = |k: &(f64, f64)| (drawn.0 - k.0).abs() <= dx && (drawn.1 - k.1).abs() <= dy + 3.0;
        assert!(known.yaw_errors.iter().any(near), "{drawn:?}");
    }
    let of = |points: &[(f64, f64)]| {
        let late: Vec<f64> = points.iter().filter(|p| p.0 > 60.0).map(|p| p.1).collect();
        (late.iter().map(|v| v * v).sum::<f64>() / late.len() as f64).sqrt()
    };
    assert!(of(&drawing.points("truth")) < of(&known.yaw_errors) + 1.0);
    // A magnetometer of a simulated flight is off by what its noise makes.
    assert!(of(&drawing.points("magnetometer 0")) < 15.0);
}

#[test]
fn innovations_flow_and_vibration_are_those_of_the_navigator() {
    let known = known();
    let navigator = &known.runner.pipeline.navigator;
    for (measured, title) in
        [(Measured::GnssPosition, "GNSS position, GNSS 0"), (Measured::Flow, "optical flow 0")]
    {
        let drawing = Drawing::of(&known.page, title);
        let nis = navigator.statuses().nis(measured);
        let text =
            format!("{} fused, {} gated out, mean NIS {:.2}.", nis.fused, nis.gated, nis.mean().unwrap());
        assert!(known.page.contains(&text), "{text}");
        let means = drawing.points("NIS, mean");
        let mean = means.iter().map(|p| p.1).sum::<f64>() / means.len() as f64;
        assert!(
            (mean - nis.mean().unwrap()).abs() < 0.3 * nis.mean().unwrap() + 0.02,
            "{title}: {mean} {nis:?}"
        );
    }
    let (id, calibration, _) = navigator.flow_sensors().next().unwrap();
    let scale = Drawing::of(&known.page, &format!("Flow {id}: scale error"));
    let last = *scale.points("learned").last().unwrap();
    assert!(
        (last.1 - 100.0 * calibration.estimate()[2]).abs() < 2.0 * scale.resolution().1 + 0.05,
        "{last:?}"
    );
    let (_, latency_s, _) = navigator.flow_latencies_s().next().unwrap();
    let latency = Drawing::of(&known.page, &format!("Flow {id}: latency"));
    let last = *latency.points("learned").last().unwrap();
    assert!((last.1 - 1e3 * latency_s).abs() < 2.0 * latency.resolution().1 + 0.5, "{last:?}");

    let rate = Drawing::of(&known.page, "IMU samples a second");
    let drawn = rate.points("IMU");
    let mean = drawn.iter().map(|p| p.1).sum::<f64>() / drawn.len() as f64;
    assert!((mean / known.runner.outcome().imu.rate_hz().unwrap() - 1.0).abs() < 0.03, "{mean}");
    // Differences of neighbours hold what is fast, and √2 of what is white.
    let neighbours = known.forces.windows(2).filter(|w| w[0].0 > 120.0);
    let squares: Vec<f64> = neighbours.map(|w| (w[1].1[2] - w[0].1[2]).powi(2) / 2.0).collect();
    let white = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    let drawn = Drawing::of(&known.page, "Vibration of the accelerometers").points("z");
    let late: Vec<f64> = drawn.iter().filter(|p| p.0 > 120.0).map(|p| p.1 * p.1).collect();
    let mean = (late.iter().sum::<f64>() / late.len() as f64).sqrt();
    assert!((0.4..2.5).contains(&(mean / white)), "{mean} {white}");
}

#[test]
fn modes_faults_and_events_are_on_the_timeline_and_in_the_tables() {
    let known = known();
    let outcome = known.runner.outcome();
    let lanes = Drawing::of(&known.page, "Modes, sources and events");
    let modes = lanes.stays("mode");
    for change in &outcome.modes {
        let found = modes
            .iter()
            .any(|(from, _, what)| what == change.mode.label() && (from - change.t_s).abs() < 0.4);
        assert!(found, "{change:?} {modes:?}");
    }
    let withheld = &lanes.stays("GNSS withheld")[0];
    assert!((withheld.0 - OUTAGE.0).abs() < 0.3 && (withheld.1 - OUTAGE.1).abs() < 0.3);
    let fault = &lanes.stays("fault put in")[0];
    assert!((fault.0 - 150.0).abs() < 0.3 && fault.2 == FAULT, "{fault:?}");
    assert_eq!(lanes.stays("carried by").iter().filter(|s| s.2 == VelocitySource::Flow.label()).count(), 1);
    assert!(lanes.stays("barometer 0").iter().any(|s| s.2 != "healthy"));
    for (_, event) in &outcome.events {
        let text = event.to_string().replace('>', "&gt;");
        assert!(known.page.contains(&format!("<td>{text}</td>")), "{text}");
    }
    let told = outcome.outages[0];
    assert!(known.page.contains(&format!(">{:.1}</td>", told.horizontal_error_end_m.unwrap())));
}

#[test]
fn drift_is_what_the_shadows_have_measured() {
    let known = known();
    let measured = known.runner.pipeline.navigator.measured_drift();
    for m in measured.iter().filter(|m| m.times > 0) {
        let drawing = Drawing::of(&known.page, &format!("Carried by {}", m.source.label()));
        let at: Vec<f64> = drawing
            .points("error")
            .into_iter()
            .filter(|p| p.0 >= m.after_s - 0.1 && p.0 < 1.15 * m.after_s)
            .map(|p| p.1)
            .collect();
        assert_eq!(at.len(), m.times as usize, "{m:?}");
        let rms = (at.iter().map(|v| v * v).sum::<f64>() / at.len() as f64).sqrt();
        let told = m.error_m.unwrap();
        assert!((rms - told).abs() < 0.03 * told + drawing.resolution().1, "{m:?} {rms}");
    }
    assert!(measured.iter().any(|m| m.times > 3 && m.source == VelocitySource::Flow), "{measured:?}");
}

/// The page of these logs, by the command.
fn page(folder: &Path, logs: &[PathBuf], more: &[&str]) -> String {
    let out = folder.join("report.html");
    let mut arguments: Vec<String> =
        vec!["report".into(), "--force".into(), "--out".into(), out.display().to_string()];
    arguments.extend(logs.iter().map(|l| l.display().to_string()));
    arguments.extend(more.iter().map(|m| (*m).to_owned()));
    let ran = holdover(&arguments);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    fs::read_to_string(out).unwrap()
}

#[test]
fn two_seconds_and_a_log_without_gnss_say_what_they_lack_and_have_no_empty_axis() {
    let folder = tempdir().unwrap();
    let short = write_log(folder.path(), "short.tlog", &bytes_of(&records(PX4, 0.0, 2.0)));
    let page_of_short = page(folder.path(), &[short], &[]);
    for lack in ["Nothing was measured", "Nothing was fused", "GNSS was there all the time"] {
        assert!(page_of_short.contains(lack), "{lack}");
    }
    // Without any message of a receiver.
    let deaf: Vec<_> = records(PX4, 0.0, 60.0).into_iter().filter(|r| ![24, 124].contains(&r.id())).collect();
    let deaf = write_log(folder.path(), "deaf.tlog", &bytes_of(&deaf));
    let page_of_deaf = page(folder.path(), &[deaf], &[]);
    assert!(page_of_deaf.contains("Never heard: GNSS"), "{}", page_of_deaf.len());
    for page in [page_of_short, page_of_deaf] {
        for title in titles(&page) {
            let xml = page.split("<svg ").find(|s| s.contains(&format!("aria-label=\"{title}\""))).unwrap();
            assert!(xml.contains("data-name="), "{title} is empty");
        }
        assert!(!page.contains("NaN") && !page.contains(">inf"), "no number");
    }
}

#[test]
fn hostile_names_stay_text_and_nothing_is_overwritten() {
    let folder = tempdir().unwrap();
    let name = "<img src=x onerror=alert(1)>&\"'.tlog";
    let log = write_log(folder.path(), name, &bytes_of(&records(PX4, 0.0, 20.0)));
    let other = write_log(folder.path(), "other.tlog", &bytes_of(&records(PX4, 0.0, 20.0)));
    let text = page(folder.path(), &[log.clone(), other], &["--outage", "10..15"]);
    assert!(
        !text.contains("<img") && text.contains("&lt;img src=x onerror=alert(1)&gt;&amp;&quot;&#39;.tlog")
    );
    assert_eq!(text.matches("<script>").count(), 1);
    assert!(text.contains("id=\"flight-1\"") && text.contains("href=\"#flight-1\""));
    let (out, log) = (folder.path().join("report.html"), log.display().to_string());
    holdover(&["report", &log, "--out", out.to_str().unwrap()]).fails(2, &["report.html", "--force"]);
    // The same page by the way of `replay`.
    let other_out = folder.path().join("replayed.html");
    let ran = holdover(&["replay", &log, "--outage", "10..15", "--report", other_out.to_str().unwrap()]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let replayed = fs::read_to_string(other_out).unwrap();
    assert_eq!(titles(&replayed), titles(&page(folder.path(), &[log.into()], &["--outage", "10..15"])));
}

#[test]
fn a_page_is_small() {
    let known = known();
    assert!(known.page.len() < 1_500_000, "{}", known.page.len());
}

#[test]
fn a_fleet_is_shown_with_its_distributions_and_its_worst_as_the_table_has_them_merged_or_not() {
    let folder = tempdir().unwrap();
    let log = write_log(folder.path(), "a&b.tlog", &bytes_of(&records(PX4, 0.0, 240.0)));
    let short = write_log(folder.path(), "short.tlog", &bytes_of(&records(PX4, 0.0, 30.0)));
    let (log, short) = (log.to_str().unwrap(), short.to_str().unwrap());
    let of = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (one, merged, results) = (of("one.html"), of("merged.html"), of("results"));
    let question = ["--lengths", "20,40", "--starts", "3"];
    let told =
        holdover(&[&["evaluate", log, short, "--json", "--report", &one][..], &question].concat()).json();
    assert_eq!(
        holdover(&[&["evaluate", log, short, "--out", &results][..], &question].concat()).code,
        Some(0)
    );
    assert_eq!(holdover(&["evaluate", "--merge", &results, "--report", &merged]).code, Some(0));
    let page = fs::read_to_string(&one).unwrap();
    assert_eq!(page, fs::read_to_string(&merged).unwrap());

    let mut errors: Vec<f64> = told["rows"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|r| r["estimator"] == "shipped" && r["length_s"] == 40.0)
        .filter_map(|r| r["horizontal_error_end_m"].as_f64())
        .collect();
    errors.sort_by(f64::total_cmp);
    let n = errors.len() as f64;
    let drawn = Drawing::of(&page, "Outages of 40 s");
    let known: Vec<(f64, f64)> = std::iter::once((0.0, 0.0))
        .chain(errors.iter().enumerate().map(|(i, e)| (*e, 100.0 * (i + 1) as f64 / n)))
        .collect();
    drawn.shows("shipped", &known);
    let honest = Drawing::of(&page, "Errors over what was claimed").points("a normal distribution's");
    assert!(honest.iter().all(|(k, part)| (part - 100.0 * (1.0 - (-k * k).exp())).abs() < 1.0));
    // The worst leads to its flight's row, and says how to look at it.
    assert!(page.contains("<a href=\"#log-0\">a&amp;b.tlog</a>") && page.contains("id=\"log-0\""));
    let worst = told["rows"].as_array().unwrap().iter().filter(|r| r["estimator"] == "shipped");
    let worst = worst.max_by(|a, b| {
        let of = |r: &serde_json::Value| r["horizontal_error_end_m"].as_f64().unwrap_or(0.0);
        of(a).total_cmp(&of(b))
    });
    let (start, length) =
        (worst.unwrap()["start_s"].as_f64().unwrap(), worst.unwrap()["length_s"].as_f64().unwrap());
    let command = format!("a&amp;b.tlog&#39; --outage {start:.1}..{:.1}</code>", start + length);
    let table = page.split("look at it with").nth(1).unwrap();
    // A short outage within a long one may end with the same error.
    assert!(table.split("</tr>").skip(1).take(2).any(|row| row.contains(&command)), "{command}");
    assert!(page.contains("no outage of these lengths fits"), "why a flight has no rows");
    holdover(&["evaluate", log, "--out", &results, "--report", &one]).fails(2, &["--merge"]);
}
