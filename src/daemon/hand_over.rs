//! The daemon's part of the hand-over: what the conversation is told of the navigation, and the operator of both.

use crate::outbound::handover::Sending;
use crate::sample::{GnssFix, GnssSample};
use crate::time::{AutopilotTime, Companion, Stamp};
use crate::wire::session::fusion::{Fusion, Refused};
use crate::wire::session::hand_over::{HandOverNews, Situation};
use crate::wire::session::source_switch::SwitchNews;
use crate::wire::session::status_text_sender::Severity;

use super::Daemon;
use super::summary::HandOverSummary;

impl Daemon {
    /// How it stands, for the hand-over.
    pub(super) fn situation(&self) -> Situation {
        let outbound = &self.pipeline.outbound;
        let sends = outbound.sending().sends() && outbound.sending() != Sending::Farewell;
        let fit = self.solution.as_ref().filter(|_| sends && !self.watch.silent());
        Situation {
            mode: self.pipeline.navigator.mode(),
            quality: fit.map(|s| outbound.quality(s)),
            age_s: self.age_s,
            departure: outbound.departure(),
            place: self.pipeline.navigator.began_at(),
        }
    }

    /// What the autopilot stands on is known anew.
    pub(super) fn follow_standing(&mut self, now: Stamp<Companion>) {
        if let Some(hand_over) = self.session.hand_over() {
            let standing = hand_over.standing(now);
            self.pipeline.outbound.set_standing(standing);
            self.recording.stands(now, standing);
        }
    }

    /// How it stands, for the summary.
    pub(super) fn hand_over_summary(&self, now: Stamp<Companion>) -> Option<HandOverSummary> {
        let hand_over = self.session.hand_over()?;
        let alignment = self.pipeline.outbound.alignment();
        let offset = (alignment.offset().raw().norm(), alignment.heading_offset_rad());
        Some(HandOverSummary {
            sending: self.pipeline.outbound.sending(),
            standing: hand_over.standing(now),
            fusion: hand_over.fusion(),
            offset: alignment.aligned().then_some(offset),
        })
    }

    /// The autopilot's receiver spoke; also where its fix is withheld from us.
    pub(super) fn receiver_spoke(&mut self, fix: &GnssSample, at: Stamp<Companion>) {
        if let (Some(feed), Some(place)) = (&mut self.feed, fix.position) {
            feed.fix(place, at);
        }
        if fix.fix >= GnssFix::ThreeD
            && let Some(hand_over) = self.session.hand_over_mut()
        {
            hand_over.fix(at);
        }
    }

    /// A position of `time` left.
    pub(super) fn position_left(&mut self, time: AutopilotTime, now: Stamp<Companion>) {
        self.age_s = self.session.age_on_arrival_s(now, time, self.decoder.clock());
        if let Some(hand_over) = self.session.hand_over_mut() {
            hand_over.sent(now);
        }
    }

    /// Tells whether something is sent, and why, when that changes; the pilot only when it begins or ends.
    pub(super) fn tell_sending(&mut self) {
        let sending = self.pipeline.outbound.sending();
        let before = self.sending_told.replace(sending);
        if before == Some(sending) {
            return;
        }
        if before.is_some_and(Sending::sends) == sending.sends() {
            tracing::info!("{}", sending.label());
        } else if sending == Sending::Lost {
            self.say(Severity::Critical, sending.label());
        } else {
            self.say(Severity::Notice, sending.label());
        }
    }

    pub(super) fn tell_hand_over(&mut self, news: HandOverNews) {
        match news {
            HandOverNews::Fusion(fusion) => {
                match severity_of_fusion(&fusion) {
                    Severity::Info => tracing::info!("{fusion}"),
                    severity => self.say(severity, &fusion.to_string()),
                }
                if let Some(advice) = fusion.advice() {
                    tracing::warn!("{fusion}: {advice}");
                }
            }
            HandOverNews::Switch(news) => self.say(severity_of_switch(&news), &news.to_string()),
            HandOverNews::Autopilot(text) => tracing::warn!("the autopilot says: {text}"),
        }
    }
}

fn severity_of_fusion(fusion: &Fusion) -> Severity {
    match fusion {
        Fusion::Refused(Refused::NotAided) => Severity::Critical,
        Fusion::Refused(_) => Severity::Warning,
        Fusion::Fused => Severity::Notice,
        Fusion::NotSent | Fusion::Sent | Fusion::Received | Fusion::Beside => Severity::Info,
    }
}

fn severity_of_switch(news: &SwitchNews) -> Severity {
    match news {
        SwitchNews::NotSwitched(..)
        | SwitchNews::Reverted(_)
        | SwitchNews::SwitchOver(_)
        | SwitchNews::SwitchSoon(_) => Severity::Critical,
        SwitchNews::Switched(..) | SwitchNews::PilotSwitched(_) => Severity::Warning,
        SwitchNews::SwitchBack(_) => Severity::Notice,
    }
}
