//! A recording flown again as it was flown: with what the autopilot stood on, the drills, and the state that was gone on from; and whether
//! it says what was said.

use crate::log::Aside;
use crate::navigator::solution::Solution;
use crate::outbound::message::OutboundMessage;
use crate::pipeline::Pipeline;
use crate::sample::{Input, Sample};
use crate::state::{KeptState, Moment, go_on};
use crate::wire::clock::AutopilotClock;
use crate::wire::recording::{Mark, SentAgain, SentReport};

/// No kept state has more pieces.
const MOST_PIECES: u16 = 2048;

/// See the module's documentation.
#[derive(Clone, Debug, Default)]
pub(super) struct AsFlown {
    /// The log is a recording.
    recorded: bool,
    /// When what is read was recorded, µs.
    at_us: i64,
    pieces: Vec<u8>,
    next_piece: u16,
    kept: Option<Box<KeptState>>,
    sent: SentAgain,
}

impl AsFlown {
    /// What a recording says beside inputs. An interval in which GNSS was withheld is to be heeded.
    pub(super) fn aside(&mut self, aside: &Aside<'_>, pipeline: &mut Pipeline) -> Option<(f64, f64)> {
        match aside {
            Aside::At(us) => self.at_us = i64::try_from(*us).unwrap_or(0),
            Aside::Sent(frame) => self.sent.then(frame),
            Aside::Mark(Mark::Part { .. }) => self.recorded = true,
            Aside::Mark(Mark::Follows { vehicle, anew }) => {
                if *anew {
                    pipeline.begin_anew();
                    self.kept = None;
                }
                pipeline.follow(vehicle);
            }
            Aside::Mark(Mark::Stands(on)) => pipeline.outbound.set_standing(*on),
            Aside::Mark(Mark::Drill { from_s, to_s }) => return Some((*from_s, *to_s)),
            Aside::Mark(Mark::Kept { index, of, bytes }) => self.piece(*index, *of, bytes),
            Aside::Mark(Mark::Heard(_) | Mark::HeardOfOurs | Mark::Lost(_)) => {}
        }
        None
    }

    fn piece(&mut self, index: u16, of: u16, bytes: &[u8]) {
        if index == 0 {
            self.pieces.clear();
            self.next_piece = 0;
        }
        if index != self.next_piece || of > MOST_PIECES {
            return;
        }
        self.next_piece += 1;
        self.pieces.extend(bytes);
        if self.next_piece == of {
            self.kept = KeptState::decode(&std::mem::take(&mut self.pieces)).ok().map(Box::new);
        }
    }

    /// The pipeline takes an input. At the first IMU sample it goes on from what was kept, as it did then.
    pub(super) fn take(
        &mut self,
        pipeline: &mut Pipeline,
        clock: &AutopilotClock,
        input: &Input,
        out: &mut Vec<OutboundMessage>,
    ) -> Option<Solution> {
        if let Input::Sample(Sample::Imu(imu)) = input
            && let Some(kept) = self.kept.take()
        {
            let moment = Moment { clock, unix_us: self.at_us };
            // Where it is not gone on from, it was not then.
            let _ = go_on(&kept, (&mut pipeline.navigator, &mut pipeline.outbound), &moment, imu.time);
        }
        let solution = pipeline.take(clock, input, out);
        for message in out.iter().filter(|_| self.recorded) {
            self.sent.again(message, clock);
        }
        solution
    }

    /// How what is sent compares with what was sent; `None` of a log that is no recording.
    pub(super) fn report(&self) -> Option<SentReport> {
        self.recorded.then(|| self.sent.report())
    }
}
