//! How fast the rotors turn, as speed controllers tell: what shakes the inertial unit, and where its shaking stands in the spectrum.

/// Speeds are counted in steps of 1 Hz up to this.
const MOST_HZ: usize = 1000;
const RPM_PER_HZ: f64 = 60.0;

/// Speeds of all rotors of a flight, counted.
#[derive(Clone, Debug, Default)]
pub struct RotorSpeeds {
    /// A bit each controller that told of a rotor that turns.
    controllers: u32,
    told: u64,
    counts: Vec<u64>,
}

impl RotorSpeeds {
    /// A controller tells how many turns a minute its rotor makes. One that stands, or that turns as none does, is left out.
    pub(super) fn note(&mut self, controller: u8, rpm: f64) {
        let bin = (rpm.abs() / RPM_PER_HZ).round();
        if !(1.0..MOST_HZ as f64).contains(&bin) || u32::from(controller) >= u32::BITS {
            return;
        }
        self.controllers |= 1 << controller;
        self.told += 1;
        self.counts.resize(MOST_HZ, 0);
        self.counts[bin as usize] += 1;
    }

    /// Controllers whose rotors turned.
    pub fn controllers(&self) -> u32 {
        self.controllers.count_ones()
    }

    /// The speed, Hz, that this part of what was told is below; `None` if nothing was.
    pub fn quantile_hz(&self, part: f64) -> Option<f64> {
        let wanted = (self.told as f64 * part).ceil().max(1.0) as u64;
        let mut below = 0;
        let at = self.counts.iter().position(|n| {
            below += n;
            below >= wanted
        });
        at.map(|hz| hz as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn speeds_have_quantiles_and_those_of_no_rotor_are_left_out() {
        let mut speeds = RotorSpeeds::default();
        assert_eq!((speeds.controllers(), speeds.quantile_hz(0.5)), (0, None));
        for (controller, hz) in
            [(0, 40.0), (0, 50.0), (3, 50.0), (3, 60.0), (1, 0.0), (2, f64::NAN), (2, 1e9)]
        {
            speeds.note(controller, hz * 60.0);
        }
        // One that turns backwards turns.
        speeds.note(40, 3000.0);
        speeds.note(3, -3000.0);
        assert_eq!(speeds.controllers(), 2);
        assert_eq!([0.0, 0.5, 1.0].map(|q| speeds.quantile_hz(q).unwrap()), [40.0, 50.0, 60.0]);
    }

    proptest! {
        #[test]
        fn any_numbers_are_counted_or_not(told in proptest::collection::vec((any::<u8>(), any::<f64>()), 0..50), part in 0.0..=1.0f64) {
            let mut speeds = RotorSpeeds::default();
            told.iter().for_each(|(controller, rpm)| speeds.note(*controller, *rpm));
            let at = speeds.quantile_hz(part);
            prop_assert_eq!(at.is_some(), speeds.controllers() > 0);
            prop_assert!(at.is_none_or(|hz| (1.0..1000.0).contains(&hz)));
        }
    }
}
