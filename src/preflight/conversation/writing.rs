//! Setting what mends the faults, and what became of it.

use super::{
    Finding, FindingGrade, Preflight, PreflightEnd, PreflightPhase, PreflightReport, WrittenParameter, judge,
};

impl Preflight {
    /// Asks for every parameter that mends a fault to be set. An armed vehicle is left alone.
    pub(super) fn start_writing(&mut self, report: &mut PreflightReport) {
        if report.readings.vehicle.armed {
            report.not_written = Some("the vehicle is armed");
            return;
        }
        let mendable = |f: &&Finding| f.grade == FindingGrade::Fault && f.mend.is_some();
        let Some(encoding) = self.encoding() else { return };
        for finding in report.findings.iter().filter(mendable) {
            let value = self.value(&finding.subject).zip(finding.mend);
            let Some((value, wanted)) = value.and_then(|(v, m)| Some((v.with(encoding, m)?, m))) else {
                continue;
            };
            let Some(parameters) = &mut self.parameters else { return };
            parameters.dialogue.set(value);
            report.written.push(WrittenParameter {
                parameter: finding.subject.clone(),
                before: report.readings.parameter(&finding.subject).unwrap_or_default(),
                wanted,
                after: None,
                took: false,
                reboot: finding.reboot,
            });
        }
    }

    /// What was set is read back by now, or never will be.
    pub(super) fn written(&mut self, mut report: PreflightReport) {
        let (told, _) = self.told();
        for written in &mut report.written {
            written.after = told.get(&written.parameter).copied();
            // Both went through 32 bits.
            written.took = written.after.is_some_and(|after| after as f32 == written.wanted as f32);
            if let Some(after) = written.after {
                report.readings.parameters.insert(written.parameter.clone(), after);
            }
        }
        report.findings = judge(&report.readings, &self.needs);
        self.phase = PreflightPhase::Ended(PreflightEnd::Read(Box::new(report)));
    }
}
