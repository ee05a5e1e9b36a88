//! Which UDP peer is answered, and which is not even listened to: decided by source before content.
//!
//! While a peer is pinned and well, nobody else's datagrams are looked into. Others are judged ([`PeerCandidate`]) only while nobody is pinned,
//! or the pinned peer is quiet or has no sensors. It is given up
//!
//! - to another port of its host that goes on with the autopilot's clock, as soon as it is quiet: a router was restarted;
//! - to whoever qualifies when it was silent, or without IMU messages, for the time that is allowed;
//! - to nobody, when it was silent for so long.
//!
//! While it is held, in an outage, only who goes on with the autopilot's clock takes its place, for as long as there can be navigation left
//! to be captured.

use std::net::SocketAddr;

use super::boot_clock::BootClock;
use super::candidate::{Evidence, PeerCandidate};
use crate::time::{Companion, Span, Stamp};
use crate::wire::frame::{ComponentId, Frame, SystemId};
use crate::wire::session::identity::AutopilotShown;

/// A peer that said nothing for so long may have gone: others are looked at.
const QUIET: Span = Span::from_millis(150);
/// A peer that said nothing for so long has gone, if another port of its host goes on with the autopilot's clock.
const GONE: Span = Span::from_millis(300);
/// A held peer that is silent for longer is given up all the same: without an IMU there is no navigation any more.
const HELD_FOR: Span = Span::from_millis(60_000);
/// Addresses that are judged at once. An attacker can invent more; those of whom least was heard make room.
const MAX_CANDIDATES: usize = 256;

/// How a pin is won and lost.
#[derive(Clone, Copy, Debug)]
pub(super) struct PinPolicy {
    /// Only an autopilot of this system is answered.
    pub(super) system: Option<SystemId>,
    /// Only an autopilot of this component is answered.
    pub(super) component: Option<ComponentId>,
    /// Measurements are asked for, and no heartbeats.
    pub(super) for_sensors: bool,
    /// How long an autopilot's heartbeats must come.
    pub(super) confirm: Span,
    /// How long a peer may be silent, or without IMU messages.
    pub(super) silence: Span,
}

#[derive(Clone, Copy, Debug)]
struct PinnedPeer {
    peer: SocketAddr,
    sender: (SystemId, ComponentId),
    heard: Stamp<Companion>,
    /// When the last measurement came; before one did, when it was pinned.
    measured: Stamp<Companion>,
    clock: BootClock,
}

/// What is done with a datagram, by its source alone.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Regard {
    /// It comes from the pinned peer.
    Serve,
    /// It is looked into: its sender may be pinned.
    Judge,
    /// It is not looked into: the pinned peer is well.
    Ignore,
}

/// What becomes of the pin.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum PinChange {
    /// `peer` is pinned; so many others looked like autopilots, too. What was heard of its autopilot.
    Pinned { peer: SocketAddr, rivals: usize, shown: Option<AutopilotShown> },
    /// The autopilot is heard from another address, by its clock: the pin goes there.
    Followed { from: SocketAddr, to: SocketAddr },
    /// The pin goes to another, as the one before was silent, or without IMU messages, for so long.
    Replaced { from: SocketAddr, to: SocketAddr, silent: bool, lasted: Span },
    /// Nobody is pinned: the one before was silent for so long.
    Released { peer: SocketAddr, silent: Span },
}

/// The pin of one link.
#[derive(Debug)]
pub(super) struct Pin {
    policy: PinPolicy,
    pinned: Option<PinnedPeer>,
    /// Of the peer before, when nobody is pinned.
    before: Option<BootClock>,
    candidates: Vec<PeerCandidate>,
}

impl Pin {
    pub(super) fn new(policy: PinPolicy) -> Self {
        Self { policy, pinned: None, before: None, candidates: Vec::new() }
    }

    pub(super) fn peer(&self) -> Option<SocketAddr> {
        self.pinned.map(|pinned| pinned.peer)
    }

    /// Whether the pinned peer has everything that it should, so that nobody else is looked at.
    pub(super) fn is_well(&self, now: Stamp<Companion>) -> bool {
        self.pinned.is_some_and(|p| now - p.heard <= QUIET && !self.lacks_sensors(&p, now))
    }

    fn lacks_sensors(&self, pinned: &PinnedPeer, now: Stamp<Companion>) -> bool {
        !self.policy.for_sensors && now - pinned.measured > self.policy.silence
    }

