//! Output of `cdcrd doctor`.

use std::io::{self, Write};

use anstyle::{AnsiColor, Style};
use anyhow::{Context, Result};
use cdcr_shared_types::counted;
use clap::{Args, ValueEnum};

use super::ConfigSource;
use crate::doctor::{DoctorReport, Finding, Severity, examine};

/// Help text after the options.
pub(super) const AFTER_HELP: &str = "Example: cdcrd doctor --config robot.toml --format json\n\
    Takes one second to sample the threads that use the core of the real-time threads.\n\n\
    Exit status: 0 ok; 10 a warning or an unknown value; 20 a fault: the daemon \
    does not start, or lacks a need of realtime.mode = \"require\". With realtime.mode = \"off\", \
    findings that only affect real time are shown as ok.";

#[derive(Debug, Args)]
pub(super) struct DoctorOptions {
    #[command(flatten)]
    source: ConfigSource,
    /// Output format.
    #[arg(long, value_enum, default_value_t = Format::Text, value_name = "FORMAT")]
    format: Format,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Format {
    /// One line per finding, with reason and remedy if it is not ok.
    Text,
    /// One JSON object.
    Json,
}

/// Examines this machine, prints the report, and returns its exit status.
pub(super) fn run(options: &DoctorOptions) -> Result<u8> {
    let report = examine(&options.source.load()?);
    // Colours only on a terminal, and not if NO_COLOR is set.
    let mut out = anstream::stdout().lock();
    let written = match options.format {
        Format::Text => write_text(&mut out, &report),
        Format::Json => {
            let text = serde_json::to_string_pretty(&report).context("the report")?;
            writeln!(out, "{text}")
        }
    };
    match written.and_then(|()| out.flush()) {
        // The reader has closed the pipe: `cdcrd doctor | head`.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {}
        written => written.context("cannot write the report")?,
    }
    Ok(report.worst.exit_status())
}

fn style(severity: Severity) -> Style {
    let color = match severity {
        Severity::Ok => AnsiColor::Green,
        Severity::Unknown => AnsiColor::Cyan,
        Severity::Warning => AnsiColor::Yellow,
        Severity::Fault => AnsiColor::Red,
    };
    color.on_default()
}

fn write_text(out: &mut impl Write, report: &DoctorReport) -> io::Result<()> {
    let title = |finding: &Finding| finding.title.chars().count();
    let width = report.findings.iter().map(title).max().unwrap_or(0);
    for finding in &report.findings {
        let color = style(finding.severity);
        let word = finding.severity.word();
        writeln!(
            out,
            "{color}{word:<7}{color:#}  {:<width$}  {}",
            finding.title, finding.value
        )?;
        if finding.severity != Severity::Ok {
            writeln!(out, "         why   {}", finding.why)?;
            writeln!(out, "         fix   {}", finding.remedy)?;
        }
    }
    let counts = Severity::ALL.map(|severity| {
        let same = |finding: &&Finding| finding.severity == severity;
        let count = report.findings.iter().filter(same).count();
        match severity.word() {
            word @ ("ok" | "unknown") => format!("{count} {word}"),
            noun => counted(count, noun),
        }
    });
    let color = style(report.worst);
    writeln!(out, "\n{color}{}{color:#}", counts.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_aligned_and_only_what_is_not_ok_is_explained() {
        let finding = |title, severity| Finding {
            key: "key",
            title,
            severity,
            value: "seen".to_owned(),
            why: "Because.",
            remedy: "do it".to_owned(),
        };
        let report = DoctorReport {
            worst: Severity::Fault,
            findings: vec![
                finding("a", Severity::Ok),
                finding("longer", Severity::Fault),
            ],
        };
        let mut bytes = anstream::StripStream::new(Vec::new());
        write_text(&mut bytes, &report).unwrap();
        let text = String::from_utf8(bytes.into_inner()).unwrap();
        let expected = [
            "ok       a       seen",
            "fault    longer  seen",
            "         why   Because.",
            "         fix   do it",
            "",
            "1 ok, 0 unknown, 0 warnings, 1 fault",
        ];
        assert_eq!(text.lines().collect::<Vec<_>>(), expected);
    }
}
