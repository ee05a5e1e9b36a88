//! The losses of GNSS that a log holds by itself: what Holdover made of them, and what the autopilot's own filter had.
//!
//! An outage that is made by withholding GNSS says nothing of the autopilot's filter, which was aided all the time. A loss that happened
//! hit both alike, so that there its estimate is a peer: both are compared with the first fix after it, as they were before they
//! heard of it.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::geo::{Geodetic, LocalNed};
use crate::log::{Log, LogError};
use crate::pipeline::PipelineSettings;
use crate::sample::{GnssSample, Input, Reference, Sample, TruthState};
use crate::time::AutopilotTime;

use super::runner::{ReferenceKind, Runner};

/// A receiver without a fix for less than this is no loss, s.
pub const LEAST_S: f64 = 5.0;
/// The autopilot's estimate is carried on by its velocity over at most so long, s.
const CURRENT_S: f64 = 1.0;

/// A loss that is in the log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LossRow {
    /// When the last fix before it was, s since the first sample.
    pub start_s: f64,
    /// How long there was none, s.
    pub length_s: f64,
    /// What both are compared with at its end.
    pub reference: ReferenceKind,
    /// Holdover's horizontal error at its end, m.
    pub error_m: Option<f64>,
    /// What Holdover claimed that to be (1 sigma), m.
    pub sigma_m: Option<f64>,
    /// The horizontal error of the autopilot's own estimate, m.
    pub own_error_m: Option<f64>,
}

/// What is followed while the log is played.
#[derive(Clone, Debug, Default)]
struct Follower {
    fixed: Option<AutopilotTime>,
    own: Option<(AutopilotTime, Geodetic, Vector3<f64>)>,
    truth: Option<TruthState>,
    rows: Vec<LossRow>,
}

/// The losses within the flight (from when to when, s since the first sample) in the order in which they happened.
///
/// # Errors
/// What reading the log says.
pub fn losses(
    log: &Log,
    settings: &PipelineSettings,
    flight: Option<(f64, f64)>,
) -> Result<Vec<LossRow>, LogError> {
    let Some((from, to)) = flight else { return Ok(Vec::new()) };
    let mut runner = Runner::new(settings, &[]);
    runner.pipeline.follow(log.vehicle());
    let mut follower = Follower::default();
    log.play(
        |_, _| {},
        |clock, item| {
            match item {
                // Before the navigation hears of it.
                Input::Sample(Sample::Gnss(fix)) if fix.receiver == 0 => follower.fix(&runner, fix, from, to),
                Input::Reference(Reference::Global { time, position, velocity }) => {
                    follower.own = Some((*time, *position, velocity.raw()));
                }
                Input::Reference(Reference::Truth(truth)) if truth.position.is_some() => {
                    follower.truth = Some(*truth);
                }
                _ => {}
            }
            runner.take(clock, item);
        },
    )?;
    Ok(follower.rows)
}

impl Follower {
    fn fix(&mut self, runner: &Runner, fix: &GnssSample, from: f64, to: f64) {
        let Some(position) = fix.position else { return };
        let before = self.fixed.replace(fix.time);
        let Some(before) = before.filter(|b| fix.time.seconds_since(*b) >= LEAST_S) else { return };
        let (start_s, now_s) = (runner.seconds(before), runner.seconds(fix.time));
        if start_s < from || now_s > to {
            return;
        }
        let Some(frame) = runner.pipeline.navigator.frame() else { return };
        let truth = self.truth.filter(|t| fix.time.seconds_since(t.time).abs() < CURRENT_S);
        let (reference, at, when) = match truth.and_then(|t| Some((t.time, t.position?))) {
            Some((time, position)) => (ReferenceKind::Truth, position, time),
            None => {
                let (latency_s, _) = runner.pipeline.navigator.gnss_latency_s();
                (ReferenceKind::Gnss, position, fix.time - crate::time::Span::from_seconds(latency_s))
            }
        };
        let at_ned = frame.to_ned(&at);
        let solution = runner.solution().map(|s| {
            let ned = (s.position + s.velocity * when.seconds_since(s.time)).raw();
            ((ned - at_ned).xy().norm(), s.horizontal_sigma_m())
        });
        self.rows.push(LossRow {
            start_s,
            length_s: now_s - start_s,
            reference,
            error_m: solution.map(|s| s.0),
            sigma_m: solution.map(|s| s.1),
            own_error_m: self.own_error_m(frame, &at_ned, when),
        });
    }

    fn own_error_m(&self, frame: &LocalNed, at_ned: &Vector3<f64>, when: AutopilotTime) -> Option<f64> {
        let (time, position, velocity_ned) = self.own?;
        let dt = when.seconds_since(time);
        (dt.abs() < CURRENT_S).then(|| (frame.to_ned(&position) + velocity_ned * dt - at_ned).xy().norm())
    }
}