    /// Judges a datagram by where it comes from.
    pub(super) fn regard(&self, peer: SocketAddr, now: Stamp<Companion>) -> Regard {
        match &self.pinned {
            Some(pinned) if pinned.peer == peer => Regard::Serve,
            _ if self.is_well(now) => Regard::Ignore,
            _ => Regard::Judge,
        }
    }

    /// Takes note of a valid frame from `peer`. Garbage keeps no pin alive, and wins none.
    pub(super) fn hear(&mut self, peer: SocketAddr, frame: &Frame<'_>, now: Stamp<Companion>) {
        let evidence = Evidence::of(frame, &self.policy);
        if let Some(pinned) = self.pinned.as_mut().filter(|pinned| pinned.peer == peer) {
            pinned.heard = now;
            if evidence == Some(Evidence::Measurement) {
                pinned.measured = now;
            }
            if evidence.is_some() || (frame.system(), frame.component()) == pinned.sender {
                pinned.clock.note(frame, now);
            }
            return;
        }
        let before = self.pinned.as_ref().map(|pinned| &pinned.clock).or(self.before.as_ref());
        if let Some(known) = self.candidates.iter_mut().find(|c| c.peer == peer) {
            return known.hear(frame, evidence, before, now);
        }
        if evidence.is_none() {
            return;
        }
        let mut candidate = PeerCandidate::new(peer, frame, now);
        candidate.hear(frame, evidence, before, now);
        if self.candidates.len() >= MAX_CANDIDATES
            && let Some((i, _)) = self.candidates.iter().enumerate().min_by_key(|(_, c)| c.weight())
        {
            self.candidates.swap_remove(i);
        }
        self.candidates.push(candidate);
    }

    /// Decides who is pinned from now on; to be asked after every datagram that was judged, and now and then. With `hold` the autopilot
    /// must not be mistaken for another.
    pub(super) fn decide(&mut self, now: Stamp<Companion>, hold: bool) -> Option<PinChange> {
        let patience = self.policy.silence.max(self.policy.confirm);
        self.candidates.retain(|c| now - c.last_heard() <= patience);
        let Some(pinned) = self.pinned else { return self.choose(now) };
        if self.is_well(now) {
            // What others showed in a pause of its own is no evidence against it in the next.
            self.candidates.clear();
            return None;
        }
        let silent = now - pinned.heard;
        if silent > GONE
            && let Some(to) = self.same_host(&pinned)
        {
            self.pin(to, now);
            return Some(PinChange::Followed { from: pinned.peer, to: to.peer });
        }
        let gone = silent > self.policy.silence;
        if !gone && !self.lacks_sensors(&pinned, now) {
            return None;
        }
        let held = hold && silent <= HELD_FOR;
        if let Some(to) = self.best(|c| !held || c.goes_on()) {
            let lasted = if gone { silent } else { now - pinned.measured };
            self.pin(to, now);
            return Some(if to.goes_on() {
                PinChange::Followed { from: pinned.peer, to: to.peer }
            } else {
                PinChange::Replaced { from: pinned.peer, to: to.peer, silent: gone, lasted }
            });
        }
        if !gone || held {
            return None;
        }
        self.before = Some(pinned.clock);
        self.pinned = None;
        Some(PinChange::Released { peer: pinned.peer, silent })
    }

    /// Nobody is pinned: the only one that qualifies is, or the best when all had their time to show themselves.
    fn choose(&mut self, now: Stamp<Companion>) -> Option<PinChange> {
        let best = self.best(|_| true)?;
        let since = self.candidates.iter().map(PeerCandidate::first_heard).min()?;
        let rivals = self.candidates.len() - 1;
        if rivals > 0 && now - since < self.policy.confirm && !best.goes_on() {
            return None;
        }
        self.pin(best, now);
        Some(PinChange::Pinned { peer: best.peer, rivals, shown: best.shown() })
    }

    fn best(&self, may: impl Fn(&PeerCandidate) -> bool) -> Option<PeerCandidate> {
        let qualified = self.candidates.iter().filter(|c| c.qualifies(&self.policy) && may(c));
        qualified.max_by_key(|c| c.rank(&self.policy)).copied()
    }

    /// The same autopilot from another port of the same host.
    fn same_host(&self, pinned: &PinnedPeer) -> Option<PeerCandidate> {
        let same = |c: &&PeerCandidate| {
            c.peer.ip() == pinned.peer.ip() && c.sender() == pinned.sender && c.goes_on()
        };
        self.candidates.iter().filter(same).max_by_key(|c| c.rank(&self.policy)).copied()
    }

