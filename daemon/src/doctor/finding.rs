//! What was found: one assessed line for each thing that matters.

use serde::Serialize;

/// The remedy of what is well.
pub(crate) const NOTHING_TO_DO: &str = "nothing to do";

/// How bad it is. The order is that of badness.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Severity {
    /// As it should be.
    Ok,
    /// It could not be read, so that nobody can call it good.
    Unknown,
    /// The daemon runs, and its timing suffers.
    Warning,
    /// The daemon does not start, or the configuration requires what is not there.
    Fault,
}

impl Severity {
    /// Every severity, best first.
    pub(crate) const ALL: [Self; 4] = [Self::Ok, Self::Unknown, Self::Warning, Self::Fault];

    pub(crate) const fn word(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Unknown => "unknown",
            Self::Warning => "warning",
            Self::Fault => "fault",
        }
    }

    /// Exit status of a report whose worst severity this is. The numbers stay clear of 1 (any other error),
    /// 2 (wrong command line) and those from 64 on.
    pub(crate) const fn exit_status(self) -> u8 {
        match self {
            Self::Ok => 0,
            Self::Unknown | Self::Warning => 10,
            Self::Fault => 20,
        }
    }
}

/// What a check says about its subject.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Assessment {
    pub(crate) severity: Severity,
    /// What was seen.
    pub(crate) value: String,
    pub(crate) remedy: String,
}

impl Assessment {
    /// As it should be.
    pub(crate) fn ok(value: impl Into<String>) -> Self {
        Self::new(Severity::Ok, value, NOTHING_TO_DO)
    }

    /// Bad for timing.
    pub(crate) fn warning(value: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::new(Severity::Warning, value, remedy)
    }

    /// It keeps the daemon from starting.
    pub(crate) fn fault(value: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::new(Severity::Fault, value, remedy)
    }

    /// Not to be read; `remedy` makes it readable.
    pub(crate) fn unknown(value: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::new(Severity::Unknown, value, remedy)
    }

    /// As it should be where `is_good`, bad for timing where not.
    pub(crate) fn good_if(
        is_good: bool,
        value: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        let severity = if is_good {
            Severity::Ok
        } else {
            Severity::Warning
        };
        Self::new(severity, value, remedy)
    }

    pub(crate) fn new(
        severity: Severity,
        value: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self {
            severity,
            value: value.into(),
            remedy: remedy.into(),
        }
    }
}

/// One thing that matters, and how it is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct Finding {
    /// Name for programs; it stays the same from version to version.
    pub(crate) key: &'static str,
    /// Name for people.
    pub(crate) title: &'static str,
    #[serde(rename = "verdict")]
    pub(crate) severity: Severity,
    /// What was seen.
    pub(crate) value: String,
    /// Why it matters, in one sentence.
    pub(crate) why: &'static str,
    /// The command that corrects it, or [`NOTHING_TO_DO`].
    pub(crate) remedy: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct DoctorReport {
    pub(crate) worst: Severity,
    /// In the order of the checks.
    pub(crate) findings: Vec<Finding>,
}

impl DoctorReport {
    pub(crate) fn new(findings: Vec<Finding>) -> Self {
        let worst = findings.iter().map(|finding| finding.severity).max();
        Self {
            worst: worst.unwrap_or(Severity::Ok),
            findings,
        }
    }

    pub(crate) fn count(&self, severity: Severity) -> usize {
        let same = |finding: &&Finding| finding.severity == severity;
        self.findings.iter().filter(same).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn finding(severity: Severity) -> Finding {
        Finding {
            key: "key",
            title: "title",
            severity,
            value: String::new(),
            why: "",
            remedy: String::new(),
        }
    }

    #[test]
    fn the_worst_finding_is_the_worst_of_the_report() {
        assert_eq!(DoctorReport::new(Vec::new()).worst, Severity::Ok);
        for (index, worst) in Severity::ALL.into_iter().enumerate() {
            let mut findings: Vec<_> = Severity::ALL[..=index]
                .iter()
                .copied()
                .map(finding)
                .collect();
            assert_eq!(DoctorReport::new(findings.clone()).worst, worst);
            findings.reverse();
            let report = DoctorReport::new(findings);
            assert_eq!(report.worst, worst);
            assert_eq!(report.count(worst), 1);
        }
    }

    #[test]
    fn a_worse_verdict_never_has_a_smaller_exit_status() {
        let statuses = Severity::ALL.map(Severity::exit_status);
        assert!(statuses.is_sorted());
        assert!(!statuses.contains(&1) && !statuses.contains(&2));
    }
}
