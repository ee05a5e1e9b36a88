//! What becomes of a receiver that is found wrong, and of the one beside it.
//!
//! Both receivers are judged by the same tests all the time, one of them is navigated on. When that one fails, or its fixes have not passed
//! for half a second, the other takes over with all that is known of it, if it is trusted itself. Where two that pass every test are further
//! apart than is usual for them, one of them lies, and nobody can say which: both are suspect, and the uncertainty says so.

use nalgebra::Vector2;

use crate::navigator::tuning::receiver_lie::CARRIED_S;
use crate::sample::GnssSample;
use crate::time::{AutopilotTime, Span};

use super::context::{Context, SourceFacts};
use super::core::Core;
use super::inertia;
use super::judge::{self, Charge};
use super::monitor::GnssFault;
use super::monitor::felt_velocity::{FeltVelocity, VelocityLie};
use super::monitor::gnss_integrity::Standing;
use super::monitor::receiver_lie::{ReceiverFinding, ShownLie};
use super::monitor::velocity_step::VelocitySteps;
use super::reset::Reset;
use super::solution::Mode;
use super::sources::SourceSet;
use super::sources::gnss::{FixReading, expectation};
use super::sources::status::{SourceId, SourceKind, SourceStatus};

const IMU: SourceId = SourceId::only(SourceKind::Imu);

/// What a fault is charged as; a loss of the fix is none.
const fn charge_of(fault: GnssFault) -> Option<Charge> {
    match fault {
        GnssFault::Spoofed | GnssFault::Jammed | GnssFault::SignalsInconsistent => Some(Charge::SaysSo),
        GnssFault::Frozen => Some(Charge::Stuck),
        GnssFault::Inconsistent => Some(Charge::WalksOff),
        GnssFault::ContradictsFlow => Some(Charge::ContradictsFlow),
        GnssFault::PositionJump | GnssFault::VelocityJump | GnssFault::ContradictsInertia => {
            Some(Charge::ContradictsInertia)
        }
        _ => None,
    }
}

fn id_of(receiver: u8) -> SourceId {
    SourceId { kind: SourceKind::Gnss, id: receiver }
}

/// A fix passed, or failed, and its receiver is `trusted` or not. A charge is brought when trust is lost, and taken back when it is won again:
/// after some seconds of good fixes ([`super::monitor::gnss_integrity`] says how many).
pub(super) fn charge(
    core: &mut Core,
    now: AutopilotTime,
    receiver: u8,
    verdict: Result<(), GnssFault>,
    trusted: bool,
) {
    let id = id_of(receiver);
    match verdict.map_err(charge_of) {
        Err(Some(charge)) if !trusted => judge::accuse(core, now, id, charge),
        Ok(()) if trusted && core.statuses.charge(id).is_some_and(|c| c != Charge::FitsBadly) => {
            judge::acquit(core, now, id);
        }
        _ => {}
    }
}

/// A fix of the receiver in use, set against the flow, which testifies together with inertia where that suspects the receiver.
///
/// # Errors
/// [`GnssFault::ContradictsFlow`] while position and velocity walk off together. The way back: some seconds in which they do not.
pub(super) fn hear_flow(
    core: &mut Core,
    sources: &mut SourceSet,
    reading: &FixReading,
) -> Result<(), GnssFault> {
    let gnss = &mut sources.gnss;
    let (flow, known) = (gnss.travel.at(reading.measured), gnss.travel.covariance());
    let (was_walking, no_more) = (gnss.witness.walk().is_some(), gnss.witness.walks_no_more(known));
    let times = [reading.stamp, reading.measured];
    gnss.witness.fix(times, reading.position_ned.xy(), flow, known);
    gnss.air.fix(times, reading.position_ned.xy(), gnss.steps.is_doubted() || gnss.witness.doubts());
    if let Some((seconds, step)) = gnss.steps.doubted(reading.measured) {
        gnss.witness.hear_inertia(seconds, &step, known);
    }
    let Some(walk) = gnss.witness.walk().copied() else {
        if was_walking && no_more {
            gnss.steps.clear();
        }
        return Ok(());
    };
    gnss.steps.confirm(reading.measured);
    if !was_walking {
        core.integrity.walks(walk.walked_ne, walk.spread_m);
        core.integrity.leads(&reading.position_error);
        sources.flow.unlearn(&mut sources.gnss.travel, core);
    }
    Err(GnssFault::ContradictsFlow)
}