    fn pin(&mut self, candidate: PeerCandidate, now: Stamp<Companion>) {
        // What goes on with a clock has that clock until it has told its own.
        let clock = self.pinned.map(|pinned| pinned.clock).or(self.before.take());
        let clock = clock.filter(|_| candidate.goes_on()).unwrap_or_default();
        let (peer, sender) = (candidate.peer, candidate.sender());
        self.pinned = Some(PinnedPeer { peer, sender, heard: now, measured: now, clock });
        self.candidates.clear();
    }
}

#[cfg(test)]
mod tests {
    use mavlink::dialects::ardupilotmega::{
        HEARTBEAT_DATA, MavAutopilot, MavMessage, MavModeFlag, MavState, MavType, RAW_IMU_DATA,
    };

    use super::*;
    use crate::wire::session::Address;
    use crate::wire::session::identity::{Identity, IdentityConfig, IdentityEvent};
    use crate::wire::session::outgoing::FrameWriter;

    const POLICY: PinPolicy = PinPolicy {
        system: None,
        component: None,
        for_sensors: false,
        confirm: Span::from_millis(2000),
        silence: Span::from_millis(5000),
    };

    fn addr(host: u8, port: u16) -> SocketAddr {
        ([127, 0, 0, host], port).into()
    }

    fn at(ms: i64) -> Stamp<Companion> {
        Stamp::from_micros(ms * 1000)
    }

