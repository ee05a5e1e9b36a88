//! What passes the gate, and what does not.

use super::*;
use crate::wire::frame::{ComponentId, SystemId};
use crate::wire::session::Address;
use crate::wire::session::heartbeat::{SystemStatus, heartbeat};
use crate::wire::session::outgoing::FrameWriter;
use mavlink::dialects::ardupilotmega::{MavMessage, SYSTEM_TIME_DATA};

/// Some time in 2026, µs since 1970.
const NOW_US: i64 = 1_790_000_000_000_000;

fn key() -> SigningKey {
    SigningKey::new([3; 32])
}

fn gate(accept_unsigned: AcceptUnsigned) -> SigningGate {
    SigningGate::new(Some(key()), &SigningSettings { accept_unsigned, ..SigningSettings::default() })
}

fn frame(message: &MavMessage) -> FrameBytes {
    let from = Address { system: SystemId(1), component: ComponentId::AUTOPILOT };
    FrameWriter::new(from).write(message).unwrap()
}

fn time_frame() -> FrameBytes {
    frame(&MavMessage::SYSTEM_TIME(SYSTEM_TIME_DATA { time_unix_usec: 3, time_boot_ms: 4 }))
}

/// Signed on link 5, this many seconds after [`NOW_US`].
fn signed_at(key: &SigningKey, seconds: f64) -> FrameBytes {
    signed(&time_frame(), key, 5, SigningStamp::of_unix_us(NOW_US + (seconds * 1e6) as i64)).unwrap()
}

fn admit(gate: &SigningGate, bytes: &FrameBytes) -> Result<(), Cause> {
    gate.admit(&bytes.frame().unwrap(), false, NOW_US)
}

#[test]
fn with_a_key_only_what_it_signed_comes_in_and_only_once() {
    let gate = gate(AcceptUnsigned::Auto);
    let good = signed_at(&key(), 0.0);
    assert_eq!(admit(&gate, &good), Ok(()));
    assert_eq!(admit(&gate, &good), Err(Cause::Replayed));
    assert_eq!(admit(&gate, &signed_at(&key(), -1.0)), Err(Cause::Replayed));
    assert_eq!(admit(&gate, &signed_at(&SigningKey::new([4; 32]), 1.0)), Err(Cause::BadSignature));
    assert_eq!(admit(&gate, &time_frame()), Err(Cause::Unsigned));
    assert_eq!(admit(&gate, &frame(&heartbeat(SystemStatus::Active, 0))), Err(Cause::Unsigned));
    assert_eq!(admit(&gate, &signed_at(&key(), 1.0)), Ok(()));
    let expected =
        SigningCounts { verified: 2, bad_signature: 1, replayed: 2, unsigned: 2, ..SigningCounts::default() };
    assert_eq!(gate.counts(), expected);
}

#[test]
fn a_forged_frame_moves_no_stamp() {
    let gate = gate(AcceptUnsigned::Auto);
    assert!(admit(&gate, &signed_at(&SigningKey::new([4; 32]), 1e6)).is_err());
    assert_eq!(admit(&gate, &signed_at(&key(), 0.0)), Ok(()));
}

#[test]
fn a_new_stream_is_of_the_last_minute_and_one_that_lags_is_answered_all_the_same() {
    let gate = gate(AcceptUnsigned::Auto);
    let late = signed_at(&key(), -61.0);
    assert_eq!(admit(&gate, &late), Err(Cause::OldSignature));
    assert!(gate.is_genuine(&late.frame().unwrap(), false));
    assert!(!gate.is_genuine(&time_frame().frame().unwrap(), false));
    assert_eq!(admit(&gate, &signed_at(&key(), -59.0)), Ok(()));
    assert!(!gate.is_genuine(&late.frame().unwrap(), false), "a replay by now");
}