/// A fix of the receiver in use, set against inertia.
///
/// # Errors
/// [`GnssFault::ContradictsInertia`] while its velocity has stepped where inertia felt nothing. The way back: it steps back, or agrees with what carries, in velocity or position, or was
/// silent, or does not lead further off than the position is uncertain.
pub(super) fn hear_inertia(
    core: &mut Core,
    sources: &mut SourceSet,
    reading: &FixReading,
) -> Result<(), GnssFault> {
    let facts = sources.facts(core);
    let (flies, position_sigma) = (inertia::flies(core, &facts), core.horizontal_sigma_m(&facts));
    let steps = &mut sources.gnss.steps;
    let seen = reading.velocity_ne.zip(core.timeline.impulse(reading.measured));
    if !matches!(core.mode, Mode::Aided | Mode::Rejoining | Mode::Holdover) {
        steps.forget();
    }
    let Some((velocity, impulse)) = seen else { return told(steps) };
    let sound = !core.witnesses.inertia.is_doubted() && core.statuses.charge(IMU).is_none();
    steps.observe(&FeltVelocity {
        time: reading.measured,
        velocity,
        impulse: impulse.xy(),
        epoch: core.timeline.epoch(),
        judged: core.mode == Mode::Aided && sound && core.estimator.has_error_state(),
        flies,
        error: reading.velocity_error,
        sigma: core.estimator.speed_sigma().unwrap_or(f64::INFINITY),
        position_sigma: position_sigma.unwrap_or(f64::INFINITY),
        apart: core.dead_reckoning().then_some(reading.position_error),
    });
    let gnss = &mut sources.gnss;
    let known = gnss.travel.covariance();
    let refutes = |seconds: f64, step: &Vector2<f64>| {
        let by_flow = gnss.witness.refutes(seconds, step, velocity.norm(), known);
        [by_flow, gnss.air.refutes(seconds, step)].into_iter().flatten().reduce(std::ops::Add::add)
    };
    gnss.steps.weigh_hunches(reading.measured, refutes);
    if let Some((seconds, step)) = gnss.steps.doubted(reading.measured) {
        let refuted = refutes(seconds, &step);
        gnss.steps.hear_witnesses(refuted);
    }
    let steps = &mut gnss.steps;
    if steps.take_cleared() {
        core.witnesses.unexplained.cleared();
    }
    told(steps)
}

/// The innovations of the filter, which follows the receiver in use: where they show that it lies, the filter is what it would be had it known.
pub(super) fn judge_innovations(
    core: &mut Core,
    sources: &mut SourceSet,
    now: AutopilotTime,
    facts: &SourceFacts,
) {
    let SourceSet { gnss, flow, .. } = sources;
    let follows = core.mode == Mode::Aided && core.integrity.trusted() && gnss.steps.lie().is_none();
    let carried = facts.flow_velocity.is_some_and(|(told, _)| now.seconds_since(told) < CARRIED_S);
    if !follows || !carried || !inertia::flies(core, facts) {
        return core.witnesses.receiver.rest();
    }
    let found = core.witnesses.receiver.judge(now, core.estimator.jump_windows());
    if found.is_none() && gnss.steps.suspected().is_none() {
        // It has run its course, or others have refuted it.
        core.witnesses.receiver.came_to_nothing();
    }
    let since = |lie: &ShownLie| now - Span::from_seconds(lie.age_s);
    let lie = match found {
        None => {
            let gone =
                |since| core.witnesses.receiver.has_vanished(now, since, core.estimator.jump_windows());
            if gnss.steps.suspected().is_some_and(gone) {
                gnss.steps.clear();
            }
            return;
        }
        Some(ReceiverFinding::Suspected(lie)) => {
            return gnss.steps.suspect(now, VelocityLie::new(since(&lie), lie.step), lie.odds);
        }
        Some(ReceiverFinding::Lies(lie)) => lie,
    };
    let Some(moved) = core.estimator.believe_receiver_lies(lie.window) else { return };
    gnss.steps.charge(since(&lie), lie.step);
    core.timeline.reset(&Reset::Relocated);
    core.published.stays(&moved.position_ned);
    core.witnesses.unexplained.undone();
    flow.unlearn(&mut gnss.travel, core);
}

/// Who is wrong where inertia parts from a receiver that agrees with itself? While nobody knows, the position may be off by as much as they are apart.
pub(super) fn dispute(
    core: &mut Core,
    sources: &SourceSet,
    now: AutopilotTime,
    reading: &FixReading,
    judged: Result<Standing, GnssFault>,
) {
    let outage = core.dead_reckoning();
    let unexplained = &mut core.witnesses.unexplained;
    let open = match judged {
        Err(GnssFault::VelocityJump) => !sources.gnss.steps.parted_at_once(),
        // That they are near for a moment settles nothing before the receiver is believed again.
        Ok(standing) => unexplained.is_disputed() && (outage || standing != Standing::Near),
        Err(_) => false,
    };
    match reading.velocity_error {
        Some(apart) if open => unexplained.dispute(now, &reading.position_error, apart.norm()),
        _ => unexplained.settled(),
    }
}