    const BEAT: fn() -> MavMessage = || {
        MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode: 0,
            mavtype: MavType::MAV_TYPE_QUADROTOR,
            autopilot: MavAutopilot::MAV_AUTOPILOT_PX4,
            base_mode: MavModeFlag::empty(),
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
        })
    };
    const IMU: fn() -> MavMessage = || MavMessage::RAW_IMU(RAW_IMU_DATA::default());

    /// Who was pinned, and beside how many others.
    fn pinned(change: Option<PinChange>) -> Option<(SocketAddr, usize)> {
        match change {
            Some(PinChange::Pinned { peer, rivals, shown: Some(_) }) => Some((peer, rivals)),
            _ => None,
        }
    }

    /// Something that sends, with sequence numbers of its own.
    struct Sender {
        peer: SocketAddr,
        writer: FrameWriter,
        /// Its clock when ours is 0, ms.
        boot_ms: i64,
        /// Whether there is an outage.
        hold: bool,
    }

    impl Sender {
        fn new(peer: SocketAddr, component: u8, boot_ms: i64) -> Self {
            let from = Address { system: SystemId(1), component: ComponentId(component) };
            Self { peer, writer: FrameWriter::new(from), boot_ms, hold: false }
        }

        fn send(&mut self, pin: &mut Pin, ms: i64, message: &MavMessage) -> Option<PinChange> {
            if pin.regard(self.peer, at(ms)) == Regard::Ignore {
                return None;
            }
            pin.hear(self.peer, &self.writer.write(message).unwrap().frame().unwrap(), at(ms));
            pin.decide(at(ms), self.hold)
        }

        fn beat(&mut self, pin: &mut Pin, ms: i64) -> Option<PinChange> {
            self.send(pin, ms, &BEAT())
        }

        fn imu(&mut self, pin: &mut Pin, ms: i64) -> Option<PinChange> {
            let time_usec = ((self.boot_ms + ms) * 1000).unsigned_abs();
            self.send(pin, ms, &MavMessage::RAW_IMU(RAW_IMU_DATA { time_usec, ..Default::default() }))
        }

        /// A heartbeat a second and an IMU message every 20 ms, in [from, to); what it changed first.
        fn fly(&mut self, pin: &mut Pin, from: i64, to: i64) -> Option<(i64, PinChange)> {
            (from..to).step_by(20).find_map(|ms| {
                let beat = if ms % 1000 == 0 { self.beat(pin, ms) } else { None };
                let change = beat.or_else(|| self.imu(pin, ms)).or_else(|| pin.decide(at(ms), self.hold));
                change.map(|change| (ms, change))
            })
        }
    }

    /// Pinned to an autopilot at port 1 that flies until 10 s.
    fn flying() -> (Pin, Sender) {
        let mut pin = Pin::new(POLICY);
        let mut vehicle = Sender::new(addr(1, 1), 1, 100_000);
        assert!(vehicle.fly(&mut pin, 0, 10_000).is_some());
        vehicle.fly(&mut pin, 600, 10_000);
        (pin, vehicle)
    }

    #[test]
    fn one_heartbeat_pins_nobody_and_a_rate_of_them_does() {
        let mut pin = Pin::new(POLICY);
        let mut lone = Sender::new(addr(1, 1), 1, 0);
        assert_eq!(lone.beat(&mut pin, 0), None);
        // A hundred at once are no rate.
        assert!((0..100).all(|i| lone.beat(&mut pin, i).is_none()));
        assert_eq!(pin.decide(at(4000), false), None);
        let mut vehicle = Sender::new(addr(1, 2), 1, 0);
        assert_eq!([8000, 9000].map(|ms| vehicle.beat(&mut pin, ms)), [None; 2]);
        assert_eq!(pinned(vehicle.beat(&mut pin, 9990)), Some((addr(1, 2), 0)));
    }

    #[test]
    fn with_an_imu_a_peer_is_pinned_within_half_a_second() {
        let mut pin = Pin::new(POLICY);
        let change = Sender::new(addr(1, 1), 1, 0).fly(&mut pin, 0, 5000);
        let (when, change) = change.unzip();
        assert_eq!((when, pinned(change)), (Some(500), Some((addr(1, 1), 0))));
    }

    /// When an identity that goes on from what the link has heard follows the sender, ms.
    fn followed(imu: bool) -> Option<i64> {
        let mut pin = Pin::new(POLICY);
        let mut vehicle = Sender::new(addr(1, 1), 1, 0);
        let mut identity = Identity::new(IdentityConfig::default());
        let mut up = false;
        (0..20_000).step_by(20).find(|&ms| {
            let mut change = (ms % 1000 == 0).then(|| vehicle.beat(&mut pin, ms)).flatten();
            if imu {
                change = change.or(vehicle.imu(&mut pin, ms));
            }
            if let Some(PinChange::Pinned { shown: Some(shown), .. }) = &change {
                identity.heard_before(at(ms), shown);
                up = true;
            }
            // What the link passes on once it is up.
            let heard = [(ms % 1000 == 0).then_some(BEAT), imu.then_some(IMU)];
            up && heard.iter().flatten().any(|message| {
                let frame = vehicle.writer.write(&message()).unwrap();
                matches!(identity.hear(at(ms), &frame.frame().unwrap()).1, Some(IdentityEvent::Found(_)))
            })
        })
    }

    #[test]
    fn what_the_link_has_heard_is_not_waited_for_again() {
        // The third heartbeat, and the second where there is an IMU.
        assert_eq!([false, true].map(followed), [Some(2000), Some(1000)]);
    }

    #[test]
    fn another_component_than_the_configured_one_is_not_answered() {
        let mut pin = Pin::new(PinPolicy { component: Some(ComponentId(1)), ..POLICY });
        let mut other = Sender::new(addr(1, 66), 77, 0);
        assert_eq!(other.fly(&mut pin, 0, 10_000), None);
        let (_, change) = Sender::new(addr(1, 1), 1, 0).fly(&mut pin, 10_000, 15_000).unzip();
        assert_eq!(pinned(change), Some((addr(1, 1), 0)));
    }

    #[test]
    fn who_forges_heartbeats_first_does_not_win_over_an_autopilot_with_its_sensors() {
        let mut pin = Pin::new(POLICY);
        let (mut forger, mut vehicle) = (Sender::new(addr(1, 66), 77, 0), Sender::new(addr(1, 1), 1, 0));
        let mut change = None;
        for ms in (0..4000).step_by(20) {
            if ms % 500 == 0 {
                change = change.or(forger.beat(&mut pin, ms));
            }
            // The autopilot is there half a second later.
            if ms >= 500 && change.is_none() {
                change = vehicle.fly(&mut pin, ms, ms + 20).map(|(_, change)| change);
            }
        }
        assert_eq!(pinned(change), Some((addr(1, 1), 1)));
    }

    #[test]
    fn a_forger_that_was_pinned_gives_way_to_the_autopilot() {
        let mut pin = Pin::new(POLICY);
        let (mut forger, mut vehicle) = (Sender::new(addr(1, 66), 77, 0), Sender::new(addr(1, 1), 1, 0));
        for ms in (0..=4000).step_by(1000) {
            forger.beat(&mut pin, ms);
        }
        assert_eq!(pin.peer(), Some(addr(1, 66)));
        let mut change = None;
        for ms in (5000..20_000).step_by(100) {
            change = change.or(forger.beat(&mut pin, ms));
            // Heartbeats alone: it is not asked for more yet.
            if ms % 1000 == 50 || ms % 1000 == 500 {
                change = change.or(vehicle.beat(&mut pin, ms));
            }
        }
        let Some(PinChange::Replaced { from, to, silent: false, .. }) = change else { panic!("{change:?}") };
        assert_eq!((from, to), (addr(1, 66), addr(1, 1)));
    }

    #[test]
    fn nobody_takes_the_place_of_a_peer_that_is_well() {
        let (mut pin, mut vehicle) = flying();
        let mut forger = Sender::new(addr(1, 66), 1, 100_000);
        for ms in (10_000..30_000).step_by(20) {
            vehicle.fly(&mut pin, ms, ms + 20);
            assert_eq!(pin.regard(forger.peer, at(ms + 10)), Regard::Ignore);
            assert_eq!(forger.imu(&mut pin, ms + 10), None);
        }
        assert_eq!(pin.peer(), Some(addr(1, 1)));
    }

    #[test]
    fn a_router_that_restarts_on_another_port_is_followed_within_half_a_second() {
        let (mut pin, mut vehicle) = flying();
        vehicle.peer = addr(1, 2);
        let followed = PinChange::Followed { from: addr(1, 1), to: addr(1, 2) };
        let (when, change) = vehicle.fly(&mut pin, 10_020, 15_000).unwrap();
        assert_eq!(change, followed);
        assert!(when <= 10_480, "{when}");
    }

    #[test]
    fn another_clock_or_another_host_is_not_followed_at_once() {
        for (peer, boot_ms) in [(addr(1, 2), 0), (addr(2, 1), 100_000)] {
            let (mut pin, _) = flying();
            let mut other = Sender::new(peer, 1, boot_ms);
            let (when, _) = other.fly(&mut pin, 10_020, 20_000).unwrap();
            assert!(when > 14_900, "{peer} after {when} ms");
        }
    }

    #[test]
    fn in_an_outage_only_the_same_clock_takes_the_place_of_a_silent_peer() {
        let (mut pin, _) = flying();
        let mut forger = Sender { hold: true, ..Sender::new(addr(2, 66), 1, 0) };
        assert_eq!(forger.fly(&mut pin, 10_000, 40_000), None);
        let mut vehicle = Sender { hold: true, ..Sender::new(addr(2, 9), 1, 100_000) };
        let change = vehicle.fly(&mut pin, 40_000, 42_000).map(|(_, change)| change);
        assert_eq!(change, Some(PinChange::Followed { from: addr(1, 1), to: addr(2, 9) }));
    }

    #[test]
    fn garbage_keeps_no_pin_and_silence_lets_it_go() {
        let (mut pin, _) = flying();
        let last = 9980;
        assert_eq!(pin.decide(at(last + 5000), false), None);
        let released = PinChange::Released { peer: addr(1, 1), silent: Span::from_millis(5001) };
        assert_eq!(pin.decide(at(last + 5001), false), Some(released));
        assert_eq!(pin.peer(), None);
    }

    #[test]
    fn a_held_pin_is_let_go_when_there_can_be_no_navigation_left() {
        let (mut pin, _) = flying();
        assert_eq!(pin.decide(at(60_000), true), None);
        assert!(matches!(pin.decide(at(75_000), true), Some(PinChange::Released { .. })));
    }

    #[test]
    fn a_flood_of_invented_addresses_does_not_push_the_autopilot_out() {
        let mut pin = Pin::new(POLICY);
        let mut vehicle = Sender::new(addr(1, 1), 1, 0);
        let mut port = 1000u16;
        let mut pinned = None;
        for ms in (0..4000).step_by(20) {
            for _ in 0..100 {
                port = port.wrapping_add(1);
                let change = Sender::new(addr(3, port), 1, 0).beat(&mut pin, ms);
                pinned = pinned.or(change.map(|change| (ms, change)));
            }
            pinned = pinned.or(vehicle.fly(&mut pin, ms, ms + 20));
        }
        let Some((when, PinChange::Pinned { peer, .. })) = pinned else { panic!("{pinned:?}") };
        assert_eq!(peer, addr(1, 1));
        assert!(when <= 2500, "{when}");
    }
}