#[test]
fn what_is_taken_unsigned_is_as_configured() {
    let beat = frame(&heartbeat(SystemStatus::Active, 0));
    for (accept, of_beat, of_other) in [
        (AcceptUnsigned::Auto, false, false),
        (AcceptUnsigned::Never, false, false),
        (AcceptUnsigned::Heartbeat, true, false),
        (AcceptUnsigned::Always, true, true),
    ] {
        let gate = gate(accept);
        assert_eq!((admit(&gate, &beat).is_ok(), admit(&gate, &time_frame()).is_ok()), (of_beat, of_other));
        // A signature that is there is looked at, whatever is taken without one.
        assert!(admit(&gate, &signed_at(&SigningKey::new([4; 32]), 0.0)).is_err());
    }
    let settings = SigningSettings { sensors_unsigned: true, ..SigningSettings::default() };
    let gate = SigningGate::new(Some(key()), &settings);
    let bytes = time_frame();
    assert_eq!(gate.admit(&bytes.frame().unwrap(), true, NOW_US), Ok(()));
    assert_eq!(admit(&gate, &bytes), Err(Cause::Unsigned));
}

#[test]
fn without_a_key_everything_comes_in_and_signatures_are_counted() {
    let gate = SigningGate::default();
    assert_eq!(admit(&gate, &time_frame()), Ok(()));
    assert_eq!(admit(&gate, &signed_at(&key(), -1e6)), Ok(()));
    assert_eq!(gate.counts(), SigningCounts { no_key: 1, ..SigningCounts::default() });
    assert_eq!(gate.sign(time_frame(), 0, NOW_US), Some(time_frame()));
}

#[test]
fn what_goes_out_is_signed_with_the_links_id_and_stamps_that_increase() {
    let settings = SigningSettings { link_id: 254, ..SigningSettings::default() };
    let ours = SigningGate::new(Some(key()), &settings);
    let theirs = gate(AcceptUnsigned::Never);
    let ids: Vec<u8> = [0, 1, 2, 0, 0]
        .into_iter()
        .map(|link| {
            let bytes = ours.sign(time_frame(), link, NOW_US).unwrap();
            assert_eq!(admit(&theirs, &bytes), Ok(()));
            Signature::of(&bytes.frame().unwrap()).unwrap().link_id
        })
        .collect();
    assert_eq!(ids, [254, 255, 0, 254, 254]);
    // A clock that is set back does not set the stamps back.
    let bytes = ours.sign(time_frame(), 0, 0).unwrap();
    assert_eq!(admit(&theirs, &bytes), Ok(()));
}

#[test]
fn a_restart_forgets_nothing_and_a_killed_process_neither() {
    for at_the_end in [true, false] {
        let before = gate(AcceptUnsigned::Auto);
        assert_eq!(admit(&before, &signed_at(&key(), 0.0)), Ok(()));
        let sent = before.sign(time_frame(), 0, NOW_US).unwrap();
        assert_eq!(admit(&before, &signed_at(&key(), 0.5)), Ok(()));
        let kept = if at_the_end { before.keepable(true) } else { before.keepable(false) };
        let after = gate(AcceptUnsigned::Auto);
        after.recall(&kept);
        for seconds in [0.0, 0.5] {
            assert_eq!(admit(&after, &signed_at(&key(), seconds)), Err(Cause::Replayed), "{seconds}");
        }
        assert_eq!(admit(&after, &signed_at(&key(), 3.0)), Ok(()));
        let stamp = |bytes: &FrameBytes| Signature::of(&bytes.frame().unwrap()).unwrap().stamp;
        assert!(stamp(&after.sign(time_frame(), 0, 0).unwrap()) > stamp(&sent));
    }
}

/// Without the time of day an autopilot counts its frames: it must not be shut out for long after a restart.
#[test]
fn a_stream_that_counts_frames_goes_on_after_a_kill() {
    let stamp = |n: u64| SigningStamp(SigningStamp::of_unix_us(NOW_US).0 + n);
    let frame = |n| signed(&time_frame(), &key(), 5, stamp(n)).unwrap();
    let before = gate(AcceptUnsigned::Auto);
    let mut kept = before.keepable(false);
    for n in 0..2000 {
        assert_eq!(admit(&before, &frame(n)), Ok(()));
        if n % 200 == 0 {
            kept = before.keepable(false);
        }
    }
    let after = gate(AcceptUnsigned::Auto);
    after.recall(&kept);
    assert_eq!(admit(&after, &frame(1999)), Err(Cause::Replayed));
    assert_eq!(admit(&after, &frame(2201)), Ok(()));
}
