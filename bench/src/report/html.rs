//! Results as one page.

use anyhow::Result;

use super::{Part, QUICK, Report, Start, own_name, targets};
use crate::page::{Page, escape};
use crate::section::Section;

const INTRODUCTION: &str = "\
<p>What <code>cdcr-bench all</code> measured. Everything that a number needs to be judged is on this page: the \
machine, the method, and the baselines that were measured in the same run. On a shared machine an absolute \
latency says little; the ratio to the bare loop, taken in turns with it, says what the daemon adds. The same \
numbers are in <code>report.json</code>, for <code>cdcr-bench compare</code>, each case in a CSV, and every \
latency in <code>histograms/</code>, in the log format of HDR histograms.</p>\n";

pub(super) fn of_section(start: &Start, section: &dyn Section) -> Result<String> {
    let mut page = Page::new(section.heading());
    result(&mut page, section)?;
    machine(&mut page, start);
    Ok(page.end())
}

/// All results, with contents, machine and targets first.
pub(super) fn of_report(report: &Report) -> Result<String> {
    let mut page = Page::new("What cdcr reaches, measured");
    page.text(INTRODUCTION);
    if report.extent.quick {
        page.failure(QUICK);
    }
    let targets = report.targets()?;
    let mut entries = vec![("environment", "The machine")];
    let not_judged = report.not_judged();
    if !targets.is_empty() || not_judged.is_some() {
        entries.push(("targets", "Figures to reach"));
    }
    entries.extend(report.parts.iter().map(|part| (part.name, heading(part))));
    page.contents(&entries);
    machine(&mut page, &report.start);
    if !targets.is_empty() {
        page.heading("Figures to reach", Some("targets"));
        page.text(targets::EXPLANATION);
        page.plain_table(&targets::table(&targets));
    }
    if let Some(why) = not_judged {
        page.heading("Figures to reach", Some("targets"));
        page.text(&format!("<p>{}</p>", escape(why)));
    }
    for part in &report.parts {
        page.heading(heading(part), Some(part.name));
        match &part.result {
            Ok(section) => result(&mut page, &**section)?,
            Err(cause) => page.failure(&format!("There is no result: {cause}")),
        }
    }
    Ok(page.end())
}

fn heading(part: &Part) -> &'static str {
    part.result
        .as_ref()
        .map_or(part.name, |section| section.heading())
}

fn machine(page: &mut Page, start: &Start) {
    page.heading("The machine", Some("environment"));
    page.plain_table(&start.environment.table());
}

fn result(page: &mut Page, section: &dyn Section) -> Result<()> {
    let name = section.name();
    page.text(section.explanation());
    for table in section.tables() {
        page.table(&table);
    }
    for picture in section.pictures()? {
        page.figure(&own_name(name, picture.name), &picture);
    }
    if !section.histograms().is_empty() {
        let log = escape(&format!("histograms/{name}.hlog"));
        page.text(&format!(
            "<p>Every latency of it is in <code>{log}</code>.</p>"
        ));
    }
    Ok(())
}
