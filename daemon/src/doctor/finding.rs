//! What was found: one judged line for each thing that matters.

use serde::Serialize;

/// The remedy of what is well.
pub const NOTHING_TO_DO: &str = "nothing to do";

/// How bad it is. The order is that of badness.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// As it should be.
    Ok,
    /// It could not be read, so that nobody can call it good.
    Unknown,
    /// The daemon runs, and its timing suffers.
    Warning,
    /// The daemon does not start, or the configuration requires what is not there.
    Fault,
}

impl Verdict {
    /// Every verdict, best first.
    pub const ALL: [Self; 4] = [Self::Ok, Self::Unknown, Self::Warning, Self::Fault];

    /// The word that is shown.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Unknown => "unknown",
            Self::Warning => "warning",
            Self::Fault => "fault",
        }
    }

    /// Exit status of a report whose worst verdict this is. The numbers stay clear of 1 (any other error),
    /// 2 (wrong command line) and those from 64 on.
    pub const fn exit_status(self) -> u8 {
        match self {
            Self::Ok => 0,
            Self::Unknown | Self::Warning => 10,
            Self::Fault => 20,
        }
    }
}

/// What a check says about its subject.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Judgement {
    /// How bad.
    pub verdict: Verdict,
    /// What was seen.
    pub value: String,
    /// What to do about it.
    pub remedy: String,
}

impl Judgement {
    /// As it should be.
    pub fn ok(value: impl Into<String>) -> Self {
        Self::new(Verdict::Ok, value, NOTHING_TO_DO)
    }

    /// Bad for timing.
    pub fn warning(value: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::new(Verdict::Warning, value, remedy)
    }

    /// It keeps the daemon from starting.
    pub fn fault(value: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::new(Verdict::Fault, value, remedy)
    }

    /// Not to be read; `remedy` makes it readable.
    pub fn unknown(value: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::new(Verdict::Unknown, value, remedy)
    }

    /// Any verdict.
    pub fn new(verdict: Verdict, value: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self {
            verdict,
            value: value.into(),
            remedy: remedy.into(),
        }
    }
}

/// One thing that matters, and how it is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Name for programs; it stays the same from version to version.
    pub key: &'static str,
    /// Name for people.
    pub title: &'static str,
    /// How bad.
    pub verdict: Verdict,
    /// What was seen.
    pub value: String,
    /// Why it matters, in one sentence.
    pub why: &'static str,
    /// The command that corrects it, or [`NOTHING_TO_DO`].
    pub remedy: String,
}

/// Every finding.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Report {
    /// The worst verdict.
    pub worst: Verdict,
    /// In the order of the checks.
    pub findings: Vec<Finding>,
}

impl Report {
    /// A report of `findings`.
    pub fn new(findings: Vec<Finding>) -> Self {
        let worst = findings.iter().map(|finding| finding.verdict).max();
        Self {
            worst: worst.unwrap_or(Verdict::Ok),
            findings,
        }
    }

    /// How many findings have this verdict.
    pub fn count(&self, verdict: Verdict) -> usize {
        let same = |finding: &&Finding| finding.verdict == verdict;
        self.findings.iter().filter(same).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn finding(verdict: Verdict) -> Finding {
        Finding {
            key: "key",
            title: "title",
            verdict,
            value: String::new(),
            why: "",
            remedy: String::new(),
        }
    }

    #[test]
    fn the_worst_finding_is_the_worst_of_the_report() {
        assert_eq!(Report::new(Vec::new()).worst, Verdict::Ok);
        for (index, worst) in Verdict::ALL.into_iter().enumerate() {
            let mut findings: Vec<_> = Verdict::ALL[..=index]
                .iter()
                .copied()
                .map(finding)
                .collect();
            assert_eq!(Report::new(findings.clone()).worst, worst);
            findings.reverse();
            let report = Report::new(findings);
            assert_eq!(report.worst, worst);
            assert_eq!(report.count(worst), 1);
        }
    }

    #[test]
    fn a_worse_verdict_never_has_a_smaller_exit_status() {
        let statuses = Verdict::ALL.map(Verdict::exit_status);
        assert!(statuses.is_sorted());
        assert!(!statuses.contains(&1) && !statuses.contains(&2));
    }
}
