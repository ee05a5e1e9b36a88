//! What the operator is told of the IMU's stream: that it is silent, or late.

use crate::time::{AutopilotTime, Companion, Span, Stamp};
use crate::wire::session::status_text_sender::Severity;

use super::Daemon;
use super::lateness::LateNews;
use super::watch::ImuNews;

/// What arrived longer ago has waited for us.
const JUST_NOW: Span = Span::from_millis(50);

impl Daemon {
    /// Whether an IMU sample of `time` has come later than the link explains.
    pub(super) fn look_for_lateness(
        &mut self,
        time: AutopilotTime,
        at: Stamp<Companion>,
        now: Stamp<Companion>,
    ) {
        // Of what arrived some time ago, in a pause perhaps, it is not known well when.
        if now - at > JUST_NOW {
            return;
        }
        let sync = self.session.timesync_at(at);
        match self.lateness.came(at, time, self.decoder.clock(), sync) {
            Some(LateNews::Late(span)) => {
                let text = format!("IMU samples come {:.1} s late: no position is sent", span.seconds());
                self.say(Severity::Critical, &text);
            }
            Some(LateNews::InTime) => self.say(Severity::Notice, "IMU samples come in time again"),
            Some(LateNews::ForGood(span)) => {
                let text = format!("the link is slower by {:.1} s for good", span.seconds());
                self.say(Severity::Warning, &text);
            }
            None => {}
        }
    }

    /// The stream has stopped, or goes on.
    pub(super) fn imu_news(&mut self, news: ImuNews) {
        match news {
            ImuNews::NeverCame => {
                self.say(Severity::Critical, "no IMU message comes: nothing to navigate with")
            }
            ImuNews::Silent(span) => {
                self.say(Severity::Critical, &format!("IMU silent for {:.1} s", span.seconds()));
            }
            ImuNews::Back(span) => {
                self.say(Severity::Notice, &format!("IMU is back after {:.1} s", span.seconds()));
            }
        }
    }
}
