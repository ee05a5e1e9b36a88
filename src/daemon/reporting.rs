//! What the daemon shows: copies for the page, several times a second, where somebody serves it.

use crate::navigator::event::EventKind;
use crate::navigator::shadow::MeasuredDrift;
use crate::navigator::solution::Solution;
use crate::sample::{Reference, SampleKind};
use crate::status::view::{
    ClockView, CountView, EventView, InputView, LinkView, OutputView, RecordingView, VehicleView,
};
use crate::status::{Glance, show};
use crate::time::{Companion, Stamp};
use crate::wire::counters::Cause;
use crate::wire::link::Excess;
use crate::wire::session::status_text_sender::Severity;

use super::Daemon;
use super::lines::LogHandle;
use super::summary::{Summary, faulty_heights};

impl Daemon {
    /// Shows how it fares, where that is due.
    pub(super) fn show(&mut self, now: Stamp<Companion>) {
        if !self.feed.as_ref().is_some_and(|feed| feed.is_due(now)) {
            return;
        }
        let summary = self.summary(now);
        let Some(mut feed) = self.feed.take() else { return };
        let glance = Glance {
            pipeline: &self.pipeline,
            solution: self.solution.as_ref(),
            vehicle: self.vehicle_view(),
            output: output_view(&summary),
            input: self.input_view(&summary),
            clock: ClockView {
                offset_s: summary.timesync.map(|(offset, _)| offset.seconds()),
                round_trip_ms: summary.timesync.map(|(_, round_trip)| round_trip.seconds() * 1e3),
                latency_ms: self.age_s.map(|s| s * 1e3),
                reboots: summary.reboots,
            },
        };
        let view = show(glance, &mut feed, now);
        feed.show(view, now);
        self.feed = Some(feed);
    }

    /// How it fares, in one piece.
    pub(super) fn summary(&self, now: Stamp<Companion>) -> Summary {
        let mut rejects = self.decoder.counters().clone();
        rejects.add(Cause::WrongSystem, self.session.wrong_system());
        let (mut inbound_dropped, mut unsent, mut strangers, mut excess) = (0, 0, 0, Excess::default());
        for stats in self.transmitter.handles().stats() {
            rejects.merge(&stats.rejects);
            inbound_dropped += stats.inbound_dropped;
            unsent += stats.unsent_full + stats.unsent_stale + stats.unsent_unsigned;
            strangers += stats.wrong_peer;
            excess.add(&stats.excess);
        }
        let mut rates_hz = [0.0; SampleKind::ALL.len()];
        if let Some((then, before)) = self.summed {
            let elapsed = now.seconds_since(then).max(1e-3);
            for ((rate, n), b) in rates_hz.iter_mut().zip(self.counts.heard).zip(before) {
                *rate = (n - b) as f64 / elapsed;
            }
        }
        Summary {
            mode: self.pipeline.navigator.mode(),
            sigma_m: self.solution.as_ref().map(Solution::horizontal_sigma_m),
            drift: MeasuredDrift::to_tell(&self.pipeline.navigator.measured_drift()),
            faulty_heights: faulty_heights(&self.pipeline.navigator),
            sources: self.pipeline.navigator.source_reports(),
            rates_hz,
            sent: self.counts.sent,
            hand_over: self.hand_over_summary(now),
            not_finite: self.counts.not_finite,
            late: self.counts.late,
            rejects,
            repairs: self.decoder.repairs().clone(),
            duplicates: self.counts.duplicates,
            sensor_frames: self.counts.sensor_frames,
            inbound_dropped,
            strangers,
            excess,
            unsent,
            timesync: self.session.timesync(),
            answered: self.session.answered(),
            words_withheld: self.status_texts.withheld(),
            reboots: self.decoder.clock().reboots(),
            signing: self.transmitter.handles().signing(),
            recording: self.recording.counts(),
            lines_lost: self.log.as_ref().map_or(0, LogHandle::lost),
        }
    }

    fn vehicle_view(&self) -> Option<VehicleView> {
        let vehicle = self.session.vehicle()?;
        Some(VehicleView {
            autopilot: vehicle.autopilot.to_string(),
            version: vehicle.version.map(|v| v.to_string()),
            system: vehicle.system.0,
            armed: vehicle.armed,
            heard: self.session.is_heard(),
        })
    }

    fn input_view(&self, summary: &Summary) -> InputView {
        let stats = self.transmitter.handles().stats();
        let count = |(cause, n): (Cause, u64)| CountView { cause: cause.label().to_owned(), count: n };
        InputView {
            frames: stats.iter().map(|s| s.frames_in).sum(),
            rate_hz: 0.0,
            rejected: summary.rejects.seen().map(count).collect(),
            dropped: summary.inbound_dropped + summary.excess.unread,
            strangers: summary.strangers,
            links: stats
                .iter()
                .map(|s| LinkView {
                    endpoint: s.endpoint.to_string(),
                    peer: s.peer.clone(),
                    frames: [s.frames_in, s.frames_out],
                    lost: s.lost_frames(),
                })
                .collect(),
        }
    }

    /// Shows what was told.
    pub(super) fn show_event(&mut self, code: Option<&'static str>, severity: Severity, text: &str) {
        let (now, unix_us) = (self.clock.now(), self.clock.unix_us());
        let Some(feed) = &mut self.feed else { return };
        let severity = match severity {
            Severity::Info => "info",
            Severity::Notice => "notice",
            Severity::Warning => "warning",
            Severity::Critical => "critical",
        };
        let event = EventView {
            unix_s: unix_us as f64 * 1e-6,
            severity: severity.to_owned(),
            code: code.map(str::to_owned),
            text: text.to_owned(),
            ..EventView::default()
        };
        feed.tell(event, now);
    }

    /// Why the mode has changed.
    pub(super) fn mode_news(&mut self, kind: &EventKind) {
        if let (Some(feed), EventKind::Mode { reason, .. }) = (&mut self.feed, kind) {
            feed.mode_changed(reason.to_string());
        }
    }

    /// Where the autopilot believes to be.
    pub(super) fn show_reference(&mut self, reference: &Reference, at: Stamp<Companion>) {
        if let (Some(feed), Reference::Global { position, .. }) = (&mut self.feed, reference) {
            feed.autopilot(*position, at);
        }
    }
}

fn output_view(summary: &Summary) -> OutputView {
    let hand_over = summary.hand_over.as_ref();
    OutputView {
        sending: hand_over.map_or("not sent: no autopilot", |h| h.sending.label()).to_owned(),
        sent: summary.sent,
        rate_hz: 0.0,
        quality: None,
        withheld: summary.late + summary.not_finite,
        autopilot_on: hand_over.map(|h| h.standing.label().to_owned()),
        fused: hand_over.map(|h| h.fusion.to_string()),
        recording: summary.recording.map(|r| RecordingView { bytes: r.bytes, lost: r.lost }),
    }
}
