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
pub(super) type Assessed = Result<String, Problem>;

/// An aspect that is not good, or cannot be read.
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
macro_rules! warn_unless {
    ($is_good:expr, $value:literal => $remedy:literal) => {
        if $is_good {
            Ok(format!($value))
        } else {
            problem!($crate::doctor::Severity::Warning, $value => $remedy)
        }
    };
}
pub(super) use warn_unless;

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
#[derive(Debug, Serialize)]
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

#[derive(Debug, Serialize)]
pub(crate) struct DoctorReport {
    pub(crate) worst: Severity,
    /// In the order of the checks.
    pub(crate) findings: Vec<Finding>,
}
