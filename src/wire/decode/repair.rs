//! What the decoder does about messages that are not what their definition says: they are used all the same where that is safe, and
//! what was done is counted and told once.

use std::fmt;

/// Something that was put right, or left out because it tells nothing new.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Repair {
    /// A fix whose stamp is missing, constant or of another clock was stamped by its arrival.
    GnssByArrival,
    /// A fix that was sent again was left out.
    GnssRepeated,
    /// A flow reading that was sent again was left out.
    FlowRepeated,
    /// A magnetic field was off by this power of ten.
    FieldUnit(i32),
    /// A measurement of another component, on another clock, was stamped by its arrival.
    ForeignByArrival,
}

impl Repair {
    /// As many as there are kinds.
    const KINDS: usize = 5;

    fn kind(self) -> usize {
        match self {
            Repair::GnssByArrival => 0,
            Repair::GnssRepeated => 1,
            Repair::FlowRepeated => 2,
            Repair::FieldUnit(_) => 3,
            Repair::ForeignByArrival => 4,
        }
    }

    /// A word that stays the same, to search for.
    pub const fn code(self) -> &'static str {
        match self {
            Repair::GnssByArrival => "gnss-by-arrival",
            Repair::GnssRepeated => "gnss-repeated",
            Repair::FlowRepeated => "flow-repeated",
            Repair::FieldUnit(_) => "field-unit",
            Repair::ForeignByArrival => "foreign-by-arrival",
        }
    }

    /// A short name for tables.
    pub const fn label(self) -> &'static str {
        match self {
            Repair::GnssByArrival => "GNSS fixes stamped by arrival",
            Repair::GnssRepeated => "repeated GNSS fixes left out",
            Repair::FlowRepeated => "repeated flow readings left out",
            Repair::FieldUnit(_) => "magnetic fields put into the right unit",
            Repair::ForeignByArrival => "measurements of other components stamped by arrival",
        }
    }
}

impl fmt::Display for Repair {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Repair::GnssByArrival => write!(
                f,
                "GPS_RAW_INT is stamped on no clock that is known: fixes are taken to be as old as their message"
            ),
            Repair::GnssRepeated => {
                write!(f, "GPS_RAW_INT is sent more often than there are fixes: each is used once")
            }
            Repair::FlowRepeated => {
                write!(f, "optical flow is sent more often than there are readings: each is used once")
            }
            Repair::FieldUnit(power) => write!(
                f,
                "the magnetometer's field is 10^{power} times what Earth's can be, a wrong unit: it is taken in the right one"
            ),
            Repair::ForeignByArrival => write!(
                f,
                "another component stamps its measurements on a clock of its own: they are taken to be as old as their message"
            ),
        }
    }
}

/// Repairs of one kind before it is told: a reboot of the autopilot makes a few.
const TOLD_AT: u64 = 5;

/// Counts repairs, and tells of each kind once.
#[derive(Clone, Debug, Default)]
pub struct Repairs {
    counts: [u64; Repair::KINDS],
    last: [Option<Repair>; Repair::KINDS],
    news: Option<Repair>,
}

impl Repairs {
    pub(super) fn count(&mut self, repair: Repair) {
        let kind = repair.kind();
        self.counts[kind] += 1;
        self.last[kind] = Some(repair);
        if self.counts[kind] == TOLD_AT {
            self.news = Some(repair);
        }
    }

    /// What is to be told, once.
    pub(super) fn take_news(&mut self) -> Option<Repair> {
        self.news.take()
    }

    /// The repairs that were made, and how often.
    pub fn seen(&self) -> impl Iterator<Item = (Repair, u64)> + '_ {
        self.last.iter().zip(self.counts).filter_map(|(repair, n)| repair.map(|r| (r, n)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_is_explained() {
        let all = [
            Repair::GnssByArrival,
            Repair::GnssRepeated,
            Repair::FlowRepeated,
            Repair::FieldUnit(3),
            Repair::ForeignByArrival,
        ];
        assert_eq!(all.map(Repair::kind).to_vec(), (0..Repair::KINDS).collect::<Vec<_>>());
        let page = include_str!("../../../docs/src/sensors.md");
        assert!(all.iter().all(|r| page.contains(&format!("| `{}` |", r.code()))));
    }

    #[test]
    fn each_kind_is_told_once_when_it_is_no_accident() {
        let mut repairs = Repairs::default();
        let told: Vec<Repair> = (0..100)
            .filter_map(|_| {
                repairs.count(Repair::FieldUnit(6));
                repairs.take_news()
            })
            .collect();
        repairs.count(Repair::GnssRepeated);
        assert_eq!((told, repairs.take_news()), (vec![Repair::FieldUnit(6)], None));
        let seen: Vec<_> = repairs.seen().collect();
        assert_eq!(seen, [(Repair::GnssRepeated, 1), (Repair::FieldUnit(6), 100)]);
    }
}
