//! Findings: one assessed line for each aspect.

use serde::Serialize;

use crate::system::Unreadable;

/// Severity of a finding, in ascending order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Severity {
    Ok,
    /// It could not be read, so it cannot be assessed as good.
    Unknown,
    /// The daemon runs, and its timing suffers.
    Warning,
    /// The daemon does not start, or the configuration requires something missing.
    Fault,
}

impl Severity {
    /// Every severity, best first.
    pub(crate) const ALL: [Self; 4] = [Self::Ok, Self::Unknown, Self::Warning, Self::Fault];

    pub(crate) fn word(self) -> &'static str {
        ["ok", "unknown", "warning", "fault"][self as usize]
    }

    /// Exit status of a report with this worst severity. The numbers avoid 1 (any other error), 2 (wrong
    /// command line) and those from 64 on.
    pub(crate) fn exit_status(self) -> u8 {
        [0, 10, 10, 20][self as usize]
    }
}

/// The observation if it is good, or the problem.
pub(super) type Assessed<T = String> = Result<T, Problem>;

/// An aspect that is not good, or cannot be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Problem {
    pub(super) severity: Severity,
    /// The observation.
    pub(super) value: String,
    pub(super) remedy: String,
}

/// A problem of a severity: observation and remedy, both as in `format!`.
macro_rules! problem {
    ($severity:expr, $value:literal => $remedy:literal) => {
        Err($crate::doctor::finding::Problem {
            severity: $severity,
            value: format!($value),
            remedy: format!($remedy),
        })
    };
}
pub(super) use problem;

/// The observation if it is good, or a warning.
pub(super) fn warn_unless(is_good: bool, value: String, remedy: impl Into<String>) -> Assessed {
    if is_good {
        return Ok(value);
    }
    Err(Problem {
        severity: Severity::Warning,
        value,
        remedy: remedy.into(),
    })
}

impl From<Unreadable> for Problem {
    fn from(cause: Unreadable) -> Self {
        Self {
            severity: Severity::Unknown,
            value: cause.to_string(),
            remedy: "run `cdcrd doctor` as root, or check it by hand".to_owned(),
        }
    }
}

/// One aspect and its assessment.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct Finding {
    /// Name for programs; stable across versions.
    pub(crate) key: &'static str,
    /// Name for people.
    pub(crate) title: &'static str,
    #[serde(rename = "verdict")]
    pub(crate) severity: Severity,
    /// The observation.
    pub(crate) value: String,
    /// Why it matters, in one sentence.
    pub(crate) why: &'static str,
    /// The remedy, often a command, or `nothing to do`.
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
        let severities = findings.iter().map(|finding| finding.severity);
        let worst = severities.max().unwrap_or(Severity::Ok);
        Self { worst, findings }
    }

    pub(crate) fn count(&self, severity: Severity) -> usize {
        let same = |finding: &&Finding| finding.severity == severity;
        self.findings.iter().filter(same).count()
    }
}
