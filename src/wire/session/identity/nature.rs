//! What a vehicle's heartbeats say that it is, and when another word of theirs is believed.
//!
//! A vehicle does not become another between two heartbeats. Another autopilot is believed when several heartbeats over seconds say so, none of them
//! what was said before, and something else than a heartbeat has shown that the vehicle began anew: its clock, a silence, its firmware's version.
//! Another type of vehicle is believed without the last. Armed is believed at once, and disarmed, unless both were told in turns: then as a type.
//! Times are µs of whatever clock the heartbeats are counted on.

use super::super::heartbeat_fields::HeartbeatFields;

/// Heartbeats that have to agree on something new, and the time that they come over, µs.
const CONFIRM: u32 = 5;
const OVER_US: i64 = 3_500_000;
/// The same for disarmed, where it was contradicted.
const DISARMED: u32 = 3;
const DISARMED_OVER_US: i64 = 1_500_000;
/// Who was armed and disarmed within this time may be again, µs.
const IN_TURNS_US: i64 = 10_000_000;

/// What to make of a heartbeat.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) enum NatureWord {
    /// The vehicle is this.
    Believed(HeartbeatFields),
    /// It contradicts what is known.
    Doubted,
}

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Nature {
    known: Option<HeartbeatFields>,
    /// What contradicts it.
    other: Option<Contender>,
    /// Something else has shown that the vehicle began anew.
    independent: bool,
    /// When it was told last that it is armed where it was not, or the other way round.
    turned_us: Option<i64>,
    disarmed: Option<Contender>,
}

/// What was said against what is known: the first time, and how often.
#[derive(Clone, Copy, Debug)]
struct Contender {
    fields: HeartbeatFields,
    since_us: i64,
    times: u32,
}

impl Contender {
    fn hear(before: Option<Self>, fields: HeartbeatFields, now_us: i64) -> Self {
        match before {
            Some(c) if same(&c.fields, &fields) => Self { times: c.times + 1, fields, ..c },
            _ => Self { fields, since_us: now_us, times: 1 },
        }
    }

    fn lasted(&self, now_us: i64, times: u32, over_us: i64) -> bool {
        self.times >= times && now_us.saturating_sub(self.since_us) >= over_us
    }
}

fn same(a: &HeartbeatFields, b: &HeartbeatFields) -> bool {
    (a.autopilot, a.vehicle_type) == (b.autopilot, b.vehicle_type)
}

impl Nature {
    /// The vehicle is known to have begun anew, by something else than heartbeats.
    pub(crate) fn independent(&mut self) {
        self.independent = true;
    }

    /// Takes a heartbeat of its autopilot.
    pub(crate) fn hear(&mut self, now_us: i64, fields: HeartbeatFields) -> NatureWord {
        let Some(known) = self.known else {
            self.known = Some(fields);
            return NatureWord::Believed(fields);
        };
        if same(&known, &fields) {
            self.other = None;
            self.independent = false;
            return self.armed(now_us, known, fields);
        }
        let other = Contender::hear(self.other, fields, now_us);
        self.other = Some(other);
        let evident = fields.autopilot == known.autopilot || self.independent;
        if !evident || !other.lasted(now_us, CONFIRM, OVER_US) {
            return NatureWord::Doubted;
        }
        *self = Self { known: Some(fields), ..Self::default() };
        NatureWord::Believed(fields)
    }

    fn armed(&mut self, now_us: i64, known: HeartbeatFields, fields: HeartbeatFields) -> NatureWord {
        let turns = fields.armed() != known.armed();
        let lately = self.turned_us.is_some_and(|t| now_us.saturating_sub(t) < IN_TURNS_US);
        if !turns {
            self.disarmed = None;
        } else {
            self.turned_us = Some(now_us);
            if lately && known.armed() {
                let disarmed = Contender::hear(self.disarmed, fields, now_us);
                self.disarmed = Some(disarmed);
                if !disarmed.lasted(now_us, DISARMED, DISARMED_OVER_US) {
                    return NatureWord::Doubted;
                }
            }
            self.disarmed = None;
        }
        self.known = Some(fields);
        NatureWord::Believed(fields)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: i64 = 1_000_000;

    fn beat(vehicle_type: u8, autopilot: u8, armed: bool) -> HeartbeatFields {
        HeartbeatFields {
            custom_mode: 0,
            vehicle_type,
            autopilot,
            base_mode: if armed { 0x80 } else { 0 },
            system_status: 4,
            mavlink_version: 3,
        }
    }

    fn believed(nature: &mut Nature, now_us: i64, fields: HeartbeatFields) -> bool {
        nature.hear(now_us, fields) == NatureWord::Believed(fields)
    }

    #[test]
    fn a_heartbeat_makes_no_other_vehicle() {
        let mut nature = Nature::default();
        for s in 0..100 {
            assert!(believed(&mut nature, s * SECOND, beat(2, 3, true)));
            for n in 0..50 {
                assert_eq!(nature.hear(s * SECOND + n, beat(2, 12, true)), NatureWord::Doubted);
                assert_eq!(nature.hear(s * SECOND + n, beat(1, 3, true)), NatureWord::Doubted);
            }
        }
    }

    #[test]
    fn another_autopilot_needs_more_than_heartbeats() {
        let mut nature = Nature::default();
        believed(&mut nature, 0, beat(2, 3, false));
        assert!((1..60).all(|s| nature.hear(s * SECOND, beat(2, 12, false)) == NatureWord::Doubted));
        nature.independent();
        assert!(believed(&mut nature, 60 * SECOND, beat(2, 12, false)));
        // Evidence of before does not count for the next.
        assert!((61..90).all(|s| nature.hear(s * SECOND, beat(2, 3, false)) == NatureWord::Doubted));
    }

    #[test]
    fn another_type_is_believed_after_seconds() {
        let mut nature = Nature::default();
        believed(&mut nature, 0, beat(2, 3, false));
        let told: Vec<bool> = (1..7).map(|s| believed(&mut nature, s * SECOND, beat(13, 3, false))).collect();
        assert_eq!(told, [false, false, false, false, true, true]);
    }

    #[test]
    fn who_is_armed_and_disarmed_in_turns_is_armed() {
        let mut nature = Nature::default();
        assert!(believed(&mut nature, 0, beat(2, 3, false)));
        assert!(believed(&mut nature, 20 * SECOND, beat(2, 3, true)));
        assert!(believed(&mut nature, 60 * SECOND, beat(2, 3, false)), "the first is believed");
        let mut changes = 0;
        let mut armed = false;
        for ms in (60_001..120_000).step_by(10) {
            let fields = beat(2, 3, ms % 1000 < 10);
            if let NatureWord::Believed(now) = nature.hear(ms * 1000, fields) {
                changes += u32::from(now.armed() != armed);
                armed = now.armed();
            }
        }
        assert_eq!((changes, armed), (1, true));
        assert!(believed(&mut nature, 120 * SECOND, beat(2, 3, true)));
        let landed = (121..125).find(|s| believed(&mut nature, s * SECOND, beat(2, 3, false)));
        assert_eq!(landed, Some(123), "and disarmed at last");
    }
}
