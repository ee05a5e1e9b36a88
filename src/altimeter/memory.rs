//! What the altimeter knows, as numbers that can be kept, and back.

use nalgebra::SVector;
use serde::{Deserialize, Serialize};

use super::channel_state::ChannelState;
use super::drift::Drift;
use super::fault_tolerant::Altimeter;
use super::joint::STATES;
use super::settings::AltimeterSettings;
use super::tuning::LARGEST_M;
use crate::geo::symmetric;

/// State, covariance, and what is held of each channel. What watches for faults begins anew.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AltimeterMemory {
    /// Height m, climb m/s, acceleration error m/s², offsets of the channels and biases of their faults, m.
    pub state: [f64; STATES],
    /// The covariance's upper triangle, row by row.
    pub covariance: Vec<f64>,
    /// Time of the state, s since the start.
    pub clock_s: f64,
    /// By the channels' index.
    pub channels: [ChannelMemory; 4],
}

/// One channel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChannelMemory {
    /// When it was last heard, s since the start, if ever.
    pub heard_s: Option<f64>,
    /// What it should read was once known.
    pub settled: bool,
    /// Since when a bias is declared, s since the start.
    pub biased_since_s: Option<f64>,
    /// What its offset was before, m.
    pub offset_before_m: f64,
}

/// No flight is longer, s.
const LONGEST_S: f64 = 1e8;

impl ChannelMemory {
    fn of(c: &ChannelState) -> Self {
        Self {
            heard_s: c.started.then_some(c.heard_s).filter(|t| t.is_finite()),
            settled: c.settled,
            biased_since_s: c.biased_since_s,
            offset_before_m: c.offset_before_m,
        }
    }

    fn state(&self, clock_s: f64) -> Option<ChannelState> {
        let past = |t: f64| (0.0..=clock_s).contains(&t);
        let sound = self.heard_s.is_none_or(past)
            && self.biased_since_s.is_none_or(past)
            && self.offset_before_m.abs() <= LARGEST_M;
        sound.then(|| ChannelState {
            started: self.heard_s.is_some(),
            settled: self.settled,
            biased_since_s: self.biased_since_s,
            offset_before_m: self.offset_before_m,
            heard_s: self.heard_s.unwrap_or(f64::NEG_INFINITY),
            ..ChannelState::new()
        })
    }
}

impl AltimeterMemory {
    /// What an altimeter knows; `None` before it has a height.
    pub fn of(altimeter: &Altimeter) -> Option<Self> {
        altimeter.height_m()?;
        let mut present = altimeter.clone();
        present.propagate();
        Some(Self {
            state: present.joint.x.into(),
            covariance: symmetric::upper(&present.joint.p),
            clock_s: present.clock_s,
            channels: present.channels.each_ref().map(ChannelMemory::of),
        })
    }

    /// An altimeter that knows this. `None` where it is no height of anything.
    pub fn altimeter(&self, settings: AltimeterSettings) -> Option<Altimeter> {
        let sound =
            (0.0..=LONGEST_S).contains(&self.clock_s) && self.state.iter().all(|x| x.abs() <= LARGEST_M);
        let p = symmetric::covariance::<STATES>(&self.covariance).filter(|_| sound)?;
        let mut channels = [ChannelState::new(); 4];
        for (channel, memory) in channels.iter_mut().zip(&self.channels) {
            *channel = memory.state(self.clock_s)?;
        }
        let mut altimeter = Altimeter::new(settings);
        altimeter.joint.x = SVector::from(self.state);
        altimeter.joint.p = p;
        altimeter.channels = channels;
        altimeter.clock_s = self.clock_s;
        altimeter.drift = Drift::default();
        altimeter.started = true;
        Some(altimeter)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Channel, Health};
    use super::*;

    #[test]
    fn what_was_known_goes_on_and_what_is_nothing_is_refused() {
        let settings = AltimeterSettings::table_1();
        let mut altimeter = Altimeter::new(settings);
        assert_eq!(AltimeterMemory::of(&altimeter), None);
        for k in 0..2000 {
            altimeter.predict(0.02, 0.0, 0.0);
            if k % 5 == 0 {
                altimeter.measure(Channel::Gnss, 100.0, Some(1.0), 0.0);
                altimeter.measure(Channel::Baro, 130.0, None, 0.0);
            }
        }
        altimeter.predict(0.013, 1.0, 0.0);
        let memory = AltimeterMemory::of(&altimeter).unwrap();
        let back = memory.altimeter(settings).unwrap();
        assert!((back.height_m().unwrap() - altimeter.height_m().unwrap()).abs() < 1e-9);
        assert!((back.climb_mps() - altimeter.climb_mps()).abs() < 1e-4);
        let offset = |a: &Altimeter| a.offset_m(Channel::Baro).unwrap();
        // Brought up to the present, it has gone back a little towards what is normal.
        assert!((offset(&back) - offset(&altimeter)).abs() < 0.1);
        // Thirty metres apart somebody is at fault by these settings, and stays so.
        let faulty = |a: &Altimeter| [Channel::Baro, Channel::Gnss].map(|c| a.health(c).is_faulty());
        assert_eq!(faulty(&back), faulty(&altimeter));
        assert!(faulty(&back).contains(&true));
        assert_eq!(back.health(Channel::Range), Health::Unheard);
        let wrong = |f: fn(&mut AltimeterMemory)| {
            let mut memory = memory.clone();
            f(&mut memory);
            memory.altimeter(settings).is_none()
        };
        assert!(wrong(|m| m.state[0] = f64::NAN) && wrong(|m| m.covariance[0] = -1.0));
        assert!(wrong(|m| m.clock_s = -1.0) && wrong(|m| m.channels[0].heard_s = Some(1e9)));
    }
}
