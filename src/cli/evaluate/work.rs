//! One log: outages slid over it with every estimator, and its own losses.

use crate::config::Settings;
use crate::fleet::{LogFailure, LogOutcome, NaturalLoss, OutageRow, Unusable};
use crate::log::{Log, LogError, LogFile};
use crate::navigator::settings::Estimator;
use crate::replay::losses::{LEAST_S, losses};
use crate::replay::sweep::{SETTLE_S, Survey, survey, sweep};

use super::super::inspect::lacking;
use super::super::jobs;

/// What is asked of every log.
pub(super) struct Question {
    /// Settings with each of the estimators.
    pub(super) settings: Vec<Settings>,
    /// Lengths of the outages, s.
    pub(super) lengths_s: Vec<f64>,
    /// Starts an outage length.
    pub(super) starts: usize,
}

impl Question {
    /// Asks a log, with at most so many estimators at a time. It never fails: a log that cannot be used says why.
    pub(super) fn ask(&self, index: u64, file: &LogFile, identity: String, threads: usize) -> LogOutcome {
        let mut outcome =
            LogOutcome { index, log: file.path().display().to_string(), identity, ..LogOutcome::default() };
        if let Err(error) = self.fill(&mut outcome, file, threads) {
            outcome.rows.clear();
            outcome.losses.clear();
            if matches!(error, LogError::Io { .. }) {
                // What could not be had may be had another time.
                outcome.identity.clear();
            }
            outcome.failure = Some(LogFailure { kind: Unusable::Unreadable, why: error.to_string() });
        }
        outcome
    }

    fn fill(&self, outcome: &mut LogOutcome, file: &LogFile, threads: usize) -> Result<(), LogError> {
        let log = Log::of(file.clone(), self.settings.first().and_then(|s| s.system))?;
        outcome.format = Some(log.format().label().to_owned());
        outcome.autopilot = Some(log.vehicle().autopilot.to_string());
        let survey = survey(&log)?;
        outcome.duration_s = survey.duration_s;
        let lacks = |why: String| Some(LogFailure { kind: Unusable::Lacking, why });
        if let Some(why) = lacking(&survey.heard, &survey.imu) {
            outcome.failure = lacks(why);
            return Ok(());
        }
        if survey.flights.is_empty() {
            outcome.failure = lacks("the vehicle does not fly in it".to_owned());
            return Ok(());
        }
        // What fails is the log's reason, not the command's.
        let mut answers: Vec<Option<Result<_, LogError>>> = self.settings.iter().map(|_| None).collect();
        let asked = jobs::as_done(
            &self.settings,
            threads,
            true,
            |settings| self.with(settings, &log, &survey),
            |i, answer| {
                answers[i] = Some(answer);
                Ok(())
            },
        );
        debug_assert!(asked.is_ok());
        for answer in answers.into_iter().flatten() {
            let (rows, losses) = answer?;
            outcome.rows.extend(rows);
            outcome.losses.extend(losses);
        }
        if outcome.rows.is_empty() {
            let longest_s = survey.flights.iter().map(|(from, to)| to - from).fold(0.0, f64::max);
            outcome.failure = lacks(format!(
                "no outage of these lengths fits into its flight of {longest_s:.0} s, of which {SETTLE_S} s are to settle in"
            ));
        }
        Ok(())
    }

    fn with(
        &self,
        settings: &Settings,
        log: &Log,
        survey: &Survey,
    ) -> Result<(Vec<OutageRow>, Vec<NaturalLoss>), LogError> {
        let pipeline = &settings.pipeline;
        let name = log.path().display().to_string();
        let estimator: Estimator = pipeline.navigator.estimator;
        let found = if survey.longest_loss_s >= LEAST_S {
            losses(log, pipeline, survey.airborne())?
        } else {
            Vec::new()
        };
        let rows = sweep(log, pipeline, &survey.flights, &self.lengths_s, self.starts)?;
        let named = || (name.clone(), estimator.label().to_owned());
        let row = |row| {
            let (log, estimator) = named();
            OutageRow { log, estimator, row }
        };
        let loss = |row| {
            let (log, estimator) = named();
            NaturalLoss { log, estimator, row }
        };
        Ok((rows.into_iter().map(row).collect(), found.into_iter().map(loss).collect()))
    }
}
