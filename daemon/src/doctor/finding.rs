//! What was found: one assessed line for each thing that matters.

use serde::Serialize;

/// How bad it is. The order is that of badness.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Severity {
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

    pub(crate) fn word(self) -> &'static str {
        ["ok", "unknown", "warning", "fault"][self as usize]
    }

    /// Exit status of a report whose worst severity this is. The numbers stay clear of 1 (any other error),
    /// 2 (wrong command line) and those from 64 on.
    pub(crate) fn exit_status(self) -> u8 {
        [0, 10, 10, 20][self as usize]
    }
}

/// What was seen where it is as it should be, or the problem.
pub(super) type Assessed<T = String> = Result<T, Problem>;

/// Something that is not as it should be, or cannot be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Problem {
    pub(super) severity: Severity,
    /// What was seen.
    pub(crate) value: String,
    pub(super) remedy: String,
}

/// A problem of a severity: what was seen, and the remedy, both as in `format!`.
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

/// The problem of a file, or of what stands in it.
pub(super) fn unreadable(what: &str, cause: impl std::fmt::Display) -> Problem {
    Problem {
        severity: Severity::Unknown,
        value: format!("cannot read {what}: {cause}"),
        remedy: "run `cdcrd doctor` as root, or check it by hand".to_owned(),
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
    /// The command that corrects it, or `nothing to do`.
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
        let worst = worst.unwrap_or(Severity::Ok);
        Self { worst, findings }
    }

    pub(crate) fn count(&self, severity: Severity) -> usize {
        let same = |finding: &&Finding| finding.severity == severity;
        self.findings.iter().filter(same).count()
    }
}