fn told(steps: &VelocitySteps) -> Result<(), GnssFault> {
    if steps.lie().is_some() { Err(GnssFault::ContradictsInertia) } else { Ok(()) }
}

/// A fix of the receiver that is not in use. True when it is from now on.
pub(super) fn spare(core: &mut Core, sources: &mut SourceSet, now: AutopilotTime, s: &GnssSample) -> bool {
    let judged = judge_spare(core, sources, now, s).and_then(|(standing, reading)| {
        if walks_along(core, sources, &reading) {
            return Err(GnssFault::ContradictsFlow);
        }
        if core.integrity.walks_with(&sources.gnss.spare.wander()) {
            return Err(GnssFault::Inconsistent);
        }
        if shares_step(core, &mut sources.gnss.steps, &reading) {
            return Err(GnssFault::ContradictsInertia);
        }
        Ok((standing, reading))
    });
    let spare = &mut sources.gnss.spare;
    match judged {
        Ok((standing, _)) => {
            spare.good(now, standing);
        }
        Err(fault) => {
            spare.bad(now, fault);
        }
    }
    let trusted = spare.trusted();
    if let Ok((_, reading)) = &judged
        && trusted
        && core.integrity.trusted()
    {
        compare(core, sources, now, s.receiver, reading);
    }
    // Who contradicts the one in use is not acquitted for being consistent in itself.
    charge(
        core,
        now,
        s.receiver,
        judged.map(|_| ()),
        trusted && !(judged.is_ok() && sources.gnss.disagrees()),
    );
    if judged.is_ok() && trusted && core.integrity.fails(now) {
        core.integrity.take_over(&mut sources.gnss.spare);
        sources.gnss.use_receiver(s.receiver);
        judge::acquit(core, now, id_of(s.receiver));
        return true;
    }
    false
}

/// The velocity of the receiver in use has stepped, and that of this one lies where the step has led, as far as anybody can tell.
fn shares_step(core: &Core, steps: &mut VelocitySteps, reading: &FixReading) -> bool {
    let Some(velocity) = reading.velocity_ne.filter(|_| steps.lie().is_some()) else { return false };
    let impulse = core.timeline.impulse(reading.measured);
    impulse.is_none_or(|felt| steps.is_shared_by(&(velocity - felt.xy()), core.timeline.epoch()))
}

/// Whether the receiver that is not in use is charged: it may have led the estimate astray.
pub(super) fn other_lied(core: &Core, in_use: u8) -> bool {
    let charged =
        |s: &SourceStatus| s.source.kind == SourceKind::Gnss && s.source.id != in_use && s.charge().is_some();
    core.statuses.iter().any(charged)
}

/// The receiver in use walks off from the flow, and this fix of the other lies where that has led it.
fn walks_along(core: &Core, sources: &SourceSet, reading: &FixReading) -> bool {
    if sources.gnss.witness.walk().is_none() {
        return false;
    }
    let walked = core.integrity.walked();
    // Until dead reckoning begins the estimate has walked, too.
    let led = if core.dead_reckoning() { reading.position_error } else { reading.position_error + walked };
    led.dot(&walked) > 0.5 * walked.norm_squared()
}

fn judge_spare(
    core: &Core,
    sources: &mut SourceSet,
    now: AutopilotTime,
    s: &GnssSample,
) -> Result<(Standing, FixReading), GnssFault> {
    sources.gnss.spare.admit(s)?;
    let position = s.position.ok_or(GnssFault::NoFix)?;
    let environment = core.surroundings.environment().ok_or(GnssFault::Untimely)?;
    let measured = sources.gnss.measured(now, s)?;
    let context = Context { core, facts: sources.facts(core) };
    let reading = sources.gnss.observe(s, measured, environment.frame.to_ned(&position), &context)?;
    let expected = expectation(&reading, &context);
    let position_ne = reading.position_ned.xy();
    let standing =
        sources.gnss.spare.judge(reading.stamp, position_ne, reading.velocity_ne, Some(expected))?;
    Ok((standing, reading))
}

/// Two receivers that both pass: how far they are apart.
fn compare(core: &mut Core, sources: &mut SourceSet, now: AutopilotTime, receiver: u8, spare: &FixReading) {
    let gnss = &mut sources.gnss;
    let in_use = gnss.receiver();
    let Some(disagree) = gnss.compare(spare) else { return };
    for id in [in_use, receiver].map(id_of) {
        if disagree {
            judge::accuse(core, now, id, Charge::FitsBadly);
        } else if core.statuses.charge(id) == Some(Charge::FitsBadly) {
            judge::acquit(core, now, id);
        }
    }
}
